"""A differentiable daylight sky: simulate it, fit it, refit Preetham's model."""

from .analytic import (
    CIEClear as CIEClear,
    ExtendedPreetham as ExtendedPreetham,
    fit_perez as fit_perez,
    Intermediate as Intermediate,
    overcast_luminance as overcast_luminance,
    Perez as Perez,
    Preetham as Preetham,
    refit as refit,
    Sunlight as Sunlight,
)
from .atmosphere import (
    Aerosol as Aerosol,
    Atmosphere as Atmosphere,
    CornetteShanks as CornetteShanks,
    Droplets as Droplets,
    Exponential as Exponential,
    Gas as Gas,
    Ground as Ground,
    HenyeyGreenstein as HenyeyGreenstein,
    hoffman_haze as hoffman_haze,
    Layered as Layered,
    Levels as Levels,
    meteorological_range as meteorological_range,
    optical_depth_to_turbidity as optical_depth_to_turbidity,
    Ozone as Ozone,
    OzoneLayer as OzoneLayer,
    Prescribed as Prescribed,
    Rayleigh as Rayleigh,
    RayleighPhase as RayleighPhase,
    Tabulated as Tabulated,
    turbidity_from_range as turbidity_from_range,
    turbidity_to_optical_depth as turbidity_to_optical_depth,
    TwoModeAerosol as TwoModeAerosol,
    TwoTermHenyeyGreenstein as TwoTermHenyeyGreenstein,
)
from .draw import plot as plot
from .light import daylight as daylight, srgb as srgb, srgb_from_linear as srgb_from_linear, xyY as xyY, xyz as xyz
from .measured import (
    Measurement as Measurement,
    read as read,
    read_response as read_response,
    Response as Response,
    Sky as Sky,
    write_sky as write_sky,
)
from .records import (
    fit_many as fit_many,
    load as load,
    read_coefficients as read_coefficients,
    read_fits as read_fits,
    save as save,
)
from .retrieve import (
    fisher_information as fisher_information,
    Fit as Fit,
    Fits as Fits,
    haze_optics as haze_optics,
    invert as invert,
    next_directions as next_directions,
    PARAMETERS as PARAMETERS,
    posterior_covariance as posterior_covariance,
    predict as predict,
    sensitivity as sensitivity,
)
from .scene import (
    Directions as Directions,
    fisheye as fisheye,
    hemisphere as hemisphere,
    Scene as Scene,
    short_sun_position as short_sun_position,
    solar_time as solar_time,
    unit_vectors as unit_vectors,
)
from .transport import (
    AerialPerspective as AerialPerspective,
    constant_ambient as constant_ambient,
    DoubleScattering as DoubleScattering,
    Fluxes as Fluxes,
    OrdersOfScattering as OrdersOfScattering,
    Path as Path,
    scattered_light as scattered_light,
    Shells as Shells,
    SingleScattering as SingleScattering,
    Stokes as Stokes,
    Uniform as Uniform,
    upsample as upsample,
    Upsampled as Upsampled,
)
