"""Light that was scattered once, or reflected by the ground once, at every level and under every sun."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...atmosphere import Atmosphere
from ...numerics import as_float, legendre_series, of_angle, safe_sqrt
from ...scene import haversine
from ..columns import EARTH_RADIUS, slant_columns
from ..single import lit_integrals
from ..views import Views
from .grid import half_turn, Rays
from .medium import Medium


# Number of azimuths in half a turn for quantities that change little with azimuth.
FEW_AZIMUTHS = 6


def sun_on_ground(
    atmosphere: Atmosphere, extinction, cosine: Float[Array, "*place"]
) -> Float[Array, "*place wavelength"]:
    """Irradiance of the direct beam on level ground, per unit solar irradiance."""
    lit = cosine > 0.0
    inside = jnp.where(lit, cosine, 1.0)
    column = slant_columns([c.profile for c in atmosphere.constituents], jnp.zeros_like(inside), inside, "spherical")
    depth = jnp.tensordot(jnp.moveaxis(column, 0, -1), extinction, 1)
    return jnp.where(lit, cosine, 0.0)[..., None] * jnp.exp(-depth)


def first_order(
    atmosphere: Atmosphere,
    medium: Medium,
    rays: Rays,
    azimuth: np.ndarray,
    sun_zenith: Float[Array, " sun"],
    passed: Float[Array, "level grounded wavelength"],
    nodes: int,
) -> Float[Array, "sun level zenith azimuth wavelength"]:
    """Radiance of the first order with phase functions cut after their moments, per unit solar irradiance, sr^-1.

    The integral over the lit parts of a ray changes little with azimuth and is computed for few azimuths. Phase
    functions are computed for all.
    """
    count, grounded = medium.moments.shape[0], rays.grounded
    shape = (*rays.zenith_cosine.shape, FEW_AZIMUTHS)
    few = half_turn(FEW_AZIMUTHS)
    cosine, height, length, turn = (
        as_float(np.broadcast_to(v, shape).ravel())
        for v in (rays.zenith_cosine[..., None], rays.level[:, None, None], rays.length[..., None], few)
    )
    zenith = jnp.arccos(cosine)
    ray_zenith = zenith.reshape(shape)[:, :, :1]
    series = legendre_series(1, count)[:, 0]
    spread = as_float(spread_azimuths(azimuth))
    radius = as_float(EARTH_RADIUS + rays.level)[:, None, None]
    to_ground = as_float(rays.length[:, -grounded:])[..., None]

    def under(sun):
        half = haversine(zenith, sun, turn)
        views = Views(True, height, cosine, jnp.cos(sun), half, jnp.zeros_like(height), length)
        integral = lit_integrals(atmosphere.constituents, views, medium.extinction, nodes, "spherical")
        integral = jnp.einsum("af,lzfcw->lzacw", spread, integral.reshape(*shape, *integral.shape[1:]))
        half = haversine(ray_zenith, sun, as_float(azimuth)[None, None])
        angle = 2.0 * jnp.arctan2(safe_sqrt(half), safe_sqrt(1.0 - half))
        phase = jnp.tensordot(of_angle(series, angle), medium.moments, ((0,), (0,))) / (4.0 * np.pi)
        light = jnp.sum(integral * phase * medium.scattering[None, None, None], axis=3)
        to_sun = 1.0 - 2.0 * half[:, -grounded:]
        lit = sun_on_ground(atmosphere, medium.extinction, (radius * jnp.cos(sun) + to_ground * to_sun) / EARTH_RADIUS)
        return light.at[:, -grounded:].add((medium.albedo / np.pi)[None, None, None] * lit * passed[:, :, None])

    return jax.lax.map(under, sun_zenith, batch_size=4)


def spread_azimuths(azimuth: np.ndarray) -> np.ndarray:
    """Weights `[azimuth, few]` that interpolate from few azimuths of half a turn to these, by a series of cosines."""
    few = half_turn(FEW_AZIMUTHS)
    mode = np.arange(FEW_AZIMUTHS)[:, None]
    series = np.cos(mode * few) * np.where(mode > 0, 2.0, 1.0) / FEW_AZIMUTHS
    return np.cos(mode * azimuth).T @ series
