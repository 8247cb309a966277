"""Degrees of polarisation as samples: read, written, fitted, and refused where the model has none."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from made_skies import as_sky, OWN_NOISE, PLAIN, SOLVER
from vector_skies import air_once, polarised_by_air, scattered_once

import skyfit
from skyfit.atmosphere import Exponential, Ground, Ozone, Prescribed, Rayleigh, RayleighPhase
from skyfit.light import extraterrestrial_irradiance
from skyfit.retrieve import SkyModel, with_values
from skyfit.retrieve.forward import observe, Problem


FREE = "aerosol_optical_depth", "haze_polarisation"
VIEW = skyfit.hemisphere(40)


def atmosphere(depth=0.2, polarisation=0.6) -> skyfit.Atmosphere:
    haze = skyfit.Aerosol(depth, phase=skyfit.HenyeyGreenstein(0.65, polarisation=polarisation))
    return skyfit.Atmosphere(Rayleigh(), haze, Ozone(), Ground())


@pytest.fixture(scope="module")
def sky() -> skyfit.Sky:
    """Of light scattered once, with noise of 1 % and of 0.005 in the degree."""
    sun = np.asarray(extraterrestrial_irradiance(PLAIN, 6.0), float)
    light = SOLVER.stokes(atmosphere(), skyfit.Scene(0.9, 1.0, VIEW, PLAIN, sun))
    random = np.random.default_rng(4)
    degree = np.asarray(light.degree, float)
    degree = np.clip(degree + 0.005 * random.standard_normal(degree.shape), 0.0, 1.0)
    made = as_sky(np.asarray(light.radiance, float), noise=0.01, seed=5)
    return replace(
        made, degree_of_polarisation=degree[None], degree_of_polarisation_sigma=np.full((1, *degree.shape), 0.005)
    )


@pytest.mark.parametrize("suffix", [".nc", ".csv"])
def test_degrees_come_back_from_a_file(sky, suffix, tmp_path):
    degree = sky.degree_of_polarisation.copy()
    degree[0, 3, 2] = np.nan
    skyfit.write_sky(replace(sky, degree_of_polarisation=degree), tmp_path / f"sky{suffix}")
    back = skyfit.read(tmp_path / f"sky{suffix}")
    np.testing.assert_allclose(back.degree_of_polarisation, degree, rtol=1e-12)
    np.testing.assert_allclose(back.degree_of_polarisation_sigma, sky.degree_of_polarisation_sigma, rtol=1e-12)
    assert not any("not used" in note for note in back.notes)
    some = back.at_times([0]).select(np.array([410.0]))
    assert some.degree_of_polarisation.shape == (1, 40, 1)
    with pytest.raises(ValueError, match="`degree_of_polarisation` must be in"):
        replace(sky, degree_of_polarisation=degree + 1.0)


def test_degrees_read_are_those_of_a_closed_form_and_their_slopes_are_finite(x64):
    """Of air scattering once in a flat layer, by `scattered_once`, which skyfit did not write; neutral points too."""
    depth = np.array([0.05, 0.2])
    air = skyfit.Atmosphere(Prescribed(depth, Exponential(8000.0), RayleighPhase(0.0)), None, None, Ground(0.0))
    zenith, azimuth = np.radians([0.0, 30.0, 60.0, 75.0, 50.0]), np.radians([0.0, 40.0, 120.0, 180.0, 0.0])
    one = Problem(
        *(jnp.asarray(v)[None] for v in (np.radians(50.0), 0.0, zenith, azimuth, np.ones(2), np.array([450.0, 550.0]))),
        jnp.zeros((1, 5, 2)), jnp.ones((1, 5, 2)), beside=jnp.zeros((1, 10)), beside_weight=jnp.ones((1, 10)),
        has_degree=True,
    ).at(0)  # fmt: skip
    found = observe(skyfit.SingleScattering(64, "flat"), SkyModel(air), one).beside.reshape(5, 2)
    expected = np.stack(
        [
            np.hypot(*light[1:]) / light[0]
            for d in depth
            for light in [scattered_once(50.0, np.degrees(zenith), np.degrees(azimuth), d, air_once, polarised_by_air)]
        ],
        axis=1,
    )
    np.testing.assert_allclose(found, expected, atol=1e-9)
    # toward the sun nothing is polarised
    assert found[4] == pytest.approx(0.0, abs=1e-12)

    def degrees(values):
        model = with_values(SkyModel(atmosphere()), FREE, values)
        return observe(SOLVER, model, one).degree

    slope = jax.jit(jax.jacfwd(degrees))(jnp.array([0.2, 0.6]))
    assert np.all(np.isfinite(slope)) and np.abs(slope[2]).min() > 0.0


def test_degrees_determine_what_the_radiance_does_not(x64, sky):
    start = SkyModel(atmosphere(0.3, 0.3))
    settings = {"solver": SOLVER, "start": start, "measurement": OWN_NOISE, "guess": False}
    fit = skyfit.invert(sky, FREE, **settings)
    assert fit.result == ("successful",) and fit.determined.all()
    assert np.all(np.abs(fit.values[0] - [0.2, 0.6]) < 3.0 * fit.sigma[0])
    said = next(note for note in fit.notes if note.startswith("degree of polarisation: model minus measurement"))
    assert 0.9 < float(said.split()[-5]) < 1.1
    with pytest.raises(ValueError, match="`solver` must be polarised for degrees of polarisation"):
        skyfit.invert(sky, FREE, **(settings | {"solver": skyfit.OrdersOfScattering.draft()}))
    with pytest.raises(ValueError, match="`field_of_view` must be 0 with degrees of polarisation"):
        skyfit.invert(sky, FREE, **(settings | {"measurement": replace(OWN_NOISE, field_of_view=0.1)}))
