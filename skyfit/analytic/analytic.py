"""What every analytic sky answers: luminance and chromaticity by Perez' form times their zenith values."""

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
    """A clear sky in closed form, by turbidity and the sun's zenith angle."""

    @abstractmethod
    def perez(self, turbidity: Float[ArrayLike, ""], theta_sun: Float[ArrayLike, ""]) -> tuple[Perez, Perez, Perez]:
        """The distributions of luminance Y and of chromaticity x and y.

        **Arguments:** `turbidity`, dimensionless; `theta_sun`, the sun's zenith angle in radians.
        """

    @abstractmethod
    def zenith(
        self, turbidity: Float[ArrayLike, ""], theta_sun: Float[ArrayLike, ""]
    ) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
        """Luminance (cd m^-2) and chromaticity x, y of the zenith; arguments as `perez`."""

    @abstractmethod
    def check_range(self, turbidity, sun_zenith) -> None:
        """Raises `ValueError` where the model has no answer; for concrete values, outside jit.

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

        $Y = Y_z F_Y(\theta, \gamma) / F_Y(0, \theta_s)$, and so for x and y.

        **Arguments:** `turbidity`; `theta_sun` sun zenith angle; `theta` view zenith angle and
        `gamma` angle from the sun, `[direction]`; radians.
        **Returns:** Y in cd m^-2, x, y, each `[direction]`.
        **Valid:** where `valid` says so: of turbidity and sun nothing is raised here. Angles from 0 to pi, else
        `ValueError` where they are not traced. Directions below the horizon get the horizon's
        value of F at their gamma.
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
        """Tristimulus values of the sky in the scene's directions; of its wavelengths and its sun's light none is used.

        **Arguments:** `turbidity`, dimensionless; `scene`.
        **Returns:** X, Y, Z in cd m^-2 for the CIE 1931 observer, `[direction, 3]`; 0 below the horizon.
        **Valid:** as `radiance`. **Source:** as `luminance_chromaticity`.
        """
        luminance, x, y = self._seen(turbidity, scene)
        return xyz_from_xyY(jnp.stack([x, y, luminance], axis=-1))

    def radiance(self, turbidity: Float[ArrayLike, ""], scene: Scene) -> Float[Array, "direction wavelength"]:
        r"""Spectral radiance of the sky: daylight of its chromaticity, with its luminance.

        $L(\lambda) = Y S_D(\lambda; x, y) / (683 \int S_D \bar y d\lambda)$; see `skyfit.light.daylight`.

        **Arguments:** `turbidity`, dimensionless; `scene`, whose `solar_irradiance` is not used: the luminance is
        absolute, and knows no Earth-Sun distance and no other sun.
        **Returns:** W m^-2 sr^-1 nm^-1, `[direction, wavelength]`; 0 below the horizon.
        **Valid:** 300-830 nm, and where `valid` says so. A turbidity that is no tracer and that `check_range`
        refuses is a `ValueError`, and so for the sun beside it; values traced by jit, vmap or grad raise nothing: ask
        `valid`. Outside the range all is finite, and 0 where the luminance is negative.
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
        r"""The sky as linear sRGB in many directions, fast: for images, see `skyfit.scene.fisheye`.

        **Arguments:** `turbidity`, dimensionless; `sun` and `view`, unit vectors east, north, up, the components first;
        `outside`, what becomes of colours outside the screen's range: "kept", with a negative component; "pale", mixed
        with grey of their luminance until none is negative; "nan", and so everywhere where `valid` is False, which
        flags the skies of a batch.
        **Returns:** red, green, blue in cd m^-2, `[3, direction]`: white of that luminance has three equal values.
        Times an exposure and through `skyfit.light.srgb_from_linear` it is a pixel. 0 below the horizon, z < -1e-6.
        **Valid:** as `radiance`; vectors of length 1, else `ValueError` where they are not traced; float32 within 1e-5
        of the largest component, against `xyz` in float64. Fast outside jit, where it runs as three programs; within
        another one, it is right and slower.
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
        """All that one sky is, in 18 numbers: of Y (cd m^-2), x and y each A, B, C, D, E and the zenith's value over F.

        **Arguments:** `turbidity`; `theta_sun`, the sun's zenith angle, rad. **Valid:** where `valid` says so.
        **Source:** as `luminance_chromaticity`; `skyfit.records.write_evaluator` writes code that evaluates them.
        """
        values, shapes = self.zenith(turbidity, theta_sun), self.perez(turbidity, theta_sun)
        scale = [value / shape.at_zenith(theta_sun) for value, shape in zip(values, shapes, strict=True)]
        return jnp.stack([jnp.append(s.coefficients, v) for s, v in zip(shapes, scale, strict=True)])

    def _seen(self, turbidity, scene: Scene):
        """Luminance, 0 where there is none, and chromaticity in the scene's directions."""
        _check_scalar(turbidity)
        self._check(turbidity, scene.sun_zenith)
        view = scene.view
        gamma = angle_between(view.zenith, scene.sun_zenith, view.azimuth - scene.sun_azimuth)
        luminance, x, y = self.luminance_chromaticity(turbidity, scene.sun_zenith, view.zenith, gamma)
        return jnp.where(above_horizon(view.zenith), jnp.maximum(luminance, 0.0), 0.0), x, y

    def _check(self, turbidity, sun_zenith) -> None:
        """`check_range` of what can be seen of the values while a program is traced."""
        haze, sun = concrete(turbidity), concrete(sun_zenith)
        if haze is not None:
            self.check_range(haze, 0.0 if sun is None else sun)


def _check_scalar(turbidity) -> None:
    if jnp.ndim(turbidity) != 0:
        raise ValueError(f"`turbidity` must be one number (jax.vmap takes many), got shape {jnp.shape(turbidity)}")


def check_sun_is_up(sun_zenith) -> None:
    """A `ValueError` unless all zenith angles of the sun (radians, concrete) are between 0 and pi/2."""
    sun = np.atleast_1d(np.asarray(sun_zenith, dtype=np.float64))
    # float32 pi/2 is above pi/2
    bad = ~((sun >= 0.0) & (sun <= 0.5 * np.pi + 1e-6))
    if bad.any():
        raise ValueError(f"`sun_zenith` must be between 0 and pi/2, sun above the horizon, got {sun[bad][0]:g} rad")


@jax.jit
def _rows(
    sky: AbstractAnalyticSky, turbidity: Float[ArrayLike, ""], sun: Float[Array, "3"]
) -> tuple[Float[Array, ""], Float[Array, "3 6"]]:
    """The zenith angle of the sun's direction, and the frame of that sky."""
    sun_zenith = jnp.arctan2(safe_sqrt(jnp.square(sun[0]) + jnp.square(sun[1])), sun[2])
    return sun_zenith, sky.frame(turbidity, sun_zenith)
