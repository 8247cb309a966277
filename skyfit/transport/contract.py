"""What every transport solver answers, and the optics of an atmosphere as solvers use them."""

from abc import abstractmethod
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..atmosphere import Atmosphere
from ..numerics import Ranged, safe_sqrt
from ..scene import Scene


Geometry = Literal["flat", "spherical"]
# relative model errors by comparison with other solvers: of polarised skies, and of skies without polarisation
POLARISED_ERROR, SCALAR_ERROR = 0.003, 0.007


class Irradiances(NamedTuple):
    """Irradiance on the horizontal ground, W m^-2 nm^-1, `[wavelength]` each.

    `up_at_top`, what leaves the top of the atmosphere, None where the tier does not know it.
    """

    direct: Float[Array, " wavelength"]
    diffuse_down: Float[Array, " wavelength"]
    up: Float[Array, " wavelength"]
    up_at_top: Float[Array, " wavelength"] | None = None


class Stokes(NamedTuple):
    r"""Linearly polarised skylight, W m^-2 sr^-1 nm^-1, `[direction, wavelength]` each.

    `radiance` I; `q` is positive where light swings in the vertical plane through the view, `u` where it swings at 45
    degrees to it, from up toward smaller azimuths: to the left. V is neglected: air makes none, and what haze makes of
    light that air has polarised is at most some thousandths of I (its effect on I about 1e-5).
    """

    radiance: Float[Array, "direction wavelength"]
    q: Float[Array, "direction wavelength"]
    u: Float[Array, "direction wavelength"]

    @property
    def degree(self) -> Float[Array, "direction wavelength"]:
        r"""The degree of linear polarisation, $\sqrt{Q^2 + U^2} / I$, in [0, 1]; 0 in the dark."""
        lit = self.radiance > 0.0
        polarised = safe_sqrt(jnp.asarray(self.q**2 + self.u**2))
        return jnp.where(lit, polarised / jnp.where(lit, self.radiance, 1.0), 0.0)

    @property
    def angle(self) -> Float[Array, "direction wavelength"]:
        """The angle of polarisation from up to the left, in (-pi/2, pi/2], rad; 0 where nothing is polarised."""
        some = self.q**2 + self.u**2 > 0.0
        return 0.5 * jnp.arctan2(jnp.where(some, self.u, 0.0), jnp.where(some, self.q, 1.0))


class Path(NamedTuple):
    """What the air between the eye and objects does to their light, `[direction, wavelength]` each.

    `transmittance`, dimensionless, in [0, 1]; `inscatter`, W m^-2 sr^-1 nm^-1.
    """

    transmittance: Float[Array, "direction wavelength"]
    inscatter: Float[Array, "direction wavelength"]

    def over(self, background: Float[Array, "direction wavelength"]) -> Float[Array, "direction wavelength"]:
        r"""Objects seen through the air, $F_{ex} L_0 + L_{in}$ (Hoffman & Preetham 2002, eq. 1).

        **Arguments:** `background` $L_0$, the objects' own radiance. **Returns:** the unit of `background`.
        """
        return self.transmittance * background + self.inscatter


class AbstractSolver(Ranged):
    """A way to solve the transfer of sunlight to an observer; holds only its resolution and its geometry.

    A tier that can also answers `path(atmosphere, scene, distance)`, a `Path` to objects at `distance`
    `[direction]`, m, along the scene's views.
    """

    geometry: eqx.AbstractVar[Geometry]

    @property
    @abstractmethod
    def model_error(self) -> float:
        """The relative size of each of the smooth errors that a retrieval allows this solver (`error_shapes`)."""

    @abstractmethod
    def coarser(self) -> "AbstractSolver":
        """The solver of the slopes of a retrieval, some per cent off; itself where it is cheap."""

    @abstractmethod
    def radiance(self, atmosphere: Atmosphere, scene: Scene) -> Float[Array, "direction wavelength"]:
        """Diffuse sky radiance, W m^-2 sr^-1 nm^-1; zero for directions below the horizon."""

    @abstractmethod
    def fluxes(self, atmosphere: Atmosphere, scene: Scene) -> Irradiances:
        """Direct, diffuse downward and upward irradiance on the ground."""


def check_on_ground(scene: Scene, solver: str) -> None:
    """A `ValueError` where the scene has an observer above the ground, for a solver that knows none."""
    if scene.height is not None:
        raise ValueError(f"`height` of the scene must be None for {solver}: it knows the observer on the ground only")


def check_geometry(geometry: str) -> None:
    """A `ValueError` unless the geometry is known."""
    if geometry not in ("flat", "spherical"):
        raise ValueError(f'`geometry` must be "flat" or "spherical", got {geometry!r}')
