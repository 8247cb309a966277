"""Turbidity: the paper's relations to the haze's optical depth, and the meteorological range."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import skyfit
from skyfit.atmosphere import (
    angstrom_coefficient,
    bodhaine_optical_depth,
    meteorological_range,
    optical_depth_to_turbidity,
    paper_scattering_coefficient,
    turbidity_from_range,
    turbidity_to_optical_depth,
)


RELATIONS = ("definition", "sunlight", "scattering")


def test_angstroms_coefficient_is_a1s_and_never_negative():
    np.testing.assert_allclose(angstrom_coefficient(jnp.array([1.0, 2.0, 6.0])), [0.00022, 0.0463, 0.23062], rtol=1e-4)
    assert float(jax.jit(angstrom_coefficient)(0.9)) == 0.0
    assert np.all(np.isfinite(jax.vmap(jax.grad(angstrom_coefficient))(jnp.array([0.0, 0.9, 1.0, 5.0]))))


def test_the_relations_are_the_papers(x64):
    """A.1 at T = 2 gives 0.1007 (ERRATA); A.3 with 1e-18 and A.4 give T of 1.80, 2.59, 4.97 by sec. 2.1 (ERRATA 2)."""
    assert float(turbidity_to_optical_depth(2.0, "sunlight")) == pytest.approx(0.1007, abs=5e-5)
    assert float(turbidity_to_optical_depth(2.0)) == pytest.approx(float(bodhaine_optical_depth(550.0)), rel=1e-12)
    air = float(paper_scattering_coefficient(550.0)) / 0.1136e-3
    found = [1.0 + float(turbidity_to_optical_depth(t, "scattering")) / air for t in (2.0, 3.0, 6.0)]
    np.testing.assert_allclose(found, [1.80, 2.59, 4.97], atol=6e-3)
    # the printed 1e-16 gives 80.8
    assert 1.0 + 100.0 * (found[0] - 1.0) == pytest.approx(80.8, abs=0.2)


@pytest.mark.parametrize("relation", RELATIONS)
def test_depth_and_turbidity_are_inverses_in_both_dtypes(relation):
    for wide in (False, True):
        with jax.enable_x64(wide):
            turbidity = jnp.array([1.0, 1.7, 4.0, 20.0])
            depth = turbidity_to_optical_depth(turbidity, relation)
            assert np.all(np.asarray(depth) >= 0.0)
            np.testing.assert_allclose(
                optical_depth_to_turbidity(depth, relation), turbidity, rtol=1e-12 if wide else 1e-5
            )
            slope = jax.vmap(jax.grad(lambda t: turbidity_to_optical_depth(t, relation)))(turbidity)
            np.testing.assert_allclose(slope, (depth[3] - depth[0]) / 19.0, rtol=1e-5)


def test_an_atmosphere_takes_a_relation():
    haze = skyfit.Atmosphere.from_turbidity(3.0, "scattering", angstrom_exponent=0.8).aerosol
    assert float(haze.optical_depth) == pytest.approx(0.1900, abs=5e-5)
    assert float(haze.angstrom_exponent) == pytest.approx(0.8)
    with pytest.raises((ValueError, TypeError), match="relation"):
        turbidity_to_optical_depth(3.0, "guess")


def test_pure_air_lets_one_see_over_three_hundred_kilometres():
    assert float(meteorological_range(1.0)) == pytest.approx(339e3, rel=2e-3)
    assert float(jax.jit(meteorological_range)(0.5)) == float(meteorological_range(1.0))
    # the scale heights of A.4 and of the oracles
    assert float(meteorological_range(1.0, air_optical_length=1.0 / 0.1136e-3)) == pytest.approx(355e3, rel=2e-3)
    assert float(meteorological_range(1.0, air_optical_length=8000.0)) == pytest.approx(322e3, rel=2e-3)


def test_the_range_is_where_the_contrast_is_two_per_cent(x64):
    """Sec. 2.1, contrast of a black target before the horizon, found by bisection in the atmosphere itself."""
    atmosphere = skyfit.Atmosphere(
        skyfit.Rayleigh(profile=skyfit.Exponential(8400.0)),
        skyfit.Aerosol(turbidity_to_optical_depth(4.0)),
        None,
    )
    scene = skyfit.Scene.from_degrees(60.0, skyfit.Directions.from_degrees(90.0, 0.0), [550.0], irradiance="unit")

    def contrast(distance):
        # in air of the ground's density the airlight rises to that of the horizon as transmittance falls
        path = skyfit.Uniform().path(atmosphere, scene, jnp.array([distance]))
        endless = skyfit.Uniform().path(atmosphere, scene, jnp.array([1e8]))
        return float(1.0 - path.inscatter[0, 0] / endless.inscatter[0, 0])

    found = brentq(lambda d: contrast(d) - 0.02, 1e3, 1e5, xtol=1e-3)
    assert float(meteorological_range(4.0)) == pytest.approx(found, rel=1e-6)


@pytest.mark.parametrize(
    "turbidity, tolerance", [(1.0, 0.07), (2.0, 0.07), (3.0, 0.42), (4.0, 0.63), (8.0, 0.80), (10.0, 0.75)]
)
def test_the_range_is_near_figure_3_for_clear_air_and_too_long_in_haze(turbidity, tolerance):
    """SLIB's author put a curve through Fig. 3; its thick haze lies lower than 1200 m."""
    figure = 1e3 * 2.0 ** (9.0 / 1.55 ** math.log2(turbidity) - 0.5)
    ratio = float(meteorological_range(turbidity)) / figure
    assert abs(ratio - 1.0) < tolerance
    assert turbidity < 1.5 or ratio > 1.0


def test_turbidity_and_range_are_inverses_with_finite_gradients(x64):
    turbidity = jnp.array([1.0, 1.5, 2.0, 6.0, 50.0])
    np.testing.assert_allclose(turbidity_from_range(meteorological_range(turbidity)), turbidity, rtol=1e-12)
    np.testing.assert_allclose(
        turbidity_from_range(meteorological_range(turbidity, 900.0, 8000.0), 900.0, 8000.0), turbidity, rtol=1e-12
    )
    assert float(turbidity_from_range(1e9)) == 1.0
    far = jnp.array([-1.0, 0.0, 1.0, 1e4, 3.39e5, 1e9, jnp.inf])
    for values in (jax.vmap(turbidity_from_range)(far), jax.vmap(jax.grad(turbidity_from_range))(far[:-1])):
        assert np.all(np.isfinite(values))
    slope = jax.grad(meteorological_range)(3.0)
    central = (meteorological_range(3.0 + 1e-5) - meteorological_range(3.0 - 1e-5)) / 2e-5
    assert float(slope) == pytest.approx(float(central), rel=1e-7)
    np.testing.assert_allclose(jax.jit(jax.vmap(meteorological_range))(turbidity), meteorological_range(turbidity))


def test_range_in_float32_is_near_float64():
    turbidity = np.array([1.0, 2.0, 7.0])
    narrow = meteorological_range(jnp.asarray(turbidity))
    assert narrow.dtype == jnp.float32
    with jax.enable_x64(True):
        np.testing.assert_allclose(narrow, meteorological_range(jnp.asarray(turbidity)), rtol=1e-6)
