"""The scene: the sun's position, the directions of view and the wavelengths."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..light import earth_sun_factor, extraterrestrial_irradiance
from ..numerics import as_float, as_float_or_none, IN_MICROMETRES, radians_within, Ranged, within
from .directions import Directions, MOST_AZIMUTH


def _radians(degrees):
    # Computed with NumPy where possible: with JAX it would be one more compiled program
    return jnp.deg2rad(as_float(degrees)) if isinstance(degrees, jax.Array) else np.deg2rad(np.asarray(degrees, float))


class Scene(Ranged):
    """The geometry and the spectrum of one sky, seen by one observer.

    `sun_zenith`, `sun_azimuth` at the observer, in radians, azimuth clockwise from north;
    `wavelength_nm`, 200 to 5000 nm; `solar_irradiance` on a plane normal to the sun at the top of the atmosphere,
    W m^-2 nm^-1; `height` of the observer above the ground in m, or None for the ground, which costs nothing.

    **Valid:** zenith angle 0 to pi, azimuth to two turns, irradiance and height not negative. Concrete values outside
    are a `ValueError`.

    **Example:**

        >>> scene = skyfit.Scene.from_degrees(60, skyfit.hemisphere(10), [450, 550, 650])
        >>> scene.view.zenith.shape, scene.solar_irradiance.shape
        ((10,), (3,))
    """

    sun_zenith: Float[Array, ""] = eqx.field(converter=as_float, metadata=radians_within(0.0, np.pi))
    sun_azimuth: Float[Array, ""] = eqx.field(converter=as_float, metadata=radians_within(-MOST_AZIMUTH, MOST_AZIMUTH))
    view: Directions
    wavelength_nm: Float[Array, " wavelength"] = eqx.field(
        converter=as_float, metadata=within(200.0, 5000.0, "nm", IN_MICROMETRES)
    )
    solar_irradiance: Float[Array, " wavelength"] = eqx.field(converter=as_float, metadata=within(0.0, 1e30))
    height: Float[Array, ""] | None = eqx.field(
        converter=as_float_or_none, default=None, metadata=within(0.0, 1e9, "m")
    )

    def __check_init__(self):
        if self.wavelength_nm.ndim != 1 or self.solar_irradiance.shape != self.wavelength_nm.shape:
            raise ValueError(
                "`wavelength_nm` must be 1-d and `solar_irradiance` of its length, "
                f"got {self.wavelength_nm.shape} and {self.solar_irradiance.shape}"
            )

    @classmethod
    def from_degrees(
        cls,
        sun_zenith,
        view: Directions,
        wavelength_nm,
        sun_azimuth=0.0,
        day_of_year: int | None = None,
        fwhm_nm: float | None = None,
        irradiance: Literal["astm_g173", "preetham", "unit"] | np.ndarray = "astm_g173",
        height=None,
    ) -> "Scene":
        """A scene from sun angles in degrees, with a tabulated solar spectrum.

        **Arguments:** sun angles in degrees; `view`; `wavelength_nm` `[wavelength]`; `day_of_year` scales
        the irradiance by the Earth-Sun distance (None: 1 au); `fwhm_nm`, the width of the instrument's Gaussian line
        shape; `irradiance`, a named spectrum, "unit" (1 at every wavelength) or values in W m^-2 nm^-1;
        `height` of the observer above the ground, m (None: on the ground).
        **Returns:** a `Scene`. **Valid:** 300-1100 nm for "astm_g173", 380-750 nm for "preetham".
        """
        if isinstance(irradiance, str):
            if irradiance == "unit":
                values = np.ones(np.shape(wavelength_nm))
            else:
                values = extraterrestrial_irradiance(np.asarray(wavelength_nm), fwhm_nm, irradiance)
        else:
            values = irradiance
        if day_of_year is not None:
            values = values * earth_sun_factor(day_of_year)
        return cls(_radians(sun_zenith), _radians(sun_azimuth), view, wavelength_nm, values, height)
