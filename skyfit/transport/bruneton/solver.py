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


# wavelengths at once: what the tables need in memory while they are made grows with them
_TOGETHER = 8


class Bruneton(AbstractSolver):
    r"""Multiple scattering on a sphere from four-dimensional tables, as Bruneton & Neyret have it; to be compared.

    Algorithm 4.1: T(r, mu), E(r, mu_s) and S(u_r, u_mu, u_mu_s, u_nu), `orders` of scattering and reflection by a
    Lambertian ground, single scattering of haze apart, so that its phase function is applied when the table is read.
    Read linearly, as a texture is.

    `transmittance`, `irradiance`, `scattering`: nodes of the tables, the paper's by default; `nodes`, quadrature points
    a part of a path; `directions`, zenith angles of a sphere and azimuths of a half turn; `lowest_sun`, the cosine of
    the sun's zenith angle where the tables end; `rescaled`: views are spread over the lengths that there are, not from
    nothing on (`unit_view`); `one_component`: of the haze only the longest wavelength is stored,
    and the others are in proportion to the air's.

    What differs from the paper: the air is 100 km deep on an Earth of 6371 km, as for the other solvers (60 and
    6360); any constituents, each scatterer but the air with a table of its own; the logarithm of T is stored;
    paths are integrated by graded Gauss nodes, single scattering over their lit parts; spheres by Gauss nodes on
    either side of the horizon, with phase functions whose sum is made one.
    **Valid:** observers from the ground to space, suns to `suns`, the last five degrees of which are a `LowSunWarning`.
    Against backward Monte Carlo (experiments/validation/space.py) `normal` is 1.9 % off in the median under suns to 89
    degrees, mostly for the orders that it leaves out (0.5 % with eight and `rescaled`), 4 % from 89 to 96, 7 % from 96
    on; level views and views into the Earth's shadow 20 to 100 %. The limb in twilight, from space, is several times
    too bright: S is linear between suns. Scalar: no polarisation.
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
        """A tenth of the paper's sizes."""
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
        # the largest errors of 95 % of views from the ground under the last suns, by the oracle of space.py
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
        """The tables of an atmosphere for all observers, views and suns, per unit irradiance of the sun.

        **Arguments:** `wavelength_nm` `[wavelength]`, any number: they are solved eight at a time.
        **Returns:** `BrunetonField`.
        """
        wavelength_nm = as_float(wavelength_nm)
        if wavelength_nm.ndim != 1 or not wavelength_nm.shape[0]:
            raise ValueError(f"`wavelength_nm` must be 1-d and not empty, got the shape {wavelength_nm.shape}")
        check_range("wavelength_nm", wavelength_nm, 200.0, 5000.0, "nm", IN_MICROMETRES)
        atmosphere.check_wavelengths(wavelength_nm)
        if self.one_component and air_of(atmosphere, wavelength_nm).smooth is None:
            raise ValueError("`atmosphere` must have air, whose phase function ends at degree 2, for `one_component`")
        # one program makes the tables with and without the shortcut
        tables = _tables(replace(self, one_component=False), atmosphere, wavelength_nm)
        if self.one_component:
            tables = tables._replace(apart=tables.apart[..., jnp.argmax(wavelength_nm)][..., None])
        return BrunetonField(atmosphere, wavelength_nm, tables, self._sizes())

    @checked
    def radiance(self, atmosphere: Atmosphere, scene: Scene) -> Float[Array, "direction wavelength"]:
        """Radiance by all tables made anew, W m^-2 sr^-1 nm^-1: `prepare` serves many scenes.

        Black below the horizon of an observer on the ground; from above it, with the ground's light.
        """
        return self.prepare(atmosphere, scene.wavelength_nm).radiance(scene)

    @checked
    def path(self, atmosphere: Atmosphere, scene: Scene, distance: Float[Array, " direction"]) -> Path:
        """The air between the observer and objects at `distance` (m) along each view."""
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
