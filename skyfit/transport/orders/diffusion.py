"""Diffusion of light through layers: a quick estimate of all remaining orders of scattering that loses no light."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...numerics import tridiagonal_inverse


# Least optical depth between neighbouring layers. Thinner ones count as one: diffusion only guides the sweeps.
_THIN = 1e-4


class Spread(NamedTuple):
    """Diffused light: mean radiance and flux / 4 pi in each layer, flux onto the ground and out of the top."""

    moments: Float[Array, "moment layer wavelength"]
    ground_flux: Float[Array, " wavelength"]
    top_flux: Float[Array, " wavelength"]


def diffusion(
    depth: Float[Array, "layer wavelength"],
    albedo: Float[Array, "layer wavelength"],
    forward: Float[Array, "layer wavelength"],
    ground_albedo: Float[Array, " wavelength"],
) -> Callable:
    r"""Make the function that estimates, by diffusion, all light that follows from scattering some light.

    The mean radiance $M_0$ and the flux / 4 pi $M_1$ obey $dM_1/d\tau = -(1-\omega) M_0 + \omega m_0$ and
    $\tfrac13 dM_0/d\tau = -(1-\omega g) M_1 + \omega g\, m_1$, as means over layers. No light enters from above. The
    ground is Lambertian.

    **Arguments:** `depth`, `albedo` and `forward` are, from the top, each layer's optical depth, its single scattering
    albedo $\omega$ and the product $\omega g$ with the asymmetry parameter; `ground_albedo`. **Returns:** a linear
    function of the mean radiance and the flux / 4 pi that are scattered, `[layer, wavelength]` each. It gives a
    `Spread`: those of all the light that follows, and its fluxes. No light is lost: light that is not absorbed leaves.
    **Source:** Alcouffe 1977, Nucl. Sci. Eng. 64, 344; boundaries of Marshak.
    """
    reflectance = ground_albedo[None]
    half = 0.5 * depth * (1.0 - forward)
    between = jnp.maximum(half[1:] + half[:-1], _THIN)

    def mixing(width):
        # Between thick layers sweeps carry more light than diffusion. The sums are unstable if diffusion carries less.
        return 0.25 * width**2 / (1.0 + width**2)

    inner = 1.0 / (3.0 * between) + mixing(between)
    top = 1.0 / (2.0 + 3.0 * half[:1]) + mixing(2.0 * half[:1])
    onto_ground = 0.5 / (1.0 + reflectance + 1.5 * half[-1:] * (1.0 - reflectance)) + mixing(2.0 * half[-1:])
    bottom = (1.0 - reflectance) * onto_ground
    rate, push = jnp.concatenate([top, inner, bottom]), 1.0 / between
    none = jnp.zeros_like(top)
    pushes = jnp.concatenate([none, push, 3.0 * bottom]), jnp.concatenate([3.0 * top, push, none])

    def flux(even, extra):
        """M_1 at the levels, with neither light nor source beyond the ends."""
        even, extra = jnp.pad(even, ((1, 1), (0, 0))), jnp.pad(extra, ((1, 1), (0, 0)))
        return rate * (even[:-1] - even[1:]) + pushes[0] * extra[:-1] + pushes[1] * extra[1:]

    above, below = rate[:-1], rate[1:]
    diagonal = depth * (1.0 - albedo) + above + below
    diagonals = jnp.concatenate([none, -inner]).T, diagonal.T, jnp.concatenate([-inner, none]).T
    inverse = jax.vmap(tridiagonal_inverse)(*jax.lax.stop_gradient(diagonals))

    def balance(even, mean, extra):
        """Gain of each layer from the light scattered in it, less its losses."""
        return depth * (albedo * mean - (1.0 - albedo) * even) - jnp.diff(flux(even, extra), axis=0)

    def diffuse(mean, stream):
        extra = 0.5 * depth * forward * stream
        # One step of refinement has the derivative of the solution and does not differentiate the inverse.
        guess = jax.lax.stop_gradient(jnp.einsum("wjk,kw->jw", inverse, balance(jnp.zeros_like(mean), mean, extra)))
        even = guess + jnp.einsum("wjk,kw->jw", inverse, balance(guess, mean, extra))
        level = flux(even, extra)
        ground_flux = 4.0 * np.pi * onto_ground[0] * (even[-1] + 3.0 * extra[-1])
        return Spread(jnp.stack([even, 0.5 * (level[1:] + level[:-1])]), ground_flux, -4.0 * np.pi * level[0])

    return diffuse


def first_of(values, shape: tuple[int, ...]):
    """Pad `values` with zeros, at the end of each axis, to `shape`."""
    return jnp.pad(values, [(0, whole - part) for whole, part in zip(shape, values.shape, strict=True)])
