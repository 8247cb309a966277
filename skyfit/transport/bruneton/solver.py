"""The solver of Bruneton & Neyret 2008: everything precomputed in tables, once for all observers, views and suns."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ...atmosphere import Atmosphere
from ...numerics import as_float, check_range, IN_MICROMETRES, within
from ...scene import Scene
from ..contract import AbstractSolver, checked, Geometry, GROUND_TO_SPACE, Irradiances, Observers, Path, Suns
from ..optics import scatterer_indices
from .field import air_of, BrunetonField
from .parameterisation import Sizes
from .tables import Air, precompute, Resolution, Tables, transmittance


# Number of wavelengths computed at once. The memory that is needed to make the tables grows with it.
_TOGETHER = 8


class Bruneton(AbstractSolver):
    r"""Multiple scattering on a sphere from four-dimensional tables, after Bruneton & Neyret; meant for comparison.

    Algorithm 4.1 makes T(r, mu), E(r, mu_s) and S(u_r, u_mu, u_mu_s, u_nu) by `orders` of scattering and reflection by
    a Lambertian ground. Single scattering of haze is stored apart, so that its phase function is applied when the table
    is read. Tables are read linearly, like a texture.

    `transmittance`, `irradiance`, `scattering`: nodes of the tables, the paper's by default; `nodes`, quadrature points
    per part of a path; `directions`, numbers of zenith angles in a sphere and of azimuths in half a turn; `lowest_sun`,
    the cosine of the sun's zenith angle where the tables end; `rescaled`, whether the nodes of views are spread over
    the lengths that views can have, not from 0 on (`unit_view`); `one_component`, whether only the longest wavelength
    of the haze is stored, and the others are taken in proportion to those of the air.

    Differences from the paper: the air is 100 km deep on an Earth of 6371 km, as for the other solvers (60 and
    6360); constituents are arbitrary, and each scatterer but the air has its own table; the logarithm of T is stored;
    paths are integrated by graded Gauss nodes, single scattering over their lit parts; spheres are integrated by Gauss
    nodes on either side of the horizon, with phase functions whose sum is normalised to one.
    **Valid:** observers from the ground to space; suns to `suns`, the last five degrees of which give a
    `LowSunWarning`. Against backward Monte Carlo (experiments/validation/space.py) the median error of `normal` is
    1.9 % under suns to 89 degrees, mostly from the orders that it leaves out (0.5 % with eight and `rescaled`), 4 %
    from 89 to 96 and 7 % from 96 on. Level views and views into the Earth's shadow are 20 to 100 % off. The limb in
    twilight, from space, is several times too bright, because S is linear between suns. Polarisation is left out.
    **Source:** Bruneton & Neyret 2008, Precomputed Atmospheric Scattering.
    """

    transmittance: tuple[int, int] = eqx.field(static=True, default=(64, 256))
    irradiance: tuple[int, int] = eqx.field(static=True, default=(16, 64))
    scattering: tuple[int, int, int, int] = eqx.field(static=True, default=(32, 128, 32, 8))
    orders: int = eqx.field(static=True, default=4, metadata=within(1.0, np.inf))
    nodes: int = eqx.field(static=True, default=12, metadata=within(2.0, np.inf))
    directions: tuple[int, int] = eqx.field(static=True, default=(20, 16))
    lowest_sun: float = eqx.field(static=True, default=-0.2, metadata=within(-0.9, -0.01))
    rescaled: bool = eqx.field(static=True, default=False)
    one_component: bool = eqx.field(static=True, default=False)
    geometry: Geometry = eqx.field(static=True, default="spherical")

    def __check_init__(self):
        if self.geometry != "spherical":
            raise ValueError(f'`geometry` must be "spherical" for Bruneton, got {self.geometry!r}')
        sides = {"transmittance": 2, "irradiance": 2, "scattering": 4, "directions": 2}
        for name, count in sides.items():
            value = getattr(self, name)
            if len(value) != count or min(value) < 2:
                raise ValueError(f"`{name}` must be {count} numbers of at least 2, got {value}")
        # half of the views and of the directions lie on either side of the horizon
        for name, halved in {"transmittance": 1, "scattering": 1, "directions": 0}.items():
            value = getattr(self, name)[halved]
            if value % 2 or (value < 4 and name != "directions"):
                raise ValueError(f"`{name}` must have an even number at place {halved}, 4 or more, got {value}")

    @classmethod
    def draft(cls, geometry: Geometry = "spherical") -> "Bruneton":
        """A fifth of the entries of the paper's table of scattering, a quarter of those of the other two."""
        return cls(
            transmittance=(32, 128), irradiance=(8, 32), scattering=(16, 64, 24, 8), nodes=8, directions=(12, 10),
            geometry=geometry,
        )  # fmt: skip

    @classmethod
    def normal(cls, geometry: Geometry = "spherical") -> "Bruneton":
        """The paper's sizes."""
        return cls(geometry=geometry)

    @classmethod
    def fine(cls, geometry: Geometry = "spherical") -> "Bruneton":
        """Twice the paper's suns and angles, views spread over their lengths, six orders, suns to 108 degrees."""
        return cls(
            irradiance=(16, 128), scattering=(32, 128, 64, 16), orders=6, lowest_sun=-0.3091, rescaled=True,
            geometry=geometry,
        )  # fmt: skip

    @property
    def suns(self) -> Suns:
        # Error that 95 % of views from the ground stay under with the lowest suns, against the reference of space.py.
        return Suns(float(np.degrees(np.arccos(self.lowest_sun))), 0.3)

    @property
    def observers(self) -> Observers:
        return GROUND_TO_SPACE

    @property
    def model_error(self) -> float:
        return 0.03

    def coarser(self) -> AbstractSolver:
        return self

    def prepare(self, atmosphere: Atmosphere, wavelength_nm: Float[ArrayLike, "..."]) -> BrunetonField:
        """Make the tables of an atmosphere for all observers, views and suns, per unit irradiance of the sun.

        **Arguments:** `wavelength_nm` `[wavelength]`, any number: at most eight are solved at a time.
        **Returns:** `BrunetonField`.
        """
        wavelength_nm = as_float(wavelength_nm)
        if wavelength_nm.ndim != 1 or not wavelength_nm.shape[0]:
            raise ValueError(f"`wavelength_nm` must be 1-d and not empty, got the shape {wavelength_nm.shape}")
        check_range("wavelength_nm", wavelength_nm, 200.0, 5000.0, "nm", IN_MICROMETRES)
        atmosphere.check_wavelengths(wavelength_nm)
        if self.one_component and air_of(atmosphere, wavelength_nm).smooth is None:
            raise ValueError("`atmosphere` must have air, whose phase function ends at degree 2, for `one_component`")
        # One program makes the tables with and without the shortcut.
        tables = _tables(replace(self, one_component=False), atmosphere, wavelength_nm)
        if self.one_component:
            tables = tables._replace(apart=tables.apart[..., jnp.argmax(wavelength_nm)][..., None])
        return BrunetonField(atmosphere, wavelength_nm, tables, self._sizes())

    @checked
    def radiance(self, atmosphere: Atmosphere, scene: Scene) -> Float[Array, "direction wavelength"]:
        """Radiance from tables made for this scene, W m^-2 sr^-1 nm^-1; `prepare` makes them once for many scenes.

        It is black below the horizon of an observer on the ground, and contains light of the ground for one above it.
        """
        return self.prepare(atmosphere, scene.wavelength_nm).radiance(scene)

    @checked
    def path(self, atmosphere: Atmosphere, scene: Scene, distance: Float[Array, " direction"]) -> Path:
        """Effect of the air between the observer and objects at `distance` (m) along each view."""
        return self.prepare(atmosphere, scene.wavelength_nm).path(scene, distance)

    @checked
    def fluxes(self, atmosphere: Atmosphere, scene: Scene) -> Irradiances:
        """Irradiance on the ground: the direct beam, the table E, the ground's reflection."""
        return self.prepare(atmosphere, scene.wavelength_nm).fluxes(scene)

    def _sizes(self) -> Sizes:
        return Sizes(self.transmittance, self.irradiance, self.scattering, self.lowest_sun, self.rescaled)


@eqx.filter_jit
def _tables(solver: Bruneton, atmosphere: Atmosphere, wavelength_nm) -> Tables:
    air, sizes = air_of(atmosphere, wavelength_nm), solver._sizes()
    resolution = Resolution(sizes, solver.orders, solver.nodes, solver.directions)
    count = wavelength_nm.shape[0]
    if not scatterer_indices(atmosphere.constituents):
        return _without_light(air, sizes)
    parts = -(-count // _TOGETHER)
    size = -(-count // parts)
    places = np.minimum(np.arange(parts * size), count - 1).reshape(parts, size)

    def some(chosen) -> Tables:
        few = Air(
            air.constituents,
            wavelength_nm[chosen],
            air.extinction[:, chosen],
            air.scattering[:, chosen],
            air.reflectance[chosen],
        )
        return precompute(few, resolution)

    if parts == 1:
        tables = some(places[0])
    else:
        stacked = jax.lax.map(some, jnp.asarray(places))
        tables = Tables(*(jnp.moveaxis(t, 0, -2).reshape(*t.shape[1:-1], -1)[..., :count] for t in stacked))
    return tables


def _without_light(air: Air, sizes: Sizes) -> Tables:
    count = air.wavelength_nm.shape[0]
    depth = jnp.zeros((*sizes.transmittance, count))
    if air.constituents:
        depth = transmittance(air, sizes)
    light = jnp.zeros((*sizes.scattering, count))
    return Tables(depth, jnp.zeros((*sizes.irradiance, count)), light, light[None][:0])
