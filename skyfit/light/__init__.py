from .colour import (
    equal_energy as equal_energy,
    LUMINOUS_EFFICACY as LUMINOUS_EFFICACY,
    srgb as srgb,
    srgb_from_xyz as srgb_from_xyz,
    xyY as xyY,
    xyz as xyz,
    xyz_from_xyY as xyz_from_xyY,
)
from .solar import (
    earth_sun_factor as earth_sun_factor,
    extraterrestrial_irradiance as extraterrestrial_irradiance,
    SUN_SOLID_ANGLE as SUN_SOLID_ANGLE,
)
