from .airmass import relative_airmass as relative_airmass
from .directions import (
    angle_between as angle_between,
    as_float as as_float,
    Directions as Directions,
    haversine as haversine,
    hemisphere as hemisphere,
)
from .samples import Sky as Sky
from .scene import Scene as Scene
from .sun import short_sun_position as short_sun_position, solar_time as solar_time
