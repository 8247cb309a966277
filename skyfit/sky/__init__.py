from .analytic import AbstractAnalyticSky as AbstractAnalyticSky
from .extended import ExtendedPreetham as ExtendedPreetham
from .perez import Perez as Perez, perez_distribution as perez_distribution
from .preetham import Preetham as Preetham
