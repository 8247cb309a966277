"""Diffuse light on discrete streams: the sum over all orders of scattering."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...atmosphere import Atmosphere
from ...numerics import associated_legendre, gauss_legendre
from ...scene import Scene
from .diffusion import diffusion
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


def harmonics(cosine, sine, count: int, modes: int) -> Float[Array, "parity half mode *shape"]:
    """Associated Legendre functions in the layout of `degree_index`."""
    every = associated_legendre(cosine, sine, modes, count)
    return every[degree_index(count, modes), np.arange(modes)[None, None]]


def solve(layers: Layers, resolution: Resolution, modes: int) -> Field:
    """The diffuse field: sweeps, each followed by the diffusion of what it left over.

    **Source:** successive orders as in Lenoble et al. 2007, JQSRT 107, 479; sources by conservative means over
    the layers; diffusion synthetic acceleration: Alcouffe 1977, Nucl. Sci. Eng. 64, 344.
    """
    cosine, weight = gauss_legendre(resolution.streams)
    dtype, count = layers.depth.dtype, layers.moments.shape[0]
    mu = jnp.asarray(cosine, dtype)
    from_moment = harmonics(mu, jnp.asarray(np.sqrt(1.0 - cosine**2), dtype), count, modes)
    to_moment = jnp.asarray(0.5 * weight, dtype)[None, None, None] * from_moment
    phase = layers.moments[degree_index(count, modes)]
    flux_weight = jnp.asarray(2.0 * np.pi * weight * cosine, dtype)
    mode_weight = jnp.asarray(np.where(np.arange(modes) == 0, 1.0, 2.0) / (4.0 * np.pi), dtype)

    sweeps = sweeps_through(layers.height, layers.depth, mu, resolution.geometry)
    shine_top, shine = sweeps.shine()

    def sweep(last, mean, beam_flux):
        """Moments of the mean radiance, flux onto the ground and out of the top, for one source."""
        flux = jnp.einsum("n,nw->w", flux_weight, last[0, 0])
        reflected = layers.ground_albedo * (flux + beam_flux)
        top = jnp.einsum("n,nw->w", flux_weight, last[1, 0] + reflected[None] * shine_top)
        mean = mean.at[1, :, 0].add(reflected[None, None] * shine)
        both = jnp.stack([mean[0] + mean[1], mean[0] - mean[1]])
        return jnp.einsum("phmn,pkmnw->phmkw", to_moment, both), flux, top

    def on_streams(moments):
        even, odd = jnp.einsum("phmn,phmkw->pkmnw", from_moment, moments)
        return jnp.stack([even + odd, even - odd])

    # the beam, exponential within each layer
    sun = harmonics(layers.sun_cosine, layers.sun_sine, count, modes) * mode_weight[None, None]
    once = on_streams(sun[..., None, None] * phase) * layers.beam[None, :-1, None, None]
    total = sweep(*sweeps.of_beam(once, layers.beam_depth), jnp.maximum(layers.sun_cosine, 0.0) * layers.beam[-1])
    diffuse = None
    if resolution.complete:
        diffuse = diffusion(layers.depth, layers.moments[0], layers.moments[1] / 3.0, layers.ground_albedo)

    def order(carry, _):
        left, total = carry
        even, odd = left[0, 0, 0], left[1, 0, 0]
        even, odd = (0.0 * even, 0.0 * odd) if diffuse is None else diffuse(even, odd)[:2]
        source = on_streams(phase * _added(left, even, odd))
        scattered = sweep(*sweeps.of_source(source), jnp.zeros_like(layers.beam[-1]))
        return (_added(scattered[0], -even, -odd), jax.tree.map(jnp.add, total, scattered)), None

    left = total[0]
    if resolution.orders > 1:
        (left, total), _ = jax.lax.scan(order, (left, total), None, length=resolution.orders - 1)
    if diffuse is None:
        return Field(total[0], total[1], total[2])
    even, odd, more_flux, more_top = diffuse(left[0, 0, 0], left[1, 0, 0])
    return Field(_added(total[0], even, odd), total[1] + more_flux, total[2] + more_top)


def _added(moments, even, odd):
    """The moments with the mean radiance and the vertical flux of some diffuse light added."""
    return moments.at[0, 0, 0].add(even).at[1, 0, 0].add(odd)


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
    field = solve(layers, resolution, modes)
    if not resolution.polarised:
        return layers, field
    polar = polarise(layers, field.moments, resolution, modes, stokes)
    ground, top = field.ground_flux + polar.ground_flux, field.top_flux + polar.top_flux
    return layers, Field(field.moments, ground, top, polar)
