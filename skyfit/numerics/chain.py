"""Least squares over a chain of times, with unknowns of each time and shared unknowns, by orthogonal factorisation.

The Jacobian of a joint fit of many times consists of blocks. The rows of a time depend on its own unknowns and on the
shared ones; smoothness rows depend on two neighbours. Elimination of one time after the other by QR costs the same for
each, so that the total cost grows linearly with their number. It squares no condition number.
**Source:** square-root information smoothing, Bierman 1977, Factorization Methods for Discrete Sequential Estimation,
ch. 5 and 10; multi-pixel retrievals: Dubovik et al. 2011, Atmos. Meas. Tech. 4, 975, sec. 4.3.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from .factor import solve_upper, triangle


# Change of the residuals, in standard deviations, that a unit step of an unconstrained unknown must make. The data do
# not determine an unknown that changes them less; it is left where it is.
_DETERMINED = 0.3
_MOST_REJECTED = 8


class Point(NamedTuple):
    """Unknowns, steps of them, or their limits."""

    own: Float[Array, "time parameter"]
    shared: Float[Array, " shared"]


class Begin(NamedTuple):
    """Auxiliary results that rows may take over instead of computing them.

    `known`: those of the last accepted point; at the first point those given, without a meaning unless `holds` is set.
    `holds`: they are those of this very point. `close`: the end is so close that the slopes among them still serve.
    """

    known: Any
    holds: Bool[Array, ""]
    close: Bool[Array, ""]


class Rows(NamedTuple):
    """Residuals of each time's samples and priors, of the shared unknowns' priors, and of steps between neighbours."""

    data: Float[Array, "time row"]
    shared: Float[Array, " shared"]
    step: Float[Array, "step parameter"]


class Blocks(NamedTuple):
    """Derivatives of the rows, and any number of right-hand sides.

    `own`, `common`: derivatives of the data rows by a time's own and by the shared unknowns; `prior`: those of the
    shared rows; `here`, `after`: those of a step by the earlier and the later unknown, which are diagonal.
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
    """The blocks of a linear operator from `Point` to `Rows`.

    The number of products does not grow with the times. All even times share a product, and all odd ones: no row
    depends on two times of the same kind.
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
    """The blocks with the columns of held unknowns set to zero."""
    own, shared = 1.0 - held.own, 1.0 - held.shared
    return blocks._replace(
        own=blocks.own * own[:, None],
        common=blocks.common * shared[None, None],
        prior=blocks.prior * shared[None],
        here=blocks.here * own[:-1],
        after=blocks.after * own[1:],
    )


def damped(blocks: Blocks, size: Point) -> Blocks:
    """The blocks with an additional row for each unknown, which holds it at 0 with the strength `size`."""
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
    """Eliminate one time after the other: `pivot` fixes its own unknowns, `last` remains for the shared ones.

    `carried` is the information of all earlier times on (own, shared, right-hand sides) of a time.
    """
    times, _, own = blocks.own.shape
    shared, side = blocks.common.shape[2], blocks.right.shape[2]
    dtype = blocks.own.dtype
    # The link of the last time is empty.
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
    """The first `count` rows of R, padded with zeros; its diagonal is positive, so that R is continuous in `rows`."""
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
    """The unknowns that minimise the sum of squares of rows plus right-hand side, for each right-hand side.

    **Valid:** every unknown must have a row (`damped` adds one).
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
    """Rows with all information on each time's own and the shared unknowns; those of other times are eliminated.

    **Arguments:** `guard`, strengths too small to matter, by which unknowns without influence can be eliminated.
    **Returns:** rows over (own, shared); their normal matrix is the inverse of that marginal covariance.
    """
    safe = damped(blocks, guard)
    # Information that earlier and later times carry here. That of the earlier ones contains the shared prior rows.
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
    """Sum of squares of the change of the rows by a step."""
    data = jnp.einsum("trp,tp->tr", blocks.own, step.own) + jnp.einsum("trs,s->tr", blocks.common, step.shared)
    link = blocks.here * step.own[:-1] + blocks.after * step.own[1:]
    return jnp.sum(data**2) + jnp.sum((blocks.prior @ step.shared) ** 2) + jnp.sum(link**2)


class _ChainState(NamedTuple):
    """The linear problem at the last accepted point; squared change of its rows by the whole step to its minimum."""

    point: Point
    blocks: Blocks
    change: Float[Array, ""]


class ChainDescent(optx.AbstractDescent):
    r"""Marquardt's step $(J^T J + \lambda\, \mathrm{diag}(J^T J))\, \delta = -J^T r$ within a box, for a chain.

    As in `MarquardtDescent`, unknowns at the edge of the box that would leave it are held while the others move. The
    last `linear` shared unknowns, in which the residuals are linear and which have priors, are not damped. The step
    goes to their best values, so that no narrow valley along them slows the others down. $\lambda$ of the first step is
    `first_damping`.
    """

    limit: Point
    linear: int = 0
    first_damping: ArrayLike = 0.1
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
        return _ChainState(y, blocks_of(f_info.jac, f_info.residual, y), state.change)

    def step(self, step_size, state):
        """No step: `ChainMarquardt` takes it, so that one program finds the damped step and the whole one."""
        return jax.tree.map(jnp.zeros_like, state.point), optx.RESULTS.successful

    def steps(self, step_size, state) -> tuple[Point, Float[Array, ""]]:
        """The step of this size, and the squared change of the rows by the whole step to the minimum."""
        damping = jnp.stack([jnp.zeros_like(step_size), jnp.sqrt(self.first_damping / step_size)])
        both = jax.lax.map(lambda size: self.to_best(state.point, state.blocks, size), damping)
        whole, step = jax.tree.map(lambda v: v[0], both), jax.tree.map(lambda v: v[1], both)
        return step, squared_change(state.blocks, whole)

    def to_best(self, point: Point, blocks: Blocks, damping) -> Point:
        """The step to the minimum of the linear problem in the box, damped by this share of each column's length.

        Combinations that hardly change the residuals (`_DETERMINED`) are damped in addition: the step is along the
        combinations that the data determine.
        """
        slope = gradient(blocks)
        # Unknowns are held at the edge where the cost falls outward, then where the step would still lead outward.
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
        # A logistic curve is about straight over the distance `longest`.
        bounded = jax.tree.map(
            lambda d, limit: jnp.where(jnp.isfinite(limit), jnp.clip(d, -self.longest, self.longest), d),
            change,
            self.limit,
        )
        return jax.tree.map(lambda p, d, limit: jnp.clip(p + d, -limit, limit) - p, point, bounded, self.limit)


class ChainMarquardt(optx.AbstractGaussNewton):
    """Optimistix' Gauss-Newton loop, ended when the whole step to the minimum changes the residuals by < `tolerance`.

    Residuals are in standard deviations. At the end no determined combination of parameters is further from its best
    value than this share of its sigma. `tolerance` and `max_steps` may be traced.
    """

    descent: ChainDescent
    max_steps: Int[Array, ""]
    tolerance: Float[Array, ""]
    close: Float[Array, ""]
    rtol: float = 0.0
    atol: float = 0.0
    norm: Callable = optx.max_norm
    search: optx.AbstractSearch = optx.ClassicalTrustRegion(
        high_cutoff=0.75, low_cutoff=0.01, high_constant=5.0, low_constant=0.1
    )
    verbose: Callable = lambda **_: None

    def step(self, fn, y, args, options, state, tags):
        """As in optimistix, but the rows may take over auxiliary results: those of the first point, and slopes."""
        arguments, begin = args
        # slopes that led to a step that was refused are renewed
        close = ~state.first_step & (state.descent_state.change < self.close**2)
        close = close & (state.num_steps_since_acceptance == 0)
        known = jax.tree.map(lambda a, b: jnp.where(state.first_step, a, b), begin.known, state.aux)
        begin = Begin(known, begin.holds & state.first_step, close)
        y, state, aux = super().step(fn, y, (arguments, begin), options, state, tags)
        step, change = self.descent.steps(state.search_state.step_size, state.descent_state)
        ahead = jax.tree.map(jnp.add, y, step)
        state = eqx.tree_at(lambda s: (s.y_eval, s.descent_state.change), state, (ahead, change))
        return y, state, aux

    def terminate(self, fn, y, args, options, state, tags):
        done = (state.num_accepted_steps > 0) & (state.descent_state.change < self.tolerance**2)
        # When the search only shrinks, rounding lets no step succeed.
        stuck = (state.num_accepted_steps > 0) & (state.num_steps_since_acceptance > _MOST_REJECTED)
        late = state.num_steps >= self.max_steps
        result = optx.RESULTS.where(late & ~(done | stuck), optx.RESULTS.nonlinear_max_steps_reached, state.result)
        return done | stuck | late, result


def minimise(
    rows, point: Point, arguments, known, holds: Bool[ArrayLike, ""], limit: Point, linear: int, max_steps: ArrayLike,
    tolerance: ArrayLike = 0.05, first_damping: ArrayLike = 0.1, close: ArrayLike = 0.0,
):  # fmt: skip
    """Minimise the sum of squares within |unknown| <= `limit` by Levenberg-Marquardt on optimistix' loop.

    **Arguments:** `rows(point, (arguments, begin))` gives `Rows`, linear about the point, and auxiliary results;
    `known`, such results, and whether they hold at the first point; `linear` and `first_damping` as in `ChainDescent`;
    `max_steps` and `tolerance` (`ChainMarquardt`). Where the whole step changes the residuals by less than `close`, the
    slopes need not be renewed (`Begin.close`), unless the step before was refused. Numbers may be traced.
    **Returns:** the point, the auxiliary results of `rows`, half the sum of squares, the number of steps and
    optimistix' result; nothing is raised.
    """
    descent = ChainDescent(limit, linear, jnp.asarray(first_damping))
    solver = ChainMarquardt(
        descent=descent, max_steps=jnp.asarray(max_steps), tolerance=jnp.asarray(tolerance), close=jnp.asarray(close)
    )
    given = arguments, Begin(known, jnp.asarray(holds), jnp.zeros((), bool))
    solution = optx.least_squares(rows, solver, point, given, has_aux=True, max_steps=None, throw=False)
    # The sum of a point and a step to the edge may be beyond the edge by rounding.
    end = jax.tree.map(lambda p, edge: jnp.clip(p, -edge, edge), solution.value, limit)
    cost = 0.5 * sum(jnp.sum(part**2) for part in solution.state.f_info.residual)
    return end, solution.state.aux, cost, solution.stats["num_steps"], solution.result
