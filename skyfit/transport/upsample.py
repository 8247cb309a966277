"""Spatial coherence: a solver solves few directions, and the smooth sky between them is interpolated."""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..atmosphere import Atmosphere
from ..numerics import chebyshev_nodes, chebyshev_weights, cubic, hat_weights
from ..scene import above_horizon, Directions, haversine, Scene
from .columns import exponential_nodes, slant_columns
from .contract import AbstractSolver, check_on_ground, check_scene, Geometry
from .optics import optics


# Zenith angle (rad) at which the grid ends: the radiance of a flat solver is not smooth in the last degrees.
_EDGE = {"flat": np.radians(88.0), "spherical": 0.5 * np.pi}
# How much the nodes crowd toward the horizon; number of heights in a scatterer's mean sunlight.
_CROWDING, _HEIGHTS = 1.3, 8
# Number of directions evaluated at once: their weights take 1.1 kB each, twice. For more directions, the numbers of
# zenith angles and azimuths in a table of the interpolant: cubics in the table are within 2e-5 of it.
_CHUNK, _FINE = 32768, (257, 129)
# Radiance (W m^-2 sr^-1 nm^-1) below which light counts as black.
_DARK = 1e-30


class Upsampled(NamedTuple):
    """An interpolated sky, `[direction, wavelength]` each.

    `radiance`, W m^-2 sr^-1 nm^-1; `error`, the estimated relative error that interpolation adds to the solver's own;
    it has no gradient.
    """

    radiance: Float[Array, "direction wavelength"]
    error: Float[Array, "direction wavelength"]


def upsample(
    solver: AbstractSolver, atmosphere: Atmosphere, scene: Scene, zeniths: int = 20, azimuths: int = 14
) -> Upsampled:
    r"""Interpolate the sky of any solver to many directions from a solution in few.

    $\ln L = \ln \bar p(\gamma) + \sum_{k,m} a_{km} T_k(x(\theta)) \cos m\phi$, $\theta = \theta_1 \tanh(cx)/\tanh c$

    $\bar p$ is the mean phase function, weighted by the sunlight that each constituent scatters, so that the grid
    need not resolve the aureole; $\phi$ is the azimuth from the sun. The sky is the same left and right of the
    sun, and $L(-\theta, \phi) = L(\theta, \pi - \phi)$, so that the polynomials in x span the whole arc from
    horizon to horizon (k + m even) and nodes crowd its ends, not the zenith.

    The solver solves `zeniths * azimuths` directions, whatever the number that is asked for: by default 280, 1/29 of
    the 8192 pixels of Klassen's 128 x 64 picture and 1/234 of those of a 256 x 256 dome. The interpolation costs the
    phase functions and the product of a [direction, 280] by a [280, wavelength] matrix. Beyond 32768 directions cubics
    in a table of that product replace it, 2e-5 off. For fewer than 280 directions call the solver itself.

    The error of the interpolant without its highest quarter of coefficients, in zenith and in azimuth, is known at the
    nodes. The estimated error is its largest value among a node and its neighbours, linear between nodes. It is a bound
    in 95 % of directions where the grid resolves the sky; where errors reach some per cent, it is half a bound.

    **Arguments:** `solver`, anything with `radiance` and `geometry`; `zeniths` >= 4 and `azimuths` >= 4, nodes.
    **Returns:** `Upsampled`. **Valid:** the observer on the ground, and skies that are smooth apart from the phase
    function of the haze. Flat: view zenith to 88 degrees; nearer to the horizon the last value is held with an error
    of 1. Directions below the horizon and black skies are 0, with error 0. The error found is at most 1 %, median below
    0.02 %, at view zenith to 85 degrees, sun 20 to 85 and optical depth of haze 0.05 and 0.4. At sun 85 and an optical
    depth of 0.6 it is 1.9 and 0.03 %.
    **Source:** Klassen 1987, sec. 8. He integrates anew where the angle has changed by a threshold and repeats the
    colour between; here the threshold is replaced by an interpolant, which has no bands, and its error.
    """
    check_scene(solver, atmosphere, scene)
    return _upsampled(solver, atmosphere, scene, zeniths, azimuths)


@eqx.filter_jit
def _upsampled(solver: AbstractSolver, atmosphere: Atmosphere, scene: Scene, zeniths: int, azimuths: int) -> Upsampled:
    check_on_ground(scene, "upsample")
    if zeniths < 4 or azimuths < 4:
        raise ValueError(f"`zeniths` and `azimuths` must be >= 4, got {zeniths} and {azimuths}")
    grid = _Grid(zeniths, azimuths, solver.geometry)
    places, turns = (jnp.asarray(v, scene.sun_zenith.dtype) for v in grid.nodes())
    coarse = replace(scene, view=grid.directions(places, turns, scene.sun_azimuth))
    values = solver.radiance(atmosphere, coarse)
    dark = values < _DARK
    smooth = jnp.log(jnp.where(dark, _DARK, values)) - _log_phase(atmosphere, coarse, solver.geometry)
    # The weights sum to 1. Relative to the largest value, float32 loses nothing and the sky cannot overflow.
    top = jax.lax.stop_gradient(jnp.max(smooth, axis=0))[None]
    smooth = smooth - top

    missed = grid.missed(places, turns, jax.lax.stop_gradient(smooth))

    def served(view: Directions, at) -> Upsampled:
        zenith = view.zenith
        exponent, error = at(zenith, view.azimuth - scene.sun_azimuth)
        log_phase = _log_phase(atmosphere, replace(scene, view=view), solver.geometry)
        radiance = jnp.exp(jnp.minimum(exponent, 1.0) + top + log_phase)
        rounding = 30.0 * jnp.finfo(error.dtype).eps
        error = jnp.where((zenith > grid.edge + 1e-6)[:, None], 1.0, error + rounding)
        lit = above_horizon(zenith)[:, None] & ~jnp.all(dark, axis=0)[None]
        return Upsampled(jnp.where(lit, radiance, 0.0), jnp.where(lit, jax.lax.stop_gradient(error), 0.0))

    def by_weights(zenith, azimuth):
        place, turn = grid.place(zenith), jnp.cos(azimuth)
        return grid.weights(place, turn) @ smooth, grid.hats(place, turn) @ missed

    count = scene.view.zenith.shape[0]
    if count <= _CHUNK:
        return served(scene.view, by_weights)
    by_table = grid.tabled(smooth, missed)
    blocks = -(-count // _CHUNK)
    filled = jax.tree.map(lambda v: jnp.pad(v, (0, blocks * _CHUNK - count), "edge").reshape(blocks, -1), scene.view)
    # A gradient computes each block again, so that it needs the memory of one block only.
    found = jax.lax.map(jax.checkpoint(lambda view: served(view, by_table)), filled)
    return jax.tree.map(lambda v: v.reshape(-1, v.shape[-1])[:count], found)


class _Grid(NamedTuple):
    """Nodes over half of the sky: `place` in (0, 1] is x of the zenith angle, `turn` the cosine of the azimuth."""

    zeniths: int
    azimuths: int
    geometry: Geometry

    @property
    def edge(self) -> float:
        return float(_EDGE[self.geometry])

    def nodes(self):
        places, turns = chebyshev_nodes(2 * self.zeniths)[self.zeniths :], chebyshev_nodes(self.azimuths)
        return (v.ravel() for v in np.meshgrid(places, turns, indexing="ij"))

    def directions(self, place, turn, sun_azimuth):
        zenith = self.edge * jnp.tanh(_CROWDING * place) / np.tanh(_CROWDING)
        return Directions(zenith, sun_azimuth + jnp.arccos(turn))

    def place(self, zenith):
        # The limit is past the edge by rounding only, so that the gradient on the edge is whole.
        share = jnp.where(zenith < self.edge + 1e-6, zenith / self.edge, 1.0)
        return jnp.arctanh(np.tanh(_CROWDING) * share) / _CROWDING

    def weights(self, place, turn, up: int | None = None, around: int | None = None):
        """Weights `[direction, node]` of the interpolant, with `up` and `around` coefficients kept."""
        along = chebyshev_weights(place, 2 * self.zeniths, up)
        across = chebyshev_weights(turn, self.azimuths, around)
        # Nodes beyond the zenith are nodes of this side with the azimuth reversed.
        here, beyond = along[:, self.zeniths :], along[:, self.zeniths - 1 :: -1]
        both = here[:, :, None] * across[:, None, :] + beyond[:, :, None] * across[:, None, ::-1]
        return both.reshape(place.shape[0], -1)

    def hats(self, place, turn):
        """Weights `[direction, node]` of linear interpolation; all positive."""
        places, turns = chebyshev_nodes(2 * self.zeniths)[self.zeniths :], chebyshev_nodes(self.azimuths)
        along = hat_weights(place, jnp.asarray(places, place.dtype))
        across = hat_weights(turn, jnp.asarray(turns, turn.dtype))
        return (along[:, :, None] * across[:, None, :]).reshape(place.shape[0], -1)

    def tabled(self, smooth, missed):
        """Make the function that gives the interpolant and its error from a table of both."""
        polar, azimuth = (np.linspace(0.0, end, n) for end, n in zip((0.5 * np.pi, np.pi), _FINE, strict=True))
        every = np.meshgrid(np.cos(polar), np.cos(azimuth), indexing="ij")
        places, turns = (jnp.asarray(v.ravel(), smooth.dtype) for v in every)
        values = [self.weights(places, turns) @ smooth, self.hats(places, turns) @ missed]
        table = jnp.concatenate(values, axis=1).reshape(*_FINE, -1)

        def at(zenith, azimuth):
            # Stay just short of the end of the polar angle, where its slope is infinite.
            polar = jnp.arccos(jnp.minimum(self.place(zenith), 1.0 - 1e-6))
            turned = jnp.mod(azimuth, 2.0 * np.pi)
            turned = jnp.minimum(turned, 2.0 * np.pi - turned)
            first, along = cubic(polar * ((_FINE[0] - 1) / (0.5 * np.pi)), _FINE[0])
            second, across = cubic(turned * ((_FINE[1] - 1) / np.pi), _FINE[1])
            around = jax.vmap(lambda i, j: jax.lax.dynamic_slice(table, (i, j, 0), (4, 4, table.shape[2])))
            found = jnp.einsum("id,jd,dijw->dw", jnp.stack(along), jnp.stack(across), around(first, second))
            exponent, error = jnp.split(found, 2, axis=1)
            return exponent, jnp.maximum(error, 0.0)

        return at

    def missed(self, places, turns, smooth):
        """Error about each node of the interpolant with three quarters of its coefficients, `[node, wavelength]`."""
        up, around = 2 * self.zeniths - self.zeniths // 2, self.azimuths - max(1, self.azimuths // 4)
        miss = jnp.abs(smooth - self.weights(places, turns, up=up) @ smooth)
        miss = miss + jnp.abs(smooth - self.weights(places, turns, around=around) @ smooth)
        shape = self.zeniths, self.azimuths, smooth.shape[1]
        padded = jnp.pad(miss.reshape(shape), ((1, 1), (1, 1), (0, 0)), "edge")
        near = [padded[i : i + shape[0], j : j + shape[1]] for i in range(3) for j in range(3)]
        return jnp.max(jnp.stack(near), axis=0).reshape(smooth.shape)


def _log_phase(atmosphere: Atmosphere, scene: Scene, geometry: Geometry) -> Float[Array, "direction wavelength"]:
    """Log of the mean phase function, weighted by the sunlight that each constituent scatters, in arbitrary scale."""
    constituents, wavelength = atmosphere.constituents, scene.wavelength_nm
    depths = optics(constituents, wavelength)
    each = zip(constituents, depths.scattering, strict=True)
    scatterers = [(c, phase, depth) for c, depth in each if (phase := c.phase) is not None]
    total = jnp.zeros((scene.view.zenith.shape[0], wavelength.shape[0]), wavelength.dtype)
    if not scatterers:
        return total
    y, weight = (jnp.asarray(v, wavelength.dtype) for v in exponential_nodes(_HEIGHTS))
    height = jnp.stack([c.profile.reach() * y for c, *_ in scatterers])
    cosine = jnp.cos(scene.sun_zenith) + jnp.zeros_like(height)
    column = jnp.moveaxis(slant_columns([c.profile for c in constituents], height, cosine, geometry), 0, -1)
    depth = column @ depths.extinction
    sunlight = jnp.exp(jnp.min(depth, axis=(0, 1))[None, None] - depth)
    half = haversine(scene.view.zenith, scene.sun_zenith, scene.view.azimuth - scene.sun_azimuth)
    for (c, phase, scattering), levels, light in zip(scatterers, height, sunlight, strict=True):
        share = weight * c.profile.reach() * c.profile.density(levels)
        total = total + phase.at_haversine(half, wavelength) * (scattering * (share @ light))[None]
    return jnp.log(jnp.where(total > 0.0, total, 1.0))
