"""Paths of views through the air: their lit parts, quadrature points on them, columns from the eye."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..atmosphere import AbstractProfile
from ..numerics import safe_sqrt
from ..scene import above_horizon, haversine, Scene
from .columns import (
    EARTH_RADIUS,
    graded_nodes,
    height_gain,
    length_scale,
    MIN_COSINE,
    outward_columns,
    tangent_height,
    TOP_OF_AIR,
)
from .contract import Geometry


# Nodes of a curved path are spread over this many times the height over which the scatterers thin out.
_SPREAD = 2.0
# Distance (m) at which no air is left.
_FAR = 1e8
# directions times wavelengths that a solver takes at once: some 2 kB each while it computes
_AT_ONCE = 1 << 19


class Views(NamedTuple):
    """Straight lines from the observer: `height` of the observer (m), cosines of the zenith angles there.

    `aloft` is False for the observer on the ground, whose views all climb; the horizontal one is the lowest.
    `half_angle`, sin^2 of half the angle between view and sun; `entry` (m) to where the view enters the air; `length`
    (m) to where it leaves the air, meets the ground or ends.
    """

    aloft: bool
    height: Float[Array, " direction"]
    cosine: Float[Array, " direction"]
    sun_cosine: Float[Array, ""]
    half_angle: Float[Array, " direction"]
    entry: Float[Array, " direction"]
    length: Float[Array, " direction"]


class Points(NamedTuple):
    """Points on views: `height` (m), cosines of the zenith angles of view and sun there."""

    height: Float[Array, "direction node"]
    view_cosine: Float[Array, "direction node"]
    sun_cosine: Float[Array, "direction node"]


def in_pieces(
    light: Callable[[Scene], Float[Array, "*component direction wavelength"]], scene: Scene
) -> Float[Array, "*component direction wavelength"]:
    """The light of a scene's directions, which are handed over in equal pieces where they are too many for memory.

    What `light` computes for all directions alike is computed for each piece anew. Gradients keep one piece at a time.
    """
    count = scene.view.zenith.shape[0]
    number = -(-count * scene.wavelength_nm.shape[0] // _AT_ONCE)
    if number <= 1:
        return light(scene)
    size = -(-count // number)

    def pieces(values):
        return jnp.pad(values, (0, number * size - count), mode="edge").reshape(number, size)

    @jax.checkpoint
    def one(view):
        return light(eqx.tree_at(lambda s: s.view, scene, view))

    found = jnp.moveaxis(jax.lax.map(one, jax.tree.map(pieces, scene.view)), 0, -3)
    return found.reshape(*found.shape[:-3], number * size, found.shape[-1])[..., :count, :]


def views_of(scene: Scene, geometry: Geometry, distance: Float[Array, " direction"] | None = None) -> Views:
    """The scene's views, each to the ground, to the end of the air or to `distance` (m)."""
    zenith = scene.view.zenith
    cosine = jnp.cos(zenith)
    climbs = above_horizon(zenith)
    half = haversine(zenith, scene.sun_zenith, scene.view.azimuth - scene.sun_azimuth)
    aloft = scene.height is not None
    height = jnp.zeros_like(cosine) if scene.height is None else scene.height + jnp.zeros_like(cosine)
    if geometry == "flat":
        size = jnp.maximum(jnp.abs(cosine), MIN_COSINE)
        cosine = jnp.where(climbs, size, -size)
        entry, length = jnp.zeros_like(size), jnp.where(climbs, _FAR, height / size)
    else:
        if not aloft:
            cosine = jnp.maximum(cosine, 0.0)
        entry, length = _through_air(height, cosine, climbs)
    if distance is not None:
        length = jnp.minimum(length, jnp.clip(distance, 0.0, _FAR))
    return Views(aloft, height, cosine, jnp.cos(scene.sun_zenith), half, jnp.minimum(entry, length), length)


def _through_air(height, cosine, climbs):
    """Distances (m) at which a line enters and leaves the air or meets the ground, equal where it misses the air."""
    along = EARTH_RADIUS * cosine + height * cosine
    under_top = (TOP_OF_AIR - height) * (2.0 * EARTH_RADIUS + TOP_OF_AIR + height)
    above_ground = height * (2.0 * EARTH_RADIUS + height)
    to_top, to_ground = safe_sqrt(along**2 + under_top), safe_sqrt(along**2 - above_ground)
    rising = along >= 0.0
    leave = jnp.where(rising, under_top / jnp.where(rising, along + to_top, 1.0), to_top - along)
    inward = jnp.where(rising, 1.0, to_top - along)
    outside = under_top < 0.0
    misses = outside & (rising | (to_top <= 0.0))
    entry = jnp.where(outside & ~misses, -under_top / inward, 0.0)
    leave = jnp.where(misses, 0.0, leave)
    meets = ~climbs & (along**2 >= above_ground)
    downward = jnp.where(meets, to_ground - along, 1.0)
    return entry, jnp.where(meets, above_ground / jnp.where(downward > 0.0, downward, 1.0), leave)


def _shadow(views: Views):
    """Distances (m) at which each view enters and leaves the Earth's shadow; both are the view's end if it stays lit.

    The shadow is the half cylinder behind the Earth. Its edges are the roots of a quadratic in the distance, computed
    without cancellation.
    """
    radius = EARTH_RADIUS + views.height
    to_sun = 1.0 - 2.0 * views.half_angle
    across_square = jnp.maximum(4.0 * views.half_angle * (1.0 - views.half_angle), 1e-12)
    outside = tangent_height(views.height, views.sun_cosine + jnp.zeros_like(radius))
    outside = outside * (2.0 * EARTH_RADIUS + outside)
    middle = radius * (views.cosine - views.sun_cosine * to_sun)
    square = middle**2 - across_square * outside
    root = safe_sqrt(square)
    leaving = middle > 0.0
    sum_ = jnp.where(leaving, middle + root, root - middle)
    # roots: (-middle -+ root) / across_square, their product outside / across_square
    one, other = sum_ / across_square, outside / jnp.where(sum_ > 0.0, sum_, 1.0)
    near, far = jnp.where(leaving, -one, other), jnp.where(leaving, -other, one)
    dark = (square > 0.0) & (far > 0.0) & (radius * views.sun_cosine + jnp.maximum(near, 0.0) * to_sun < 0.0)
    ends = jnp.where(dark, near, _FAR), jnp.where(dark, far, _FAR)
    return tuple(jnp.clip(v, views.entry, views.length) for v in ends)


def lit_points(
    views: Views, reach: Float[Array, ""], edges: Float[Array, " edge"], nodes: int, geometry: Geometry
) -> tuple[Points, Float[Array, "direction node"]]:
    """Quadrature points on the lit parts of each view and the weights of their steps, m.

    Each part ends at the entry into the air, the lowest point of the view, the shadow's edges, a height where the
    density jumps or the view's end. Its nodes crowd toward its lower end, as the air does.

    **Arguments:** `reach` (m), the height over which the scatterers thin out; `edges`, heights (m, increasing) of
    jumps; `nodes` per part. The observer on the ground has one part, one aloft three, times the number of edges plus
    one.
    """
    if geometry == "flat":
        return _flat_points(views, reach, edges, nodes)
    into_dark, from_dark = _shadow(views)
    if not views.aloft:
        # A view from the ground begins in the shadow or never enters it.
        pieces = [(jnp.where(into_dark <= views.entry, from_dark, views.entry), views.length)]
    else:
        radius = EARTH_RADIUS + views.height
        lowest = jnp.clip(-radius * views.cosine, views.entry, views.length)
        # Between the two outer parts lies a third, on the side of the lowest point without shadow.
        before, after = jnp.minimum(into_dark, lowest), jnp.maximum(from_dark, lowest)
        third = jnp.where(into_dark > lowest, into_dark, jnp.minimum(from_dark, lowest))
        pieces = [(before, views.entry), (lowest, third), (after, views.length)]
    low, far = (jnp.stack(v, axis=1) for v in zip(*pieces, strict=True))
    start = points_at(views, low)
    if edges.shape[0]:
        low, far = _cut(low, far, start, edges)
        start = points_at(views, low)
    scale = length_scale(EARTH_RADIUS + start.height, jnp.abs(start.view_cosine), _SPREAD * reach)
    away = far - low
    y, weight = graded_nodes(jnp.abs(away) / scale, nodes)
    distance = low[..., None] + jnp.where(away < 0.0, -scale, scale)[..., None] * y
    flat = (low.shape[0], -1)
    return points_at(views, distance.reshape(flat)), (scale[..., None] * weight).reshape(flat)


def _cut(low, far, start: Points, edges):
    """Parts that climb from `low` to `far`, cut at the heights of the edges."""
    climb = edges[None, None] - start.height[..., None]
    above = climb > 0.0
    radius, cosine = (EARTH_RADIUS + start.height)[..., None], jnp.abs(start.view_cosine)[..., None]
    length = jnp.abs(far - low)[..., None]
    along = jnp.where(above, length_scale(radius, cosine, jnp.where(above, climb, 1.0)), 0.0)
    along = jnp.concatenate([0.0 * length, jnp.minimum(along, length), length], axis=-1)
    place = low[..., None] + jnp.where(far < low, -1.0, 1.0)[..., None] * along
    flat = (low.shape[0], -1)
    return place[..., :-1].reshape(flat), place[..., 1:].reshape(flat)


def _flat_points(views: Views, reach, edges, nodes):
    """Points placed by height: dense toward the observer for views up, toward the ground for views down."""
    climb = jnp.abs(views.length * views.cosine)[:, None]
    low = jnp.where(views.cosine > 0.0, views.height, jnp.maximum(views.height + views.length * views.cosine, 0.0))
    # Heights above the lower end, which keep the digits of short paths.
    inside = jnp.clip(edges[None] - low[:, None], 0.0, climb)
    place = jnp.concatenate([0.0 * climb, inside, climb], axis=1)
    # The density is constant within layers.
    scale = reach * (_SPREAD if edges.shape[0] else 1.0)
    y, weight = graded_nodes(jnp.diff(place, axis=1) / scale, nodes)
    height = low[:, None] + (place[:, :-1, None] + scale * y).reshape(place.shape[0], -1)
    cosine, sun = views.cosine[:, None] + jnp.zeros_like(height), views.sun_cosine + jnp.zeros_like(height)
    step = jnp.where(sun > 0.0, scale / jnp.abs(cosine) * weight.reshape(height.shape), 0.0)
    return Points(height, cosine, sun), step


def points_at(views: Views, distance: Float[Array, "direction node"]) -> Points:
    """Points at distances (m) on views in spherical geometry."""
    radius, cosine = (EARTH_RADIUS + views.height)[:, None], views.cosine[:, None]
    height = views.height[:, None] + height_gain(radius, cosine, distance)
    to_sun = (1.0 - 2.0 * views.half_angle)[:, None]
    here = EARTH_RADIUS + height
    return Points(height, (radius * cosine + distance) / here, (radius * views.sun_cosine + distance * to_sun) / here)


def end_points(views: Views, geometry: Geometry) -> Points:
    """Points at the ends of the views."""
    if geometry == "spherical":
        return points_at(views, views.length[:, None])
    height = jnp.maximum(views.height + views.length * views.cosine, 0.0)[:, None]
    return Points(height, views.cosine[:, None], views.sun_cosine + jnp.zeros_like(height))


def eye_columns(
    profiles: Sequence[AbstractProfile], views: Views, points: Points, geometry: Geometry
) -> Float[Array, "constituent direction node"]:
    """Columns between the eye and points on its views, in units of the vertical column from the ground."""
    lowest = jnp.maximum(tangent_height(views.height, views.cosine), 0.0)
    height = jnp.concatenate([views.height[:, None], lowest[:, None], points.height], axis=1)
    cosine = jnp.concatenate([views.cosine[:, None], jnp.zeros_like(lowest)[:, None], points.view_cosine], axis=1)
    outward = outward_columns(profiles, height, jnp.abs(cosine), geometry)
    here, from_lowest, there = outward[..., :1], outward[..., 1:2], outward[..., 2:]
    climbed = here - there
    if not views.aloft:
        return jnp.maximum(climbed, 0.0)
    descends = points.view_cosine[None] < 0.0
    column = jnp.where(descends, -climbed, climbed)
    if geometry == "spherical":
        # The column down to the lowest point and up again.
        through = 2.0 * from_lowest - here - there
        column = jnp.where((views.cosine[None, :, None] < 0.0) & ~descends, through, column)
    return jnp.maximum(column, 0.0)
