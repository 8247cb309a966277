"""Polarisation of diffuse light: the difference between the vector and the scalar solution, on few streams."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...numerics import associated_legendre, gauss_legendre, spin_legendre
from ...scene import Scene
from .diffusion import diffusion
from .layering import Layers, Resolution
from .sweep import sweeps_through


class Polarised(NamedTuple):
    """What polarisation does: sources in each layer, by their moments, and changes of the fluxes at the two ends.

    `radiance`: what it adds to the scalar source; `even`, `odd`: sources of Q and U, the odd ones change sign under a
    mirror.
    """

    radiance: Float[Array, "degree mode layer wavelength"]
    even: Float[Array, "degree mode layer wavelength"]
    odd: Float[Array, "degree mode layer wavelength"]
    ground_flux: Float[Array, " wavelength"]
    top_flux: Float[Array, " wavelength"]


def plain_place(degrees: int, modes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where degree l and mode m stand in the layout of `degree_index`: parity, half, mode, `[degree, mode]` each."""
    degree, mode = np.arange(degrees)[:, None], np.arange(modes)[None]
    return (degree + mode) % 2, np.broadcast_to(degree // 2, (degrees, modes)), np.broadcast_to(mode, (degrees, modes))


def polarise(layers: Layers, moments, resolution: Resolution, modes: int, stokes: bool) -> Polarised:
    r"""The polarised field that a scalar one and the beam excite, and what it does to the radiance in turn.

    With the moments I of the scalar field, D of the vector radiance less it, and E, B of Q and U, scattering makes
    $D \leftarrow \beta D + \gamma E$, $E \leftarrow \gamma (I + D) + \alpha E$, $B \leftarrow \zeta B$; the beam
    excites E. D, E and B are smooth: few streams carry them, through the layers of the scalar solution.

    **Arguments:** `moments` of the scalar field, in the layout of `degree_index`, and their `modes`; `stokes`, whether
    Q and U are asked for.
    **Source:** the expansion is Siewert's 1982 (Astron. Astrophys. 109, 195) with V neglected; I as a given source is
    ours. Orders as in `solve`; those after the last one are summed as a geometric series.
    """
    few, matrix, every = resolution.few(stokes), layers.matrix, modes
    assert matrix is not None
    cosine, weight = gauss_legendre(few.streams)
    dtype, count, modes = layers.depth.dtype, min(few.moments, matrix.shape[1]), min(few.modes, modes)
    both = jnp.asarray(np.stack([cosine, -cosine]), dtype)
    sine = jnp.asarray(np.stack([np.sqrt(1.0 - cosine**2)] * 2), dtype)
    plain = associated_legendre(both, sine, modes, count)
    r, t = spin_legendre(both, sine, modes, count)
    # of E and B on Q and U
    spin = jnp.stack([jnp.stack([r, t]), jnp.stack([t, r])])
    half_weight = jnp.asarray(0.5 * weight, dtype)
    alpha, gamma, zeta = matrix[:, :count, None]
    beta = layers.moments[:count, None]
    flux_weight = jnp.asarray(2.0 * np.pi * weight * cosine, dtype)
    sweeps = sweeps_through(layers.height, layers.depth, both[0], resolution.geometry)
    shine_top, shine = sweeps.shine()

    def on_streams(moments):
        light = jnp.einsum("lmdn,lmjw->djmnw", plain, moments[0])
        both = jnp.einsum("kslmdn,klmjw->djsmnw", spin, moments[1:])
        return jnp.concatenate([light, both.reshape(*both.shape[:2], -1, *both.shape[4:])], axis=2)

    def sweep(last, mean):
        """Moments of the mean Stokes parameters, flux onto the ground and out of the top, for one source."""
        flux = jnp.einsum("n,nw->w", flux_weight, last[0, 0])
        reflected = layers.ground_albedo * flux
        top = jnp.einsum("n,nw->w", flux_weight, last[1, 0] + reflected[None] * shine_top)
        mean = mean.at[1, :, 0].add(reflected[None, None] * shine)
        light = jnp.einsum("lmdn,djmnw->lmjw", plain * half_weight[None, None, None], mean[:, :, :modes])
        both = mean[:, :, modes:].reshape(*mean.shape[:2], 2, modes, *mean.shape[3:])
        both = jnp.einsum("kslmdn,djsmnw->klmjw", spin * half_weight[(None,) * 5], both)
        return jnp.concatenate([light[None], both]), flux, top

    def scattered(field):
        difference, even, odd = field
        return jnp.stack([beta * difference + gamma * even, gamma * difference + alpha * even, zeta * odd])

    nothing = jnp.zeros((count, modes, *alpha.shape[2:]), dtype)
    sun = associated_legendre(layers.sun_cosine, layers.sun_sine, modes, count)
    mode_weight = jnp.asarray(np.where(np.arange(modes) == 0, 1.0, 2.0) / (4.0 * np.pi), dtype)
    beam = jnp.stack([nothing, gamma * (sun * mode_weight[None])[..., None, None], nothing])
    total = sweep(*sweeps.of_beam(on_streams(beam) * layers.beam[None, :-1, None, None], layers.beam_depth))
    excited = matrix[1][:, None] * moments[plain_place(matrix.shape[1], every)]
    diffuse = diffusion(layers.depth, layers.moments[0], layers.moments[1] / 3.0, layers.ground_albedo)

    def order(carry, _):
        _, left, total, source = carry
        more, stream, *_ = diffuse(left[0, 0, 0], left[0, 1, 0])
        found = sweep(*sweeps.of_source(on_streams(scattered(_added(left, more, stream)) + source)))
        return (
            left,
            _added(found[0], -more, -stream),
            jax.tree.map(jnp.add, total, found),
            jnp.zeros_like(source),
        ), None

    left = total[0]
    start = left, left, total, jnp.stack([nothing, excited[:count, :modes], nothing])
    (before, left, (total, ground_flux, top_flux), _), _ = jax.lax.scan(order, start, None, length=few.orders)
    tail = _tail(before, left)
    more, stream, more_flux, more_top = diffuse(*(left + tail)[0, :2, 0])
    radiance, even, odd = scattered(_added(total + tail, more, stream))
    # the aureole's light is polarised anew at each scattering: in all of its modes
    even, odd = excited.at[:count, :modes].add(even), jnp.zeros_like(excited).at[:count, :modes].set(odd)
    return Polarised(radiance, even, odd, ground_flux + more_flux, top_flux + more_top)


def _tail(before, last):
    """What the orders after the last one sum up to, if each is the same share of the one before."""
    axes = (1, 2, 3)
    # of the size of one, or the squares of faint light vanish
    peak = jax.lax.stop_gradient(jnp.max(jnp.abs(before), axis=axes))
    unit = (1.0 / jnp.where(peak > 0.0, peak, 1.0))[:, None, None, None]
    size = jnp.sum((unit * before) ** 2, axis=axes)
    share = jnp.sum((unit * before) * (unit * last), axis=axes) / jnp.where(size > 0.0, size, 1.0)
    share = jnp.clip(share, 0.0, 0.95)
    return (share / (1.0 - share))[:, None, None, None] * last


def _added(field, more, stream):
    """The moments with the mean radiance and the vertical flux of some diffuse light added."""
    return field.at[0, 0, 0].add(more).at[0, 1, 0].add(stream)


def sources_of_stokes(field: Polarised, scene: Scene) -> Float[Array, "stokes layer direction wavelength"]:
    """Sources of Q and U along each view."""
    degrees, modes = field.even.shape[:2]
    cosine = jnp.maximum(jnp.cos(scene.view.zenith), 0.0)
    r, t = spin_legendre(cosine, jnp.sin(scene.view.zenith), modes, degrees)
    turn = jnp.arange(modes)[:, None] * (scene.view.azimuth - scene.sun_azimuth)[None]
    along, across = jnp.cos(turn)[None], jnp.sin(turn)[None]
    of_even, of_odd = jnp.stack([r * along, t * across]), jnp.stack([t * along, r * across])
    light = jnp.einsum("slmd,lmkw->skdw", of_even, field.even)
    return light + jnp.einsum("slmd,lmkw->skdw", of_odd, field.odd)
