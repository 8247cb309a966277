"""What every analytic sky answers: luminance and chromaticity by Perez' form times their zenith values."""

from abc import abstractmethod

import equinox as eqx
from jaxtyping import Array, ArrayLike, Bool, Float

from .perez import Perez


class AbstractAnalyticSky(eqx.Module):
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
        **Valid:** where `valid` says so; nothing is raised here. Directions below the horizon get the horizon's
        value of F at their gamma.
        **Source:** Preetham 1999 eq. 4, A.2.
        """
        zenith = self.zenith(turbidity, theta_sun)
        shape = self.perez(turbidity, theta_sun)
        luminance, x, y = (
            value * perez.ratio(theta, gamma, theta_sun) for value, perez in zip(zenith, shape, strict=True)
        )
        return luminance, x, y
