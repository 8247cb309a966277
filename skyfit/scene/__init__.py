from .airmass import relative_airmass as relative_airmass
from .directions import (
    above_horizon as above_horizon,
    angle_between as angle_between,
    as_float as as_float,
    Directions as Directions,
    haversine as haversine,
    hemisphere as hemisphere,
    LOWEST_VISIBLE as LOWEST_VISIBLE,
)
from .samples import Sky as Sky, STATION_RANGES as STATION_RANGES
from .scene import Scene as Scene
from .sun import short_sun_position as short_sun_position, solar_time as solar_time
from .vectors import fisheye as fisheye, unit_vectors as unit_vectors
