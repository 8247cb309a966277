"""The CIE's clear and overcast skies, and a mixture of a clear and an overcast sky."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from ..light import daylight, WHITE, xyY_from_xyz, xyz_from_xyY
from ..numerics import as_float, check_radians, concrete, Ranged, within
from ..scene import above_horizon, Scene
from .analytic import AbstractAnalyticSky, check_sun_is_up
from .perez import Perez


# Preetham 1999 eq. 1 over 0.91: A, B, C, D, E of Perez' form
_CLEAR = (-1.0, -0.32, 10.0 / 0.91, -3.0, 0.45 / 0.91)
# Perez coefficients of a uniform distribution
_EVEN = (0.0, -1.0, 0.0, -1.0, 0.0)
# Largest solar elevation, rad; the tangent diverges toward the zenith (Radiance's gensky stops at 87 degrees, too)
_HIGHEST_SUN = math.radians(87.0)
_NARROWEST = 1e-3


class CIEClear(AbstractAnalyticSky):
    r"""The CIE's clear sky: luminance from sun and turbidity, with the chromaticity of D65, which screens show as grey.

    $Y = Y_z \frac{(0.91 + 10 e^{-3\gamma} + 0.45 \cos^2\gamma) (1 - e^{-0.32/\cos\theta})}
    {(0.91 + 10 e^{-3\theta_s} + 0.45 \cos^2\theta_s) (1 - e^{-0.32})}$, Perez' form with A, B, C, D, E of
    -1, -0.32, 10.99, -3, 0.4945.

    **Valid:** where `valid` is True; beyond, the formula is finite. **Source:** Kittler 1967, CIE 110-1994; Preetham
    1999, eq. 1. The zenith: `zenith`.

    **Example:**

        >>> scene = skyfit.Scene.from_degrees(60, skyfit.hemisphere(20), [450, 550, 650])
        >>> skyfit.CIEClear().radiance(3.0, scene).shape
        (20, 3)
    """

    def perez(self, turbidity: Float[ArrayLike, ""], theta_sun: Float[ArrayLike, ""]) -> tuple[Perez, Perez, Perez]:
        """The distribution of luminance, independent of turbidity and sun, and uniform distributions of x and y."""
        even = Perez(*_EVEN)
        return Perez(*_CLEAR), even, even

    def zenith(
        self, turbidity: Float[ArrayLike, ""], theta_sun: Float[ArrayLike, ""]
    ) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
        r"""Luminance of the zenith, $1000\,[(1.376\,T - 1.81) \tan h + 0.38]$, and the chromaticity of D65.

        **Arguments:** `turbidity`; `theta_sun`, the sun's zenith angle $\pi/2 - h$ in radians.
        **Returns:** cd m^-2, x, y.
        **Valid:** where `valid` is True. A sun within 3 degrees of the zenith is moved to 3 degrees from it, a sun
        below the horizon to the horizon. This T measures the extinction of sunlight, like Linke's turbidity. It is
        close but not equal to Preetham's T: at the same number Preetham's zenith is 1.5 to 4 times as bright.
        **Source:** the formula of Radiance's gensky; Preetham 1999 names Karayel et al. 1984 and CIE 110-1994 for
        formulas of this kind, neither of which was at hand.
        """
        luminance = _clear_zenith(jnp.asarray(turbidity), theta_sun)
        x, y = (jnp.full_like(luminance, value) for value in WHITE)
        return luminance, x, y

    def check_range(self, turbidity, sun_zenith) -> None:
        """Raise `ValueError` if the zenith luminance is not positive or the sun not up; concrete values, outside jit.

        **Arguments:** `turbidity`; `sun_zenith` radians; numbers or arrays.
        """
        turbidity, sun = np.broadcast_arrays(np.atleast_1d(turbidity).astype(float), np.asarray(sun_zenith, float))
        check_sun_is_up(sun)
        luminance = np.asarray(_clear_zenith(turbidity, sun))
        bad = ~(np.isfinite(turbidity) & (luminance > 0.0))
        if bad.any():
            raise ValueError(
                f"`turbidity` must leave the zenith a positive luminance (1.32 always does), got {turbidity[bad][0]:g}"
            )

    def valid(self, turbidity: Float[ArrayLike, ""], sun_zenith: Float[ArrayLike, ""]) -> Bool[Array, ""]:
        """Whether the sun is up, at least 3 degrees from the zenith, and the zenith luminance positive. NaN: False."""
        sun = jnp.asarray(sun_zenith)
        near_zenith = sun < 0.5 * jnp.pi - _HIGHEST_SUN
        return ~near_zenith & (sun <= 0.5 * jnp.pi) & (self.zenith(turbidity, sun)[0] > 0.0)


def _clear_zenith(turbidity, theta_sun):
    elevation = jnp.clip(0.5 * jnp.pi - theta_sun, 0.0, _HIGHEST_SUN)
    return 1000.0 * ((1.376 * turbidity - 1.81) * jnp.tan(elevation) + 0.38)


def overcast_zenith_luminance(theta_sun: Float[ArrayLike, ""]) -> Float[Array, ""]:
    r"""Zenith luminance of the overcast sky, $123 + 8600 \sin h$.

    **Arguments:** `theta_sun`, the sun's zenith angle $\pi/2 - h$ in radians. **Returns:** cd m^-2.
    **Valid:** sun above the horizon; for a sun below it the value at the horizon holds.
    **Source:** the formula of Radiance's gensky; to 0.2 % the $\frac{9}{7\pi} (300 + 21000 \sin h)$ of Krochmann &
    Seidl 1974 and DIN 5034-2, which states the horizontal illuminance.
    """
    check_radians("theta_sun", theta_sun, 0.0, math.pi)
    return 123.0 + 8600.0 * jnp.maximum(jnp.cos(theta_sun), 0.0)


def overcast_luminance(
    theta_sun: Float[ArrayLike, ""], theta: Float[ArrayLike, "*direction"]
) -> Float[Array, "*direction"]:
    r"""Luminance of the CIE's overcast sky, $Y_z (1 + 2 \cos\theta) / 3$.

    **Arguments:** `theta_sun`, zenith angle of the hidden sun; `theta`, view zenith angle `[direction]`; radians.
    **Returns:** cd m^-2, `[direction]`; the horizontal illuminance is $\frac{7\pi}{9} Y_z$.
    **Valid:** views above the horizon; views below it get the horizon's value. Zenith: `overcast_zenith_luminance`.
    **Source:** Moon & Spencer 1942, CIE 110-1994; Preetham 1999, eq. 2.

    **Example:**

        >>> horizon, zenith = skyfit.overcast_luminance(0.8, np.radians([90.0, 0.0]))
        >>> round(float(zenith / horizon), 3)
        3.0
    """
    check_radians("theta", theta, 0.0, math.pi)
    gradation = (1.0 + 2.0 * jnp.maximum(jnp.cos(theta), 0.0)) / 3.0
    return overcast_zenith_luminance(theta_sun) * gradation


class Intermediate(Ranged):
    r"""A sky that changes from clear to overcast with increasing turbidity.

    $L = (1 - w) L_{clear} + w L_{overcast}$, $w = 3s^2 - 2s^3$ with s increasing linearly from 0 at `clear_turbidity`
    to 1 at `overcast_turbidity`. The overcast sky has the spectrum of D65. Radiances are mixed, so luminance and
    spectrum are those of the sum of both lights.

    **Valid:** `clear_turbidity` below `overcast_turbidity`, else `ValueError`. Up to the first turbidity the sky is
    clear, from the second overcast. The clear sky is evaluated at `overcast_turbidity` at most.
    **Source:** Preetham 1999, sec. 5, which says to interpolate and shows an overcast sky at turbidity 10; its own
    model is fitted to 2 to 6 (sec. 3.2): hence 6 and 10. The weight is a choice of this code.

    **Example:**

        >>> round(float(skyfit.Intermediate(skyfit.CIEClear()).overcast_share(8.0)), 3)
        0.5
    """

    clear: AbstractAnalyticSky
    clear_turbidity: Float[Array, ""] = eqx.field(converter=as_float, default=6.0, metadata=within(0.0, 1e4))
    overcast_turbidity: Float[Array, ""] = eqx.field(converter=as_float, default=10.0, metadata=within(0.0, 1e4))

    def __check_init__(self):
        clear, overcast = concrete(self.clear_turbidity), concrete(self.overcast_turbidity)
        if clear is not None and overcast is not None and not np.all(clear < overcast):
            raise ValueError(f"`clear_turbidity` must be below `overcast_turbidity`, got {clear} and {overcast}")

    def overcast_share(self, turbidity: Float[ArrayLike, ""]) -> Float[Array, ""]:
        """The weight w of the overcast sky, 0 to 1, with a slope of 0 at both ends."""
        width = jnp.maximum(self.overcast_turbidity - self.clear_turbidity, _NARROWEST)
        s = jnp.clip((turbidity - self.clear_turbidity) / width, 0.0, 1.0)
        return s * s * (3.0 - 2.0 * s)

    def luminance_chromaticity(
        self,
        turbidity: Float[ArrayLike, ""],
        theta_sun: Float[ArrayLike, ""],
        theta: Float[ArrayLike, "*direction"],
        gamma: Float[ArrayLike, "*direction"],
    ) -> tuple[Float[Array, "*direction"], Float[Array, "*direction"], Float[Array, "*direction"]]:
        """Luminance and chromaticity in the given directions, from the sum of the tristimulus values.

        **Arguments, returns:** as `AbstractAnalyticSky.luminance_chromaticity`. **Valid:** as the clear sky.
        """
        share = self.overcast_share(turbidity)
        thin = jnp.minimum(jnp.asarray(turbidity), self.overcast_turbidity)
        clear = jnp.stack(self.clear.luminance_chromaticity(thin, theta_sun, theta, gamma), axis=-1)
        clear = xyz_from_xyY(jnp.concatenate([clear[..., 1:], clear[..., :1]], axis=-1))
        luminance = overcast_luminance(theta_sun, theta)
        overcast = jnp.stack([luminance * part for part in xyz_from_xyY(jnp.asarray([*WHITE, 1.0]))], axis=-1)
        mixed = (1.0 - share) * clear + share * overcast
        x, y, luminance = jnp.moveaxis(xyY_from_xyz(mixed), -1, 0)
        return luminance, x, y

    def radiance(
        self,
        turbidity: Float[ArrayLike, ""],
        scene: Scene,
        clear_radiance: Float[Array, "direction wavelength"],
    ) -> Float[Array, "direction wavelength"]:
        """Spectral radiance, given that of the clear sky.

        **Arguments:** `turbidity`; `scene`; `clear_radiance`, W m^-2 sr^-1 nm^-1, from any model.
        **Returns:** W m^-2 sr^-1 nm^-1. **Valid:** 300-830 nm; below the horizon the overcast sky is dark.
        """
        share = self.overcast_share(turbidity)
        overcast = overcast_luminance(scene.sun_zenith, scene.view.zenith)
        overcast = jnp.where(above_horizon(scene.view.zenith), overcast, 0.0)
        grey = overcast[:, None] * daylight(*WHITE, scene.wavelength_nm)[None]
        return (1.0 - share) * clear_radiance + share * grey
