"""The base class of analytic skies: luminance and chromaticity as Perez' distribution times the zenith value."""

from abc import abstractmethod

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from ..light import daylight, xyz_from_xyY
from ..numerics import check_radians, check_unit_vectors, concrete, Ranged, safe_sqrt
from ..scene import above_horizon, angle_between, Scene
from . import pixels
from .perez import Perez


OUTSIDE = "kept", "pale", "nan"


class AbstractAnalyticSky(Ranged):
    """A clear sky in closed form, a function of turbidity and the sun's zenith angle."""

    @abstractmethod
    def perez(self, turbidity: Float[ArrayLike, ""], theta_sun: Float[ArrayLike, ""]) -> tuple[Perez, Perez, Perez]:
        """The distributions of luminance Y and of chromaticity x and y.

        **Arguments:** `turbidity`, dimensionless; `theta_sun`, the sun's zenith angle in radians.
        """

    @abstractmethod
    def zenith(
        self, turbidity: Float[ArrayLike, ""], theta_sun: Float[ArrayLike, ""]
    ) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
        """Luminance (cd m^-2) and chromaticity x, y of the zenith; arguments as for `perez`."""

    @abstractmethod
    def check_range(self, turbidity, sun_zenith) -> None:
        """Raise `ValueError` outside the model's range; for concrete values, outside jit.

        **Arguments:** `turbidity`; `sun_zenith` radians; numbers or arrays.
        """

    @abstractmethod
    def valid(self, turbidity: Float[ArrayLike, ""], sun_zenith: Float[ArrayLike, ""]) -> Bool[Array, ""]:
        """Whether the model is within its range; a flag for batches. NaN gives False; arguments as `check_range`."""

    def luminance_chromaticity(
        self,
        turbidity: Float[ArrayLike, ""],
        theta_sun: Float[ArrayLike, ""],
        theta: Float[ArrayLike, "*direction"],
        gamma: Float[ArrayLike, "*direction"],
    ) -> tuple[Float[Array, "*direction"], Float[Array, "*direction"], Float[Array, "*direction"]]:
        r"""Luminance and chromaticity of the sky in the given directions.

        $Y = Y_z F_Y(\theta, \gamma) / F_Y(0, \theta_s)$, and likewise for x and y.

        **Arguments:** `turbidity`; `theta_sun` sun zenith angle; `theta` view zenith angle and
        `gamma` angle from the sun, `[direction]`; radians.
        **Returns:** Y in cd m^-2, x, y, each `[direction]`.
        **Valid:** where `valid` is True; this method does not check turbidity and sun. Concrete angles outside 0 to
        pi are a `ValueError`. Directions below the horizon get the horizon's value of F at their gamma.
        **Source:** Preetham 1999 eq. 4, A.2.
        """
        check_radians("theta_sun", theta_sun, 0.0, np.pi)
        zenith = self.zenith(turbidity, theta_sun)
        shape = self.perez(turbidity, theta_sun)
        luminance, x, y = (
            value * perez.ratio(theta, gamma, theta_sun) for value, perez in zip(zenith, shape, strict=True)
        )
        return luminance, x, y

    def xyz(self, turbidity: Float[ArrayLike, ""], scene: Scene) -> Float[Array, "direction 3"]:
        """Tristimulus values of the sky in the scene's directions.

        **Arguments:** `turbidity`, dimensionless; `scene`, whose wavelengths and solar irradiance are not used.
        **Returns:** X, Y, Z in cd m^-2 for the CIE 1931 observer, `[direction, 3]`; 0 below the horizon.
        **Valid:** as `radiance`. **Source:** as `luminance_chromaticity`.
        """
        luminance, x, y = self._seen(turbidity, scene)
        return xyz_from_xyY(jnp.stack([x, y, luminance], axis=-1))

    def radiance(self, turbidity: Float[ArrayLike, ""], scene: Scene) -> Float[Array, "direction wavelength"]:
        r"""Spectral radiance of the sky: daylight with the model's chromaticity and luminance.

        $L(\lambda) = Y S_D(\lambda; x, y) / (683 \int S_D \bar y d\lambda)$; see `skyfit.light.daylight`.

        **Arguments:** `turbidity`, dimensionless; `scene`, whose `solar_irradiance` is not used: the luminance is
        absolute and does not depend on the Earth-Sun distance or the solar spectrum.
        **Returns:** W m^-2 sr^-1 nm^-1, `[direction, wavelength]`; 0 below the horizon.
        **Valid:** 300-830 nm, and where `valid` is True. A concrete turbidity, with a concrete sun, outside
        `check_range` is a `ValueError`. Values traced by jit, vmap or grad raise nothing; use `valid` for them.
        Outside the range the result is finite, and 0 where the luminance is negative.
        **Source:** Preetham 1999 eq. 4, A.2, A.5.
        """
        luminance, x, y = self._seen(turbidity, scene)
        return luminance[:, None] * daylight(x, y, scene.wavelength_nm)

    def rgb(
        self,
        turbidity: Float[ArrayLike, ""],
        sun: Float[ArrayLike, "3"],
        view: Float[Array, "3 ..."],
        outside: str = "kept",
    ) -> Float[Array, "3 ..."]:
        r"""Linear sRGB of the sky in many directions; fast enough for images (see `skyfit.scene.fisheye`).

        **Arguments:** `turbidity`, dimensionless; `sun` and `view`, unit vectors east, north, up, the components first;
        `outside`, the treatment of colours outside the screen's gamut: "kept" leaves the negative component; "pale"
        mixes them with grey of their luminance until no component is negative; "nan" makes them NaN, and the whole sky
        where `valid` is False, which flags the skies of a batch.
        **Returns:** red, green, blue in cd m^-2, `[3, direction]`: white of that luminance has three equal values.
        Multiply by an exposure and apply `skyfit.light.srgb_from_linear` for pixels. 0 below the horizon, z < -1e-6.
        **Valid:** as `radiance`. Concrete vectors whose length is not 1 are a `ValueError`. float32 agrees with `xyz`
        in float64 within 1e-5 of the largest component. Outside jit it runs as three compiled programs and is fast;
        inside another compiled program it is correct but slower.
        **Source:** Preetham 1999 eq. 4, A.2; IEC 61966-2-1:1999.
        """
        sun = jnp.asarray(sun)
        if sun.shape != (3,) or view.shape[:1] != (3,):
            raise ValueError(
                f"`sun` and `view` must have east, north, up as their first axis, got {sun.shape} and {view.shape}"
            )
        if outside not in OUTSIDE:
            raise ValueError(f"`outside` must be one of {', '.join(OUTSIDE)}, got {outside!r}")
        _check_scalar(turbidity)
        check_unit_vectors("sun", sun)
        check_unit_vectors("view", view)
        sun_zenith, rows = _rows(self, turbidity, sun)
        self._check(turbidity, sun_zenith)
        found = pixels.linear_srgb(*pixels.tristimulus(rows[:, 5], rows[:, :5], *pixels.geometry(sun, view)))
        if outside == "pale":
            return pixels.paled(found)
        if outside == "nan":
            return jnp.where(self.valid(turbidity, sun_zenith) & (jnp.min(found, axis=0) >= 0.0)[None], found, jnp.nan)
        return found

    def frame(self, turbidity: Float[ArrayLike, ""], theta_sun: Float[ArrayLike, ""]) -> Float[Array, "3 6"]:
        """The 18 numbers that determine one sky: for Y (cd m^-2), x and y each A-E and the zenith value over F there.

        **Arguments:** `turbidity`; `theta_sun`, the sun's zenith angle, rad. **Valid:** where `valid` is True.
        **Source:** as `luminance_chromaticity`; `skyfit.records.write_evaluator` writes code that evaluates them.
        """
        values, shapes = self.zenith(turbidity, theta_sun), self.perez(turbidity, theta_sun)
        scale = [value / shape.at_zenith(theta_sun) for value, shape in zip(values, shapes, strict=True)]
        return jnp.stack([jnp.append(s.coefficients, v) for s, v in zip(shapes, scale, strict=True)])

    def _seen(self, turbidity, scene: Scene):
        """Luminance and chromaticity in the scene's directions; luminance is 0 below the horizon or if negative."""
        _check_scalar(turbidity)
        self._check(turbidity, scene.sun_zenith)
        view = scene.view
        gamma = angle_between(view.zenith, scene.sun_zenith, view.azimuth - scene.sun_azimuth)
        luminance, x, y = self.luminance_chromaticity(turbidity, scene.sun_zenith, view.zenith, gamma)
        return jnp.where(above_horizon(view.zenith), jnp.maximum(luminance, 0.0), 0.0), x, y

    def _check(self, turbidity, sun_zenith) -> None:
        """Apply `check_range` to those values that are concrete while a program is traced."""
        haze, sun = concrete(turbidity), concrete(sun_zenith)
        if haze is not None:
            self.check_range(haze, 0.0 if sun is None else sun)


def _check_scalar(turbidity) -> None:
    if jnp.ndim(turbidity) != 0:
        raise ValueError(f"`turbidity` must be one number (jax.vmap takes many), got shape {jnp.shape(turbidity)}")


def check_sun_is_up(sun_zenith) -> None:
    """Raise `ValueError` unless all zenith angles of the sun (radians, concrete) are between 0 and pi/2."""
    sun = np.atleast_1d(np.asarray(sun_zenith, dtype=np.float64))
    # float32 pi/2 is above pi/2
    bad = ~((sun >= 0.0) & (sun <= 0.5 * np.pi + 1e-6))
    if bad.any():
        raise ValueError(f"`sun_zenith` must be between 0 and pi/2, sun above the horizon, got {sun[bad][0]:g} rad")


@jax.jit
def _rows(
    sky: AbstractAnalyticSky, turbidity: Float[ArrayLike, ""], sun: Float[Array, "3"]
) -> tuple[Float[Array, ""], Float[Array, "3 6"]]:
    """The sun's zenith angle, and `frame` of the sky with that sun."""
    sun_zenith = jnp.arctan2(safe_sqrt(jnp.square(sun[0]) + jnp.square(sun[1])), sun[2])
    return sun_zenith, sky.frame(turbidity, sun_zenith)
