"""Diffuse light on discrete streams: the sum over all orders of scattering."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..atmosphere import Atmosphere
from ..numerics import gauss_legendre, legendre_series, of_angle, phi_functions
from ..scene import above_horizon, Scene
from .diffusion import diffusion, first_of, Spread
from .layers import layered, Layers, Resolution
from .optical_path import layer_airmass
from .polarised import polarise, Polarised, sources_of_stokes
from .sweeps import sloped, sweeps_through


class Field(NamedTuple):
    """The diffuse light summed over all orders: moments of its mean in each layer, fluxes at the two ends.

    `moments` are those of the scalar solution; `polarised`, what polarisation does, is in the fluxes.
    """

    moments: Float[Array, "parity half mode layer wavelength"]
    ground_flux: Float[Array, " wavelength"]
    top_flux: Float[Array, " wavelength"]
    polarised: Polarised | None = None


def degree_index(count: int, modes: int) -> np.ndarray:
    """Degrees l `[parity, half, mode]`: those of l + m even first, whose harmonics are even in the cosine."""
    half, mode = np.arange(count // 2)[None, :, None], np.arange(modes)[None, None, :]
    return 2 * half + (mode + np.arange(2)[:, None, None]) % 2


def harmonics(zenith, count: int, modes: int) -> Float[Array | np.ndarray, "parity half mode *shape"]:
    """Associated Legendre functions in the layout of `degree_index`."""
    return of_angle(legendre_series(modes, count)[degree_index(count, modes), np.arange(modes)], zenith)


def solve(layers: Layers, diffuse: Callable | None, resolution: Resolution, modes: int) -> Field:
    """The diffuse field: sweeps, each followed by the diffusion of what it left over (`diffuse`, None: by nothing).

    **Source:** successive orders as in Lenoble et al. 2007, JQSRT 107, 479; sources by conservative means over
    the layers; diffusion synthetic acceleration: Alcouffe 1977, Nucl. Sci. Eng. 64, 344.
    """
    cosine, weight = gauss_legendre(resolution.streams)
    dtype, count = layers.depth.dtype, layers.moments.shape[0]
    on_nodes = harmonics(np.arccos(cosine), count, modes)
    from_moment, to_moment = jnp.asarray(on_nodes, dtype), jnp.asarray(0.5 * weight * on_nodes, dtype)
    phase = layers.moments[degree_index(count, modes)]
    flux_weight = jnp.asarray(2.0 * np.pi * weight * cosine, dtype)
    mode_weight = jnp.asarray(np.where(np.arange(modes) == 0, 1.0, 2.0) / (4.0 * np.pi), dtype)

    sweeps = sweeps_through(layers.height, layers.depth, jnp.asarray(cosine, dtype), resolution.geometry)
    shine_top, shine = sweeps.shine()

    def sweep(emission, beam_flux):
        """Moments of the mean radiance, flux onto the ground and out of the top, for one source."""
        last, down, up = sweeps.run(emission)
        flux = jnp.einsum("n,nw->w", flux_weight, last[0, 0])
        reflected = layers.ground_albedo * (flux + beam_flux)
        top = jnp.einsum("n,nw->w", flux_weight, last[1, 0] + reflected[None] * shine_top)
        up = up + first_of(shine * reflected[None, None, None], up.shape)
        both = jnp.stack([down + up, down - up])
        return jnp.einsum("phmn,pkmnw->phmkw", to_moment, both), flux, top

    def on_streams(moments):
        even, odd = jnp.einsum("phmn,phmkw->pkmnw", from_moment, moments)
        return jnp.stack([even + odd, even - odd])

    def added(moments, pair):
        """The moments with the mean radiance and the vertical flux of some diffuse light added."""
        return moments + first_of(pair[:, None, None], moments.shape)

    def order(carry, _):
        emission, beam_flux, total, spread = carry
        found = sweep(emission, beam_flux)
        total = jax.tree.map(jnp.add, total, found)
        left = added(found[0], -spread.moments)
        if diffuse is not None:
            spread = diffuse(*left[:, 0, 0])
        source = on_streams(phase * added(left, spread.moments))
        return (sweeps.of_source(source), jnp.zeros_like(beam_flux), total, spread), None

    # the beam, exponential within each layer
    sun = harmonics(layers.sun_zenith, count, modes) * mode_weight[None, None]
    once = on_streams(sun[..., None, None] * phase) * layers.beam[None, :-1, None, None]
    beam_flux = jnp.maximum(jnp.cos(layers.sun_zenith), 0.0) * layers.beam[-1]
    dark = jnp.zeros_like(beam_flux)
    nothing = Spread(jnp.zeros_like(phase[:, 0, 0]), dark, dark)
    start = sweeps.of_beam(once, layers.beam_depth), beam_flux, (jnp.zeros_like(phase), dark, dark), nothing
    (_, _, total, spread), _ = jax.lax.scan(order, start, None, length=resolution.orders)
    return Field(added(total[0], spread.moments), total[1] + spread.ground_flux, total[2] + spread.top_flux)


def diffuse_field(
    atmosphere: Atmosphere,
    scene: Scene,
    wavelength_nm: Float[Array, " wavelength"],
    resolution: Resolution,
    stokes: bool = False,
) -> tuple[Layers, Field]:
    """The layers and the light in them."""
    layers = layered(atmosphere, scene, wavelength_nm, resolution)
    _, modes = resolution.for_phases(atmosphere.constituents)
    diffuse = None
    if resolution.complete:
        diffuse = diffusion(layers.depth, layers.moments[0], layers.moments[1] / 3.0, layers.ground_albedo)
    field = solve(layers, diffuse, resolution, modes)
    if not resolution.polarised:
        return layers, field
    polar = polarise(layers, field.moments, diffuse, resolution, modes, stokes)
    ground, top = field.ground_flux + polar.ground_flux, field.top_flux + polar.top_flux
    return layers, Field(field.moments, ground, top, polar)


def multiple_scattering(
    atmosphere: Atmosphere,
    scene: Scene,
    wavelength_nm: Float[Array, " wavelength"],
    resolution: Resolution,
    stokes: bool = False,
) -> Float[Array, "stokes direction wavelength"]:
    """Light of second and higher orders toward an observer on the ground, per unit solar irradiance.

    **Returns:** the radiance alone, or with `stokes` (of a polarised resolution) I, Q and U.
    """
    layers, field = diffuse_field(atmosphere, scene, wavelength_nm, resolution, stokes)
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
    return jnp.where(above_horizon(view.zenith)[None, :, None], light, 0.0)


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
