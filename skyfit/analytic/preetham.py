"""The analytic daylight model of Preetham, Shirley and Smits 1999, with any set of coefficients."""

import math
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from ..tables import read_table
from .analytic import AbstractAnalyticSky, check_sun_is_up
from .perez import Perez


LARGEST_CHI = 1.5  # rad; the published angle stays below 4 pi / 9 = 1.396 for all turbidities > 0


class Preetham(AbstractAnalyticSky):
    """Luminance and chromaticity of a clear sky as functions of turbidity and the sun's zenith angle.

    `distribution` `[Y x y, A B C D E, slope constant]`: Perez coefficients, linear in turbidity.
    `zenith_luminance` `[tangent offset angle, slope constant]`, each linear in turbidity, the first
    two in kcd m^-2. `zenith_chromaticity` `[x y, T^2 T 1, cube square linear constant]` in the
    sun's zenith angle in radians. `check_range` raises below `lowest_turbidity`. `valid` is False outside
    `fitted_turbidity` and beyond `lowest_sun` (zenith angle, radians). These limits belong to the coefficients, so a
    refit has its own. Outside the range the results are finite but meaningless: the published Y has a pole at turbidity
    1.643, and below it most of the sky is negative.

    **Source:** Preetham 1999 A.2. The fit there is to simulations of turbidity 2 to 6.

    **Example:**

        >>> scene = skyfit.Scene.from_degrees(60, skyfit.hemisphere(10), [450, 550, 650])
        >>> skyfit.Preetham.published().xyz(3.0, scene).shape
        (10, 3)
    """

    distribution: Float[Array, "3 5 2"]
    zenith_luminance: Float[Array, "3 2"]
    zenith_chromaticity: Float[Array, "2 3 4"]
    lowest_turbidity: float = eqx.field(static=True, default=1.7)
    fitted_turbidity: tuple[float, float] = eqx.field(static=True, default=(2.0, 10.0))
    lowest_sun: float = eqx.field(static=True, default=0.5 * math.pi)

    @classmethod
    def published(cls, digits: Literal[4, 5] = 4) -> "Preetham":
        """The coefficients of the paper (A.2), as printed, or with the fifth decimal of public code.

        **Arguments:** `digits` after the point. With four digits the luminance agrees with that of five within 0.05 %,
        but x at the zenith, where rounding is multiplied by T^2 and the cube of the sun's angle, differs by up to 6 %
        at T = 8.
        **Source:** data/preetham_*.csv say whose each digit is.
        """
        if digits not in (4, 5):
            raise ValueError(f"`digits` must be 4 or 5, got {digits!r}")
        end = "" if digits == 4 else "_5"
        perez = read_table(f"preetham_perez_coefficients{end}.csv")
        chromaticity = read_table(f"preetham_zenith_chromaticity{end}.csv")
        zenith = read_table("preetham_zenith_luminance.csv")
        powers = ("cubic", "square", "linear", "constant")
        distribution = [[perez[f"{name}_{c}"] for c in ("slope", "constant")] for name in "Yxy"]
        polynomial = [[chromaticity[f"{name}_{power}"] for power in powers] for name in "xy"]
        return cls(
            jnp.asarray(np.moveaxis(np.array(distribution), 1, 2)),
            jnp.asarray(np.stack([zenith["slope"], zenith["constant"]], axis=1)),
            jnp.asarray(np.moveaxis(np.array(polynomial), 1, 2)),
        )

    @property
    def fitted_sun(self) -> tuple[float, float]:
        """The range of the sun's zenith angle, rad."""
        return 0.0, self.lowest_sun

    def perez(self, turbidity: Float[ArrayLike, ""], theta_sun: Float[ArrayLike, ""]) -> tuple[Perez, Perez, Perez]:
        """The distributions of luminance Y and of chromaticity x and y, the same for every sun.

        **Arguments:** `turbidity`, dimensionless; `theta_sun` is not used.
        **Returns:** three `Perez`, for Y, x, y. **Valid, source:** as for the class.
        """
        coefficients = self.distribution[..., 0] * turbidity + self.distribution[..., 1]
        luminance, x, y = (Perez.from_coefficients(row) for row in coefficients)
        return luminance, x, y

    def zenith(
        self, turbidity: Float[ArrayLike, ""], theta_sun: Float[ArrayLike, ""]
    ) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
        r"""Luminance and chromaticity of the zenith.

        $Y_z = 1000 [(4.0453 T - 4.9710) \tan\chi - 0.2155 T + 2.4192]$,
        $\chi = (4/9 - T/120)(\pi - 2\theta_s)$; x and y: cubic in $\theta_s$, quadratic in T.

        **Arguments:** `turbidity`; `theta_sun`, the sun's zenith angle in radians.
        **Returns:** Y_z in cd m^-2 (the paper's formula is in kcd m^-2), x_z, y_z.
        **Valid:** where `valid` is True. Outside, the formula is finite, with chi limited to +-1.5, but Y_z may be
        negative (sun well below the horizon, or low at T > 11.2).
        **Source:** Preetham 1999 A.2.
        """
        slope, constant = self.zenith_luminance[:, 0], self.zenith_luminance[:, 1]
        tangent, offset, angle = slope * turbidity + constant
        sun = jnp.asarray(theta_sun)
        chi = jnp.clip(angle * (jnp.pi - 2.0 * sun), -LARGEST_CHI, LARGEST_CHI)
        cubic, square, linear, constant = jnp.moveaxis(self.zenith_chromaticity, -1, 0)
        of_sun = ((cubic * sun + square) * sun + linear) * sun + constant
        x, y = (of_sun[:, 0] * turbidity + of_sun[:, 1]) * turbidity + of_sun[:, 2]
        return 1000.0 * (tangent * jnp.tan(chi) + offset), x, y

    def check_range(self, turbidity, sun_zenith) -> None:
        """Raise `ValueError` outside the model's range; for concrete values, outside jit.

        **Arguments:** `turbidity`; `sun_zenith` radians; numbers or arrays.
        **Valid:** turbidity >= `lowest_turbidity` and the sun at or above the horizon. Beyond
        `fitted_turbidity` and `lowest_sun` the model extrapolates: no error here, but `valid` is False.
        """
        low = np.atleast_1d(np.asarray(turbidity, dtype=np.float64))
        bad = ~(np.isfinite(low) & (low >= self.lowest_turbidity))
        if bad.any():
            raise ValueError(
                f"`turbidity` must be at least {self.lowest_turbidity:g}, got {low[bad][0]:g}: these coefficients "
                "have no answer below (the published sky is singular at 1.643)"
            )
        check_sun_is_up(sun_zenith)

    def valid(self, turbidity: Float[ArrayLike, ""], sun_zenith: Float[ArrayLike, ""]) -> Bool[Array, ""]:
        """Whether the model is within its range; a flag for batches, to be mapped with `vmap`.

        **Arguments:** `turbidity`; `sun_zenith` radians.
        **Returns:** True where turbidity is within `fitted_turbidity` (published: 2 to 10), the sun
        not below `lowest_sun` (published: the horizon) and the zenith luminance is positive. NaN gives False.
        """
        low, high = self.fitted_turbidity
        turbidity, sun = jnp.asarray(turbidity), jnp.asarray(sun_zenith)
        luminance, _, _ = self.zenith(turbidity, sun)
        fitted = (turbidity >= low) & (turbidity <= high)
        # Rounding to float32 may move an angle beyond the limit
        return fitted & (sun >= 0.0) & (sun <= self.lowest_sun + 1e-6) & (luminance > 0.0)
