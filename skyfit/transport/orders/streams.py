"""Diffuse light on discrete streams: the sum over all orders of scattering."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...atmosphere import Atmosphere
from ...numerics import gauss_legendre, legendre_series, of_angle
from ...scene import Scene
from .diffusion import diffusion, first_of, Spread
from .layering import layered, Layers, Resolution
from .polarisation import polarise, Polarised
from .sweep import sweeps_through


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
