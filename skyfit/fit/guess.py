"""Where a fit starts: the haze that explains the sky best by single scattering."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..scene import as_float
from ..transport import SingleScattering
from ..transport.solver import Geometry
from .parameters import PARAMETERS, SkyModel, with_values
from .problem import observe, Problem


# hazes that are tried: optical depths from clean to thick, exponents of coarse and fine particles
_DEPTHS = (0.02, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0)
_EXPONENTS = (0.3, 1.3)
# what all orders of scattering make of the light of the first one, at each wavelength
_BRIGHTENING = (1.0, 1.8)


def first_guess(geometry: Geometry, model: SkyModel, free: tuple[str, ...], problem: Problem) -> np.ndarray:
    """Values of the free parameters at each time, `[time, parameter]`: the start's, with the best of some hazes.

    The level of each wavelength may be brighter than single scattering by what higher orders add; the aureole and the
    gradient toward the horizon tell the haze.
    """
    first = [float(PARAMETERS[n].from_leaf(PARAMETERS[n].leaf(model))) for n in free]
    values = np.tile(first, (problem.sun_zenith.shape[0], 1))
    depth = next((n for n in ("aerosol_optical_depth", "turbidity") if n in free), None)
    if depth is None or not hasattr(model.atmosphere.aerosol, "optical_depth"):
        return values
    exponents = _EXPONENTS if "angstrom_exponent" in free else (None,)
    tried = []
    for optical_depth, exponent in itertools.product(_DEPTHS, exponents):
        haze = with_values(model, ("aerosol_optical_depth",), [optical_depth])
        row = dict(zip(free, first, strict=True)) | {depth: float(PARAMETERS[depth].from_leaf(optical_depth))}
        if exponent is not None:
            haze, row["angstrom_exponent"] = with_values(haze, ("angstrom_exponent",), [exponent]), exponent
        tried.append((haze, list(row.values())))
    models = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(haze for haze, _ in tried))
    costs = np.asarray(_costs(SingleScattering.draft(geometry), models, problem), float)
    rows = np.array([row for _, row in tried])
    best = np.argmin(np.where(np.isfinite(costs), costs, np.inf), axis=0)
    return np.where(np.isfinite(costs).any(axis=0)[:, None], rows[best], values)


@eqx.filter_jit
def _costs(solver, models, problem: Problem):
    """What each model leaves over at each time, `[model, time]`, the level of each channel being free within bounds."""

    def cost(model, one):
        light, _ = observe(solver, model, one)
        weighted = one.weight**2 * light
        norm = jnp.sum(weighted * light, axis=0)
        level = jnp.sum(weighted * one.measured, axis=0) / jnp.where(norm > 0.0, norm, 1.0)
        level = jnp.clip(level, *as_float(_BRIGHTENING))
        return jnp.sum((one.weight * (level[None] * light - one.measured)) ** 2)

    return jax.lax.map(lambda model: jax.lax.map(lambda one: cost(model, one), problem), models)
