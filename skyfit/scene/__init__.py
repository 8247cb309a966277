from .airmass import relative_airmass as relative_airmass
from .directions import (
    above_horizon as above_horizon,
    angle_between as angle_between,
    Directions as Directions,
    fisheye as fisheye,
    haversine as haversine,
    hemisphere as hemisphere,
    LOWEST_VISIBLE as LOWEST_VISIBLE,
    unit_vectors as unit_vectors,
)
from .scene import Scene as Scene
from .sun import short_sun_position as short_sun_position, solar_time as solar_time
