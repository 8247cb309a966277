"""Many Perez fits at once: against scipy, known coefficients, unusable skies, derivatives, lanes."""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares
from skies import SINGLE

import skyfit
from skyfit.analytic import fit_perez, Preetham
from skyfit.analytic.perez_fits import CLEAR_SKY
from skyfit.numerics import as_float
from skyfit.scene import angle_between, hemisphere


COLOUR = (-0.3, -0.2, 0.2, -1.1, 0.03)
DOME = hemisphere(120)
ZENITH, AZIMUTH = np.append(DOME.zenith, 0.0), np.append(DOME.azimuth, 0.0)
WEIGHT = np.where(ZENITH <= np.radians(85.0), 20.0, 0.0)
SLANT = 1.0 / np.maximum(np.cos(ZENITH), 0.01) - 1.0
# light, zenith's light, view zenith, angle from the sun, sun, weight: what the tests differentiate by
LIGHT, AT_ZENITH, THETA, GAMMA, SUN, WEIGHTS = range(6)


class Fits(NamedTuple):
    """As `PerezFits`, on the host."""

    coefficients: np.ndarray
    cost: np.ndarray
    steps: np.ndarray
    converged: np.ndarray


def angles(sun):
    """Angles from the sun, `[sky, direction]`."""
    return np.asarray(angle_between(as_float(ZENITH)[None], as_float(sun)[:, None], as_float(AZIMUTH)[None]))


def given(light, sun):
    """The arguments of a fit in the process's precision."""
    light = np.asarray(light)
    return tuple(as_float(v) for v in (light, light[:, -1], ZENITH, angles(sun), sun, WEIGHT))


# a program for each shape, dtype and setting serves many tests
@partial(jax.jit, static_argnames=("start", "max_steps"))
def compiled(arguments, start, max_steps):
    return fit_perez(*arguments, start=start, max_steps=max_steps)


def fit(arguments, start=CLEAR_SKY, max_steps=100) -> Fits:
    return Fits(*map(np.asarray, compiled(arguments, start, max_steps)))


def ratio(coefficients, gamma, sun):
    """Perez 1993 eq. 1 in units of the zenith, written out again."""
    a, b, c, d, e = np.asarray(coefficients, float)

    def form(secant, gamma):
        return (1 + a * np.exp(b * secant)) * (1 + c * np.exp(d * gamma) + e * np.cos(gamma) ** 2)

    return form(SLANT + 1.0, gamma) / form(1.0, sun)


def published(turbidity, quantity, sun):
    """The sky's light of one quantity of Preetham's model and its coefficients; the zenith's is 1."""
    coefficients = np.asarray(Preetham.published().perez(turbidity, 0.0)[quantity].coefficients, float)
    gamma = angles(sun)
    return np.stack([ratio(coefficients, g, s) for g, s in zip(gamma, sun, strict=True)]), coefficients


def scipy_fit(light, gamma, sun, start, at_zenith=None, weight=WEIGHT, slant=SLANT, **options):
    """Unknowns and cost by MINPACK, in the unknowns of the docstring with their Jacobian by hand."""
    share = weight * (light[-1] if at_zenith is None else at_zenith) / light
    square = np.cos(gamma) ** 2 - np.cos(sun) ** 2

    def both(u):
        b, d, rise = -np.exp(u[1]), -np.exp(u[3]), 1 - np.exp(-u[0])
        steep, here, there = np.exp(b * slant), np.exp(d * gamma), np.exp(d * sun)
        first, second = 1 + rise * (steep - 1), 1 + u[2] * (here - there) + u[4] * square
        columns = [
            second * (steep - 1) * (1 - rise), second * rise * steep * slant * b, first * (here - there),
            first * u[2] * d * (here * gamma - there * sun), first * square,
        ]  # fmt: skip
        return share * first * second - weight, share[:, None] * np.stack(columns, axis=1)

    with np.errstate(over="ignore", invalid="ignore"):
        found = least_squares(lambda u: both(u)[0], start, lambda u: both(u)[1], method="lm", **options)
    return found.x, 2.0 * found.cost


def unknowns(coefficients, sun):
    a, b, c, d, e = np.asarray(coefficients, float)
    at_zenith = 1 + c * np.exp(d * sun) + e * np.cos(sun) ** 2
    return np.array([np.log1p(a * np.exp(b)), np.log(-b), c / at_zenith, np.log(-d), e / at_zenith])


def coefficients_of(u, sun):
    rest = 1 - u[2] * np.exp(-np.exp(u[3]) * sun) - u[4] * np.cos(sun) ** 2
    return np.array([np.expm1(u[0]) * np.exp(np.exp(u[1])), -np.exp(u[1]), u[2] / rest, -np.exp(u[3]), u[4] / rest])


@pytest.fixture(scope="module")
def simulated():
    """Light of 40 single-scattering skies at 550 nm and their suns, in float64."""
    turbidity, sun = (m.ravel() for m in np.meshgrid([1.5, 2.0, 2.5, 3.0, 4.0], np.radians(np.linspace(4.0, 81.0, 8))))
    view = skyfit.Directions(ZENITH, AZIMUTH)

    @eqx.filter_jit
    def all_skies(turbidity, sun):
        def one(case):
            scene = skyfit.Scene(case[1], 0.0, view, np.array([550.0]), jnp.ones(1))
            return SINGLE["spherical"].radiance(skyfit.Atmosphere.from_turbidity(case[0]), scene)[:, 0]

        return jax.lax.map(one, (turbidity, sun))

    return np.asarray(all_skies(as_float(turbidity), as_float(sun)), float), sun


@pytest.fixture(params=[False, True], ids=["float32", "float64"])
def double(request):
    with jax.enable_x64(request.param):
        yield request.param


# --- what is found


def test_finds_what_scipy_finds(double, simulated):
    light, sun = simulated
    got = fit(given(light, sun))
    assert got.converged.all() and got.cost.dtype == (np.float64 if double else np.float32)
    gamma = angles(sun).astype(float)
    for i, s in enumerate(sun):
        _, best = scipy_fit(light[i], gamma[i], s, unknowns(CLEAR_SKY, s))
        assert got.cost[i] <= 1.001 * best, (i, s)
        # the cost is that of the coefficients as Perez' formula takes them
        error = WEIGHT * (light[i, -1] * ratio(got.coefficients[i], gamma[i], s) / light[i] - 1.0)
        np.testing.assert_allclose(got.cost[i], np.sum(error**2), rtol=1e-8 if double else 2e-3)
    assert got.steps.mean() < 12.0


@pytest.mark.parametrize("quantity", range(3), ids="Yxy")
def test_recovers_the_published_coefficients(double, quantity):
    sun = np.radians([8.0, 25.0, 40.0, 50.0, 60.0, 70.0, 80.0, 91.0])
    skies = [published(t, quantity, sun) for t in (2.0, 3.0, 4.0, 5.0, 6.0)]
    light = np.concatenate([s[0] for s in skies])
    got = fit(given(light, np.tile(sun, 5)), CLEAR_SKY if quantity == 0 else COLOUR)
    assert got.converged.all() and got.steps.max() <= 12
    expected = np.repeat([s[1] for s in skies], sun.size, axis=0)
    np.testing.assert_allclose(got.coefficients, expected, rtol=1e-8 if double else 1e-3)


def test_sun_at_the_zenith(double):
    """Where horizon and aureole are functions of the same angle."""
    sun = np.zeros(40)
    sun[20:] = np.linspace(0.0, 0.01, 20)
    light, coefficients = published(3.0, 0, sun)
    got = fit(given(light, sun))
    assert got.converged.all()
    np.testing.assert_allclose(got.coefficients, np.tile(coefficients, (40, 1)), rtol=1e-5 if double else 2e-2)


def test_vanishing_zenith(double):
    """F(0, sun) near zero: the coefficients are huge and their ratio is the sky."""
    sun = np.radians(np.linspace(5.0, 20.0, 40))
    c = 1.3
    e = (1.0 - 1e-4 - c * np.exp(-2.0 * sun)) / np.cos(sun) ** 2
    true = [coefficients_of([-1.0, -1.0, c, np.log(2.0), x], s) for x, s in zip(e, sun, strict=True)]
    gamma = angles(sun).astype(float)
    light = np.stack([ratio(t, g, s) for t, g, s in zip(true, gamma, sun, strict=True)])
    got = fit(given(light, sun))
    back = np.stack([ratio(t, g, s) for t, g, s in zip(got.coefficients, gamma, sun, strict=True)])
    assert np.abs(got.coefficients[:, 2]).min() > 1e2
    assert np.abs(back / light - 1.0)[:, WEIGHT > 0.0].max() < (1e-6 if double else 1e-3)


def test_steps_end(simulated):
    whole, short = fit(given(*simulated)), fit(given(*simulated), max_steps=4)
    assert short.steps.max() == 4 and not short.converged[whole.steps > 4].any()
    assert np.all(short.cost >= 0.99 * whole.cost)
    # a chromaticity from the start of a luminance: elsewhere or longer, never endless
    sun = np.linspace(0.1, 1.4, 40)
    assert fit(given(published(3.0, 1, sun)[0], sun)).steps.max() <= 100


# --- what cannot be used


def spoilt(simulated):
    """Six skies that are not usable, among others that are."""
    light, sun = simulated[0].copy(), simulated[1].copy()
    for i, value in enumerate((np.nan, 0.0, -1.0, np.inf, 1e-30)):
        light[3 * i, 7] = value
    arguments = list(given(light, sun))
    arguments[SUN] = arguments[SUN].at[20].set(jnp.nan)
    arguments[GAMMA] = arguments[GAMMA].at[21, 3].set(jnp.nan)
    arguments[AT_ZENITH] = arguments[AT_ZENITH].at[22].set(-1.0).at[23].set(jnp.inf)
    return tuple(arguments), np.array([0, 3, 6, 9, 12, 20, 21, 22, 23])


def test_unusable_skies_come_back_as_the_start(double, simulated):
    arguments, bad = spoilt(simulated)
    got, clean = fit(arguments), fit(given(*simulated))
    good = np.setdiff1d(np.arange(40), bad)
    np.testing.assert_allclose(got.coefficients[bad], np.tile(CLEAR_SKY, (bad.size, 1)), rtol=1e-6)
    assert not got.converged[bad].any() and np.isinf(got.cost[bad]).all()
    assert got.converged[good].all()
    for mine, alone in zip(got, clean, strict=True):
        np.testing.assert_array_equal(mine[good], alone[good])


@pytest.mark.parametrize("place", [THETA, WEIGHTS])
def test_shared_arguments_that_are_not_numbers_spoil_every_sky(simulated, place):
    arguments = list(given(*simulated))
    arguments[place] = arguments[place].at[3].set(jnp.nan)
    got = fit(tuple(arguments))
    assert not got.converged.any() and np.all(got.coefficients == np.float32(CLEAR_SKY))


@pytest.mark.parametrize("value", [np.nan, 0.0, -3.0, 1e-30])
def test_directions_without_weight_are_not_looked_at(simulated, value):
    arguments, unseen = list(given(*simulated)), jnp.asarray(WEIGHT == 0.0)
    arguments[LIGHT] = jnp.where(unseen[None], value, arguments[LIGHT])
    if np.isnan(value):
        arguments[THETA] = jnp.where(unseen, value, arguments[THETA])
        arguments[GAMMA] = jnp.where(unseen[None], value, arguments[GAMMA])
    for mine, clean in zip(fit(tuple(arguments)), fit(given(*simulated)), strict=True):
        np.testing.assert_array_equal(mine, clean)


def test_without_any_weight_the_start_stays(simulated):
    arguments = list(given(*simulated))
    arguments[WEIGHTS] = 0.0 * arguments[WEIGHTS]
    got = fit(tuple(arguments))
    np.testing.assert_allclose(got.coefficients, np.tile(CLEAR_SKY, (40, 1)), rtol=1e-5)
    assert np.all(got.cost == 0.0)


@pytest.mark.parametrize("change", [{1: 0.1}, {3: 0.0}, {0: -2.0}, {2: float("nan")}], ids=str)
def test_bad_starts(simulated, change):
    start = tuple(change.get(k, value) for k, value in enumerate(CLEAR_SKY))
    with pytest.raises(ValueError, match="`start` must be finite with B < 0, D < 0"):
        fit_perez(*given(*simulated), start=start)


def test_no_sky():
    with pytest.raises(ValueError, match="`light` must hold at least one sky"):
        fit_perez(*given(np.ones((0, ZENITH.size)), np.ones(0)))


# --- many at once


@pytest.mark.parametrize("count", [1, 300])
def test_neighbours_and_place_do_not_matter(simulated, count):
    """One, more than the lanes: each sky is fitted as in the batch of 40, wherever it stands."""
    light, sun = simulated
    chosen = np.random.default_rng(count).integers(0, sun.size, count)
    clean, got = fit(given(light, sun)), fit(given(light[chosen], sun[chosen]))
    assert got.steps.shape == (count,) and got.converged.all()
    # other programs round otherwise
    np.testing.assert_allclose(got.cost, clean.cost[chosen], rtol=1e-4)
    for sky in np.unique(chosen):
        same = got.coefficients[chosen == sky]
        np.testing.assert_array_equal(same, np.broadcast_to(same[0], same.shape))


def test_transforms_and_dtypes(simulated):
    arguments = given(*simulated)
    eager = fit_perez(*arguments)
    inside = fit(arguments)
    np.testing.assert_allclose(eager.cost, inside.cost, rtol=1e-4)
    # skies in pairs: vmap over what depends on the sky
    halves = [v.reshape(2, 20, *v.shape[1:]) if v.shape[0] == 40 else v for v in arguments]
    axes = tuple(0 if v.shape[0] == 2 else None for v in halves)
    mapped = jax.jit(jax.vmap(fit_perez, axes))(*halves)
    np.testing.assert_allclose(np.ravel(mapped.cost), inside.cost, rtol=1e-4)
    np.testing.assert_array_equal(np.ravel(mapped.converged), inside.converged)
    with jax.enable_x64(True):
        single = fit(arguments)
        twice = fit(given(*simulated))
    assert single.coefficients.dtype == np.float32 and twice.coefficients.dtype == np.float64
    np.testing.assert_allclose(single.cost, twice.cost, rtol=1e-4)


# --- derivatives


def directions(arguments, seed=0):
    """Random relative changes of every argument."""
    random = np.random.default_rng(seed)
    return tuple(as_float(random.normal(size=v.shape)) * v for v in arguments)


@jax.jit
def forward(arguments, along):
    return jax.jvp(lambda *a: fit_perez(*a)[:2], arguments, along)[1]


@jax.jit
def backward(arguments, cotangent):
    return jax.vjp(lambda *a: fit_perez(*a)[:2], *arguments)[1](cotangent)


def test_derivatives_are_those_of_fitting_again(x64, simulated):
    """By all arguments at once, of skies that are no Perez skies, against MINPACK's fits of changed data."""
    arguments = given(*simulated)
    along = directions(arguments)
    slope, rise = map(np.asarray, forward(arguments, along))
    found = fit(arguments).coefficients
    step, worst = 1e-5, []
    exact = {"ftol": 1e-15, "xtol": 1e-15, "gtol": 1e-15, "max_nfev": 2000}
    for i in range(0, 40, 3):
        ends = []
        for sign in (step, -step):
            light, at_zenith, theta, gamma, sun, weight = (
                np.asarray(v + sign * d)[i if v.shape[0] == 40 else slice(None)]
                for v, d in zip(arguments, along, strict=True)
            )
            slant = 1.0 / np.maximum(np.cos(theta), 0.01) - 1.0
            begin = unknowns(found[i], float(arguments[SUN][i]))
            u, cost = scipy_fit(light, gamma, sun, begin, at_zenith, weight, slant, **exact)
            ends.append((coefficients_of(u, sun), cost))
        central = (ends[0][0] - ends[1][0]) / (2 * step)
        np.testing.assert_allclose(rise[i], (ends[0][1] - ends[1][1]) / (2 * step), rtol=1e-2)
        worst.append(np.abs(slope[i] - central).max() / np.abs(central).max())
    assert np.median(worst) < 1e-3 and max(worst) < 2e-2, worst


def test_forward_is_reverse(x64, simulated):
    """At one end of one search: two programs end their searches some digits apart."""
    arguments = given(*simulated)
    along = directions(arguments)
    random = np.random.default_rng(1)
    cotangent = tuple(as_float(random.normal(size=t.shape)) / np.abs(t).max() for t in forward(arguments, along))

    @jax.jit
    def both(arguments, along, cotangent):
        _, linear = jax.linearize(lambda *a: fit_perez(*a)[:2], *arguments)
        return linear(*along), jax.linear_transpose(linear, *arguments)(cotangent)

    tangent, gradient = both(arguments, along, cotangent)
    one = sum(float(jnp.vdot(c, t)) for c, t in zip(cotangent, tangent, strict=True))
    other = sum(float(jnp.vdot(g, d)) for g, d in zip(gradient, along, strict=True))
    assert one == pytest.approx(other, rel=1e-9)


def test_gradients_are_finite_whatever_the_sky(double, simulated):
    arguments, bad = spoilt(simulated)
    arguments = tuple(v.at[1].set(0.0) if k == SUN else v for k, v in enumerate(arguments))
    gradient = backward(arguments, (jnp.ones((40, 5)), jnp.ones(40)))
    assert all(np.isfinite(g).all() for g in gradient)
    for k in (LIGHT, AT_ZENITH, GAMMA, SUN):
        assert np.all(np.asarray(gradient[k])[bad] == 0.0)


def test_single_precision_derivatives_are_near(simulated):
    results = []
    for double in (False, True):
        with jax.enable_x64(double):
            arguments = given(*simulated)
            results.append(np.asarray(forward(arguments, directions(arguments))[0]))
    error = np.abs(results[0] - results[1]).max(axis=1) / np.abs(results[1]).max(axis=1)
    assert np.median(error) < 1e-3 and error.max() < 0.1
