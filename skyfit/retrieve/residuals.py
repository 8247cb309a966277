"""Residuals of some times and their slopes: what a joint fit minimises, in few rows a time."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..measured.noise import Loss
from ..numerics.chain import Point, reduced, Rows
from ..transport import AbstractSolver
from .forward import observe, Problem
from .loss import robust
from .parameters import MOVING, PARAMETERS, with_values


class Setup(NamedTuple):
    """What a fit is asked for, all static: names of each time's own and of the shared parameters, loss, steps."""

    own: tuple[str, ...]
    shared: tuple[str, ...]
    loss: Loss
    threshold: float
    model_error: float
    calibrated: bool
    max_steps: int

    @property
    def names(self) -> tuple[str, ...]:
        return self.own + self.shared


class Priors(NamedTuple):
    """Gaussian priors on each parameter's scale: centre and one over sigma (0: none), in the order own, shared.

    `calibration`: one over the sigma of a wavelength's scale. `step`: one over the sigma of the change between two
    neighbours in time.
    """

    centre: Float[Array, " parameter"]
    weight: Float[Array, " parameter"]
    calibration: Float[Array, ""]
    step: Float[Array, "step own"]


class Known(NamedTuple):
    """What the solver said at the last point that was accepted."""

    radiance: Float[Array, "time direction channel"]
    direct: Float[Array, "time channel"] | None
    jacobian: Float[Array, "time sample parameter"]


def bound(names: tuple[str, ...], free: Float[Array, " parameter"]) -> Float[Array, " parameter"]:
    """Values of unconstrained numbers, in the parameters' stated units."""
    return jnp.stack([PARAMETERS[n].bound(free[i]) for i, n in enumerate(names)])


def on_scale(names: tuple[str, ...], free: Float[Array, " parameter"]) -> Float[Array, " parameter"]:
    return jnp.stack([PARAMETERS[n].on_scale(free[i]) for i, n in enumerate(names)])


def _with_slope(function, names: tuple[str, ...], free):
    """A map that acts on each number by itself, and its derivative."""
    return jax.jvp(lambda v: function(names, v), (free,), (jnp.ones_like(free),))


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


def calibration_of(setup: Setup, point: Point, channels: int) -> Float[Array, " channel"]:
    """The instrument's scale of each channel at a point, 1 where it is not fitted."""
    if setup.calibrated:
        return 1.0 + point.shared[len(setup.shared) :]
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


def _readings(names: tuple[str, ...], solver: AbstractSolver, slopes_by: AbstractSolver, fixed, values, one: Problem):
    """What the solver says of one time, and the derivatives by the parameters, `[sample, parameter]`, by another.

    Parameters that move no ray share one pass, each of the others has its own: what does not move costs nothing then.
    """

    def read(solver, part, places, others):
        every: list = [None] * len(names)
        for i, value in [*zip(places, part, strict=True), *others]:
            every[i] = value
        return observe(solver, with_values(fixed, names, every), one)

    def samples(part, places):
        others = [(i, values[i]) for i in range(len(names)) if i not in places]
        return _samples(one, *read(slopes_by, list(part), places, others))

    still = [i for i, name in enumerate(names) if name not in MOVING]
    columns: list = [None] * len(names)
    if still:
        jacobian = jax.jacfwd(lambda part: samples(part, still))(values[jnp.asarray(still)])
        for k, i in enumerate(still):
            columns[i] = jacobian[:, k]
    for i in range(len(names)):
        if i not in still:
            _, columns[i] = jax.jvp(lambda v, i=i: samples([v], [i]), (values[i],), (jnp.ones_like(values[i]),))
    radiance, direct = read(solver, list(values), range(len(names)), [])
    return Known(radiance, direct, jnp.stack(columns, axis=1))


def objective(setup: Setup, solver: AbstractSolver, slopes_by: AbstractSolver):
    """The rows of all times, linear about the point, for `minimise`."""
    names, count = setup.names, len(setup.own)

    def rows(point: Point, arguments):
        fixed, problem, priors, scale = arguments
        here = jax.lax.stop_gradient(point)
        channels = problem.measured.shape[2]
        shared, calibration = here.shared[: len(setup.shared)], calibration_of(setup, here, channels)

        def known_at(item):
            own, one = item
            free = jnp.concatenate([own, shared])
            values, slope = _with_slope(bound, names, free)
            return _readings(names, solver, slopes_by, fixed, values, one), slope

        known, slopes = jax.lax.map(known_at, (here.own, problem))
        residual, weight = whitened(problem, known, calibration, scale)
        after = robust(residual, setup.loss, setup.threshold)
        by_value = known.jacobian * (after.slope * weight * instrument_gain(calibration, problem))[..., None]
        by_channel = None
        if setup.calibrated:
            by_channel = known.radiance * (after.slope * weight)[:, : known.radiance[0].size].reshape(
                known.radiance.shape
            )
        scaled, steep = (
            jax.vmap(lambda own: _with_slope(on_scale, setup.own, own))(here.own) if count else (here.own, here.own)
        )
        prior = (scaled - priors.centre[None, :count]) * priors.weight[None, :count]
        own, common, right = rows_of_times(
            by_value * slopes[:, None], after.value[..., None], by_channel, steep * priors.weight[None, :count],
            prior[..., None],
        )  # fmt: skip
        step = (scaled[1:] - scaled[:-1]) * priors.step
        shared_value, shared_slope = shared_priors(setup, here.shared, priors)
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


def shared_priors(setup: Setup, shared, priors: Priors):
    """Residuals of the shared parameters' and the scales' priors, and their slopes."""
    count, first = len(setup.shared), len(setup.own)
    scales = shared[count:] * priors.calibration
    if not count:
        return scales, jnp.broadcast_to(priors.calibration, scales.shape)
    scaled, steep = _with_slope(on_scale, setup.shared, shared[:count])
    value = (scaled - priors.centre[first:]) * priors.weight[first:]
    slope = steep * priors.weight[first:]
    return jnp.concatenate([value, scales]), jnp.concatenate(
        [slope, jnp.broadcast_to(priors.calibration, scales.shape)]
    )
