"""The parameters of some times of a sky, each time's own and those that all share, with their covariance."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..numerics import triangle
from ..scene import as_float, haversine
from ..transport import AbstractSolver
from .chain import Blocks, damped, marginal_rows, minimise, Point, solve_chain
from .measurement import error_shapes, robust
from .parameters import PARAMETERS, SkyModel
from .problem import Problem
from .residuals import (
    bound,
    calibration_of,
    instrument_gain,
    Known,
    objective,
    on_scale,
    Priors,
    rows_of_times,
    Setup,
    shared_priors,
    whitened,
)
from .solve import covariance, LOGISTIC_LIMIT


# strengths, in units of a column's length, of what keeps the elimination of unknowns without influence sound
_GUARD = 1e-6
# normal deviates: the median size is 1 / 1.4826 standard deviations
_MEDIAN_SIZE = 1.4826
# of the influence of residuals, where hardly any is small
_LEAST_SLOPE = 0.1


class Estimate(NamedTuple):
    """The outcome for some times; arrays only, so that it passes through jit and vmap.

    `values` and covariances are in the order own, shared, in the parameters' stated units. `noise` is the covariance by
    noise, priors included, already widened by `scale` squared; `model` that by the model's stated error. `chi_square`
    is of all samples, those that the loss trusts less too. `triangle` has the scaled Jacobian's singular values.
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


def estimate(
    setup: Setup,
    solvers: tuple[AbstractSolver, AbstractSolver, AbstractSolver],
    fixed: SkyModel,
    problem: Problem,
    priors: Priors,
    starts: Point,
) -> Estimate:
    """The parameters of some times and what is known of their errors.

    **Arguments:** `solvers` of the first steps, of the slopes of the last ones, and of their radiance: where the search
    ends and what a sigma is need slopes no better than the per cent that the two differ by. `fixed`, a model with the
    values that are not fitted; `starts`, unconstrained numbers, `own` `[start, time, parameter]` and `shared`
    `[start, shared]`: the first solver goes from each of them, the last one from the best end. The time axis of all is
    any length; its cost is linear.
    """
    channels = problem.measured.shape[2]
    none = channels if setup.calibrated else 0
    box = jnp.concatenate([jnp.full(len(setup.shared), LOGISTIC_LIMIT), jnp.full(none, jnp.inf)])
    dtype = problem.measured.dtype
    limit = Point(jnp.full(starts.own.shape[1:], LOGISTIC_LIMIT, dtype), box.astype(dtype))
    ones = jnp.ones(problem.measured.shape[0], dtype)

    def run(solver, slopes, point, scale):
        rows = objective(setup, solver, slopes)
        return minimise(rows, point, (fixed, problem, priors, scale), limit, none, setup.max_steps)

    def first(start):
        start = Point(start.own, jnp.concatenate([start.shared, jnp.zeros(none, dtype)]))
        end, known, steps, _ = run(solvers[0], solvers[0], start, ones)
        cost = _cost(setup, priors, end, whitened(problem, known, calibration_of(setup, end, channels), ones)[0])
        return end, known, steps, jnp.where(jnp.isfinite(cost), cost, jnp.inf)

    ends, known, steps, costs = jax.lax.map(first, starts)
    best = jnp.argmin(costs)
    end, known, used = jax.tree.map(lambda v: v[best], (ends, known, steps))
    scale = _noise_scale(setup, *whitened(problem, known, calibration_of(setup, end, channels), ones))
    end, known, more, result = run(solvers[2], solvers[1], end, scale)
    return _described(setup, problem, priors, end, known, used + more, result)


def _cost(setup: Setup, priors: Priors, end: Point, residual):
    """Half the sum of squares after the loss, priors included."""
    total = jnp.sum(robust(residual, setup.loss, setup.threshold).value ** 2)
    count = len(setup.own)
    if count:
        scaled = jax.vmap(lambda own: on_scale(setup.own, own))(end.own)
        total += jnp.sum(((scaled - priors.centre[None, :count]) * priors.weight[None, :count]) ** 2)
        total += jnp.sum(((scaled[1:] - scaled[:-1]) * priors.step) ** 2)
    return 0.5 * (total + jnp.sum(shared_priors(setup, end.shared, priors)[0] ** 2))


def _noise_scale(setup: Setup, residual, weight):
    """How many times the stated sigma the residuals are, per time, 1 at least."""
    if setup.loss == "squares":
        scale = jnp.sqrt(_chi_square(setup, residual, weight))
    else:
        size = jnp.where(weight > 0.0, jnp.abs(residual), jnp.nan)
        scale = _MEDIAN_SIZE * jnp.nanmedian(size, axis=1)
    return jnp.where(scale > 1.0, scale, 1.0)


def _chi_square(setup: Setup, residual, weight):
    """Reduced, per time: the shared parameters count with their share of each."""
    samples = jnp.sum(weight > 0.0, axis=1)
    known = len(setup.own) + len(setup.shared) / residual.shape[0]
    return jnp.sum(jnp.where(weight > 0.0, residual**2, 0.0), axis=1) / jnp.maximum(samples - known, 1.0)


def _widening(setup: Setup, residual, weight):
    r"""How much wider than $(J^T W J)^{-1/2}$ the error is, per time; for squares the root of the reduced chi-square.

    $[\overline{\psi^2}\, \overline{w}]^{1/2} / \overline{\psi'}$ with the influence $\psi = w z$ of a residual: what is
    far off counts with its bounded influence, not with its size.
    **Source:** Huber 1981, Robust Statistics, sec. 7.6, divided by the mean weight that is in W.
    """

    def influence(residual):
        trust = robust(residual, setup.loss, setup.threshold).weight
        return trust * residual, trust

    (psi, trust), (slope, _) = jax.jvp(influence, (residual,), (jnp.ones_like(residual),))
    held = weight > 0.0
    count = jnp.maximum(jnp.sum(held, axis=1), 1)

    def mean(values):
        return jnp.sum(jnp.where(held, values, 0.0), axis=1) / count

    # where most are far off nothing holds, but finite it is
    return jnp.sqrt(_chi_square(setup, psi, weight) * mean(trust)) / jnp.maximum(mean(slope), _LEAST_SLOPE)


def _described(setup: Setup, problem: Problem, priors: Priors, end: Point, known: Known, steps, result) -> Estimate:
    """Values, covariances and gains at the end of a fit."""
    names, count, own_count = setup.names, len(setup.names), len(setup.own)
    times, directions, channels = problem.measured.shape
    shared = jnp.broadcast_to(end.shared[None, : len(setup.shared)], (times, len(setup.shared)))
    values = jax.vmap(lambda free: bound(names, free))(jnp.concatenate([end.own, shared], axis=1))
    calibration = calibration_of(setup, end, channels)
    raw, raw_weight = whitened(problem, known, calibration, jnp.ones(times, values.dtype))
    scale = _noise_scale(setup, raw, raw_weight)
    trust = robust(raw / scale[:, None], setup.loss, setup.threshold).weight
    plain = _chi_square(setup, raw, raw_weight)
    scale = jnp.maximum(scale * _widening(setup, raw / scale[:, None], raw_weight), 1.0)
    weight = jnp.sqrt(trust) * raw_weight / scale[:, None]
    log = jnp.asarray([PARAMETERS[n].log for n in names])
    spread = jnp.where(log[None], values, as_float([PARAMETERS[n].spread(1.0) for n in names])[None])
    instrument = instrument_gain(calibration, problem)
    columns = known.jacobian * (weight * instrument)[..., None] * spread[:, None]
    by_channel = None
    if setup.calibrated:
        by_channel = known.radiance * weight[:, : directions * channels].reshape(problem.measured.shape)
    errors = setup.model_error * _model_errors(problem, known) * (weight * instrument)[..., None]
    # a prior or a step on the parameter's scale: a unit there is one e-fold, or the range
    unit = jnp.where(log, 1.0, as_float([PARAMETERS[n].spread(1.0) for n in names]))
    tight = unit * priors.weight
    side = errors.shape[2]
    own, common, right = rows_of_times(
        columns, errors, by_channel, jnp.broadcast_to(tight[None, :own_count], (times, own_count)),
        jnp.zeros((times, own_count, side), errors.dtype),
    )  # fmt: skip
    scales = common.shape[2] - len(setup.shared)
    prior = jnp.diag(jnp.concatenate([tight[own_count:], jnp.broadcast_to(priors.calibration, (scales,))]))
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
    parameters = len(setup.shared)
    shift = jnp.concatenate(
        [shift_own, jnp.broadcast_to(shift_shared[None, :parameters], (times, parameters, side))], axis=1
    )
    shift = shift * spread[..., None]
    both = spread[:, :, None] * spread[:, None, :]
    by_sample = jnp.einsum("tpq,tsq->tps", spreads[:, :count, :count], columns)[..., : directions * channels]
    gain = by_sample.reshape(times, count, directions, channels)
    if setup.calibrated:
        gain = gain + jnp.einsum("tpc,tdc->tpdc", spreads[:, :count, count:], by_channel)
    sky_weight = weight[:, : directions * channels].reshape(problem.measured.shape)
    deviations = jnp.diagonal(spreads, axis1=1, axis2=2)
    freedom = jnp.clip(1.0 - tight[None] ** 2 * deviations[:, :count], 0.0, 1.0)
    freedom = jnp.sum(jnp.where(jnp.isfinite(deviations[:, :count]), freedom, 0.0), axis=1)
    cost = _cost(setup, priors, end, raw)
    scales_sigma = jnp.sqrt(deviations[0, count:]) if setup.calibrated else jnp.zeros(channels, own.dtype)
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
        cost,
        steps,
        jnp.all(jnp.isfinite(values)) & jnp.isfinite(cost),
        result,
    )


def _model_errors(problem: Problem, known: Known) -> Float[Array, "time sample shape"]:
    """Smooth errors of the model's radiance, in its unit; the direct beam has none."""

    def at(item):
        one, radiance = item
        half = haversine(one.view_zenith, one.sun_zenith, one.view_azimuth - one.sun_azimuth)
        airmass = 1.0 / jnp.maximum(jnp.cos(one.view_zenith), 0.05)
        place = one.wavelength_nm
        if one.response is not None:
            size = jnp.abs(one.response)
            place = size @ place / jnp.sum(size, axis=1)
        shapes = error_shapes(airmass, 1.0 - 2.0 * half, place)
        errors = (shapes * radiance[None]).reshape(shapes.shape[0], -1).T
        if one.direct is None:
            return errors
        return jnp.concatenate([errors, jnp.zeros((one.direct.shape[0], errors.shape[1]), errors.dtype)])

    return jax.vmap(at)((problem, known.radiance))
