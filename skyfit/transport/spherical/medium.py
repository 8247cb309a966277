"""Optics of a spherical atmosphere, and weights of the light along each ray."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...atmosphere import Atmosphere
from ...numerics import as_float
from ..optics import optics, scatterer_indices
from ..orders.layering import peaked, Resolution as Streams, scaled_optics
from ..views import eye_columns, Points, Views
from .grid import Rays


# Least opacity and least extinction (m^-1); their squares are still a float32.
_LEAST, _NO_AIR = 1e-18, 1e-15
# Largest factor by which the weights on a ray are corrected. What is still missing lies near the eye, on rays of an
# opacity above the second number.
_MOST, _THICK = 1.5, 0.1


class Medium(NamedTuple):
    """Delta-M optics of the constituents at some wavelengths; `moments` contain the factor 2 l + 1."""

    extinction: Float[Array, "constituent wavelength"]
    scattering: Float[Array, "scatterer wavelength"]
    moments: Float[Array, "moment scatterer wavelength"]
    albedo: Float[Array, " wavelength"]
    # Indices, among the scatterers, of those without a last moment.
    peaks: tuple[int, ...]


class RayWeights(NamedTuple):
    """Weight of each node of a ray per unit source, and transmittance from its end.

    `node` `[level, node, wavelength]`, the weights, m; `density` `[scatterer, level, node]`, m^-1; `passed`, the
    transmittance from the ground, `[level, grounded zenith, wavelength]`.
    """

    node: Float[Array, "level node wavelength"]
    density: Float[Array, "scatterer level node"]
    passed: Float[Array, "level grounded wavelength"]


def medium_of(atmosphere: Atmosphere, wavelength_nm: Float[Array, " wavelength"], moments: int) -> Medium:
    """Optics of an atmosphere; light in the peaks of phase functions beyond `moments` counts as unscattered."""
    if not scatterer_indices(atmosphere.constituents):
        none = jnp.zeros((0, *wavelength_nm.shape), wavelength_nm.dtype)
        extinction = optics(atmosphere.constituents, wavelength_nm).extinction
        return Medium(extinction, none, none[None], atmosphere.ground.reflectance(wavelength_nm), ())
    streams = Streams(moments // 2, 1, 2, 1, "spherical")
    scaled = scaled_optics(atmosphere.constituents, wavelength_nm, streams)
    scatterers = scatterer_indices(atmosphere.constituents)
    peaks = tuple(scatterers.index(i) for i, _ in peaked(atmosphere.constituents))
    albedo = atmosphere.ground.reflectance(wavelength_nm)
    return Medium(scaled.extinction, scaled.scattering, scaled.moments, albedo, peaks)


def ray_weights(atmosphere: Atmosphere, medium: Medium, rays: Rays) -> RayWeights:
    r"""Weights $e^{-\tau} ds$ of the nodes of all rays, scaled so that a ray's opacity is exactly $1 - e^{-\tau}$."""
    constituents = atmosphere.constituents
    profiles = [c.profile for c in constituents]
    levels, nodes = rays.height.shape
    spread = np.broadcast_to(rays.level[:, None], rays.height.shape)
    eye = _views(spread, rays.zenith_cosine[:, rays.ray])
    points = Points(*(as_float(v.reshape(-1, 1)) for v in (rays.height, rays.cosine, rays.cosine)))
    column = eye_columns(profiles, eye, points, "spherical")[..., 0].reshape(-1, levels, nodes)
    ends = Points(*(as_float(v.reshape(-1, 1)) for v in (rays.end_height, rays.end_cosine, rays.end_cosine)))
    eye = _views(np.broadcast_to(rays.level[:, None], rays.length.shape), rays.zenith_cosine)
    whole = eye_columns(profiles, eye, ends, "spherical")[..., 0].reshape(-1, *rays.length.shape)
    whole = jnp.einsum("clz,cw->lzw", whole, medium.extinction)
    every = jnp.stack([p.density(as_float(rays.height)) for p in profiles])
    weight = jnp.exp(-jnp.einsum("cln,cw->lnw", column, medium.extinction)) * as_float(rays.step)[..., None]
    # The nodes that belong to each ray, and the nearest of them.
    mine = np.arange(rays.length.shape[1])[:, None] == rays.ray[None]
    near = np.argmin(np.where(mine[None], rays.distance[:, None], np.inf), axis=-1)
    of_ray, nearest = as_float(mine), as_float(near[..., None] == np.arange(nodes))
    extinction = jnp.einsum("cln,cw->lnw", every, medium.extinction)
    scale, missing = completed(-jnp.expm1(-whole), jnp.einsum("zn,lnw,lnw->lzw", of_ray, weight, extinction))
    weight = weight * scale[:, rays.ray] + jnp.einsum("lzn,lzw->lnw", nearest, missing) / jnp.maximum(
        extinction, _LEAST
    )
    density = jnp.stack([every[i] for i in scatterer_indices(constituents)])
    return RayWeights(weight, density, jnp.exp(-whole[:, -rays.grounded :]))


def completed(
    whole: Float[Array, "..."], found: Float[Array, "..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Factor of the weights on a ray and addition to its nearest node by which their opacity becomes the `whole`.

    In thick air the nodes miss most of the opacity near the eye.
    """
    some = found > _LEAST
    scale = jnp.minimum(jnp.where(some, whole / jnp.where(some, found, 1.0), 1.0), _MOST)
    return scale, jnp.where(whole > _THICK, jnp.maximum(whole - scale * found, 0.0), 0.0)


def per_metre(share: Float[Array, "*shape"], extinction: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Weight (m) of a node that has a `share` of a ray's opacity; 0 where there is no extinction."""
    some = extinction > _NO_AIR
    return jnp.where(some, share / jnp.where(some, extinction, 1.0), 0.0)


def _views(height: np.ndarray, cosine: np.ndarray) -> Views:
    none = jnp.zeros(height.size)
    return Views(True, as_float(height.ravel()), as_float(cosine.ravel()), jnp.zeros(()), none, none, none)
