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
from .samples import Sky as Sky
from .scene import Scene as Scene
from .vectors import fisheye as fisheye, unit_vectors as unit_vectors
