"""Diffuse light on discrete streams: the sum over all orders of scattering."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...atmosphere import AbstractConstituent
from ...numerics import gauss_legendre, legendre_series, of_angle
from ...scene import Scene
from .diffusion import diffusion, first_of, Spread
from .layering import layered, Layers, Resolution, Scaled
from .polarisation import polarise, Polarised
from .sweep import sweeps_through


# Optical depth of layers that keep half of the light scattered in them.
_SPREAD = 0.65


class Field(NamedTuple):
    """The diffuse light summed over all orders: moments of its mean in each layer, fluxes at the two ends.

    `moments` are those of the scalar solution. The fluxes contain the effect of polarisation, `polarised`.
    """

    moments: Float[Array, "parity half mode layer wavelength"]
    ground_flux: Float[Array, " wavelength"]
    top_flux: Float[Array, " wavelength"]
    polarised: Polarised | None = None


def degree_index(count: int, modes: int) -> np.ndarray:
    """Degrees l `[parity, half, mode]`: first those with even l + m, whose harmonics are even in the cosine."""
    half, mode = np.arange(count // 2)[None, :, None], np.arange(modes)[None, None, :]
    return 2 * half + (mode + np.arange(2)[:, None, None]) % 2


def harmonics(zenith, count: int, modes: int) -> Float[Array | np.ndarray, "parity half mode *shape"]:
    """Associated Legendre functions in the layout of `degree_index`."""
    return of_angle(legendre_series(modes, count)[degree_index(count, modes), np.arange(modes)], zenith)


def solve(layers: Layers, diffuse: Callable | None, resolution: Resolution, modes: int) -> Field:
    """Solve the diffuse field by sweeps, each followed by the diffusion of its residual (`diffuse`, None for none).

    The residual is the light that a sweep finds beyond the field so far. Each step of the field is a weighted sum of
    the residual and of the step before (`relaxation`).

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
        """The moments plus the mean radiance and the vertical flux of some diffuse light."""
        return moments + first_of(pair[:, None, None], moments.shape)

    def order(carry, factors):
        emission, beam_flux, moments, held, step, fluxes, spread = carry
        found, *flux = sweep(emission, beam_flux)
        residual = held + found
        if diffuse is not None:
            spread = diffuse(*residual[:, 0, 0])
        of_residual, of_step = factors[:, None, None, :, None]
        step = of_residual * added(residual, spread.moments) + of_step * step
        emission = sweeps.of_source(on_streams(phase * step))
        fluxes = jax.tree.map(jnp.add, fluxes, tuple(flux))
        return (emission, jnp.zeros_like(beam_flux), moments + step, residual - step, step, fluxes, spread), None

    # Light scattered from the beam, which is exponential within each layer.
    sun = harmonics(layers.sun_zenith, count, modes) * mode_weight[None, None]
    once = on_streams(sun[..., None, None] * phase) * layers.beam[None, :-1, None, None]
    beam_flux = jnp.maximum(jnp.cos(layers.sun_zenith), 0.0) * layers.beam[-1]
    dark = jnp.zeros_like(beam_flux)
    nothing, none = Spread(jnp.zeros_like(phase[:, 0, 0]), dark, dark), jnp.zeros_like(phase)
    factors = relaxation(layers, resolution, modes)
    start = sweeps.of_beam(once, layers.beam_depth), beam_flux, none, none, none, (dark, dark), nothing
    (_, _, moments, held, _, fluxes, spread), _ = jax.lax.scan(order, start, factors)
    # The last step takes the whole residual, so that all light that was scattered counts.
    return Field(added(moments + held, spread.moments), fluxes[0] + spread.ground_flux, fluxes[1] + spread.top_flux)


def relaxation(layers: Layers, resolution: Resolution, modes: int) -> Float[Array, "order factor mode wavelength"]:
    r"""Weights of the residual and of the step before in each step of `solve`, by Chebyshev's semi-iteration.

    A sweep multiplies the missing light by eigenvalues between 0 (or that of a negative moment) and $\rho$. The weights
    minimise the largest value of the polynomial in these eigenvalues; a plain sum of orders leaves $\rho^n$. For an
    azimuthal mode, $\rho$ is the largest moment of the scattering that the mode carries, times the share of light that
    stays in layers of that optical depth. In the first mode, where diffusion follows each sweep, half the second moment
    replaces the largest. Without `resolution.complete` the sweeps are plain, one order each.

    **Source:** Golub & Varga 1961, Numer. Math. 3, 147. The share: the largest eigenvalue of isotropic scattering in a
    slab, within 0.05.
    """
    dtype, count = layers.depth.dtype, layers.moments.shape[0]
    if not resolution.complete:
        return jnp.asarray(np.array([[[[1.0]], [[0.0]]]] * resolution.orders), dtype)
    degree = np.arange(count)
    moments = layers.moments / jnp.asarray(2.0 * degree + 1.0, dtype)[:, None, None]
    carried = np.where(degree >= np.arange(modes)[:, None], 1.0, 0.0)
    carried[0] = np.where(degree == 2, 0.5, 0.0)
    carried = jnp.asarray(carried, dtype)[:, :, None]
    # Linear sources are not close to the light within layers that are thick themselves, so sweeps are plain there.
    thickness = jnp.sum(layers.depth, axis=0)
    stays = (thickness / (thickness + _SPREAD) / (1.0 + jnp.max(layers.depth, axis=0) ** 2))[None]
    low = stays * jnp.min(carried * jnp.minimum(jnp.min(moments, axis=1), 0.0)[None], axis=1)
    high = stays * jnp.max(carried * jnp.maximum(jnp.max(moments, axis=1), 0.0)[None], axis=1)
    scale, square = 2.0 / (2.0 - low - high), ((high - low) / (2.0 - low - high)) ** 2
    over, steps = jnp.ones_like(scale), [jnp.stack([scale, jnp.zeros_like(scale)])]
    for order in range(1, resolution.orders):
        over = 1.0 / (1.0 - (0.5 if order == 1 else 0.25) * square * over)
        steps.append(jnp.stack([over * scale, over - 1.0]))
    return jnp.stack(steps)


def diffuse_field(
    constituents: tuple[AbstractConstituent, ...],
    scene: Scene,
    scaled: Scaled,
    ground_albedo: Float[Array, " wavelength"],
    resolution: Resolution,
    stokes: bool = False,
) -> tuple[Layers, Field]:
    """The layers and the diffuse field in them, over a ground of the given albedo."""
    layers = layered(constituents, scene, scaled, ground_albedo, resolution)
    diffuse = None
    if resolution.complete:
        diffuse = diffusion(layers.depth, layers.moments[0], layers.moments[1] / 3.0, layers.ground_albedo)
    field = solve(layers, diffuse, resolution, scaled.modes)
    if not resolution.polarised:
        return layers, field
    polar = polarise(layers, field.moments, diffuse, resolution, scaled.modes, stokes)
    ground, top = field.ground_flux + polar.ground_flux, field.top_flux + polar.top_flux
    return layers, Field(field.moments, ground, top, polar)
