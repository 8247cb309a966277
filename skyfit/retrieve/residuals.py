"""Residuals of some times and their slopes, which a joint fit minimises, reduced to few rows for each time."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..measured.noise import Loss
from ..numerics.chain import Begin, Point, reduced, Rows
from ..numerics.least_squares import LOGISTIC_LIMIT
from ..transport import AbstractSolver
from .components import Expected
from .forward import observe, Problem
from .loss import Robust, robust
from .model import SkyModel
from .parameters import PARAMETERS, POINTING, with_values


# for double precision or not: step of the difference quotients as a share of the range, and whether they are two-sided
_DIFFERENCE = {True: (1e-4, False), False: (5e-3, True)}


class Choices(NamedTuple):
    """The static choices of a retrieval: names of each time's own and of the shared parameters, loss, calibration."""

    own: tuple[str, ...]
    shared: tuple[str, ...]
    loss: Loss
    calibrated: bool

    @property
    def names(self) -> tuple[str, ...]:
        return self.own + self.shared


class Numbers(NamedTuple):
    """Traced settings: another value needs no new compilation.

    `threshold` of the loss in standard deviations; `model_error`, relative; `max_steps` of each search; `expected`
    sizes of the shared errors; `level`, relative size of an error that all samples of a time share.
    """

    threshold: Float[Array, ""]
    model_error: Float[Array, ""]
    max_steps: Int[Array, ""]
    expected: Expected
    level: Float[Array, ""]


class Priors(NamedTuple):
    """Gaussian priors on each parameter's scale: centre and one over sigma (0: none), in the order own, shared.

    `calibration`: one over the sigma of a wavelength's scale, None where the scale is exact. `step`: one over the sigma
    of the change between two neighbours in time. `smooth`: linear combinations of parameters, on their scales and over
    the sigma, with a prior mean of 0. No combination mixes own and shared parameters.
    """

    centre: Float[Array, " parameter"]
    inverse_sigma: Float[Array, " parameter"]
    calibration: Float[Array, ""] | None
    step: Float[Array, "step own"]
    smooth: Float[Array, "row parameter"]

    def rows(self) -> Float[Array, "row parameter"]:
        """The slopes of the priors by the parameters: of single parameters first, then of combinations."""
        return jnp.concatenate([jnp.diag(self.inverse_sigma), self.smooth])

    def residual(self, scaled: Float[Array, " parameter"]) -> Float[Array, " row"]:
        """The residuals of the priors, in the order of `rows`, at the parameters' positions on their scales."""
        return jnp.concatenate([(scaled - self.centre) * self.inverse_sigma, self.smooth @ scaled])

    def of(self, which: slice) -> "Priors":
        """The priors of some of the parameters."""
        centre, inverse_sigma = self.centre[which], self.inverse_sigma[which]
        return self._replace(centre=centre, inverse_sigma=inverse_sigma, smooth=self.smooth[:, which])


class Weighing(NamedTuple):
    """The weighting of the sky's samples, of one time or with a time axis.

    `scale`: the noise over the stated noise. `excess`: the parameters' uncertainty over that by independent noise. The
    priors, except those of calibration, and the measurements besides the radiance are multiplied by `excess`.
    """

    scale: Float[Array, "*time"]
    excess: Float[Array, "*time"]

    def of_all(self) -> Float[Array, ""]:
        """The excess for what all times share."""
        return jnp.sqrt(jnp.mean(self.excess**2))


class Known(NamedTuple):
    """The solver's output at the last accepted point, of one time, or with a time axis in front.

    `jacobian`: slopes by the parameters on their scales. `turn`: slopes by the two pointing offsets in radians.
    """

    radiance: Float[Array, "*time direction channel"]
    beside: Float[Array, "*time other"] | None
    jacobian: Float[Array, "*time sample parameter"]
    turn: Float[Array, "*time direction channel axis"]


def ends_of(names: tuple[str, ...], dtype) -> tuple[Float[Array, " parameter"], Float[Array, " parameter"]]:
    """The bounds of the parameters on their scales."""
    ends = np.array([PARAMETERS[n].ends() for n in names]).reshape(-1, 2)
    return jnp.asarray(ends[:, 0], dtype), jnp.asarray(ends[:, 1], dtype)


def on_scale(names: tuple[str, ...], free: Float[Array, " parameter"]) -> Float[Array, " parameter"]:
    """Positions of unconstrained numbers on the parameters' scales, all at once: fewer programs to compile."""
    low, high = ends_of(names, free.dtype)
    return low + (high - low) * jax.nn.sigmoid(free)


def from_scale(names: tuple[str, ...], scaled: Float[Array, " parameter"]) -> Float[Array, " parameter"]:
    """Values at positions on the parameters' scales, in the parameters' stated units."""
    log = np.array([PARAMETERS[n].log for n in names], bool)
    return jnp.where(log, jnp.exp(jnp.where(log, scaled, 0.0)), scaled)


def bound(names: tuple[str, ...], free: Float[Array, " parameter"]) -> Float[Array, " parameter"]:
    """Values of unconstrained numbers, in the parameters' stated units."""
    return from_scale(names, on_scale(names, free))


def values_at(choices: Choices, point: Point) -> Float[Array, "time parameter"]:
    """Values of each time, in the parameters' stated units, in the order own, shared."""
    shared = jnp.broadcast_to(point.shared[: len(choices.shared)], (point.own.shape[0], len(choices.shared)))
    return jax.vmap(lambda free: bound(choices.names, free))(jnp.concatenate([point.own, shared], axis=1))


def _with_slope(names: tuple[str, ...], free):
    """`on_scale`, which acts on each number by itself, and its derivative."""
    return jax.jvp(lambda v: on_scale(names, v), (free,), (jnp.ones_like(free),))


def _samples(radiance, beside):
    """Join the sky and the measurements besides the radiance to one row of samples."""
    return radiance.reshape(-1) if beside is None else jnp.concatenate([radiance.reshape(-1), beside])


def weight_of(one: Problem, weighing: Weighing) -> Float[Array, " sample"]:
    """The weight of every sample of one time before the loss, 0 where masked; those besides the radiance come last."""
    sky = one.weight.reshape(-1) / weighing.scale
    return sky if one.beside_weight is None else jnp.concatenate([sky, one.beside_weight * weighing.excess])


def trusted(choices: Choices, threshold, one: Problem, known: Known, calibration, weighing: Weighing) -> Robust:
    """The weighted residuals of one time after the loss, which does not act on those besides the radiance."""
    residual = _samples(known.radiance * calibration[None] - one.measured, beside_residual(one, known))
    plain = residual * weight_of(one, weighing)
    after = robust(plain, choices.loss, threshold)
    sky = jnp.arange(plain.size) < one.measured.size
    return Robust(*(jnp.where(sky, part, end) for part, end in zip(after, (plain, 1.0, 1.0), strict=True)))


def beside_residual(one: Problem, known: Known) -> Float[Array, " other"] | None:
    """Model minus measurement for the measurements besides the radiance, or None."""
    return None if one.beside is None or known.beside is None else known.beside - one.beside


def box(choices: Choices, point: Point) -> Point:
    """The largest distance from 0 of each unknown of a point, infinite for the channels' scales."""
    scales = point.shared.size - len(choices.shared)
    shared = jnp.concatenate([jnp.full(len(choices.shared), LOGISTIC_LIMIT), jnp.full(scales, jnp.inf)])
    own = jnp.full_like(point.own, LOGISTIC_LIMIT)
    return Point(own, shared.astype(own.dtype))


def calibration_of(choices: Choices, point: Point, channels: int) -> Float[Array, " channel"]:
    """The instrument's scale of each channel at a point, 1 where it is not fitted."""
    if choices.calibrated:
        return 1.0 + point.shared[len(choices.shared) :]
    return jnp.ones(channels, point.own.dtype)


def columns_of(choices: Choices, one: Problem, known: Known, calibration, unit) -> Float[Array, "sample column"]:
    """The slopes of one time's samples by all unknowns, in the order own, shared, the channels' scales.

    **Arguments:** `unit`, the unit of each parameter's slope, as a length on the parameter's scale.
    """
    columns = known.jacobian * instrument_gain(calibration, one)[:, None] * unit[None]
    if not choices.calibrated:
        return columns
    channels = known.radiance.shape[1]
    scales = known.radiance[..., None] * jnp.eye(channels, dtype=known.radiance.dtype)[None]
    scales = scales.reshape(-1, channels)
    beam = jnp.zeros((columns.shape[0] - scales.shape[0], channels), scales.dtype)
    return jnp.concatenate([columns, jnp.concatenate([scales, beam])], axis=1)


def reduced_rows(choices: Choices, rows, right, slope, prior_right):
    """Reduce the rows of one time to few, and append those of the priors of its own parameters.

    **Arguments:** `rows` `[row, column]`, columns as of `columns_of`; `right` `[row, side]`; `slope` `[row, own]` and
    `prior_right`, slopes and right-hand sides of the own parameters' priors.
    **Returns:** own, common (the channels' scales last), right.
    """
    count = len(choices.own)
    own, common, right = reduced(rows[:, :count], rows[:, count:], right, rows.shape[1] + 1)
    nothing = jnp.zeros((slope.shape[0], common.shape[1]), common.dtype)
    return (
        jnp.concatenate([own, slope]),
        jnp.concatenate([common, nothing]),
        jnp.concatenate([right, prior_right]),
    )


def nothing_known(problem: Problem, count: int) -> Known:
    """Zeros in the place of the solver's output and its slopes by `count` parameters, of all times or of one."""
    beside = problem.beside
    *times, directions, channels = problem.measured.shape
    rows = directions * channels + (0 if beside is None else beside.shape[-1])
    return Known(
        jnp.zeros_like(problem.measured),
        None if beside is None else jnp.zeros_like(beside),
        jnp.zeros((*times, rows, count), problem.measured.dtype),
        jnp.zeros((*problem.measured.shape, len(POINTING)), problem.measured.dtype),
    )


def linearised(
    names: tuple[str, ...],
    solver: AbstractSolver,
    slopes_by: AbstractSolver | None,
    fixed: SkyModel,
    scaled,
    one: Problem,
    begin: Begin,
    exact: Bool[Array, ""],
) -> Known:
    """The solver's output for one time, and its slopes by the parameters on their scales.

    What is known of this point is taken over, and so are slopes where the end is close (`Begin`). New slopes are those
    of `slopes_by`, or of the solver itself with `exact` or without `slopes_by`. They are difference quotients over a
    small share of each range, kept inside it: one-sided in double precision, two-sided over a larger share in single
    precision. A loop of traced length through each solver gives values and slopes, so that one copy of each is
    compiled. Compiling forward-mode slopes would take most of the time of a first retrieval.
    """
    count = len(names)
    # the slopes by the pointing are needed even if it is not fitted
    others = [n for n in POINTING if n not in names]
    names = names + tuple(others)
    held = [PARAMETERS[n].from_leaf(PARAMETERS[n].leaf(fixed)) for n in others]
    scaled = jnp.concatenate([scaled, jnp.stack(held).astype(scaled.dtype)]) if others else scaled
    low, high = ends_of(names, scaled.dtype)
    share, both = _DIFFERENCE[scaled.dtype == jnp.float64]
    step = share * (high - low)
    if both:
        ahead, behind = jnp.minimum(scaled + step, high) - scaled, jnp.maximum(scaled - step, low) - scaled
        moves = jnp.concatenate([jnp.diag(ahead), jnp.diag(behind)])
    else:
        ahead, behind = jnp.where(scaled + step <= high, step, -step), jnp.zeros_like(step)
        moves = jnp.diag(ahead)
    points = scaled[None] + jnp.concatenate([jnp.zeros_like(moves[:1]), moves])
    known = begin.known
    old = _samples(known.radiance, known.beside)

    def first(solver, some):
        """Samples at the first `some` points."""

        def at(i, found):
            reading = observe(solver, with_values(fixed, names, from_scale(names, points[i])), one)
            return found.at[i].set(_samples(reading.radiance, reading.beside))

        return jax.lax.fori_loop(0, some, at, jnp.zeros((len(points), old.size), old.dtype))

    every, none = len(points), jnp.zeros((), int)
    if slopes_by is None:
        samples = first(solver, jnp.where(begin.holds, none, jnp.where(begin.close, 1, every)))
        values, renewed = jnp.where(begin.holds, old, samples[0]), ~(begin.holds | begin.close)
    else:
        coarse = first(slopes_by, jnp.where(exact | begin.close, none, every))
        whole = first(solver, jnp.where(exact & ~begin.close, every, 1))
        samples, values, renewed = jnp.where(exact, whole, coarse), whole[0], ~begin.close
    after, before = samples[1 : len(names) + 1], samples[len(names) + 1 :] if both else samples[:1]
    jacobian = ((after - before) / (ahead - behind)[:, None]).T
    turn = jnp.stack([jacobian[: known.radiance.size, names.index(n)] for n in POINTING], axis=-1) * (180.0 / np.pi)
    radiance, beside = values[: known.radiance.size], values[known.radiance.size :]
    return Known(
        radiance.reshape(known.radiance.shape),
        None if known.beside is None else beside,
        jnp.where(renewed, jacobian[:, :count], known.jacobian),
        jnp.where(renewed, turn.reshape(known.turn.shape), known.turn),
    )


def objective(choices: Choices, solver: AbstractSolver, slopes_by: AbstractSolver | None):
    """The function for `minimise` that gives the rows of all times, linear about the point."""
    names, count = choices.names, len(choices.own)

    def rows(point: Point, given: tuple[tuple, Begin]):
        (fixed, problem, priors, weighing, threshold, exact), begin = given
        here = jax.lax.stop_gradient(point)
        channels = problem.measured.shape[2]
        shared, calibration = here.shared[: len(choices.shared)], calibration_of(choices, here, channels)
        scaled, steep = jax.vmap(lambda own: _with_slope(choices.own, own))(here.own) if count else (here.own, here.own)
        mine = priors.of(slice(0, count))
        prior = jax.vmap(mine.residual)(scaled) * weighing.excess[:, None]
        tight = mine.rows()[None] * steep[:, None] * weighing.excess[:, None, None]

        def at(item):
            own, one, weighing, tight, prior, known = item
            scaled, slope = _with_slope(names, jnp.concatenate([own, shared]))
            known = linearised(names, solver, slopes_by, fixed, scaled, one, begin._replace(known=known), exact)
            after = trusted(choices, threshold, one, known, calibration, weighing)
            columns = columns_of(choices, one, known, calibration, slope)
            columns = columns * (weight_of(one, weighing) * after.slope)[:, None]
            return reduced_rows(choices, columns, after.value[:, None], tight, prior[:, None]), known

        items = here.own, problem, weighing, tight, prior, begin.known
        (own, common, right), known = jax.lax.map(at, items)
        link = priors.step * weighing.of_all()
        step = (scaled[1:] - scaled[:-1]) * link
        shared_value, shared_slope = shared_priors(choices, here.shared, priors, weighing.of_all())
        move = jax.tree.map(jnp.subtract, point, here)
        data = right[..., 0] + jnp.einsum("trp,tp->tr", own, move.own) + jnp.einsum("trs,s->tr", common, move.shared)
        stepped = step + link * (steep[1:] * move.own[1:] - steep[:-1] * move.own[:-1])
        return Rows(data, shared_value + shared_slope @ move.shared, stepped), known

    return rows


def instrument_gain(calibration, one: Problem) -> Float[Array, " sample"]:
    """The instrument's scale of every sample of one time, 1 for measurements besides the radiance."""
    sky = jnp.broadcast_to(calibration[None], one.measured.shape).reshape(-1)
    return sky if one.beside is None else jnp.concatenate([sky, jnp.ones(one.beside.shape[0], sky.dtype)])


def shared_priors(choices: Choices, shared, priors: Priors, excess):
    """Residuals of the shared parameters' and the scales' priors, and their slopes `[row, shared]`."""
    count, first = len(choices.shared), len(choices.own)
    value, slope = shared[:0], jnp.zeros((0, count), shared.dtype)
    if count:
        scaled, steep = _with_slope(choices.shared, shared[:count])
        mine = priors.of(slice(first, None))
        value, slope = mine.residual(scaled) * excess, mine.rows() * steep[None] * excess
    if priors.calibration is None:
        return value, slope
    scales = shared[count:] * priors.calibration
    return jnp.concatenate([value, scales]), with_scales(slope, priors.calibration, scales.size)


def with_scales(rows: Float[Array, "row shared"], calibration, scales: int) -> Float[Array, "more column"]:
    """Append a column and a row for each channel's scale to the rows of the shared parameters' priors."""
    own = jnp.diag(jnp.full(scales, calibration, rows.dtype))
    above = jnp.pad(rows, ((0, 0), (0, scales)))
    return jnp.concatenate([above, jnp.pad(own, ((0, 0), (rows.shape[1], 0)))])


def cost(choices: Choices, priors: Priors, point: Point, residual, weighing: Weighing) -> Float[Array, ""]:
    """Half the sum of squares of the residuals after the loss, `residual`, and of the priors."""
    total = jnp.sum(residual**2)
    count = len(choices.own)
    if count:
        scaled = jax.vmap(lambda own: on_scale(choices.own, own))(point.own)
        prior = jax.vmap(priors.of(slice(0, count)).residual)(scaled)
        total += jnp.sum((prior * weighing.excess[:, None]) ** 2)
        total += jnp.sum(((scaled[1:] - scaled[:-1]) * priors.step * weighing.of_all()) ** 2)
    return 0.5 * (total + jnp.sum(shared_priors(choices, point.shared, priors, weighing.of_all())[0] ** 2))
