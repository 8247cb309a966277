"""Direct sunlight at the ground, attenuated by air, haze, ozone, mixed gases and water vapour."""

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from ..atmosphere import angstrom_coefficient, DOBSON_PER_METRE, Ozone, preetham_absorption
from ..light import SUN_SOLID_ANGLE
from ..numerics import as_float, check_radians, check_wavelength, Ranged, within
from ..scene import LOWEST_VISIBLE, relative_airmass, Scene


# Range of the absorption coefficients, nm; from 380 to 780 nm they are the paper's
_SHORTEST, _LONGEST = 300.0, 1100.0
# Largest amounts, m: 1000 Dobson units, and three times the water vapour of the tropics. Larger numbers are probably
# in another unit
_MOST_OZONE, _MOST_WATER = 0.01, 0.2
# beta is 0 at turbidity 0.9952
_LOWEST_TURBIDITY = 0.995


class Transmittances(NamedTuple):
    """Transmittance of the direct beam for each constituent, dimensionless, `[wavelength]` each."""

    rayleigh: Float[Array, " wavelength"]
    aerosol: Float[Array, " wavelength"]
    ozone: Float[Array, " wavelength"]
    mixed_gases: Float[Array, " wavelength"]
    water_vapour: Float[Array, " wavelength"]

    def product(self) -> Float[Array, " wavelength"]:
        """The transmittance of all constituents together."""
        return self.rayleigh * self.aerosol * self.ozone * self.mixed_gases * self.water_vapour


class Sunlight(Ranged):
    r"""Direct sunlight at sea level through haze of a given turbidity.

    `turbidity`, dimensionless, from 0.995; `angstrom_exponent` of the haze; `ozone`, m at NTP (0.0035 m are 350 Dobson
    units); `water_vapour`, m of precipitable water. With airmass m and wavelength in um the factors are
    $e^{-0.008735\,\lambda^{-4.08} m}$, $e^{-\beta\lambda^{-\alpha} m}$, $e^{-k_o l m}$,
    $e^{-1.41 k_g m / (1 + 118.93 k_g m)^{0.45}}$, $e^{-0.2385 k_w w m / (1 + 20.07 k_w w m)^{0.45}}$.

    **Valid:** turbidity from 0.995, ozone to 0.01 m, water to 0.2 m, else `ValueError`; traced values are not checked,
    and negative water counts as 0. 300 to 1100 nm, else `ValueError`; traced wavelengths beyond get the coefficients at
    the ends. From 380 to 780 nm the coefficients are the paper's, where a gap means no absorption; outside, they are
    those of SPECTRL2. Both are Leckner's, but the paper lacks oxygen's band at 687 nm and smooths that at 762 nm. The
    sun is at or above the horizon and the observer at sea level.
    The paper found luminance and chromaticity at turbidity 2 within 2 % of Wyszecki & Stiles' sun, whose numbers were
    not at hand. The direct beam of ASTM G173, with its own haze and gases, is reproduced within 1.3 %
    (experiments/validation/sunlight.py).
    **Source:** Preetham 1999, A.1 and Table 2, after Iqbal 1983 (Leckner 1978). The paper prints the airmass inside
    the exponents of the wavelength ($\lambda^{-4.08 m}$), against Bouguer's law. 300-380 and 780-1100 nm: Bird &
    Riordan 1986, Table 1.

    **Example:**

        >>> scene = skyfit.Scene.from_degrees(60, skyfit.hemisphere(20), [450, 550, 650])
        >>> sun = skyfit.Sunlight(3.0)
        >>> blue, green, red = sun.irradiance(scene) / scene.solar_irradiance
        >>> bool(blue < green < red)
        True
    """

    turbidity: Float[Array, ""] = eqx.field(converter=as_float, metadata=within(_LOWEST_TURBIDITY, 1e4))
    angstrom_exponent: Float[Array, ""] = eqx.field(converter=as_float, default=1.3, metadata=within(-2.0, 6.0))
    ozone: Float[Array, ""] = eqx.field(converter=as_float, default=0.0035, metadata=within(0.0, _MOST_OZONE, "m"))
    water_vapour: Float[Array, ""] = eqx.field(converter=as_float, default=0.02, metadata=within(0.0, _MOST_WATER, "m"))

    def factors(
        self, theta_sun: Float[ArrayLike, ""], wavelength_nm: Float[ArrayLike, " wavelength"]
    ) -> Transmittances:
        """The transmittance of each constituent.

        **Arguments:** `theta_sun`, the sun's zenith angle in radians; `wavelength_nm` `[wavelength]`.
        **Returns:** `Transmittances`. **Valid, source:** as for the class; below the horizon the airmass is that at it.
        """
        wavelength_nm = as_float(wavelength_nm)
        check_radians("theta_sun", theta_sun, 0.0, math.pi)
        check_wavelength(wavelength_nm, _SHORTEST, _LONGEST, "of the absorption coefficients")
        airmass = relative_airmass(as_float(theta_sun))
        per_water, mixed = (
            jnp.interp(wavelength_nm, *map(as_float, preetham_absorption(name)))
            for name in ("water_absorption", "mixed_gas_absorption")
        )
        ozone = Ozone(column=DOBSON_PER_METRE * self.ozone, table="preetham").optical_depth_at(wavelength_nm)
        log_micrometre = jnp.log(wavelength_nm * 1e-3)
        # Iqbal 1983, after Leckner 1978
        rayleigh = 0.008735 * jnp.exp(-4.08 * log_micrometre)
        haze = angstrom_coefficient(self.turbidity) * jnp.exp(-self.angstrom_exponent * log_micrometre)
        gas, water = mixed * airmass, per_water * (self.water_vapour * airmass)
        return Transmittances(
            jnp.exp(-rayleigh * airmass),
            jnp.exp(-haze * airmass),
            jnp.exp(-ozone * airmass),
            jnp.exp(-1.41 * _band(gas, 118.93)),
            jnp.exp(-0.2385 * _band(water, 20.07)),
        )

    def transmittance(
        self, theta_sun: Float[ArrayLike, ""], wavelength_nm: Float[ArrayLike, " wavelength"]
    ) -> Float[Array, " wavelength"]:
        """The transmittance of all constituents together; arguments, range and source as for `factors`."""
        return self.factors(theta_sun, wavelength_nm).product()

    def irradiance(self, scene: Scene) -> Float[Array, " wavelength"]:
        """Irradiance of the direct beam at the ground, on a plane normal to it, W m^-2 nm^-1.

        **Arguments:** `scene`, with the observer on the ground, else `ValueError`.
        **Returns:** `[wavelength]`. **Valid:** as for the class; 0 if the sun is below the horizon.
        """
        if scene.height is not None:
            raise ValueError("`height` of the scene must be None for Sunlight: it knows the observer at sea level only")
        light = scene.solar_irradiance * self.transmittance(scene.sun_zenith, scene.wavelength_nm)
        return jnp.where(jnp.cos(scene.sun_zenith) > LOWEST_VISIBLE, light, 0.0)

    def radiance(self, scene: Scene) -> Float[Array, " wavelength"]:
        """Mean radiance of the sun's disc, W m^-2 sr^-1 nm^-1: `irradiance` over the disc's 6.794e-5 sr at 1 au.

        **Arguments, valid:** as `irradiance`. **Returns:** `[wavelength]`.
        """
        return self.irradiance(scene) / SUN_SOLID_ANGLE


def _band(amount, saturation):
    r"""An absorption band that saturates, $x / (1 + s x)^{0.45}$; Leckner 1978."""
    # Without this a negative amount would take the logarithm of a negative number
    amount = jnp.where(amount < 0.0, 0.0, amount)
    return amount * jnp.exp(-0.45 * jnp.log1p(saturation * amount))
