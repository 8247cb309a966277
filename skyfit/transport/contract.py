"""What every transport solver answers, and the optics of an atmosphere as solvers use them."""

import functools
import warnings
from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar, Literal, NamedTuple, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..atmosphere import Atmosphere
from ..numerics import check_range, concrete, Ranged, safe_sqrt
from ..scene import Scene


Geometry = Literal["flat", "spherical"]
# relative model errors by comparison with other solvers: of polarised skies, and of skies without polarisation
POLARISED_ERROR, SCALAR_ERROR = 0.003, 0.007
_LAST_DEG = 5.0
# rad, that a view may be below the level and yet be called level
_LEVEL = 1e-4
_Method = TypeVar("_Method", bound=Callable)


class LowSunWarning(UserWarning):
    """The sun stands in the last five degrees of what a solver knows; the message says how far its sky may be off."""


class ThickAirWarning(UserWarning):
    """What a solver leaves out of the orders of scattering may be more than three hundredths of the light."""


class Suns(NamedTuple):
    """The suns whose skies a solver knows, and how well the last of them.

    `largest_deg`, the largest zenith angle, degrees; `error`, the relative error to expect in the last five degrees,
    None where it is no other than elsewhere.
    """

    largest_deg: float
    error: float | None = None


class Observers(NamedTuple):
    """The observers whose skies a solver knows: to `highest_m` above the ground, m; 0 is none but those on it.

    Above the ground views may go down too.
    """

    highest_m: float


ALL_SUNS = Suns(180.0)
ON_GROUND, GROUND_TO_SPACE = Observers(0.0), Observers(np.inf)
# the largest errors of 95 % of views to 85 degrees, by backward Monte Carlo on a sphere, OrdersOfScattering.normal in
# air of optical depth 0.05 to 0.5 and haze to 0.3: flat under a sun at 85 degrees (median to 0.12), spherical under
# one at 89 (median to 0.03)
FLAT_SUNS, SPHERICAL_SUNS = Suns(85.0, 0.2), Suns(90.0, 0.1)


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
        share = polarised / jnp.where(lit, self.radiance, 1.0)
        return jnp.where(lit, jnp.minimum(share, 1.0), 0.0)

    @property
    def angle(self) -> Float[Array, "direction wavelength"]:
        """The angle of polarisation from up to the left, in (-pi/2, pi/2], rad; 0 where nothing is polarised."""
        some = self.q**2 + self.u**2 > 0.0
        return 0.5 * jnp.arctan2(jnp.where(some, self.u, 0.0), jnp.where(some, self.q, 1.0))


class Path(NamedTuple):
    """What the air between the eye and objects does to their light, `[direction, wavelength]` each.

    `transmittance`, dimensionless, in [0, 1]; `inscatter`, W m^-2 sr^-1 nm^-1. Of a picture, by `air_to`, both are
    `[row, column, channel]`.
    """

    transmittance: Float[Array, "*direction wavelength"]
    inscatter: Float[Array, "*direction wavelength"]

    def over(self, background: Float[Array, "*direction wavelength"]) -> Float[Array, "*direction wavelength"]:
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
    # whether skies after sunset are near enough to the sky's own to be inverted
    after_sunset: ClassVar[bool] = False
    # whether the air is as dense at any height, so that a path is the same from anywhere
    even_air: ClassVar[bool] = False

    @property
    @abstractmethod
    def suns(self) -> Suns:
        """The suns that the solver knows in its geometry; `checked` calls refuse and flag by it."""

    @property
    @abstractmethod
    def observers(self) -> Observers:
        """The observers whose radiance the solver knows in its geometry; others are refused by `check_observer`."""

    @property
    @abstractmethod
    def model_error(self) -> float:
        """The relative size of each of the smooth errors that a retrieval allows this solver (`error_shapes`)."""

    def doubt(self, atmosphere: Atmosphere) -> str | None:
        """What of an atmosphere the solver is further off for than it states, in words; None if nothing is."""
        return None

    def suited(
        self,
        atmosphere: Atmosphere,
        wavelength_nm: Float[Array, " wavelength"],
    ) -> "AbstractSolver":
        """The solver with as much of what costs time as the atmosphere asks for, where that is not traced."""
        return self

    @abstractmethod
    def coarser(self) -> "AbstractSolver":
        """The solver of the slopes of a retrieval, some per cent off; itself where it is cheap."""

    @abstractmethod
    def radiance(self, atmosphere: Atmosphere, scene: Scene) -> Float[Array, "direction wavelength"]:
        """Diffuse radiance, W m^-2 sr^-1 nm^-1; zero below the horizon of an observer on the ground."""

    @abstractmethod
    def fluxes(self, atmosphere: Atmosphere, scene: Scene) -> Irradiances:
        """Direct, diffuse downward and upward irradiance on the ground."""


def checked(method: _Method) -> _Method:
    """A public call of a solver as one program, which refuses and flags first what can be seen.

    `check_scene`, and of all but paths `check_observer`.
    """
    program = eqx.filter_jit(method)

    @functools.wraps(method)
    def call(solver, atmosphere, scene, distance=None):
        check_scene(solver, atmosphere, scene)
        # a path may begin elsewhere
        if distance is None:
            check_observer(solver, scene)
        elif not solver.even_air:
            check_eye(scene)
        check_range("distance", distance, 0.0, np.inf, "m")
        return program(solver, atmosphere, scene, *(() if distance is None else (distance,)))

    return call  # pyright: ignore[reportReturnType]


def check_scene(solver: AbstractSolver, atmosphere: Atmosphere, scene: Scene) -> None:
    """A `ValueError` for a sun or wavelengths beyond what solver and atmosphere know, a `LowSunWarning` for a low sun.

    What is traced passes unseen.
    """
    atmosphere.check_wavelengths(scene.wavelength_nm)
    lowest = solver.suns.largest_deg
    known = f"{type(solver).__name__}, {solver.geometry}: suns to {lowest:g} degrees"
    check_range("sun_zenith", scene.sun_zenith, 0.0, np.radians(lowest), "rad", known)
    said = low_sun(solver, scene.sun_zenith)
    if said is not None:
        warnings.warn(said, LowSunWarning, stacklevel=4)


def low_sun(solver: AbstractSolver, sun_zenith) -> str | None:
    """What to expect of a solver under the lowest of some suns, radians, in words; None where it is as good as ever."""
    suns, zenith = solver.suns, concrete(sun_zenith)
    if suns.error is None or zenith is None or not zenith.size:
        return None
    sun = float(np.degrees(zenith.max()))
    # to what float32 tells apart
    if not suns.largest_deg - _LAST_DEG + 1e-4 < sun <= suns.largest_deg + 1e-4:
        return None
    return (
        f"the sun is {sun:.4g} degrees from the zenith: {type(solver).__name__} in {solver.geometry} geometry may be "
        f"{100.0 * suns.error:.0f} % off from {suns.largest_deg - _LAST_DEG:g} degrees on"
    )


def check_observer(solver: AbstractSolver, scene: Scene) -> None:
    """A `ValueError` for an observer that the solver does not know."""
    name = f"{type(solver).__name__} in {solver.geometry} geometry"
    if solver.observers == ON_GROUND:
        check_on_ground(scene, name)
    check_range("height", scene.height, 0.0, solver.observers.highest_m, "m", f"what {name} knows")


def check_on_ground(scene: Scene, solver: str) -> None:
    """A `ValueError` where the scene has an observer above the ground, for a solver that knows none."""
    if scene.height is not None:
        raise ValueError(f"`height` of the scene must be None for {solver}: it knows the observer on the ground only")


def check_eye(scene: Scene) -> None:
    """A `ValueError` for a path down to the ground from no height, whose length is 0; traced views pass unseen."""
    zenith = concrete(scene.view.zenith)
    if scene.height is None and zenith is not None and np.any(zenith > np.pi / 2 + _LEVEL):
        raise ValueError(
            "`height` of the scene must be given for a path below the horizon (an eye is some 2 m up), got None and a "
            f"view zenith of {np.degrees(zenith.max()):.4g} degrees"
        )


def check_geometry(geometry: str) -> None:
    """A `ValueError` unless the geometry is known."""
    if geometry not in ("flat", "spherical"):
        raise ValueError(f'`geometry` must be "flat" or "spherical", got {geometry!r}')
