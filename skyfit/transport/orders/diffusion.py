"""Diffusion of light through layers: a quick, conservative guess at all orders of scattering to come."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...numerics import tridiagonal_inverse


# optical depth between layers below which they count as one: diffusion guides the sweeps, it does not decide
_THIN = 1e-4


class Spread(NamedTuple):
    """Light that diffuses: mean radiance and flux / 4 pi in each layer, flux onto the ground and out of the top."""

    moments: Float[Array, "moment layer wavelength"]
    ground_flux: Float[Array, " wavelength"]
    top_flux: Float[Array, " wavelength"]


def diffusion(
    depth: Float[Array, "layer wavelength"],
    albedo: Float[Array, "layer wavelength"],
    forward: Float[Array, "layer wavelength"],
    ground_albedo: Float[Array, " wavelength"],
) -> Callable:
    r"""All that follows the scattering of some light, as diffusion has it.

    With $M_0$, $M_1$ the mean radiance and flux / 4 pi: $dM_1/d\tau = -(1-\omega) M_0 + \omega m_0$ and
    $\tfrac13 dM_0/d\tau = -(1-\omega g) M_1 + \omega g\, m_1$, means over layers, no light from above, a
    Lambertian ground.

    **Arguments:** of each layer from the top: optical depth, single-scattering albedo $\omega$, and that times the
    asymmetry parameter, $\omega g$; the ground's albedo. **Returns:** a function of the mean radiance and the flux
    / 4 pi that are scattered, `[layer, wavelength]` each, which gives those of all the light that follows and
    its fluxes, a `Spread`. It is linear. No light is lost: what is not absorbed leaves.
    **Source:** Alcouffe 1977, Nucl. Sci. Eng. 64, 344; boundaries of Marshak.
    """
    reflectance = ground_albedo[None]
    half = 0.5 * depth * (1.0 - forward)
    between = jnp.maximum(half[1:] + half[:-1], _THIN)

    def mixing(width):
        # between thick layers the sweeps carry more than diffusion does; the sums are unstable where it carries less
        return 0.25 * width**2 / (1.0 + width**2)

    inner = 1.0 / (3.0 * between) + mixing(between)
    top = 1.0 / (2.0 + 3.0 * half[:1]) + mixing(2.0 * half[:1])
    onto_ground = 0.5 / (1.0 + reflectance + 1.5 * half[-1:] * (1.0 - reflectance)) + mixing(2.0 * half[-1:])
    bottom = (1.0 - reflectance) * onto_ground
    rate, push = jnp.concatenate([top, inner, bottom]), 1.0 / between
    none = jnp.zeros_like(top)
    pushes = jnp.concatenate([none, push, 3.0 * bottom]), jnp.concatenate([3.0 * top, push, none])

    def flux(even, extra):
        """M_1 at the levels; without light and source beyond the ends."""
        even, extra = jnp.pad(even, ((1, 1), (0, 0))), jnp.pad(extra, ((1, 1), (0, 0)))
        return rate * (even[:-1] - even[1:]) + pushes[0] * extra[:-1] + pushes[1] * extra[1:]

    above, below = rate[:-1], rate[1:]
    diagonal = depth * (1.0 - albedo) + above + below
    diagonals = jnp.concatenate([none, -inner]).T, diagonal.T, jnp.concatenate([-inner, none]).T
    inverse = jax.vmap(tridiagonal_inverse)(*jax.lax.stop_gradient(diagonals))

    def balance(even, mean, extra):
        """What a layer gains of the light that is scattered in it, less what it loses."""
        return depth * (albedo * mean - (1.0 - albedo) * even) - jnp.diff(flux(even, extra), axis=0)

    def diffuse(mean, stream):
        extra = 0.5 * depth * forward * stream
        # one step of refinement: it has the derivative of the solution, without that of an inverse
        guess = jax.lax.stop_gradient(jnp.einsum("wjk,kw->jw", inverse, balance(jnp.zeros_like(mean), mean, extra)))
        even = guess + jnp.einsum("wjk,kw->jw", inverse, balance(guess, mean, extra))
        level = flux(even, extra)
        ground_flux = 4.0 * np.pi * onto_ground[0] * (even[-1] + 3.0 * extra[-1])
        return Spread(jnp.stack([even, 0.5 * (level[1:] + level[:-1])]), ground_flux, -4.0 * np.pi * level[0])

    return diffuse


def first_of(values, shape: tuple[int, ...]):
    """An array of zeros but for the first entries along each axis."""
    return jnp.pad(values, [(0, whole - part) for whole, part in zip(shape, values.shape, strict=True)])
