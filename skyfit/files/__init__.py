"""Files: measured sky in, samples out."""

from .coefficients import read_coefficients as read_coefficients, write_coefficients as write_coefficients
from .fit_record import load as load, save as save, write_prediction as write_prediction
from .many import fit_many as fit_many, read_fits as read_fits
from .reading import read as read
from .response import read_response as read_response
from .solar_position import solar_position as solar_position
from .table import read_directions as read_directions
from .writing import atomic as atomic, write_sky as write_sky
