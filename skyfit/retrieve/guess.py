"""The first guess of a fit: the haze that explains the sky best by single scattering."""

import itertools
from collections.abc import Iterator
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from ..atmosphere import BinnedAerosol, TwoModeAerosol
from ..numerics import as_float
from ..programs import kept
from ..transport import Geometry, SingleScattering
from .forward import observe, Problem
from .model import SkyModel
from .parameters import PARAMETERS, SIZE_BINS, values_of, with_values


# trial hazes: optical depths from clean to thick; coarse and fine particles; phase functions by the names of
# their parameters: the start's own, and a narrow lobe over a broad one
_DEPTHS = (0.03, 0.08, 0.2, 0.5, 1.2)
_KINDS = {"angstrom_exponent": (0.4, 1.4), "fine_fraction": (0.35, 0.85)}
_LOBES = ({}, {"asymmetry": 0.85, "asymmetry_second": 0.45, "forward_fraction": 0.4},
          {"asymmetry": 0.93, "asymmetry_second": 0.55, "forward_fraction": 0.25})  # fmt: skip
# least and largest ratio of the radiance of all orders of scattering to that of the first, at each wavelength
_BRIGHTENING = (1.0, 1.8)


def first_guess(geometry: Geometry, model: SkyModel, free: tuple[str, ...], problem: Problem) -> np.ndarray:
    """Values of the free parameters at each time, `[time, parameter]`: the start's, with the best trial haze.

    The level of each wavelength may exceed single scattering by the light of higher orders. The aureole and the
    gradient toward the horizon determine the haze.
    """
    first = values_of(model, free)
    values = np.tile(list(first.values()), (problem.sun_zenith.shape[0], 1))
    depth = next((n for n in ("aerosol_optical_depth", "turbidity") if n in free), None)
    if set(SIZE_BINS) <= set(free):
        rows = np.array([list((first | bins).values()) for bins in _in_bins(model)])
    elif depth is None:
        return values
    else:
        rows = _rows(first, depth, free)
    # the radiance alone is used, with a free level of each channel
    problem = replace(problem, beside=None, beside_weight=None, has_beam=False, has_degree=False)
    costs = np.asarray(_costs(SingleScattering.draft(geometry), model, free, as_float(rows), problem), float)
    best = np.argmin(np.where(np.isfinite(costs), costs, np.inf), axis=0)
    some = np.asarray(np.any(np.isfinite(costs), axis=0))
    return np.where(some[:, None], rows[best], values)


def _rows(first: dict[str, float], depth: str, free: tuple[str, ...]) -> np.ndarray:
    """Trial values, `[haze, parameter]`, of hazes whose optical depth is a parameter."""
    kinds = [{n: v} for n, values in _KINDS.items() if n in free for v in values] or [{}]
    lobes = _LOBES if set(_LOBES[-1]) <= set(free) else ({},)
    depths = [{depth: float(PARAMETERS[depth].from_leaf(v))} for v in _DEPTHS]
    return np.array([list((first | a | b | c).values()) for a, b, c in itertools.product(depths, kinds, lobes)])


def _in_bins(model: SkyModel) -> Iterator[dict[str, float]]:
    """The size bins of the trial hazes."""
    for depth, share in itertools.product(_DEPTHS, _KINDS["fine_fraction"]):
        haze = BinnedAerosol.like(TwoModeAerosol(depth, share))  # pyright: ignore[reportCallIssue]
        yield values_of(SkyModel(model.atmosphere.replace(aerosol=haze)), SIZE_BINS)


def _left_over(solver, model, free, rows, problem: Problem):
    """The residual sum of squares of each row of values at each time; the level of each channel is free in bounds."""

    def cost(row, one):
        light = observe(solver, with_values(model, free, row), one).radiance
        weighted = one.weight**2 * light
        norm = jnp.sum(weighted * light, axis=0)
        level = jnp.sum(weighted * one.measured, axis=0) / jnp.where(norm > 0.0, norm, 1.0)
        level = jnp.clip(level, *as_float(_BRIGHTENING))
        return jnp.sum((one.weight * (level[None] * light - one.measured)) ** 2)

    return jax.lax.map(lambda row: jax.lax.map(lambda one: cost(row, one), problem), rows)


_costs = kept(_left_over, lambda *_: 0)
