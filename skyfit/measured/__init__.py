from .masking import mask_sun as mask_sun
from .noise import NoiseModel as NoiseModel
from .possible import STATION_RANGES as STATION_RANGES
from .readers import read as read, read_directions as read_directions, read_response as read_response
from .response import LineShape as LineShape, Response as Response, Seen as Seen
from .samples import Sky as Sky, time_names as time_names
from .solar_position import solar_position as solar_position
from .station import station_pressure as station_pressure, sun_factor as sun_factor
from .writing import atomic as atomic, write_sky as write_sky
