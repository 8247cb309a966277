"""The five-parameter distribution of sky light by Perez, Seals and Michalsky."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..numerics import as_float, check_radians, Ranged, within


# Smallest cos(theta), that of 89.43 degrees: below, the sky depends on the angle from the sun only
LOWEST_COSINE = 0.01
# Largest exponent; exp(20) = 5e8, and the square of a product of two such factors fits in float32
LARGEST_EXPONENT = 20.0
_SMALLEST_ZENITH = 1e-6
# Largest coefficient: any finite float32
_MOST = 1e38


def perez_distribution(
    coefficients: Float[Array, " parameter"],
    theta: Float[ArrayLike, "*direction"],
    gamma: Float[ArrayLike, "*direction"],
) -> Float[Array, "*direction"]:
    r"""Relative luminance or chromaticity of the sky in a direction.

    $F(\theta, \gamma) = (1 + A e^{B / \cos\theta}) (1 + C e^{D \gamma} + E \cos^2\gamma)$

    **Arguments:** `coefficients` A, B, C, D, E, `[5]`; `theta` view zenith angle, `gamma` angle
    from the sun, radians, `[direction]`.
    **Returns:** dimensionless, `[direction]`.
    **Valid:** theta below pi/2; concrete angles outside 0 to pi are a `ValueError`. The inputs are guarded: cos(theta)
    is at least 0.01, so at and below the horizon the value at 89.43 degrees holds, and exponents are at most 20. Value
    and gradients are finite everywhere.
    **Source:** Perez et al. 1993 eq. 1; Preetham 1999 eq. 3.
    """
    check_radians("theta", theta, 0.0, np.pi)
    check_radians("gamma", gamma, 0.0, np.pi)
    a, b, c, d, e = coefficients
    cosine = jnp.maximum(jnp.cos(theta), LOWEST_COSINE)
    horizon = 1.0 + a * jnp.exp(jnp.minimum(b / cosine, LARGEST_EXPONENT))
    circumsolar = c * jnp.exp(jnp.minimum(d * jnp.asarray(gamma), LARGEST_EXPONENT))
    return horizon * (1.0 + circumsolar + e * jnp.square(jnp.cos(gamma)))


class Perez(Ranged):
    """Perez' distribution with its five coefficients; see `perez_distribution`.

    `horizon_darkening` A: negative values brighten the horizon. `horizon_gradient` B, negative: how close to the
    horizon that happens. `circumsolar_intensity` C. `circumsolar_width` D, per radian, negative: values near 0 are
    wide. `backscatter` E.

    **Example:**

        >>> sky = skyfit.Perez(-1.0, -0.32, 10.0, -3.0, 0.45)
        >>> toward, away = sky.ratio(np.radians([45.0, 45.0]), np.radians([5.0, 95.0]), np.radians(50.0))
        >>> bool(toward > 5.0 * away)
        True
    """

    horizon_darkening: Float[Array, ""] = eqx.field(converter=as_float, metadata=within(-_MOST, _MOST))
    horizon_gradient: Float[Array, ""] = eqx.field(converter=as_float, metadata=within(-_MOST, _MOST))
    circumsolar_intensity: Float[Array, ""] = eqx.field(converter=as_float, metadata=within(-_MOST, _MOST))
    circumsolar_width: Float[Array, ""] = eqx.field(converter=as_float, metadata=within(-_MOST, _MOST))
    backscatter: Float[Array, ""] = eqx.field(converter=as_float, metadata=within(-_MOST, _MOST))

    @classmethod
    def from_coefficients(cls, coefficients: Float[Array, " parameter"]) -> "Perez":
        """A distribution from A, B, C, D, E in one array `[5]`."""
        return cls(*coefficients)

    @property
    def coefficients(self) -> Float[Array, " parameter"]:
        """A, B, C, D, E in one array `[5]`."""
        return jnp.stack(
            [
                self.horizon_darkening,
                self.horizon_gradient,
                self.circumsolar_intensity,
                self.circumsolar_width,
                self.backscatter,
            ]
        )

    def relative(
        self, theta: Float[ArrayLike, "*direction"], gamma: Float[ArrayLike, "*direction"]
    ) -> Float[Array, "*direction"]:
        """F(theta, gamma); arguments, range and source as for `perez_distribution`."""
        return perez_distribution(self.coefficients, theta, gamma)

    def ratio(
        self,
        theta: Float[ArrayLike, "*direction"],
        gamma: Float[ArrayLike, "*direction"],
        theta_sun: Float[ArrayLike, ""],
    ) -> Float[Array, "*direction"]:
        """Sky light relative to the zenith, F(theta, gamma) / F(0, theta_sun).

        **Arguments:** `theta` view zenith angle, `gamma` angle from the sun, `[direction]`,
        `theta_sun` the sun's zenith angle, radians.
        **Returns:** dimensionless, `[direction]`; 1 at the zenith.
        **Valid:** coefficients with positive F(0, theta_sun). Its absolute value is raised to at least 1e-6 with
        its sign kept, so that the result is finite, though possibly large.
        **Source:** Preetham 1999 eq. 4.
        """
        return self.relative(theta, gamma) / self.at_zenith(theta_sun)

    def at_zenith(self, theta_sun: Float[ArrayLike, ""]) -> Float[Array, ""]:
        """F(0, theta_sun), the divisor in `ratio`, kept away from 0 as described there."""
        zenith = self.relative(jnp.zeros_like(theta_sun), theta_sun)
        smallest = jnp.where(zenith < 0.0, -_SMALLEST_ZENITH, _SMALLEST_ZENITH)
        return jnp.where(jnp.abs(zenith) < _SMALLEST_ZENITH, smallest, zenith)
