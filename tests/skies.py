"""Skies and solvers that the tests of the solver floor share."""

from dataclasses import replace
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import skyfit
from skyfit import Sky
from skyfit.atmosphere import Aerosol, Exponential, Ground, HenyeyGreenstein, Ozone, Prescribed, Rayleigh, RayleighPhase
from skyfit.numerics import as_float
from skyfit.retrieve import Fit, Fitted, invert, predict, start_model, with_values
from skyfit.scene import angle_between
from skyfit.transport import DoubleScattering, OrdersOfScattering, Shells, SingleScattering, Spherical, Uniform


EARTH_RADIUS = 6371e3
ONE = np.array([550.0])
# few of everything: what these tests claim does not depend on resolution
SMALL = {geometry: OrdersOfScattering(3, 3, 8, 4, 8, 3, geometry) for geometry in ("flat", "spherical")}
SINGLE = {geometry: SingleScattering(12, geometry) for geometry in ("flat", "spherical")}
DOUBLE = {geometry: DoubleScattering(3, 3, 8, 8, 3, geometry) for geometry in ("flat", "spherical")}
SHELLS = {geometry: Shells(12, geometry) for geometry in ("flat", "spherical")}
POLARISED = {"spherical": OrdersOfScattering(3, 3, 8, 4, 8, 3, polarised=True)}
SPHERE = {
    "spherical": Spherical(
        levels=8,
        moments=4,
        up=3,
        flat=2,
        down=2,
        orders=3,
        sun_step=2.0,
        path_nodes=4,
        first_nodes=5,
        view_nodes=5,
        nodes=8,
    )
}
KINDS = {
    "single": SINGLE, "double": DOUBLE, "orders": SMALL, "polarised": POLARISED, "sphere": SPHERE, "shells": SHELLS,
    "uniform": {"flat": Uniform()},
}  # fmt: skip
SOLVERS = {f"{name} {geometry}": kind[geometry] for name, kind in KINDS.items() for geometry in kind}


def slow(*values):
    return pytest.param(*values, marks=pytest.mark.slow)


def views(zenith, azimuth):
    return skyfit.Directions.from_degrees(np.asarray(zenith, float)[:, None], np.asarray(azimuth, float)[None])


def haze_over_air(air, haze, asymmetry=0.7, albedo_single=0.9, ground=0.0, haze_height=1200.0):
    """The oracles' atmosphere, at one wavelength."""
    return skyfit.Atmosphere(
        Prescribed(jnp.reshape(jnp.asarray(air, float), (1,)), Exponential(8000.0), RayleighPhase(0.0)),
        Prescribed(
            jnp.reshape(jnp.asarray(haze, float), (1,)),
            Exponential(haze_height),
            HenyeyGreenstein(asymmetry),
            albedo_single,
        ),
        None,
        Ground(ground),
    )


def unit_scene(sun_deg, view, wavelength=ONE):
    return skyfit.Scene.from_degrees(sun_deg, view, wavelength, irradiance="unit")


def phase_functions(cosine, asymmetry=0.7):
    """Of air and haze, sr^-1."""
    lobe = (1.0 - asymmetry**2) / (4.0 * np.pi * (1.0 + asymmetry**2 - 2.0 * asymmetry * cosine) ** 1.5)
    return 3.0 / (16.0 * np.pi) * (1.0 + cosine**2), lobe


def unit_vector(zenith_deg, azimuth_deg):
    z, a = np.radians([zenith_deg, azimuth_deg])
    return np.array([np.sin(z) * np.cos(a), np.sin(z) * np.sin(a), np.cos(z)])


COLOURS = np.array([420.0, 480.0, 550.0, 680.0])


def hazy(**changes):
    """Every kind of leaf: air, haze, ozone, ground."""
    values = {
        "pressure": 9e4,
        "haze": 0.2,
        "albedo": 0.9,
        "asymmetry": 0.65,
        "ozone": 300.0,
        "ground": 0.2,
    } | changes
    atmosphere = skyfit.Atmosphere(
        # none at all too, which no weather has
        eqx.tree_at(lambda air: air.pressure, Rayleigh(), as_float(values["pressure"])),
        Aerosol(
            values["haze"],
            1.2,
            values["albedo"],
            0.02,
            HenyeyGreenstein(values["asymmetry"]),
            Exponential(1500.0),
        ),
        Ozone(values["ozone"]),
        Ground(values["ground"], 0.05),
    )
    return atmosphere


def sky_of(solver, view, wavelength=COLOURS):
    """A function of the atmosphere and the sun's zenith angle in radians."""

    def sky(atmosphere, sun):
        return solver.radiance(atmosphere, skyfit.Scene(sun, 0.3, view, wavelength, jnp.ones(len(wavelength))))

    return sky


def weights_of(values):
    """One of each number, none alike: what reverse mode sums is told apart."""
    return np.cos(np.arange(values.size)).reshape(values.shape)


def forward_of(field, count, step=1e-5, moved=None):
    """Of a function of `count` numbers near 0, in one program: values a step ahead and behind, and forward-mode slopes.

    **Arguments:** `moved`, the places of the numbers that may be moved, None for all.
    **Returns:** values `[side, moved, ...]`, slopes `[number, ...]`.
    """
    unit = jnp.eye(count)
    some = unit if moved is None else unit[np.asarray(moved)]

    @jax.jit
    def along(points, directions):
        return jax.lax.map(lambda item: jax.jvp(field, item[:1], item[1:]), (points, directions))

    points = jnp.concatenate([step * some, -step * some, 0.0 * unit])
    values, slopes = map(np.asarray, along(points, jnp.concatenate([some, some, unit])))
    return values[: 2 * len(some)].reshape(2, len(some), *values.shape[1:]), slopes[-count:]


def reverse_of(field, count, weight):
    """Of a function of `count` numbers, at 0: reverse-mode slopes of the weighted sum of its values `[number]`."""
    return np.asarray(jax.jit(jax.grad(lambda p: jnp.sum(weight * field(p))))(jnp.zeros(count)))


SKIES = {}


def compiled_sky(name, atmosphere, sun, zenith, azimuth):
    """At most nine directions; one program for each solver and dtype serves many tests."""
    key = name, jnp.result_type(float)
    if key not in SKIES:

        def sky(atmosphere, sun, zenith, azimuth):
            return sky_of(SOLVERS[name], skyfit.Directions(zenith, azimuth))(atmosphere, sun)

        SKIES[key] = jax.jit(sky)
    zenith, azimuth = (np.ravel(v) for v in np.broadcast_arrays(zenith, azimuth))
    padded = (jnp.asarray(np.pad(v, (0, 9 - len(zenith)), "edge"), float) for v in (zenith, azimuth))
    atmosphere = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), atmosphere)
    return np.asarray(SKIES[key](atmosphere, jnp.asarray(sun, float), *padded))[: len(zenith)]


def names_of(tree):
    return [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(tree)]


def simulated_by(model):
    """The formula's own skies in place of the simulation of `skyfit.analytic.refit`, `[sky, direction, 3]`."""

    def simulate(solver, flat, atmosphere, view, limit, sun, turbidity):
        rows = []
        for one, haze in zip(sun, turbidity, strict=True):
            gamma = angle_between(view.zenith, one, view.azimuth)
            luminance, x, y = model.luminance_chromaticity(haze, one, view.zenith, gamma)
            rows.append(jnp.stack([luminance * x / y, luminance, luminance * (1.0 - x - y) / y], axis=-1))
        return jnp.stack(rows)

    return simulate


MADE_WITH = SingleScattering(8, "flat")


def make_sky() -> Sky:
    """Two times, ten directions, four wavelengths; two samples masked."""
    zenith = np.radians([5.0, 30.0, 30.0, 30.0, 55.0, 55.0, 55.0, 75.0, 75.0, 75.0])
    azimuth = np.radians([0.0, 0.0, 120.0, 240.0, 60.0, 180.0, 300.0, 0.0, 120.0, 240.0])
    shape = (2, zenith.size, 4)
    usable = np.ones(shape, bool)
    usable[0, 3], usable[1, 4, 2] = False, False
    return Sky(
        radiance=np.full(shape, 0.1),
        sigma=None,
        usable=usable,
        view_zenith=zenith,
        view_azimuth=azimuth,
        wavelength_nm=np.array([440.0, 500.0, 600.0, 760.0]),
        sun_zenith=np.radians([40.0, 65.0]),
        sun_azimuth=np.radians([150.0, 250.0]),
        time=np.array(["2024-06-01T10:00", "NaT"], "datetime64[ns]"),
        altitude_m=300.0,
        masked={"suspect": 5},
        notes=("made up",),
        source="made.nc",
    )


MADE_FREE = ("turbidity", "angstrom_exponent", "asymmetry", "pointing_azimuth")
MADE_SHARED = ("asymmetry",)


@cache
def fit_of_made_sky() -> Fit:
    """A fit to `make_sky` filled by the solver `MADE_WITH`, with seeded noise; the times share the asymmetry."""
    free, truth, noise = MADE_FREE, [3.2, 1.1, 0.72, 1.5], 0.02
    sky = make_sky()
    model = with_values(start_model(free, 97000.0), free, truth)
    exact = sky.wavelength_nm, np.ones((1, len(sky.wavelength_nm)))
    alone = [Fitted(sky.time[t : t + 1], (model,), MADE_WITH, 6.0, *exact) for t in range(2)]
    clean = np.concatenate([predict(fitted, sky.at(t)) for t, fitted in enumerate(alone)])
    radiance = clean * np.random.default_rng(0).normal(1.0, noise, clean.shape)
    sky = replace(sky, radiance=np.where(sky.usable, radiance, np.nan))
    return invert(sky, free, MADE_WITH, fwhm_nm=6.0, shared=MADE_SHARED)
