"""Double scattering: the sky as Preetham, Shirley & Smits simulated it."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..atmosphere import Atmosphere, Ground
from ..numerics import within
from ..scene import Scene
from .contract import (
    AbstractSolver,
    check_geometry,
    check_observer,
    check_scene,
    checked,
    FLAT_SUNS,
    Geometry,
    Irradiances,
    Observers,
    ON_GROUND,
    SCALAR_ERROR,
    SPHERICAL_SUNS,
    Suns,
)
from .optics import optics, scatterer_indices, transmitted_sun
from .orders.layering import Resolution, scaled_optics
from .orders.solver import streamed_light
from .orders.spectrum import spectral_nodes, SpectralNodes
from .orders.streams import diffuse_field
from .views import in_pieces


class DoubleScattering(AbstractSolver):
    r"""Sunlight that is scattered once or twice over a black ground: no third order, no light from the ground.

    $L = L_1 + \int J_2\, e^{-\tau} d\tau$ with
    $J_2(\omega) = \sum_c \omega_c \int p_c(\omega, \omega') L_1(\omega') d\omega'$

    The once-scattered light is exact. Its second scattering is that of Gauss streams and Fourier modes, with the first
    2 x `streams` moments of the phase function and without delta-M, by which a truncated peak would count as no
    scattering. Resolution and `geometry` are as in `OrdersOfScattering`. The radiance ignores the ground's albedo.

    **Valid:** as `OrdersOfScattering`; asymmetry parameters to about 0.8. The light left out is a tenth of a clear blue
    sky, and more of haze over a bright ground. Polarisation is left out, as in a scalar `OrdersOfScattering`.
    **Source:** Nishita et al. 1996, Display method of the sky color taking into account multiple scattering;
    Preetham 1999, sec. 3.2: "second order scattering", reflection by the ground neglected.
    """

    streams: int = eqx.field(static=True, default=8, metadata=within(1.0, np.inf))
    modes: int = eqx.field(static=True, default=12, metadata=within(1.0, np.inf))
    levels: int = eqx.field(static=True, default=30, metadata=within(2.0, np.inf))
    nodes: int = eqx.field(static=True, default=24, metadata=within(1.0, np.inf))
    spectral_nodes: int | None = eqx.field(static=True, default=None, metadata=within(0.0, np.inf))
    geometry: Geometry = eqx.field(static=True, default="spherical")

    def __check_init__(self):
        check_geometry(self.geometry)
        self._resolution(1).check()

    @classmethod
    def draft(cls, geometry: Geometry = "spherical") -> "DoubleScattering":
        """6 streams."""
        return cls(streams=6, modes=12, levels=16, nodes=16, geometry=geometry)

    @classmethod
    def normal(cls, geometry: Geometry = "spherical") -> "DoubleScattering":
        """8 streams."""
        return cls(geometry=geometry)

    @classmethod
    def fine(cls, geometry: Geometry = "spherical") -> "DoubleScattering":
        """16 streams, every wavelength."""
        return cls(streams=16, modes=24, levels=100, nodes=64, spectral_nodes=0, geometry=geometry)

    @property
    def suns(self) -> Suns:
        return SPHERICAL_SUNS if self.geometry == "spherical" else FLAT_SUNS

    @property
    def observers(self) -> Observers:
        return ON_GROUND

    @property
    def model_error(self) -> float:
        return SCALAR_ERROR

    def coarser(self) -> AbstractSolver:
        return self

    def radiance(self, atmosphere: Atmosphere, scene: Scene) -> Float[Array, "direction wavelength"]:
        """Sky radiance by the first two orders of scattering, W m^-2 sr^-1 nm^-1."""
        check_scene(self, atmosphere, scene)
        check_observer(self, scene)
        return self._light(atmosphere, scene, spectral_nodes(atmosphere, scene, self.spectral_nodes))

    @eqx.filter_jit
    def _light(self, atmosphere: Atmosphere, scene: Scene, few: SpectralNodes | None):
        def light(scene):
            return streamed_light(_over_black(atmosphere), scene, self._resolution(1), self.nodes, few)[0]

        return in_pieces(light, scene)

    @checked
    def fluxes(self, atmosphere: Atmosphere, scene: Scene) -> Irradiances:
        """Irradiance on the ground: the direct beam, the light scattered once or twice, the ground's reflection."""
        constituents, irradiance = atmosphere.constituents, scene.solar_irradiance
        extinction = optics(constituents, scene.wavelength_nm).extinction
        beam = transmitted_sun(constituents, scene, extinction, self.geometry)
        direct = irradiance * jnp.maximum(jnp.cos(scene.sun_zenith), 0.0) * beam
        diffuse = jnp.zeros_like(direct)
        if scatterer_indices(constituents):
            black = jnp.zeros_like(scene.wavelength_nm)
            resolution = self._resolution(2)
            scaled = scaled_optics(constituents, scene.wavelength_nm, resolution)
            _, field = diffuse_field(constituents, scene, scaled, black, resolution)
            # The slopes in thick layers may undershoot where little light comes through.
            diffuse = irradiance * jnp.maximum(field.ground_flux, 0.0)
        return Irradiances(direct, diffuse, atmosphere.ground.reflectance(scene.wavelength_nm) * (direct + diffuse))

    def _resolution(self, orders: int) -> Resolution:
        return Resolution(self.streams, self.modes, self.levels, orders, self.geometry, complete=False)


def _over_black(atmosphere: Atmosphere) -> Atmosphere:
    return eqx.tree_at(lambda a: a.ground, atmosphere, Ground(0.0))
