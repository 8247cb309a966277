r"""Spatial coherence: a solver is asked for a few directions, and the smooth sky between them is interpolated."""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..atmosphere import Atmosphere
from ..numerics import chebyshev_nodes, chebyshev_weights, hat_weights
from ..scene import Directions, haversine, Scene
from .optical_path import above_horizon, exponential_nodes, slant_column
from .solver import AbstractSolver, check_on_ground, optics


CROWD = 1.0
DROPZ, DROPA = 0.25, 0.25
# W m^-2 sr^-1 nm^-1; what is darker counts as black
_DARK = 1e-30
_HEIGHTS = 8


class Upsampled(NamedTuple):
    radiance: Float[Array, "direction wavelength"]
    error: Float[Array, "direction wavelength"]


@eqx.filter_jit
def upsample(
    solver: AbstractSolver, atmosphere: Atmosphere, scene: Scene, zeniths: int = 12, azimuths: int = 12
) -> Upsampled:
    place, turn = chebyshev_nodes(2 * zeniths)[zeniths:], chebyshev_nodes(azimuths)
    place, turn = (jnp.asarray(v.ravel(), scene.sun_zenith.dtype) for v in np.meshgrid(place, turn, indexing="ij"))
    zenith = 0.5 * np.pi * jnp.tanh(CROWD * place) / np.tanh(CROWD)
    coarse = replace(scene, view=Directions(zenith, scene.sun_azimuth + jnp.arccos(turn)))
    values = solver.radiance(atmosphere, coarse)
    dark = values < _DARK
    logs = jnp.log(jnp.where(dark, _DARK, values)) - _log_known(solver, atmosphere, coarse)
    top = jnp.max(logs, axis=0)
    logs = logs - top[None]
    few = zeniths * 2 - max(2, int(DROPZ * 2 * zeniths)), azimuths - max(1, int(DROPA * azimuths))

    def weights(place, turn, up=None, around=None):
        up, around = chebyshev_weights(place, 2 * zeniths, up), chebyshev_weights(turn, azimuths, around)
        up, down = up[:, zeniths:], up[:, zeniths - 1 :: -1]
        both = up[:, :, None] * around[:, None, :] + down[:, :, None] * around[:, None, ::-1]
        return both.reshape(place.shape[0], -1)

    missed = jnp.abs(logs - weights(place, turn, few[0], None) @ logs)
    missed = missed + jnp.abs(logs - weights(place, turn, None, few[1]) @ logs)
    missed = jnp.pad(missed.reshape(zeniths, azimuths, -1), ((1, 1), (1, 1), (0, 0)), "edge")
    around = [missed[i : i + zeniths, j : j + azimuths] for i in range(3) for j in range(3)]
    envelope = jnp.max(jnp.stack(around), axis=0).reshape(zeniths * azimuths, -1)

    zenith = scene.view.zenith
    place = jnp.arctanh(np.tanh(CROWD) * jnp.minimum(zenith, 0.5 * np.pi) / (0.5 * np.pi)) / CROWD
    turn = jnp.cos(scene.view.azimuth - scene.sun_azimuth)
    hats = hat_weights(place, jnp.asarray(chebyshev_nodes(2 * zeniths)[zeniths:], place.dtype))
    hats = hats[:, :, None] * hat_weights(turn, jnp.asarray(chebyshev_nodes(azimuths), place.dtype))[:, None, :]
    error = hats.reshape(zenith.shape[0], -1) @ envelope + 10.0 * jnp.finfo(envelope.dtype).eps
    exponent = jnp.minimum(weights(place, turn) @ logs, 1.0)
    radiance = jnp.exp(exponent + top[None] + _log_known(solver, atmosphere, scene))
    lit = above_horizon(zenith)[:, None] & ~jnp.all(dark, axis=0)[None]
    return Upsampled(jnp.where(lit, radiance, 0.0), jnp.where(lit, error, 0.0))


def _log_known(solver, atmosphere, scene):
    r"""Log of the phase functions' mean, weighted by the sunlight that each scatterer scatters."""
    constituents, wavelength = atmosphere.constituents, scene.wavelength_nm
    scatterers = [c for c in constituents if c.phase is not None]
    shape = scene.view.zenith.shape[0], wavelength.shape[0]
    if not scatterers:
        return jnp.zeros(shape, wavelength.dtype)
    depths = optics(constituents, wavelength)
    y, weight = (jnp.asarray(v, wavelength.dtype) for v in exponential_nodes(_HEIGHTS))
    heights = jnp.stack([c.profile.reach() * y for c in scatterers])
    cosine = jnp.cos(scene.sun_zenith) + jnp.zeros_like(heights)
    sunward = jnp.stack([slant_column(c.profile, heights, cosine, solver.geometry) for c in constituents], axis=-1)
    depth = sunward @ depths.extinction
    depth = depth - jnp.min(depth, axis=(0, 1))[None, None]
    half = haversine(scene.view.zenith, scene.sun_zenith, scene.view.azimuth - scene.sun_azimuth)
    total = jnp.zeros(shape, wavelength.dtype)
    row = 0
    for c, scattering in zip(constituents, depths.scattering, strict=True):
        if c.phase is None:
            continue
        share = weight * c.profile.reach() * c.profile.density(heights[row])
        total = total + c.phase.value(half, wavelength) * (scattering * (share @ jnp.exp(-depth[row])))[None]
        row += 1
    return jnp.log(jnp.where(total > 0.0, total, 1.0))
