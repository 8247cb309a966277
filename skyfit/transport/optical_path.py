"""Columns along straight rays through a flat or a spherical atmosphere, normalised to the vertical column."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..atmosphere import AbstractProfile
from ..numerics import gauss_legendre, hat_weights, safe_sqrt
from .solver import Geometry


# m, mean radius of the Earth
EARTH_RADIUS = 6371e3
# a flat atmosphere has no horizon: cosines below this are taken as this
MIN_COSINE = 1e-4
_COLUMN_NODES = 16


def exponential_nodes(count: int, grading: int = 1) -> tuple[np.ndarray, np.ndarray]:
    r"""Nodes y on (0, inf) and weights for integrands that fall about as $e^{-y}$.

    Gauss-Legendre in x with $1 - e^{-y} = x^{grading}$; a grading of 2 crowds the nodes toward the start.

    **Arguments:** `count`, nodes; `grading`, 1 or 2. **Returns:** y and dy weights, `[count]` each.
    """
    x, weight = gauss_legendre(count)
    share = x**grading
    return -np.log1p(-share), weight * grading * x ** (grading - 1) / (1.0 - share)


def height_gain(radius, cosine, distance):
    r"""Height gained along a ray, $\sqrt{r^2 + 2 r s \mu + s^2} - r$ without cancellation, m."""
    square = distance * (2.0 * radius * cosine + distance)
    return square / (jnp.sqrt(radius**2 + square) + radius)


def length_scale(radius, cosine, height):
    """The distance (m) after which a ray that climbs at `cosine` >= 0 has gained `height`."""
    start = radius * cosine
    square = height * (2.0 * radius + height)
    return square / (jnp.sqrt(start**2 + square) + start)


def outward_column(profile: AbstractProfile, height, cosine, geometry: Geometry):
    """As `slant_column` for a ray that climbs: valid for `cosine` >= 0 only, at half its cost."""
    if geometry == "flat":
        return profile.above(height) / jnp.maximum(cosine, MIN_COSINE)
    nodes, weights = exponential_nodes(_COLUMN_NODES)
    radius = (EARTH_RADIUS + height)[..., None]
    cosine = cosine[..., None]
    scale = length_scale(radius, cosine, profile.reach())
    axes = tuple(range(height.ndim))
    distance = scale * jnp.expand_dims(jnp.asarray(nodes, height.dtype), axes)
    density = profile.density(height[..., None] + height_gain(radius, cosine, distance))
    return (density @ jnp.asarray(weights, height.dtype)) * scale[..., 0]


def slant_column(
    profile: AbstractProfile,
    height: Float[Array, "*shape"],
    cosine: Float[Array, "*shape"],
    geometry: Geometry,
) -> Float[Array, "*shape"]:
    r"""The column along a ray from `height` to space, in units of the vertical column from the ground.

    Flat: $F(h) / \mu$. Spherical: $\int \rho(h(s))\, ds$; a ray that first descends passes its tangent point.

    **Arguments:** `height` (m, >= 0) and `cosine` of the zenith angle there, one shape.
    **Returns:** dimensionless, the airmass times the share of the column above.
    **Valid:** every cosine; flat: cosines below 1e-4 are taken as 1e-4; spherical: a ray that would enter the
    ground is continued with its tangent point on the ground (`sunlit` says which do).
    **Source:** Klassen 1987, eq. 27, 28 with the exact change of variable (his l(r) is linear in r).
    """
    if geometry == "flat":
        return outward_column(profile, height, cosine, geometry)
    outward = outward_column(profile, height, jnp.abs(cosine), geometry)
    lowest = jnp.maximum(tangent_height(height, cosine), 0.0)
    through = 2.0 * outward_column(profile, lowest, jnp.zeros_like(lowest), geometry) - outward
    return jnp.where(cosine >= 0.0, outward, jnp.maximum(through, outward))


def above_horizon(zenith: Float[Array, " direction"]) -> Bool[Array, " direction"]:
    """Whether a view meets the sky; the horizontal one does, whatever the rounding of pi / 2."""
    return jnp.cos(zenith) > -1e-6


def tangent_height(height, cosine):
    """Height of the point of a ray's line that is nearest to the Earth's centre, m, negative inside."""
    sine = safe_sqrt(1.0 - cosine**2)
    return height - (EARTH_RADIUS + height) * cosine**2 / (1.0 + sine)


def layer_airmass(
    height: Float[Array, " level"], cosine: Float[Array, " direction"], geometry: Geometry
) -> Float[Array, "layer direction"]:
    r"""Length of a ray from the ground within each layer over the layer's thickness.

    **Arguments:** `height` of the levels, top to ground (m); `cosine` of the view zenith angle at the ground.
    **Returns:** dimensionless, $1/\mu$ when flat. **Valid:** cosine >= 0 (flat: >= 1e-4).
    """
    if geometry == "flat":
        airmass = 1.0 / jnp.maximum(cosine, MIN_COSINE)
        return jnp.broadcast_to(airmass[None], (height.shape[0] - 1, cosine.shape[0]))
    upper, lower = height[:-1, None], height[1:, None]

    def from_tangent(level):
        # distance from the point nearest to the Earth's centre; r sin(zenith) stays along the ray
        square = (EARTH_RADIUS * cosine[None]) ** 2 + level * (2.0 * EARTH_RADIUS + level)
        return jnp.sqrt(jnp.maximum(square, 1.0))

    return (2.0 * EARTH_RADIUS + upper + lower) / (from_tangent(upper) + from_tangent(lower))


class StreamPath(NamedTuple):
    """How streams of fixed local zenith angle cross the layers one way.

    `airmass` `[layer, stream]`, length in a layer over its thickness; `turn` `[layer, stream, stream]`, weights
    that interpolate the radiance where a ray enters the layer, at another local angle than it leaves it with;
    None where the angle stays.
    """

    airmass: Float[Array, "layer stream"]
    turn: Float[Array, "layer stream stream"] | None


def stream_paths(
    height: Float[Array, " level"], cosine: Float[Array, " stream"], geometry: Geometry
) -> tuple[StreamPath, StreamPath]:
    r"""Paths of downward and of upward streams through the layers between levels.

    A straight ray keeps $r \sin\theta$: it comes down into a layer steeper than it leaves it, and goes up the
    other way round. An upward ray that would have come from under the layer's tangent point enters horizontally.

    **Arguments:** `height` of the levels, top to ground (m); `cosine` of the streams where they leave a layer,
    increasing. **Returns:** down, up. **Source:** geometry; Klassen 1987, eq. 20 with the local elevation.
    """
    layers = height.shape[0] - 1
    if geometry == "flat":
        airmass = jnp.broadcast_to(1.0 / cosine[None], (layers, cosine.shape[0]))
        return StreamPath(airmass, None), StreamPath(airmass, None)
    upper, lower = EARTH_RADIUS + height[:-1, None], EARTH_RADIUS + height[1:, None]
    thickness = upper - lower
    rise = thickness * (upper + lower)
    # distances from the point of the ray's line that is nearest to the Earth's centre
    at_lower, at_upper = lower * cosine[None], upper * cosine[None]
    above = jnp.sqrt(at_lower**2 + rise)
    below = safe_sqrt(at_upper**2 - rise)

    def turn(entering):
        # radiance times cosine is linear in the cosine for thin and for thick layers alike
        inside = jnp.clip(entering, cosine[0], cosine[-1])
        return hat_weights(inside, cosine) * cosine[None, None] / inside[:, :, None]

    down = StreamPath(rise / (above + at_lower) / thickness, turn(above / upper))
    up = StreamPath((at_upper - below) / thickness, turn(below / lower))
    return down, up


def sunlit(height: Float[Array, "*shape"], cosine: Float[Array, "*shape"], geometry: Geometry) -> Bool[Array, "*shape"]:
    """Whether the ray from `height` toward the sun at `cosine` misses the ground."""
    if geometry == "flat":
        return cosine > 0.0
    return (cosine >= 0.0) | (tangent_height(height, cosine) > 0.0)
