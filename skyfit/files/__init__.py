"""Files: measured sky in, samples out."""

from .reading import read as read
from .solar_position import solar_position as solar_position
from .table import read_directions as read_directions
from .writing import atomic as atomic, write_sky as write_sky
