"""The kinds of error: whitening against dense covariances, and the sizes that many simulated residuals show."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
import scipy.stats

import skyfit
from skyfit.retrieve import components
from skyfit.retrieve.components import Components, Expected
from skyfit.retrieve.forward import Problem
from skyfit.retrieve.loss import typical_size


DIRECTIONS, CHANNELS = 60, 12
NM = np.linspace(400.0, 900.0, CHANNELS)


def free(strength=1.0):
    return Expected(
        jnp.array([1e-3, 1e-3, 1e-4, 0.0, 0.0]), jnp.array([*[strength] * 3, jnp.inf, jnp.inf]), jnp.array(0.1)
    )


def errors(moves=False, seed=0):
    """Of a sky whose slopes are larger in some directions, as near a sun."""
    view, random = skyfit.hemisphere(DIRECTIONS), np.random.default_rng(seed)
    shape = DIRECTIONS, CHANNELS
    light = np.exp(0.3 * random.standard_normal(shape))
    weight = np.where(random.uniform(size=shape) > 0.1, 1.0 / (0.01 * light), 0.0)
    steep = 3.0 * random.standard_normal((DIRECTIONS, 1, 2)) * np.linspace(0.3, 1.7, CHANNELS)[:, None]
    views = (jnp.broadcast_to(v[:, None], shape) if moves else v for v in (view.zenith, view.azimuth))
    given = jnp.array(0.9), jnp.array(0.0), *views, jnp.ones(CHANNELS), NM, light, weight
    one = Problem(*(jnp.asarray(part)[None] for part in given)).at(0)
    return components.errors_of(one, one.measured, jnp.asarray(light[..., None] * steep))


def sizes(sample, level, colour, pointing, *broad):
    return Components(jnp.array(sample), jnp.array([level, colour, pointing, *(broad or (0.0, 0.0))]))


def dense(errors, found):
    """The covariances of the samples of each direction."""
    weight = np.asarray(errors.weight)
    own = (float(found.sample) / np.where(weight > 0.0, weight, 1.0)) ** 2
    if errors.turned is not None:
        own = own + np.asarray(errors.turned) * float(found.common[2]) ** 2
    common = np.asarray(errors.common) * np.repeat(np.asarray(found.common[:3]), [1, 2, 2])
    return np.einsum("dce,dfe->dcf", common, common) + np.eye(CHANNELS) * own[..., None]


def dense_of_all(errors, found):
    """The covariance of all samples, with broad errors."""
    whole = scipy.linalg.block_diag(*dense(errors, found))
    broad = np.asarray(errors.broad) * np.asarray(found.common)[3:, None]
    broad = broad.reshape(whole.shape[0], -1)
    return whole + broad @ broad.T


def drawn(errors, found, seed):
    factor = np.linalg.cholesky(dense(errors, found))
    return np.einsum("dcf,df->dc", factor, np.random.default_rng(seed).standard_normal(factor.shape[:2]))


def some_columns(seed, count=6):
    return np.random.default_rng(seed).standard_normal((DIRECTIONS, 1, count)) * np.ones((CHANNELS, 1))


@functools.partial(jax.jit, static_argnames="loss")
def estimate(errors, residual, columns, expected, loss):
    prior = jnp.zeros((0, columns.shape[-1]))
    return components.estimate(errors, residual, columns, prior, expected, loss, jnp.array(3.0))


@pytest.mark.parametrize("found", [(1.0, 0.02, 0.01, 0.01), (1.7, 0.05, 0.0, 0.002)])
@pytest.mark.parametrize("moves", [False, True])
def test_whitened_rows_have_the_squares_of_the_dense_covariance(x64, moves, found):
    wrong = errors(moves)
    white = components.whitening(wrong, sizes(found[0], *found[1:]))
    samples = np.random.default_rng(2).standard_normal((DIRECTIONS, CHANNELS, 3))
    rows = np.asarray(components.whiten(white, jnp.asarray(samples)))
    whole = dense(wrong, sizes(found[0], *found[1:]))
    for d in range(DIRECTIONS):
        held = np.asarray(wrong.weight[d]) > 0.0
        part = samples[d, held]
        expected = part.T @ np.linalg.solve(whole[d][np.ix_(held, held)], part)
        np.testing.assert_allclose(rows[d].T @ rows[d], expected, rtol=1e-9)
        joined = np.asarray(components.joined(white, jnp.asarray(rows[..., 0])))[d]
        np.testing.assert_allclose(joined @ joined, expected[0, 0], rtol=1e-9)


@pytest.mark.parametrize("moves", [False, True])
def test_what_errors_in_common_move_has_their_covariance(x64, moves):
    wrong, found = errors(moves), (1.3, 0.02, 0.01, 0.01)
    rows = np.random.default_rng(3).standard_normal((DIRECTIONS, CHANNELS, 4))
    moved = np.asarray(components.moved_by(wrong, sizes(found[0], *found[1:]), jnp.asarray(rows)))
    common = dense(wrong, sizes(found[0], *found[1:])) - dense(wrong, sizes(found[0], 0.0, 0.0, 0.0))
    np.testing.assert_allclose(moved.T @ moved, np.einsum("dcx,dcf,dfy->xy", rows, common, rows), rtol=1e-9, atol=1e-12)


def test_what_broad_errors_move_has_their_covariance(x64):
    wrong, found = errors(), sizes(1.0, 0.0, 0.0, 0.0, 0.03, 0.02)
    rows = np.random.default_rng(3).standard_normal((DIRECTIONS, CHANNELS, 4))
    moved = np.asarray(components.moved_by(wrong, found, jnp.asarray(rows)))
    common = dense_of_all(wrong, found) - dense_of_all(wrong, sizes(1.0, 0.0, 0.0, 0.0))
    rows = rows.reshape(-1, 4)
    np.testing.assert_allclose(moved.T @ moved, rows.T @ common @ rows, rtol=1e-9)


def test_a_broad_error_has_its_size_everywhere_and_neighbours_share_it(x64):
    wrong, view = errors(), skyfit.hemisphere(DIRECTIONS)
    level = np.asarray(wrong.broad[:, :, 0]) / np.asarray(wrong.common[..., :1])
    shared = level[:, 0] @ level[:, 0].T
    np.testing.assert_allclose(np.diagonal(shared), 1.0, rtol=1e-12)
    zenith, azimuth = np.asarray(view.zenith), np.asarray(view.azimuth)
    cosine = np.cos(zenith[:, None]) * np.cos(zenith) + np.sin(zenith[:, None]) * np.sin(zenith) * np.cos(
        azimuth[:, None] - azimuth
    )
    assert shared[cosine > np.cos(0.3)].min() > 0.9 and shared[cosine < np.cos(1.8)].max() < 0.3


@pytest.mark.parametrize("truth", [(0.04, 0.02), (0.02, 0.05)])
def test_the_sizes_of_broad_errors_are_those_of_the_largest_restricted_likelihood(x64, truth):
    wrong, rest = errors(), (1.2, 0.015, 0.01, 0.005)
    whole, columns = dense_of_all(wrong, sizes(*rest, *truth)), some_columns(5)
    residual = np.linalg.cholesky(whole) @ np.random.default_rng(4).standard_normal(whole.shape[0])
    anything = Expected(jnp.full(5, 1e-3), jnp.full(5, 1e-9), jnp.array(0.1))
    shaped = jnp.asarray(residual.reshape(DIRECTIONS, CHANNELS))
    found = estimate(wrong, shaped, jnp.asarray(columns), anything, "squares")
    held = np.flatnonzero(np.asarray(wrong.weight).ravel() > 0.0)
    x, r = columns.reshape(-1, columns.shape[-1])[held], residual[held]

    def cost(logs):
        inverse = np.linalg.inv(dense_of_all(wrong, sizes(*np.exp(logs)))[np.ix_(held, held)])
        normal, right = x.T @ inverse @ x, x.T @ inverse @ r
        total = r @ inverse @ r - np.linalg.slogdet(inverse)[1] + np.linalg.slogdet(normal)[1]
        return total - right @ np.linalg.solve(normal, right)

    mine = np.log([found.sample, *found.common])
    # no size is better where the others stay
    for k in range(mine.size):
        step = 0.05 * np.eye(mine.size)[k]
        assert cost(mine) < min(cost(mine + step), cost(mine - step)) + 0.02, k


def test_what_the_others_hold_is_a_broad_error_where_it_is_broad(x64):
    """A parameter that all times share explains nothing of one time's residual, whatever its slopes."""
    wrong = errors()
    level = np.asarray(wrong.common[..., 0])
    residual = drawn(wrong, sizes(1.0, 0.0, 0.0, 0.0), 3) + 0.05 * level
    anything = Expected(jnp.array([5e-4, 3e-4, 2e-4, 5e-4, 3e-4]), jnp.ones(5), jnp.array(1.0))
    given = wrong, jnp.asarray(residual), jnp.asarray(level[..., None]), jnp.zeros((0, 1)), anything, "huber"
    held, moved = (components.estimate(*given, jnp.array(3.0), moves) for moves in (False, True))
    assert held.common[3] > 0.02 and held.common[0] < 0.01
    assert moved.common[3] < 2e-3 and moved.common[0] < 2e-3


def restricted_likelihood(errors, residual, columns, found):
    """Minus twice its logarithm, by dense algebra (Patterson & Thompson 1971)."""
    whole, total, normal, right = dense(errors, found), 0.0, 0.0, 0.0
    for d in range(DIRECTIONS):
        held = np.asarray(errors.weight[d]) > 0.0
        inverse = np.linalg.inv(whole[d][np.ix_(held, held)])
        r, x = residual[d, held], columns[d, held]
        total += r @ inverse @ r - np.linalg.slogdet(inverse)[1]
        normal, right = normal + x.T @ inverse @ x, right + x.T @ inverse @ r
    return total + np.linalg.slogdet(normal)[1] - right @ np.linalg.solve(normal, right)


@pytest.mark.parametrize("moves", [False, True])
def test_the_sizes_are_those_of_the_largest_restricted_likelihood(x64, moves):
    wrong, truth = errors(moves), (1.3, 0.02, 0.01, 0.008)
    residual, columns = drawn(wrong, sizes(truth[0], *truth[1:]), 4), some_columns(5)
    found = estimate(wrong, jnp.asarray(residual), jnp.asarray(columns), free(1e-9), "squares")

    def cost(logs):
        return restricted_likelihood(wrong, residual, columns, sizes(*np.exp(logs)))

    start = np.log(truth)
    best = np.exp(scipy.optimize.minimize(cost, start, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-3}).x)
    np.testing.assert_allclose([found.sample, *found.common[:3]], best, rtol=0.02)


@pytest.mark.parametrize("loss", ["squares", "huber"])
@pytest.mark.parametrize("moves", [False, True])
def test_the_sizes_of_many_residuals_are_right_on_the_mean(x64, moves, loss):
    wrong, truth = errors(moves), sizes(1.2, 0.02, 0.01, 0.005)
    columns = jnp.asarray(some_columns(7))
    found = [estimate(wrong, jnp.asarray(drawn(wrong, truth, 10 + k)), columns, free(), loss) for k in range(40)]
    squares = np.mean([np.square([one.sample, *one.common[:3]]) for one in found], axis=0)
    np.testing.assert_allclose(np.sqrt(squares), [1.2, 0.02, 0.01, 0.005], rtol=0.06)


def test_an_outlying_direction_does_not_make_the_others_uncertain(x64):
    wrong = errors()
    residual = drawn(wrong, sizes(1.0, 0.01, 1e-4, 1e-4), 8)
    residual[5] += 0.8 * np.asarray(wrong.common[5, :, 0])
    columns = jnp.asarray(some_columns(9, 1))
    robust = estimate(wrong, jnp.asarray(residual), columns, free(), "huber")
    plain = estimate(wrong, jnp.asarray(residual), columns, free(), "squares")
    assert 0.007 < robust.common[0] < 0.014 and plain.common[0] > 0.05


def test_what_is_given_stays(x64):
    wrong = errors()
    residual = jnp.asarray(drawn(wrong, sizes(0.5, 0.02, 0.01, 0.005), 9))
    given = Expected(jnp.array([0.03, 0.0, 0.002, 0.02, 0.0]), jnp.full(5, jnp.inf), jnp.array(1.0))
    found = estimate(wrong, residual, jnp.asarray(some_columns(9, 1)), given, "huber")
    np.testing.assert_array_equal(found.common, given.common)
    assert found.sample == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("count", [1, 2, 5, 8])
def test_a_typical_size_is_that_of_the_median(count):
    size = np.random.default_rng(count).normal(size=8)
    held = np.arange(8) < count
    expected = np.median(np.abs(size[:count])) / scipy.stats.norm.ppf(0.75)
    found = [typical_size(jnp.asarray(v), jnp.asarray(held)) for v in (size, np.where(held, size, np.nan))]
    np.testing.assert_allclose(found, expected, rtol=1e-4)
    assert np.isnan(typical_size(jnp.asarray(size), jnp.zeros(8, bool)))
