from .inversion import (
    DEFAULT_FREE as DEFAULT_FREE,
    invert as invert,
    predict as predict,
    simulate as simulate,
)
from .parameters import PARAMETERS as PARAMETERS, SkyModel as SkyModel, start_model as start_model
from .result import Fit as Fit, Fitted as Fitted, time_names as time_names
