from .analytic import AbstractAnalyticSky as AbstractAnalyticSky
from .cie import (
    CIEClear as CIEClear,
    Intermediate as Intermediate,
    overcast_luminance as overcast_luminance,
    overcast_zenith_luminance as overcast_zenith_luminance,
)
from .extended import ExtendedPreetham as ExtendedPreetham
from .perez import Perez as Perez, perez_distribution as perez_distribution
from .preetham import Preetham as Preetham
from .sunlight import Sunlight as Sunlight, Transmittances as Transmittances
