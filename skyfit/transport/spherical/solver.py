"""Multiple scattering in a spherical atmosphere, from the ground to space and from noon to deep twilight."""

import math
import warnings
from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ...atmosphere import Atmosphere, Droplets
from ...numerics import as_float, check_range, concrete, within
from ...scene import Scene
from ..columns import EARTH_RADIUS, TOP_OF_AIR
from ..contract import (
    AbstractSolver,
    check_eye,
    check_scene,
    Geometry,
    GROUND_TO_SPACE,
    Irradiances,
    Observers,
    Path,
    SCALAR_ERROR,
    Suns,
    ThickAirWarning,
)
from .field import Lit, SphericalField
from .grid import Resolution, sun_coordinate
from .transfer import solve


_LOWEST_SUN = 108.0
# Distance (degrees) from the observer's sun within which suns affect the light on the ground, by day and by night; the
# zenith angle at which night begins.
_AROUND, _AROUND_AT_NIGHT, _NIGHT = 8.0, 14.0, 100.0
# Number of suns solved around a traced one, whose place is not known; possible numbers for others.
_TRACED = 12
_COUNTS = (6, 8, 10, 12, 16, 20, 28)
# Largest scattering optical depth of thin air. Larger ones, with the numbers of orders that leave less than a
# thousandth of the light over a ground of albedo 1. Number of orders for thicker air.
_THIN, _ORDERS, _MOST_ORDERS = 0.8, ((1.5, 8), (4.0, 12), (8.0, 20), (20.0, 32)), 32
# Fog are scatterers that reach no higher than this (m); values of `near` for it, and their largest share of its reach;
# least numbers of levels, of nodes on rays and of nodes on views.
_FOG, _NEARS, _SHARE_NEAR, _FOG_GRID = 300.0, (100.0, 30.0, 10.0), 0.7, (36, 24, 40)
# Share of light left over above which a warning is given; the share found is larger than the true one.
_MOST_LEFT_OVER = 0.03
# Wavelength at which `doubt` judges an atmosphere.
_DOUBTED_NM = 400.0


class Spherical(AbstractSolver):
    r"""All orders of scattering in a spherical atmosphere over a Lambertian ground, for any observer, view and sun.

    The diffuse light is represented by its moments in spherical harmonics about the sun's axis, at some heights under
    some suns. The whole atmosphere has the same axis: along a straight ray the angle to it is constant, and only the
    azimuth of the place turns. Sunlight scattered once is integrated exactly over the lit parts of each ray. Each
    further order carries the moments of the last one along curved paths. Moments of degree 3 and more, which only haze
    has, are taken from the column over the place. The orders are combined as in GMRES, and what the combination leaves
    over falls off as the last order does. If it is more than 3 % of the light, an atmosphere that is not traced gives a
    `ThickAirWarning`; a traced one does where droplets may be fog. Phase functions are cut by delta-M; single
    scattering uses the whole of them (TMS).

    `levels` of height; `moments` of the phase functions, even; `up`, `flat`, `down`, numbers of zenith angles of the
    rays of a level: to the sky, between its horizon and level views, and to the ground; `orders` for thin air (thick
    air that is not traced has up to 32, `suited`); `sun_step`, degrees between suns in twilight; `path_nodes` and
    `first_nodes` on rays from the levels, for diffuse light and for sunlight; `view_nodes` and `nodes`, the same on
    views; `near`, the height (m) below which levels and nodes crowd. For fog and other scatterers within 300 m of the
    ground, if not traced, `near` is smaller and there are more levels and nodes (`suited`).

    **Valid:** suns to 108 degrees, observers from the ground to space. The light is scalar: the effect of polarisation
    is missing, as in a scalar `OrdersOfScattering`. Rays are straight: with the sun at its true place skies are 2-11 %
    too dark at 88 degrees and 15-46 % at 96, half way to its apparent place 2 and 8 % off
    (experiments/results/refraction.json). Layers that begin and end within a kilometre are resolved only as finely as
    the levels. Fog on the ground, of optical depth 2, is within 3 % of discrete ordinates (tests), within ten degrees
    of the sun 8 %; where the atmosphere is traced it is 20-50 % too dark.
    **Source:** the observer's problem and its tables: Bruneton & Neyret 2008; harmonics about the sun's axis are our
    own; TMS: Nakajima & Tanaka 1988, JQSRT 40, 51.
    """

    levels: int = eqx.field(static=True, default=26, metadata=within(4.0, np.inf))
    moments: int = eqx.field(static=True, default=12, metadata=within(4.0, np.inf))
    up: int = eqx.field(static=True, default=10, metadata=within(2.0, np.inf))
    flat: int = eqx.field(static=True, default=8, metadata=within(2.0, np.inf))
    down: int = eqx.field(static=True, default=6, metadata=within(2.0, np.inf))
    orders: int = eqx.field(static=True, default=5, metadata=within(2.0, np.inf))
    sun_step: float = eqx.field(static=True, default=1.5, metadata=within(0.2, 5.0, "degrees"))
    path_nodes: int = eqx.field(static=True, default=9, metadata=within(2.0, np.inf))
    first_nodes: int = eqx.field(static=True, default=14, metadata=within(2.0, np.inf))
    view_nodes: int = eqx.field(static=True, default=16, metadata=within(2.0, np.inf))
    nodes: int = eqx.field(static=True, default=24, metadata=within(2.0, np.inf))
    near: float = eqx.field(static=True, default=1000.0, metadata=within(1.0, 1e4, "m"))
    geometry: Geometry = eqx.field(static=True, default="spherical")
    after_sunset: ClassVar[bool] = True

    def __check_init__(self):
        if self.geometry != "spherical":
            raise ValueError(f'`geometry` must be "spherical" for Spherical, got {self.geometry!r}')
        if self.moments % 2:
            raise ValueError(f"`moments` must be even, got {self.moments}")

    @classmethod
    def draft(cls, geometry: Geometry = "spherical") -> "Spherical":
        """Coarse, for Jacobians; its errors were not measured."""
        return cls(
            levels=16, moments=6, up=8, flat=4, down=4, orders=4, sun_step=2.0, path_nodes=7, first_nodes=10,
            view_nodes=12, nodes=16, geometry=geometry,
        )  # fmt: skip

    @classmethod
    def normal(cls, geometry: Geometry = "spherical") -> "Spherical":
        """Differs from Monte Carlo by 1.2 % at most under suns to 89 degrees, 1.9 % to 96, 4.3 % to 108.

        The medians are 0.07, 0.1 and 0.4 %. Monte Carlo's own standard errors, 0.1 to 0.7 %, are in all of these.
        """
        return cls(geometry=geometry)

    @classmethod
    def fine(cls, geometry: Geometry = "spherical") -> "Spherical":
        """Finer in every respect: medians of 0.07, 0.08, 0.36 % in these ranges; its times were not measured."""
        return cls(
            levels=32, moments=16, up=14, flat=10, down=8, orders=8, sun_step=1.0, path_nodes=14, first_nodes=20,
            view_nodes=24, nodes=32, geometry=geometry,
        )  # fmt: skip

    @property
    def suns(self) -> Suns:
        return Suns(_LOWEST_SUN)

    @property
    def observers(self) -> Observers:
        return GROUND_TO_SPACE

    @property
    def model_error(self) -> float:
        return SCALAR_ERROR

    def coarser(self) -> AbstractSolver:
        return Spherical.draft()

    def suited(self, atmosphere: Atmosphere, wavelength_nm: Float[Array, " wavelength"]) -> "Spherical":
        """This solver with as many `orders` and as fine a grid as the atmosphere needs, where it is not traced.

        `Droplets` of traced height may be fog: they give a `ThickAirWarning` unless `near` is that of fog.
        """
        near = _near(atmosphere)
        droplets = [c for c in atmosphere.constituents if isinstance(c, Droplets)]
        if self.near > _NEARS[0] and any(concrete(c.profile.reach()) is None for c in droplets):
            warnings.warn(
                f"droplets of traced height: if they are fog, lower than {_FOG:g} m, its light is up to 50 % too dark "
                f"without `near` of {_NEARS[0]:g} m or less, as `suited` gives it outside jit",
                ThickAirWarning,
                stacklevel=2,
            )
        if near < self.near:
            levels, on_rays, on_views = map(max, _FOG_GRID, (self.levels, self.path_nodes, self.view_nodes))
            return replace(self, near=near, levels=levels, path_nodes=on_rays, view_nodes=on_views).suited(
                atmosphere, wavelength_nm
            )
        depth = concrete(_scattering_depth(atmosphere, wavelength_nm))
        if depth is None or depth <= _THIN:
            return self
        need = next((count for most, count in _ORDERS if depth <= most), _MOST_ORDERS)
        return self if need <= self.orders else replace(self, orders=need)

    def doubt(self, atmosphere: Atmosphere) -> str | None:
        shortest = as_float(np.array([_DOUBTED_NM]))
        depth = concrete(_scattering_depth(atmosphere, shortest))
        known = max([_THIN, *(most for most, count in _ORDERS if count <= self.orders)])
        if depth is None or depth <= known:
            return None
        return (
            f"air of a scattering depth of {depth:.2g} at {_DOUBTED_NM:g} nm, for which {self.orders} orders of "
            f"Spherical are few: they do to {known:g}"
        )

    def prepare(
        self,
        atmosphere: Atmosphere,
        wavelength_nm: Float[ArrayLike, " wavelength"],
        *,
        sun_zenith: Float[ArrayLike, "..."] | None = None,
        height: Float[ArrayLike, "..."] | None = None,
    ) -> SphericalField:
        """Solve the atmosphere once, for many observers, views and suns.

        **Arguments:** `wavelength_nm`; `sun_zenith` (rad), suns that will be asked for: the field is valid between the
        least and the largest of them, None: for all to 108 degrees; `height` (m), observers likewise: the field is
        valid up to the highest, None: on the ground if a sun is given, else everywhere. **Returns:** `SphericalField`,
        per unit solar irradiance.
        """
        wavelength_nm = as_float(wavelength_nm)
        atmosphere.check_wavelengths(wavelength_nm)
        check_range("height", height, 0.0, 1e9, "m")
        check_range("sun_zenith", sun_zenith, 0.0, math.radians(_LOWEST_SUN), "rad", "Spherical: suns to 108 degrees")
        first, count, suns_deg, highest = self._window(sun_zenith, height)
        resolution = self.suited(atmosphere, wavelength_nm)._resolution()
        solution, place = _solved(resolution, atmosphere, wavelength_nm, as_float(first), count)
        left_over = concrete(solution.left_over)
        if left_over is not None and left_over.size and left_over.max() > _MOST_LEFT_OVER:
            warnings.warn(
                f"what {resolution.orders} orders of scattering leave over may be {100.0 * left_over.max():.2g} % of "
                "the light: more `orders` leave less",
                ThickAirWarning,
                stacklevel=2,
            )
        answered = as_float(np.array(suns_deg)), as_float(highest)
        return SphericalField(atmosphere, wavelength_nm, solution, place, *answered, resolution)

    def radiance(self, atmosphere: Atmosphere, scene: Scene) -> Float[Array, "direction wavelength"]:
        """Radiance of sky and ground, W m^-2 sr^-1 nm^-1; zero below the horizon of an observer on the ground."""
        check_scene(self, atmosphere, scene)
        return self._for(atmosphere, scene).radiance(scene)

    def fluxes(self, atmosphere: Atmosphere, scene: Scene) -> Irradiances:
        """Irradiance on the ground, and the flux that leaves the air above it."""
        check_scene(self, atmosphere, scene)
        return self._for(atmosphere, scene).fluxes(scene)

    def path(
        self, atmosphere: Atmosphere, scene: Scene, distance: Float[Array, " direction"], lit: Lit | None = None
    ) -> Path:
        """Effect of the air up to objects at `distance` (m) along each view; `lit` as in `SphericalField.path`."""
        check_scene(self, atmosphere, scene)
        check_eye(scene)
        return self._for(atmosphere, scene).path(scene, distance, lit)

    def _for(self, atmosphere: Atmosphere, scene: Scene) -> SphericalField:
        height = 0.0 if scene.height is None else scene.height
        return self.prepare(atmosphere, scene.wavelength_nm, sun_zenith=scene.sun_zenith, height=height)

    def _resolution(self) -> Resolution:
        return Resolution(
            self.levels, self.moments, (self.up, self.flat, self.down), self.orders, self.sun_step,
            self.path_nodes, self.first_nodes, self.view_nodes, self.nodes, self.near,
        )  # fmt: skip

    def _window(self, sun_zenith, height):
        """Place of the first sun and number of suns; zenith angles (degrees) and height (m) that they are valid for."""
        suns, heights = concrete(sun_zenith), concrete(height)
        highest = np.inf if height is None or heights is None else float(heights.max())
        if sun_zenith is not None and height is None:
            highest = 0.0
        # Views from aloft reach air under other suns, as far as the horizon and the end of the air behind it.
        dip = _dip(highest)
        around = dip + min(dip, _dip(TOP_OF_AIR))
        if sun_zenith is None or not np.isfinite(highest):
            low, high = self._place(0.0), self._place(_LOWEST_SUN + _AROUND_AT_NIGHT)
            return low, math.ceil(high - low) + 1, (0.0, _LOWEST_SUN), highest
        if suns is None:
            count = _TRACED + math.ceil(2.0 * around / self.sun_step)
            middle = sun_coordinate(jax.lax.stop_gradient(jnp.mean(as_float(sun_zenith))), self.sun_step)
            first = jnp.maximum(middle - 0.5 * (count - 1), self._place(0.0))
            return first, count, (0.0, _LOWEST_SUN), highest
        least, largest = np.degrees(suns.min()), np.degrees(suns.max())
        around += _AROUND_AT_NIGHT if largest > _NIGHT else _AROUND
        low, high = self._place(max(least - around, 0.0)), self._place(min(largest + around, 180.0))
        # Few different numbers, so that few programs are compiled.
        need = math.ceil(high - low) + 1
        count = next((n for n in _COUNTS if n >= need), need)
        return max(low - 0.5 * (count - need), self._place(0.0)), count, (float(least), float(largest)), highest

    def _place(self, degrees: float) -> float:
        return sun_coordinate(np.radians([degrees]), self.sun_step).item()


def _dip(height: float) -> float:
    """Angle (degrees) at the Earth's centre between an observer and the horizon."""
    return math.degrees(math.acos(EARTH_RADIUS / (EARTH_RADIUS + min(height, 1e9))))


def _near(atmosphere: Atmosphere) -> float:
    """The `near` (m) that the atmosphere needs; infinite without fog. Traced profiles do not count."""
    reaches = [concrete(c.profile.reach()) for c in atmosphere.constituents if c.phase is not None]
    lowest = min((float(reach) for reach in reaches if reach is not None), default=np.inf)
    if lowest > _FOG:
        return np.inf
    return next((near for near in _NEARS if near <= _SHARE_NEAR * lowest), _NEARS[-1])


@eqx.filter_jit
def _scattering_depth(atmosphere: Atmosphere, wavelength_nm) -> Float[Array, ""]:
    """Largest scattering optical depth at any of the wavelengths."""
    parts = [
        c.optical_depth_at(wavelength_nm) * c.single_scattering_albedo_at(wavelength_nm)
        for c in atmosphere.constituents
    ]
    return jnp.max(sum(parts, jnp.zeros_like(wavelength_nm)), initial=0.0)


@eqx.filter_jit
def _solved(resolution: Resolution, atmosphere: Atmosphere, wavelength_nm, first, count: int):
    place = first + jnp.arange(count)
    return solve(atmosphere, wavelength_nm, place, resolution), place
