"""The errors of the parameters at the end of a search."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..numerics import as_float, solve_upper, triangle
from ..numerics.chain import Blocks, damped, marginal_rows, Point, solve_chain
from ..numerics.least_squares import covariance
from ..scene import angle_between
from .components import Components, Errors, errors_of, estimate, joined, moved_by, share_of, whiten, whitening
from .forward import Problem
from .loss import robust, typical_size
from .model_error import model_errors
from .parameters import PARAMETERS
from .residuals import (
    beside_residual,
    calibration_of,
    Choices,
    columns_of,
    instrument_gain,
    Known,
    Numbers,
    Priors,
    reduced_rows,
    trusted,
    values_at,
    Weighing,
    weight_of,
    with_scales,
)


# strength, relative to a column's length, of the rows that keep the elimination sound for unknowns without influence
_GUARD = 1e-6
# least mean slope of the influence of residuals, for times at which hardly any residual is small
_LEAST_SLOPE = 0.1


class Estimate(NamedTuple):
    """The outcome for some times; arrays only, so that it passes through jit and vmap.

    `values` and covariances are in the order of the free names, in the parameters' stated units. `noise`: covariance by
    noise of all kinds, priors included. `model`: covariance by the model's stated error and by the error of a whole
    time's level. `triangle` has the scaled Jacobian's singular values.
    `scale`: the samples' own noise over the stated noise. `common`: sizes of the shared errors, in the order of
    `KINDS`. `widening`: factor by which `noise` is widened because the loss trusts some samples less. `chi_square`:
    reduced, of all samples with the stated noise. `error_share`: share of each kind of error, the samples' own first,
    in the sum of squares. `residual_correlation`: that of the whitened residuals between neighbours in wavelength and
    in direction. `radiance`, `beside`: the instrument's reading of the end. `gain`: d parameter / d radiance of the
    same time. `cost`: half the sum of squares after the loss.
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
    common: Float[Array, "time kind"]
    widening: Float[Array, " time"]
    error_share: Float[Array, "time kind"]
    residual_correlation: Float[Array, "time neighbour"]
    beside: Float[Array, "time other"] | None
    chi_square: Float[Array, " time"]
    calibration: Float[Array, " channel"]
    calibration_sigma: Float[Array, " channel"]
    cost: Float[Array, ""]
    steps: Int[Array, ""]
    finite: Bool[Array, ""]
    result: Any


class End(NamedTuple):
    """The end of a search: the point, the solver's output there, the weighting of the samples, sizes of their errors.

    The sizes are those that the residuals of this end show (`components_at`).
    """

    point: Point
    known: Known
    weighing: Weighing
    sizes: Components
    cost: Float[Array, ""]
    steps: Int[Array, ""]
    result: Any


def components_at(
    choices: Choices, numbers: Numbers, problem: Problem, priors: Priors, point: Point, known: Known
) -> Components:
    """Estimate the sizes of each time's errors from the residuals of a point; no derivative goes through them.

    A single time cannot move parameters that times share or that link them. Where times contradict each other, that
    counts as an error of the samples.
    """
    alone = problem.measured.shape[0] == 1
    calibration = calibration_of(choices, point, problem.measured.shape[2])
    # the slopes are by the parameters on their scales
    prior = priors.rows()
    if choices.calibrated:
        prior = with_scales(prior, priors.calibration, calibration.size)
    mine = prior.shape[1] if alone else len(choices.own)

    def at(item):
        one, known = item
        columns = columns_of(choices, one, known, calibration, jnp.ones_like(priors.inverse_sigma))
        sky = columns[: one.measured.size, :mine].reshape(*one.measured.shape, -1)
        residual = known.radiance * calibration[None] - one.measured
        errors = errors_of(one, known.radiance, known.turn)
        given = prior[:, :mine], numbers.expected, choices.loss, numbers.threshold
        return estimate(errors, residual, sky, *given, alone)

    return jax.lax.map(at, jax.lax.stop_gradient((problem, known)))


def weighing_at(choices: Choices, numbers: Numbers, problem: Problem, priors: Priors, end: End) -> Weighing:
    r"""The weighting of the samples from the residuals of an end that was found with the stated noise.

    `excess` is $[\mathrm{tr}(H^{-1} M) / p]^{1/2}$ with the normal matrix H of the p parameters and the covariance M
    of its right-hand side by noise of all kinds, as if p independent numbers determined the parameters.
    **Source:** Ribatet, Cooley & Davison 2012, Stat. Sinica 22, 813 (magnitude adjustment of a composite likelihood).
    """
    calibration = calibration_of(choices, end.point, problem.measured.shape[2])
    count = len(choices.names)

    def at(item):
        one, known, sizes = item
        plain = (known.radiance * calibration[None] - one.measured) * one.weight
        typical = typical_size(plain.reshape(-1), one.weight.reshape(-1) > 0.0)
        scale = jnp.where(typical > 1.0, typical, 1.0)
        weighing = Weighing(scale, jnp.ones_like(scale))
        columns = columns_of(choices, one, known, calibration, jnp.ones_like(priors.inverse_sigma))
        # the channels' scales come first, so that the last rows are of the parameters alone
        columns = jnp.concatenate([columns[:, count:], columns[:, :count]], axis=1)
        given = errors_of(one, known.radiance, known.turn), sizes, weighing, columns
        _, rows, effects = _noise_of(choices, numbers.threshold, one, known, calibration, *given)
        moves = _sides(rows, effects)[-count:]
        return Weighing(scale, jnp.sqrt(jnp.maximum(jnp.mean(jnp.sum(moves**2, axis=1)), 1.0)))

    return jax.lax.stop_gradient(jax.lax.map(at, (problem, end.known, end.sizes)))


def _noise_of(
    choices: Choices, threshold, one: Problem, known: Known, calibration, errors: Errors, sizes, weighing, columns
):
    """Trust in each sample, weighted rows of `columns`, and their normal equations' right-hand sides by each error.

    Samples of a direction beyond the threshold of the loss count as one error, with the influence that they have.
    """
    trust = trusted(choices, threshold, one, known, calibration, weighing).weight
    plain, root = weight_of(one, weighing), jnp.sqrt(trust)
    rows = columns * (plain * root)[:, None]
    directions, channels = one.measured.shape
    held = directions * channels
    sky, beam = (rows * root[:, None])[:held], rows[held:]
    own = sky * (sizes.sample / weighing.scale)
    common = moved_by(errors, sizes, (sky * plain[:held, None]).reshape(directions, channels, -1))
    effects = [own, beam * weighing.excess, common]
    if choices.loss != "squares":
        residual = (known.radiance * calibration[None] - one.measured).reshape(-1) * plain[:held]
        far = jnp.where(jnp.abs(residual) > threshold, residual, 0.0)
        effects.append(jnp.sum((sky * far[:, None]).reshape(directions, channels, -1), axis=1))
    return trust, rows, jnp.concatenate(effects)


def _sides(rows, effects):
    r"""Right-hand sides $y$ of the triangle $T$ of some rows: $T^T y$ has the covariance of all effects together.

    **Arguments:** `rows` `[row, column]`; `effects` `[effect, column]`. **Returns:** `[column, side]`, as many sides,
    whose sign is free: it also suits the triangle with a positive diagonal.
    """
    count = rows.shape[1]
    guard = jnp.sqrt(jnp.sum(rows**2, axis=0))
    rows = jnp.concatenate([rows, jnp.diag(jnp.where(guard > 0.0, _GUARD * guard, 1.0))])
    # one program for both
    most = max(len(rows), len(effects))
    both = jnp.stack([jnp.pad(part, ((0, most - len(part)), (0, 0))) for part in (rows, effects)])
    upper, sides = jax.lax.map(lambda part: triangle(part)[:count], both)
    # solve the transpose, a lower triangle, with rows and columns reversed
    return solve_upper(upper.T[::-1, ::-1], sides.T[::-1])[::-1]


def _chi_square(choices: Choices, square, held):
    """The reduced chi-square of one time, for which each time's share of the shared parameters counts."""
    known = len(choices.own) + len(choices.shared) / held[1]
    return jnp.sum(square) / jnp.maximum(held[0] - known, 1.0)


def _widening(choices: Choices, threshold, plain):
    r"""The factor, 1 at least, by which the loss widens the error of one time, from its whitened residuals.

    $[\overline{\psi^2} / \overline{w^2}]^{1/2}\, \overline{w} / \overline{\psi'}$ with the influence
    $\psi = w z$ of a residual. Means are over residuals within the threshold: `_noise_of` has the others and weights.
    **Source:** Huber 1981, Robust Statistics, sec. 7.6.
    """

    def influence(residual):
        return robust(residual, choices.loss, threshold).weight * residual

    psi, slope = jax.jvp(influence, (plain,), (jnp.ones_like(plain),))
    trust = robust(plain, choices.loss, threshold).weight
    near = (plain != 0.0) & (jnp.abs(plain) <= threshold)

    def mean(values):
        return jnp.sum(jnp.where(near, values, 0.0)) / jnp.maximum(jnp.sum(near), 1)

    wide = jnp.sqrt(mean(psi**2) / mean(trust**2)) * mean(trust) / jnp.maximum(mean(slope), _LEAST_SLOPE)
    return jnp.where(wide > 1.0, wide, 1.0)


def _correlation(one: Problem, value) -> Float[Array, " neighbour"]:
    """The correlation of whitened residuals with the next wavelength, and with the nearest direction."""
    held = one.weight > 0.0
    beside = held[:, 1:] & held[:, :-1]
    spectral = jnp.sum(jnp.where(beside, value[:, 1:] * value[:, :-1], 0.0)) / jnp.maximum(jnp.sum(beside), 1)
    zenith, azimuth = one.mean_view()
    angle = angle_between(zenith[:, None], zenith[None], azimuth[:, None] - azimuth[None])
    some = jnp.any(held, axis=1)
    same = jnp.eye(zenith.size, dtype=bool) | ~some[None]
    nearest = jnp.argmin(jnp.where(same, jnp.inf, angle), axis=1)
    both = held & held[nearest]
    angular = jnp.sum(jnp.where(both, value * value[nearest], 0.0)) / jnp.maximum(jnp.sum(both), 1)
    size = jnp.sum(jnp.where(held, value**2, 0.0)) / jnp.maximum(jnp.sum(held), 1)
    return jnp.stack([spectral, angular]) / jnp.where(size > 0.0, size, 1.0)


def _moved(blocks: Blocks):
    """The shift of the parameters of each time, then of the shared unknowns, by each right-hand side."""
    mine, shared = solve_chain(blocks)
    return jnp.concatenate([mine, jnp.broadcast_to(shared[None], (mine.shape[0], *shared.shape))], axis=1)


def _by_errors(blocks: Blocks, noise, priors: slice, excess, all_excess, prior_error):
    """The covariance of each time's parameters and the shared unknowns by noise and priors of all times, and by models.

    **Arguments:** `blocks`, damped, whose right-hand sides are the errors that the model makes at all times together;
    `noise` `[time, row, effect]`, right-hand sides of each time's first rows; `priors`, the rows of each time's priors;
    `excess`, errors of these rows; `all_excess`, that of links between times; `prior_error`, errors of the shared
    unknowns' priors. **Returns:** both `[time, unknown, unknown]`.
    """
    times, effects, count = noise.shape[0], noise.shape[1], blocks.own.shape[2]
    told, model = priors.stop - priors.start, blocks.right.shape[2]
    sides, kind = max(effects + told + count, model), noise.dtype
    by_model = jnp.pad(blocks.right, ((0, 0), (0, 0), (0, sides - model)))
    # rows that only damp have no error
    error = jnp.pad(prior_error, (0, blocks.prior.shape[0] - prior_error.size))

    def add(totals, source):
        """Add the shifts by the errors of one more time, then by those of the shared unknowns, then by the model's."""
        here = (jnp.arange(times) == source)[:, None, None]
        told_by, ties = (jnp.where(here, jnp.eye(size, dtype=kind)[None], 0.0) for size in (told, count))
        right = jnp.zeros((times, blocks.own.shape[1], sides), kind)
        right = right.at[:, :effects, :effects].set(jnp.where(here, noise, 0.0))
        right = right.at[:, priors, effects : effects + told].set(told_by * excess[:, None, None])
        right = jnp.where(source > times, by_model, right)
        steps = jnp.zeros((times - 1, count, sides), kind)
        steps = steps.at[:, :, effects + told : effects + told + count].set(ties[: times - 1] * all_excess)
        last = jnp.where(source == times, jnp.eye(error.size, sides, dtype=kind) * error[:, None], 0.0)
        shift = _moved(blocks._replace(right=right, prior_right=last, step_right=steps))
        square = jnp.einsum("tpk,tqk->tpq", shift, shift)
        shares = jnp.where(source > times, 0.0, square), jnp.where(source > times, square, 0.0)
        return jax.tree.map(jnp.add, totals, shares), None

    nothing = jnp.zeros((times, *(count + blocks.common.shape[2],) * 2), kind)
    return jax.lax.scan(add, (nothing, nothing), jnp.arange(times + 2))[0]


def described(choices: Choices, numbers: Numbers, problem: Problem, priors: Priors, found: End) -> Estimate:
    """Values, covariances and gains at the end of a search, parameters in the order own, shared."""
    end, known = found.point, found.known
    names, count, own_count = choices.names, len(choices.names), len(choices.own)
    times, directions, channels = problem.measured.shape
    values = values_at(choices, end)
    calibration = calibration_of(choices, end, channels)
    sizes = found.sizes
    log = jnp.asarray([PARAMETERS[n].log for n in names])
    spread = jnp.where(log[None], values, as_float([PARAMETERS[n].spread(1.0) for n in names])[None])
    # a unit on the parameter's scale is one e-fold, or the range
    unit = jnp.where(log, 1.0, as_float([PARAMETERS[n].spread(1.0) for n in names]))
    excess, all_excess = found.weighing.excess, found.weighing.of_all()
    tight = priors.of(slice(0, own_count)).rows() * unit[None, :own_count]
    own_tight = tight[None] * excess[:, None, None]
    shared_tight = priors.of(slice(own_count, None)).rows() * unit[None, own_count:] * all_excess
    errors = model_errors(problem, known.radiance) * numbers.model_error
    level = numbers.level * jnp.where(jnp.arange(errors.shape[1]) < directions * channels, 1.0, 0.0)
    level = level[None] * _with_beam(known.radiance.reshape(times, -1), errors.shape[1])
    errors = jnp.concatenate([errors, level[..., None]], axis=2)
    side = errors.shape[2]

    def at(item):
        one, known, errors, sizes, weighing, tied = item
        shared_errors = errors_of(one, known.radiance, known.turn)
        white = whitening(shared_errors, sizes)
        samples = jnp.sum(one.weight > 0.0) + (0 if one.beside_weight is None else jnp.sum(one.beside_weight > 0.0))
        held = samples, times
        residual = known.radiance * calibration[None] - one.measured
        plain = joined(white, whiten(white, residual[..., None])[..., 0])
        wide = _widening(choices, numbers.threshold, plain)
        stated = jnp.sum((residual * one.weight) ** 2)
        beam = beside_residual(one, known)
        if beam is not None and one.beside_weight is not None:
            stated += jnp.sum((beam * one.beside_weight) ** 2)
        columns = columns_of(choices, one, known, calibration, unit)
        given = shared_errors, sizes, weighing, columns
        trust, rows, effects = _noise_of(choices, numbers.threshold, one, known, calibration, *given)
        weight = weight_of(one, weighing) * jnp.sqrt(trust)
        right = errors * (instrument_gain(calibration, one) * weight)[:, None]
        parts = reduced_rows(choices, rows, right, tied, jnp.zeros((tied.shape[0], side), rows.dtype))
        noise = _sides(jnp.concatenate(parts[:2], axis=1)[: rows.shape[1]], wide * effects)
        told = wide, _chi_square(choices, stated, held), _correlation(one, plain), share_of(shared_errors, sizes)
        trust = trust[: directions * channels].reshape(directions, channels)
        return parts, noise, told, rows * weight[:, None], trust

    items = problem, known, errors, sizes, found.weighing, own_tight
    (own, common, right), noise, told, columns, weight = jax.lax.map(at, items)
    wide, chi_square, correlation, shares = told
    scales = common.shape[2] - len(choices.shared)
    exact = 0.0 if priors.calibration is None else priors.calibration
    prior = with_scales(shared_tight, exact, scales)
    link = unit[None, :own_count] * priors.step * all_excess
    # error of the shared unknowns' priors, whose weights have the excess too
    prior_error = jnp.concatenate([jnp.full(len(shared_tight), all_excess), jnp.ones(scales, own.dtype)])
    blocks = Blocks(
        own, common, right, prior, jnp.zeros((prior.shape[0], side), own.dtype), -link, link,
        jnp.zeros((*link.shape, side), own.dtype),
    )  # fmt: skip
    size = jax.tree.map(
        lambda v: jnp.where(v > 0.0, _GUARD * v, 1.0),
        Point(
            jnp.sqrt(jnp.sum(own**2, axis=1)),
            jnp.sqrt(jnp.sum(common**2, axis=(0, 1)) + jnp.sum(prior**2, axis=0)),
        ),
    )
    marginal = marginal_rows(blocks, size)
    every = jnp.ones(marginal.shape[2], own.dtype)
    # the channels' scales come first, so that the triangle's last rows are of the parameters alone
    spreads, triangles = jax.vmap(lambda rows: covariance(rows, every))(jnp.roll(marginal, scales, axis=2))
    spreads, triangles = jnp.roll(spreads, -scales, axis=(1, 2)), triangles[:, scales:, scales:]
    rows = slice(own.shape[1] - own_tight.shape[1], own.shape[1])
    total, by_model = _by_errors(damped(blocks, size), noise, rows, excess, all_excess, prior_error)
    # undetermined parameters have no finite sigma
    unknown = jnp.isinf(jnp.diagonal(spreads, axis1=1, axis2=2))
    total = jnp.where(unknown[:, :, None] | unknown[:, None], spreads, total)
    both = spread[:, :, None] * spread[:, None, :]

    def gain_at(item):
        spreads, columns = item
        gain = (columns @ spreads[:, :count])[: directions * channels]
        return jnp.moveaxis(gain.reshape(directions, channels, count), -1, 0)

    gain = jax.lax.map(gain_at, (spreads, columns))
    deviations = jnp.diagonal(spreads, axis1=1, axis2=2)
    weighed = jax.vmap(lambda own: jax.scipy.linalg.block_diag(own, shared_tight))(own_tight)
    finite = jnp.where(jnp.isfinite(spreads), spreads, 0.0)[:, :count, :count]
    known_by_data = 1.0 - jnp.einsum("tpq,trp,trq->tp", finite, weighed, weighed)
    # where a prior ties parameters together, only the sum over them has a meaning
    freedom = jnp.clip(jnp.where(jnp.isfinite(deviations[:, :count]), known_by_data, 0.0).sum(axis=1), 0.0, count)
    scales_sigma = jnp.sqrt(jnp.diagonal(total[0])[count:]) if choices.calibrated else jnp.zeros(channels, own.dtype)
    return Estimate(
        values,
        jnp.where(jnp.isinf(total[:, :count, :count]), jnp.inf, total[:, :count, :count] * both),
        by_model[:, :count, :count] * both,
        triangles,
        freedom,
        known.radiance * calibration[None, None],
        gain * spread[:, :, None, None],
        weight,
        sizes.sample,
        sizes.common,
        wide,
        shares,
        correlation,
        known.beside,
        chi_square,
        calibration,
        scales_sigma,
        found.cost,
        found.steps,
        jnp.all(jnp.isfinite(values)) & jnp.isfinite(found.cost),
        found.result,
    )


def _with_beam(radiance, samples: int):
    """Append empty samples of the beam to those of the sky."""
    return jnp.pad(radiance, ((0, 0), (0, samples - radiance.shape[1])))
