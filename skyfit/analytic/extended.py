"""Perez' form with coefficients that vary smoothly with turbidity and sun, to twilight."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from ..tables import read_table
from .analytic import AbstractAnalyticSky
from .perez import LARGEST_EXPONENT, Perez


# Domain of the Chebyshev polynomials: turbidity, and the sun's zenith angle in degrees
TURBIDITY_RANGE = (1.0, 10.0)
SUN_ZENITH_RANGE_DEG = (0.0, 92.0)
_SUN_ZENITH_RANGE = (math.radians(SUN_ZENITH_RANGE_DEG[0]), math.radians(SUN_ZENITH_RANGE_DEG[1]))
# Lower bound of the circumsolar and the backscatter term; 1 plus both then stays positive
LOWEST_TERM = -0.45
# Largest ln(-B) and ln(-D). In thin air the colour hardly changes toward the horizon, and the factor e^-B in A would
# overflow
STEEPEST = math.log(LARGEST_EXPONENT)
# Width of the rounded corner of the map to LOWEST_TERM
CORNER = 0.1


class ExtendedPreetham(AbstractAnalyticSky):
    r"""Luminance and chromaticity of a clear sky for turbidity 1 to 10 and sun zenith angles to 92 degrees.

    Preetham's five coefficients (eq. 3, 4) are linear in turbidity and the same for every sun. Here each quantity has
    six numbers, each a Chebyshev series in $\log T$ and the square of the sun's zenith angle,
    $u_k = \sum_{ij} c_{kij} T_i(2 \log_{10} T - 1) T_j(2 (\theta_s / 92^\circ)^2 - 1)$, and
    $1 + A e^{B / \cos\theta} = 1 + (e^{u_0} - 1) e^{B (1 / \cos\theta - 1)}$, $B = -e^{u_1}$, $C = s(u_2)$,
    $D = -e^{u_3}$, $E = s(u_4)$, zenith value $e^{u_5}$, with s a smooth map to numbers above -0.45, and B and D at
    least -20. Y, x and y are therefore positive and finite by construction. $e^{u_0}$ is the ratio of zenith to horizon
    in the gradation factor.

    `coefficients` c of Y (cd m^-2), x, y; `fitted_turbidity` and `fitted_sun` (zenith angles, radians), the range of
    the skies they were fitted to. **Valid:** the fitted range. Beyond turbidity 1 to 10 and sun 0 to 92 degrees the
    value at the edge holds. The shipped x + y exceeds 1 (negative Z) in the last degree above the horizon for pure air
    and a sun beyond 88 degrees.
    **Source:** `skyfit.refit(form="extended")`; the shipped ones by experiments/studies/refit.py.

    **Example:**

        >>> sky = skyfit.ExtendedPreetham.shipped()
        >>> bool(sky.valid(3.0, np.radians(80.0))), bool(sky.valid(12.0, np.radians(80.0)))
        (True, False)
    """

    coefficients: Float[Array, "3 6 turbidity sun"]
    fitted_turbidity: tuple[float, float] = eqx.field(static=True, default=TURBIDITY_RANGE)
    fitted_sun: tuple[float, float] = eqx.field(static=True, default=_SUN_ZENITH_RANGE)

    @classmethod
    def shipped(cls) -> "ExtendedPreetham":
        """Coefficients for skyfit's default atmosphere (data/extended_preetham.csv says which)."""
        table = read_table("extended_preetham.csv")
        columns = [name for name in table if name.startswith("sun_")]
        rows = np.stack([table[name] for name in columns], axis=1)
        return cls(jnp.asarray(rows.reshape(3, 6, -1, len(columns))))

    def numbers(self, turbidity: Float[ArrayLike, ""], theta_sun: Float[ArrayLike, ""]) -> Float[Array, "3 6"]:
        """The six unbounded numbers u of Y, x, y; arguments as for `perez`."""
        return jnp.einsum("qkij,ij->qk", self.coefficients, self.polynomials(turbidity, theta_sun))

    def polynomials(
        self, turbidity: Float[ArrayLike, ""], theta_sun: Float[ArrayLike, ""]
    ) -> Float[Array, "turbidity sun"]:
        """The products of Chebyshev polynomials that the coefficients multiply; arguments as for `perez`."""
        low, high = (math.log(t) for t in TURBIDITY_RANGE)
        # The inputs are clipped: beyond the range the value at the edge holds
        haze = (jnp.log(jnp.maximum(turbidity, TURBIDITY_RANGE[0])) - low) / (high - low)
        sun = jnp.square(jnp.asarray(theta_sun) / math.radians(SUN_ZENITH_RANGE_DEG[1]))
        rows = _chebyshev(haze, self.coefficients.shape[2])
        columns = _chebyshev(sun, self.coefficients.shape[3])
        return rows[:, None] * columns[None]

    def perez(self, turbidity: Float[ArrayLike, ""], theta_sun: Float[ArrayLike, ""]) -> tuple[Perez, Perez, Perez]:
        """The distributions of luminance Y and of chromaticity x and y; range and source as for the class."""
        luminance, x, y = (_perez(row) for row in self.numbers(turbidity, theta_sun))
        return luminance, x, y

    def zenith(
        self, turbidity: Float[ArrayLike, ""], theta_sun: Float[ArrayLike, ""]
    ) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
        """Luminance (cd m^-2) and chromaticity x, y of the zenith; range and source as for the class."""
        luminance, x, y = jnp.exp(self.numbers(turbidity, theta_sun)[:, 5])
        return luminance, x, y

    def check_range(self, turbidity, sun_zenith) -> None:
        """Raise `ValueError` outside the fitted range; for concrete values, outside jit."""
        for name, values, (low, high) in (
            ("turbidity", np.asarray(turbidity, float), self.fitted_turbidity),
            ("sun_zenith", np.asarray(sun_zenith, float), self.fitted_sun),
        ):
            # float32 pi/2 is above pi/2
            bad = ~((values >= low - 1e-6) & (values <= high + 1e-6))
            if bad.any():
                raise ValueError(f"`{name}` must be between {low:g} and {high:.4g}, got {values[bad].flat[0]:g}")

    def valid(self, turbidity: Float[ArrayLike, ""], sun_zenith: Float[ArrayLike, ""]) -> Bool[Array, ""]:
        """Whether turbidity and sun are within the fitted range; a flag for batches. NaN gives False."""
        turbidity, sun = jnp.asarray(turbidity), jnp.asarray(sun_zenith)
        (thin, thick), (high, low) = self.fitted_turbidity, self.fitted_sun
        # Rounding to float32 may move an angle beyond the limit
        return (turbidity >= thin) & (turbidity <= thick) & (sun >= high - 1e-6) & (sun <= low + 1e-6)


def _chebyshev(share, count: int):
    """Chebyshev polynomials on [0, 1] up to degree `count` - 1."""
    x = 2.0 * jnp.clip(share, 0.0, 1.0) - 1.0
    rows = [jnp.ones_like(x), x]
    for _ in range(2, count):
        rows.append(2.0 * x * rows[-1] - rows[-2])
    return jnp.stack(rows[:count])


def _perez(numbers) -> Perez:
    """Perez' coefficients from six unbounded numbers."""
    steepness = jnp.exp(jnp.minimum(numbers[1], STEEPEST))
    return Perez(
        jnp.expm1(numbers[0]) * jnp.exp(steepness),
        -steepness,
        _above(numbers[2]),
        -jnp.exp(jnp.minimum(numbers[3], STEEPEST)),
        _above(numbers[4]),
    )


def _above(number):
    """A smooth map from all numbers to those above -0.45, with slope 1 for large numbers."""
    return LOWEST_TERM + 0.5 * (number + jnp.sqrt(jnp.square(number) + CORNER**2))
