from .analytic import AbstractAnalyticSky as AbstractAnalyticSky
from .cie import (
    CIEClear as CIEClear,
    Intermediate as Intermediate,
    overcast_luminance as overcast_luminance,
    overcast_zenith_luminance as overcast_zenith_luminance,
)
from .extended import ExtendedPreetham as ExtendedPreetham
from .perez import Perez as Perez, perez_distribution as perez_distribution
from .perez_fits import fit_perez as fit_perez, PerezFits as PerezFits
from .perez_of_sky import perez_of_sky as perez_of_sky, SkyPerez as SkyPerez
from .preetham import Preetham as Preetham
from .refit import (
    Comparison as Comparison,
    Errors as Errors,
    model_xyz as model_xyz,
    preetham_atmosphere as preetham_atmosphere,
    Refit as Refit,
    refit as refit,
)
from .sunlight import Sunlight as Sunlight, Transmittances as Transmittances
