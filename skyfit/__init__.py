from .atmosphere import Aerosol as Aerosol, Atmosphere as Atmosphere
from .scene import Directions as Directions, hemisphere as hemisphere, Scene as Scene, Sky as Sky
from .transport import OrdersOfScattering as OrdersOfScattering, SingleScattering as SingleScattering
