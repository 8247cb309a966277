"""Residuals of some times and their slopes: what a joint fit minimises, in few rows a time."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..measured.noise import Loss
from ..numerics.chain import Point, reduced, Rows
from ..transport import AbstractSolver
from .forward import observe, Problem
from .loss import robust
from .model import SkyModel
from .parameters import PARAMETERS, with_values


# whether precision is double: the share of a parameter's range over which slopes are taken, and whether to both sides
_DIFFERENCE = {True: (1e-4, False), False: (5e-3, True)}


class Choices(NamedTuple):
    """What a retrieval is compiled for: names of each time's own and of the shared parameters, loss, calibration."""

    own: tuple[str, ...]
    shared: tuple[str, ...]
    loss: Loss
    calibrated: bool

    @property
    def names(self) -> tuple[str, ...]:
        return self.own + self.shared


class Numbers(NamedTuple):
    """Settings that are traced: another value compiles nothing.

    `threshold` of the loss in standard deviations; `model_error`, relative; `max_steps` of each search.
    """

    threshold: Float[Array, ""]
    model_error: Float[Array, ""]
    max_steps: Int[Array, ""]


class Priors(NamedTuple):
    """Gaussian priors on each parameter's scale: centre and one over sigma (0: none), in the order own, shared.

    `calibration`: one over the sigma of a wavelength's scale, None where the scale is exact. `step`: one over the sigma
    of the change between two neighbours in time.
    """

    centre: Float[Array, " parameter"]
    inverse_sigma: Float[Array, " parameter"]
    calibration: Float[Array, ""] | None
    step: Float[Array, "step own"]


class Known(NamedTuple):
    """What the solver said at the last point that was accepted; slopes are by the parameters on their scales."""

    radiance: Float[Array, "time direction channel"]
    direct: Float[Array, "time channel"] | None
    jacobian: Float[Array, "time sample parameter"]


def bound(names: tuple[str, ...], free: Float[Array, " parameter"]) -> Float[Array, " parameter"]:
    """Values of unconstrained numbers, in the parameters' stated units."""
    return jnp.stack([PARAMETERS[n].bound(free[i]) for i, n in enumerate(names)])


def on_scale(names: tuple[str, ...], free: Float[Array, " parameter"]) -> Float[Array, " parameter"]:
    return jnp.stack([PARAMETERS[n].on_scale(free[i]) for i, n in enumerate(names)])


def _with_slope(names: tuple[str, ...], free):
    """`on_scale`, which acts on each number by itself, and its derivative."""
    return jax.jvp(lambda v: on_scale(names, v), (free,), (jnp.ones_like(free),))


def _samples(one: Problem, radiance, direct):
    """Sky and direct beam in one row of samples."""
    return radiance.reshape(-1) if one.direct is None else jnp.concatenate([radiance.reshape(-1), direct])


def whitened(problem: Problem, known: Known, calibration, scale):
    """Residuals over sigma and weights over all samples of each time, `[time, sample]`, and the model beside them."""
    model = known.radiance * calibration[None, None]
    weight = (problem.weight / scale[:, None, None]).reshape(model.shape[0], -1)
    residual = (model - problem.measured).reshape(model.shape[0], -1)
    if known.direct is None or problem.direct is None or problem.direct_weight is None:
        return residual * weight, weight
    direct = (known.direct - problem.direct) * problem.direct_weight / scale[:, None]
    weights = jnp.concatenate([weight, problem.direct_weight / scale[:, None]], axis=1)
    return jnp.concatenate([residual * weight, direct], axis=1), weights


def calibration_of(choices: Choices, point: Point, channels: int) -> Float[Array, " channel"]:
    """The instrument's scale of each channel at a point, 1 where it is not fitted."""
    if choices.calibrated:
        return 1.0 + point.shared[len(choices.shared) :]
    return jnp.ones(channels, point.own.dtype)


def rows_of_times(columns, right, by_channel, prior_slope, prior_right):
    """The rows of all times as few, with a row for the prior of each of a time's own parameters.

    **Arguments:** `columns` `[time, sample, parameter]`, own ones first; `right` `[time, sample, side]`; `by_channel`
    as in `_reduced_time`, of each time; slopes and right-hand sides of the own parameters' priors.
    **Returns:** own, common (the channels' scales last), right.
    """
    times, count = prior_slope.shape

    def reduced_at(item):
        columns, right, by_channel = item
        return _reduced_time(columns[:, :count], columns[:, count:], by_channel, right)

    own, common, reduced_right = jax.vmap(reduced_at)((columns, right, by_channel))
    diagonal = prior_slope[:, :, None] * jnp.eye(count, dtype=own.dtype)[None]
    nothing = jnp.zeros((times, count, common.shape[2]), common.dtype)
    return (
        jnp.concatenate([own, diagonal], axis=1),
        jnp.concatenate([common, nothing], axis=1),
        jnp.concatenate([reduced_right, prior_right], axis=1),
    )


def _reduced_time(own, common, by_channel, right):
    """One time's rows as few: each channel's scale touches its own samples only, and goes first.

    `by_channel`: derivative of each sky sample by its channel's scale, `[direction, channel]`, or None. Returns own,
    common (the channels' scales last) and right-hand sides of a channel's and a parameter's rows.
    """
    width = own.shape[1], common.shape[1]
    count = sum(width) + 1
    if by_channel is None:
        return reduced(own, common, right, count)
    sky, channels = by_channel.size, by_channel.shape[1]
    everything = jnp.concatenate([own, common, right], axis=1)
    columns = everything[:sky].reshape(-1, channels, everything.shape[1])
    length = jnp.sqrt(jnp.sum(by_channel**2, axis=0))
    unit = by_channel / jnp.where(length > 0.0, length, 1.0)[None]
    along = jnp.einsum("dc,dcn->cn", unit, columns)
    across = (columns - unit[..., None] * along[None]).reshape(sky, -1)
    rest = jnp.concatenate([across, everything[sky:]])
    rows = reduced(rest[:, : width[0]], rest[:, width[0] : sum(width)], rest[:, sum(width) :], count)
    nothing = jnp.zeros((count, channels), own.dtype)
    return (
        jnp.concatenate([along[:, : width[0]], rows[0]]),
        jnp.concatenate(
            [
                jnp.concatenate([along[:, width[0] : sum(width)], jnp.diag(length)], axis=1),
                jnp.concatenate([rows[1], nothing], axis=1),
            ]
        ),
        jnp.concatenate([along[:, sum(width) :], rows[2]]),
    )


def linearised(
    names: tuple[str, ...],
    solver: AbstractSolver,
    slopes_by: AbstractSolver | None,
    fixed: SkyModel,
    scaled,
    one: Problem,
) -> Known:
    """What the solver says of one time, and its slopes by the parameters on their scales, by `slopes_by` if given.

    The slopes are differences over a small share of each range, kept inside it: to one side in double precision, to
    both sides, over more, in single. Values and slopes then are one loop through one copy of the solver: compiling
    forward-mode slopes would take most of a first retrieval.
    """
    low, high = (jnp.asarray(ends, scaled.dtype) for ends in zip(*(PARAMETERS[n].ends() for n in names), strict=True))
    share, both = _DIFFERENCE[scaled.dtype == jnp.float64]
    step = share * (high - low)
    if both:
        ahead, behind = jnp.minimum(scaled + step, high) - scaled, jnp.maximum(scaled - step, low) - scaled
        moves = jnp.concatenate([jnp.diag(ahead), jnp.diag(behind)])
    else:
        ahead, behind = jnp.where(scaled + step <= high, step, -step), jnp.zeros_like(step)
        moves = jnp.diag(ahead)
    points = scaled[None] + jnp.concatenate([jnp.zeros_like(moves[:1]), moves])

    def read(solver, scaled):
        values = [PARAMETERS[n].from_scale(scaled[i]) for i, n in enumerate(names)]
        return observe(solver, with_values(fixed, names, values), one)

    every = jax.lax.map(lambda point: read(slopes_by or solver, point), points)
    samples = jax.vmap(lambda sky, beam: _samples(one, sky, beam))(*every)
    radiance, direct = jax.tree.map(lambda v: v[0], every) if slopes_by is None else read(solver, scaled)
    count = len(names)
    after, before = samples[1 : count + 1], samples[count + 1 :] if both else samples[:1]
    return Known(radiance, direct, ((after - before) / (ahead - behind)[:, None]).T)


def objective(choices: Choices, solver: AbstractSolver, slopes_by: AbstractSolver | None):
    """The rows of all times, linear about the point, for `minimise`."""
    names, count = choices.names, len(choices.own)

    def rows(point: Point, arguments):
        fixed, problem, priors, scale, threshold = arguments
        here = jax.lax.stop_gradient(point)
        channels = problem.measured.shape[2]
        shared, calibration = here.shared[: len(choices.shared)], calibration_of(choices, here, channels)

        def known_at(item):
            own, one = item
            scaled, slope = _with_slope(names, jnp.concatenate([own, shared]))
            return linearised(names, solver, slopes_by, fixed, scaled, one), slope

        known, slopes = jax.lax.map(known_at, (here.own, problem))
        residual, weight = whitened(problem, known, calibration, scale)
        after = robust(residual, choices.loss, threshold)
        by_value = known.jacobian * (after.slope * weight * instrument_gain(calibration, problem))[..., None]
        by_channel = None
        if choices.calibrated:
            by_channel = known.radiance * (after.slope * weight)[:, : known.radiance[0].size].reshape(
                known.radiance.shape
            )
        scaled, steep = jax.vmap(lambda own: _with_slope(choices.own, own))(here.own) if count else (here.own, here.own)
        prior = (scaled - priors.centre[None, :count]) * priors.inverse_sigma[None, :count]
        own, common, right = rows_of_times(
            by_value * slopes[:, None], after.value[..., None], by_channel, steep * priors.inverse_sigma[None, :count],
            prior[..., None],
        )  # fmt: skip
        step = (scaled[1:] - scaled[:-1]) * priors.step
        shared_value, shared_slope = shared_priors(choices, here.shared, priors)
        move = jax.tree.map(jnp.subtract, point, here)
        data = right[..., 0] + jnp.einsum("trp,tp->tr", own, move.own) + jnp.einsum("trs,s->tr", common, move.shared)
        stepped = step + priors.step * (steep[1:] * move.own[1:] - steep[:-1] * move.own[:-1])
        return Rows(data, shared_value + shared_slope * move.shared, stepped), known

    return rows


def instrument_gain(calibration, problem: Problem):
    """The instrument's scale of every sample, 1 for the direct beam."""
    sky = jnp.broadcast_to(calibration[None], problem.measured.shape[1:]).reshape(-1)
    if problem.direct is None:
        return sky[None]
    return jnp.concatenate([sky, jnp.ones(problem.direct.shape[1], sky.dtype)])[None]


def shared_priors(choices: Choices, shared, priors: Priors):
    """Residuals of the shared parameters' and the scales' priors, and their slopes."""
    count, first = len(choices.shared), len(choices.own)
    value, slope = shared[:0], shared[:0]
    if count:
        scaled, steep = _with_slope(choices.shared, shared[:count])
        value = (scaled - priors.centre[first:]) * priors.inverse_sigma[first:]
        slope = steep * priors.inverse_sigma[first:]
    if priors.calibration is None:
        return value, slope
    scales = shared[count:] * priors.calibration
    return jnp.concatenate([value, scales]), jnp.concatenate(
        [slope, jnp.broadcast_to(priors.calibration, scales.shape)]
    )


def cost(choices: Choices, numbers: Numbers, priors: Priors, point: Point, residual) -> Float[Array, ""]:
    """Half the sum of squares after the loss, priors included."""
    total = jnp.sum(robust(residual, choices.loss, numbers.threshold).value ** 2)
    count = len(choices.own)
    if count:
        scaled = jax.vmap(lambda own: on_scale(choices.own, own))(point.own)
        total += jnp.sum(((scaled - priors.centre[None, :count]) * priors.inverse_sigma[None, :count]) ** 2)
        total += jnp.sum(((scaled[1:] - scaled[:-1]) * priors.step) ** 2)
    return 0.5 * (total + jnp.sum(shared_priors(choices, point.shared, priors)[0] ** 2))
