"""The light that the field in the layers sends toward an observer on the ground."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...atmosphere import Atmosphere
from ...numerics import legendre_series, of_angle, phi_functions
from ...scene import above_horizon, Scene
from ..columns import layer_airmass
from .layering import Resolution
from .polarisation import sources_of_stokes
from .streams import degree_index, diffuse_field
from .sweep import sloped


class Multiple(NamedTuple):
    """Light of second and higher orders toward an observer on the ground, fluxes of diffuse light and beam onto it.

    All per unit solar irradiance.
    """

    light: Float[Array, "stokes direction wavelength"]
    diffuse: Float[Array, " wavelength"]
    beam: Float[Array, " wavelength"]


def multiple_scattering(
    atmosphere: Atmosphere,
    scene: Scene,
    wavelength_nm: Float[Array, " wavelength"],
    ground_albedo: Float[Array, " wavelength"],
    resolution: Resolution,
    stokes: bool = False,
) -> Multiple:
    """What an observer on the ground gets of second and higher orders of scattering.

    **Arguments:** `ground_albedo` at the wavelengths. **Returns:** a `Multiple`: the radiance alone, or with `stokes`
    (of a polarised resolution) I, Q and U.
    """
    layers, field = diffuse_field(atmosphere, scene, wavelength_nm, ground_albedo, resolution, stokes)
    count, modes = resolution.for_phases(atmosphere.constituents)
    view = scene.view
    degree = degree_index(count, modes)
    moments = layers.moments[degree] * field.moments
    cosine = jnp.maximum(jnp.cos(view.zenith), 0.0)
    turn = jnp.arange(modes)[:, None] * (view.azimuth - scene.sun_azimuth)[None]
    # harmonics of a degree below the mode are zero
    some = np.nonzero(degree >= np.arange(modes))
    every = moments[some]
    if field.polarised is not None:
        added = field.polarised.radiance
        # polarisation has fewer degrees and modes
        place = np.stack([degree[some], some[2]])
        inside = np.all(place < np.array(added.shape[:2])[:, None], axis=0)
        extra = added[tuple(np.where(inside[None], place, 0))]
        every = every + jnp.where(inside[:, None, None], extra, 0.0)
    series = legendre_series(modes, count)[degree[some], some[2]]
    basis = of_angle(series, view.zenith) * jnp.cos(turn)[some[2]]
    sources = [jnp.einsum("hd,hkw->kdw", basis, every)]
    if stokes and field.polarised is not None:
        sources += [*sources_of_stokes(field.polarised, scene)]
    airmass = layer_airmass(layers.height, cosine, resolution.geometry)
    light = jnp.stack([_seen(source, layers.depth, airmass) for source in sources])
    beam = jnp.maximum(jnp.cos(scene.sun_zenith), 0.0) * layers.beam[-1]
    return Multiple(jnp.where(above_horizon(view.zenith)[None, :, None], light, 0.0), field.ground_flux, beam)


@jax.custom_jvp
def _seen(
    source: Float[Array, "layer direction wavelength"],
    depth: Float[Array, "layer wavelength"],
    airmass: Float[Array, "layer direction"],
) -> Float[Array, "direction wavelength"]:
    """Radiance on the ground of what the layers send out along each view.

    Its tangents are sums over layers of derivatives that are the same for all of them and are formed once.
    """
    return _along_view(source, *_everywhere(source, depth, airmass))


def _everywhere(source, depth, airmass):
    return jnp.broadcast_to(depth[:, None], source.shape), jnp.broadcast_to(airmass[:, :, None], source.shape)


def _along_view(source, depth, airmass):
    slant = airmass * depth
    below = jnp.cumsum(slant[::-1], axis=0)[::-1] - slant
    first, second = phi_functions(slant)
    emitted = slant * (first * source - (0.5 * first - second) * sloped(source, depth))
    return jnp.sum(jnp.exp(-below) * emitted, axis=0)


@_seen.defjvp
def _seen_tangent(primals, tangents):
    radiance, backward = jax.vjp(_along_view, primals[0], *_everywhere(*primals))
    by_source, by_depth, by_airmass = backward(jnp.ones_like(radiance))
    source, depth, airmass = tangents
    tangent = jnp.einsum("kdw,kdw->dw", by_source, source)
    tangent += jnp.einsum("kdw,kw->dw", by_depth, depth)
    return radiance, tangent + jnp.einsum("kdw,kd->dw", by_airmass, airmass)
