"""Multiple scattering by successive orders with discrete ordinates."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...atmosphere import AbstractPhase, Atmosphere
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


# Wavelength (nm) at which `doubt` judges a phase function, and the least moment beyond the streams that it reports.
_GREEN, _FORWARD = np.array([550.0]), 0.05


class OrdersOfScattering(AbstractSolver):
    r"""All orders of scattering and a Lambertian ground, with exact single scattering.

    The method has Fourier modes in azimuth, Gauss streams in zenith angle and delta-M truncation of the phase function.
    Legendre moments turn the multiple-scattering source into the exact view directions. Single scattering uses the
    whole phase function (Nakajima & Tanaka's TMS), and the aureole is corrected to the second order (their IMS). After
    each sweep diffusion closes what is left over, so that no light is lost however thick the haze and few the sweeps.
    The steps of the sweeps are weighted (`streams.relaxation`).

    `streams` per hemisphere; `modes` in azimuth; `levels` of the vertical grid, dense in haze; `orders`,
    sweeps through it; `nodes` of the single-scattering integral.
    `spectral_nodes`: the number of wavelengths at which multiple scattering is solved over a black ground, where a
    spectrum has more; half as many are solved over a lit one. Coarse streams complete the spectrum
    (`spectrum.interpolated`). 0 solves all wavelengths. None takes as many as keep the light within some 1e-3 from 300
    to 1100 nm where views are so few that this saves time, else all.
    `geometry`: "flat" or "spherical". Spherical paths of beam and view are curved, and diffuse streams change their
    local angle from layer to layer; for them the sun's local zenith angle is everywhere that of the observer.
    `polarised`: include linear polarisation in the radiance and answer `stokes`. It takes 1.2 times the scalar solver's
    time, its Jacobian 1.4 times.

    The observer stands on the ground, or in flat geometry anywhere from it to space. All views, up and down, look into
    the same field. `fluxes` are those on the ground for every observer.

    **Valid:** flat: sun and view zenith to 85 degrees. Haze of optical depth 3 is within 0.4 % of DISORT with 48
    streams for an asymmetry parameter of 0.8, and within 1.3 % for 0.85. Haze of optical depth 1 and asymmetry
    parameter 0.88 is within 2.2 % (`fine` 0.2 %; suns at 40 and 60 degrees). At optical depth 50 the light is 2 % off
    (`normal`), more where little is left. Views may be black where absorbing haze leaves less light than the errors of
    the streams, and under haze that scatters backward (asymmetry parameter below -0.8).
    Spherical: sun and view zenith to 80 degrees are within 1 % beyond the noise of the Monte Carlo, at 85 within 5 %,
    and the sun at 89 within 10 % (median 3 %). Suns beyond 85 degrees (flat) and 90 (spherical) raise a `ValueError`;
    the last five degrees of each give a `LowSunWarning`.
    All this holds for scalar light. Scalar light misses the effect of polarisation: up to 8 % of a clear sky at 383 nm
    and 1.4 % at 710 nm, of either sign, and 19 % in air of optical depth 1 under a low sun.
    `polarised`, flat: I, and Q and U over I, are within 0.5 % (`fine` 0.02 %) of Natraj et al. 2009 for air of optical
    depths to 1 and sun and view cosines from 0.1, and within 0.4 % of sasktran2 with haze. Spherical, at 75 degrees:
    the effect of polarisation on I is within 0.2 % of sasktran2's, and Q and U are within 1.2 % of I. V is neglected
    (`Stokes`).
    Aloft (flat, polarised, `fine`): I, and Q and U over I, are within 0.02 % and three standard errors of MYSTIC at the
    bottom, inside and at the top of five atmospheres (Emde et al. 2015; experiments/validation/iprt.py). `normal` is
    within 0.1 % but for two cases. Where strongly absorbing gas lies above the scatterers it is 3 % off (320 nm, 85
    degrees from straight down, above the ozone). Where hardly any air is left above, it is 9 % off (views up from
    100 km, of radiance 1e-7).
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
        """Flat: the median error is 0.05 %, the largest 2 % at 85 degrees."""
        return cls(streams=6, modes=12, levels=16, orders=5, nodes=16, geometry=geometry, polarised=polarised)

    @classmethod
    def normal(cls, geometry: Geometry = "spherical", polarised: bool = False) -> "OrdersOfScattering":
        """Flat: the median error is 0.01 %, the largest 0.5 % at 85 degrees; spherical: 0.3 %."""
        return cls(geometry=geometry, polarised=polarised)

    @classmethod
    def fine(cls, geometry: Geometry = "spherical", polarised: bool = False) -> "OrdersOfScattering":
        """The reference of this package: flat within 0.1 %."""
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

    @property
    def knows_polarisation(self) -> bool:
        return self.polarised

    def doubt(self, atmosphere: Atmosphere) -> str | None:
        # Error against DISORT with 48 streams: 1.2 % where this moment is 0.07 (asymmetry 0.85, optical depth 3), 2.2 %
        # where it is 0.13 (0.88, 1).
        phases = [phase for _, phase in peaked(atmosphere.constituents)]
        count = 2 * self.streams
        left = [float(_moment(phase, count)) for phase in phases]
        if not left or max(left) < _FORWARD:
            return None
        return (
            f"haze scatters so far forward that {self.streams} streams may be 1 to 2 % off, more than the stated model "
            "error: `OrdersOfScattering.fine`, or `--preset fine`, resolves it"
        )

    def coarser(self) -> "OrdersOfScattering":
        # A draft is cheap enough not to compile another solver.
        if self.streams <= _COARSE.streams:
            return self
        # In haze of optical depth 0.05 to 3 a search by these slopes takes as many steps as by those of `normal`.
        return replace(_COARSE, geometry=self.geometry)

    def radiance(self, atmosphere: Atmosphere, scene: Scene) -> Float[Array, "direction wavelength"]:
        """Radiance by all orders of scattering, W m^-2 sr^-1 nm^-1.

        Downward views from aloft contain the light that the ground reflects; downward views on the ground are black.
        """
        check_scene(self, atmosphere, scene)
        check_observer(self, scene)
        return self._light(atmosphere, scene, spectral_nodes(atmosphere, scene, self.spectral_nodes), False)[0]

    def stokes(self, atmosphere: Atmosphere, scene: Scene) -> Stokes:
        """Radiance and linear polarisation, W m^-2 sr^-1 nm^-1, of a solver with `polarised`.

        Q and U take more modes, so the radiance here may differ by 1e-4 from `radiance`.
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

        The delta-M beam contains the forward peak. The part of it given by the true transmittance counts as direct
        light, the rest as diffuse.
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
            # The slopes in thick layers may undershoot where little light comes through.
            diffuse = jnp.maximum(field.ground_flux + sun * layers.beam[-1] - direct, 0.0)
            top = field.top_flux * scene.solar_irradiance
        up = reflectance * (direct + diffuse)
        irradiance = scene.solar_irradiance
        return Irradiances(direct * irradiance, diffuse * irradiance, up * irradiance, top)

    def _resolution(self) -> Resolution:
        return Resolution(self.streams, self.modes, self.levels, self.orders, self.geometry, polarised=self.polarised)


# Some per cent off, in a seventh of the time of the polarised `normal`.
_COARSE = OrdersOfScattering(streams=6, modes=8, levels=12, orders=3, nodes=16)


@eqx.filter_jit
def _moment(phase: AbstractPhase, degree: int) -> Float[Array, ""]:
    """The largest moment of a degree at green wavelengths."""
    return jnp.max(phase.moments(degree + 1, as_float(_GREEN))[degree])


def streamed_light(
    atmosphere: Atmosphere,
    scene: Scene,
    resolution: Resolution,
    nodes: int,
    few: SpectralNodes | None,
    stokes: bool = False,
) -> Float[Array, "stokes direction wavelength"]:
    """Exact single scattering plus higher orders and ground as the streams solve them, W m^-2 sr^-1 nm^-1.

    **Arguments:** `nodes` of the single-scattering integral; `few`, counts of wavelengths at which the streams solve,
    None for all of the scene's. **Returns:** the radiance alone, or with `stokes` I, Q and U.
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
        # A correction as large as the light that it corrects would be meaningless.
        excess = aureole_excess(constituents, scene, scaled, resolution.geometry)
        excess = jnp.clip(excess, -0.5 * single[0], 0.5 * single[0])
        single = jnp.concatenate([single[:1] - excess[None], single[1:]])
    if few is None:
        ground = atmosphere.ground.reflectance(wavelength)
        multiple = multiple_scattering(constituents, scene, scaled, ground, resolution, stokes).light
    else:
        multiple = interpolated(atmosphere, scene, resolution, few, stokes)
    light = single + multiple
    # The streams' error may exceed the light where almost none is left or haze scatters far backward.
    dark = jnp.asarray(np.array([0.0, -np.inf, -np.inf])[: light.shape[0], None, None], light.dtype)
    return jnp.where(light < dark, dark, light) * scene.solar_irradiance[None, None]
