"""Fast colours of an analytic sky in many directions: no trigonometric functions, six exponentials per pixel.

Each step is compiled separately. In one program XLA would fuse them into one loop each for red, green and blue, and
each loop would repeat nearly all computations.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..light import SMALLEST_Y, SRGB_FROM_XYZ, SRGB_LUMINANCE
from ..numerics import safe_sqrt
from ..scene import LOWEST_VISIBLE
from .perez import LARGEST_EXPONENT, LOWEST_COSINE


def _polynomial(function, degree: int, end: float) -> tuple[float, ...]:
    """Coefficients of the polynomial interpolating at Chebyshev nodes on [0, end], highest power first."""
    interpolant = np.polynomial.Chebyshev.interpolate(function, degree, domain=[0.0, end])
    return tuple(interpolant.convert(kind=np.polynomial.Polynomial).coef[::-1].tolist())


# arcsin(sqrt(m)) / sqrt(m), m <= 1/2; the error of the angle from the sun is 3e-8 rad
ARCSINE = _polynomial(lambda m: np.arcsin(np.sqrt(m)) / np.sqrt(m), 7, 0.5)
# sin(sqrt(q))^2 / q, sqrt(q) <= pi / 2; the error of the square is 3e-8
_SQUARED_SINE = _polynomial(lambda q: np.square(np.sin(np.sqrt(q))) / q, 5, 0.25 * np.pi**2)

_BELOW = -1.0


def _horner(coefficients: tuple[float, ...], x: Float[Array, "..."]) -> Float[Array, "..."]:
    value = jnp.full_like(x, coefficients[0])
    for coefficient in coefficients[1:]:
        value = value * x + coefficient
    return value


@jax.jit
def geometry(
    sun: Float[Array, "3"], view: Float[Array, "3 ..."]
) -> tuple[Float[Array, "*direction"], Float[Array, "*direction"]]:
    r"""Angle from the sun $\gamma$ and $1/\cos\theta$ of unit vectors; the latter is -1 below the horizon.

    $\sin^2(\gamma/2) = |v - s|^2 / 4$, which is accurate near the sun.

    **Arguments:** unit vectors, the vertical last. **Returns:** radians; dimensionless; `[direction]` each.
    **Valid:** everywhere; the gradient of the angle is 0 where it is 0 or pi.
    """
    half = 0.25 * (jnp.square(view[0] - sun[0]) + jnp.square(view[1] - sun[1]) + jnp.square(view[2] - sun[2]))
    near = half < 0.5
    smaller = jnp.where(near, half, 1.0 - half)
    angle = 2.0 * safe_sqrt(smaller) * _horner(ARCSINE, smaller)
    slant = jnp.where(view[2] <= LOWEST_VISIBLE, _BELOW, 1.0 / jnp.maximum(view[2], LOWEST_COSINE))
    return jnp.where(near, angle, jnp.pi - angle), slant


@jax.jit
def tristimulus(
    zenith: Float[Array, "3"],
    coefficients: Float[Array, "3 parameter"],
    angle: Float[Array, "*direction"],
    slant: Float[Array, "*direction"],
) -> tuple[Float[Array, "*direction"], Float[Array, "*direction"], Float[Array, "*direction"]]:
    """X, Y and X + Y + Z from three Perez distributions of Y, x and y, each times `zenith`.

    **Arguments:** `zenith` values of Y, x, y per unit of F; `coefficients` A, B, C, D, E of each; `angle` and `slant`
    from `geometry`. **Returns:** values in the unit of Y; 0 below the horizon and where Y is negative.
    **Valid:** as `perez_distribution`, and y > 0; y below 1e-6 is raised to it. **Source:** Preetham 1999 eq. 3, 4.
    """
    squared = jnp.square(angle - 0.5 * jnp.pi)
    # Computing this for each of the three distributions is cheaper than storing it
    cosine_squared = squared * _horner(_SQUARED_SINE, squared)

    def distribution(scale, row):
        a, b, c, d, e = row
        horizon = scale + scale * a * jnp.exp(jnp.minimum(b * slant, LARGEST_EXPONENT))
        return horizon * (1.0 + c * jnp.exp(jnp.minimum(d * angle, LARGEST_EXPONENT)) + e * cosine_squared)

    luminance, x, y = (distribution(scale, row) for scale, row in zip(zenith, coefficients, strict=True))
    luminance = jnp.where(slant > 0.0, jnp.maximum(luminance, 0.0), 0.0)
    total = luminance / jnp.maximum(y, SMALLEST_Y)
    return x * total, luminance, total


@jax.jit
def linear_srgb(
    first: Float[Array, "*direction"], luminance: Float[Array, "*direction"], total: Float[Array, "*direction"]
) -> Float[Array, "3 ..."]:
    r"""Linear sRGB from X, Y and X + Y + Z, in the same unit. **Source:** IEC 61966-2-1:1999."""
    rows = SRGB_FROM_XYZ.tolist()
    return jnp.stack([(of_x - of_z) * first + (of_y - of_z) * luminance + of_z * total for of_x, of_y, of_z in rows])


@jax.jit
def paled(rgb: Float[Array, "3 ..."]) -> Float[Array, "3 ..."]:
    """Colours mixed with grey of the same luminance until no component is negative."""
    red, green, blue = SRGB_LUMINANCE.tolist()
    grey = jnp.maximum(red * rgb[0] + green * rgb[1] + blue * rgb[2], 0.0)
    least = jnp.minimum(jnp.min(rgb, axis=0), 0.0)
    share = jnp.where(least < 0.0, grey / jnp.where(least < 0.0, grey - least, 1.0), 1.0)
    # Rounding may leave slightly negative values
    return jnp.maximum(grey[None] + share[None] * (rgb - grey[None]), 0.0)
