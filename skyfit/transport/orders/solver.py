"""Multiple scattering by successive orders with discrete ordinates."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...atmosphere import Atmosphere
from ...numerics import as_float, within
from ...scene import Scene
from ..contract import (
    AbstractSolver,
    check_geometry,
    check_observer,
    check_scene,
    checked,
    FLAT_SUNS,
    Geometry,
    GROUND_TO_SPACE,
    Irradiances,
    Observers,
    ON_GROUND,
    POLARISED_ERROR,
    SCALAR_ERROR,
    SPHERICAL_SUNS,
    Stokes,
    Suns,
)
from ..optics import optics, scatterer_indices, transmitted_sun
from ..single import single_scattering
from ..views import in_pieces
from .aureole import aureole_excess
from .layering import peaked, Resolution, scaled_optics
from .reconstruct import bare_ground, multiple_scattering
from .spectrum import interpolated, spectral_nodes, SpectralNodes
from .streams import diffuse_field


# nm, where a phase function is judged, and the moment beyond the streams from which on they miss some of it
_GREEN, _FORWARD = np.array([550.0]), 0.05


class OrdersOfScattering(AbstractSolver):
    r"""All orders of scattering and a Lambertian ground, with exact single scattering.

    Fourier modes in azimuth, Gauss streams in zenith angle, delta-M truncation of the phase function; the
    multiple-scattering source is turned into the exact view directions by its Legendre moments, single scattering uses
    the whole phase function (Nakajima & Tanaka's TMS), and the aureole is corrected to the second order (their IMS).
    What the sweeps leave over is closed by diffusion after each of them, so that no light is lost however thick the
    haze and few the sweeps; their steps are weighted (`streams.relaxation`).

    `streams` per hemisphere; `modes` in azimuth; `levels` of the vertical grid, dense in haze; `orders`,
    sweeps through it; `nodes` of the single-scattering integral; `spectral_nodes`, wavelengths at which
    multiple scattering is solved over a black ground, and half as many over a lit one, where a spectrum has more;
    coarse streams complete it (`spectrum.interpolated`). None: as many as keep it within some 1e-3 from 300 to 1100 nm,
    where views are so few that this saves time, else all; 0: all;
    `geometry` "spherical": curved paths for beam and view, and diffuse streams that change their local angle
    from layer to layer, under a sun whose local zenith angle is the observer's for them; or "flat". `polarised`: with
    linear polarisation, in the radiance and for `stokes`: 1.2 times the scalar solver's time, its Jacobian 1.4 times.

    The observer stands on the ground, or in flat geometry anywhere from it to space: the same field is looked at from
    within, up and down. `fluxes` are those on the ground for all of them.

    **Valid:** flat: sun and view zenith to 85 degrees. Haze of optical depth 3 and asymmetry parameter 0.8 is within
    0.4 % of DISORT with 48 streams, 0.85 within 1.3 %, haze of optical depth 1 and 0.88 within 2.2 % (`fine` 0.2 %;
    suns at 40 and 60 degrees). Optical depth 50 is 2 % off (`normal`), more where little light is left; where haze
    that absorbs leaves less than the errors of the streams, and under haze that scatters backward (asymmetry below
    -0.8), views may be black.
    Spherical: sun and view zenith to 80 within 1 % beyond the noise of the Monte Carlo, at 85 within 5 %, the sun at 89
    within 10 %, in the median 3. Suns beyond 85 degrees (flat) and 90 (spherical) are a `ValueError`, the last five
    degrees of each a `LowSunWarning`.
    All this is of scalar light. What polarisation does is missing from it: up to 8 % of a clear sky at 383 nm and 1.4 %
    at 710 nm, of either sign, 19 % in air of optical depth 1 under a low sun. `polarised`, flat: I, and Q and U over I,
    within 0.5 % (`fine` 0.02 %) of Natraj et al. 2009 for air of optical depths to 1, sun and view cosines from 0.1,
    and within 0.4 % of sasktran2 with haze. Spherical: what polarisation does to I within 0.2 % of sasktran2's, Q and U
    within 1.2 % of I, at 75 degrees. V is neglected (`Stokes`).
    Aloft (flat, polarised, `fine`): I, and Q and U over I, within 0.02 % and three standard errors of MYSTIC at the
    bottom, inside and at the top of five atmospheres (Emde et al. 2015; experiments/validation/iprt.py). `normal` is
    within 0.1 %, but where gas that absorbs much lies above what scatters: 3 % at 320 nm and 85 degrees from straight
    down above the ozone; and where hardly any air is left above, views up from 100 km are 9 % of their 1e-7 off.
    **Source:** Nakajima & Tanaka 1988, JQSRT 40, 51; Wiscombe 1977, J. Atmos. Sci. 34, 1408;
    Lenoble et al. 2007, JQSRT 107, 479 (successive orders).
    """

    streams: int = eqx.field(static=True, default=8, metadata=within(1.0, np.inf))
    modes: int = eqx.field(static=True, default=16, metadata=within(1.0, np.inf))
    levels: int = eqx.field(static=True, default=24, metadata=within(2.0, np.inf))
    orders: int = eqx.field(static=True, default=7, metadata=within(1.0, np.inf))
    nodes: int = eqx.field(static=True, default=24, metadata=within(1.0, np.inf))
    spectral_nodes: int | None = eqx.field(static=True, default=None, metadata=within(0.0, np.inf))
    geometry: Geometry = eqx.field(static=True, default="spherical")
    polarised: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        check_geometry(self.geometry)
        self._resolution().check()

    @classmethod
    def draft(cls, geometry: Geometry = "spherical", polarised: bool = False) -> "OrdersOfScattering":
        """Flat: 0.05 % in the median, to 2 % at 85 degrees."""
        return cls(streams=6, modes=12, levels=16, orders=5, nodes=16, geometry=geometry, polarised=polarised)

    @classmethod
    def normal(cls, geometry: Geometry = "spherical", polarised: bool = False) -> "OrdersOfScattering":
        """Flat: 0.01 % in the median, to 0.5 % at 85 degrees; spherical 0.3 %."""
        return cls(geometry=geometry, polarised=polarised)

    @classmethod
    def fine(cls, geometry: Geometry = "spherical", polarised: bool = False) -> "OrdersOfScattering":
        """The reference of the house: flat within 0.1 %."""
        return cls(
            streams=16,
            modes=32,
            levels=100,
            orders=12,
            nodes=64,
            spectral_nodes=0,
            geometry=geometry,
            polarised=polarised,
        )

    @property
    def suns(self) -> Suns:
        return SPHERICAL_SUNS if self.geometry == "spherical" else FLAT_SUNS

    @property
    def observers(self) -> Observers:
        return ON_GROUND if self.geometry == "spherical" else GROUND_TO_SPACE

    @property
    def model_error(self) -> float:
        return POLARISED_ERROR if self.polarised else SCALAR_ERROR

    def doubt(self, atmosphere: Atmosphere) -> str | None:
        # against DISORT with 48 streams: 1.2 % at 0.07 (asymmetry 0.85, optical depth 3), 2.2 % at 0.13 (0.88, 1)
        phases = [phase for _, phase in peaked(atmosphere.constituents)]
        count = 2 * self.streams
        left = [float(np.max(np.asarray(phase.moments(count + 1, as_float(_GREEN))[count]))) for phase in phases]
        if not left or max(left) < _FORWARD:
            return None
        return (
            f"haze scatters so far forward that {self.streams} streams may be 1 to 2 % off, more than the stated model "
            "error: `OrdersOfScattering.fine`, or `--preset fine`, resolves it"
        )

    def coarser(self) -> "OrdersOfScattering":
        return OrdersOfScattering.draft(self.geometry, self.polarised)

    def radiance(self, atmosphere: Atmosphere, scene: Scene) -> Float[Array, "direction wavelength"]:
        """Radiance by all orders of scattering, W m^-2 sr^-1 nm^-1.

        Aloft views down end on the ground, whose reflected light is in them; on the ground they are black.
        """
        check_scene(self, atmosphere, scene)
        check_observer(self, scene)
        return self._light(atmosphere, scene, spectral_nodes(atmosphere, scene, self.spectral_nodes), False)[0]

    def stokes(self, atmosphere: Atmosphere, scene: Scene) -> Stokes:
        """Radiance and linear polarisation, W m^-2 sr^-1 nm^-1, of a solver with `polarised`.

        Q and U take more modes than `radiance` does, whose last digits (1e-4) may differ from those here.
        """
        check_scene(self, atmosphere, scene)
        check_observer(self, scene)
        if not self.polarised:
            raise ValueError(
                "`polarised` must be True for `stokes`, got False: OrdersOfScattering.normal(polarised=True)"
            )
        return Stokes(*self._light(atmosphere, scene, spectral_nodes(atmosphere, scene, self.spectral_nodes), True))

    @eqx.filter_jit
    def _light(self, atmosphere: Atmosphere, scene: Scene, few: SpectralNodes | None, stokes: bool):
        def light(scene):
            return streamed_light(atmosphere, scene, self._resolution(), self.nodes, few, stokes)

        return in_pieces(light, scene)

    @checked
    def fluxes(self, atmosphere: Atmosphere, scene: Scene) -> Irradiances:
        """Irradiance on the ground, wherever the observer stands: the direct beam, the sky, the ground's reflection.

        The delta-M beam contains the forward peak; it is counted as direct light only as far as the true
        transmittance goes, the rest as diffuse.
        """
        constituents = atmosphere.constituents
        extinction = optics(constituents, scene.wavelength_nm).extinction
        sun = jnp.maximum(jnp.cos(scene.sun_zenith), 0.0)
        direct = sun * transmitted_sun(constituents, scene, extinction, self.geometry)
        reflectance = atmosphere.ground.reflectance(scene.wavelength_nm)
        diffuse, top = jnp.zeros_like(direct), None
        if scatterer_indices(constituents):
            resolution = self._resolution()
            scaled = scaled_optics(constituents, scene.wavelength_nm, resolution)
            layers, field = diffuse_field(constituents, scene, scaled, reflectance, resolution)
            # where little comes through thick layers, their slopes may undershoot
            diffuse = jnp.maximum(field.ground_flux + sun * layers.beam[-1] - direct, 0.0)
            top = field.top_flux * scene.solar_irradiance
        up = reflectance * (direct + diffuse)
        irradiance = scene.solar_irradiance
        return Irradiances(direct * irradiance, diffuse * irradiance, up * irradiance, top)

    def _resolution(self) -> Resolution:
        return Resolution(self.streams, self.modes, self.levels, self.orders, self.geometry, polarised=self.polarised)


def streamed_light(
    atmosphere: Atmosphere,
    scene: Scene,
    resolution: Resolution,
    nodes: int,
    few: SpectralNodes | None,
    stokes: bool = False,
) -> Float[Array, "stokes direction wavelength"]:
    """Exact single scattering and what streams make of the higher orders and the ground, W m^-2 sr^-1 nm^-1.

    **Arguments:** `nodes` of the single-scattering integral; `few`, wavelengths at which the streams solve, None for
    all of the scene's. **Returns:** the radiance alone, or with `stokes` I, Q and U.
    """
    constituents = atmosphere.constituents
    wavelength = scene.wavelength_nm
    if not scatterer_indices(constituents):
        dark = jnp.zeros((3 if stokes else 1, scene.view.zenith.shape[0], wavelength.shape[0]))
        if scene.height is None:
            return dark
        return dark.at[0].set(bare_ground(atmosphere, scene) * scene.solar_irradiance[None])
    scaled = scaled_optics(constituents, wavelength, resolution)
    dimmed = scaled.unscaled._replace(extinction=scaled.extinction)
    single = single_scattering(constituents, scene, dimmed, nodes, resolution.geometry, stokes)
    if resolution.complete and peaked(constituents):
        # a correction of the size of what it corrects is none
        excess = aureole_excess(constituents, scene, scaled, resolution.geometry)
        excess = jnp.clip(excess, -0.5 * single[0], 0.5 * single[0])
        single = jnp.concatenate([single[:1] - excess[None], single[1:]])
    if few is None:
        ground = atmosphere.ground.reflectance(wavelength)
        multiple = multiple_scattering(constituents, scene, scaled, ground, resolution, stokes).light
    else:
        multiple = interpolated(atmosphere, scene, resolution, few, stokes)
    light = single + multiple
    # no radiance is negative: where next to none is left, or haze scatters far backward, streams may be off by more
    dark = jnp.asarray(np.array([0.0, -np.inf, -np.inf])[: light.shape[0], None, None], light.dtype)
    return jnp.where(light < dark, dark, light) * scene.solar_irradiance[None, None]
