"""From one order of scattering to the next: light is carried along curved paths to every level, under every sun."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...atmosphere import Atmosphere
from ...numerics import as_float, cubic_weights, safe_sqrt, solve_upper, triangle
from ..columns import EARTH_RADIUS
from . import harmonics as sun_harmonics
from .first import FEW_AZIMUTHS, first_order, spread_azimuths
from .grid import dusk, half_turn, Rays, rays_of, Resolution, sun_at, sun_weights
from .medium import Medium, medium_of, ray_weights, RayWeights


# Orders after the last one fall like it. Limits of the largest ratio between two of them.
_SLOWEST = 0.95, 0.999
_NO_LIGHT = 1e-15
# Damping of the combination of orders, in units of rounding, for changes between orders that hardly differ.
_GUARD = 100.0
# Levels and suns of the table that views read linearly, per level and sun of the cubic table. It is within some 1e-4 of
# the cubics, and its kinks make no step of the light in a series of suns.
FINER_LEVELS, FINER_SUNS = 4, 12


class Solution(NamedTuple):
    """The diffuse light of all orders per unit solar irradiance, divided by `dusk` of the sun.

    `moments` of the radiance; `ground`, diffuse irradiance on level ground; `fine`, the moments that travel, at
    `FINER_LEVELS` and `FINER_SUNS` times as many levels and suns, which views read linearly; `left_over`, the share of
    the mean light that belongs to orders which were not solved.
    """

    moments: Float[Array, "level sun harmonic wavelength"]
    ground: Float[Array, "sun wavelength"]
    fine: Float[Array, "finelevel finesun travelling wavelength"]
    left_over: Float[Array, " wavelength"]


class Order(NamedTuple):
    """The light of one order, in the same form as in `Solution`."""

    moments: Float[Array, "level sun harmonic wavelength"]
    ground: Float[Array, "sun wavelength"]


class Carrier(NamedTuple):
    """Weights that carry light from level to level; all but `rays` depend on geometry alone.

    Azimuths and suns are one axis, `here`. `views`, the harmonics of the rays of a level; `basis`, those that travel,
    at the nodes; `suns`, weights of suns at the nodes, times `dusk` there; `ground`, the same where rays meet the
    ground; `between`, weights of levels at the nodes.
    """

    views: Float[Array, "sun harmonic level zenith azimuth"]
    basis: Float[Array, "level node here harmonic"]
    suns: Float[Array, "level node here sun"]
    ground: Float[Array, "level grounded here sun"]
    between: Float[Array, "level node other"]
    rays: RayWeights


def solve(
    atmosphere: Atmosphere,
    wavelength_nm: Float[Array, " wavelength"],
    sun_place: Float[Array, " sun"],
    resolution: Resolution,
) -> Solution:
    """Solve all orders of scattering at all levels under some suns of `sun_coordinate` `sun_place`, one apart."""
    orders = orders_of(atmosphere, wavelength_nm, sun_place, resolution)
    total, rest = _combined(orders)
    more = _closure(orders)
    more = Order(more[:, :, None] * rest.moments, more[0] * rest.ground)
    left_over = safe_sqrt(_squares(more.moments[:, :, 0]) / (_squares(total.moments[:, :, 0]) + _NO_LIGHT**2))
    return tabled(jax.tree.map(jnp.add, total, more), left_over)


def orders_of(
    atmosphere: Atmosphere,
    wavelength_nm: Float[Array, " wavelength"],
    sun_place: Float[Array, " sun"],
    resolution: Resolution,
) -> Order:
    """The light of each order, `[order, ...]`."""
    rays = rays_of(resolution)
    medium = medium_of(atmosphere, wavelength_nm, resolution.moments)
    names = sun_harmonics.kept(resolution.moments, bool(medium.peaks))
    if not medium.scattering.shape[0]:
        suns = *sun_place.shape, *wavelength_nm.shape
        shape = resolution.orders, resolution.levels, suns[0], len(names), suns[1]
        return Order(jnp.zeros(shape), jnp.zeros((resolution.orders, *suns)))
    azimuths = resolution.moments + 1 if medium.peaks else FEW_AZIMUTHS
    azimuth = half_turn(azimuths)
    weights = ray_weights(atmosphere, medium, rays)
    sun = sun_at(sun_place, resolution.sun_step)
    carrier = _carrier(rays, names, azimuth, sun_place, sun, resolution, weights)
    solid_angle = as_float(rays.solid_angle / azimuths)
    first = first_order(atmosphere, medium, rays, azimuth, sun, weights.passed, resolution.first_nodes)
    scale = 1.0 / dusk(sun)

    def moments(light) -> Order:
        """Harmonics of `light` `[sun, level, zenith, azimuth, wavelength]`, and its irradiance on the ground."""
        weighted = light * solid_angle[None, :, :, None, None] * scale[:, None, None, None, None]
        found = jnp.einsum("shlza,slzaw->lshw", carrier.views, weighted)
        down = as_float(np.maximum(rays.zenith_cosine[0], 0.0))
        return Order(found, jnp.einsum("z,szaw->sw", down, weighted[:, 0]))

    def step(last, _):
        now = moments(_carried(last, carrier, medium, rays, names, dusk(sun), azimuth))
        return now, now

    start = moments(first)
    _, later = jax.lax.scan(jax.checkpoint(step), start, length=resolution.orders - 1)
    return jax.tree.map(lambda one, more: jnp.concatenate([one[None], more]), start, later)


def _squares(light: Float[Array, "*axes wavelength"]) -> Float[Array, " wavelength"]:
    return jnp.sum(light**2, axis=tuple(range(light.ndim - 1)))


def _combined(orders: Order) -> tuple[Order, Order]:
    r"""The combination of sums of orders that is nearest to the sum of all, and the last order that is in it.

    With the orders $o_j$, `[order, ...]`, and their sums $s_j$ it is $\sum_j \gamma_j s_{j+1}$. Each wavelength has its
    own $\gamma$ such that $\sum_j \gamma_j = 1$ and $|\sum_j \gamma_j o_{j+1}|$ is least, as in GMRES.
    **Source:** reduced rank extrapolation, Sidi 2017, Vector Extrapolation Methods with Applications, ch. 2.
    """
    flat = [o.reshape(o.shape[0], -1, o.shape[-1]) for o in (orders.moments[1:, :, :, 0], orders.ground[1:])]
    off = jnp.concatenate(flat, axis=1).T
    found = jax.vmap(_nearest)(off[..., -1:] - off[..., :-1], off[..., -1]).T
    share = jnp.concatenate([found, 1.0 - jnp.sum(found, axis=0, keepdims=True)])
    # Each order is part of its own sum and of the sums after it.
    within = jnp.concatenate([jnp.ones_like(share[:1]), jnp.cumsum(share[::-1], axis=0)[::-1]])
    total = jax.tree.map(lambda o: jnp.einsum("jw,j...w->...w", within, o), orders)
    rest = jax.tree.map(lambda o: jnp.einsum("jw,j...w->...w", share, o[1:]), orders)
    return total, rest


def _nearest(columns: Float[Array, "place column"], goal: Float[Array, " place"]) -> Float[Array, " column"]:
    """Coefficients of the combination of columns that is nearest to the goal; 0 for columns that are empty."""
    count = columns.shape[1]
    square = jnp.sum(columns**2, axis=0)
    some = square > _NO_LIGHT**2
    size = jnp.where(some, jnp.sqrt(jnp.where(some, square, 1.0)), 1.0)
    largest = jnp.max(jnp.abs(goal))
    lit = largest > _NO_LIGHT
    # In the dark any goal but 0 will do, because its length has a derivative.
    goal = jnp.where(lit, goal / jnp.where(lit, largest, 1.0), 1.0)
    rows = jnp.concatenate([columns / size[None], goal[:, None]], axis=1)
    # Empty columns get a row of unit strength.
    guard = jnp.where(some, _GUARD * jnp.finfo(rows.dtype).eps, 1.0)
    held = jnp.eye(count, count + 1, dtype=rows.dtype) * guard[:, None]
    whole = triangle(jnp.concatenate([rows, held]))[:count]
    return jnp.where(lit, solve_upper(whole[:, :count], whole[:, count]) * largest / size, 0.0)


def _closure(orders: Order) -> Float[Array, "level sun wavelength"]:
    """Sum of the orders after the last, in units of the last, if they fall as it does."""
    before, after = orders.moments[-2, :, :, 0], orders.moments[-1, :, :, 0]
    some = before > _NO_LIGHT
    # No place falls more slowly than the air as a whole, or than the first of `_SLOWEST`.
    whole = jnp.sum(after, axis=(0, 1)) / jnp.maximum(jnp.sum(before, axis=(0, 1)), _NO_LIGHT)
    slowest = jnp.clip(whole, *_SLOWEST)[None, None]
    ratio = jnp.clip(jnp.where(some, after / jnp.where(some, before, 1.0), 0.0), 0.0, slowest)
    return ratio / (1.0 - ratio)


def tabled(light: Order, left_over: Float[Array, " wavelength"]) -> Solution:
    """The light of some orders, with the table that views read."""

    def finer(count: int, times: int):
        return as_float(cubic_weights(np.arange(times * (count - 1) + 1) / times, count))

    levels, suns = finer(light.moments.shape[0], FINER_LEVELS), finer(light.moments.shape[1], FINER_SUNS)
    travelling = light.moments[:, :, : len(sun_harmonics.kept(sun_harmonics.TRAVELLING, False))]
    return Solution(*light, jnp.einsum("il,js,lshw->ijhw", levels, suns, travelling), left_over)


def _carrier(rays: Rays, names, azimuth, sun_place, sun, resolution: Resolution, weights) -> Carrier:
    cosine = as_float(rays.zenith_cosine)
    radius = as_float(EARTH_RADIUS + rays.level)[:, None, None, None]
    # `[level, zenith, azimuth, sun]`
    turn, under = as_float(azimuth)[None, None, :, None], sun[None, None, None]
    every = sun_harmonics.along_sun(cosine[:, :, None, None], turn, under)
    views = jnp.moveaxis(sun_harmonics.of_views(names, *every), -1, 0)
    few = as_float(half_turn(FEW_AZIMUTHS))[None, None, :, None]
    along, out, aside = sun_harmonics.along_sun(cosine[:, :, None, None], few, under)

    def there(distance, pick):
        """Points that rays reach: along the sun's axis, out from it and aside, m, `[level, node, azimuth, sun]`."""
        distance = as_float(distance)[:, :, None, None]
        start = radius * jnp.cos(under), radius * jnp.sin(under), 0.0
        return [s + distance * v[:, pick] for s, v in zip(start, (along, out, aside), strict=True)]

    def suns_at(place):
        zenith = jnp.arctan2(safe_sqrt(place[1] ** 2 + place[2] ** 2), place[0])
        row = sun_weights(zenith, sun_place, resolution.sun_step)
        return row.reshape(*zenith.shape[:2], -1, sun.shape[0])

    place = there(rays.distance, rays.ray)
    view = (v[:, rays.ray] for v in (along, out, aside))
    basis = jnp.stack(sun_harmonics.carried(names, *view, *place[1:]), axis=-1)
    basis = basis.reshape(*basis.shape[:2], -1, basis.shape[-1])
    grounded = np.arange(rays.length.shape[1])[-rays.grounded :]
    at_ground = suns_at(there(rays.length[:, grounded], grounded))
    return Carrier(views, basis, suns_at(place), at_ground, as_float(rays.between), weights)


def _carried(order: Order, carrier: Carrier, medium: Medium, rays: Rays, names, fall, azimuth):
    """Radiance of the next order, `[sun, level, zenith, azimuth, wavelength]`."""
    travelling = sun_harmonics.travelling(names)
    degree = np.array([pair[0] for pair in names])
    share = as_float(sun_harmonics.weights(names))
    zeniths, suns, wavelengths = rays.length.shape[1], *order.ground.shape
    of_ray = as_float(np.arange(zeniths)[:, None] == rays.ray[None])
    moments = order.moments[:, :, :travelling] * share[None, None, :travelling, None]
    grounded = zeniths - rays.grounded
    low = medium.moments[: sun_harmonics.TRAVELLING]

    def at_level(level):
        """Light that arrives at one level; scatterers are mixed at each node, for each degree that travels."""
        basis, suns_there, between, node, density, passed, at_ground = level
        mixed = jnp.einsum("nw,cn,cw,dcw->ndw", node, density, medium.scattering, low)
        source = jnp.einsum("no,oshw->nshw", between, moments) * mixed[:, None, degree[:travelling]]
        source = source.reshape(source.shape[0], suns, -1)
        light = jnp.einsum("nxs,nsk->nxk", suns_there, source).reshape(source.shape[0], -1, travelling, wavelengths)
        light = jnp.einsum("nxhw,nxh->nxw", light, basis)
        light = jnp.einsum("zn,nxw->zxw", of_ray, light)
        lit = jnp.einsum("zxs,sw->zxw", at_ground, order.ground)
        reflected = (medium.albedo / np.pi)[None, None] * lit * passed[:, None]
        return light.at[grounded:].add(reflected)

    weights = carrier.rays.node, jnp.moveaxis(carrier.rays.density, 0, 1), carrier.rays.passed
    light = jax.lax.map(at_level, (carrier.basis, carrier.suns, carrier.between, *weights, carrier.ground))
    light = light.reshape(*light.shape[:2], FEW_AZIMUTHS, suns, wavelengths)
    light = jnp.einsum("af,lzfsw->slzaw", as_float(spread_azimuths(azimuth)), light)
    for c in medium.peaks:
        emitted = carrier.rays.node * carrier.rays.density[c][..., None] * medium.scattering[c][None, None]
        held = jnp.einsum("zn,lnw,lno->lzow", of_ray, emitted, carrier.between)
        weight = medium.moments[degree[travelling:], c] * share[travelling:, None]
        local = jnp.einsum("lzow,oshw->lzshw", held, order.moments[:, :, travelling:] * weight[None, None])
        local = local * fall[None, None, :, None, None]
        light = light + jnp.einsum("lzshw,shlza->slzaw", local, carrier.views[:, travelling:])
    return light
