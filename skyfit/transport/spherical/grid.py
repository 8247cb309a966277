"""The grid of a spherical atmosphere: heights, suns and directions, and interpolation between them."""

import math
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...numerics import cubic_weights, gauss_legendre, library_of
from ..columns import EARTH_RADIUS, TOP_OF_AIR


# Heights are near (exp(a x^p) - 1) for evenly spaced x: dense where haze lies. This is p.
_POWER = 1.5
# Nodes of a path crowd within this many times `near` above its lowest point.
CLIMB = 2.0
# Zenith angle (degrees) above which suns are evenly spaced. Below it the spacing widens by this share for each step.
_EVEN_ABOVE, _WIDER = 86.0, 0.3
# Light in twilight falls as exp(-0.8 z) with the sun's zenith angle z in degrees, from about 93 to 130.
_FALL, _DUSK, _SOFT, _NIGHT = 0.8, 93.0, 1.5, 130.0


class Resolution(NamedTuple):
    """Resolution of a spherical atmosphere, all static; see `Spherical`."""

    levels: int
    moments: int
    zeniths: tuple[int, int, int]
    orders: int
    sun_step: float
    path_nodes: int
    first_nodes: int
    view_nodes: int
    once_nodes: int
    near: float


class Rays(NamedTuple):
    """Straight rays from every level to where they leave the air or meet the ground; numpy, float64, static.

    `zenith_cosine` and `solid_angle` (over all azimuths, sr) are `[level, zenith]`; the last `grounded` zenith angles
    meet the ground. Nodes are `[level, node]`: `height` (m), `cosine` of the zenith angle there, `distance` from the
    level and `step` (m). `between` are the weights of the levels at the nodes, `[level, node, other level]`; `ray` is
    the index of the zenith angle that a node belongs to, `[node]`. `length` (m) of each ray, `end_height` (m) and
    `end_cosine` at its end are `[level, zenith]`.
    """

    level: np.ndarray
    zenith_cosine: np.ndarray
    solid_angle: np.ndarray
    grounded: int
    height: np.ndarray
    cosine: np.ndarray
    distance: np.ndarray
    step: np.ndarray
    between: np.ndarray
    ray: np.ndarray
    length: np.ndarray
    end_height: np.ndarray
    end_cosine: np.ndarray


def level_heights(resolution: Resolution) -> np.ndarray:
    """Heights of the levels, m, from the ground to the top of the air."""
    x = np.arange(resolution.levels) / (resolution.levels - 1)
    return resolution.near * np.expm1(math.log1p(TOP_OF_AIR / resolution.near) * x**_POWER)


def height_coordinate(height: Any, resolution: Resolution) -> Any:
    """Position of heights (m) among the levels, 0 to `levels` - 1; numpy arrays give numpy arrays."""
    xp, near = library_of(height), resolution.near
    share = xp.log1p(xp.clip(height, 1e-3, TOP_OF_AIR) / near) / math.log1p(TOP_OF_AIR / near)
    return (resolution.levels - 1) * share ** (1.0 / _POWER)


def sun_coordinate(zenith: Any, step: float) -> Any:
    """Position of a sun's zenith angle (rad) on the axis on which suns are `step` degrees apart in twilight.

    Suns are one unit apart on it. Numpy arrays give numpy arrays.
    """
    xp = library_of(zenith)
    above = (xp.rad2deg(zenith) - _EVEN_ABOVE) / step
    return xp.where(above > 0.0, above, -xp.log1p(_WIDER * xp.maximum(-above, 0.0)) / _WIDER)


def sun_at(place: Float[Array, "..."], step: float) -> Float[Array, "..."]:
    """The inverse of `sun_coordinate`, rad."""
    below = jnp.expm1(_WIDER * jnp.maximum(-place, 0.0)) / _WIDER
    return jnp.deg2rad(_EVEN_ABOVE + step * jnp.where(place > 0.0, place, -below))


def dusk(zenith: Float[Array, "..."]) -> Float[Array, "..."]:
    """Approximate fall of light with the sun's zenith angle (rad); tables over suns contain light divided by it."""
    return jnp.exp(-_FALL * _SOFT * jnp.logaddexp(0.0, (jnp.minimum(jnp.rad2deg(zenith), _NIGHT) - _DUSK) / _SOFT))


def sun_weights(zenith: Float[Array, "..."], sun_place: Float[Array, " sun"], step: float) -> Float[Array, "... sun"]:
    """Weights of the suns of a table for zenith angles (rad), times `dusk` there."""
    place = sun_coordinate(zenith, step) - sun_place[0]
    return cubic_weights(place, sun_place.shape[0]) * dusk(zenith)[..., None]


def half_turn(count: int) -> np.ndarray:
    """Azimuths (rad) in the middle of equal parts of half a turn."""
    return np.pi * (np.arange(count) + 0.5) / count


def rays_of(resolution: Resolution) -> Rays:
    """The rays from all levels through the atmosphere.

    Zenith cosines are Gauss nodes in three panels: the sky above the level, the air between it and the ground's
    horizon, and the ground. They are dense toward both horizons. Nodes on a ray are Gauss nodes in the logarithm of the
    distance from its lowest point.
    """
    height = level_heights(resolution)
    radius = EARTH_RADIUS + height
    horizon = -np.sqrt(height * (2.0 * EARTH_RADIUS + height)) / radius
    (up, up_weight), (flat, flat_weight), (down, down_weight) = (gauss_legendre(count) for count in resolution.zeniths)
    one = np.ones_like(horizon)[:, None]
    cosine = np.concatenate(
        [one * up**2, horizon[:, None] * (1.0 - flat), horizon[:, None] - (1.0 + horizon[:, None]) * down**2], axis=1
    )
    below = one + horizon[:, None]
    weights = one * 2.0 * up * up_weight, (one - below) * flat_weight, below * 2.0 * down * down_weight
    weight = np.concatenate(weights, axis=1)
    first, middle, last = (range(*ends) for ends in _ends(resolution.zeniths))
    along = radius[:, None] * cosine
    to_top = np.sqrt(along**2 + (TOP_OF_AIR - height[:, None]) * (EARTH_RADIUS + TOP_OF_AIR + radius[:, None]))
    to_ground = -along - np.sqrt(np.maximum(along**2 - height[:, None] * (EARTH_RADIUS + radius[:, None]), 0.0))
    meets = (np.arange(cosine.shape[1]) >= last.start)[None] & (radius > 0.0)[:, None]
    length = np.where(meets, to_ground, to_top - along)
    # Pieces that climb from their start, which is at a distance from the level, in either direction.
    pieces = [(z, 0.0 * along[:, z], length[:, z], 1.0) for z in first]
    pieces += [(z, -along[:, z], length[:, z] + along[:, z], 1.0) for z in middle]
    pieces += [(z, -along[:, z], -along[:, z], -1.0) for z in middle]
    pieces += [(z, length[:, z], length[:, z], -1.0) for z in last]
    x, share = gauss_legendre(resolution.path_nodes)
    nodes = []
    for z, start, extent, sign in pieces:
        lowest = _after(radius, cosine[:, z], start)
        slope = np.maximum((along[:, z] + start) * sign, 0.0)
        climb = CLIMB * resolution.near * (2.0 * lowest + CLIMB * resolution.near)
        scale = (climb / (np.sqrt(slope**2 + climb) + slope))[:, None]
        span = np.log1p(extent[:, None] / scale)
        distance = start[:, None] + sign * scale * np.expm1(span * x)
        there = _after(radius[:, None], cosine[:, z, None], distance)
        step = scale * span * np.exp(span * x) * share
        nodes.append((there - EARTH_RADIUS, (along[:, z, None] + distance) / there, distance, step))
    end = np.where(meets, EARTH_RADIUS, EARTH_RADIUS + TOP_OF_AIR)
    place = np.repeat([z for z, *_ in pieces], resolution.path_nodes)
    heights, cosines, distances, steps = (np.concatenate(part, axis=1) for part in zip(*nodes, strict=True))
    return Rays(
        level=height,
        zenith_cosine=cosine,
        solid_angle=2.0 * np.pi * weight,
        grounded=resolution.zeniths[2],
        height=heights,
        cosine=cosines,
        distance=distances,
        step=steps,
        between=cubic_weights(height_coordinate(heights, resolution), resolution.levels),
        ray=place,
        length=length,
        end_height=end - EARTH_RADIUS,
        end_cosine=(along + length) / end,
    )


def _ends(counts):
    ends = np.concatenate([[0], np.cumsum(counts)]).tolist()
    return list(zip(ends[:-1], ends[1:], strict=True))


def _after(radius, cosine, distance):
    return np.sqrt(radius**2 + distance * (2.0 * radius * cosine + distance))
