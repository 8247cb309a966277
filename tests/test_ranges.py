"""Values out of range are refused where they can be seen, by every public constructor and by functions."""

from dataclasses import fields, is_dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import skyfit
from skyfit import (
    Aerosol,
    BinnedAerosol,
    CornetteShanks,
    Directions,
    Droplets,
    Exponential,
    Gas,
    Ground,
    HenyeyGreenstein,
    Intermediate,
    Layered,
    Levels,
    NoiseModel,
    Ozone,
    OzoneLayer,
    Perez,
    Prescribed,
    Rayleigh,
    RayleighPhase,
    Response,
    Scene,
    Sunlight,
    Tabulated,
    TwoModeAerosol,
    TwoTermHenyeyGreenstein,
)


PI = float(np.pi)
VIEW = {"zenith": [0.3, 0.5], "azimuth": [0.0, 0.1]}
LINES = {"table_wavelength_nm": [400.0, 700.0]}
# a class, arguments that are right, and of each field the ends of its range
RANGES = [
    (skyfit.Spherical, {}, {"sun_step": (0.2, 5.0), "near": (1.0, 1e4)}),
    (skyfit.Bruneton, {}, {"lowest_sun": (-0.9, -0.01)}),
    (
        Aerosol, {"optical_depth": 0.1},
        {
            "optical_depth": (0.0, 1e3), "angstrom_exponent": (-2.0, 6.0), "single_scattering_albedo": (0.0, 1.0),
            "single_scattering_albedo_slope": (-10.0, 10.0), "angstrom_curvature": (-3.0, 3.0),
        },
    ),
    (
        TwoModeAerosol, {"optical_depth": 0.1},
        {
            "optical_depth": (0.0, 1e3), "fine_fraction": (0.0, 1.0), "fine_radius": (0.05, 0.5),
            "coarse_radius": (0.8, 6.0), "fine_width": (0.3, 0.9), "coarse_width": (0.3, 0.9),
            "refractive_index": (1.33, 1.6), "absorption_index": (0.0, 0.1),
        },
    ),
    (
        BinnedAerosol, {"bins": [0.01] * 22},
        {
            "bins": (0.0, 1e3), "refractive_index": (1.33, 1.6), "refractive_index_slope": (-0.3, 0.3),
            "absorption_index": (0.0, 0.1), "absorption_index_exponent": (-6.0, 6.0),
            "absorption_index_curvature": (-10.0, 10.0),
        },
    ),
    (Rayleigh, {}, {"pressure": (2e3, 1.2e5)}),
    (Ozone, {}, {"column": (0.0, 1e3)}),
    (
        Gas, LINES | {"column": 1.0, "absorption_per_unit": [0.1, 0.2], "profile": Exponential(8e3)},
        {"column": (0.0, 1e30), "table_wavelength_nm": (100.0, 1e5), "absorption_per_unit": (0.0, 1e30)},
    ),
    (
        Droplets,
        LINES | {"coefficient": 0.02, "thickness": 100.0, "efficiency": [2.0, 2.0], "phase": HenyeyGreenstein(0.8)},
        {
            "coefficient": (0.0, 10.0), "thickness": (0.1, 1e5), "table_wavelength_nm": (100.0, 1e5),
            "efficiency": (0.0, 1e3), "single_scattering_albedo": (0.0, 1.0),
        },
    ),
    (
        Prescribed, {"optical_depth": [0.1, 0.2], "profile": Exponential(8e3)},
        {"optical_depth": (0.0, 1e4), "single_scattering_albedo": (0.0, 1.0)},
    ),
    (RayleighPhase, {}, {"depolarization": (0.0, 1.0)}),
    (HenyeyGreenstein, {"asymmetry": 0.7}, {"asymmetry": (-0.999, 0.999), "polarisation": (0.0, 1.0)}),
    (CornetteShanks, {"asymmetry": 0.7}, {"asymmetry": (-0.999, 0.999), "polarisation": (0.0, 1.0)}),
    (
        TwoTermHenyeyGreenstein, {"asymmetry": 0.7, "asymmetry_second": 0.1, "forward_fraction": 0.8},
        {
            "asymmetry": (-0.999, 0.999), "asymmetry_second": (-0.999, 0.999), "forward_fraction": (0.0, 1.0),
            "forward_fraction_slope": (-10.0, 10.0), "polarisation": (0.0, 1.0),
        },
    ),
    (
        Tabulated, LINES | {"angle": [1.0, 2.0], "log_value": [[0.0, 0.0], [0.0, 0.0]]},
        {
            "angle": (0.0, PI), "table_wavelength_nm": (100.0, 1e5), "log_value": (-80.0, 80.0),
            "polarisation": (0.0, 1.0), "matrix_ratio": (-1.0, 1.0),
        },
    ),
    (Exponential, {"scale_height": 8e3}, {"scale_height": (10.0, 1e6)}),
    (OzoneLayer, {}, {"height": (1.0, 1e5), "thickness": (1.0, 1e5)}),
    (Layered, {"edges": [0.0, 1e3, 2e3], "fraction": [0.5, 0.5]}, {"edges": (0.0, 1e6), "fraction": (0.0, 1e30)}),
    (Levels, {"height": [0.0, 1e3], "density_at": [1.0, 0.5]}, {"height": (0.0, 1e6), "density_at": (0.0, 1e30)}),
    (Ground, {}, {"albedo": (0.0, 1.0), "albedo_slope": (-10.0, 10.0), "red_edge": (-1.0, 1.0)}),
    (Directions, VIEW, {"zenith": (0.0, PI), "azimuth": (-4.0 * PI, 4.0 * PI), "weight": (0.0, 4.0 * PI)}),
    (
        Scene,
        {
            "sun_zenith": 0.5, "sun_azimuth": 0.0, "view": Directions(**VIEW), "wavelength_nm": [400.0, 500.0],
            "solar_irradiance": [1.0, 1.0],
        },
        {
            "sun_zenith": (0.0, PI), "sun_azimuth": (-4.0 * PI, 4.0 * PI), "wavelength_nm": (200.0, 5e3),
            "solar_irradiance": (0.0, 1e30), "height": (0.0, 1e9),
        },
    ),
    (
        Sunlight, {"turbidity": 2.0},
        {
            "turbidity": (0.995, 1e4), "angstrom_exponent": (-2.0, 6.0), "ozone": (0.0, 0.01),
            "water_vapour": (0.0, 0.2),
        },
    ),
    (
        Intermediate, {"clear": skyfit.Preetham.published()},
        {"clear_turbidity": (0.0, 1e4), "overcast_turbidity": (0.0, 1e4)},
    ),
    (
        Perez,
        {
            "horizon_darkening": -1.0, "horizon_gradient": -0.3, "circumsolar_intensity": 1.0,
            "circumsolar_width": -2.0, "backscatter": 0.1,
        },
        {field.name: (-1e38, 1e38) for field in fields(Perez)},
    ),
    (
        skyfit.Camera, {"projection": "fisheye", "field_of_view": 1.0},
        {
            "azimuth": (-4.0 * PI, 4.0 * PI), "elevation": (-0.5 * PI, 0.5 * PI), "field_of_view": (1e-4, 2.0 * PI),
            "k1": (-0.5, 0.5), "k2": (-0.5, 0.5),
        },
    ),
    (
        NoiseModel, {},
        {
            "relative": (0.0, 1.0), "floor": (0.0, 1.0), "calibration": (0.0, 1.0), "model_error": (0.0, 1.0),
            "field_of_view": (0.0, 0.5), "threshold": (0.5, 1e3), "level": (0.0, 1.0), "colour": (0.0, 1.0),
            "pointing": (0.0, 0.2), "time_level": (0.0, 1.0), "broad_level": (0.0, 1.0), "broad_colour": (0.0, 1.0),
        },
    ),
    (
        Response, {"wavelength_nm": np.array([400.0, 500.0]), "weight": np.ones((1, 2))},
        {"wavelength_nm": (300.0, 1100.0), "weight": (-1e30, 1e30)},
    ),
]  # fmt: skip
# what a call answers or a file holds: nobody makes one with arguments of his own
ANSWERS = {"Fit", "Fits", "Image", "Irradiances", "Panorama", "Path", "Sky", "SphericalField", "Stokes", "Upsampled"}
# parts by name, and coefficients of a fit of which each number is one
OTHER = {"Atmosphere", "CIEClear", "ExtendedPreetham", "Preetham"}
# ends that another condition refuses: an interval that is none, a density of 0, no noise at all
ELSEWHERE = {
    ("Intermediate", "clear_turbidity", 1e4), ("Intermediate", "overcast_turbidity", 0.0),
    ("Levels", "density_at", 0.0), ("NoiseModel", "relative", 0.0), ("NoiseModel", "floor", 0.0),
}  # fmt: skip

CASES = [(kind, right, name, *ends) for kind, right, ranges in RANGES for name, ends in ranges.items()]
NAMES = [f"{kind.__name__}-{name}" for kind, _, name, *_ in CASES]


def with_value(right, name, value):
    """Right arguments but for one, in the place of one number of an array."""
    if not np.ndim(right.get(name)):
        # of an optional array
        shape = {"weight": (2,), "matrix_ratio": (3, 2, 2)}.get(name, ())
        return right | {name: np.full(shape, value) if shape else value}
    changed = np.array(right[name], float)
    changed[(0,) * changed.ndim if value <= changed.min() or np.isnan(value) else (-1,) * changed.ndim] = value
    return right | {name: changed}


@pytest.mark.parametrize("kind, right, name, low, high", CASES, ids=NAMES)
def test_constructors_refuse_what_is_out_of_range_and_take_the_ends(kind, right, name, low, high):
    step = 1e-3 * (high - low)
    for value in (low - step, high + step, np.nan, -np.inf, np.inf):
        with pytest.raises(ValueError, match="^`[^\n]* must [^\n]*, got [^\n]*$") as error:
            kind(**with_value(right, name, value))
        assert f"`{name}`" in str(error.value)
    for end in (low, high):
        if (kind.__name__, name, end) not in ELSEWHERE:
            kind(**with_value(right, name, end))
            # a float32 of an end is not beyond it
            kind(**with_value(right, name, float(np.float32(end))))


def of_floats(kind) -> bool:
    return is_dataclass(kind) and any("Float" in str(f.type) or "float" in str(f.type) for f in fields(kind))


def test_no_public_class_with_numbers_is_left_out():
    public = {name: getattr(skyfit, name) for name in skyfit.__all__ if isinstance(getattr(skyfit, name), type)}
    listed = {kind.__name__: ranges for kind, _, ranges in RANGES}
    missing = {name for name, kind in public.items() if of_floats(kind)} - set(listed) - ANSWERS - OTHER
    assert not missing
    for name, ranges in listed.items():
        numbers = {f.name for f in fields(public[name]) if "Float" in str(f.type) or "float" in str(f.type)}
        assert numbers <= set(ranges), name


HAZE = HenyeyGreenstein(0.7)
EXTENDED = skyfit.ExtendedPreetham.shipped()
UP, WEST = jnp.array([0.0, 0.0, 1.0]), jnp.array([[-1.0], [0.0], [0.0]])
CALLS = {
    "turbidity of haze": (lambda v: skyfit.turbidity_to_optical_depth(v), 1.0, 1e4, "turbidity"),
    "haze of turbidity": (lambda v: skyfit.optical_depth_to_turbidity(v), 0.0, 1e3, "optical_depth"),
    "range": (lambda v: skyfit.meteorological_range(v), 1.0, 1e4, "turbidity"),
    "distance": (lambda v: skyfit.turbidity_from_range(v), 1.0, np.inf, "distance"),
    "Angstrom": (lambda v: skyfit.atmosphere.angstrom_coefficient(v), 0.9953, 1e4, "turbidity"),
    "altitude": (lambda v: skyfit.atmosphere.pressure_at_altitude(v), -500.0, 11e3, "altitude_m"),
    "from_turbidity": (lambda v: skyfit.Atmosphere.from_turbidity(v), 1.0, 1e4, "turbidity"),
    "from_optical_depth": (lambda v: skyfit.Atmosphere.from_optical_depth(v), 0.0, 1e3, "optical_depth"),
    "Hoffman": (lambda v: skyfit.hoffman_haze("light fog", jnp.array([500.0]), v), 0.0, 5e-5, "absorption"),
    "phase": (lambda v: HAZE.at_angle(jnp.array([v]), jnp.array([550.0])), 0.0, PI, "angle"),
    "half angle": (lambda v: HAZE.at_haversine(jnp.array([v]), jnp.array([550.0])), 0.0, 1.0, "haversine"),
    "zenith": (lambda v: skyfit.unit_vectors(v, 0.0), 0.0, PI, "zenith"),
    "azimuth": (lambda v: skyfit.unit_vectors(0.1, v), -4.0 * PI, 4.0 * PI, "azimuth"),
    "airmass": (lambda v: skyfit.scene.relative_airmass(v), 0.0, PI, "zenith"),
    "overcast": (lambda v: skyfit.overcast_luminance(1.0, v), 0.0, PI, "theta"),
    "overcast sun": (lambda v: skyfit.overcast_luminance(v, 1.0), 0.0, PI, "theta_sun"),
    "day": (lambda v: skyfit.light.earth_sun_factor(v), 1.0, 366.0, "day_of_year"),
    "latitude": (lambda v: skyfit.short_sun_position(12.0, 100, v), -0.5 * PI, 0.5 * PI, "latitude"),
    "longitude": (lambda v: skyfit.solar_time(12.0, 100, v, 0.0), -2.0 * PI, 2.0 * PI, "longitude_west"),
    "daylight": (lambda v: skyfit.daylight(0.3, 0.3, np.array([v])), 300.0, 830.0, "wavelength_nm"),
    "view of a model": (lambda v: EXTENDED.luminance_chromaticity(3.0, 1.0, v, 0.5), 0.0, PI, "theta"),
    "sun of a model": (lambda v: EXTENDED.rgb(3.0, v * UP, WEST), 0.999, 1.001, "|sun|"),
    "pixels of a model": (lambda v: EXTENDED.rgb(3.0, UP, v * WEST), 0.999, 1.001, "|view|"),
}


@pytest.mark.parametrize("name", CALLS)
def test_functions_refuse_what_is_out_of_range_and_take_the_ends(name):
    call, low, high, argument = CALLS[name]
    step = 1e-2 * (high - low if np.isfinite(high) else 1.0)
    for value in (low - step, high + step, np.nan):
        # infinity is a distance
        if value != np.inf:
            with pytest.raises(ValueError) as error:
                call(float(value))
            assert str(error.value).startswith(f"`{argument}` must be ") and "\n" not in str(error.value)
    for end in (low, high):
        call(float(end))


@pytest.mark.parametrize("solver, name, least", [
    (skyfit.SingleScattering, "nodes", 1), (skyfit.Shells, "nodes", 1), (skyfit.AerialPerspective, "pieces", 2),
    (skyfit.OrdersOfScattering, "levels", 2), (skyfit.DoubleScattering, "streams", 1),
])  # fmt: skip
def test_resolutions_have_a_least_number(solver, name, least):
    with pytest.raises(ValueError, match=f"`{name}` must be at least {least}, got {least - 1}"):
        solver(**{name: least - 1})


def test_what_was_meant_is_said():
    for call, hint in (
        (lambda: Rayleigh(1013.25), "hPa times 100"),
        (lambda: Scene(0.7, 180.0, Directions(**VIEW), [500.0], [1.0]), "radians"),
        (lambda: Scene.from_degrees(40.0, Directions(**VIEW), [0.55], irradiance="unit"), "micrometres"),
        (lambda: HAZE.at_angle(jnp.array([90.0]), jnp.array([550.0])), "radians"),
        (lambda: Exponential(8.0), "kilometres"),
    ):
        with pytest.raises(ValueError, match=hint):
            call()


def test_traced_values_pass_and_batches_are_made_as_before():
    depths = jnp.array([0.1, 0.2])
    made = jax.vmap(lambda depth: Aerosol(depth, phase=HenyeyGreenstein(depth)))(depths)
    assert made.optical_depth.shape == made.phase.asymmetry.shape == (2,)
    # a tree that is put together again is not made anew: marks and gradients take the place of numbers
    assert jax.tree.map(lambda leaf: -leaf, made).optical_depth[0] < 0.0
    assert jax.tree.map(lambda _: None, made).optical_depth is None
    unseen = jax.jit(lambda depth: Aerosol(depth).optical_depth)(-0.2)
    assert unseen == jnp.float32(-0.2)
    slope = jax.grad(lambda t: skyfit.Atmosphere.from_turbidity(t).aerosol.optical_depth)(0.5)
    assert np.isfinite(slope)
