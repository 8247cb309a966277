"""The interface of every transport solver, its results and its checks."""

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
# Relative model errors of polarised skies and of skies without polarisation, by comparison with other solvers.
POLARISED_ERROR, SCALAR_ERROR = 0.003, 0.007
_LAST_DEG = 5.0
# Angle (rad) below the horizon up to which a view still counts as level.
_LEVEL = 1e-4
_Method = TypeVar("_Method", bound=Callable)


class LowSunWarning(UserWarning):
    """The sun is in the last five degrees of a solver's valid range; the message says how far its sky may be off."""


class ThickAirWarning(UserWarning):
    """The light that a solver leaves out in thick air, or in fog that it does not resolve, may be per cents of it."""


class Suns(NamedTuple):
    """The suns for which a solver is valid, and its error for the lowest of them.

    `largest_deg`, the largest zenith angle, degrees; `error`, the relative error to expect in the last five degrees,
    None where it is the same as elsewhere.
    """

    largest_deg: float
    error: float | None = None


class Observers(NamedTuple):
    """The observers for which a solver is valid: up to `highest_m` above the ground, m; 0: on the ground only.

    Observers above the ground may also look down.
    """

    highest_m: float


ALL_SUNS = Suns(180.0)
ON_GROUND, GROUND_TO_SPACE = Observers(0.0), Observers(np.inf)
# Errors of OrdersOfScattering.normal that 95 % of views to 85 degrees stay under, by backward Monte Carlo on a sphere,
# in air of optical depth 0.05 to 0.5 and haze to 0.3: flat with the sun at 85 degrees (median to 0.12), spherical with
# the sun at 89 (median to 0.03).
FLAT_SUNS, SPHERICAL_SUNS = Suns(85.0, 0.2), Suns(90.0, 0.1)


class Irradiances(NamedTuple):
    """Irradiance on the horizontal ground, W m^-2 nm^-1, `[wavelength]` each.

    `up_at_top` is the flux that leaves the top of the atmosphere, None for solvers that do not compute it.
    """

    direct: Float[Array, " wavelength"]
    diffuse_down: Float[Array, " wavelength"]
    up: Float[Array, " wavelength"]
    up_at_top: Float[Array, " wavelength"] | None = None


class Stokes(NamedTuple):
    r"""Linearly polarised skylight, W m^-2 sr^-1 nm^-1, `[direction, wavelength]` each.

    `radiance` is I. `q` is positive where light swings in the vertical plane through the view. `u` is positive where it
    swings at 45 degrees to that plane, turned from up toward smaller azimuths: to the left. V is neglected. Air makes
    none, and haze turns light that air has polarised into at most some thousandths of I (its effect on I is about
    1e-5).
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
        """The angle of polarisation from up to the left, in (-pi/2, pi/2], rad; 0 where light is unpolarised."""
        some = self.q**2 + self.u**2 > 0.0
        return 0.5 * jnp.arctan2(jnp.where(some, self.u, 0.0), jnp.where(some, self.q, 1.0))


class Path(NamedTuple):
    """Effect of the air between the eye and objects on their light, `[direction, wavelength]` each.

    `transmittance`, dimensionless, in [0, 1]; `inscatter`, W m^-2 sr^-1 nm^-1. For a picture, from `air_to`, both are
    `[row, column, channel]`.
    """

    transmittance: Float[Array, "*direction wavelength"]
    inscatter: Float[Array, "*direction wavelength"]

    def over(self, background: Float[Array, "*direction wavelength"]) -> Float[Array, "*direction wavelength"]:
        r"""Radiance of objects seen through the air, $F_{ex} L_0 + L_{in}$ (Hoffman & Preetham 2002, eq. 1).

        **Arguments:** `background` $L_0$, the objects' own radiance. **Returns:** the unit of `background`.
        """
        return self.transmittance * background + self.inscatter


class AbstractSolver(Ranged):
    """A method that solves the transfer of sunlight to an observer; it holds only its resolution and its geometry.

    Some solvers also have `path(atmosphere, scene, distance)`, a `Path` to objects at `distance` `[direction]`, m,
    along the scene's views.
    """

    geometry: eqx.AbstractVar[Geometry]
    # Whether the solver's skies after sunset are accurate enough to invert measurements.
    after_sunset: ClassVar[bool] = False
    # Whether the density of the air is the same at all heights, so that a path does not depend on the eye's height.
    even_air: ClassVar[bool] = False

    @property
    @abstractmethod
    def suns(self) -> Suns:
        """The suns for which the solver is valid in its geometry; `checked` calls raise or warn by it."""

    @property
    @abstractmethod
    def observers(self) -> Observers:
        """The observers for which the solver is valid in its geometry; `check_observer` refuses others."""

    @property
    @abstractmethod
    def model_error(self) -> float:
        """The relative size of each smooth error that a retrieval assumes for this solver (`error_shapes`)."""

    @property
    def knows_polarisation(self) -> bool:
        """Whether the solver answers `stokes(atmosphere, scene)`, the `Stokes` of the sky."""
        return False

    def doubt(self, atmosphere: Atmosphere) -> str | None:
        """Say, in words, why the solver's error in an atmosphere exceeds the stated one; None where it does not."""
        return None

    def suited(
        self,
        atmosphere: Atmosphere,
        wavelength_nm: Float[Array, " wavelength"],
    ) -> "AbstractSolver":
        """The solver with the resolution that an atmosphere needs, where its values are not traced."""
        return self

    @abstractmethod
    def coarser(self) -> "AbstractSolver":
        """The solver for the slopes by which a retrieval searches: some per cent off, and scalar where that saves time.

        It is this solver itself where that is cheap.
        """

    @abstractmethod
    def radiance(self, atmosphere: Atmosphere, scene: Scene) -> Float[Array, "direction wavelength"]:
        """Diffuse radiance, W m^-2 sr^-1 nm^-1; zero below the horizon of an observer on the ground."""

    @abstractmethod
    def fluxes(self, atmosphere: Atmosphere, scene: Scene) -> Irradiances:
        """Direct, diffuse downward and upward irradiance on the ground."""


def checked(method: _Method) -> _Method:
    """Compile a public method of a solver into one program that is called after checks of its untraced arguments.

    The checks are `check_scene` and, except for paths, `check_observer`.
    """
    program = eqx.filter_jit(method)

    @functools.wraps(method)
    def call(solver, atmosphere, scene, distance=None):
        check_scene(solver, atmosphere, scene)
        # A path may begin at heights whose sky the solver does not know.
        if distance is None:
            check_observer(solver, scene)
        elif not solver.even_air:
            check_eye(scene)
        check_range("distance", distance, 0.0, np.inf, "m")
        return program(solver, atmosphere, scene, *(() if distance is None else (distance,)))

    return call  # pyright: ignore[reportReturnType]


def check_scene(solver: AbstractSolver, atmosphere: Atmosphere, scene: Scene) -> None:
    """Raise a `ValueError` for a sun or wavelengths that solver or atmosphere do not know; warn of a low sun.

    The warning is a `LowSunWarning`. Traced values are not checked.
    """
    atmosphere.check_wavelengths(scene.wavelength_nm)
    lowest = solver.suns.largest_deg
    known = f"{type(solver).__name__}, {solver.geometry}: suns to {lowest:g} degrees"
    check_range("sun_zenith", scene.sun_zenith, 0.0, np.radians(lowest), "rad", known)
    said = low_sun(solver, scene.sun_zenith)
    if said is not None:
        warnings.warn(said, LowSunWarning, stacklevel=4)


def low_sun(solver: AbstractSolver, sun_zenith) -> str | None:
    """Say, in words, how far a solver may be off under the lowest of some suns, rad; None if no more than elsewhere."""
    suns, zenith = solver.suns, concrete(sun_zenith)
    if suns.error is None or zenith is None or not zenith.size:
        return None
    sun = float(np.degrees(zenith.max()))
    # Within the resolution of float32.
    if not suns.largest_deg - _LAST_DEG + 1e-4 < sun <= suns.largest_deg + 1e-4:
        return None
    return (
        f"the sun is {sun:.4g} degrees from the zenith: {type(solver).__name__} in {solver.geometry} geometry may be "
        f"{100.0 * suns.error:.0f} % off from {suns.largest_deg - _LAST_DEG:g} degrees on"
    )


def check_observer(solver: AbstractSolver, scene: Scene) -> None:
    """Raise a `ValueError` for an observer for whom the solver is not valid."""
    name = f"{type(solver).__name__} in {solver.geometry} geometry"
    if solver.observers == ON_GROUND:
        check_on_ground(scene, name)
    check_range("height", scene.height, 0.0, solver.observers.highest_m, "m", f"what {name} knows")


def check_on_ground(scene: Scene, solver: str) -> None:
    """Raise a `ValueError` if the scene gives its observer a height, for a solver valid on the ground only."""
    if scene.height is not None:
        raise ValueError(f"`height` of the scene must be None for {solver}: it knows the observer on the ground only")


def check_eye(scene: Scene) -> None:
    """Raise a `ValueError` for a downward path from the ground, whose length is 0; traced views are not checked."""
    zenith = concrete(scene.view.zenith)
    if scene.height is None and zenith is not None and np.any(zenith > np.pi / 2 + _LEVEL):
        raise ValueError(
            "`height` of the scene must be given for a path below the horizon (an eye is some 2 m up), got None and a "
            f"view zenith of {np.degrees(zenith.max()):.4g} degrees"
        )


def check_geometry(geometry: str) -> None:
    """Raise a `ValueError` unless the geometry is known."""
    if geometry not in ("flat", "spherical"):
        raise ValueError(f'`geometry` must be "flat" or "spherical", got {geometry!r}')
