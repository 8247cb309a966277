from .air import (
    AerialPerspective as AerialPerspective,
    constant_ambient as constant_ambient,
    scattered_light as scattered_light,
)
from .bruneton import Bruneton as Bruneton, BrunetonField as BrunetonField
from .choose import Choice as Choice, choose as choose
from .contract import (
    AbstractSolver as AbstractSolver,
    check_scene as check_scene,
    Geometry as Geometry,
    Irradiances as Irradiances,
    low_sun as low_sun,
    LowSunWarning as LowSunWarning,
    Observers as Observers,
    Path as Path,
    Stokes as Stokes,
    Suns as Suns,
    ThickAirWarning as ThickAirWarning,
)
from .double import DoubleScattering as DoubleScattering
from .estimate import Estimate as Estimate, estimate_error as estimate_error
from .orders import OrdersOfScattering as OrdersOfScattering
from .registry import SOLVERS as SOLVERS
from .shells import Shells as Shells
from .single import SingleScattering as SingleScattering
from .spherical import Spherical as Spherical, SphericalField as SphericalField
from .uniform import Uniform as Uniform
from .upsample import upsample as upsample, Upsampled as Upsampled
