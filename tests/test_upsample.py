"""Upsampling against the solver itself in every direction, and its estimate of its own error."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from skies import hazy, slow, unit_scene, views

import skyfit
from skyfit import OrdersOfScattering, SingleScattering, upsample
from skyfit.atmosphere import Exponential, HenyeyGreenstein, Prescribed
from skyfit.transport import AbstractSolver


WAVELENGTHS = np.array([400.0, 550.0, 800.0])
SOLVERS = {
    "single": SingleScattering.draft(),
    "single flat": SingleScattering.draft("flat"),
    "orders": OrdersOfScattering.draft(),
    "orders flat": OrdersOfScattering.draft("flat"),
}
SUNS, HAZES = (20.0, 60.0, 80.0, 85.0), (0.05, 0.4)


def dome(count, seed=0, edge=90.0):
    """Directions over the sky, a third of them low."""
    random = np.random.default_rng(seed)
    zenith = np.arccos(random.uniform(np.cos(np.radians(edge)), 1.0, count))
    zenith[: count // 3] = np.radians(np.linspace(75.0, edge, count // 3))
    return skyfit.Directions(zenith, random.uniform(0.0, 2.0 * np.pi, count))


def scene_of(sun, view):
    return skyfit.Scene.from_degrees(sun, view, WAVELENGTHS, sun_azimuth=30.0)


def compare(solver, sun, haze, view, **grid):
    """Relative error and its estimate."""
    atmosphere, scene = skyfit.Atmosphere.from_optical_depth(haze), scene_of(sun, view)
    sky = upsample(solver, atmosphere, scene, **grid)
    return np.abs(np.asarray(sky.radiance / solver.radiance(atmosphere, scene)) - 1.0), np.asarray(sky.error)


@pytest.mark.parametrize("name", ["single", "single flat", slow("orders"), slow("orders flat")])
def test_skies_are_met_and_the_estimate_bounds_the_error(name, x64):
    view = dome(400, edge=88.0 if "flat" in name else 90.0)
    low = np.degrees(view.zenith) <= 85.0
    for sun in SUNS:
        for haze in HAZES:
            error, estimate = compare(SOLVERS[name], sun, haze, view)
            assert error[low].max() < 0.01, (sun, haze)
            assert np.median(error) < 2e-4, (sun, haze)
            assert np.mean(error <= estimate) >= 0.95, (sun, haze)
            # a bound that says nothing would be no estimate
            assert np.median(estimate) < 2e-3, (sun, haze)
