"""Least squares over a chain of times: unknowns of each time's own and unknowns that all share, by orthogonal steps.

A joint fit of many times has a Jacobian of blocks: the rows of a time touch its own unknowns and the shared ones, and
rows that ask for smoothness touch two neighbours. Eliminating one time after the other by QR costs the same for each,
so that the whole grows linearly with their number, and squares no condition number.
**Source:** square-root information smoothing, Bierman 1977, Factorization Methods for Discrete Sequential Estimation,
ch. 5 and 10; multi-pixel retrievals: Dubovik et al. 2011, Atmos. Meas. Tech. 4, 975, sec. 4.3.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, ArrayLike, Float, Int

from .factor import solve_upper, triangle


# standard deviations of the residuals by which a step of one in an unconstrained unknown must pay: what does less is
# left where it is, for the data do not determine it
_DETERMINED = 0.3
_MOST_REJECTED = 8


class Point(NamedTuple):
    """Unknowns, or steps of them, or their limits."""

    own: Float[Array, "time parameter"]
    shared: Float[Array, " shared"]


class Rows(NamedTuple):
    """Residuals: of each time's samples and priors, of priors of the shared unknowns, of steps between neighbours."""

    data: Float[Array, "time row"]
    shared: Float[Array, " shared"]
    step: Float[Array, "step parameter"]


class Blocks(NamedTuple):
    """The rows with their derivatives, and any number of right-hand sides.

    `own`, `common`: derivatives of the data rows; `prior`: those of the shared rows; `here`, `after`: those of a step
    by the earlier and the later unknown, which are diagonal.
    """

    own: Float[Array, "time row parameter"]
    common: Float[Array, "time row shared"]
    right: Float[Array, "time row side"]
    prior: Float[Array, "prior shared"]
    prior_right: Float[Array, "prior side"]
    here: Float[Array, "step parameter"]
    after: Float[Array, "step parameter"]
    step_right: Float[Array, "step parameter side"]


def blocks_of(jacobian, residual: Rows, point: Point) -> Blocks:
    """The blocks of a linear operator from `Point` to `Rows`, by one product for each column that a time has.

    All even times are asked at once, then all odd ones: no row depends on two of either kind.
    """
    times, own = point.own.shape
    shared = point.shared.size
    even = (jnp.arange(times) % 2 == 0).astype(point.own.dtype)
    parity = jnp.stack([even, 1.0 - even])
    unit = jnp.eye(own, dtype=point.own.dtype)
    seeds = (parity[:, None, :, None] * unit[None, :, None, :]).reshape(2 * own, times, own)
    nothing = jnp.zeros((shared, times, own), point.own.dtype)
    none = jnp.zeros((2 * own, shared), point.own.dtype)
    seeds = Point(jnp.concatenate([seeds, nothing]), jnp.concatenate([none, jnp.eye(shared, dtype=none.dtype)]))
    columns = jax.vmap(jacobian.mv)(seeds)
    data, step = columns.data, columns.step[: 2 * own].reshape(2, own, times - 1, own)
    link = jnp.stack([jnp.diagonal(step[i], axis1=0, axis2=2) for i in range(2)])
    first = (jnp.arange(link.shape[1]) % 2 == 0)[:, None]
    return Blocks(
        jnp.moveaxis(data[:own] + data[own : 2 * own], 0, -1),
        jnp.moveaxis(data[2 * own :], 0, -1),
        residual.data[..., None],
        columns.shared[2 * own :].T,
        residual.shared[:, None],
        jnp.where(first, link[0], link[1]),
        jnp.where(first, link[1], link[0]),
        residual.step[..., None],
    )


def gradient(blocks: Blocks) -> Point:
    """The gradient of half the sum of squares, for the first right-hand side."""
    right, step = blocks.right[..., 0], blocks.step_right[..., 0]
    own = jnp.einsum("trp,tr->tp", blocks.own, right)
    own = own.at[:-1].add(blocks.here * step).at[1:].add(blocks.after * step)
    shared = jnp.einsum("trs,tr->s", blocks.common, right) + blocks.prior.T @ blocks.prior_right[:, 0]
    return Point(own, shared)


def column_norms(blocks: Blocks) -> Point:
    """The length of each unknown's column."""
    own = jnp.sum(blocks.own**2, axis=1)
    own = own.at[:-1].add(blocks.here**2).at[1:].add(blocks.after**2)
    shared = jnp.sum(blocks.common**2, axis=(0, 1)) + jnp.sum(blocks.prior**2, axis=0)
    return Point(jnp.sqrt(own), jnp.sqrt(shared))


def without(blocks: Blocks, held: Point) -> Blocks:
    """The blocks with the columns of held unknowns emptied."""
    own, shared = 1.0 - held.own, 1.0 - held.shared
    return blocks._replace(
        own=blocks.own * own[:, None],
        common=blocks.common * shared[None, None],
        prior=blocks.prior * shared[None],
        here=blocks.here * own[:-1],
        after=blocks.after * own[1:],
    )


def damped(blocks: Blocks, size: Point) -> Blocks:
    """The blocks with a row for each unknown that holds it at 0 with this strength."""
    times, own = size.own.shape
    side = blocks.right.shape[-1]
    diagonal = size.own[:, :, None] * jnp.eye(own, dtype=size.own.dtype)[None]
    shared = jnp.diag(size.shared)
    return blocks._replace(
        own=jnp.concatenate([blocks.own, diagonal], axis=1),
        common=jnp.concatenate([blocks.common, jnp.zeros((times, own, shared.shape[0]), shared.dtype)], axis=1),
        right=jnp.concatenate([blocks.right, jnp.zeros((times, own, side), shared.dtype)], axis=1),
        prior=jnp.concatenate([blocks.prior, shared]),
        prior_right=jnp.concatenate([blocks.prior_right, jnp.zeros((shared.shape[0], side), shared.dtype)]),
    )


class _Eliminated(NamedTuple):
    pivot: Float[Array, "time parameter column"]
    carried: Float[Array, "time row column"]
    last: Float[Array, "row column"]


def _eliminate(blocks: Blocks) -> _Eliminated:
    """One time after the other: rows that fix its own unknowns, and what they leave for the next time and the shared.

    `carried` holds what all earlier times say about (own, shared, right-hand sides) of a time.
    """
    times, _, own = blocks.own.shape
    shared, side = blocks.common.shape[2], blocks.right.shape[2]
    dtype = blocks.own.dtype
    # the link of the last time is empty
    pad = ((0, 1), (0, 0))
    here, after = jnp.pad(blocks.here, pad), jnp.pad(blocks.after, pad)
    link_right = jnp.pad(blocks.step_right, (*pad, (0, 0)))
    prior = jnp.concatenate([blocks.prior, blocks.prior_right], axis=1)
    prior = _triangle(prior, shared)
    start = jnp.zeros((own + shared, own + shared + side), dtype).at[own:, own:].set(prior)

    def step(carry, rows):
        own_rows, common, right, here, after, link_right = rows
        gap = jnp.zeros((carry.shape[0], own), dtype)
        before = jnp.concatenate([carry[:, :own], gap, carry[:, own:]], axis=1)
        gap = jnp.zeros((own_rows.shape[0], own), dtype)
        data = jnp.concatenate([own_rows, gap, common, right], axis=1)
        none = jnp.zeros((own, shared), dtype)
        link = jnp.concatenate([jnp.diag(here), jnp.diag(after), none, link_right], axis=1)
        whole = _triangle(jnp.concatenate([before, data, link]), 2 * own + shared)
        return whole[own:, own:], (whole[:own], carry)

    last, (pivot, carried) = jax.lax.scan(
        step, start, (blocks.own, blocks.common, blocks.right, here, after, link_right)
    )
    return _Eliminated(pivot, carried, last)


def _triangle(rows: Float[Array, "row column"], count: int) -> Float[Array, "count column"]:
    """The first `count` rows of R, filled up with empty ones; with positive diagonal, so that R follows its matrix."""
    if rows.shape[0] == 0 or rows.shape[1] == 0:
        return jnp.zeros((count, rows.shape[1]), rows.dtype)
    factor = triangle(rows)
    sign = jnp.where(jnp.diagonal(factor) < 0.0, -1.0, 1.0)
    factor = (factor * sign[:, None])[:count]
    return jnp.pad(factor, ((0, count - factor.shape[0]), (0, 0)))


def reduced(own, common, right, count: int):
    """Rows of one time as a triangle of `count` rows, with the same normal equations: own, common, right."""
    whole = _triangle(jnp.concatenate([own, common, right], axis=1), count)
    ends = own.shape[1], own.shape[1] + common.shape[1]
    return whole[:, : ends[0]], whole[:, ends[0] : ends[1]], whole[:, ends[1] :]


def solve_chain(blocks: Blocks) -> tuple[Float[Array, "time parameter side"], Float[Array, "shared side"]]:
    """The unknowns that minimise the sum of squares of rows plus right-hand side, for each of the sides.

    **Valid:** every unknown must have a row (`damped` sees to that).
    """
    own, shared = blocks.own.shape[2], blocks.common.shape[2]
    done = _eliminate(blocks)
    if shared:
        last = _triangle(done.last[:, own:], shared)
        common = -solve_upper(last[:, :shared], last[:, shared:])
    else:
        common = jnp.zeros((0, blocks.right.shape[2]), blocks.own.dtype)

    def back(later, pivot):
        right = pivot[:, 2 * own + shared :] + pivot[:, own : 2 * own] @ later
        right = right + pivot[:, 2 * own : 2 * own + shared] @ common
        here = -solve_upper(pivot[:, :own], right)
        return here, here

    nothing = jnp.zeros((own, blocks.right.shape[2]), blocks.own.dtype)
    _, every = jax.lax.scan(back, nothing, done.pivot, reverse=True)
    return every, common


def marginal_rows(blocks: Blocks, guard: Point) -> Float[Array, "time row column"]:
    """All that the data say about each time's own and the shared unknowns, the other times' own ones eliminated.

    **Arguments:** `guard`, strengths too small to matter that keep the elimination of unknowns without influence sound.
    **Returns:** rows over (own, shared); their normal matrix is the inverse of that marginal covariance.
    """
    safe = damped(blocks, guard)
    # what earlier and what later times carry here; the shared prior rows come with the first of them
    safe = safe._replace(prior=blocks.prior, prior_right=blocks.prior_right)
    empty = jnp.zeros_like(blocks.prior)
    backward = Blocks(
        safe.own[::-1], safe.common[::-1], safe.right[::-1], empty, blocks.prior_right, safe.after[::-1],
        safe.here[::-1], safe.step_right[::-1],
    )  # fmt: skip
    columns = blocks.own.shape[2] + blocks.common.shape[2]
    before, later = _eliminate(safe).carried, _eliminate(backward).carried[::-1]
    here = jnp.concatenate([blocks.own, blocks.common], axis=2)
    return jnp.concatenate([before[..., :columns], here, later[..., :columns]], axis=1)


def squared_change(blocks: Blocks, step: Point) -> Float[Array, ""]:
    """By how much a step changes the rows, the sum of squares."""
    data = jnp.einsum("trp,tp->tr", blocks.own, step.own) + jnp.einsum("trs,s->tr", blocks.common, step.shared)
    link = blocks.here * step.own[:-1] + blocks.after * step.own[1:]
    return jnp.sum(data**2) + jnp.sum((blocks.prior @ step.shared) ** 2) + jnp.sum(link**2)


class _ChainState(NamedTuple):
    """The linear problem at the last accepted point, and how much the whole step to its minimum would change."""

    point: Point
    blocks: Blocks
    change: Float[Array, ""]


class ChainDescent(optx.AbstractDescent):
    r"""Marquardt's step $(J^T J + \lambda\, \mathrm{diag}(J^T J))\, \delta = -J^T r$ within a box, for a chain.

    As `MarquardtDescent`: unknowns at the edge of the box that would leave it are held while the others move. The last
    `linear` shared unknowns, in which the residuals are linear and which have priors, are not damped: the step is to
    their best values, and no narrow valley along them slows the others down.
    """

    limit: Point
    linear: int = 0
    first_damping: float = 0.1
    longest: float = 2.0

    def init(self, y, f_info_struct):
        rows = f_info_struct.residual
        empty = Blocks(
            jnp.zeros((*rows.data.shape, y.own.shape[1])),
            jnp.zeros((*rows.data.shape, y.shared.size)),
            jnp.zeros((*rows.data.shape, 1)),
            jnp.zeros((rows.shared.size, y.shared.size)),
            jnp.zeros((rows.shared.size, 1)),
            jnp.zeros(rows.step.shape),
            jnp.zeros(rows.step.shape),
            jnp.zeros((*rows.step.shape, 1)),
        )
        return _ChainState(y, *jax.tree.map(lambda v: v.astype(y.own.dtype), (empty, jnp.array(jnp.inf))))

    def query(self, y, f_info, state):
        blocks = blocks_of(f_info.jac, f_info.residual, y)
        return _ChainState(y, blocks, squared_change(blocks, self.to_best(y, blocks, 0.0)))

    def step(self, step_size, state):
        damping = jnp.sqrt(self.first_damping / step_size)
        return self.to_best(state.point, state.blocks, damping), optx.RESULTS.successful

    def to_best(self, point: Point, blocks: Blocks, damping) -> Point:
        """The step to the minimum of the linear problem in the box, damped by this share of each column's length.

        Combinations that hardly move the residuals (`_DETERMINED`) are damped besides: the step is along what the
        data determine.
        """
        slope = gradient(blocks)
        # held at the edge: where the cost falls outward, then where the step of the others would still lead out
        side = jax.tree.map(lambda p, limit: jnp.where(jnp.abs(p) >= limit, jnp.sign(p), 0.0), point, self.limit)
        outward = jax.tree.map(lambda s, g: ((s != 0.0) & (s * g <= 0.0)).astype(g.dtype), side, slope)

        def moved(_, carry):
            held, _ = carry
            kept = without(blocks, held)
            size = jax.tree.map(lambda v: jnp.hypot(damping * v, _DETERMINED), column_norms(kept))
            size = size._replace(shared=size.shared * (jnp.arange(size.shared.size) < size.shared.size - self.linear))
            own, shared = solve_chain(damped(kept, size))
            step = Point(own[..., 0], shared[:, 0])
            led = jax.tree.map(lambda s, d: ((s != 0.0) & (jnp.sign(d) == s)).astype(d.dtype), side, step)
            return jax.tree.map(jnp.maximum, outward, led), step

        _, change = jax.lax.fori_loop(0, 2, moved, (outward, jax.tree.map(jnp.zeros_like, point)))
        # a logistic curve is straight for about this far
        bounded = jax.tree.map(
            lambda d, limit: jnp.where(jnp.isfinite(limit), jnp.clip(d, -self.longest, self.longest), d),
            change,
            self.limit,
        )
        return jax.tree.map(lambda p, d, limit: jnp.clip(p + d, -limit, limit) - p, point, bounded, self.limit)


class ChainMarquardt(optx.AbstractGaussNewton):
    """Optimistix' Gauss-Newton loop that ends where the whole step to the minimum changes the residuals by less than
    `tolerance`: residuals are in standard deviations, so that no determined combination of parameters is further from
    its best than this share of its sigma. It and `max_steps` may be traced."""

    descent: ChainDescent
    max_steps: Int[Array, ""]
    tolerance: Float[Array, ""]
    rtol: float = 0.0
    atol: float = 0.0
    norm: Callable = optx.max_norm
    search: optx.AbstractSearch = optx.ClassicalTrustRegion(
        high_cutoff=0.75, low_cutoff=0.01, high_constant=5.0, low_constant=0.1
    )
    verbose: Callable = lambda **_: None

    def terminate(self, fn, y, args, options, state, tags):
        done = (state.num_accepted_steps > 0) & (state.descent_state.change < self.tolerance**2)
        # a search that only shrinks is where rounding lets no step succeed
        stuck = (state.num_accepted_steps > 0) & (state.num_steps_since_acceptance > _MOST_REJECTED)
        late = state.num_steps >= self.max_steps
        result = optx.RESULTS.where(late & ~(done | stuck), optx.RESULTS.nonlinear_max_steps_reached, state.result)
        return done | stuck | late, result


def minimise(rows, point: Point, arguments, limit: Point, linear: int, max_steps, tolerance: ArrayLike = 0.05):
    """The least sum of squares within |unknown| <= `limit` by Levenberg-Marquardt on optimistix' loop.

    **Arguments:** `rows(point, arguments)` gives `Rows`, linear about `point`, and what is known besides; `linear` as
    in `ChainDescent`; `max_steps` and `tolerance` (`ChainMarquardt`), numbers or traced.
    **Returns:** the point, what `rows` knew at it, the number of steps and optimistix' result; nothing is raised.
    """
    descent = ChainDescent(limit, linear)
    solver = ChainMarquardt(descent=descent, max_steps=jnp.asarray(max_steps), tolerance=jnp.asarray(tolerance))
    solution = optx.least_squares(rows, solver, point, arguments, has_aux=True, max_steps=None, throw=False)
    # the sum of a point and a step to the edge is beyond it by rounding
    end = jax.tree.map(lambda p, edge: jnp.clip(p, -edge, edge), solution.value, limit)
    return end, solution.state.aux, solution.stats["num_steps"], solution.result
