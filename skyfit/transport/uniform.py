"""Air of constant density: single scattering in closed form, after Hoffman & Preetham."""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..atmosphere import AbstractConstituent, Atmosphere
from ..numerics import phi1
from ..scene import above_horizon, haversine, relative_airmass, Scene
from .contract import (
    AbstractSolver,
    check_observer,
    checked,
    Geometry,
    Irradiances,
    Observers,
    ON_GROUND,
    Path,
    SCALAR_ERROR,
    Suns,
)
from .dome import fluxes_by_quadrature
from .optics import optics


# Largest distance (m) of objects; those further off are taken to be here.
_FARTHEST = 1e9
# Error that 95 % of views to 85 degrees stay under with the sun at 88, against `SingleScattering.fine` on a sphere,
# haze to 0.3.
UNIFORM_SUNS = Suns(90.0, 1.0)


class Uniform(AbstractSolver):
    r"""Single scattering in air and haze that have their density at the ground up to where their column ends.

    Within a shell $L_{in}(s, \gamma) = \frac{1}{\beta_{ex}} E_{sun} \beta_{sc}(\gamma) (1 - e^{-\beta_{ex} s})$.
    The shells lie one inside the other: the innermost holds all scatterers, the outermost only the one of the greatest
    optical length. A constituent has the coefficient $\beta = \tau \rho(0)$ and the optical length $1 / \rho(0)$
    straight up, `relative_airmass` times that along other directions. $E_{sun}$ is the irradiance at the ground. A
    constituent that only absorbs filters it and has no shell.

    With a scene at 650, 570 and 475 nm and an irradiance of one's own scale this is the article's RGB model, whose haze
    is `hoffman_haze`. The reference for errors is the integral through real profiles (`SingleScattering`).
    **Valid:** sun above the horizon (the sky is black below it); observer on the ground. Polarisation has no effect on
    the radiance of light that is scattered once.
    **Source:** Hoffman & Preetham 2002, eq. 1-5 and Sky Color; the stored text of the two-shell sum lacks the plus
    between its two terms.
    """

    geometry: Geometry = eqx.field(static=True, default="flat")
    even_air: ClassVar[bool] = True

    def __check_init__(self):
        if self.geometry != "flat":
            raise ValueError(f'`geometry` must be "flat" for Uniform, got {self.geometry!r}')

    @classmethod
    def draft(cls, geometry: Geometry = "flat") -> "Uniform":
        """As `normal`: the sums have a closed form."""
        return cls(geometry)

    @classmethod
    def normal(cls, geometry: Geometry = "flat") -> "Uniform":
        """The closed form, which has no resolution."""
        return cls(geometry)

    @classmethod
    def fine(cls, geometry: Geometry = "flat") -> "Uniform":
        """As `normal`: the sums have a closed form."""
        return cls(geometry)

    @property
    def suns(self) -> Suns:
        return UNIFORM_SUNS

    @property
    def observers(self) -> Observers:
        return ON_GROUND

    @property
    def model_error(self) -> float:
        return SCALAR_ERROR

    def coarser(self) -> AbstractSolver:
        return self

    @checked
    def radiance(self, atmosphere: Atmosphere, scene: Scene) -> Float[Array, "direction wavelength"]:
        """Sky radiance by single scattering in the shells, W m^-2 sr^-1 nm^-1."""
        return _radiance(atmosphere, scene)

    @checked
    def fluxes(self, atmosphere: Atmosphere, scene: Scene) -> Irradiances:
        """Irradiance on the ground: the direct beam, the sky by quadrature, the ground's reflection."""
        sunlight = _sun(atmosphere.constituents, scene)
        return fluxes_by_quadrature(lambda sky: _radiance(atmosphere, sky), atmosphere, scene, sunlight, rings=16)

    @checked
    def path(self, atmosphere: Atmosphere, scene: Scene, distance: Float[Array, " direction"]) -> Path:
        r"""Effect of air of the ground's density between the eye and objects, $e^{-\beta_{ex} s}$ and eq. 4.

        **Arguments:** `distance` to the objects, m, one per view (any view, downward too).
        **Returns:** `Path`. **Valid:** near the ground, since the density does not fall with height; objects beyond
        1e9 m, and at infinity, are taken to be at 1e9 m.
        """
        check_observer(self, scene)
        shells = _shells(atmosphere.constituents, scene)
        if not shells.length.size:
            clear = jnp.zeros((distance.shape[0], scene.wavelength_nm.shape[0]))
            return Path(clear + 1.0, clear)
        # A depth image is infinite where there is only sky.
        distance = jnp.minimum(distance, _FARTHEST)
        slant = distance[:, None] * jnp.sum(shells.extinction, axis=0)[None]
        scattered = jnp.sum(shells.scattered, axis=0) * distance[:, None] * phi1(slant)
        return Path(jnp.exp(-slant), _sun(atmosphere.constituents, scene)[None] * scattered)


class _Shells(NamedTuple):
    """Coefficients at the ground, m^-1, of every scatterer, and its optical length straight up, m."""

    extinction: Float[Array, "constituent wavelength"]
    scattered: Float[Array, "constituent direction wavelength"]
    length: Float[Array, " constituent"]


def _shells(constituents: tuple[AbstractConstituent, ...], scene: Scene) -> _Shells:
    depth = optics(constituents, scene.wavelength_nm)
    half = haversine(scene.view.zenith, scene.sun_zenith, scene.view.azimuth - scene.sun_azimuth)
    extinction, scattered, length = [], [], []
    ground = jnp.zeros_like(scene.sun_zenith)
    for i, c in enumerate(constituents):
        if c.phase is not None:
            # A layer that begins above the ground has no density there; a very long shell keeps its column.
            density = jnp.maximum(c.profile.density(ground), 1e-9)
            extinction.append(depth.extinction[i] * density)
            scattered.append(c.phase.at_haversine(half, scene.wavelength_nm) * (depth.scattering[i] * density)[None])
            length.append(1.0 / density)
    if not length:
        return _Shells(depth.extinction[:0], depth.extinction[:0, None], depth.extinction[:0, 0])
    return _Shells(jnp.stack(extinction), jnp.stack(scattered), jnp.stack(length))


def _sun(constituents: tuple[AbstractConstituent, ...], scene: Scene) -> Float[Array, " wavelength"]:
    """Irradiance of the sun at the ground, normal to its beam, W m^-2 nm^-1."""
    depth = jnp.sum(optics(constituents, scene.wavelength_nm).extinction, axis=0)
    transmitted = jnp.exp(-depth * relative_airmass(scene.sun_zenith))
    return jnp.where(jnp.cos(scene.sun_zenith) > 0.0, scene.solar_irradiance * transmitted, 0.0)


def _radiance(atmosphere: Atmosphere, scene: Scene):
    shells = _shells(atmosphere.constituents, scene)
    if not shells.length.size:
        return jnp.zeros((scene.view.zenith.shape[0], scene.wavelength_nm.shape[0]))
    ends = jnp.sort(shells.length)
    thickness = jnp.diff(ends, prepend=0.0)
    # Which scatterers each shell holds, from the inside out. Compare ranks, not lengths: where two are equal, the
    # gradient is that of one order, and right.
    rank = jnp.argsort(jnp.argsort(shells.length))
    present = (rank[None] >= jnp.arange(ends.size)[:, None]).astype(ends.dtype)
    way = thickness[:, None] * relative_airmass(scene.view.zenith)[None]
    slant = way[:, :, None] * (present @ shells.extinction)[:, None]
    inside = jnp.cumsum(slant, axis=0) - slant
    scattered = jnp.einsum("sc,cdw->sdw", present, shells.scattered)
    light = jnp.sum(scattered * way[:, :, None] * phi1(slant) * jnp.exp(-inside), axis=0)
    seen = jnp.where(above_horizon(scene.view.zenith)[:, None], light, 0.0)
    return seen * _sun(atmosphere.constituents, scene)[None]
