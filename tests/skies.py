"""Skies and solvers that the tests of the solver floor share."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import skyfit
from skyfit.atmosphere import (
    Aerosol,
    Exponential,
    Ground,
    HenyeyGreenstein,
    Ozone,
    Prescribed,
    Rayleigh,
    RayleighPhase,
)
from skyfit.transport import OrdersOfScattering, SingleScattering


EARTH_RADIUS = 6371e3
ONE = np.array([550.0])
# few of everything: what these tests claim does not depend on resolution
SMALL = {geometry: OrdersOfScattering(3, 3, 8, 4, 8, 3, geometry) for geometry in ("flat", "spherical")}
SINGLE = {geometry: SingleScattering(12, geometry) for geometry in ("flat", "spherical")}
SOLVERS = {f"{name} {g}": s[g] for name, s in (("single", SINGLE), ("orders", SMALL)) for g in s}
# compilation is most of the time of these tests: programs that run once are not worth optimising
HASTE = {"xla_backend_optimization_level": 0}


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
        Rayleigh(values["pressure"]),
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


SKIES = {}


def compiled_sky(name, atmosphere, sun, zenith, azimuth):
    """At most nine directions; one program for each solver and dtype serves many tests."""
    key = name, jnp.result_type(float)
    if key not in SKIES:

        def sky(atmosphere, sun, zenith, azimuth):
            return sky_of(SOLVERS[name], skyfit.Directions(zenith, azimuth))(atmosphere, sun)

        SKIES[key] = jax.jit(sky, compiler_options=HASTE)
    zenith, azimuth = (np.ravel(v) for v in np.broadcast_arrays(zenith, azimuth))
    padded = (jnp.asarray(np.pad(v, (0, 9 - len(zenith)), "edge"), float) for v in (zenith, azimuth))
    atmosphere = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), atmosphere)
    return np.asarray(SKIES[key](atmosphere, jnp.asarray(sun, float), *padded))[: len(zenith)]


def names_of(tree):
    return [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(tree)]
