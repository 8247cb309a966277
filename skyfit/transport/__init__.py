from .aerial import AerialPerspective as AerialPerspective, constant_ambient as constant_ambient
from .double import DoubleScattering as DoubleScattering
from .orders import OrdersOfScattering as OrdersOfScattering
from .scattered import scattered_light as scattered_light
from .shells import Shells as Shells
from .single import SingleScattering as SingleScattering
from .solver import (
    AbstractSolver as AbstractSolver,
    Fluxes as Fluxes,
    Geometry as Geometry,
    Path as Path,
    Stokes as Stokes,
)
from .uniform import Uniform as Uniform
from .upsample import upsample as upsample, Upsampled as Upsampled
