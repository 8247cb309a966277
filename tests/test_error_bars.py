"""Error bars hold the truth as often as they say: a thousand skies of each kind, and one posterior by sampling."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from made_skies import as_sky, by_hand, FREE, HAZE, SOLVER

import skyfit
from skyfit.retrieve import with_values
from skyfit.retrieve.estimate import estimate
from skyfit.retrieve.forward import observe
from skyfit.retrieve.invert import Plan
from skyfit.retrieve.model_error import error_shapes
from skyfit.scene import angle_between


SEEDS = 1000
NM = np.arange(400.0, 681.0, 40.0)
TRUTH = np.array(list(HAZE.values()))
NOISE, MODEL_ERROR, CALIBRATION = 0.02, 0.005, 0.01


@pytest.fixture(scope="module")
def clean():
    with jax.enable_x64(True):
        return by_hand(directions=24, wavelength_nm=NM)


def plan_of(clean, **changes):
    sky = as_sky(clean, NOISE, wavelength_nm=NM, time=np.array(["NaT"], "datetime64[ns]"))
    return Plan(sky, FREE, SOLVER, measurement=skyfit.Measurement(model_error=MODEL_ERROR, **changes))


def estimates(plan, skies):
    """Deviations from the truth, variances by noise and by the model's error, and whether all went well, by sky."""
    start = plan.first_points(np.arange(1))

    @jax.jit
    def every(skies):
        def one(measured):
            problem = eqx.tree_at(lambda p: p.measured, plan.problem, measured[None])
            found = estimate(plan.setup, plan.solvers, plan.fixed, problem, plan.prior_rows, start)
            variances = (jnp.diagonal(v[0]) for v in (found.noise, found.model))
            return found.values[0] - TRUTH, *variances, found.finite, found.calibration, found.calibration_sigma

        return jax.lax.map(one, skies)

    return [np.asarray(part) for part in every(jnp.asarray(skies))]


def holds(deviation, sigma):
    within = [np.mean(np.abs(deviation) < width * sigma, axis=0) for width in (1.0, 1.96)]
    assert np.all((within[0] >= 0.64) & (within[0] <= 0.72)), within
    assert np.all((within[1] >= 0.93) & (within[1] <= 0.97)), within


def noisy(skies, clean, seed):
    return skies + NOISE * clean * np.random.default_rng(seed).standard_normal((SEEDS, *clean.shape))


@pytest.fixture(scope="module")
def plain(clean):
    with jax.enable_x64(True):
        plan = plan_of(clean)
        return plan, partial(estimates, plan)


def test_a_thousand_skies_with_noise(x64, clean, plain):
    plan, fitted = plain
    np.testing.assert_allclose(plan.problem.measured[0], clean, rtol=1e-12)
    deviation, noise, _, finite, *_ = fitted(noisy(clean, clean, 50))
    assert finite.all()
    holds(deviation, np.sqrt(noise))
    assert np.all(np.abs(np.mean(deviation / np.sqrt(noise), axis=0)) < 0.1)


def test_a_thousand_skies_that_the_model_cannot_make(x64, clean, plain):
    """Their smooth errors are drawn with the size that is stated; the error bars of noise alone do not hold."""
    view = skyfit.hemisphere(24)
    airmass = 1.0 / jnp.cos(view.zenith)
    cosine = jnp.cos(angle_between(view.zenith, 0.9, view.azimuth - 1.0))
    shapes = np.asarray(error_shapes(airmass, cosine, jnp.asarray(NM)))
    size = MODEL_ERROR * np.random.default_rng(51).standard_normal((SEEDS, len(shapes)))
    skies = clean * (1.0 + np.einsum("ek,kdw->edw", size, shapes))
    deviation, noise, model, finite, *_ = plain[1](noisy(skies, clean, 52))
    assert finite.all()
    holds(deviation, np.sqrt(noise + model))
    # by much more than chance for what the errors of the model move most
    assert np.min(np.mean(np.abs(deviation) < np.sqrt(noise), axis=0)) < 0.6


def test_a_thousand_skies_of_instruments_that_are_off(x64, clean):
    """Each wavelength's scale is drawn from the prior with which it is fitted."""
    scale = 1.0 + CALIBRATION * np.random.default_rng(53).standard_normal((SEEDS, 1, NM.size))
    fitted = estimates(plan_of(clean, calibration=CALIBRATION), noisy(clean * scale, clean, 54))
    deviation, noise, _, finite, calibration, sigma = fitted
    assert finite.all()
    holds(deviation, np.sqrt(noise))
    holds(calibration - scale[:, 0], sigma)


def test_the_posterior_of_one_sky_by_sampling(x64, clean):
    """No-U-turn sampling of the likelihood itself, flat in the parameters, against values and sigmas of the fit."""
    blackjax = pytest.importorskip("blackjax")
    sky = as_sky(clean, NOISE, 55, wavelength_nm=NM, time=np.array(["NaT"], "datetime64[ns]"))
    measurement = skyfit.Measurement(model_error=0.0, loss="squares")
    plan = Plan(sky, FREE, SOLVER, measurement=measurement)
    fit = skyfit.invert(sky, FREE, SOLVER, measurement=measurement)
    centre, size = jnp.asarray(fit.values[0]), jnp.asarray(fit.sigma[0] / fit.scale[0])
    one = plan.problem.at(0)

    def log_density(place):
        model = with_values(plan.fixed, FREE, centre + size * place)
        return -0.5 * jnp.sum(((observe(SOLVER, model, one)[0] - one.measured) * one.weight) ** 2)

    correlation = jnp.asarray(fit.correlation[0])
    sampler = blackjax.nuts(log_density, step_size=0.9, inverse_mass_matrix=correlation)

    @jax.jit
    def chain(key):
        def step(state, key):
            state, told = sampler.step(key, state)
            return state, (state.position, told.is_divergent)

        first = sampler.init(jnp.zeros(3))
        return jax.lax.scan(step, first, jax.random.split(key, 2200))[1]

    places, divergent = chain(jax.random.key(56))
    places = np.asarray(places)[200:]
    assert not divergent.any()
    # of 2000 nearly independent draws the mean is known to 0.03 and the spread to 3 %
    np.testing.assert_allclose(places.mean(axis=0), 0.0, atol=0.08)
    np.testing.assert_allclose(places.std(axis=0), 1.0, rtol=0.06)
    np.testing.assert_allclose(np.corrcoef(places.T), fit.correlation[0], atol=0.08)
