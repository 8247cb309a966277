"""Haze: aerosol by Angstrom's law."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics import ALL_WAVELENGTHS, as_float, within
from .constituent import AbstractConstituent
from .phase import AbstractPhase, HenyeyGreenstein, REFERENCE_WAVELENGTH
from .profile import AbstractProfile, Exponential, HAZE_SCALE_HEIGHT


class Aerosol(AbstractConstituent):
    r"""Aerosol with optical depth $\tau_{550} e^{-\alpha x + \gamma x^2}$, $x = \ln(\lambda/550)$.

    `optical_depth` at 550 nm, 0 to 1000; `angstrom_exponent` alpha, -2 to 6; `single_scattering_albedo` at 550 nm in
    [0, 1] and its slope per unit of x; `phase`; `profile`; `angstrom_curvature` gamma, -3 to 3 (fine smoke has -0.5).
    Source: Angstrom 1929; gamma: Eck et al. 1999, J. Geophys. Res. 104, 31333. Scale height 1.2 km: Preetham 1999,
    A.4 (0.8333 /km).

    **Example:**

        >>> haze = skyfit.Aerosol(0.1, angstrom_exponent=1.0)
        >>> round(float(haze.optical_depth_at(1100.0)), 3)
        0.05
    """

    optical_depth: Float[Array, ""] = eqx.field(converter=as_float, metadata=within(0.0, 1e3))
    angstrom_exponent: Float[Array, ""] = eqx.field(converter=as_float, default=1.3, metadata=within(-2.0, 6.0))
    single_scattering_albedo: Float[Array, ""] = eqx.field(converter=as_float, default=0.95, metadata=within(0.0, 1.0))
    single_scattering_albedo_slope: Float[Array, ""] = eqx.field(
        converter=as_float, default=0.0, metadata=within(-10.0, 10.0)
    )
    phase: AbstractPhase = eqx.field(default_factory=lambda: HenyeyGreenstein(0.7))
    profile: AbstractProfile = eqx.field(default_factory=lambda: Exponential(HAZE_SCALE_HEIGHT))
    angstrom_curvature: Float[Array, ""] = eqx.field(converter=as_float, default=0.0, metadata=within(-3.0, 3.0))
    smooth_in_wavelength: ClassVar[bool] = True
    known_nm: ClassVar[tuple[float, float]] = ALL_WAVELENGTHS

    def optical_depth_at(self, wavelength_nm):
        ratio = jnp.log(wavelength_nm / REFERENCE_WAVELENGTH)
        return self.optical_depth * jnp.exp((self.angstrom_curvature * ratio - self.angstrom_exponent) * ratio)

    def single_scattering_albedo_at(self, wavelength_nm):
        ratio = jnp.log(wavelength_nm / REFERENCE_WAVELENGTH)
        return jnp.clip(self.single_scattering_albedo + self.single_scattering_albedo_slope * ratio, 0.0, 1.0)
