"""Columns along straight rays through a flat or a spherical atmosphere, normalised to the vertical column."""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..atmosphere import AbstractProfile, Exponential, Layered, Levels, OzoneLayer
from ..numerics import gauss_legendre, hat_weights, polynomial, safe_sqrt
from .contract import Geometry


# Mean radius of the Earth, m.
EARTH_RADIUS = 6371e3
# Height (m) above which nothing scatters; 4e-6 of a column with scale height 8 km lie above.
TOP_OF_AIR = 100e3
# Least cosine of a zenith angle in flat geometry, which has no horizon; smaller ones are taken as this.
MIN_COSINE = 1e-4
_COLUMN_NODES = 16
# Multiply-adds of a column along a curved ray: two polynomials, of degrees 10 and 6.
COLUMN_TERMS = 17
# Quadrature points per layer in which density changes exponentially.
_LAYER_NODES = 3


def exponential_nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    r"""Nodes y on (0, inf) and weights for integrands that fall about as $e^{-y}$.

    Gauss-Legendre in x with $1 - e^{-y} = x$.

    **Arguments:** `count`, nodes. **Returns:** y and dy weights, `[count]` each.
    """
    x, weight = gauss_legendre(count)
    return -np.log1p(-x), weight / (1.0 - x)


def graded_nodes(length: Float[Array, "*shape"], count: int) -> tuple[Float[Array, "*shape node"], ...]:
    r"""Nodes y on (0, length) and weights for integrands that fall about as $e^{-y}$, dense toward the start.

    Gauss-Legendre in x with $1 - e^{-y} = x^2 (1 - e^{-length})$; for a short length $y = x^2\, length$.

    **Arguments:** `length`, dimensionless, >= 0; `count`, nodes. **Returns:** y and dy weights.
    """
    axes = tuple(range(length.ndim))
    x, weight = (jnp.expand_dims(jnp.asarray(v, length.dtype), axes) for v in gauss_legendre(count))
    share = -jnp.expm1(-length)[..., None]
    left = x**2 * share
    return -jnp.log1p(-left), 2.0 * weight * x * share / (1.0 - left)


def height_gain(radius, cosine, distance):
    r"""Height (m) gained along a ray, $\sqrt{r^2 + 2 r s \mu + s^2} - r$ without cancellation."""
    square = distance * (2.0 * radius * cosine + distance)
    return square / (jnp.sqrt(radius**2 + square) + radius)


def length_scale(radius, cosine, height):
    """The distance (m) after which a ray that climbs at `cosine` >= 0 has gained `height`."""
    start = radius * cosine
    square = height * (2.0 * radius + height)
    return square / (jnp.sqrt(start**2 + square) + start)


# Coefficients of `_grazing`'s integrals times (1 + 0.4 x), as polynomials in (1 - 0.4 x) / (1 + 0.4 x): least squares
# of the relative error to scipy's erfcx and to quadrature, at most 7e-9 and 9e-5.
_ERFCX = (
    0.747289102, 0.570483355, 0.321816899, 0.121412843, 0.0201053542, -0.00594391372,
    -0.00340407857, 0.000294040855, 0.000470715353, -1.94051036e-05, -5.10730367e-05,
)  # fmt: skip
_CURVATURE = (
    0.665488992, 0.275466489, -0.109482403, -0.187487107, -0.048507171, 0.0443745034,
    0.0248734355,
)  # fmt: skip


def _grazing(x):
    r"""$E = \int_a^\infty e^{a-b} b^{-1/2} db = \sqrt\pi\, erfcx(x)$, with $a = x^2$, and J, its curvature correction.

    $J = \frac34 (x + \frac E2) - \frac a2 E - \frac{a^2}{4} (\frac 2x - 2E)$ cancels for large x, so that polynomials
    give both.
    """
    near = 1.0 / (1.0 + 0.4 * x)
    place = 2.0 * near - 1.0

    return near * polynomial(_ERFCX, place), near * polynomial(_CURVATURE, place)


def chapman_column(scale_height, height, cosine):
    r"""Column of $e^{-h/H}/H$ along a ray that climbs through a sphere, in closed form.

    $e^{-h/H} \sqrt{X/2}\, (E(x) + J(x) / X)$ with $X = (R + h) / H$, $x = \mu \sqrt{X/2}$: the first two terms of
    Chapman's integral in 1/X.

    **Arguments:** `scale_height`, `height` in m, `cosine` of the zenith angle there. **Returns:** dimensionless.
    **Valid:** cosine >= 0; within 1e-5 for scale heights to 30 km, 4e-7 at 8 km.
    **Source:** Chapman 1931, Proc. Phys. Soc. 43, 26; Huestis 2001, JQSRT 69, 709. The second term is derived here:
    $\int e^{-\zeta} (\zeta - \zeta^2 / 4b)\, b^{-1/2} d\zeta$ with $b = a + \zeta$.
    """
    ratio = (EARTH_RADIUS + height) / scale_height
    root = jnp.sqrt(0.5 * ratio)
    first, second = _grazing(root * cosine)
    return jnp.exp(-height / scale_height) * root * (first + second / ratio)


def layered_column(profile: Layered, height, cosine):
    """The column of homogeneous layers along a ray that climbs: exact lengths within each."""
    per_metre = profile.fraction / jnp.sum(profile.fraction) / jnp.diff(profile.edges)
    climb = jnp.expand_dims(profile.edges, range(height.ndim)) - height[..., None]
    above = climb > 0.0
    length = length_scale((EARTH_RADIUS + height)[..., None], cosine[..., None], jnp.where(above, climb, 1.0))
    return jnp.diff(jnp.where(above, length, 0.0), axis=-1) @ per_metre


def levels_column(profile: Levels, height, cosine):
    """The column of a table of densities along a ray that climbs: Gauss-Legendre in the length within each layer."""

    def everywhere(values):
        return jnp.expand_dims(values, range(height.ndim))

    radius, cosine = (EARTH_RADIUS + height)[..., None], cosine[..., None]
    climb = everywhere(profile.height) - height[..., None]
    above = climb > 0.0
    length = jnp.where(above, length_scale(radius, cosine, jnp.where(above, climb, 1.0)), 0.0)
    log, thickness = profile.log_density(), everywhere(jnp.diff(profile.height))
    low, change = everywhere(log[:-1]), everywhere(jnp.diff(log))
    x, weight = gauss_legendre(_LAYER_NODES)
    mean = jnp.zeros_like(climb[..., 1:])
    for fraction, share in zip(x.tolist(), weight.tolist(), strict=True):
        distance = length[..., :-1] + fraction * jnp.diff(length, axis=-1)
        # A layer below the ray's start has no length, and its density must not run away.
        past = jnp.clip((height_gain(radius, cosine, distance) - climb[..., :-1]) / thickness, 0.0, 1.0)
        mean = mean + share * jnp.exp(low + past * change)
    return jnp.sum(mean * jnp.diff(length, axis=-1), axis=-1)


def outward_column(profile: AbstractProfile, height, cosine, geometry: Geometry):
    """As `slant_column`, for a ray that climbs: valid for `cosine` >= 0 only, at half the cost."""
    if geometry == "flat":
        return profile.column_above(height) / jnp.maximum(cosine, MIN_COSINE)
    leaves, tree = jax.tree.flatten(profile)
    if any(leaf.ndim for leaf in leaves):
        return _spherical_column(profile, height, cosine)
    return _column_of(tree, height, cosine, *leaves)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _column_of(tree, height, cosine, *leaves):
    """Column of a profile of scalars; each derivative is computed once, however many tangents there are."""
    return _spherical_column(jax.tree.unflatten(tree, leaves), height, cosine)


def _column_tangent(tree, primals, tangents):
    tangent = jnp.zeros_like(primals[0])
    for i, dot in enumerate(tangents):
        if isinstance(dot, jax.custom_derivatives.SymbolicZero):
            continue

        def along(value, i=i):
            height, cosine, *leaves = (*primals[:i], value, *primals[i + 1 :])
            return _spherical_column(jax.tree.unflatten(tree, leaves), height, cosine)

        _, slope = jax.jvp(along, (primals[i],), (jnp.ones_like(primals[i]),))
        tangent += slope * jnp.broadcast_to(dot, slope.shape)
    return _column_of(tree, *primals), tangent


_column_of.defjvp(_column_tangent, symbolic_zeros=True)


@functools.singledispatch
def _spherical_column(profile: AbstractProfile, height, cosine):
    """Column of a profile along a ray that climbs on a sphere; kinds with a better way than this register below."""
    return _quadrature(profile, height, cosine, exponential_nodes(_COLUMN_NODES), profile.reach())


@_spherical_column.register(Exponential)
def _(profile, height, cosine):
    return chapman_column(profile.scale_height, height, cosine)


@_spherical_column.register(OzoneLayer)
def _(profile, height, cosine):
    # The layer is bounded: integrate without a tail, to the height above which 1e-5 of it are left.
    climb = profile.height + 12.0 * profile.thickness
    return _quadrature(profile, height, cosine, gauss_legendre(_COLUMN_NODES), climb)


_spherical_column.register(Layered, layered_column)
_spherical_column.register(Levels, levels_column)


def _quadrature(profile: AbstractProfile, height, cosine, rule, climb):
    """Column by a rule of nodes and weights in the length over which the ray climbs by `climb`."""
    nodes, weights = rule
    radius = (EARTH_RADIUS + height)[..., None]
    cosine = cosine[..., None]
    scale = length_scale(radius, cosine, climb)
    distance = scale * jnp.expand_dims(jnp.asarray(nodes, height.dtype), range(height.ndim))
    density = profile.density(height[..., None] + height_gain(radius, cosine, distance))
    return (density @ jnp.asarray(weights, height.dtype)) * scale[..., 0]


def slant_column(
    profile: AbstractProfile,
    height: Float[Array, "*shape"],
    cosine: Float[Array, "*shape"],
    geometry: Geometry,
) -> Float[Array, "*shape"]:
    r"""Column along a ray from `height` to space, in units of the vertical column from the ground.

    Flat: $F(h) / \mu$. Spherical: $\int \rho(h(s))\, ds$; a ray that first descends passes its tangent point.

    **Arguments:** `height` (m, >= 0) and `cosine` of the zenith angle there, of the same shape.
    **Returns:** dimensionless, the airmass times the share of the column above.
    **Valid:** every cosine; flat: cosines below 1e-4 are taken as 1e-4; spherical: a ray that would enter the
    ground is continued with its tangent point on the ground (`sunlit` tells which do).
    Exponential profiles are within 1e-5, layers exact, tables of levels within 1e-6 where density changes by at most a
    factor e in a layer (3e-5 for e^2). Ozone of 20 +- 5 km is within 2e-4 at the horizon and 4e-5 above it. Other
    profiles use as many nodes on an exponential scale.
    **Source:** `chapman_column`; quadrature: Klassen 1987, eq. 27, 28 with the exact change of variable (his l(r)
    is linear in r).
    """
    return slant_columns([profile], height, cosine, geometry)[0]


def slant_columns(
    profiles: Sequence[AbstractProfile],
    height: Float[Array, "*shape"],
    cosine: Float[Array, "*shape"],
    geometry: Geometry,
) -> Float[Array, "constituent ..."]:
    """`slant_column` of several profiles."""
    if geometry == "flat":
        return outward_columns(profiles, height, cosine, geometry)
    lowest = jnp.maximum(tangent_height(height, cosine), 0.0)
    # Columns from here and from the lowest point in one call, so that one program is compiled.
    ends = jnp.stack([height, lowest]), jnp.stack([jnp.abs(cosine), jnp.zeros_like(cosine)])
    both = outward_columns(profiles, *ends, geometry)
    outward, through = both[:, 0], 2.0 * both[:, 1] - both[:, 0]
    return jnp.where(cosine[None] >= 0.0, outward, jnp.maximum(through, outward))


def outward_columns(
    profiles: Sequence[AbstractProfile], height, cosine, geometry: Geometry
) -> Float[Array, "constituent ..."]:
    """`outward_column` of several profiles: one program for all profiles of the same kind."""
    if not profiles:
        return jnp.zeros((0, *height.shape), height.dtype)
    kinds: dict = {}
    for place, profile in enumerate(profiles):
        leaves, tree = jax.tree.flatten(profile)
        kinds.setdefault((tree, *(leaf.shape for leaf in leaves)), []).append(place)
    columns, places = [], [place for kind in kinds.values() for place in kind]
    for kind in kinds.values():
        stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(profiles[place] for place in kind))
        columns.append(jax.vmap(lambda profile: outward_column(profile, height, cosine, geometry))(stacked))
    return jnp.concatenate(columns)[np.argsort(places)]


def tangent_height(height, cosine):
    """Height (m) of the point of a ray's line that is nearest to the Earth's centre, negative inside the Earth."""
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
        # Distance from the point nearest to the Earth's centre; r sin(zenith) is constant along the ray.
        square = (EARTH_RADIUS * cosine[None]) ** 2 + level * (2.0 * EARTH_RADIUS + level)
        return jnp.sqrt(jnp.maximum(square, 1.0))

    return (2.0 * EARTH_RADIUS + upper + lower) / (from_tangent(upper) + from_tangent(lower))


class StreamPath(NamedTuple):
    """Paths of streams of fixed local zenith angle through the layers in one direction.

    `airmass` `[layer, stream]`, length in a layer over its thickness; `turn` `[layer, stream, stream]`, weights that
    interpolate the radiance where a ray enters the layer, since its local angle there differs from the one where it
    leaves; None where the angle is constant.
    """

    airmass: Float[Array, "layer stream"]
    turn: Float[Array, "layer stream stream"] | None


def stream_paths(
    height: Float[Array, " level"], cosine: Float[Array, " stream"], geometry: Geometry
) -> tuple[StreamPath, StreamPath]:
    r"""Paths of downward and of upward streams through the layers between levels.

    A straight ray keeps $r \sin\theta$. Downward it is steeper where it enters a layer than where it leaves; upward it
    is steeper where it leaves. An upward ray that would have come from under the layer's tangent point enters
    horizontally.

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
    # Distances from the point of the ray's line that is nearest to the Earth's centre.
    at_lower, at_upper = lower * cosine[None], upper * cosine[None]
    above = jnp.sqrt(at_lower**2 + rise)
    below = safe_sqrt(at_upper**2 - rise)

    def turn(entering):
        # Radiance times cosine is linear in the cosine for thin and for thick layers.
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
