"""Residuals of some times and their slopes: what a joint fit minimises, in few rows a time."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..measured.noise import Loss
from ..numerics.chain import Point, reduced, Rows
from ..transport import AbstractSolver
from .components import Expected, whiten, Whitening
from .forward import observe, Problem
from .loss import robust
from .model import SkyModel
from .parameters import PARAMETERS, POINTING, with_values


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

    `threshold` of the loss in standard deviations; `model_error`, relative; `max_steps` of each search; `expected`
    sizes of the errors that the wavelengths of a direction share; `level`, relative, of an error common to a time.
    """

    threshold: Float[Array, ""]
    model_error: Float[Array, ""]
    max_steps: Int[Array, ""]
    expected: Expected
    level: Float[Array, ""]


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
    """What the solver said at the last point that was accepted: slopes by the parameters on their scales, and `turn`,
    those by the instrument's two pointing offsets in radians. Of one time, or with a time axis in front."""

    radiance: Float[Array, "*time direction channel"]
    direct: Float[Array, "*time channel"] | None
    jacobian: Float[Array, "*time sample parameter"]
    turn: Float[Array, "*time direction channel axis"]


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


def to_rows(
    one: Problem, white: Whitening, samples: Float[Array, "sample column"]
) -> tuple[Float[Array, "row column"], Float[Array, "beam column"]]:
    """Samples of one time as rows of size 1: of the sky, by its whitening, and of the direct beam."""
    directions, channels = one.measured.shape
    sky, beam = samples[: directions * channels], samples[directions * channels :]
    rows = whiten(white, sky.reshape(directions, channels, -1))
    if one.direct_weight is not None:
        beam = beam * one.direct_weight[:, None]
    return rows.reshape(-1, rows.shape[2]), beam


class Whitened(NamedTuple):
    """Residuals of one time in independent rows of size 1, after the loss: those of the direct beam are never trusted
    less. `value`, `slope` and `weight` as in `Robust`; `plain` before the loss."""

    value: Float[Array, " row"]
    slope: Float[Array, " row"]
    weight: Float[Array, " row"]
    plain: Float[Array, " row"]


def whitened(choices: Choices, threshold, one: Problem, known: Known, calibration, white: Whitening) -> Whitened:
    """The residuals of one time."""
    residual = _samples(one, known.radiance * calibration[None] - one.measured, beam_residual(one, known))
    sky, beam = to_rows(one, white, residual[:, None])
    after = robust(sky[:, 0], choices.loss, threshold)
    ones = jnp.ones_like(beam[:, 0])
    parts = zip((*after, sky[:, 0]), (beam[:, 0], ones, ones, beam[:, 0]), strict=True)
    return Whitened(*(jnp.concatenate(part) for part in parts))


def beam_residual(one: Problem, known: Known) -> Float[Array, " channel"] | None:
    """The model's direct beam minus the measured one, or None."""
    return None if one.direct is None or known.direct is None else known.direct - one.direct


def calibration_of(choices: Choices, point: Point, channels: int) -> Float[Array, " channel"]:
    """The instrument's scale of each channel at a point, 1 where it is not fitted."""
    if choices.calibrated:
        return 1.0 + point.shared[len(choices.shared) :]
    return jnp.ones(channels, point.own.dtype)


def columns_of(choices: Choices, one: Problem, known: Known, calibration, unit) -> Float[Array, "sample column"]:
    """The slopes of one time's samples by all that is fitted, own, shared, and the channels' scales last.

    **Arguments:** `unit`, of each parameter, by that on its scale.
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
    """One time's rows as few, with a row for the prior of each of its own parameters.

    **Arguments:** `rows` `[row, column]`, columns as of `columns_of`; `right` `[row, side]`; slopes and right-hand
    sides of the own parameters' priors.
    **Returns:** own, common (the channels' scales last), right.
    """
    count = len(choices.own)
    own, common, right = reduced(rows[:, :count], rows[:, count:], right, rows.shape[1] + 1)
    nothing = jnp.zeros((count, common.shape[1]), common.dtype)
    return (
        jnp.concatenate([own, jnp.diag(slope)]),
        jnp.concatenate([common, nothing]),
        jnp.concatenate([right, prior_right]),
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
    count = len(names)
    # where the instrument looked moves the samples even if it is not fitted
    others = [n for n in POINTING if n not in names]
    names = names + tuple(others)
    held = [PARAMETERS[n].from_leaf(PARAMETERS[n].leaf(fixed)) for n in others]
    scaled = jnp.concatenate([scaled, jnp.stack(held).astype(scaled.dtype)]) if others else scaled
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
    after, before = samples[1 : len(names) + 1], samples[len(names) + 1 :] if both else samples[:1]
    jacobian = ((after - before) / (ahead - behind)[:, None]).T
    turn = jnp.stack([jacobian[: radiance.size, names.index(n)] for n in POINTING], axis=-1) * (180.0 / np.pi)
    return Known(radiance, direct, jacobian[:, :count], turn.reshape(*radiance.shape, len(POINTING)))


def objective(choices: Choices, solver: AbstractSolver, slopes_by: AbstractSolver | None):
    """The rows of all times, linear about the point, for `minimise`."""
    names, count = choices.names, len(choices.own)

    def rows(point: Point, arguments):
        fixed, problem, priors, white, threshold = arguments
        here = jax.lax.stop_gradient(point)
        channels = problem.measured.shape[2]
        shared, calibration = here.shared[: len(choices.shared)], calibration_of(choices, here, channels)
        scaled, steep = jax.vmap(lambda own: _with_slope(choices.own, own))(here.own) if count else (here.own, here.own)
        prior = (scaled - priors.centre[None, :count]) * priors.inverse_sigma[None, :count]
        tight = steep * priors.inverse_sigma[None, :count]

        def at(item):
            own, one, white, tight, prior = item
            scaled, slope = _with_slope(names, jnp.concatenate([own, shared]))
            known = linearised(names, solver, slopes_by, fixed, scaled, one)
            after = whitened(choices, threshold, one, known, calibration, white)
            columns = jnp.concatenate(to_rows(one, white, columns_of(choices, one, known, calibration, slope)))
            columns = columns * after.slope[:, None]
            return reduced_rows(choices, columns, after.value[:, None], tight, prior[:, None]), known

        (own, common, right), known = jax.lax.map(at, (here.own, problem, white, tight, prior))
        step = (scaled[1:] - scaled[:-1]) * priors.step
        shared_value, shared_slope = shared_priors(choices, here.shared, priors)
        move = jax.tree.map(jnp.subtract, point, here)
        data = right[..., 0] + jnp.einsum("trp,tp->tr", own, move.own) + jnp.einsum("trs,s->tr", common, move.shared)
        stepped = step + priors.step * (steep[1:] * move.own[1:] - steep[:-1] * move.own[:-1])
        return Rows(data, shared_value + shared_slope * move.shared, stepped), known

    return rows


def instrument_gain(calibration, one: Problem) -> Float[Array, " sample"]:
    """The instrument's scale of every sample of one time, 1 for the direct beam."""
    sky = jnp.broadcast_to(calibration[None], one.measured.shape).reshape(-1)
    return sky if one.direct is None else jnp.concatenate([sky, jnp.ones(one.direct.shape[0], sky.dtype)])


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


def cost(choices: Choices, priors: Priors, point: Point, residual) -> Float[Array, ""]:
    """Half the sum of squares after the loss, `residual`, priors included."""
    total = jnp.sum(residual**2)
    count = len(choices.own)
    if count:
        scaled = jax.vmap(lambda own: on_scale(choices.own, own))(point.own)
        total += jnp.sum(((scaled - priors.centre[None, :count]) * priors.inverse_sigma[None, :count]) ** 2)
        total += jnp.sum(((scaled[1:] - scaled[:-1]) * priors.step) ** 2)
    return 0.5 * (total + jnp.sum(shared_priors(choices, point.shared, priors)[0] ** 2))
