from .haze_optics import Derived as Derived, haze_optics as haze_optics
from .inversion import (
    DEFAULT_FREE as DEFAULT_FREE,
    invert as invert,
    PARTICLE_FREE as PARTICLE_FREE,
    predict as predict,
    simulate as simulate,
    SLOW as SLOW,
)
from .many import Fits as Fits
from .measurement import Measurement as Measurement, Response as Response
from .parameters import (
    check_free as check_free,
    PARAMETERS as PARAMETERS,
    SkyModel as SkyModel,
    start_model as start_model,
    values_of as values_of,
    with_values as with_values,
)
from .perez_fits import fit_perez as fit_perez, PerezFits as PerezFits
from .problem import station_pressure as station_pressure
from .refit import (
    Comparison as Comparison,
    Errors as Errors,
    model_xyz as model_xyz,
    preetham_atmosphere as preetham_atmosphere,
    Refit as Refit,
    refit as refit,
)
from .result import Fit as Fit, Fitted as Fitted, time_names as time_names
from .sensitivity import (
    Choice as Choice,
    fisher_information as fisher_information,
    next_directions as next_directions,
    posterior_covariance as posterior_covariance,
    sensitivity as sensitivity,
)
