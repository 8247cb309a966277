"""Algorithm 4.1: the tables T, E and S, one order of scattering after the other."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...atmosphere import AbstractConstituent, AbstractPhase, Layered, RayleighPhase
from ..columns import EARTH_RADIUS, outward_columns, slant_columns
from ..views import lit_points, Views
from .lookup import interpolate, irradiance, optical_depth, Rays, scattered, sunlight
from .parameterisation import distance_to_end, Sizes, unit_height, unit_sun, unit_view, view_position
from .texels import (
    azimuth_cosine,
    irradiance_nodes,
    paths,
    possible_angle,
    Sphere,
    sphere,
    texels,
    transmittance_nodes,
)


class Air(NamedTuple):
    """Input of the tables: optical depths of the constituents and the ground's albedo at some wavelengths."""

    constituents: tuple[AbstractConstituent, ...]
    wavelength_nm: Float[Array, " wavelength"]
    extinction: Float[Array, "constituent wavelength"]
    scattering: Float[Array, "constituent wavelength"]
    reflectance: Float[Array, " wavelength"]

    @property
    def scatterers(self) -> tuple[int, ...]:
        """Indices of the scatterers: the paper's air first, if there is one."""
        places = [i for i, c in enumerate(self.constituents) if c.phase is not None]
        return tuple(sorted(places, key=lambda i: i != self.smooth))

    @property
    def smooth(self) -> int | None:
        """Index of the paper's air, the first scatterer whose phase function ends at degree 2; None without one."""
        degrees = [(i, c.phase.last_degree) for i, c in enumerate(self.constituents) if c.phase is not None]
        return next((i for i, degree in degrees if degree is not None and degree <= 2), None)

    @property
    def phases(self) -> tuple[AbstractPhase, ...]:
        """The phase functions of `scatterers`."""
        return tuple(phase for i in self.scatterers if (phase := self.constituents[i].phase) is not None)

    @property
    def smooth_phase(self) -> AbstractPhase:
        """Phase function $P_R$ by which light scattered more than once is divided in the table."""
        return RayleighPhase(0.0) if self.smooth is None else self.phases[0]

    def reach(self) -> Float[Array, ""]:
        """Height (m) over which the scatterers thin out; it has no gradient, so that nodes do not move."""
        return jax.lax.stop_gradient(
            jnp.max(jnp.stack([self.constituents[i].profile.reach() for i in self.scatterers]))
        )


class Tables(NamedTuple):
    r"""The precomputed tables, per unit irradiance of the sun.

    `optical_depth` `[height, view, wavelength]`, to the views' ends: the logarithm of T, so that $T(x) / T(y)$ is never
    0 / 0; `irradiance` `[height, sun, wavelength]`, $E[L_*]$; `air` `[height, view, sun, angle, wavelength]`,
    $C_* = S_R[L_0] + S[L_*] / P_R$; `apart`, $C_M = S_M[L_0]$ of every other scatterer, which are an additional first
    axis. With the one-component shortcut `apart` has only one wavelength.
    """

    optical_depth: Float[Array, "height view wavelength"]
    irradiance: Float[Array, "height sun wavelength"]
    air: Float[Array, "height view sun angle wavelength"]
    apart: Float[Array, "scatterer height view sun angle stored"]


class Resolution(NamedTuple):
    """Resolution of the tables, all static: `nodes` per part of a path, `directions` of a sphere, `orders`."""

    sizes: Sizes
    orders: int
    nodes: int
    directions: tuple[int, int]


_Light = Callable[[Rays], Array]


def precompute(air: Air, resolution: Resolution) -> Tables:
    """Run algorithm 4.1. `orders` counts reflections by the ground, too; E has one order less, as in the paper."""
    sizes = resolution.sizes
    depth = transmittance(air, sizes)
    single = once_scattered(air, depth, resolution)

    def direct(sun_cosine: Array) -> Array:
        ground = jnp.zeros_like(sun_cosine)
        return sunlight(depth, ground, sun_cosine, sizes) * jnp.maximum(sun_cosine, 0.0)[..., None]

    def order(state, _):
        # One program serves all orders. Light that is scattered once counts in the first round only.
        alive, more, light, total, whole = state

        # The last row is light that is scattered more often, to which no further phase function applies.
        every = jnp.concatenate([alive * single, light[..., None, :]], axis=-2)
        flat = every.reshape(*sizes.scattering, -1)

        def diffuse(rays: Rays) -> Array:
            each = scattered(flat, rays, sizes).reshape(*rays.angle.shape, *every.shape[-2:])
            half = jnp.clip(0.5 - 0.5 * rays.angle, 0.0, 1.0)
            light = each[..., -1, :]
            for row, phase in enumerate(air.phases):
                light = light + phase.at_haversine(half, air.wavelength_nm) * each[..., row, :]
            return light

        def of_ground(sun_cosine: Array) -> Array:
            return alive * direct(sun_cosine) + irradiance(more, jnp.zeros_like(sun_cosine), sun_cosine, sizes)

        def incident(rays: Rays) -> Array:
            return diffuse(rays) + reflected(air, depth, rays, of_ground, sizes)

        source = gathered(air, incident, resolution)
        more, light = collected(diffuse, resolution), along_views(air, depth, source, resolution)
        return (jnp.zeros_like(alive), more, light, total + more, whole + light), None

    multiple = jnp.zeros_like(single[..., 0, :])
    total = jnp.zeros((*sizes.irradiance, multiple.shape[-1]), multiple.dtype)
    state = jnp.ones((), multiple.dtype), total, multiple, total, multiple
    if resolution.orders > 1:
        (*_, total, multiple), _ = jax.lax.scan(order, state, length=resolution.orders - 1)
    # $P_R$ at the angle by which the table is read, also for entries whose zenith angles do not allow that angle.
    half = jnp.clip(0.5 - 0.5 * texels(sizes).angle, 0.0, 1.0)
    phase = air.smooth_phase.at_haversine(half, air.wavelength_nm)[None, None, None]
    own = 0 if air.smooth is None else 1
    smooth = single[..., 0, :] if own else jnp.zeros_like(multiple)
    return Tables(depth, total, smooth + multiple / phase, jnp.moveaxis(single[..., own:, :], -2, 0))


def transmittance(air: Air, sizes: Sizes) -> Float[Array, "height view wavelength"]:
    """The optical depth from every entry of T to the ground or to space."""
    nodes = transmittance_nodes(sizes)
    ground, profiles = nodes.ground, [c.profile for c in air.constituents]
    start = jnp.broadcast_to(nodes.height[:, None], nodes.cosine.shape)
    sky = slant_columns(profiles, start[:, ~ground], nodes.cosine[:, ~ground], "spherical")
    # The column from the ground up, less the part above the height.
    low = start[:, ground]
    height = jnp.stack([jnp.zeros_like(low), low])
    cosine = jnp.maximum(jnp.stack([nodes.end[:, ground], -nodes.cosine[:, ground]]), 0.0)
    climbing = outward_columns(profiles, height, cosine, "spherical")
    columns = jnp.concatenate([jnp.maximum(climbing[:, 0] - climbing[:, 1], 0.0), sky], axis=-1)
    return jnp.moveaxis(columns, 0, -1) @ air.extinction


def once_scattered(
    air: Air, depth, resolution: Resolution
) -> Float[Array, "height view sun angle scatterer wavelength"]:
    """$S_c[L_0]$ of each scatterer without its phase function, over the lit parts of each view."""
    sizes = resolution.sizes
    nodes, reach = texels(sizes), air.reach()
    angles = nodes.angle.shape[0]
    ground = jnp.repeat(jnp.asarray(nodes.ground), angles)
    kept = [air.constituents[i] for i in air.scatterers]
    jumps = [c.profile.edges[1:] for c in kept if isinstance(c.profile, Layered)]
    edges = jnp.sort(jnp.concatenate([jnp.zeros(0), *jumps]))

    def at_height(place):
        height, cosine = place
        view = jnp.repeat(cosine, angles)
        start = height + jnp.zeros_like(view)
        length = distance_to_end(start, view, ground)
        here = optical_depth(depth, start, view, ground, sizes)

        def under(sun):
            angle = possible_angle(view, sun, jnp.tile(nodes.angle, cosine.shape[0]))
            half = jnp.clip(0.5 - 0.5 * angle, 0.0, 1.0)
            views = Views(True, start, view, sun, half, jnp.zeros_like(view), length)
            points, step = lit_points(views, reach, edges, resolution.nodes, "spherical")
            level = jnp.maximum(points.height, 0.0)
            seen = jnp.clip(points.view_cosine, -1.0, 1.0)
            ends = jnp.broadcast_to(ground[:, None], level.shape)
            to_eye = jnp.maximum(here[:, None] - optical_depth(depth, level, seen, ends, sizes), 0.0)
            to_sun = optical_depth(depth, level, jnp.clip(points.sun_cosine, -1.0, 1.0), jnp.zeros_like(ends), sizes)
            source = jnp.stack([step * c.profile.density(level) for c in kept], axis=1)
            return source @ jnp.exp(-to_eye - to_sun)

        light = jnp.swapaxes(jax.lax.map(under, nodes.sun_cosine), 0, 1)
        # [view angle, sun, ...] -> [view, sun, angle, ...]
        return jnp.swapaxes(light.reshape(cosine.shape[0], angles, *light.shape[1:]), 1, 2)

    light = jax.lax.map(jax.checkpoint(at_height), (nodes.height, nodes.cosine))
    scattering = jnp.stack([air.scattering[i] for i in air.scatterers])
    return light * jnp.expand_dims(scattering, (0, 1, 2, 3))


def reflected(air: Air, depth, rays: Rays, of_ground: Callable[[Array], Array], sizes: Sizes) -> Array:
    r"""Light from the ground at the end of rays, $T \frac{\alpha}{\pi} E$; `of_ground` gives E by the sun there."""
    radius = EARTH_RADIUS + rays.height
    length = distance_to_end(rays.height, rays.cosine, rays.ground)
    sun = jnp.clip((radius * rays.sun_cosine + length * rays.angle) / EARTH_RADIUS, -1.0, 1.0)
    through = jnp.exp(-optical_depth(depth, rays.height, rays.cosine, rays.ground, sizes))
    share = jnp.expand_dims(air.reflectance / np.pi, range(sun.ndim))
    return jnp.where(rays.ground[..., None], through * share * of_ground(sun), 0.0)


def gathered(air: Air, incident: _Light, resolution: Resolution) -> Float[Array, "height view sun angle wavelength"]:
    """$J[L]$, eq. 7: light that every entry scatters into its view, by quadrature over the directions of the light."""
    nodes = texels(resolution.sizes)
    views, angles = nodes.cosine.shape[1], nodes.angle.shape[0]

    def at(place):
        height, cosine, sun = place
        around = sphere(height, resolution.directions)
        light = incident(_rays(height, sun, around))
        view = jnp.repeat(cosine, angles)
        turn = azimuth_cosine(view, sun, jnp.tile(nodes.angle, views))
        toward = _vectors(view, turn)
        source = jnp.zeros((views * angles, light.shape[-1]), light.dtype)
        for i, phase in zip(air.scatterers, air.phases, strict=True):
            share = air.scattering[i] * air.constituents[i].profile.density(height)
            source = source + share[None] * _turned(phase, air.wavelength_nm, toward, around, light)
        return source.reshape(views, angles, -1)

    suns = nodes.sun_cosine.shape[0]
    places = (
        jnp.repeat(nodes.height, suns),
        jnp.repeat(nodes.cosine, suns, axis=0),
        jnp.tile(nodes.sun_cosine, nodes.height.shape[0]),
    )
    source = jax.lax.map(jax.checkpoint(at), places)
    return jnp.swapaxes(source.reshape(-1, suns, *source.shape[1:]), 1, 2)


def _vectors(cosine, turn) -> Float[Array, "direction 3"]:
    """Unit vectors by components toward the sun, aside and up; `turn` is the cosine of the azimuth from the sun."""
    sine = jnp.sqrt(jnp.maximum(1.0 - cosine**2, 0.0))
    return jnp.stack([sine * turn, sine * jnp.sqrt(jnp.maximum(1.0 - turn**2, 0.0)), cosine], axis=1)


def _turned(
    phase: AbstractPhase, wavelength_nm, toward: Float[Array, "view 3"], around: Sphere, light
) -> Float[Array, "view wavelength"]:
    """Light from half a sphere and its mirror image, averaged by the phase function."""
    come = _vectors(around.cosine, jnp.asarray(np.cos(around.azimuth), light.dtype))
    weighted = around.weight[:, None] * light
    if phase.last_degree is not None and phase.last_degree <= 2:
        return _turned_smoothly(phase.moments(3, wavelength_nm), toward, come, weighted)
    # Light from one side and from the other, normalised: the mean of light that is one everywhere must be one.
    weighted = jnp.concatenate([weighted, around.weight[:, None]], axis=1)
    level = toward[:, ::2] @ come[:, ::2].T
    across = toward[:, 1:2] * come[None, :, 1]
    both = jnp.zeros((*level.shape, 1), level.dtype)
    for cosine in (level + across, level - across):
        half = jnp.clip(0.5 - 0.5 * cosine, 0.0, 1.0)
        both = both + phase.at_haversine(half.ravel(), wavelength_nm).reshape(*level.shape, -1)
    if both.shape[-1] == 1:
        total = both[..., 0] @ weighted
        return total[:, :-1] / total[:, -1:]
    total, whole = jnp.einsum("vow,ow->vw", both, weighted[:, :-1]), jnp.einsum("vow,o->vw", both, weighted[:, -1])
    return total / whole


def _turned_smoothly(moments, toward, come, weighted) -> Float[Array, "view wavelength"]:
    r"""As `_turned`, by $\frac{1}{4\pi} (1 + 3 \chi_1 c + \frac52 \chi_2 (3 c^2 - 1))$, c the cosine."""

    def squares(v):
        # Their product is the square of the cosine without terms odd in y, which cancel with the mirror image.
        return jnp.stack([v[:, 0] ** 2, v[:, 1] ** 2, v[:, 2] ** 2, np.sqrt(2.0) * v[:, 0] * v[:, 2]], axis=1)

    twice = 2.0 * weighted
    whole = jnp.sum(twice, axis=0)[None]
    first = toward[:, ::2] @ (come[:, ::2].T @ twice)
    second = squares(toward) @ (squares(come).T @ twice)
    series = whole + 3.0 * moments[1][None] * first + 2.5 * moments[2][None] * (3.0 * second - whole)
    return series / (4.0 * np.pi)


def _rays(height, sun, around: Sphere) -> Rays:
    across = jnp.sqrt(jnp.maximum(1.0 - around.cosine**2, 0.0)) * jnp.sqrt(jnp.maximum(1.0 - sun**2, 0.0))
    angle = around.cosine * sun + across * np.cos(around.azimuth)
    same = jnp.zeros_like(angle)
    return Rays(height + same, around.cosine, sun + same, jnp.clip(angle, -1.0, 1.0), jnp.asarray(around.ground))


def collected(light: _Light, resolution: Resolution) -> Float[Array, "height sun wavelength"]:
    """$E[S]$, eq. 15: irradiance on level planes at every height."""
    heights, suns = irradiance_nodes(resolution.sizes)

    def at(place):
        height, sun = place
        around = sphere(height, resolution.directions, lower=False)
        return 2.0 * (around.weight * around.cosine) @ light(_rays(height, sun, around))

    places = jnp.repeat(heights, suns.shape[0]), jnp.tile(suns, heights.shape[0])
    return jax.lax.map(jax.checkpoint(at), places).reshape(*resolution.sizes.irradiance, -1)


def along_views(
    air: Air, depth, source: Float[Array, "height view sun angle wavelength"], resolution: Resolution
) -> Float[Array, "height view sun angle wavelength"]:
    r"""$S = \int T(x, y)\, J(y)\, dy$, eq. 11, for every entry; $\nu$ is the same all along a view."""
    sizes = resolution.sizes
    nodes, reach = texels(sizes), air.reach()
    heights, views, suns, angles, wavelengths = source.shape
    slabs = source.reshape(heights, views, -1)

    def half(height, cosine, ground: bool):
        points = paths(height, cosine, ground, reach, resolution.nodes)
        flags = jnp.full(points.height.shape, ground)
        here = optical_depth(depth, height + jnp.zeros_like(cosine), cosine, flags[:, 0], sizes)
        passed = here[:, None] - optical_depth(depth, points.height, points.cosine, flags, sizes)
        weight = points.weight[..., None] * jnp.exp(-jnp.maximum(passed, 0.0))
        place = view_position(unit_view(points.height, points.cosine, flags, sizes.rescaled), flags, views)
        slab = interpolate(slabs, ((heights - 1) * unit_height(points.height), place))
        # Cosine of the sun's zenith angle at the points, interpolated between its nodes.
        angle = possible_angle(cosine[:, None, None], nodes.sun_cosine[None, :, None], nodes.angle[None, None])
        ahead = (EARTH_RADIUS + height) * nodes.sun_cosine[None, None, :, None]
        sun = (ahead + points.distance[:, :, None, None] * angle[:, None]) / (
            EARTH_RADIUS + points.height[:, :, None, None]
        )
        sun = (suns - 1) * unit_sun(sun, sizes.lowest_sun)
        low = jnp.clip(jnp.floor(sun), 0.0, suns - 2.0)
        past = (sun - low)[..., None]
        block = jnp.arange(slab.shape[0] * slab.shape[1]).reshape(*slab.shape[:2], 1, 1)
        index = (block * suns + low.astype(jnp.int32)) * angles + jnp.arange(angles)[None, None, None]
        rows = slab.reshape(-1, wavelengths)
        before, after = (rows.at[index + step].get(mode="clip") for step in (0, angles))
        return jnp.sum(weight[:, :, None, None] * (before + past * (after - before)), axis=1)

    def at_height(place):
        height, cosine = place
        down = half(height, cosine[: views // 2], True)
        return jnp.concatenate([down, half(height, cosine[views // 2 :], False)])

    return jax.lax.map(jax.checkpoint(at_height), (nodes.height, nodes.cosine))
