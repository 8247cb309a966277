"""Names and defaults of other modules for the help text, so that it need not load them; tests compare them."""

SOLVER_NAMES = ("orders", "spherical", "double", "single", "shells", "uniform")
PARAMETER_NAMES = (
    "turbidity", "aerosol_optical_depth", "angstrom_exponent", "angstrom_curvature", "single_scattering_albedo",
    "single_scattering_albedo_slope", "asymmetry", "asymmetry_second", "forward_fraction", "forward_fraction_slope",
    "haze_polarisation", "fine_fraction", "fine_radius", "coarse_radius", "fine_width", "coarse_width",
    "refractive_index", "absorption_index", "refractive_index_slope", "absorption_index_exponent",
    "absorption_index_curvature", *(f"size_bin_{number}" for number in range(1, 23)), "aerosol_scale_height", "ozone",
    "ground_albedo", "ground_albedo_slope", "ground_red_edge", "pressure", "pointing_zenith", "pointing_azimuth",
    "sun_zenith_offset",
)  # fmt: skip
# Default threshold of `NoiseModel`, in sigma
THRESHOLD = 3.0
SEA_LEVEL_PRESSURE = 101325.0  # Pa
