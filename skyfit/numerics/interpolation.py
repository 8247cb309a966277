"""Interpolation by weights of all nodes or of those around a place; differentiable, the same in every dtype."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


def hat_weights(x: Float[Array, " *shape"], nodes: Float[Array, " node"]) -> Float[Array, "*shape node"]:
    """Weights of linear interpolation: `hat_weights(x, nodes) @ values` is `interp(x, nodes, values)`.

    **Arguments:** `x`, any shape; `nodes`, increasing, one at least, the same unit.
    **Returns:** weights that sum to 1 over the last axis.
    **Valid:** beyond the end nodes the end value holds (weights do not extrapolate).
    """
    lower, upper = nodes[:-1], nodes[1:]
    fraction = (x[..., None] - jnp.expand_dims(lower, range(x.ndim))) / jnp.expand_dims(upper - lower, range(x.ndim))
    ramp = jnp.clip(fraction, 0.0, 1.0)
    ones = jnp.ones((*x.shape, 1), ramp.dtype)
    return jnp.concatenate([ones, ramp], axis=-1) - jnp.concatenate([ramp, 0.0 * ones], axis=-1)


@functools.lru_cache(maxsize=32)
def chebyshev_nodes(count: int) -> np.ndarray:
    """Roots of the Chebyshev polynomial of degree `count` on [-1, 1], ascending, `[count]`."""
    return -np.cos(np.pi * (np.arange(count) + 0.5) / count)


def chebyshev_weights(
    x: Float[Array, " wavelength"], count: int, kept: int | None = None
) -> Float[Array, "wavelength node"]:
    """Weights of polynomial interpolation from `chebyshev_nodes(count)` to points `x` in [-1, 1].

    **Arguments:** `x`, dimensionless; `count`, number of nodes; `kept`, the number of first coefficients of the
    interpolant that are used (None: all `count`).
    **Returns:** weights; `weights @ values_at_nodes` is the interpolant.
    **Source:** discrete orthogonality of Chebyshev polynomials (Trefethen, Approximation Theory, ch. 3).
    """
    at_nodes = np.cos(np.arange(count)[:, None] * np.arccos(chebyshev_nodes(count))[None, :])
    to_coefficients = 2.0 / count * at_nodes
    to_coefficients[0] *= 0.5
    rows = [jnp.ones_like(x), x]
    for _ in range(2, count):
        rows.append(2.0 * x * rows[-1] - rows[-2])
    kept = count if kept is None else kept
    return jnp.stack(rows[:kept], axis=-1) @ jnp.asarray(to_coefficients[:kept], x.dtype)


def cubic(place: Any, count: int):
    """Index of the first of four evenly spaced nodes around a place, and their Lagrange weights.

    Beyond the end nodes the end value holds.
    """
    xp = library_of(place)
    inside = xp.clip(place, 0.0, count - 1.0)
    first = xp.clip(xp.floor(inside).astype(np.int32) - 1, 0, count - 4)
    t = inside - first
    a, b, c, d = t, t - 1.0, t - 2.0, t - 3.0
    return first, (-b * c * d / 6.0, a * c * d / 2.0, -a * b * d / 2.0, a * b * c / 6.0)


def cubic_weights(place: Any, count: int) -> Any:
    """`cubic` as a row of weights for all nodes, `[..., node]`; numpy arrays give numpy arrays."""
    xp = library_of(place)
    first, four = cubic(place, count)
    behind = np.arange(count).reshape(*[1] * place.ndim, count) - first[..., None]
    row = xp.zeros(behind.shape, place.dtype)
    for k, weight in enumerate(four):
        row = row + xp.where(behind == k, weight[..., None], 0.0)
    return row


def linear(place: Float[Array, "..."], count: int):
    """Index of the first of two evenly spaced nodes around a place, and their weights.

    Beyond the end nodes the end value holds.
    """
    inside = jnp.clip(place, 0.0, count - 1.0)
    first = jnp.clip(jnp.floor(inside).astype(jnp.int32), 0, count - 2)
    return first, (1.0 - (inside - first), inside - first)


def library_of(values: Any):
    """`jax.numpy` for arrays of jax, `numpy` for others."""
    return jnp if isinstance(values, jax.Array) else np
