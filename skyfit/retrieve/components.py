"""Error components of a measurement: their kinds, the estimate of their sizes, and the whitening of residuals.

Each sample has an error of its own. All wavelengths of a direction share errors of level, of colour and of pointing. A
broad part of the sky can share errors of level and of colour. Shared errors do not weight the samples against each
other, but they widen the covariance. The computing cost is linear in the number of samples.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import erf
from jaxtyping import Array, Bool, Float

from ..measured.noise import Loss
from ..numerics import as_float
from ..numerics.factor import inverse, solve_upper, triangle
from .forward import Problem
from .loss import typical_size


KINDS = ("level", "colour", "pointing", "broad_level", "broad_colour")
# the kind of each column of `Errors.common`: colour is a slope and a bend, pointing has two axes
_KIND_OF = np.array([0, 1, 1, 2, 2], np.uint8)
COMMON = _KIND_OF.size
_ALONE, _BROAD = len(KINDS) - 2, 2
# first sizes of the search, in the order of `KINDS`: large, because convergence from below is slow
_LARGE = (0.1, 0.1, 0.03, 0.05, 0.05)
# number of bumps that make up a broad error, and their width in radians, which is about their distance
_BUMPS, _WIDTH = 16, 0.6
# number of passes of the estimate, and of steps of expectation and maximisation in each
_PASSES, _STEPS = 6, 20
# least limit, in standard deviations, beyond which a row does not count in the sizes
_FURTHEST = 3.0
# strength, relative to a column's length, of the rows that hold unknowns without influence in the elimination
_GUARD = 1e-6
# least size of a broad error that is distinguished from 0
_LEAST_BROAD = 1e-6


class Components(NamedTuple):
    """Standard deviations of the kinds of error of one time.

    `sample`: each sample's own error over the stated one. `common`, in the order of `KINDS`: relative level of a
    direction; its colour (a slope and a bend in the logarithm of wavelength, 1 at the ends); pointing in radians; level
    and slope that a broad part of the sky shares.
    """

    sample: Float[Array, ""]
    common: Float[Array, " kind"]


class Expected(NamedTuple):
    """Assumed components, before the residuals are seen.

    `common`: sizes in the order of `KINDS`. `strength`: the number of directions, or bumps of a broad error, that each
    size counts for; infinite where the size is given. `least`: least ratio of the samples' own error to the stated one.
    """

    common: Float[Array, " kind"]
    strength: Float[Array, " kind"]
    least: Float[Array, ""]


class Errors(NamedTuple):
    """Effects of errors of size 1 on the samples of one time.

    `weight`: one over the stated sigma of each sample's own error, 0 where masked. `common`: effects that a direction
    shares. `turned`: squared slope by the angle of the view, where each sample has a view, and so a pointing error, of
    its own. `broad`: effect of each bump of a broad error, of level and then of slope.
    """

    weight: Float[Array, "direction channel"]
    common: Float[Array, "direction channel effect"]
    turned: Float[Array, "direction channel"] | None
    broad: Float[Array, "direction channel kind bump"]


class Whitening(NamedTuple):
    """The transform that makes the errors of each direction independent and of size 1.

    `weight`: one over the samples' own sigma, 0 where masked. `across`, `share`: factors 1 - share across across^T, one
    for each column of `Errors.common`. `frame`: orthonormal basis of the space on which these factors act.
    """

    weight: Float[Array, "direction channel"]
    across: Float[Array, "effect direction channel"]
    share: Float[Array, "effect direction"]
    frame: Float[Array, "effect direction channel"]


def errors_of(
    one: Problem, radiance: Float[Array, "direction channel"], turn: Float[Array, "direction channel axis"]
) -> Errors:
    """The errors of one time, from the modelled `radiance` and its slopes `turn` by the two pointing offsets."""
    place = jnp.log(one.wavelength_nm)
    if one.response is not None:
        size = jnp.abs(one.response)
        place = size @ place / jnp.sum(size, axis=1)
    low, high = jnp.min(place), jnp.max(place)
    along = jnp.where(high > low, (2.0 * place - low - high) / jnp.where(high > low, high - low, 1.0), 0.0)
    shapes = jnp.stack([jnp.ones_like(along), along, 1.5 * along**2 - 0.5], axis=-1)
    # near the zenith an offset in azimuth turns the view by less
    moves = one.view_zenith.ndim == 2
    sine = jnp.abs(jnp.sin(one.view_zenith if moves else one.view_zenith[:, None]))
    slopes = jnp.stack([turn[..., 0], turn[..., 1] / jnp.maximum(sine, 1e-3)], axis=-1)
    turned = jnp.sum(slopes**2, axis=-1) if moves else None
    slopes = jnp.zeros_like(slopes) if moves else slopes
    level = radiance[..., None] * shapes[None]
    broad = level[..., :_BROAD, None] * _bumps(*one.mean_view())[:, None, None]
    return Errors(one.weight, jnp.concatenate([level, slopes], axis=-1), turned, broad)


def _bumps(zenith: Float[Array, " direction"], azimuth: Float[Array, " direction"]) -> Float[Array, "direction bump"]:
    """Smooth functions of the view; their sum with independent factors of size 1 has size 1 everywhere."""
    place = np.arange(_BUMPS)
    # a spiral spreads the centres evenly over the hemisphere
    height, turn = 1.0 - (place + 0.5) / _BUMPS, np.pi * (3.0 - np.sqrt(5.0)) * place
    side = np.sqrt(1.0 - height**2)
    centre = as_float(np.stack([side * np.sin(turn), side * np.cos(turn), height]))
    sine = jnp.sin(zenith)
    view = jnp.stack([sine * jnp.sin(azimuth), sine * jnp.cos(azimuth), jnp.cos(zenith)], axis=-1)
    bump = jnp.exp((view @ centre.astype(view.dtype) - 1.0) / _WIDTH**2)
    return bump / jnp.sqrt(jnp.sum(bump**2, axis=1, keepdims=True))


def whitening(errors: Errors, found: Components) -> Whitening:
    """The whitening for errors of the sizes `found`."""
    weight = _own_weight(errors, found)

    def one(state, k):
        scaled, frame = state
        # this column after the factors of the columns before it
        column = scaled[..., k]
        square = jnp.sum(column**2, axis=1)
        safe = jnp.where(square > 1e-6, square, 1.0)
        # (1 + a a^T)^(-1/2) = 1 - share a a^T; 1/2 for small ones
        share = jnp.where(square > 1e-6, (1.0 - 1.0 / jnp.sqrt(1.0 + safe)) / safe, 0.5)
        unit = column / jnp.sqrt(jnp.where(square > 0.0, square, 1.0))[:, None]
        # orthogonalise twice, because of rounding
        for _ in range(2):
            unit = unit - jnp.einsum("edc,ed->dc", frame, jnp.einsum("edc,dc->ed", frame, unit))
        length = jnp.sqrt(jnp.sum(unit**2, axis=1, keepdims=True))
        # a column that the columns before it span adds no axis
        axis = jnp.where(length > 1e-3, unit / jnp.where(length > 1e-3, length, 1.0), 0.0)
        return (_mirrored(scaled, column, share), frame.at[k].set(axis)), (column, share)

    begin = _scaled(errors, found) * weight[..., None], jnp.zeros((COMMON, *weight.shape), weight.dtype)
    (_, frame), (across, share) = jax.lax.scan(one, begin, jnp.arange(COMMON))
    return Whitening(weight, across, share, frame)


def _of_kind(effects, kind: int):
    """The effects of the columns of one kind."""
    return jnp.stack([effects[i] for i, of in enumerate(_KIND_OF) if of == kind])


def _scaled(errors: Errors, found: Components):
    return errors.common * found.common[_KIND_OF][None, None]


def _own_weight(errors: Errors, found: Components):
    """One over the sigma of each sample's own error."""
    weight = errors.weight / found.sample
    if errors.turned is None:
        return weight
    return weight / jnp.sqrt(1.0 + errors.turned * (_pointing(found) * weight) ** 2)


def _pointing(found: Components) -> Float[Array, ""]:
    return found.common[KINDS.index("pointing")]


def whiten(white: Whitening, samples: Float[Array, "direction channel column"]) -> Float[Array, "direction row column"]:
    """Whiten samples to independent rows of size 1: first the rows that a direction shares, then each sample's rest."""
    values = samples * white.weight[..., None]
    values = jax.lax.scan(lambda v, item: (_mirrored(v, *item), None), values, (white.across, white.share))[0]
    common = jnp.einsum("edc,dcx->dex", white.frame, values)
    return jnp.concatenate([common, values - jnp.einsum("edc,dex->dcx", white.frame, common)], axis=1)


def moved_by(
    errors: Errors, found: Components, rows: Float[Array, "direction channel column"]
) -> Float[Array, "effect column"]:
    """Shift of each column of linear `rows` by each independent shared error of one standard deviation."""
    common = jnp.einsum("dce,dcx->dex", _scaled(errors, found), rows)
    broad = jnp.einsum("dckb,k,dcx->kbx", errors.broad, found.common[_ALONE:], rows)
    common = jnp.concatenate([common.reshape(-1, rows.shape[2]), broad.reshape(-1, rows.shape[2])])
    if errors.turned is None:
        return common
    turned = (jnp.sqrt(errors.turned) * _pointing(found))[..., None] * rows
    return jnp.concatenate([common, turned.reshape(-1, rows.shape[2])])


def _mirrored(values, vector, share):
    along = jnp.sum(vector[..., None] * values, axis=1, keepdims=True)
    return values - share[:, None, None] * vector[..., None] * along


def joined(white: Whitening, rows: Float[Array, "direction row"]) -> Float[Array, "direction channel"]:
    """Join the rows of `whiten` to whitened samples."""
    return rows[:, COMMON:] + jnp.einsum("edc,de->dc", white.frame, rows[:, :COMMON])


def share_of(errors: Errors, found: Components) -> Float[Array, " kind"]:
    """Share of each kind, the samples' own first, in the sum of squares of all errors over the stated sigma."""
    weight = errors.weight / found.sample
    of_all = jnp.sum((_scaled(errors, found) * weight[..., None]) ** 2, axis=(0, 1))
    squares = [jnp.sum(weight > 0.0), *(jnp.sum(_of_kind(of_all, k)) for k in range(_ALONE))]
    if errors.turned is not None:
        squares[-1] = jnp.sum(errors.turned * (_pointing(found) * weight) ** 2)
    broad = jnp.sum((errors.broad * weight[..., None, None]) ** 2, axis=(0, 1, 3))
    squares.extend(broad * found.common[_ALONE:] ** 2)
    every = jnp.stack(squares)
    return every / jnp.maximum(jnp.sum(every), 1e-30)


def estimate(
    errors: Errors,
    residual: Float[Array, "direction channel"],
    columns: Float[Array, "direction channel column"],
    prior: Float[Array, "row column"],
    expected: Expected,
    loss: Loss,
    threshold: Float[Array, ""],
    moves: bool = True,
) -> Components:
    r"""Estimate the sizes of the errors from the residuals of one time, by restricted maximum likelihood.

    Shared errors are unknowns with a normal distribution; the parameters are unknowns without one. Expectation and
    maximisation over the posterior of both gives the variances; the evidence gives those of broad errors. Rows beyond
    the threshold of the loss, or three standard deviations if larger, do not count, but most rows always count. If far
    rows were only bounded, as in Huber's loss, those of one in threshold^2 directions would grow with the sizes that
    they cause.

    **Arguments:** `residual`, model minus measurement; `columns`, its slopes by all fitted unknowns; `prior`, rows of
    the prior knowledge of these unknowns; `moves`: whether the residuals move these unknowns, or they are held.
    **Source:** Patterson & Thompson 1971, Biometrika 58, 545; Dempster, Laird & Rubin 1977, J. R. Stat. Soc. B 39, 1;
    MacKay 1992, Neural Comput. 4, 415 (evidence).
    """
    middle = typical_size((residual * errors.weight).reshape(-1), errors.weight.reshape(-1) > 0.0)
    middle = jnp.maximum(jnp.where(jnp.isfinite(middle), middle, 1.0), expected.least)
    # scale so that no square overflows, however small the stated noise is
    errors, expected = (
        errors._replace(weight=errors.weight / middle),
        expected._replace(least=expected.least / middle),
    )
    furthest = jnp.inf if loss == "squares" else jnp.maximum(threshold, _FURTHEST)
    large = jnp.where(jnp.isinf(expected.strength), expected.common, jnp.asarray(_LARGE, middle.dtype))
    # factor that compensates for the rows that are left out as too far
    whole = 1.0 / jnp.sqrt(_calm(furthest))
    fitted = columns.shape[-1]
    broad = errors.broad.reshape(*residual.shape, -1).astype(columns.dtype)
    columns = jnp.concatenate([columns, broad], axis=-1)
    samples = jnp.concatenate([columns, residual[..., None]], axis=-1)

    def one_pass(_, found: Components) -> Components:
        rows = whiten(whitening(errors, found), samples)
        near = _near(rows[..., -1], furthest)
        tight = 1.0 / jnp.maximum(found.common[_ALONE:], _LEAST_BROAD)
        tied = jax.scipy.linalg.block_diag(prior, jnp.diag(jnp.repeat(tight, _BUMPS)))
        rows = (near[..., None] * rows).reshape(-1, rows.shape[-1])
        spread, step = _profiled(rows, tied)
        if moves:
            found = _with_broad(found, spread[fitted:], step[fitted:], expected)
        else:
            # the parameters stay where they are: only broad errors move
            least, own = _profiled(rows[:, fitted:], tied[prior.shape[0] :, fitted:])
            found = _with_broad(found, least, own, expected)
            step = jnp.concatenate([jnp.zeros(fitted, step.dtype), own])
        moved = residual + columns @ step
        left = jnp.concatenate([whole * moved[..., None], columns @ spread], axis=-1)
        trusted = jnp.all(near[:, :COMMON], axis=1, keepdims=True) & near[:, COMMON:] & (errors.weight > 0.0)
        trusted = trusted.astype(residual.dtype)
        return jax.lax.fori_loop(0, _STEPS, lambda _, v: _refined(errors, v, left, trusted, expected), found)

    found = jax.lax.fori_loop(0, _PASSES, one_pass, Components(jnp.ones_like(middle), large))
    return found._replace(sample=found.sample * middle)


def _with_broad(found: Components, spread, step, expected: Expected) -> Components:
    """Update the sizes of broad errors by the evidence: squares of their bumps over the number of determined bumps."""
    size = found.common[_ALONE:]
    square = step.reshape(_BROAD, _BUMPS) ** 2
    unsure = jnp.sum(spread.reshape(_BROAD, _BUMPS, -1) ** 2, axis=(1, 2))
    count = _BUMPS - unsure / jnp.maximum(size, _LEAST_BROAD) ** 2
    given = jnp.isinf(expected.strength[_ALONE:])
    strength = jnp.where(given, 1.0, expected.strength[_ALONE:])
    taken = expected.common[_ALONE:]
    variance = (strength * taken**2 + jnp.sum(square, axis=1)) / (strength + jnp.maximum(count, 0.0))
    return found._replace(common=found.common.at[_ALONE:].set(jnp.where(given, taken, jnp.sqrt(variance))))


def _near(rows: Float[Array, "direction row"], furthest) -> Bool[Array, "direction row"]:
    """Which whitened residuals are within `furthest` standard deviations, or typical sizes if these are larger.

    The rows that directions share have one typical size, the others another.
    """
    parts = rows[:, :COMMON], rows[:, COMMON:]
    typical = (typical_size(part.reshape(-1), part.reshape(-1) != 0.0) for part in parts)
    limits = [furthest * jnp.where(size > 1.0, size, 1.0) for size in typical]
    return jnp.concatenate([jnp.abs(p) <= limit for p, limit in zip(parts, limits, strict=True)], axis=1)


def _calm(furthest):
    """The mean square of normal deviates whose size is at most `furthest`."""
    furthest = jnp.minimum(furthest, 30.0)
    density = jnp.exp(-0.5 * furthest**2) * jnp.sqrt(2.0 / jnp.pi)
    return 1.0 - furthest * density / erf(furthest / jnp.sqrt(2.0))


def _profiled(rows, prior):
    """A root of the unknowns' covariance and the step to their best values, from whitened rows ending in residuals."""
    count = rows.shape[1] - 1
    guard = _GUARD * jnp.sqrt(jnp.sum(rows[:, :count] ** 2, axis=0))
    # unknowns without influence stay where they are
    tied = jnp.concatenate([jnp.diag(jnp.where(guard > 0.0, guard, 1.0)), prior])
    tied = jnp.pad(tied, ((0, 0), (0, 1)))
    whole = triangle(jnp.concatenate([rows, tied]))[:count]
    right = jnp.concatenate([jnp.eye(count, dtype=rows.dtype), whole[:, count:]], axis=1)
    solved = solve_upper(whole[:, :count], right)
    return solved[:, :count], -solved[:, count]


def _refined(errors: Errors, found: Components, left, trusted, expected: Expected) -> Components:
    """One step of expectation and maximisation; `left`: residuals and their slopes by unit deviates of the unknowns."""
    weight, scaled = _own_weight(errors, found), _scaled(errors, found)
    design = scaled * weight[..., None]
    unit = jnp.eye(COMMON, dtype=design.dtype)
    spread = inverse(unit[None] + jnp.einsum("dce,dcf->def", design, design))
    common = jnp.einsum("def,dcf,dcx->dex", spread, design * weight[..., None], left)
    rest = left - jnp.einsum("dce,dex->dcx", scaled, common)
    # posterior mean squares of the shared errors, in their standard deviations, and of the samples' own errors
    square = jnp.sum(common**2, axis=2) + jnp.einsum("dee->de", spread)
    own = jnp.sum(rest**2, axis=2) + jnp.einsum("dce,def,dcf->dc", scaled, spread, scaled)

    direction = jnp.max(trusted, axis=1)
    count, samples = jnp.sum(direction), jnp.maximum(jnp.sum(trusted), 1.0)
    by_effect = direction @ square / jnp.maximum(count, 1.0)
    alone = found.common[:_ALONE]
    mean = jnp.stack([jnp.mean(_of_kind(by_effect, k)) for k in range(_ALONE)]) * alone**2
    if errors.turned is not None:
        # each sample's own error has two independent parts, of which one is pointing
        size = 1.0 / jnp.where(weight > 0.0, weight, 1.0) ** 2
        share = errors.turned * (_pointing(found) * weight) ** 2
        both = share * (1.0 - share) * size
        turned = (share**2 * own + both) / jnp.where(errors.turned > 0.0, errors.turned, 1.0)
        held = trusted * (errors.turned > 0.0)
        mean = mean.at[-1].set(jnp.sum(held * turned) / jnp.maximum(jnp.sum(held), 1.0))
        own = (1.0 - share) ** 2 * own + both
    given = jnp.isinf(expected.strength[:_ALONE])
    strength, taken = jnp.where(given, 1.0, expected.strength[:_ALONE]), expected.common[:_ALONE]
    variance = (strength * taken**2 + count * mean) / (strength + count)
    ratio = jnp.sum(trusted * errors.weight**2 * own) / samples
    alone = jnp.where(given, taken, jnp.sqrt(variance))
    return Components(jnp.maximum(jnp.sqrt(ratio), expected.least), found.common.at[:_ALONE].set(alone))
