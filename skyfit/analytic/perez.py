"""The five-parameter distribution of sky light by Perez, Seals and Michalsky."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..numerics import as_float, check_radians, Ranged, within


# cos(89.43 deg): from there down the sky keeps one value per angle from the sun
LOWEST_COSINE = 0.01
# exp(20) = 5e8: the square of a product of two of them is still a float32
LARGEST_EXPONENT = 20.0
_SMALLEST_ZENITH = 1e-6
# of a coefficient: any finite one, a float32
_MOST = 1e38


def perez_distribution(
    coefficients: Float[Array, " parameter"],
    theta: Float[ArrayLike, "*direction"],
    gamma: Float[ArrayLike, "*direction"],
) -> Float[Array, "*direction"]:
    r"""Relative sky light in a direction.

    $F(\theta, \gamma) = (1 + A e^{B / \cos\theta}) (1 + C e^{D \gamma} + E \cos^2\gamma)$

    **Arguments:** `coefficients` A, B, C, D, E, `[5]`; `theta` view zenith angle, `gamma` angle
    from the sun, radians, `[direction]`.
    **Returns:** dimensionless, `[direction]`.
    **Valid:** theta below pi/2; angles outside 0 to pi are a `ValueError` where they are not traced. The inputs are
    guarded: cos(theta) is at least 0.01, so that at the horizon and below it the value is that of 89.43 degrees; the
    exponents are at most 20. Value and gradients are finite everywhere.
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

    `horizon_darkening` A: negative brightens the horizon. `horizon_gradient` B: how near the
    horizon that happens, negative. `circumsolar_intensity` C. `circumsolar_width` D, per radian,
    negative: nearer to 0 is wider. `backscatter` E.

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
        """F(theta, gamma), the arguments, range and source of `perez_distribution`."""
        return perez_distribution(self.coefficients, theta, gamma)

    def ratio(
        self,
        theta: Float[ArrayLike, "*direction"],
        gamma: Float[ArrayLike, "*direction"],
        theta_sun: Float[ArrayLike, ""],
    ) -> Float[Array, "*direction"]:
        """Sky light in units of that of the zenith, F(theta, gamma) / F(0, theta_sun).

        **Arguments:** `theta` view zenith angle, `gamma` angle from the sun, `[direction]`,
        `theta_sun` the sun's zenith angle, radians.
        **Returns:** dimensionless, `[direction]`; 1 at the zenith.
        **Valid:** coefficients whose zenith F(0, theta_sun) is positive; nearer to 0 than 1e-6 it
        is taken as 1e-6 with its sign, so that the result is finite, if large.
        **Source:** Preetham 1999 eq. 4.
        """
        return self.relative(theta, gamma) / self.at_zenith(theta_sun)

    def at_zenith(self, theta_sun: Float[ArrayLike, ""]) -> Float[Array, ""]:
        """F(0, theta_sun), the unit of `ratio`, kept away from 0 as it says."""
        zenith = self.relative(jnp.zeros_like(theta_sun), theta_sun)
        smallest = jnp.where(zenith < 0.0, -_SMALLEST_ZENITH, _SMALLEST_ZENITH)
        return jnp.where(jnp.abs(zenith) < _SMALLEST_ZENITH, smallest, zenith)
