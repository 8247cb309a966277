"""Diffuse light on discrete streams: layers, sweeps through them, and the sum over all orders of scattering."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..atmosphere import AbstractConstituent, Atmosphere
from ..numerics import associated_legendre, exp_mean, gauss_legendre, phi1, phi_functions
from ..scene import above_horizon, Scene
from .diffusion import diffusion
from .optical_path import layer_airmass, slant_column, stream_paths, sunlit, TOP_OF_AIR
from .single import scatterer_indices
from .solver import Geometry, optics


_HEIGHT_TABLE = 512


class Resolution(NamedTuple):
    """How finely streams solve, all static: `streams` a hemisphere, Fourier `modes`, layers, sweeps.

    `complete`: delta-M, and all orders that the sweeps do not reach are closed by diffusion; without it the
    phase functions are cut after their moments and the light is that of `orders` orders, no more.
    """

    streams: int
    modes: int
    levels: int
    orders: int
    geometry: Geometry
    complete: bool = True

    def check(self, nodes: int, spectral_nodes: int) -> None:
        """A `ValueError` for a count that is too small or modes that the streams cannot carry."""
        least = {"streams": 1, "modes": 1, "levels": 2, "orders": 1}
        counts = {name: (getattr(self, name), bound) for name, bound in least.items()}
        counts |= {"nodes": (nodes, 1), "spectral_nodes": (spectral_nodes, 0)}
        for name, (count, bound) in counts.items():
            if count < bound:
                raise ValueError(f"`{name}` must be at least {bound}, got {count}")
        if self.modes > 2 * self.streams:
            raise ValueError(f"`modes` must be at most 2 x `streams`, got {self.modes} for {self.streams}")

    def for_phases(self, constituents: tuple[AbstractConstituent, ...]) -> tuple[int, int]:
        """Moments and modes that these phase functions need: four and three for air alone."""
        phases = [c.phase for c in constituents if c.phase is not None]
        degrees = [phase.last_degree for phase in phases if phase.last_degree is not None]
        if len(degrees) < len(phases):
            return 2 * self.streams, self.modes
        last = max(degrees)
        return min(2 * self.streams, 2 * (last // 2 + 1)), min(self.modes, last + 1)


class Scaled(NamedTuple):
    """Optics as the streams see them; moments of scatterers with the factor 2 l + 1."""

    extinction: Float[Array, "constituent wavelength"]
    scattering: Float[Array, "scatterer wavelength"]
    moments: Float[Array, "moment scatterer wavelength"]


class Layers(NamedTuple):
    """The layered problem of one sky, top to ground, per unit solar irradiance."""

    height: Float[Array, " level"]
    depth: Float[Array, "layer wavelength"]
    beam: Float[Array, "level wavelength"]
    beam_depth: Float[Array, "layer wavelength"]
    moments: Float[Array, "moment layer wavelength"]
    sun_cosine: Float[Array, ""]
    sun_sine: Float[Array, ""]
    ground_albedo: Float[Array, " wavelength"]


class Field(NamedTuple):
    """The diffuse light summed over all orders: moments of its mean in each layer, fluxes at the two ends."""

    moments: Float[Array, "parity half mode layer wavelength"]
    ground_flux: Float[Array, " wavelength"]
    top_flux: Float[Array, " wavelength"]


def degree_index(count: int, modes: int) -> np.ndarray:
    """Degrees l `[parity, half, mode]`: those of l + m even first, whose harmonics are even in the cosine."""
    half, mode = np.arange(count // 2)[None, :, None], np.arange(modes)[None, None, :]
    return 2 * half + (mode + np.arange(2)[:, None, None]) % 2


def harmonics(cosine, sine, count: int, modes: int) -> Float[Array, "parity half mode *shape"]:
    """Associated Legendre functions in the layout of `degree_index`."""
    every = associated_legendre(cosine, sine, modes, count)
    return every[degree_index(count, modes), np.arange(modes)[None, None]]


def scaled_optics(
    constituents: tuple[AbstractConstituent, ...],
    wavelength_nm: Float[Array, " wavelength"],
    resolution: Resolution,
) -> Scaled:
    """Optical depths and the first moments of what scatters.

    With `resolution.complete`, delta-M: the forward peak beyond the last moment counts as unscattered (Wiscombe 1977).
    """
    depth, (count, _) = optics(constituents, wavelength_nm), resolution.for_phases(constituents)
    extinction, scattering, moments = [], [], []
    for i, c in enumerate(constituents):
        if c.phase is None:
            extinction.append(depth.extinction[i])
            continue
        every = c.phase.moments(count + 1, wavelength_nm) + jnp.zeros_like(wavelength_nm)[None]
        peak = every[count] if resolution.complete else jnp.zeros_like(wavelength_nm)
        extinction.append(depth.extinction[i] - peak * depth.scattering[i])
        scattering.append((1.0 - peak) * depth.scattering[i])
        moments.append((every[:count] - peak[None]) / (1.0 - peak[None]))
    degree = jnp.asarray(2.0 * np.arange(count) + 1.0, wavelength_nm.dtype)
    weighted = jnp.stack(moments, axis=1) * degree[:, None, None]
    return Scaled(jnp.stack(extinction), jnp.stack(scattering), weighted)


def level_heights(constituents: tuple[AbstractConstituent, ...], levels: int) -> Float[Array, " level"]:
    """Heights (m) of the levels, top to ground, equal steps of the scatterers' mean column share."""
    scatterers = [c.profile for c in constituents if c.phase is not None]
    table = TOP_OF_AIR * (np.arange(_HEIGHT_TABLE + 1) / _HEIGHT_TABLE) ** 3
    height = jnp.asarray(table, jnp.result_type(float))
    share = jnp.mean(jnp.stack([p.above(height) for p in scatterers]), axis=0)
    share = (share - share[-1]) / (share[0] - share[-1])
    target = jnp.arange(levels + 1) / levels
    return jnp.interp(target.astype(height.dtype), share[::-1], height[::-1])


def layered(
    atmosphere: Atmosphere,
    scene: Scene,
    wavelength_nm: Float[Array, " wavelength"],
    resolution: Resolution,
) -> Layers:
    """The atmosphere cut into layers for one sun."""
    constituents, geometry = atmosphere.constituents, resolution.geometry
    scaled = scaled_optics(constituents, wavelength_nm, resolution)
    height = level_heights(constituents, resolution.levels)
    # what little lies above the top level belongs to the first layer
    above = jnp.stack([c.profile.above(height) for c in constituents]).at[:, 0].set(0.0)
    share = jnp.diff(above, axis=1)
    depth = share.T @ scaled.extinction
    scattered = jnp.stack([share[i] for i in scatterer_indices(constituents)])[:, :, None] * scaled.scattering[:, None]
    fraction = scattered / jnp.where(depth > 0.0, depth, 1.0)[None]
    sun_cosine = jnp.cos(scene.sun_zenith)
    cosine = sun_cosine + jnp.zeros_like(height)
    slant = jnp.stack([slant_column(c.profile, height, cosine, geometry) for c in constituents])
    slant = slant.at[:, 0].set(jnp.where(sun_cosine >= 0.0, 0.0, slant[:, 0]))
    sun_depth = slant.T @ scaled.extinction
    lit = sunlit(height, cosine, geometry)
    return Layers(
        height,
        depth,
        jnp.where(lit[:, None], jnp.exp(-sun_depth), 0.0),
        jnp.maximum(jnp.diff(sun_depth, axis=0), 0.0),
        jnp.einsum("skw,lsw->lkw", fraction, scaled.moments),
        sun_cosine,
        jnp.sin(scene.sun_zenith),
        atmosphere.ground.reflectance(wavelength_nm),
    )


def sloped(source: Float[Array, "layer ..."], depth: Float[Array, "layer ..."]) -> Float[Array, "layer ..."]:
    """Difference of a source between the last and the first end of each layer, by its neighbours' means.

    `depth` has the rank of `source`. Flattened in thick layers: there a straight line through means would turn
    negative.
    """
    near = 0.5 * (depth[1:] + depth[:-1])
    one_sided = np.arange(depth.shape[0] - 1) == 0
    half = jnp.expand_dims(jnp.asarray(np.where(one_sided, 1.0, 0.5), depth.dtype), tuple(range(1, depth.ndim)))
    near = jnp.where(near > 0.0, near, 1.0)
    edge = jnp.zeros_like(depth[:1])
    damped = depth / (1.0 + 0.1 * depth**2)
    before, after = jnp.concatenate([edge, half[::-1] / near]), jnp.concatenate([half / near, edge])
    padded = jnp.concatenate([source[:1], source, source[-1:]])
    return damped * (before * (source - padded[:-2]) + after * (padded[2:] - source))


def solve(layers: Layers, resolution: Resolution, modes: int) -> Field:
    """The diffuse field: sweeps, each followed by the diffusion of what it left over.

    **Source:** successive orders as in Lenoble et al. 2007, JQSRT 107, 479; sources by conservative means over
    the layers; diffusion synthetic acceleration: Alcouffe 1977, Nucl. Sci. Eng. 64, 344.
    """
    cosine, weight = gauss_legendre(resolution.streams)
    dtype, count = layers.depth.dtype, layers.moments.shape[0]
    mu = jnp.asarray(cosine, dtype)
    from_moment = harmonics(mu, jnp.asarray(np.sqrt(1.0 - cosine**2), dtype), count, modes)
    to_moment = jnp.asarray(0.5 * weight, dtype)[None, None, None] * from_moment
    phase = layers.moments[degree_index(count, modes)]
    flux_weight = jnp.asarray(2.0 * np.pi * weight * cosine, dtype)
    mode_weight = jnp.asarray(np.where(np.arange(modes) == 0, 1.0, 2.0) / (4.0 * np.pi), dtype)

    # axes: direction of travel (down, up), layer from the top, mode, stream, wavelength
    paths = stream_paths(layers.height, mu, resolution.geometry)
    slant = jnp.stack([p.airmass for p in paths])[..., None] * layers.depth[None, :, None]
    first, second = phi_functions(slant)
    lean = 0.5 * first - second
    bends = [path.turn for path in paths if path.turn is not None]
    turns = _as_met(jnp.stack(bends)) if bends else None
    # what leaves a layer and its mean, of what enters it, of its source and of the source's step along the way
    through = _pair_as_met(jnp.exp(-slant), first)
    emits = _pair_as_met(slant * first, slant * second)
    leans = _pair_as_met(-slant * lean, lean)

    def run(start, weights, source, rise):
        """Radiance that leaves the last layer, and the mean in each layer from the top, of sources as met."""

        def step(radiance, layer):
            pass_on, turn, weight, lean, level, change = layer
            if turn is not None:
                radiance = jnp.einsum("dij,dmjw->dmiw", turn, radiance)
            leaves, mean = weight[:, :, None] * level[None] + pass_on[:, :, None] * radiance[None]
            if change is not None:
                leaves, mean = leaves + lean[0, :, None] * change, mean + lean[1, :, None] * change
            return leaves, mean

        last, mean = jax.lax.scan(step, start, (through, turns, weights, leans, source, rise))
        return last, _from_top(mean)

    nothing = jnp.zeros((slant.shape[1], 2, 1, *slant.shape[2:]), dtype)
    # the isotropic light of a ground that reflects a unit of flux
    shine_top, shine = run(nothing[0].at[1].set(1.0 / np.pi), emits, nothing, None)
    shine_top, shine = shine_top[1, 0], shine[1, :, 0]

    def sweep(last, mean, beam_flux):
        """Moments of the mean radiance, flux onto the ground and out of the top, for one source."""
        flux = jnp.einsum("n,nw->w", flux_weight, last[0, 0])
        reflected = layers.ground_albedo * (flux + beam_flux)
        top = jnp.einsum("n,nw->w", flux_weight, last[1, 0] + reflected[None] * shine_top)
        mean = mean.at[1, :, 0].add(reflected[None, None] * shine)
        both = jnp.stack([mean[0] + mean[1], mean[0] - mean[1]])
        return jnp.einsum("phmn,pkmnw->phmkw", to_moment, both), flux, top

    def on_streams(moments):
        even, odd = jnp.einsum("phmn,phmkw->pkmnw", from_moment, moments)
        return jnp.stack([even + odd, even - odd])

    # the beam, exponential within each layer
    sun = harmonics(layers.sun_cosine, layers.sun_sine, count, modes) * mode_weight[None, None]
    once = on_streams(sun[..., None, None] * phase) * layers.beam[None, :-1, None, None]
    beam = layers.beam_depth[:, None] + jnp.zeros_like(slant[0])
    mean = jnp.stack([exp_mean(beam, slant[0]), phi1(beam + slant[1])])
    met = _as_met(once)
    total = sweep(
        *run(jnp.zeros_like(met[0]), _pair_as_met(slant * mean, phi1(beam)[None] - mean), met, None),
        jnp.maximum(layers.sun_cosine, 0.0) * layers.beam[-1],
    )
    thickness = _as_met(jnp.stack([layers.depth, layers.depth]))[:, :, None, None]
    diffuse = None
    if resolution.complete:
        diffuse = diffusion(layers.depth, layers.moments[0], layers.moments[1] / 3.0, layers.ground_albedo)

    def order(carry, _):
        left, total = carry
        even, odd = left[0, 0, 0], left[1, 0, 0]
        even, odd = (0.0 * even, 0.0 * odd) if diffuse is None else diffuse(even, odd)[:2]
        source = _as_met(on_streams(phase * _added(left, even, odd)))
        met = run(jnp.zeros_like(source[0]), emits, source, sloped(source, thickness))
        scattered = sweep(*met, jnp.zeros_like(layers.beam[-1]))
        return (_added(scattered[0], -even, -odd), jax.tree.map(jnp.add, total, scattered)), None

    left = total[0]
    if resolution.orders > 1:
        (left, total), _ = jax.lax.scan(order, (left, total), None, length=resolution.orders - 1)
    if diffuse is None:
        return Field(*total)
    even, odd, more_flux, more_top = diffuse(left[0, 0, 0], left[1, 0, 0])
    return Field(_added(total[0], even, odd), total[1] + more_flux, total[2] + more_top)


def _added(moments, even, odd):
    """The moments with the mean radiance and the vertical flux of some diffuse light added."""
    return moments.at[0, 0, 0].add(even).at[1, 0, 0].add(odd)


def _as_met(array):
    """`[direction, layer from the top, ...]` to `[layer in the order met, direction, ...]`."""
    return jnp.stack([array[0], array[1, ::-1]], axis=1)


def _pair_as_met(one, other):
    return jnp.stack([_as_met(one), _as_met(other)], axis=1)


def _from_top(array):
    """The inverse of `_as_met`."""
    return jnp.stack([array[:, 0], array[::-1, 1]])


def diffuse_field(
    atmosphere: Atmosphere, scene: Scene, wavelength_nm: Float[Array, " wavelength"], resolution: Resolution
) -> tuple[Layers, Field]:
    """The layers and the light in them."""
    layers = layered(atmosphere, scene, wavelength_nm, resolution)
    _, modes = resolution.for_phases(atmosphere.constituents)
    return layers, solve(layers, resolution, modes)


def multiple_scattering(
    atmosphere: Atmosphere, scene: Scene, wavelength_nm: Float[Array, " wavelength"], resolution: Resolution
) -> Float[Array, "direction wavelength"]:
    """Radiance of second and higher orders toward an observer on the ground, per unit solar irradiance."""
    layers, field = diffuse_field(atmosphere, scene, wavelength_nm, resolution)
    count, modes = resolution.for_phases(atmosphere.constituents)
    view = scene.view
    cosine = jnp.maximum(jnp.cos(view.zenith), 0.0)
    turn = jnp.arange(modes)[:, None] * (view.azimuth - scene.sun_azimuth)[None]
    basis = harmonics(cosine, jnp.sin(view.zenith), count, modes) * jnp.cos(turn)[None, None]
    degree = degree_index(count, modes)
    # harmonics of a degree below the mode are zero
    some = np.nonzero(degree >= np.arange(modes))
    source = jnp.einsum("hd,hkw->kdw", basis[some], (layers.moments[degree] * field.moments)[some])
    airmass = layer_airmass(layers.height, cosine, resolution.geometry)
    radiance = _seen(source, layers.depth, airmass)
    return jnp.where(above_horizon(view.zenith)[:, None], radiance, 0.0)


@jax.custom_jvp
def _seen(
    source: Float[Array, "layer direction wavelength"],
    depth: Float[Array, "layer wavelength"],
    airmass: Float[Array, "layer direction"],
) -> Float[Array, "direction wavelength"]:
    """Radiance on the ground of what the layers send out along each view.

    Its tangents are sums over layers of derivatives that are the same for all of them and are formed once.
    """
    return _along_view(source, *_everywhere(source, depth, airmass))


def _everywhere(source, depth, airmass):
    return jnp.broadcast_to(depth[:, None], source.shape), jnp.broadcast_to(airmass[:, :, None], source.shape)


def _along_view(source, depth, airmass):
    slant = airmass * depth
    below = jnp.cumsum(slant[::-1], axis=0)[::-1] - slant
    first, second = phi_functions(slant)
    emitted = slant * (first * source - (0.5 * first - second) * sloped(source, depth))
    return jnp.sum(jnp.exp(-below) * emitted, axis=0)


@_seen.defjvp
def _seen_tangent(primals, tangents):
    radiance, backward = jax.vjp(_along_view, primals[0], *_everywhere(*primals))
    by_source, by_depth, by_airmass = backward(jnp.ones_like(radiance))
    source, depth, airmass = tangents
    tangent = jnp.einsum("kdw,kdw->dw", by_source, source)
    tangent += jnp.einsum("kdw,kw->dw", by_depth, depth)
    return radiance, tangent + jnp.einsum("kdw,kd->dw", by_airmass, airmass)
