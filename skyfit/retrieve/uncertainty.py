"""What is known of the errors of the parameters where a search has ended."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..numerics import as_float, triangle
from ..numerics.chain import Blocks, damped, marginal_rows, Point, solve_chain
from ..numerics.least_squares import covariance
from .forward import Problem
from .loss import robust, typical_size
from .model_error import model_errors
from .parameters import PARAMETERS
from .residuals import (
    bound,
    calibration_of,
    Choices,
    instrument_gain,
    Known,
    Numbers,
    Priors,
    rows_of_times,
    whitened,
)


# strengths, in units of a column's length, of what keeps the elimination of unknowns without influence sound
_GUARD = 1e-6
# the least influence that residuals are taken to have on the mean, where hardly any is small
_LEAST_SLOPE = 0.1


class Estimate(NamedTuple):
    """The outcome for some times; arrays only, so that it passes through jit and vmap.

    `values` and covariances are in the order of the free names, in the parameters' stated units. `noise` is the
    covariance by noise, priors included, already widened by `scale` squared; `model` that by the model's stated error.
    `chi_square` is of all samples, those that the loss trusts less too. `triangle` has the scaled Jacobian's singular
    values.
    `radiance`: what the instrument would read of the end. `gain`: d parameter / d radiance of the same time. `cost`:
    half the sum of squares after the loss.
    """

    values: Float[Array, "time parameter"]
    noise: Float[Array, "time parameter parameter"]
    model: Float[Array, "time parameter parameter"]
    triangle: Float[Array, "time row parameter"]
    freedom: Float[Array, " time"]
    radiance: Float[Array, "time direction channel"]
    gain: Float[Array, "time parameter direction channel"]
    weight: Float[Array, "time direction channel"]
    scale: Float[Array, " time"]
    chi_square: Float[Array, " time"]
    calibration: Float[Array, " channel"]
    calibration_sigma: Float[Array, " channel"]
    cost: Float[Array, ""]
    steps: Int[Array, ""]
    finite: Bool[Array, ""]
    result: Any


class End(NamedTuple):
    """Where a search has ended and what the solver says there."""

    point: Point
    known: Known
    cost: Float[Array, ""]
    steps: Int[Array, ""]
    result: Any


def noise_scale(choices: Choices, residual, weight) -> Float[Array, " time"]:
    """How many times the stated sigma the residuals are, per time, 1 at least."""
    if choices.loss == "squares":
        scale = jnp.sqrt(_chi_square(choices, residual, weight))
    else:
        scale = typical_size(residual, weight > 0.0)
    return jnp.where(scale > 1.0, scale, 1.0)


def _chi_square(choices: Choices, residual, weight):
    """Reduced, per time: the shared parameters count with their share of each."""
    samples = jnp.sum(weight > 0.0, axis=1)
    known = len(choices.own) + len(choices.shared) / residual.shape[0]
    return jnp.sum(jnp.where(weight > 0.0, residual**2, 0.0), axis=1) / jnp.maximum(samples - known, 1.0)


def _widening(choices: Choices, numbers: Numbers, residual, weight):
    r"""How much wider than $(J^T W J)^{-1/2}$ the error is, per time; for squares the root of the reduced chi-square.

    $[\overline{\psi^2}\, \overline{w}]^{1/2} / \overline{\psi'}$ with the influence $\psi = w z$ of a residual: what is
    far off counts with its bounded influence, not with its size.
    **Source:** Huber 1981, Robust Statistics, sec. 7.6, divided by the mean weight that is in W.
    """

    def influence(residual):
        trust = robust(residual, choices.loss, numbers.threshold).weight
        return trust * residual, trust

    (psi, trust), (slope, _) = jax.jvp(influence, (residual,), (jnp.ones_like(residual),))
    held = weight > 0.0
    count = jnp.maximum(jnp.sum(held, axis=1), 1)

    def mean(values):
        return jnp.sum(jnp.where(held, values, 0.0), axis=1) / count

    # where most are far off nothing holds, but finite it is
    return jnp.sqrt(_chi_square(choices, psi, weight) * mean(trust)) / jnp.maximum(mean(slope), _LEAST_SLOPE)


def described(choices: Choices, numbers: Numbers, problem: Problem, priors: Priors, found: End) -> Estimate:
    """Values, covariances and gains where a search has ended, parameters in the order own, shared."""
    end, known = found.point, found.known
    names, count, own_count = choices.names, len(choices.names), len(choices.own)
    times, directions, channels = problem.measured.shape
    shared = jnp.broadcast_to(end.shared[None, : len(choices.shared)], (times, len(choices.shared)))
    values = jax.vmap(lambda free: bound(names, free))(jnp.concatenate([end.own, shared], axis=1))
    calibration = calibration_of(choices, end, channels)
    raw, raw_weight = whitened(problem, known, calibration, jnp.ones(times, values.dtype))
    scale = noise_scale(choices, raw, raw_weight)
    trust = robust(raw / scale[:, None], choices.loss, numbers.threshold).weight
    plain = _chi_square(choices, raw, raw_weight)
    scale = jnp.maximum(scale * _widening(choices, numbers, raw / scale[:, None], raw_weight), 1.0)
    weight = jnp.sqrt(trust) * raw_weight / scale[:, None]
    log = jnp.asarray([PARAMETERS[n].log for n in names])
    spread = jnp.where(log[None], values, as_float([PARAMETERS[n].spread(1.0) for n in names])[None])
    instrument = instrument_gain(calibration, problem)
    # a unit on the parameter's scale is one e-fold, or the range
    unit = jnp.where(log, 1.0, as_float([PARAMETERS[n].spread(1.0) for n in names]))
    columns = known.jacobian * (weight * instrument)[..., None] * unit[None, None]
    by_channel = None
    if choices.calibrated:
        by_channel = known.radiance * weight[:, : directions * channels].reshape(problem.measured.shape)
    errors = numbers.model_error * model_errors(problem, known.radiance) * (weight * instrument)[..., None]
    tight = unit * priors.inverse_sigma
    side = errors.shape[2]
    own, common, right = rows_of_times(
        columns, errors, by_channel, jnp.broadcast_to(tight[None, :own_count], (times, own_count)),
        jnp.zeros((times, own_count, side), errors.dtype),
    )  # fmt: skip
    scales = common.shape[2] - len(choices.shared)
    exact = 0.0 if priors.calibration is None else priors.calibration
    prior = jnp.diag(jnp.concatenate([tight[own_count:], jnp.full(scales, exact, tight.dtype)]))
    link = unit[None, :own_count] * priors.step
    blocks = Blocks(
        own, common, right, prior, jnp.zeros((prior.shape[0], side), own.dtype), -link, link,
        jnp.zeros((*link.shape, side), own.dtype),
    )  # fmt: skip
    size = jax.tree.map(
        lambda v: jnp.where(v > 0.0, _GUARD * v, 1.0),
        Point(
            jnp.sqrt(jnp.sum(own**2, axis=1)),
            jnp.sqrt(jnp.sum(common**2, axis=(0, 1)) + jnp.diagonal(prior) ** 2),
        ),
    )
    marginal = marginal_rows(blocks, size)
    every = jnp.ones(marginal.shape[2], own.dtype)
    spreads = jax.vmap(lambda rows: covariance(rows, every)[0])(marginal)
    # the channels' scales first, so that what is left is of the parameters alone
    order = jnp.concatenate([marginal[..., count:], marginal[..., :count]], axis=2)
    triangles = jax.vmap(triangle)(order)[:, scales:, scales:]
    shift_own, shift_shared = solve_chain(damped(blocks, size))
    parameters = len(choices.shared)
    shift = jnp.concatenate(
        [shift_own, jnp.broadcast_to(shift_shared[None, :parameters], (times, parameters, side))], axis=1
    )
    shift = shift * spread[..., None]
    both = spread[:, :, None] * spread[:, None, :]
    by_sample = jnp.einsum("tpq,tsq->tps", spreads[:, :count, :count], columns)[..., : directions * channels]
    gain = by_sample.reshape(times, count, directions, channels)
    if choices.calibrated:
        gain = gain + jnp.einsum("tpc,tdc->tpdc", spreads[:, :count, count:], by_channel)
    sky_weight = weight[:, : directions * channels].reshape(problem.measured.shape)
    deviations = jnp.diagonal(spreads, axis1=1, axis2=2)
    freedom = jnp.clip(1.0 - tight[None] ** 2 * deviations[:, :count], 0.0, 1.0)
    freedom = jnp.sum(jnp.where(jnp.isfinite(deviations[:, :count]), freedom, 0.0), axis=1)
    scales_sigma = jnp.sqrt(deviations[0, count:]) if choices.calibrated else jnp.zeros(channels, own.dtype)
    return Estimate(
        values,
        jnp.where(jnp.isinf(spreads[:, :count, :count]), spreads[:, :count, :count], spreads[:, :count, :count] * both),
        jnp.einsum("tpk,tqk->tpq", shift, shift),
        triangles,
        freedom,
        known.radiance * calibration[None, None],
        gain * sky_weight[:, None] * spread[:, :, None, None],
        trust[:, : directions * channels].reshape(problem.measured.shape),
        scale,
        plain,
        calibration,
        scales_sigma,
        found.cost,
        found.steps,
        jnp.all(jnp.isfinite(values)) & jnp.isfinite(found.cost),
        found.result,
    )
