"""Light toward an observer from the field in the layers and from the ground under them."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...atmosphere import AbstractConstituent, Atmosphere
from ...numerics import legendre_series, of_angle, phi_functions
from ...scene import above_horizon, Scene
from ..columns import layer_airmass, MIN_COSINE
from ..optics import optics, transmitted_sun
from ..views import end_points, eye_columns, views_of
from .layering import depth_above, Resolution, Scaled
from .polarisation import sources_of_stokes
from .streams import degree_index, diffuse_field
from .sweep import sloped


class Multiple(NamedTuple):
    """Light of second and higher orders toward an observer, fluxes of diffuse light and beam onto the ground.

    All are per unit solar irradiance. `light` contains what the ground reflects into downward views.
    """

    light: Float[Array, "stokes direction wavelength"]
    diffuse: Float[Array, " wavelength"]
    beam: Float[Array, " wavelength"]


def multiple_scattering(
    constituents: tuple[AbstractConstituent, ...],
    scene: Scene,
    scaled: Scaled,
    ground_albedo: Float[Array, " wavelength"],
    resolution: Resolution,
    stokes: bool = False,
) -> Multiple:
    """Light of second and higher orders of scattering and of the ground, as an observer sees it.

    **Arguments:** `scene`, whose observer stands anywhere in flat geometry, else on the ground; `scaled`, the optics at
    some wavelengths, which need not be the scene's; `ground_albedo`, at the same wavelengths.
    **Returns:** a `Multiple`: the radiance alone, or with `stokes` (and a polarised resolution) I, Q and U.
    """
    layers, field = diffuse_field(constituents, scene, scaled, ground_albedo, resolution, stokes)
    count, modes = layers.moments.shape[0], scaled.modes
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
    beam = jnp.maximum(jnp.cos(scene.sun_zenith), 0.0) * layers.beam[-1]
    if scene.height is None:
        airmass = layer_airmass(layers.height, cosine, resolution.geometry)
        light = jnp.stack([_seen(source, layers.depth, airmass) for source in sources])
        light = jnp.where(above_horizon(view.zenith)[None, :, None], light, 0.0)
        return Multiple(light, field.ground_flux, beam)
    share = depth_above(constituents, layers, scene.height, scaled.extinction)
    # The slopes in thick layers may undershoot where little light comes through.
    reflected = layers.ground_albedo * jnp.maximum(field.ground_flux + beam, 0.0) / np.pi
    light = _seen_aloft(jnp.stack(sources), layers.depth, share, reflected, view.zenith)
    return Multiple(light, field.ground_flux, beam)


@jax.custom_jvp
def _seen(
    source: Float[Array, "layer direction wavelength"],
    depth: Float[Array, "layer wavelength"],
    airmass: Float[Array, "layer direction"],
) -> Float[Array, "direction wavelength"]:
    """Radiance on the ground from the sources in the layers along each view.

    All tangents share the same derivatives per layer. These are computed once and summed over the layers.
    """
    return _along_view(source, *_everywhere(source, depth, airmass))


def _everywhere(source, depth, airmass):
    return jnp.broadcast_to(depth[:, None], source.shape), jnp.broadcast_to(airmass[:, :, None], source.shape)


def _along_view(source, depth, airmass):
    slant = airmass * depth
    first, second = phi_functions(slant)
    emitted = slant * (first * source - (0.5 * first - second) * sloped(source, depth))
    return _passed(jnp.zeros_like(source[0]), jnp.exp(-slant), emitted)


def _passed(light, through, emitted):
    """Light after all layers, in the order in which it meets them: each dims what enters and adds its own."""
    return jax.lax.scan(lambda light, layer: (light * layer[0] + layer[1], None), light, (through, emitted))[0]


@_seen.defjvp
def _seen_tangent(primals, tangents):
    radiance, backward = jax.vjp(_along_view, primals[0], *_everywhere(*primals))
    by_source, by_depth, by_airmass = backward(jnp.ones_like(radiance))
    source, depth, airmass = tangents
    tangent = jnp.einsum("kdw,kdw->dw", by_source, source)
    tangent += jnp.einsum("kdw,kw->dw", by_depth, depth)
    return radiance, tangent + jnp.einsum("kdw,kd->dw", by_airmass, airmass)


def bare_ground(atmosphere: Atmosphere, scene: Scene) -> Float[Array, "direction wavelength"]:
    """Radiance of the ground seen from above through flat air without scattering, per unit solar irradiance, sr^-1."""
    constituents, wavelength = atmosphere.constituents, scene.wavelength_nm
    extinction = optics(constituents, wavelength).extinction
    lit = jnp.maximum(jnp.cos(scene.sun_zenith), 0.0) * transmitted_sun(constituents, scene, extinction, "flat")
    views, depth = views_of(scene, "flat"), jnp.zeros((scene.view.zenith.shape[0], *wavelength.shape), extinction.dtype)
    if constituents:
        columns = eye_columns([c.profile for c in constituents], views, end_points(views, "flat"), "flat")
        depth = columns[..., 0].T @ extinction
    light = (atmosphere.ground.reflectance(wavelength) * lit / np.pi)[None] * jnp.exp(-depth)
    return jnp.where(above_horizon(scene.view.zenith)[:, None], 0.0, light)


def _seen_aloft(
    sources: Float[Array, "stokes layer direction wavelength"],
    depth: Float[Array, "layer wavelength"],
    share: Float[Array, "layer wavelength"],
    reflected: Float[Array, " wavelength"],
    zenith: Float[Array, " direction"],
) -> Float[Array, "stokes direction wavelength"]:
    """Radiance at an observer on a flat Earth who has `share` of each layer overhead.

    Views up see the layers above. Views down see the layers below and the ground, whose light is not polarised.
    Sources are linear within each layer, as for the observer on the ground. Each view crosses only its own part of the
    layer in which the observer is.
    """
    climbs = above_horizon(zenith)[None, :, None]
    airmass = 1.0 / jnp.maximum(jnp.abs(jnp.cos(zenith)), MIN_COSINE)
    slant = depth[:, None] * airmass[None, :, None]
    above = share[:, None] + jnp.zeros_like(slant)
    part = jnp.where(climbs, above, 1.0 - above)
    slant = part * slant
    first, second = phi_functions(slant)
    lean = slant * (0.5 * first - second) * part
    # `step` is the change of a source from top to bottom. Upward light meets it the other way round.
    tilt = slant * first * jnp.where(climbs, 0.5 * (above - 1.0), 0.5 * above) + jnp.where(climbs, -lean, lean)
    step = jnp.stack([sloped(source, depth[:, None]) for source in sources], axis=1)
    emitted = (slant * first)[:, None] * jnp.moveaxis(sources, 0, 1) + tilt[:, None] * step
    # Views up see light on its way down through the layers above, views down light on its way up from the ground.
    through, emitted = (jnp.where(climbs[:, None], v, v[::-1]) for v in (jnp.exp(-slant)[:, None], emitted))
    ground = jnp.where(climbs[0], 0.0, reflected[None])
    return _passed(jnp.pad(ground[None], ((0, sources.shape[0] - 1), (0, 0), (0, 0))), through, emitted)
