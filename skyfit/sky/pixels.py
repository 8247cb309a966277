"""The colour of many directions of an analytic sky in few passes: no trigonometry, six exponentials a pixel.

Each step is compiled by itself: in one program XLA fuses them into one loop for red, one for green and one for blue,
each of which computes nearly everything again.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..light import SRGB_FROM_XYZ
from ..numerics import safe_sqrt
from ..scene import LOWEST_VISIBLE
from .perez import LARGEST_EXPONENT, LOWEST_COSINE


# arcsin(sqrt(m)) / sqrt(m) on [0, 1/2], highest power first; the angle then is right to 2e-8
_ARCSINE = (
    np.polynomial.Chebyshev.interpolate(lambda m: np.arcsin(np.sqrt(m)) / np.sqrt(m), 7, domain=[0.0, 0.5])
    .convert(kind=np.polynomial.Polynomial)
    .coef[::-1]
)


_BELOW = -1.0
_SMALLEST_Y = 1e-6  # as in `xyz_from_xyY`


@jax.jit
def geometry(
    sun: Float[Array, "3"], view: Float[Array, "3 ..."]
) -> tuple[Float[Array, "*direction"], Float[Array, "*direction"], Float[Array, "*direction"]]:
    r"""Angle from the sun $\gamma$, $\cos^2\gamma$ and $1/\cos\theta$ of unit vectors, the latter -1 below the horizon.

    $\sin^2(\gamma/2) = |v - s|^2 / 4$, which keeps all digits near the sun.

    **Arguments:** unit vectors, the vertical last. **Returns:** radians, then dimensionless, `[direction]` each.
    **Valid:** everywhere; the gradient of the angle is 0 where it is 0 or pi.
    """
    half = 0.25 * (jnp.square(view[0] - sun[0]) + jnp.square(view[1] - sun[1]) + jnp.square(view[2] - sun[2]))
    near = half < 0.5
    smaller = jnp.where(near, half, 1.0 - half)
    series = jnp.full_like(smaller, _ARCSINE[0])
    for coefficient in _ARCSINE[1:]:
        series = series * smaller + coefficient
    angle = 2.0 * safe_sqrt(smaller) * series
    slant = jnp.where(view[2] <= LOWEST_VISIBLE, _BELOW, 1.0 / jnp.maximum(view[2], LOWEST_COSINE))
    return jnp.where(near, angle, jnp.pi - angle), jnp.square(1.0 - 2.0 * half), slant


@jax.jit
def colours(
    zenith: Float[Array, "3"],
    coefficients: Float[Array, "3 parameter"],
    angle: Float[Array, "*direction"],
    cosine_squared: Float[Array, "*direction"],
    slant: Float[Array, "*direction"],
) -> tuple[Float[Array, "*direction"], Float[Array, "*direction"], Float[Array, "*direction"]]:
    """Y, x and y: three Perez distributions, each times `zenith`; the rest is what `geometry` returns.

    **Arguments:** `zenith` per unit of F; `coefficients` A, B, C, D, E. **Returns:** the unit of `zenith`; a negative
    Y and that below the horizon are 0. **Valid, source:** as `perez_distribution`.
    """

    def distribution(scale, row):
        a, b, c, d, e = row
        horizon = scale + scale * a * jnp.exp(jnp.minimum(b * slant, LARGEST_EXPONENT))
        return horizon * (1.0 + c * jnp.exp(jnp.minimum(d * angle, LARGEST_EXPONENT)) + e * cosine_squared)

    luminance, x, y = (distribution(scale, row) for scale, row in zip(zenith, coefficients, strict=True))
    return jnp.where(slant > 0.0, jnp.maximum(luminance, 0.0), 0.0), x, y


@jax.jit
def linear_srgb(
    luminance: Float[Array, "*direction"], x: Float[Array, "*direction"], y: Float[Array, "*direction"]
) -> Float[Array, "3 ..."]:
    r"""Linear sRGB of luminance and chromaticity, $\frac{Y}{y} M (x, y, 1 - x - y)$, in the unit of Y.

    **Valid:** y > 0; smaller y is taken as 1e-6. **Source:** IEC 61966-2-1:1999, CIE 015:2018.
    """
    scale = luminance / jnp.maximum(y, _SMALLEST_Y)
    rows = SRGB_FROM_XYZ.tolist()
    return jnp.stack([scale * ((of_x - of_z) * x + of_z) + (of_y - of_z) * luminance for of_x, of_y, of_z in rows])
