"""Scattering by air molecules."""

from typing import ClassVar, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..numerics import ALL_WAVELENGTHS, as_float, check_range, within
from .constituent import AbstractConstituent
from .phase import AbstractPhase, RayleighPhase
from .profile import AbstractProfile, Exponential


# Pressure of the standard atmosphere at sea level, Pa
SEA_LEVEL_PRESSURE = 101325.0
# Density scale height of air, m (oracles and Bruneton & Neyret 2008, sec. 2.1)
AIR_SCALE_HEIGHT = 8000.0
# Vertical optical length of air, m (Hoffman & Preetham 2002, Sunlight)
AIR_OPTICAL_LENGTH = 8400.0


def bodhaine_optical_depth(wavelength_nm):
    r"""Rayleigh optical depth of the whole column at 1013.25 mb, 45 degrees north.

    $\tau = 0.0021520 \frac{1.0455996 - 341.29061\lambda^{-2} - 0.90230850\lambda^2}
    {1 + 0.0027059889\lambda^{-2} - 85.968563\lambda^2}$, $\lambda$ in micrometres.

    **Arguments:** `wavelength_nm`, nm. **Returns:** dimensionless. **Valid:** 250-1100 nm.
    **Source:** Bodhaine et al. 1999, J. Atmos. Ocean. Tech. 16, 1854, eq. 30.
    """
    square = (wavelength_nm * 1e-3) ** 2
    numerator = 1.0455996 - 341.29061 / square - 0.90230850 * square
    return 0.0021520 * numerator / (1.0 + 0.0027059889 / square - 85.968563 * square)


def paper_scattering_coefficient(wavelength_nm):
    r"""$\beta = \frac{8\pi^3(n^2-1)^2}{3N\lambda^4}\frac{6+3p}{6-7p}$ of air at the ground, m^-1.

    **Arguments:** `wavelength_nm`, nm. **Returns:** m^-1. **Valid:** the visible (n is one number).
    **Source:** Preetham 1999, A.3; Hoffman & Preetham 2002. n = 1.0003, N = 2.545e25 m^-3, p = 0.035; N is
    that of 288.15 K (they print 228.15 K and 0 C). Bruneton & Neyret 2008, eq. 1 leaves the last factor out,
    though their own values need it.
    """
    index, density, depolarization = 1.0003, 2.545e25, 0.035
    king = (6.0 + 3.0 * depolarization) / (6.0 - 7.0 * depolarization)
    scale = 8.0 * np.pi**3 * (index**2 - 1.0) ** 2 / (3.0 * density) * king
    # lambda^4 in um^4, because in m^4 it underflows float32
    return scale * 1e24 / (wavelength_nm * 1e-3) ** 4


def pressure_at_altitude(altitude_m):
    r"""Pressure of the 1976 standard troposphere, Pa: $p = p_0 (1 - 2.25577\cdot10^{-5} h)^{5.25588}$.

    **Arguments:** `altitude_m` above sea level. **Returns:** Pa. **Valid:** -500 to 11000 m.
    **Source:** US Standard Atmosphere 1976, lapse rate 6.5 K/km.
    """
    check_range("altitude_m", altitude_m, -500.0, 11e3, "m")
    return SEA_LEVEL_PRESSURE * (1.0 - 2.25577e-5 * altitude_m) ** 5.25588


class Rayleigh(AbstractConstituent):
    """Air molecules: their optical depth is proportional to the station's pressure.

    `pressure` at the ground, 2000 to 120000 Pa (for no air leave this constituent out); `formula` "bodhaine" (default)
    or "paper" (n = 1.0003, 17 % larger).

    **Example:**

        >>> round(float(skyfit.Rayleigh().optical_depth_at(np.array([550.0]))[0]), 4)
        0.0971
    """

    pressure: Float[Array, ""] = eqx.field(
        converter=as_float, default=SEA_LEVEL_PRESSURE, metadata=within(2e3, 1.2e5, "Pa", "hPa times 100")
    )
    phase: AbstractPhase = eqx.field(default_factory=RayleighPhase)
    profile: AbstractProfile = eqx.field(default_factory=lambda: Exponential(AIR_SCALE_HEIGHT))
    formula: Literal["bodhaine", "paper"] = eqx.field(static=True, default="bodhaine")
    smooth_in_wavelength: ClassVar[bool] = True
    known_nm: ClassVar[tuple[float, float]] = ALL_WAVELENGTHS

    def __check_init__(self):
        if self.formula not in ("bodhaine", "paper"):
            raise ValueError(f'`formula` must be "bodhaine" or "paper", got {self.formula!r}')

    def optical_depth_at(self, wavelength_nm):
        if self.formula == "paper":
            sea_level = paper_scattering_coefficient(wavelength_nm) * AIR_OPTICAL_LENGTH
        else:
            sea_level = bodhaine_optical_depth(wavelength_nm)
        return sea_level * (self.pressure / SEA_LEVEL_PRESSURE)

    def single_scattering_albedo_at(self, wavelength_nm):
        return jnp.ones_like(wavelength_nm)
