"""Least squares over a chain of times against the same problem written as one dense matrix."""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.extend
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
import pytest
import scipy.optimize

from skyfit.numerics.chain import (
    Begin,
    Blocks,
    blocks_of,
    ChainDescent,
    column_norms,
    damped,
    gradient,
    marginal_rows,
    minimise,
    Point,
    reduced,
    Rows,
    solve_chain,
    without,
)
from skyfit.numerics.least_squares import result_name


# times, own unknowns, shared unknowns, whether neighbours are linked
SHAPES = {
    "all": (5, 3, 4, True),
    "no steps": (4, 3, 2, False),
    "no shared": (5, 3, 0, True),
    "no own": (4, 0, 3, True),
    "one time": (1, 3, 2, True),
    "one time alone": (1, 2, 0, False),
    "two times": (2, 1, 1, True),
}


def chain(times, own, shared, linked, rows=9, sides=2, seed=0):
    """Random blocks, more rows than unknowns."""
    random = np.random.default_rng(seed)
    here, after = -random.uniform(1.0, 2.0, (times - 1, own)), random.uniform(1.0, 2.0, (times - 1, own))
    # one unknown without a link
    keep = linked * (np.arange(own) != 1)
    parts = (
        random.normal(size=(times, rows, own)), random.normal(size=(times, rows, shared)),
        random.normal(size=(times, rows, sides)), np.diag(np.arange(shared) % 3.0),
        random.normal(size=(shared, sides)), here * keep, after * keep, random.normal(size=(times - 1, own, sides)),
    )  # fmt: skip
    return Blocks(*(jnp.asarray(part) for part in parts))


def dense(blocks: Blocks):
    """Matrix and right-hand sides; unknowns by time, then the shared ones."""
    times, _, own = blocks.own.shape
    size = times * own + blocks.common.shape[2]
    rows, right = [], []

    def add(count, side):
        rows.append(np.zeros((count, size)))
        right.append(np.asarray(side))
        return rows[-1]

    for t in range(times):
        part = add(blocks.own.shape[1], blocks.right[t])
        part[:, t * own : (t + 1) * own], part[:, times * own :] = blocks.own[t], blocks.common[t]
    add(blocks.prior.shape[0], blocks.prior_right)[:, times * own :] = blocks.prior
    for t in range(times - 1):
        part = add(own, blocks.step_right[t])
        part[:, t * own : (t + 1) * own] = np.diag(blocks.here[t])
        part[:, (t + 1) * own : (t + 2) * own] = np.diag(blocks.after[t])
    return np.concatenate(rows), np.concatenate(right)


def flat(point: Point):
    return np.concatenate([np.ravel(point.own), np.ravel(point.shared)])


def solved(blocks: Blocks):
    own, shared = solve_chain(blocks)
    return jnp.concatenate([jnp.reshape(own, (-1, own.shape[-1])), shared])


class Answers(NamedTuple):
    """All that is asked of one chain, in one program."""

    solution: jax.Array
    slope: Point
    length: Point
    known: jax.Array
    damped: jax.Array
    blocks: Blocks


@jax.jit
def answers(blocks: Blocks) -> Answers:
    length = column_norms(blocks)
    # an unknown without influence has a strength, all others next to none
    guard = jax.tree.map(lambda v: jnp.where(v > 0.0, 1e-9 * v, 1.0), length)
    empty = jax.tree.map(lambda v: jnp.where(v > 0.0, 0.0, 1.0), length)
    strong = jax.tree.map(lambda v: 0.3 * v, length)
    return Answers(
        solved(damped(blocks, empty)), gradient(blocks), length, marginal_rows(blocks, guard),
        solved(damped(blocks, strong)), again(blocks),
    )  # fmt: skip


def again(blocks: Blocks) -> Blocks:
    """The blocks of the operator that these blocks make."""

    def rows(point):
        data = jnp.einsum("trp,tp->tr", blocks.own, point.own) + blocks.common @ point.shared
        step = blocks.here * point.own[:-1] + blocks.after * point.own[1:]
        return Rows(data, blocks.prior @ point.shared, step)

    operator = lx.FunctionLinearOperator(rows, jax.eval_shape(lambda: origin(blocks)))
    residual = Rows(blocks.right[..., 0], blocks.prior_right[:, 0], blocks.step_right[..., 0])
    return blocks_of(operator, residual, origin(blocks))


def origin(blocks: Blocks) -> Point:
    return Point(jnp.zeros(blocks.own.shape[::2]), jnp.zeros(blocks.common.shape[2]))


@pytest.fixture(params=SHAPES.values(), ids=SHAPES, scope="module")
def case(request):
    with jax.enable_x64(True):
        blocks = chain(*request.param)
        return blocks, answers(blocks), *dense(blocks)


def test_the_solution_is_that_of_the_dense_problem(case):
    _, found, matrix, right = case
    np.testing.assert_allclose(found.solution, np.linalg.lstsq(matrix, -right, rcond=None)[0], atol=1e-12)


def test_gradient_and_lengths_of_columns(case):
    _, found, matrix, right = case
    np.testing.assert_allclose(flat(found.slope), matrix.T @ right[:, 0], atol=1e-12)
    np.testing.assert_allclose(flat(found.length), np.linalg.norm(matrix, axis=0), rtol=1e-12)


def test_what_is_known_of_one_time_is_its_part_of_the_inverse_normal_matrix(case):
    blocks, found, matrix, _ = case
    covariance = np.linalg.inv(matrix.T @ matrix)
    times, _, own = blocks.own.shape
    for t, rows in enumerate(np.asarray(found.known)):
        kept = [*range(t * own, (t + 1) * own), *range(times * own, len(covariance))]
        np.testing.assert_allclose(np.linalg.inv(rows.T @ rows), covariance[np.ix_(kept, kept)], atol=1e-12)


def test_damping_is_a_row_for_each_unknown(case):
    _, found, matrix, right = case
    normal = matrix.T @ matrix
    expected = np.linalg.solve(normal + 0.09 * np.diag(np.diag(normal)), -matrix.T @ right)
    np.testing.assert_allclose(found.damped, expected, atol=1e-12)


def test_the_blocks_of_an_operator_are_found_by_its_products(case):
    blocks, found, *_ = case
    for name, got in found.blocks._asdict().items():
        expected = np.asarray(getattr(blocks, name))
        np.testing.assert_allclose(got, expected[..., :1] if "right" in name else expected, atol=1e-14, err_msg=name)


def test_held_unknowns_have_no_column(case):
    blocks, found, matrix, _ = case
    random = np.random.default_rng(1)
    held = jax.tree.map(lambda v: np.asarray(random.integers(0, 2, v.shape), float), found.length)
    with jax.enable_x64(True):
        emptied = without(blocks, held)
    np.testing.assert_array_equal(dense(emptied)[0], matrix * (1.0 - flat(held)))


def test_rows_of_one_time_as_few_keep_their_normal_equations(x64):
    one = chain(1, 3, 4, False, rows=40, sides=1)
    few = reduced(one.own[0], one.common[0], one.right[0], 8)
    every = np.concatenate([one.own[0], one.common[0], one.right[0]], axis=1)
    assert [part.shape for part in few] == [(8, 3), (8, 4), (8, 1)]
    np.testing.assert_allclose(np.concatenate(few, axis=1).T @ np.concatenate(few, axis=1), every.T @ every, atol=1e-12)


def test_float32_is_near_float64():
    with jax.enable_x64(True):
        blocks = chain(*SHAPES["all"])
        expected = answers(blocks)
    got = answers(jax.tree.map(lambda v: jnp.asarray(v, jnp.float32), blocks))
    assert {v.dtype for v in jax.tree.leaves(got)} == {np.dtype(np.float32)}
    for name, tolerance in (("solution", 3e-6), ("damped", 3e-6), ("known", 3e-5)):
        np.testing.assert_allclose(getattr(got, name), getattr(expected, name), atol=tolerance)


@pytest.mark.parametrize("place", ["own", "shared"])
def test_an_unknown_without_influence_spoils_no_other(x64, place):
    blocks = chain(*SHAPES["all"])._replace(prior=jnp.diag(jnp.arange(4.0)))
    times, own = 5, 3
    if place == "own":
        blocks = blocks._replace(own=blocks.own.at[2, :, 1].set(0.0))
        gone = 2 * own + 1
    else:
        blocks = blocks._replace(common=blocks.common.at[:, :, 0].set(0.0))
        gone = times * own
    matrix, right = dense(blocks)
    assert not matrix[:, gone].any()
    left = np.delete(np.arange(matrix.shape[1]), gone)
    found = answers(blocks)
    expected = np.linalg.lstsq(matrix[:, left], -right, rcond=None)[0]
    np.testing.assert_allclose(found.solution[left], expected, atol=1e-12)
    np.testing.assert_allclose(found.solution[gone], 0.0, atol=1e-12)
    covariance = np.linalg.inv(matrix[:, left].T @ matrix[:, left])
    for t, rows in enumerate(np.asarray(found.known)):
        unknowns = np.array([*range(t * own, (t + 1) * own), *range(times * own, matrix.shape[1])])
        columns = np.flatnonzero(unknowns != gone)
        among = np.searchsorted(left, unknowns[columns])
        marginal = np.linalg.inv(rows[:, columns].T @ rows[:, columns])
        np.testing.assert_allclose(marginal, covariance[np.ix_(among, among)], atol=1e-12)


# cost


def work(jaxpr) -> int:
    """Multiplications, roughly: of a factorisation rows times columns squared, of all else what comes out."""
    total = 0
    for equation in jaxpr.eqns:
        inner = [
            v for v in equation.params.values() if isinstance(v, (jax.extend.core.Jaxpr, jax.extend.core.ClosedJaxpr))
        ]
        times = equation.params.get("length", 1)
        for part in inner:
            total += times * work(getattr(part, "jaxpr", part))
        if not inner:
            shape = equation.invars[0].aval.shape if equation.invars else ()
            factorises = equation.primitive.name in ("geqrf", "qr", "householder_product", "triangular_solve")
            total += shape[-2] * shape[-1] ** 2 * int(np.prod(shape[:-2])) if factorises else 0
            total += sum(int(np.prod(v.aval.shape)) for v in equation.outvars)
    return total


def test_the_work_grows_linearly_with_the_number_of_times():
    def step(blocks):
        point = origin(blocks)
        return ChainDescent(jax.tree.map(jnp.ones_like, point)).to_best(point, blocks, 0.1)

    def known(blocks):
        return marginal_rows(blocks, column_norms(blocks))

    for function in (solve_chain, known, step):
        counts = [work(jax.make_jaxpr(function)(chain(t, 3, 4, True, sides=1)).jaxpr) for t in (8, 16, 32)]
        # what is done once, and the same for each further time
        assert counts[2] - counts[1] == 2 * (counts[1] - counts[0]), counts
        assert counts[0] < 9 * (counts[1] - counts[0]) / 8, counts


# the search


NO = np.zeros((), bool)


@partial(jax.jit, static_argnums=2)
def boxed(blocks: Blocks, limit, max_steps=100):
    """Rows that are linear everywhere, in units of a small sigma: the search goes on to the very minimum."""

    def rows(point, given):
        blocks, _ = given
        data = jnp.einsum("trp,tp->tr", blocks.own, point.own) + blocks.common @ point.shared + blocks.right[..., 0]
        step = blocks.here * point.own[:-1] + blocks.after * point.own[1:] + blocks.step_right[..., 0]
        shared = blocks.prior @ point.shared + blocks.prior_right[:, 0]
        return jax.tree.map(lambda v: 1e3 * v, Rows(data, shared, step)), None

    limits = jax.tree.map(lambda v: jnp.full_like(v, limit), origin(blocks))
    point, _, cost, steps, result = minimise(rows, origin(blocks), blocks, None, NO, limits, 0, max_steps)
    return point, 1e-6 * cost, steps, result == optx.RESULTS.successful


@pytest.mark.parametrize("limit", [0.05, 0.2, 0.5])
@pytest.mark.parametrize("seed", range(4))
def test_in_a_box_it_is_the_bounded_minimum(x64, limit, seed):
    blocks = chain(5, 3, 4, True, seed=seed)
    matrix, right = dense(blocks)
    expected = scipy.optimize.lsq_linear(matrix, -right[:, 0], (-limit, limit), tol=1e-14)
    point, said, _, successful = boxed(blocks, limit)
    found = flat(point)
    cost = 0.5 * np.sum((matrix @ found + right[:, 0]) ** 2)
    assert said == pytest.approx(cost, rel=1e-12)
    assert successful and np.all(np.abs(found) <= limit)
    assert cost == pytest.approx(expected.cost, rel=1e-7)
    np.testing.assert_allclose(found, expected.x, atol=1e-4)
    assert np.any(np.abs(expected.x) > 0.999 * limit) or limit == 0.5


def decays(point: Point, given):
    """Amplitude and level of each time's own, the rate of the decay shared; a step prior on the level."""
    (place, measured), begin = given
    curve = jnp.exp(-jnp.exp(point.shared[0]) * place)[None]
    curve = jnp.where(begin.holds, begin.known["curve"], curve)
    data = 20.0 * (point.own[:, :1] * curve + point.own[:, 1:] - measured)
    step = 3.0 * jnp.stack([0.0 * point.own[1:, 0], point.own[1:, 1] - point.own[:-1, 1]], axis=1)
    return Rows(data, (point.shared - 0.3) / 0.5, step), {"curve": curve}


@pytest.mark.parametrize("times", [1, 6])
def test_a_nonlinear_joint_problem_has_the_minimum_that_scipy_finds(x64, times):
    random = np.random.default_rng(5)
    place = np.linspace(0.0, 2.0, 12)
    truth = random.uniform(0.5, 2.0, (times, 2))
    measured = truth[:, :1] * np.exp(-1.7 * place) + truth[:, 1:] + 0.05 * random.normal(size=(times, 12))
    arguments = jnp.asarray(place), jnp.asarray(measured)
    start = Point(jnp.ones((times, 2)), jnp.zeros(1))

    begin = Begin({"curve": jnp.zeros((1, 12))}, NO, NO)

    def residual(x):
        point = Point(jnp.asarray(x[:-1].reshape(times, 2)), jnp.asarray(x[-1:]))
        return np.concatenate([np.ravel(v) for v in decays(point, (arguments, begin))[0]])

    expected = scipy.optimize.least_squares(residual, flat(start), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    free = jax.tree.map(lambda v: jnp.full_like(v, jnp.inf), start)
    found, known, _, steps, result = eqx.filter_jit(minimise)(decays, start, arguments, *begin[:2], free, 0, 50)
    assert result_name(result) == "successful" and steps < 20
    # within the tolerance of the search, a fiftieth of a standard deviation
    sigma = np.sqrt(np.diag(np.linalg.inv(expected.jac.T @ expected.jac)))
    assert np.all(np.abs(flat(found) - expected.x) < 0.02 * sigma)
    assert 0.5 * np.sum(residual(flat(found)) ** 2) <= expected.cost + 0.02**2
    np.testing.assert_array_equal(known["curve"], decays(found, (arguments, begin))[1]["curve"])
    # a search that begins with what is known there ends at once; with a wrong curve it does so elsewhere
    for curve, same in ((known["curve"], True), (known["curve"] + 0.1, False)):
        taken = {"curve": curve}, ~NO
        again, _, _, steps, _ = eqx.filter_jit(minimise)(decays, found, arguments, *taken, free, 0, 1)
        assert steps == 1 and np.all(flat(again) == flat(found))
        moved, *_ = eqx.filter_jit(minimise)(decays, found, arguments, *taken, free, 0, 2)
        assert np.allclose(flat(moved), flat(found), atol=0.1 * sigma.min()) == same
        # what is taken over counts for the first step alone
        end, *_ = eqx.filter_jit(minimise)(decays, found, arguments, *taken, free, 0, 50)
        assert np.all(np.abs(flat(end) - expected.x) < 0.02 * sigma)


def decays_by_slopes(point: Point, given):
    """`decays`, linear about the point, with the slope of the curve that was found last, counted, where it serves."""
    (place, measured), begin = given
    here = jax.lax.stop_gradient(point.shared[0])
    curve, slope = jax.jvp(lambda rate: jnp.exp(-jnp.exp(rate) * place)[None], (here,), (jnp.ones_like(here),))
    slope = jnp.where(begin.close, begin.known["slope"], slope)
    moved = curve + slope * (point.shared[0] - here)
    rows, _ = decays(point, (given[0], Begin({"curve": moved}, ~NO, NO)))
    return rows, {"slope": slope, "renewed": begin.known["renewed"] + jnp.where(begin.close, 0, 1)}


def test_near_the_end_slopes_are_not_renewed(x64):
    random = np.random.default_rng(5)
    place = np.linspace(0.0, 2.0, 12)
    measured = 1.3 * np.exp(-1.7 * place) + 0.6 + 0.05 * random.normal(size=(1, 12))
    arguments, start = (jnp.asarray(place), jnp.asarray(measured)), Point(jnp.ones((1, 2)), jnp.zeros(1))
    nothing = {"slope": jnp.zeros((1, 12)), "renewed": jnp.asarray(0)}
    free = jax.tree.map(lambda v: jnp.full_like(v, jnp.inf), start)

    def found(close):
        return eqx.filter_jit(minimise)(decays_by_slopes, start, arguments, nothing, NO, free, 0, 50, 1e-3, 0.1, close)

    each, known, _, steps, _ = found(0.0)
    # those of a step that is refused are not counted
    assert steps - 2 <= known["renewed"] <= steps
    kept, some, _, more, result = found(1.0)
    assert result_name(result) == "successful" and more <= steps + 3
    assert some["renewed"] <= known["renewed"] - 2
    np.testing.assert_allclose(flat(kept), flat(each), atol=1e-3)


def test_the_number_of_steps_is_limited(x64):
    _, _, steps, successful = boxed(chain(5, 3, 4, True), 10.0, 1)
    assert steps == 1 and not successful


def test_unknowns_that_are_linear_are_not_damped(x64):
    blocks = chain(3, 2, 4, True)
    matrix, right = dense(blocks)
    free = jax.tree.map(lambda v: jnp.full_like(v, jnp.inf), origin(blocks))
    heavy = flat(jax.jit(lambda b: ChainDescent(free, 4).to_best(origin(b), b, 1e6))(blocks))
    # the own ones stand still; the shared ones go where they are best
    np.testing.assert_allclose(heavy[:6], 0.0, atol=1e-9)
    np.testing.assert_allclose(heavy[6:], np.linalg.lstsq(matrix[:, 6:], -right[:, 0], rcond=None)[0], atol=1e-9)
