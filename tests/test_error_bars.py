"""Error bars hold the truth as often as they say: many skies of each kind, and one posterior by sampling."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from made_skies import as_sky, by_hand, FREE, HAZE, OWN_NOISE, SOLVER

import skyfit
from skyfit.retrieve import retrieve, with_values
from skyfit.retrieve.forward import observe
from skyfit.retrieve.model_error import error_shapes
from skyfit.retrieve.prepared import first_points, prepared
from skyfit.scene import angle_between


NM = np.arange(400.0, 681.0, 40.0)
TRUTH = np.array(list(HAZE.values()))
NOISE, MODEL_ERROR, CALIBRATION = 0.02, 0.005, 0.01


@pytest.fixture(params=[150, pytest.param(1000, marks=pytest.mark.slow)], ids="{} skies".format)
def seeds(request):
    return request.param


@pytest.fixture(scope="module")
def clean():
    with jax.enable_x64(True):
        return by_hand(directions=24, wavelength_nm=NM)


def question(clean, **changes):
    """Noise is each sample's alone, and known to be: sizes that are estimated cover more (`error_bars.json`)."""
    none = dict.fromkeys(("level", "colour", "pointing", "broad_level", "broad_colour"), 0.0)
    sky = as_sky(clean, NOISE, wavelength_nm=NM, time=np.array(["NaT"], "datetime64[ns]"))
    return prepared(sky, FREE, SOLVER, measurement=skyfit.NoiseModel(model_error=MODEL_ERROR, **none | changes))


@eqx.filter_jit
def every(skies, problem, model, names, options):
    def one(measured):
        found = retrieve(eqx.tree_at(lambda p: p.measured, problem, measured[None]), model, names, **options)
        variances = (jnp.diagonal(v[0]) for v in (found.noise, found.model))
        return found.values[0] - TRUTH, *variances, found.finite, found.calibration, found.calibration_sigma

    return jax.lax.map(one, skies)


def estimates(asked, skies):
    """Deviations from the truth, variances by noise and by the model's error, and whether all went well, by sky."""
    options = asked.options() | {"priors": asked.rows, "start": first_points(asked, np.arange(1))}
    found = every(jnp.asarray(skies), asked.problem, asked.start, asked.names, options)
    return [np.asarray(part) for part in found]


def holds(deviation, sigma):
    """The shares within a sigma and within 1.96 are what a normal distribution has, as closely as so many skies tell.

    Of a thousand: 64-72 and 93-97 %. Of fewer: the binomial bounds that luck leaves once in a thousand tests.
    """
    count, parameters = deviation.shape
    within = [np.sum(np.abs(deviation) < width * sigma, axis=0) for width in (1.0, 1.96)]
    bounds = (0.64 * count, 0.72 * count), (0.93 * count, 0.97 * count)
    if count < 1000:
        shares = (2.0 * scipy.stats.norm.cdf(width) - 1.0 for width in (1.0, 1.96))
        bounds = [scipy.stats.binom.interval(1.0 - 1e-3 / parameters, count, share) for share in shares]
    for found, (low, high) in zip(within, bounds, strict=True):
        assert np.all((found >= low) & (found <= high)), found / count


def noisy(skies, clean, seed, seeds):
    return skies + NOISE * clean * np.random.default_rng(seed).standard_normal((seeds, *clean.shape))


def test_skies_with_noise(x64, clean, seeds):
    asked = question(clean)
    np.testing.assert_allclose(asked.problem.measured[0], clean, rtol=1e-12)
    deviation, noise, _, finite, *_ = estimates(asked, noisy(clean, clean, 50, seeds))
    assert finite.all()
    holds(deviation, np.sqrt(noise))
    # the mean of a thousand is known to 0.03
    assert np.all(np.abs(np.mean(deviation / np.sqrt(noise), axis=0)) < 0.1 * np.sqrt(1000 / seeds))


def test_skies_that_the_model_cannot_make(x64, clean, seeds):
    """Their smooth errors are drawn with the size that is stated; the error bars of noise alone do not hold."""
    view = skyfit.hemisphere(24)
    airmass = 1.0 / jnp.cos(view.zenith)
    cosine = jnp.cos(angle_between(view.zenith, 0.9, view.azimuth - 1.0))
    shapes = np.asarray(error_shapes(airmass, cosine, jnp.asarray(NM)))
    size = MODEL_ERROR * np.random.default_rng(51).standard_normal((seeds, len(shapes)))
    skies = clean * (1.0 + np.einsum("ek,kdw->edw", size, shapes))
    deviation, noise, model, finite, *_ = estimates(question(clean), noisy(skies, clean, 52, seeds))
    assert finite.all()
    holds(deviation, np.sqrt(noise + model))
    # by much more than chance for what the errors of the model move most
    assert np.min(np.mean(np.abs(deviation) < np.sqrt(noise), axis=0)) < 0.6


def test_skies_of_instruments_that_are_off(x64, clean, seeds):
    """Each wavelength's scale is drawn from the prior with which it is fitted."""
    scale = 1.0 + CALIBRATION * np.random.default_rng(53).standard_normal((seeds, 1, NM.size))
    fitted = estimates(question(clean, calibration=CALIBRATION), noisy(clean * scale, clean, 54, seeds))
    deviation, noise, _, finite, calibration, sigma = fitted
    assert finite.all()
    holds(deviation, np.sqrt(noise))
    holds(calibration - scale[:, 0], sigma)


def test_the_posterior_of_one_sky_by_sampling(x64, clean):
    """No-U-turn sampling of the likelihood itself, flat in the parameters, against values and sigmas of the fit."""
    blackjax = pytest.importorskip("blackjax")
    sky = as_sky(clean, NOISE, 55, wavelength_nm=NM, time=np.array(["NaT"], "datetime64[ns]"))
    measurement = replace(OWN_NOISE, loss="squares")
    asked = prepared(sky, FREE, SOLVER, measurement=measurement)
    fit = skyfit.invert(sky, FREE, SOLVER, measurement=measurement)
    centre, size = jnp.asarray(fit.values[0]), jnp.asarray(fit.sigma[0] / fit.scale[0])
    one = asked.problem.at(0)

    def log_density(place):
        model = with_values(asked.start, FREE, centre + size * place)
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
