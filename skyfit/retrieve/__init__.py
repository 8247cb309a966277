from .aerosol_optics import (
    aerosol_optics as aerosol_optics,
    aerosol_products as aerosol_products,
    Derived as Derived,
)
from .batch import Fits as Fits
from .design import (
    fisher_information as fisher_information,
    next_directions as next_directions,
    NextDirections as NextDirections,
    posterior_covariance as posterior_covariance,
    sensitivity as sensitivity,
)
from .forward import simulate as simulate
from .invert import invert as invert
from .model import SkyModel as SkyModel
from .parameters import (
    BINS_FREE as BINS_FREE,
    check_free as check_free,
    LOBES_FREE as LOBES_FREE,
    PARAMETERS as PARAMETERS,
    PARTICLE_FREE as PARTICLE_FREE,
    PICTURE_FREE as PICTURE_FREE,
    SLOW as SLOW,
    start_model as start_model,
    SUN_FREE as SUN_FREE,
    values_of as values_of,
    with_values as with_values,
)
from .predict import predict as predict
from .prepared import start_at as start_at, usual_free as usual_free
from .result import Fit as Fit, Fitted as Fitted
from .retrieve import retrieve as retrieve
