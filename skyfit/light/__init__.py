from .colour import (
    linear_from_xyz as linear_from_xyz,
    LUMINOUS_EFFICACY as LUMINOUS_EFFICACY,
    observer_weights as observer_weights,
    SMALLEST_Y as SMALLEST_Y,
    srgb as srgb,
    srgb_from_linear as srgb_from_linear,
    SRGB_FROM_XYZ as SRGB_FROM_XYZ,
    srgb_from_xyz as srgb_from_xyz,
    SRGB_LUMINANCE as SRGB_LUMINANCE,
    WHITE as WHITE,
    xyY as xyY,
    xyY_from_xyz as xyY_from_xyz,
    xyz as xyz,
    xyz_from_xyY as xyz_from_xyY,
)
from .daylight import daylight as daylight
from .solar import (
    earth_sun_factor as earth_sun_factor,
    extraterrestrial_irradiance as extraterrestrial_irradiance,
    SUN_SOLID_ANGLE as SUN_SOLID_ANGLE,
)
