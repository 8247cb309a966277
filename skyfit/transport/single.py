"""Single scattering: sunlight that is scattered once on its way to an observer anywhere from the ground to space."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from ..atmosphere import AbstractConstituent, Atmosphere, Layered
from ..numerics import within
from ..scene import Scene
from .columns import slant_columns
from .contract import (
    AbstractSolver,
    ALL_SUNS,
    check_geometry,
    checked,
    FLAT_SUNS,
    Geometry,
    GROUND_TO_SPACE,
    Irradiances,
    Observers,
    Path,
    SCALAR_ERROR,
    Stokes,
    Suns,
)
from .dome import fluxes_by_quadrature
from .optics import Optics, optics, scatterer_indices, transmitted_sun
from .views import end_points, eye_columns, in_pieces, lit_points, Views, views_of


def single_scattering(
    constituents: tuple[AbstractConstituent, ...],
    scene: Scene,
    depth: Optics,
    nodes: int,
    geometry: Geometry,
    stokes: bool = False,
) -> Float[Array, "stokes direction wavelength"]:
    """Sunlight that is scattered once, per unit solar irradiance, sr^-1.

    **Arguments:** `depth`, optical depths of extinction (a delta-M solver passes its scaled extinction) and of
    scattering (unscaled); `nodes`, points per view; `stokes`: I, Q and U instead of the radiance alone.
    """
    return single_scattering_of(constituents, scene, depth, nodes, geometry, views_of(scene, geometry), stokes)


def single_scattering_of(
    constituents: tuple[AbstractConstituent, ...],
    scene: Scene,
    depth: Optics,
    nodes: int,
    geometry: Geometry,
    views: Views,
    stokes: bool = False,
) -> Float[Array, "stokes direction wavelength"]:
    """`single_scattering` along views of the scene that may end before the air does."""
    integral = lit_integrals(constituents, views, depth.extinction, nodes, geometry)
    total, polarised = jnp.zeros_like(integral[:, 0]), jnp.zeros_like(integral[:, 0])
    for row, i in enumerate(scatterer_indices(constituents)):
        phase = constituents[i].phase
        assert phase is not None
        light = phase.at_haversine(views.half_angle, scene.wavelength_nm) * depth.scattering[i][None] * integral[:, row]
        total = total + light
        if stokes:
            polarised = polarised + phase.matrix(views.half_angle, scene.wavelength_nm)[0] * light
    if not stokes:
        return total[None]
    along, across = _turned_planes(scene)
    return jnp.stack([total, along[:, None] * polarised, across[:, None] * polarised])


def lit_integrals(
    constituents: tuple[AbstractConstituent, ...],
    views: Views,
    extinction: Float[Array, "constituent wavelength"],
    nodes: int,
    geometry: Geometry,
) -> Float[Array, "direction scatterer wavelength"]:
    r"""$\int \rho_c(h(s))\, e^{-\tau(s) - \tau_\odot(s)}\, ds$ over the lit parts of views, one for each scatterer."""
    reach = jnp.max(jnp.stack([c.profile.reach() for c in constituents if c.phase is not None]))
    points, step = lit_points(views, reach, _edges(constituents), nodes, geometry)
    profiles = [c.profile for c in constituents]
    to_sun = slant_columns(profiles, points.height, points.sun_cosine, geometry)
    column = jnp.moveaxis(eye_columns(profiles, views, points, geometry) + to_sun, 0, -1)
    scatterers = [constituents[i] for i in scatterer_indices(constituents)]
    source = jnp.stack([step * c.profile.density(points.height) for c in scatterers], axis=1)
    source, column = jax.lax.optimization_barrier((source, column))
    return _dimmed(source, column, extinction)


def _turned_planes(scene: Scene):
    """Cosine and sine of twice the angle from the vertical plane of each view to the plane of scattering."""
    zenith, turn = scene.view.zenith, scene.view.azimuth - scene.sun_azimuth
    up = jnp.sin(scene.sun_zenith) * jnp.cos(zenith) * jnp.cos(turn) - jnp.cos(scene.sun_zenith) * jnp.sin(zenith)
    aside = -jnp.sin(scene.sun_zenith) * jnp.sin(turn)
    square = up**2 + aside**2
    # Toward the sun there is no plane of scattering and no polarisation.
    safe = jnp.where(square > 0.0, square, 1.0)
    return (up**2 - aside**2) / safe, 2.0 * up * aside / safe


@jax.custom_jvp
def _dimmed(
    source: Float[Array, "direction scatterer node"],
    column: Float[Array, "direction node constituent"],
    extinction: Float[Array, "constituent wavelength"],
) -> Float[Array, "direction scatterer wavelength"]:
    """Sum over each view of the light that its points emit, attenuated by the columns.

    Its tangents are contracted before they meet the wavelengths, so that no tangent of a transmittance is computed.
    """
    return source @ jnp.exp(-(column @ extinction))


def _dimmed_tangent(primals, tangents):
    # Without the barrier the compiler computes the columns again for each tangent.
    source, column, extinction = jax.lax.optimization_barrier(primals)
    source_dot, column_dot, extinction_dot = tangents
    transmittance = jnp.exp(-(column @ extinction))

    def weighted(columns):
        terms = jnp.einsum("dsn,dnc->dscn", source, columns)
        return jnp.einsum("dscn,dnw->dscw", terms, transmittance)

    value = source @ transmittance
    tangent = jnp.zeros_like(value)
    # Zero tangents cost nothing.
    if not isinstance(source_dot, SymbolicZero):
        tangent += source_dot @ transmittance
    if not isinstance(extinction_dot, SymbolicZero):
        tangent -= jnp.einsum("dscw,cw->dsw", weighted(column), extinction_dot)
    if not isinstance(column_dot, SymbolicZero):
        tangent -= jnp.einsum("dscw,cw->dsw", weighted(column_dot), extinction)
    return value, tangent


_dimmed.defjvp(_dimmed_tangent, symbolic_zeros=True)


def _edges(constituents):
    """Heights (m) at which the density of a scatterer jumps, increasing."""
    layered = [c.profile.edges[1:] for c in constituents if c.phase is not None and isinstance(c.profile, Layered)]
    return jnp.sort(jnp.concatenate([jnp.zeros(0), *layered]))


class SingleScattering(AbstractSolver):
    r"""Single scattering of sunlight, an integral along each view.

    $L = E_0 \sum_c p_c(\gamma)\,\beta_c \int \rho_c(h(s))\, e^{-\tau(s) - \tau_\odot(s)}\, ds$

    `nodes`: quadrature points per part of a view. `geometry`: "flat" or "spherical" (straight rays through spherical
    shells for view and sun; parts end at the Earth's shadow). The observer may stand anywhere from the ground to space.
    A view down ends at the ground and contains the light scattered above it. Light reflected by the ground and second
    scattering are left out.
    **Valid:** any sun; flat: above the horizon (below it the sky is black). `normal` is within 1e-5 of the integral at
    optical depths to 0.5, 2e-4 at 1 and 1e-3 at 5, twilight included. Views are cut at the edges of `Layered`
    scatterers, which are within 1e-5 by day and 1e-2 in twilight. In spherical geometry the air above 100 km, 4e-6 of
    all, does not scatter. Polarisation has no effect on the radiance of light that is scattered once.
    **Source:** Nishita et al. 1993; Bruneton & Neyret 2008, sec. 3; ERRATA of the papers on sun distances.

    **Example:**

        >>> scene = skyfit.Scene.from_degrees(60, skyfit.hemisphere(10), [450, 550, 650])
        >>> skyfit.SingleScattering().radiance(skyfit.Atmosphere.from_turbidity(3.0), scene).shape
        (10, 3)
    """

    nodes: int = eqx.field(static=True, default=24, metadata=within(1.0, np.inf))
    geometry: Geometry = eqx.field(static=True, default="spherical")

    def __check_init__(self):
        check_geometry(self.geometry)

    @classmethod
    def draft(cls, geometry: Geometry = "spherical") -> "SingleScattering":
        """12 nodes: within 2e-3 of the integral at optical depths to 0.5."""
        return cls(nodes=12, geometry=geometry)

    @classmethod
    def normal(cls, geometry: Geometry = "spherical") -> "SingleScattering":
        """24 nodes: the quadrature does not limit the accuracy."""
        return cls(nodes=24, geometry=geometry)

    @classmethod
    def fine(cls, geometry: Geometry = "spherical") -> "SingleScattering":
        """64 nodes, for thick haze."""
        return cls(nodes=64, geometry=geometry)

    @property
    def suns(self) -> Suns:
        return ALL_SUNS if self.geometry == "spherical" else FLAT_SUNS

    @property
    def observers(self) -> Observers:
        return GROUND_TO_SPACE

    @property
    def model_error(self) -> float:
        return SCALAR_ERROR

    @property
    def knows_polarisation(self) -> bool:
        return True

    def coarser(self) -> AbstractSolver:
        return self

    @checked
    def radiance(self, atmosphere: Atmosphere, scene: Scene) -> Float[Array, "direction wavelength"]:
        """Radiance by single scattering, W m^-2 sr^-1 nm^-1; black below the horizon of an observer on the ground."""
        return _radiance(self, atmosphere, scene)

    @checked
    def stokes(self, atmosphere: Atmosphere, scene: Scene) -> Stokes:
        """Radiance and linear polarisation by single scattering."""
        return Stokes(*_light(self, atmosphere, scene, stokes=True))

    @checked
    def path(self, atmosphere: Atmosphere, scene: Scene, distance: Float[Array, " direction"]) -> Path:
        """Effect of the air between the observer and objects at `distance` (m) along each view.

        **Arguments:** `distance`, >= 0, infinite for the sky. **Valid:** a view that meets the ground ends there.
        """
        constituents = atmosphere.constituents
        optical = optics(constituents, scene.wavelength_nm)
        views = views_of(scene, self.geometry, distance)
        ends = end_points(views, self.geometry)
        depth = jnp.zeros((distance.shape[0], scene.wavelength_nm.shape[0]), optical.extinction.dtype)
        if constituents:
            columns = eye_columns([c.profile for c in constituents], views, ends, self.geometry)
            depth = columns[..., 0].T @ optical.extinction
        inscatter = jnp.zeros_like(depth)
        if scatterer_indices(constituents):
            (once,) = single_scattering_of(constituents, scene, optical, self.nodes, self.geometry, views)
            inscatter = once * scene.solar_irradiance[None]
        return Path(jnp.exp(-depth), inscatter)

    @checked
    def fluxes(self, atmosphere: Atmosphere, scene: Scene) -> Irradiances:
        """Irradiance on the ground: the direct beam, the sky by quadrature, the ground's reflection."""
        extinction = optics(atmosphere.constituents, scene.wavelength_nm).extinction
        beam = transmitted_sun(atmosphere.constituents, scene, extinction, self.geometry)
        return fluxes_by_quadrature(
            lambda sky: _radiance(self, atmosphere, sky), atmosphere, scene, scene.solar_irradiance * beam
        )


def _radiance(solver: SingleScattering, atmosphere: Atmosphere, scene: Scene):
    return _light(solver, atmosphere, scene, stokes=False)[0]


def _light(solver: SingleScattering, atmosphere: Atmosphere, scene: Scene, stokes: bool):
    """The radiance, or I, Q and U, `[stokes, direction, wavelength]`."""
    constituents = atmosphere.constituents
    if not scatterer_indices(constituents):
        return jnp.zeros((3 if stokes else 1, scene.view.zenith.shape[0], scene.wavelength_nm.shape[0]))
    optical = optics(constituents, scene.wavelength_nm)
    once = in_pieces(
        lambda scene: single_scattering(constituents, scene, optical, solver.nodes, solver.geometry, stokes), scene
    )
    return once * scene.solar_irradiance[None, None]
