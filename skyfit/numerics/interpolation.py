"""Interpolation as a matrix of weights: differentiable, free of gathers, the same in every dtype."""

import functools

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

    **Arguments:** `x`, dimensionless; `count`, number of nodes; `kept`, the first coefficients of the interpolant
    that are used (left out: all `count`).
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
