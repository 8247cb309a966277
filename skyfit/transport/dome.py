"""Irradiance on the ground by quadrature over the sky."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..atmosphere import Atmosphere
from ..numerics import gauss_legendre
from ..scene import Directions, Scene
from .contract import Irradiances


def fluxes_by_quadrature(
    radiance: Callable[[Scene], Array],
    atmosphere: Atmosphere,
    scene: Scene,
    sunlight: Float[Array, " wavelength"],
    rings: int = 8,
) -> Irradiances:
    """Irradiance on the ground, integrated over the radiance of the sky.

    **Arguments:** `radiance`, a function of a scene, W m^-2 sr^-1 nm^-1; `sunlight` at the ground normal to its beam,
    W m^-2 nm^-1; `rings` of the quadrature. **Returns:** `Irradiances` of an observer on the ground.
    """
    view, weight = dome(rings, 16)
    sky = Scene(scene.sun_zenith, scene.sun_azimuth, view, scene.wavelength_nm, scene.solar_irradiance)
    diffuse = jnp.asarray(weight, scene.wavelength_nm.dtype) @ radiance(sky)
    direct = sunlight * jnp.maximum(jnp.cos(scene.sun_zenith), 0.0)
    return Irradiances(direct, diffuse, atmosphere.ground.reflectance(scene.wavelength_nm) * (direct + diffuse))


def dome(rings: int, azimuths: int) -> tuple[Directions, np.ndarray]:
    """Product rule of quadrature over the sky; its weights are solid angle times cosine."""
    cosine, weight = gauss_legendre(rings)
    azimuth = 2.0 * np.pi * (np.arange(azimuths) + 0.5) / azimuths
    zenith, azimuth = np.meshgrid(np.arccos(cosine), azimuth, indexing="ij")
    weights = np.repeat(2.0 * np.pi / azimuths * weight * cosine, azimuths)
    return Directions(zenith.ravel(), azimuth.ravel()), weights
