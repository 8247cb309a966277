r"""The paper's table coordinates: $u_r, u_\mu, u_{\mu_s}, u_\nu$ of a point, a view and a sun, and their inverses.

Heights replace radii, $r = R + h$, and distances are computed without cancellation, so that float32 suffices. The
paper's air is 60 km deep; here it is 100 km deep, as for the other solvers.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...numerics import safe_sqrt
from ..columns import EARTH_RADIUS, TOP_OF_AIR


# Rate at which the nodes of the sun's cosine thin out away from the lowest sun: sec. 4, Parameterization.
_CROWDING = 3.0
# Distance (m) from the ground's horizon to the top of the air, $H = \sqrt{R_t^2 - R_g^2}$.
HORIZON_TO_TOP = float(np.sqrt(TOP_OF_AIR * (2.0 * EARTH_RADIUS + TOP_OF_AIR)))
# Least distance (m) in a denominator.
_SHORTEST = 1.0
# Least length (m) of a view to the ground. A view straight down from the ground has none; with this one it still
# differs from a level view.
_NOTHING = 1e-9


class Sizes(NamedTuple):
    r"""Numbers of nodes of the tables: T by r and mu, E by r and mu_s, S by r, mu, mu_s and nu; all static.

    `lowest_sun`, the cosine of the sun's zenith angle where the tables end, -0.2 in the paper; `rescaled`, whether the
    nodes of views are spread over the lengths that views can have, from straight up or down on.
    """

    transmittance: tuple[int, int]
    irradiance: tuple[int, int]
    scattering: tuple[int, int, int, int]
    lowest_sun: float
    rescaled: bool = False


def to_horizon(height: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    r"""The distance to the horizon, $\rho = \sqrt{r^2 - R_g^2}$, m."""
    return safe_sqrt(height * (2.0 * EARTH_RADIUS + height))


def meets_ground(height: Float[Array, "*shape"], cosine: Float[Array, "*shape"]) -> Bool[Array, "*shape"]:
    """Whether a view from `height` (m) at `cosine` of the zenith angle ends on the ground."""
    along = (EARTH_RADIUS + height) * cosine
    return (cosine < 0.0) & (along**2 >= height * (2.0 * EARTH_RADIUS + height))


def distance_to_end(
    height: Float[Array, "*shape"], cosine: Float[Array, "*shape"], ground: Bool[Array, "*shape"]
) -> Float[Array, "*shape"]:
    r"""The distance $d_o$ to the ground where `ground` says that a view meets it, else to the top of the air, m."""
    along = (EARTH_RADIUS + height) * cosine
    horizon = height * (2.0 * EARTH_RADIUS + height)
    to_top = (TOP_OF_AIR - height) * (2.0 * EARTH_RADIUS + TOP_OF_AIR + height)
    up, down = safe_sqrt(along**2 + to_top), safe_sqrt(along**2 - horizon)
    rising = along > 0.0
    sky = jnp.where(rising, to_top / jnp.where(rising, along + up, 1.0), up - along)
    return jnp.where(ground, horizon / jnp.maximum(down - along, _SHORTEST), sky)


def unit_height(height: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    r"""$u_r = \rho / H$."""
    return jnp.clip(to_horizon(height) / HORIZON_TO_TOP, 0.0, 1.0)


def _lengths(height, ground, rescaled: bool):
    """Lengths (m) of views from a height at the two ends of their half of the table."""
    horizon = to_horizon(height)
    longest = jnp.where(ground, horizon, horizon + HORIZON_TO_TOP)
    return jnp.where(ground, height, TOP_OF_AIR - height) if rescaled else jnp.zeros_like(longest), longest


def unit_view(
    height: Float[Array, "*shape"], cosine: Float[Array, "*shape"], ground: Bool[Array, "*shape"], rescaled: bool
) -> Float[Array, "*shape"]:
    r"""$u_\mu = \frac12 - \frac{d_o}{2 \rho}$ of a view to the ground, $\frac12 + \frac{d_o}{2 (\rho + H)}$ of others.

    It jumps at the horizon, from 0 to 1, as the length of the view does. The paper writes the distances out; its second
    line reads $\frac12 - (r\mu - \sqrt{\Delta + H^2}) / (2\rho + 2H)$. No view is shorter than the one straight up or
    down. The paper's nodes for shorter ones repeat that view, and at the zenith the table is 4 % off. With `rescaled`
    d_o and the greatest length count from there, as in Bruneton's code of 2017.
    """
    shortest, longest = _lengths(height, ground, rescaled)
    share = (distance_to_end(height, cosine, ground) - shortest) / jnp.maximum(longest - shortest, _SHORTEST)
    half = 0.5 * jnp.clip(share, 0.0, 1.0)
    return jnp.where(ground, 0.5 - half, 0.5 + half)


def unit_sun(cosine: Float[Array, "*shape"], lowest_sun: float) -> Float[Array, "*shape"]:
    r"""$u_{\mu_s} = (1 - e^{-3\mu_s - 0.6}) / (1 - e^{-3.6})$, with 0.6 = -3 x `lowest_sun`; 0 for lower suns."""
    whole = -np.expm1(-_CROWDING * (1.0 - lowest_sun))
    return jnp.clip(-jnp.expm1(-_CROWDING * (cosine - lowest_sun)) / whole, 0.0, 1.0)


def unit_angle(cosine: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    r"""$u_\nu = (1 + \nu) / 2$ of the cosine of the angle between view and sun."""
    return 0.5 + 0.5 * cosine


def height_of(unit: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """The inverse of `unit_height`, m."""
    square = (unit * HORIZON_TO_TOP) ** 2
    return square / (jnp.sqrt(square + EARTH_RADIUS**2) + EARTH_RADIUS)


def length_of(
    unit: Float[Array, "*shape"], height: Float[Array, "*shape"], ground: Bool[Array, "*shape"], rescaled: bool
) -> Float[Array, "*shape"]:
    """Length $d_o$ (m) of the view at `unit`, no shorter than the one straight up or down."""
    shortest, longest = _lengths(height, ground, rescaled)
    # On the ground the distance to the horizon is 0: views down are level except for the one straight down.
    longest = jnp.maximum(longest, _SHORTEST)
    distance = shortest + jnp.where(ground, 1.0 - 2.0 * unit, 2.0 * unit - 1.0) * (longest - shortest)
    up = jnp.maximum(distance, jnp.maximum(TOP_OF_AIR - height, _SHORTEST))
    return jnp.where(ground, jnp.maximum(jnp.clip(distance, height, longest), _NOTHING), up)


def view_of(
    unit: Float[Array, "*shape"], height: Float[Array, "*shape"], ground: Bool[Array, "*shape"], rescaled: bool
) -> Float[Array, "*shape"]:
    """The inverse of `unit_view`: the cosine of the view's zenith angle at `height`."""
    length, radius = length_of(unit, height, ground, rescaled), EARTH_RADIUS + height
    above = (TOP_OF_AIR - height) * (2.0 * EARTH_RADIUS + TOP_OF_AIR + height)
    below = jnp.maximum(to_horizon(height), _SHORTEST) ** 2
    return jnp.clip(jnp.where(ground, -below - length**2, above - length**2) / (2.0 * radius * length), -1.0, 1.0)


def sun_of(unit: Float[Array, "*shape"], lowest_sun: float) -> Float[Array, "*shape"]:
    """The inverse of `unit_sun`."""
    whole = -np.expm1(-_CROWDING * (1.0 - lowest_sun))
    return jnp.clip(lowest_sun - jnp.log1p(-unit * whole) / _CROWDING, -1.0, 1.0)


def view_position(unit: Float[Array, "*shape"], ground: Bool[Array, "*shape"], count: int) -> Float[Array, "*shape"]:
    """Position of a view among `count` nodes, from 0: half of them are on each side of the jump, none across it."""
    half = count // 2
    return jnp.where(ground, 2.0 * unit * (half - 1), half + (2.0 * unit - 1.0) * (half - 1))


def view_nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Units of `count` nodes of views, those to the ground first, and which views meet the ground."""
    share = 0.5 * np.linspace(0.0, 1.0, count // 2)
    return np.concatenate([share, 0.5 + share]), np.arange(count) < count // 2
