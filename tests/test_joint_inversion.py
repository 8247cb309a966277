"""Several times with parameters in common, priors and smoothness, against the same least squares by scipy."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from made_skies import as_sky, by_hand, EXACT, FREE, HAZE, OWN_NOISE, PLAIN, SOLVER

import skyfit
from skyfit.light import extraterrestrial_irradiance
from skyfit.retrieve import start_model, with_values


# noise of each sample alone, as the dense fit has it
SQUARES = replace(OWN_NOISE, loss="squares")
SHARED = ("asymmetry",)
DEPTHS, EXPONENTS, ASYMMETRY = (0.15, 0.3), (1.1, 0.8), 0.65
ANGLES = (0.9, 0.6)
IRRADIANCE = np.asarray(extraterrestrial_irradiance(PLAIN, 6.0), float)


def two_times(depths):
    """Two times; the stated noise is a little larger than the true one, so that nothing is widened."""
    with jax.enable_x64(True):
        rows = [
            by_hand(aerosol_optical_depth=d, angstrom_exponent=e, sun_zenith=s)
            for d, e, s in zip(depths, EXPONENTS, ANGLES, strict=True)
        ]
        # a common factor of the days' distance from the sun has no part in this
        no_day = np.array(["2025-10-05T12:00", "2025-10-05T12:30"], "datetime64[ns]")
        made = as_sky(np.stack(rows), 0.015, seed=30, sun_zenith=ANGLES, time=no_day)
        return replace(made, sigma=made.sigma * (0.02 / 0.015))


@pytest.fixture(scope="module")
def sky():
    return two_times(DEPTHS)


@pytest.fixture(scope="module")
def plain(sky):
    with jax.enable_x64(True):
        return fitted(sky)


def fitted(sky, **changes):
    return skyfit.invert(sky, FREE, SOLVER, shared=SHARED, measurement=SQUARES, **changes)


@eqx.filter_jit
def radiance(depth, exponent, asymmetry, sun_zenith, factor):
    """By the solver alone."""
    aerosol = skyfit.Aerosol(depth, exponent, 0.95, 0.0, skyfit.HenyeyGreenstein(asymmetry))
    atmosphere = eqx.tree_at(lambda a: a.aerosol, skyfit.Atmosphere.from_optical_depth(0.1), aerosol)
    atmosphere = eqx.tree_at(lambda a: a.rayleigh.pressure, atmosphere, jnp.asarray(101325.0))
    scene = skyfit.Scene(sun_zenith, 1.0, skyfit.hemisphere(40), jnp.asarray(PLAIN), factor * IRRADIANCE)
    return SOLVER.radiance(atmosphere, scene)


def by_scipy(sky, scaled=(), factor=1.0):
    """Values and covariance of (depth, exponent) of each time and the shared asymmetry; `scaled`: more residuals."""
    measured, sigma = jnp.asarray(sky.radiance), jnp.asarray(sky.sigma)

    def residual(x):
        rows = [(radiance(x[2 * t], x[2 * t + 1], x[4], ANGLES[t], factor) - measured[t]) / sigma[t] for t in range(2)]
        return jnp.concatenate([*(jnp.ravel(r) for r in rows), *(jnp.reshape(more(x), 1) for more in scaled)])

    value, slope = jax.jit(residual), jax.jit(jax.jacfwd(residual))
    end = scipy.optimize.least_squares(
        lambda x: np.asarray(value(x)), [0.2, 1.0, 0.2, 1.0, 0.6], lambda x: np.asarray(slope(x)),
        bounds=([1e-3, -1, 1e-3, -1, 0.0], [2, 3, 2, 3, 0.95]), x_scale="jac", xtol=1e-12, ftol=1e-14, gtol=1e-12,
    )  # fmt: skip
    return end.x, np.linalg.inv(end.jac.T @ end.jac)


def agree(fit, expected, covariance):
    for t in range(2):
        places = [2 * t, 2 * t + 1, 4]
        np.testing.assert_allclose(fit.values[t], expected[places], rtol=1e-4)
        wanted = covariance[np.ix_(places, places)]
        scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
        np.testing.assert_allclose(fit.covariance[t] / scale, wanted / scale, atol=1e-3)


@pytest.fixture(scope="module")
def factor(sky):
    """The sun's distance of the day, as the fit has it."""
    from skyfit.light import earth_sun_factor
    from skyfit.measured.station import day_of_year

    return float(earth_sun_factor(day_of_year(sky.time[0])))


def test_a_joint_fit_is_the_dense_one(x64, sky, plain, factor):
    assert plain.result == ("successful", "successful") and np.all(plain.scale == 1.0)
    assert plain.values[0, 2] == plain.values[1, 2]
    assert plain.sigma[0, 2] == pytest.approx(plain.sigma[1, 2], rel=1e-9)
    agree(plain, *by_scipy(sky, factor=factor))
    # three parameters of the data's own at each time, one of them in common
    np.testing.assert_allclose(plain.degrees_of_freedom, 3.0, rtol=1e-6)
    truth = np.array([(d, e, ASYMMETRY) for d, e in zip(DEPTHS, EXPONENTS, strict=True)])
    np.testing.assert_allclose(plain.values[:, 2] / ASYMMETRY, truth[:, 2] / ASYMMETRY, atol=0.02)


def test_a_prior_is_one_more_residual(x64, sky, plain, factor):
    """Of a positive parameter on its logarithm."""
    priors = {"aerosol_optical_depth": (0.2, 0.02), "asymmetry": (0.65, 0.0003)}
    extra = [lambda x, t=t: (jnp.log(x[2 * t]) - np.log(0.2)) * (0.2 / 0.02) for t in range(2)]
    extra.append(lambda x: (x[4] - 0.65) / 0.0003)
    fit = fitted(sky, priors=priors)
    agree(fit, *by_scipy(sky, extra, factor))
    assert np.all(fit.degrees_of_freedom < 2.7) and fit.priors == priors
    tight = fitted(sky, priors={"asymmetry": (0.65, 1e-6)})
    np.testing.assert_allclose(tight.degrees_of_freedom, 2.0, atol=1e-4)
    assert "asymmetry is known from its prior more than from these data" in tight.undetermined[0]
    assert not any("prior" in text for text in plain.undetermined[0])


def test_smoothness_is_a_residual_between_neighbours_with_both_limits(x64, sky, plain, factor):
    sigma = 0.02
    apart = [lambda x: (jnp.log(x[2]) - jnp.log(x[0])) / (sigma * np.sqrt(0.5))]
    agree(fitted(sky, smooth={"aerosol_optical_depth": sigma}), *by_scipy(sky, apart, factor))
    loose = fitted(sky, smooth={"aerosol_optical_depth": 1e4})
    np.testing.assert_allclose(loose.values, plain.values, rtol=1e-6)
    np.testing.assert_allclose(loose.sigma, plain.sigma, rtol=1e-6)
    # where the two depths are one, stiff steps are a shared parameter
    stiff, shared = stiff_and_shared(two_times((0.2, 0.2)))
    assert np.all(shared.scale == 1.0) and np.all(stiff.scale == 1.0)
    assert np.all(np.abs(stiff.values - shared.values) < 0.05 * shared.sigma)
    np.testing.assert_allclose(stiff.sigma, shared.sigma, rtol=0.01)
    # where they are two, one depth suits neither time, and their weights are those of where each first search ended
    stiff, shared = stiff_and_shared(sky)
    assert shared.scale.max() > 5.0 and shared.result[1] == stiff.result[1] == "poor_fit"
    np.testing.assert_allclose(stiff.scale, shared.scale, rtol=0.01)
    assert np.all(np.abs(stiff.values - shared.values) < 0.25 * shared.sigma)


def stiff_and_shared(sky):
    """A fit whose two depths hardly may differ, and one with a single depth."""
    stiff = fitted(sky, smooth={"aerosol_optical_depth": 1e-5})
    assert stiff.values[0, 0] == pytest.approx(stiff.values[1, 0], rel=1e-4)
    both = ("aerosol_optical_depth", *SHARED)
    return stiff, skyfit.invert(sky, FREE, SOLVER, shared=both, measurement=SQUARES)


def test_gain_is_what_a_sample_moves(x64, sky, plain):
    for t, d, w in ((0, 3, 2), (1, 20, 10), (0, 35, 7)):
        step = 10.0 * sky.sigma[t, d, w]
        ends = []
        for sign in (1.0, -1.0):
            moved = sky.radiance.copy()
            moved[t, d, w] += sign * step
            ends.append(fitted(replace(sky, radiance=moved)).values[t])
        expected = (ends[0] - ends[1]) / (2.0 * step)
        off = np.abs(plain.gain[t, :, d, w] - expected) / np.max(np.abs(plain.gain[t]), axis=(1, 2))
        assert np.all(off < 0.02), (off, plain.gain[t, :, d, w] / expected)


def test_names_that_cannot_be_shared_smooth_or_known_before_and_no_steps(sky):
    for changes, said in (
        ({"shared": ("ozone",)}, "`shared` must name free parameters.*'ozone'"),
        ({"shared": SHARED, "smooth": {"asymmetry": 0.1}}, "`smooth` must name free .* not shared, got 'asymmetry'"),
        ({"smooth": {"aerosol_optical_depth": 0.0}}, "`smooth` of aerosol_optical_depth must be a positive"),
        ({"priors": {"ozone": (300.0, 10.0)}}, "`priors` must name free parameters.*'ozone'"),
        ({"max_steps": 0}, "`max_steps` must be 1 or more, got 0"),
        ({"priors": {"asymmetry": (2.0, 0.1)}}, r"`priors` of asymmetry must be a value in \[0, 0.95\]"),
        ({"priors": {"asymmetry": (0.6, -0.1)}}, "`priors` of asymmetry.*positive sigma"),
    ):
        with pytest.raises(ValueError, match=said) as caught:
            skyfit.invert(sky, FREE, SOLVER, measurement=SQUARES, **changes)
        assert "\n" not in str(caught.value)
    turned = replace(sky, time=sky.time[::-1])
    with pytest.raises(ValueError, match="`smooth` needs the times of the sky, increasing"):
        fitted(turned, smooth={"aerosol_optical_depth": 0.1})


LOBES = ("aerosol_optical_depth", "asymmetry", "asymmetry_second", "forward_fraction", "aerosol_scale_height")


def test_lobes_stand_in_order_whichever_the_search_found_and_haze_height_is_not_determined(x64):
    """A thin haze: what a sky tells of its height is less than the noise."""
    phase = skyfit.TwoTermHenyeyGreenstein(0.8, 0.3, 0.6)
    sky = as_sky(by_hand(phase=phase, aerosol_optical_depth=0.01, angstrom_exponent=1.3), 0.06, seed=31)
    fits = []
    for lobes in ((0.7, 0.2, 0.5), (0.2, 0.7, 0.5)):
        start = with_values(start_model(LOBES, 101325.0), LOBES[1:4], np.array(lobes))
        fits.append(skyfit.invert(sky, LOBES, SOLVER, start, measurement=EXACT, guess=False))
    there, back = fits
    for fit in fits:
        assert fit.result == ("successful",)
        assert fit.values[0, 1] > fit.values[0, 2]
        assert np.all(np.abs(fit.values[0, :4] - [0.01, 0.8, 0.3, 0.6]) < 4.0 * fit.sigma[0, :4])
        assert "aerosol_scale_height is not determined by these data" in fit.undetermined[0]
        assert fit.determined[0].tolist() == [True, True, True, True, False]
    # each search ends within a fiftieth of sigma of the best
    assert np.all(np.abs(back.values[0, :4] - there.values[0, :4]) < 0.04 * there.sigma[0, :4])
    np.testing.assert_allclose(back.sigma[0, :4], there.sigma[0, :4], rtol=2e-2)
    np.testing.assert_allclose(back.correlation[0, :4, :4], there.correlation[0, :4, :4], atol=2e-2)
    ratio = back.gain[0, 3] / np.max(np.abs(there.gain[0, 3])) - there.gain[0, 3] / np.max(np.abs(there.gain[0, 3]))
    assert np.max(np.abs(ratio)) < 0.05


def test_several_starts_end_at_the_best(x64):
    sky = as_sky(by_hand(), 0.005, seed=32)
    bad = with_values(start_model(FREE, 101325.0), FREE, np.array([4.5, 3.3, 0.02]))
    one = skyfit.invert(sky, FREE, SOLVER, measurement=EXACT)
    several = skyfit.invert(sky, FREE, SOLVER, bad, measurement=EXACT, guess=False, starts=4)
    assert several.result == ("successful",)
    assert several.cost[0] <= one.cost[0] * 1.0001
    assert np.all(np.abs(several.values[0] - one.values[0]) < 0.05 * one.sigma[0])
    assert np.all(np.abs(one.values[0] - list(HAZE.values())) < 4.0 * one.sigma[0])
