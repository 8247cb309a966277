from .field import SphericalField as SphericalField
from .solver import Spherical as Spherical
