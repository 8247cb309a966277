"""Directions as unit vectors, for many pixels: x east, y north, z up, the components first."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .directions import as_float


def unit_vectors(
    zenith: Float[ArrayLike, "*direction"], azimuth: Float[ArrayLike, "*direction"]
) -> Float[Array, "3 ..."]:
    r"""Unit vectors of directions, $(\sin\theta \sin\phi, \sin\theta \cos\phi, \cos\theta)$: east, north, up.

    **Arguments:** zenith angle and azimuth clockwise from north, radians, of one shape.
    **Returns:** dimensionless, `[3, direction]`. **Valid:** everywhere.
    """
    sine = jnp.sin(zenith)
    return jnp.stack([sine * jnp.sin(azimuth), sine * jnp.cos(azimuth), jnp.cos(zenith)])


def fisheye(size: int) -> Float[Array, "3 row column"]:
    r"""Unit vectors of the pixels of a dome: zenith in the middle, the horizon as its rim, north up, east right.

    The zenith angle grows linearly with the distance from the middle, $\theta = \frac{\pi}{2} r$.

    **Arguments:** `size`, pixels across, >= 1. **Returns:** dimensionless, `[3, row, column]`, the top row first.
    **Valid:** the corners lie below the horizon, z < 0.
    """
    if size < 1:
        raise ValueError(f"`size` must be >= 1, got {size}")
    edge = (np.arange(size) + 0.5) / size * 2.0 - 1.0
    x, y = np.meshgrid(edge, edge[::-1])
    radius = np.hypot(x, y)
    # numpy's sinc has pi in it: sin(pi r / 2) / r
    sine = 0.5 * np.pi * np.sinc(0.5 * radius)
    return as_float(np.stack([sine * x, sine * y, np.cos(0.5 * np.pi * radius)]))
