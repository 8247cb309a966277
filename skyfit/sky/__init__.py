from .analytic import AbstractAnalyticSky as AbstractAnalyticSky
from .perez import Perez as Perez, perez_distribution as perez_distribution
from .preetham import Preetham as Preetham
