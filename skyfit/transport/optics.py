"""Vertical optical depths of the constituents, and the sun's beam through them."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..atmosphere import AbstractConstituent
from ..scene import Scene
from .columns import slant_columns
from .contract import Geometry


class Optics(NamedTuple):
    """Vertical optical depths of each constituent at some wavelengths."""

    extinction: Float[Array, "constituent wavelength"]
    scattering: Float[Array, "constituent wavelength"]


def optics(constituents: tuple[AbstractConstituent, ...], wavelength_nm: Float[Array, " wavelength"]) -> Optics:
    """Extinction and scattering optical depth, one row per constituent; that of scattering is 0 for pure absorbers."""
    if not constituents:
        empty = jnp.zeros((0, *wavelength_nm.shape), wavelength_nm.dtype)
        return Optics(empty, empty)
    extinction = jnp.stack([c.optical_depth_at(wavelength_nm) for c in constituents])
    albedo = jnp.stack(
        [
            jnp.zeros_like(wavelength_nm) if c.phase is None else c.single_scattering_albedo_at(wavelength_nm)
            for c in constituents
        ]
    )
    return Optics(extinction, extinction * albedo)


def scatterer_indices(constituents: tuple[AbstractConstituent, ...]) -> tuple[int, ...]:
    """Indices of the constituents that scatter."""
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
    """Optical depth from the ground toward the sun; for a sun below the horizon, past the tangent point."""
    cosine = jnp.cos(scene.sun_zenith)
    ground = jnp.zeros_like(cosine)
    if not constituents:
        return jnp.zeros(extinction.shape[1], extinction.dtype)
    return slant_columns([c.profile for c in constituents], ground, cosine, geometry) @ extinction
