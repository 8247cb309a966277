"""Interpolation of the tables, linear in every coordinate, as a graphics processor reads a texture."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .parameterisation import meets_ground, Sizes, unit_angle, unit_height, unit_sun, unit_view, view_position


class Rays(NamedTuple):
    """Points in the air and views from them: `height` (m) and cosines of zenith angles, all of one shape.

    `angle`, the cosine of the angle between view and sun; `ground`, whether the view meets the ground. This is a
    property of the whole ray, which must not be decided again at its points.
    """

    height: Float[Array, "*shape"]
    cosine: Float[Array, "*shape"]
    sun_cosine: Float[Array, "*shape"]
    angle: Float[Array, "*shape"]
    ground: Bool[Array, "*shape"]


def interpolate(
    table: Float[Array, "*axes value"], positions: Sequence[Float[Array, "*shape"]]
) -> Float[Array, "*shape value"]:
    """Linear interpolation along every axis but the last.

    **Arguments:** `positions`, one for each axis, in nodes from 0. **Returns:** the values there; positions beyond the
    ends have the end's value.
    """
    counts = table.shape[:-1]
    rows = table.reshape(-1, table.shape[-1])
    low = [jnp.clip(jnp.floor(p), 0.0, n - 2.0) for p, n in zip(positions, counts, strict=True)]
    past = [jnp.clip(p - at, 0.0, 1.0) for p, at in zip(positions, low, strict=True)]
    low = [at.astype(jnp.int32) for at in low]
    total = jnp.zeros((*positions[0].shape, table.shape[-1]), table.dtype)
    for corner in itertools.product((0, 1), repeat=len(counts)):
        index, weight = jnp.zeros_like(low[0]), jnp.ones_like(past[0])
        for step, at, share, count in zip(corner, low, past, counts, strict=True):
            index = index * count + at + step
            weight = weight * (share if step else 1.0 - share)
        total = total + weight[..., None] * rows.at[index].get(mode="clip")
    return total


def optical_depth(
    table: Float[Array, "height view wavelength"],
    height: Float[Array, "*shape"],
    cosine: Float[Array, "*shape"],
    ground: Bool[Array, "*shape"],
    sizes: Sizes,
) -> Float[Array, "*shape wavelength"]:
    """Optical depth from points to the end of their views, from the transmittance table."""
    rows, columns = sizes.transmittance
    view = view_position(unit_view(height, cosine, ground, sizes.rescaled), ground, columns)
    return interpolate(table, ((rows - 1) * unit_height(height), view))


def sunlight(
    table: Float[Array, "height view wavelength"],
    height: Float[Array, "*shape"],
    sun_cosine: Float[Array, "*shape"],
    sizes: Sizes,
) -> Float[Array, "*shape wavelength"]:
    """Transmittance of the sun's beam to points, 0 where the ground hides the sun."""
    dark = meets_ground(height, sun_cosine)
    lit = jnp.exp(-optical_depth(table, height, sun_cosine, jnp.zeros_like(dark), sizes))
    return jnp.where(dark[..., None], 0.0, lit)


def irradiance(
    table: Float[Array, "height sun wavelength"],
    height: Float[Array, "*shape"],
    sun_cosine: Float[Array, "*shape"],
    sizes: Sizes,
) -> Float[Array, "*shape wavelength"]:
    """Irradiance on a level plane, from the table E."""
    rows, columns = sizes.irradiance
    sun = (columns - 1) * unit_sun(sun_cosine, sizes.lowest_sun)
    return interpolate(table, ((rows - 1) * unit_height(height), sun))


def scattered(
    table: Float[Array, "height view sun angle value"], rays: Rays, sizes: Sizes
) -> Float[Array, "*shape value"]:
    """Values for rays from a table over the four coordinates, such as S."""
    heights, views, suns, angles = sizes.scattering
    position = (
        (heights - 1) * unit_height(rays.height),
        view_position(unit_view(rays.height, rays.cosine, rays.ground, sizes.rescaled), rays.ground, views),
        (suns - 1) * unit_sun(rays.sun_cosine, sizes.lowest_sun),
        (angles - 1) * unit_angle(rays.angle),
    )
    return interpolate(table, position)
