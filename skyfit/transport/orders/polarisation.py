"""Polarisation of diffuse light: the difference between the vector and the scalar solution, on few streams."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...numerics import associated_legendre, gauss_legendre, spin_legendre
from ...scene import Scene
from .diffusion import first_of, Spread
from .layering import Layers, Resolution
from .sweep import sweeps_through


class Polarised(NamedTuple):
    """Effects of polarisation: moments of the sources in each layer, and changes of the fluxes at the two ends.

    `radiance` is added to the scalar source. `even` and `odd` are sources of Q and U; the odd ones change sign under
    reflection.
    """

    radiance: Float[Array, "degree mode layer wavelength"]
    even: Float[Array, "degree mode layer wavelength"]
    odd: Float[Array, "degree mode layer wavelength"]
    ground_flux: Float[Array, " wavelength"]
    top_flux: Float[Array, " wavelength"]


def polarise(
    layers: Layers, moments, diffuse: Callable | None, resolution: Resolution, modes: int, stokes: bool
) -> Polarised:
    r"""Solve the polarised field that the scalar field and the beam excite, and its effect on the radiance.

    The moments are I of the scalar field, D of the vector radiance less the scalar one, and E, B of Q and U.
    Scattering gives $D \leftarrow \beta D + \gamma E$, $E \leftarrow \gamma (I + D) + \alpha E$,
    $B \leftarrow \zeta B$. The beam excites E. D, E and B are smooth, so few streams carry them through the layers of
    the scalar solution.

    **Arguments:** `moments`, those of the scalar field, in the layout of `degree_index`; `modes`, their number of
    modes; `diffuse`, the function from `diffusion` for these layers; `stokes`, whether Q and U are asked for.
    **Source:** the expansion is Siewert's 1982 (Astron. Astrophys. 109, 195) with V neglected; I as a given source is
    ours. Orders as in `solve`; those after the last one are summed as a geometric series.
    """
    few, matrix, every = resolution.few(stokes), layers.matrix, modes
    assert matrix is not None and diffuse is not None
    cosine, weight = gauss_legendre(few.streams)
    dtype, count, modes = layers.depth.dtype, min(few.moments, matrix.shape[1]), min(few.modes, modes)
    down = np.arccos(cosine)
    zenith = np.stack([down, np.pi - down])
    plain, (r, t) = associated_legendre(zenith, modes, count), spin_legendre(zenith, modes, count)
    # First axis: moments D, E and B. Second axis: I, Q and U.
    to_streams = np.zeros((3, 3, *plain.shape))
    to_streams[0, 0], to_streams[1, 1], to_streams[1, 2], to_streams[2, 1], to_streams[2, 2] = plain, r, t, t, r
    to_moments = jnp.asarray(0.5 * weight * to_streams, dtype)
    to_streams = jnp.asarray(to_streams, dtype)
    alpha, gamma, zeta = matrix[:, :count, None]
    beta = layers.moments[:count, None]
    flux_weight = jnp.asarray(2.0 * np.pi * weight * cosine, dtype)
    sweeps = sweeps_through(layers.height, layers.depth, jnp.asarray(cosine, dtype), resolution.geometry)
    shine_top, shine = sweeps.shine()

    def on_streams(moments):
        light = jnp.einsum("kslmdn,klmjw->djsmnw", to_streams, moments)
        return light.reshape(*light.shape[:2], -1, *light.shape[4:])

    def sweep(emission):
        """Moments of the mean Stokes parameters, flux onto the ground and out of the top, for one source."""
        last, down, up = sweeps.run(emission)
        flux = jnp.einsum("n,nw->w", flux_weight, last[0, 0])
        reflected = layers.ground_albedo * flux
        top = jnp.einsum("n,nw->w", flux_weight, last[1, 0] + reflected[None] * shine_top)
        up = up + first_of(shine * reflected[None, None, None], up.shape)
        light = jnp.stack([down, up]).reshape(2, down.shape[0], 3, modes, *down.shape[2:])
        return jnp.einsum("kslmdn,djsmnw->klmjw", to_moments, light), flux, top

    def scattered(field):
        difference, even, odd = field
        return jnp.stack([beta * difference + gamma * even, gamma * difference + alpha * even, zeta * odd])

    def added(field, pair):
        """The moments plus the mean radiance and the vertical flux of some diffuse light."""
        return field + first_of(pair[None, :, None], field.shape)

    def order(carry, _):
        emission, source, (_, before), total, spread = carry
        found = sweep(emission)
        left = added(found[0], -spread.moments)
        spread = diffuse(*left[0, :2, 0])
        source_here = scattered(added(left, spread.moments)) + source
        return (
            sweeps.of_source(on_streams(source_here)),
            jnp.zeros_like(source),
            (before, left),
            jax.tree.map(jnp.add, total, found),
            spread,
        ), None

    nothing = jnp.zeros((count, modes, *alpha.shape[2:]), dtype)
    sun = associated_legendre(layers.sun_zenith, modes, count)
    mode_weight = jnp.asarray(np.where(np.arange(modes) == 0, 1.0, 2.0) / (4.0 * np.pi), dtype)
    beam = jnp.stack([nothing, gamma * (sun * mode_weight[None])[..., None, None], nothing])
    degree, mode = np.arange(matrix.shape[1])[:, None], np.arange(every)[None]
    excited = matrix[1][:, None] * moments[(degree + mode) % 2, degree // 2, mode]
    source = jnp.stack([nothing, excited[:count, :modes], nothing])
    dark = jnp.zeros_like(layers.ground_albedo)
    field = jnp.zeros_like(source)
    start = (
        sweeps.of_beam(on_streams(beam) * layers.beam[None, :-1, None, None], layers.beam_depth),
        source,
        (field, field),
        (field, dark, dark),
        Spread(field[0, :2, 0], dark, dark),
    )
    (_, _, (before, left), (total, ground_flux, top_flux), spread), _ = jax.lax.scan(
        order, start, None, length=few.orders + 1
    )
    # The orders after the last one, and the diffused light that follows from them.
    share = _share(before, left)
    tail = share[:, None, None, None] * left
    spread = jax.tree.map(lambda v: jnp.expand_dims(1.0 + share[0], range(v.ndim - 1)) * v, spread)
    radiance, even, odd = scattered(added(total + tail, spread.moments))
    # Each scattering polarises the aureole's light anew, so `excited` keeps all modes of the scalar field.
    even = excited + first_of(even, excited.shape)
    return Polarised(
        radiance, even, first_of(odd, excited.shape), ground_flux + spread.ground_flux, top_flux + spread.top_flux
    )


def _share(before, last):
    """Sum of all orders after the last one, over the last, if each is the same share of the one before."""
    axes = (1, 2, 3)
    # Scaled to order one, because the squares of faint light would underflow.
    peak = jax.lax.stop_gradient(jnp.max(jnp.abs(before), axis=axes))
    unit = (1.0 / jnp.where(peak > 0.0, peak, 1.0))[:, None, None, None]
    size = jnp.sum((unit * before) ** 2, axis=axes)
    share = jnp.sum((unit * before) * (unit * last), axis=axes) / jnp.where(size > 0.0, size, 1.0)
    share = jnp.clip(share, 0.0, 0.95)
    return share / (1.0 - share)


def sources_of_stokes(field: Polarised, scene: Scene) -> Float[Array, "stokes layer direction wavelength"]:
    """Sources of Q and U along each view."""
    degrees, modes = field.even.shape[:2]
    r, t = spin_legendre(scene.view.zenith, modes, degrees)
    turn = jnp.arange(modes)[:, None] * (scene.view.azimuth - scene.sun_azimuth)[None]
    along, across = jnp.cos(turn)[None], jnp.sin(turn)[None]
    of_even, of_odd = jnp.stack([r * along, t * across]), jnp.stack([t * along, r * across])
    light = jnp.einsum("slmd,lmkw->skdw", of_even, field.even)
    return light + jnp.einsum("slmd,lmkw->skdw", of_odd, field.odd)
