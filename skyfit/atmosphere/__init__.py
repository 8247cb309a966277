from .aerosol import Aerosol as Aerosol
from .atmosphere import Atmosphere as Atmosphere, Ground as Ground
from .constituent import AbstractConstituent as AbstractConstituent, Prescribed as Prescribed
from .description import (
    CONSTITUENTS as CONSTITUENTS,
    describe as describe,
    from_description as from_description,
    PHASES as PHASES,
    PROFILES as PROFILES,
)
from .droplets import droplet_phase as droplet_phase, Droplets as Droplets
from .gas import (
    AbstractGas as AbstractGas,
    DOBSON_PER_METRE as DOBSON_PER_METRE,
    Gas as Gas,
    MOLECULES_PER_DOBSON as MOLECULES_PER_DOBSON,
    Ozone as Ozone,
    preetham_absorption as preetham_absorption,
)
from .hoffman import hoffman_haze as hoffman_haze, HOFFMAN_WAVELENGTHS as HOFFMAN_WAVELENGTHS
from .mie import TwoModeAerosol as TwoModeAerosol, TwoModePhase as TwoModePhase
from .phase import (
    AbstractPhase as AbstractPhase,
    CornetteShanks as CornetteShanks,
    HenyeyGreenstein as HenyeyGreenstein,
    RayleighPhase as RayleighPhase,
    REFERENCE_WAVELENGTH as REFERENCE_WAVELENGTH,
    Tabulated as Tabulated,
    TwoTermHenyeyGreenstein as TwoTermHenyeyGreenstein,
)
from .profile import (
    AbstractProfile as AbstractProfile,
    Exponential as Exponential,
    HAZE_SCALE_HEIGHT as HAZE_SCALE_HEIGHT,
    Layered as Layered,
    Levels as Levels,
    OzoneLayer as OzoneLayer,
)
from .rayleigh import (
    bodhaine_optical_depth as bodhaine_optical_depth,
    paper_scattering_coefficient as paper_scattering_coefficient,
    pressure_at_altitude as pressure_at_altitude,
    Rayleigh as Rayleigh,
    SEA_LEVEL_PRESSURE as SEA_LEVEL_PRESSURE,
)
from .size_bins import BIN_RADII as BIN_RADII, BinnedAerosol as BinnedAerosol, BinnedPhase as BinnedPhase
from .turbidity import (
    angstrom_coefficient as angstrom_coefficient,
    hosek_turbidity as hosek_turbidity,
    meteorological_range as meteorological_range,
    optical_depth_to_turbidity as optical_depth_to_turbidity,
    turbidity_from_range as turbidity_from_range,
    turbidity_to_optical_depth as turbidity_to_optical_depth,
)
