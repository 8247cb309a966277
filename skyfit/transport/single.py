"""Single scattering: sunlight that is scattered once on its way to an observer on the ground."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..atmosphere import AbstractConstituent, Atmosphere
from ..numerics import gauss_legendre
from ..scene import Directions, haversine, Scene
from .optical_path import (
    above_horizon,
    EARTH_RADIUS,
    exponential_nodes,
    height_gain,
    length_scale,
    MIN_COSINE,
    outward_column,
    slant_column,
    sunlit,
)
from .solver import AbstractSolver, check_geometry, Fluxes, Geometry, optics


class ViewPath(NamedTuple):
    """Points along each view and what lies between them, the eye and the sun."""

    source: Float[Array, "constituent direction node"]
    column: Float[Array, "direction node constituent"]


def view_path(constituents: tuple[AbstractConstituent, ...], scene: Scene, nodes: int, geometry: Geometry) -> ViewPath:
    """Quadrature points along each view: densities with weights, and columns eye - point - sun.

    **Arguments:** `nodes`, points per view. **Returns:** `ViewPath`; `source` is density times weight,
    dimensionless, zero in the Earth's shadow; `column` is normalised to the vertical column.
    """
    zenith, azimuth = scene.view.zenith, scene.view.azimuth
    cosine = jnp.maximum(jnp.cos(zenith), 0.0 if geometry == "spherical" else MIN_COSINE)
    sun_cosine = jnp.cos(scene.sun_zenith)
    to_sun = 1.0 - 2.0 * haversine(zenith, scene.sun_zenith, azimuth - scene.sun_azimuth)
    y, weight = (jnp.asarray(v, cosine.dtype)[None] for v in exponential_nodes(nodes, grading=2))
    reach = jnp.max(jnp.stack([c.profile.reach() for c in constituents if c.phase is not None]))
    if geometry == "flat":
        height = reach * y + jnp.zeros_like(cosine)[:, None]
        step = reach / cosine[:, None] * weight
        view_cosine = cosine[:, None] + jnp.zeros_like(height)
        local_sun = sun_cosine + jnp.zeros_like(height)
    else:
        scale = length_scale(EARTH_RADIUS, cosine, reach)[:, None]
        start = _shadow_length(cosine, sun_cosine, to_sun)[:, None]
        distance = start + scale * y
        step = scale * weight
        height = height_gain(EARTH_RADIUS, cosine[:, None], distance)
        radius = EARTH_RADIUS + height
        view_cosine = (EARTH_RADIUS * cosine[:, None] + distance) / radius
        local_sun = (EARTH_RADIUS * sun_cosine + distance * to_sun[:, None]) / radius
    lit = sunlit(height, local_sun, geometry) & above_horizon(zenith)[:, None]
    source = jnp.stack([jnp.where(lit, step * c.profile.density(height), 0.0) for c in constituents])
    ground = jnp.zeros_like(cosine)
    column = jnp.stack(
        [
            outward_column(c.profile, ground, cosine, geometry)[:, None]
            - outward_column(c.profile, height, view_cosine, geometry)
            + slant_column(c.profile, height, local_sun, geometry)
            for c in constituents
        ],
        axis=-1,
    )
    return ViewPath(source, jnp.maximum(column, 0.0))


def _shadow_length(cosine, sun_cosine, to_sun):
    """How far (m) a view from the ground runs in the Earth's shadow when the sun is below the horizon."""
    below = jnp.minimum(sun_cosine, 0.0)
    across = cosine - below * to_sun
    sine_square = jnp.maximum(1.0 - to_sun**2, 0.0)
    root = jnp.sqrt(jnp.maximum(across**2 + sine_square * below**2, 1e-30))
    # no further than 1e8 m, where no air is left
    return EARTH_RADIUS * below**2 / jnp.maximum(across + root, 0.06 * below**2 + 1e-9)


def single_scattering(
    constituents: tuple[AbstractConstituent, ...],
    scene: Scene,
    extinction: Float[Array, "constituent wavelength"],
    nodes: int,
    geometry: Geometry,
) -> Float[Array, "direction wavelength"]:
    """Radiance of sunlight that is scattered once, per unit solar irradiance, sr^-1.

    **Arguments:** `extinction`, optical depths that attenuate (a delta-M solver passes its scaled ones; what
    scatters is unscaled); `nodes`, points per view. **Returns:** `[direction, wavelength]`.
    """
    path = view_path(constituents, scene, nodes, geometry)
    scattering = optics(constituents, scene.wavelength_nm).scattering
    half = haversine(scene.view.zenith, scene.sun_zenith, scene.view.azimuth - scene.sun_azimuth)
    transmittance = jnp.exp(-(path.column @ extinction))
    integral = jnp.stack([path.source[i] for i in scatterer_indices(constituents)], axis=1) @ transmittance
    total, row = jnp.zeros_like(integral[:, 0]), 0
    for c, depth in zip(constituents, scattering, strict=True):
        if c.phase is not None:
            total = total + c.phase.value(half, scene.wavelength_nm) * depth[None] * integral[:, row]
            row += 1
    return total


def scatterer_indices(constituents: tuple[AbstractConstituent, ...]) -> tuple[int, ...]:
    """Places of the constituents that scatter."""
    return tuple(i for i, c in enumerate(constituents) if c.phase is not None)


def transmitted_sun(
    constituents: tuple[AbstractConstituent, ...],
    scene: Scene,
    extinction: Float[Array, "constituent wavelength"],
    geometry: Geometry,
) -> Float[Array, " wavelength"]:
    """Direct transmittance from space to the ground toward the sun; 0 with the sun below the horizon."""
    cosine = jnp.cos(scene.sun_zenith)
    return jnp.where(cosine > 0.0, jnp.exp(-sun_depth(constituents, scene, extinction, geometry)), 0.0)


def sun_depth(
    constituents: tuple[AbstractConstituent, ...],
    scene: Scene,
    extinction: Float[Array, "constituent wavelength"],
    geometry: Geometry,
) -> Float[Array, " wavelength"]:
    """The optical depth from the ground toward the sun; below the horizon, past the tangent point."""
    cosine = jnp.cos(scene.sun_zenith)
    ground = jnp.zeros_like(cosine)
    depth = jnp.zeros(extinction.shape[1], extinction.dtype)
    for c, vertical in zip(constituents, extinction, strict=True):
        depth = depth + slant_column(c.profile, ground, cosine, geometry) * vertical
    return depth


class SingleScattering(AbstractSolver):
    r"""Single scattering of sunlight, an integral along each view.

    $L = E_0 \sum_c p_c(\gamma)\,\beta_c \int \rho_c(h(s))\, e^{-\tau(s) - \tau_\odot(s)}\, ds$

    `nodes` quadrature points per view; `geometry` "flat" or "spherical" (curved paths for view and sun, the
    Earth's shadow as the start of the path). No light of the ground, no second scattering.
    **Valid:** sun zenith to 95 degrees spherical, below 90 flat (beyond it the sky is black).
    **Source:** Nishita et al. 1993; Bruneton & Neyret 2008, sec. 3; ERRATA of the papers on sun distances.
    """

    nodes: int = eqx.field(static=True, default=24)
    geometry: Geometry = eqx.field(static=True, default="spherical")

    def __check_init__(self):
        check_geometry(self.geometry)

    @classmethod
    def draft(cls, geometry: Geometry = "spherical") -> "SingleScattering":
        """12 nodes."""
        return cls(nodes=12, geometry=geometry)

    @classmethod
    def normal(cls, geometry: Geometry = "spherical") -> "SingleScattering":
        """24 nodes."""
        return cls(nodes=24, geometry=geometry)

    @classmethod
    def fine(cls, geometry: Geometry = "spherical") -> "SingleScattering":
        """64 nodes."""
        return cls(nodes=64, geometry=geometry)

    @eqx.filter_jit
    def radiance(self, atmosphere: Atmosphere, scene: Scene) -> Float[Array, "direction wavelength"]:
        """Sky radiance by single scattering, W m^-2 sr^-1 nm^-1."""
        return _radiance(self, atmosphere, scene)

    @eqx.filter_jit
    def fluxes(self, atmosphere: Atmosphere, scene: Scene) -> Fluxes:
        """Irradiance on the ground: the direct beam, the sky by quadrature, the ground's reflection."""
        view, weight = dome(8, 16)
        sky = eqx.tree_at(lambda s: s.view, scene, view)
        diffuse = jnp.asarray(weight, scene.wavelength_nm.dtype) @ _radiance(self, atmosphere, sky)
        extinction = optics(atmosphere.constituents, scene.wavelength_nm).extinction
        beam = transmitted_sun(atmosphere.constituents, scene, extinction, self.geometry)
        direct = scene.solar_irradiance * jnp.maximum(jnp.cos(scene.sun_zenith), 0.0) * beam
        albedo = atmosphere.ground.reflectance(scene.wavelength_nm)
        return Fluxes(direct, diffuse, albedo * (direct + diffuse))


def _radiance(solver: SingleScattering, atmosphere: Atmosphere, scene: Scene):
    constituents = atmosphere.constituents
    if not scatterer_indices(constituents):
        return jnp.zeros((scene.view.zenith.shape[0], scene.wavelength_nm.shape[0]))
    extinction = optics(constituents, scene.wavelength_nm).extinction
    once = single_scattering(constituents, scene, extinction, solver.nodes, solver.geometry)
    return once * scene.solar_irradiance[None]


def dome(rings: int, azimuths: int) -> tuple[Directions, np.ndarray]:
    """A product rule over the sky; weights are solid angle times cosine."""
    cosine, weight = gauss_legendre(rings)
    azimuth = 2.0 * np.pi * (np.arange(azimuths) + 0.5) / azimuths
    zenith, azimuth = np.meshgrid(np.arccos(cosine), azimuth, indexing="ij")
    weights = np.repeat(2.0 * np.pi / azimuths * weight * cosine, azimuths)
    return Directions(zenith.ravel(), azimuth.ravel()), weights
