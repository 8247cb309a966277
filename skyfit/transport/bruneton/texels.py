"""The nodes of the tables, the directions from which light reaches them, and the paths of their views."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...numerics import gauss_legendre, safe_sqrt
from ..columns import EARTH_RADIUS, graded_nodes, height_gain, length_scale
from .parameterisation import distance_to_end, height_of, length_of, Sizes, sun_of, to_horizon, view_nodes, view_of


# Nodes of a path are spread over this many times the height over which the scatterers thin out.
_SPREAD = 2.0


class Texels(NamedTuple):
    """The nodes of the table S: `cosine` of the views at each height; `ground`, which views meet the ground."""

    height: Float[Array, " height"]
    cosine: Float[Array, "height view"]
    ground: Bool[np.ndarray, " view"]
    sun_cosine: Float[Array, " sun"]
    angle: Float[Array, " angle"]


def texels(sizes: Sizes) -> Texels:
    """The nodes of the table S."""
    heights, views, suns, angles = sizes.scattering
    height, (unit, ground) = height_of(_units(heights)), view_nodes(views)
    shape = heights, views
    cosine = view_of(
        jnp.broadcast_to(jnp.asarray(unit, height.dtype)[None], shape),
        jnp.broadcast_to(height[:, None], shape),
        jnp.broadcast_to(jnp.asarray(ground)[None], shape),
        sizes.rescaled,
    )
    return Texels(height, cosine, ground, sun_of(_units(suns), sizes.lowest_sun), 2.0 * _units(angles) - 1.0)


def _units(count: int) -> Float[Array, " node"]:
    return jnp.linspace(0.0, 1.0, count)


def irradiance_nodes(sizes: Sizes) -> tuple[Float[Array, " height"], Float[Array, " sun"]]:
    """Heights (m) and cosines of the sun of the table E."""
    heights, suns = sizes.irradiance
    return height_of(_units(heights)), sun_of(_units(suns), sizes.lowest_sun)


class Ends(NamedTuple):
    """The nodes of the table T: as `Texels`, and `end`, the cosine of the zenith angle of the view back at its end."""

    height: Float[Array, " height"]
    cosine: Float[Array, "height view"]
    ground: Bool[np.ndarray, " view"]
    end: Float[Array, "height view"]


def transmittance_nodes(sizes: Sizes) -> Ends:
    """The nodes of the table T; `end` holds for views to the ground only, with all digits at the horizon."""
    heights, views = sizes.transmittance
    nodes = texels(sizes._replace(scattering=(heights, views, 2, 2)))
    shape = nodes.cosine.shape
    height = jnp.broadcast_to(nodes.height[:, None], shape)
    unit, ground = (jnp.broadcast_to(jnp.asarray(v)[None], shape) for v in view_nodes(views))
    length = length_of(jnp.asarray(unit, height.dtype), height, ground, sizes.rescaled)
    horizon = to_horizon(height)
    up = (horizon - length) * (horizon + length) / (2.0 * EARTH_RADIUS * length)
    # A view down from the ground ends where it begins.
    return Ends(
        nodes.height, nodes.cosine, nodes.ground, jnp.clip(jnp.where(height > 0.0, up, -nodes.cosine), 0.0, 1.0)
    )


def azimuth_cosine(cosine, sun_cosine, angle):
    r"""Cosine of the azimuth between view and sun, $(\nu - \mu \mu_s) / \sqrt{(1 - \mu^2)(1 - \mu_s^2)}$.

    The two zenith angles do not allow every $\nu$; others are replaced by the nearest that is allowed.
    """
    across = safe_sqrt((1.0 - cosine**2) * (1.0 - sun_cosine**2))
    some = across > 1e-6
    return jnp.where(some, jnp.clip((angle - cosine * sun_cosine) / jnp.where(some, across, 1.0), -1.0, 1.0), 1.0)


def possible_angle(cosine, sun_cosine, angle):
    r"""The $\nu$ of an entry of the table: the nearest that its zenith angles allow."""
    across = safe_sqrt((1.0 - cosine**2) * (1.0 - sun_cosine**2))
    return jnp.clip(cosine * sun_cosine + across * azimuth_cosine(cosine, sun_cosine, angle), -1.0, 1.0)


class Sphere(NamedTuple):
    """Directions about a point: the half with y >= 0, with the sun in the x z plane; `weight` (sr) counts one half."""

    cosine: Float[Array, " direction"]
    azimuth: Float[np.ndarray, " direction"]
    ground: Bool[np.ndarray, " direction"]
    weight: Float[Array, " direction"]


def sphere(height: Float[Array, ""], counts: tuple[int, int], lower: bool = True) -> Sphere:
    """Directions from a height: zenith angles on either side of the horizon and dense at it, azimuths even.

    **Arguments:** `counts`, the total number of zenith angles and the number of azimuths in half a turn; `lower`, False
    for the directions above a level plane only, cosines from 0.
    """
    zeniths, azimuths = counts
    x, share = gauss_legendre(zeniths // 2)
    near, weight = jnp.asarray(x**2, height.dtype), jnp.asarray(2.0 * x * share, height.dtype)
    horizon = -to_horizon(height) / (EARTH_RADIUS + height) if lower else jnp.zeros_like(height)
    cosine, solid = horizon + (1.0 - horizon) * near, (1.0 - horizon) * weight
    if lower:
        cosine = jnp.concatenate([horizon - (1.0 + horizon) * near, cosine])
        solid = jnp.concatenate([(1.0 + horizon) * weight, solid])
    azimuth = np.pi * (np.arange(azimuths) + 0.5) / azimuths
    rows = cosine.shape[0]
    ground = np.arange(rows) < (rows // 2 if lower else 0)
    return Sphere(
        jnp.repeat(cosine, azimuths),
        np.tile(azimuth, rows),
        np.repeat(ground, azimuths),
        jnp.repeat(solid, azimuths) * (np.pi / azimuths),
    )


class Paths(NamedTuple):
    """Points on views of the table: distance and weight (m), height (m), cosine of the zenith angle of the view."""

    distance: Float[Array, "view node"]
    weight: Float[Array, "view node"]
    height: Float[Array, "view node"]
    cosine: Float[Array, "view node"]


def paths(height: Float[Array, ""], cosine: Float[Array, " view"], ground: bool, reach, nodes: int) -> Paths:
    """Points on whole views, dense where they run lowest.

    **Arguments:** `ground`, whether all of the views end on the ground; `reach` (m), the height over which the
    scatterers thin out; `nodes`, the number on a view to the ground. Others have twice as many: one part before the
    lowest point and one after it.
    """
    radius = EARTH_RADIUS + height
    length = distance_to_end(height + jnp.zeros_like(cosine), cosine, jnp.full(cosine.shape, ground))
    if ground:
        low, far = length[:, None], jnp.zeros_like(length)[:, None]
    else:
        lowest = jnp.clip(-radius * cosine, 0.0, length)
        low = jnp.stack([lowest, lowest], axis=1)
        far = jnp.stack([jnp.zeros_like(length), length], axis=1)
    start, start_cosine = _at(height, cosine, low)
    scale = length_scale(EARTH_RADIUS + start, jnp.abs(start_cosine), _SPREAD * reach)
    away = far - low
    y, weight = graded_nodes(jnp.abs(away) / scale, nodes)
    distance = low[..., None] + jnp.where(away < 0.0, -scale, scale)[..., None] * y
    shape = cosine.shape[0], -1
    distance, weight = distance.reshape(shape), (scale[..., None] * weight).reshape(shape)
    return Paths(distance, weight, *_at(height, cosine, distance))


def _at(height, cosine, distance):
    radius, cosine = EARTH_RADIUS + height, cosine[:, None]
    gained = jnp.maximum(height + height_gain(radius, cosine, distance), 0.0)
    return gained, jnp.clip((radius * cosine + distance) / (EARTH_RADIUS + gained), -1.0, 1.0)
