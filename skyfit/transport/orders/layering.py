"""The atmosphere cut into layers for one sun, and the resolution at which streams solve them."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...atmosphere import AbstractConstituent, AbstractPhase
from ...scene import Scene
from ..columns import slant_columns, sunlit, TOP_OF_AIR
from ..contract import Geometry
from ..optics import Optics, optics, scatterer_indices


_HEIGHT_TABLE = 512


class Resolution(NamedTuple):
    """Resolution of the streams, all static: `streams` per hemisphere, Fourier `modes`, layers, sweeps (`orders`).

    With `complete`, delta-M scales the optics, and diffusion closes all orders that the sweeps do not reach. Without
    it, the phase functions are cut after their moments, and the light is that of `orders` orders alone. `polarised`:
    the solution is the vector radiance, found from its difference to the scalar one.
    """

    streams: int
    modes: int
    levels: int
    orders: int
    geometry: Geometry
    complete: bool = True
    polarised: bool = False

    def few(self, stokes: bool) -> "Few":
        """Resolution for polarisation, whose effect on the radiance is smooth and some per cent of the light.

        In haze, Q and U (`stokes`) need more moments and modes than the effect on the radiance does.
        """
        streams = (3 * self.streams + 3) // 4
        moments, modes = (2 * streams, 2 * streams) if stokes else (streams + 2, max(3, streams // 2))
        return Few(streams, moments, min(self.modes, modes), (2 * self.orders + 1) // 3)

    def coarse(self) -> "Resolution":
        """Resolution that shows how light changes with wavelength, at a tenth of the work: same layers, few streams."""
        return self._replace(
            streams=min(self.streams, 6), modes=min(self.modes, 4), orders=min(self.orders, 4), polarised=False
        )

    def check(self) -> None:
        """Raise a `ValueError` for more modes than the streams can carry."""
        # The range of `streams` refuses zero streams.
        if self.streams >= 1 and self.modes > 2 * self.streams:
            raise ValueError(f"`modes` must be at most 2 x `streams`, got {self.modes} for {self.streams}")

    def for_phases(self, constituents: tuple[AbstractConstituent, ...]) -> tuple[int, int]:
        """Numbers of moments and modes that these phase functions need: four and three for air alone."""
        if peaked(constituents):
            return 2 * self.streams, self.modes
        last = max(c.phase.last_degree or 0 for c in constituents if c.phase is not None)
        return min(2 * self.streams, 2 * (last // 2 + 1)), min(self.modes, last + 1)


def peaked(constituents: tuple[AbstractConstituent, ...]) -> list[tuple[int, AbstractPhase]]:
    """Indices and phase functions of the constituents without a last moment: delta-M cuts off their forward peak."""
    phases = enumerate(c.phase for c in constituents)
    return [(i, phase) for i, phase in phases if phase is not None and phase.last_degree is None]


class Few(NamedTuple):
    """Numbers of streams per hemisphere, moments of the scattering matrix, Fourier modes and sweeps."""

    streams: int
    moments: int
    modes: int
    orders: int


class Scaled(NamedTuple):
    """Optics as the streams use them; the scatterers' moments contain the factor 2 l + 1.

    `matrix`: moments alpha, gamma, zeta, None without polarisation. `modes`: the number that these phase functions
    need. `unscaled`: the whole optical depths, before delta-M.
    """

    extinction: Float[Array, "constituent wavelength"]
    scattering: Float[Array, "scatterer wavelength"]
    moments: Float[Array, "moment scatterer wavelength"]
    matrix: Float[Array, "element moment scatterer wavelength"] | None
    modes: int
    unscaled: Optics


class Layers(NamedTuple):
    """The layered problem of one sky, top to ground, per unit solar irradiance."""

    height: Float[Array, " level"]
    depth: Float[Array, "layer wavelength"]
    beam: Float[Array, "level wavelength"]
    beam_depth: Float[Array, "layer wavelength"]
    moments: Float[Array, "moment layer wavelength"]
    sun_zenith: Float[Array, ""]
    ground_albedo: Float[Array, " wavelength"]
    matrix: Float[Array, "element moment layer wavelength"] | None


def scaled_optics(
    constituents: tuple[AbstractConstituent, ...],
    wavelength_nm: Float[Array, " wavelength"],
    resolution: Resolution,
) -> Scaled:
    """Optical depths of the constituents and the first moments of the scatterers.

    With `resolution.complete`, delta-M scales them: the forward peak beyond the last moment counts as unscattered
    (Wiscombe 1977).
    """
    depth, (count, modes) = optics(constituents, wavelength_nm), resolution.for_phases(constituents)
    extinction, scattering, moments, matrices = [], [], [], []
    degree = jnp.asarray(2.0 * np.arange(count) + 1.0, wavelength_nm.dtype)

    # the forward peak keeps the polarisation
    kept = jnp.asarray([1.0, 0.0, 1.0], wavelength_nm.dtype)[:, None, None]
    for i, c in enumerate(constituents):
        if c.phase is None:
            extinction.append(depth.extinction[i])
            continue
        every = c.phase.moments(count + 1, wavelength_nm) + jnp.zeros_like(wavelength_nm)[None]
        peak = every[count] if resolution.complete else jnp.zeros_like(wavelength_nm)
        extinction.append(depth.extinction[i] - peak * depth.scattering[i])
        scattering.append((1.0 - peak) * depth.scattering[i])
        moments.append((every[:count] - peak[None]) / (1.0 - peak[None]))
        if resolution.polarised:
            matrix = c.phase.matrix_moments(count, wavelength_nm) - kept * peak[None, None]
            matrices.append(matrix / (1.0 - peak[None, None]))
    weighted = jnp.stack(moments, axis=1) * degree[:, None, None]
    matrix = jnp.stack(matrices, axis=2) * degree[None, :, None, None] if resolution.polarised else None
    return Scaled(jnp.stack(extinction), jnp.stack(scattering), weighted, matrix, modes, depth)


def level_heights(constituents: tuple[AbstractConstituent, ...], levels: int) -> Float[Array, " level"]:
    """Heights (m) of the levels, top to ground, at equal steps of the scatterers' mean share of column above."""
    scatterers = [c.profile for c in constituents if c.phase is not None]
    table = TOP_OF_AIR * (np.arange(_HEIGHT_TABLE + 1) / _HEIGHT_TABLE) ** 3
    height = jnp.asarray(table, jnp.result_type(float))
    share = jnp.mean(jnp.stack([p.column_above(height) for p in scatterers]), axis=0)
    share = (share - share[-1]) / (share[0] - share[-1])
    target = jnp.asarray(np.arange(levels + 1) / levels, height.dtype)[:, None]
    # Each step of the table counts up to the point where the share above has fallen to the target.
    fall = share[:-1] - share[1:]
    climbed = (share[None, :-1] - target) / jnp.where(fall > 0.0, fall, 1.0)[None]
    return jnp.clip(climbed, 0.0, 1.0) @ jnp.diff(height)


def depth_above(
    constituents: tuple[AbstractConstituent, ...],
    layers: "Layers",
    observer: Float[Array, ""],
    extinction: Float[Array, "constituent wavelength"],
) -> Float[Array, "layer wavelength"]:
    """Share of each layer's optical depth that lies above an observer, exactly 1 for an observer on the ground.

    **Arguments:** `observer`, height above the ground, m; `extinction`, the optical depths that made the layers.
    **Returns:** dimensionless, in [0, 1]; within a layer it is linear in the constituents' columns there.
    """
    above = jnp.stack([c.profile.column_above(layers.height[1:]) for c in constituents])
    upper = jnp.pad(above[:, :-1], ((0, 0), (1, 0)))
    here = jnp.stack([c.profile.column_above(observer) for c in constituents])[:, None]
    part = (jnp.clip(here, upper, above) - upper).T @ extinction
    filled = layers.depth > 0.0
    return jnp.clip(jnp.where(filled, part, 0.0) / jnp.where(filled, layers.depth, 1.0), 0.0, 1.0)


def layered(
    constituents: tuple[AbstractConstituent, ...],
    scene: Scene,
    scaled: Scaled,
    ground_albedo: Float[Array, " wavelength"],
    resolution: Resolution,
) -> Layers:
    """Cut the atmosphere into layers for one sun, over a ground of the given albedo."""
    height = level_heights(constituents, resolution.levels)
    # The little air above the top level belongs to the first layer.
    above = jnp.stack([c.profile.column_above(height[1:]) for c in constituents])
    share = jnp.diff(jnp.pad(above, ((0, 0), (1, 0))), axis=1)
    depth = share.T @ scaled.extinction
    scattered = jnp.stack([share[i] for i in scatterer_indices(constituents)])[:, :, None] * scaled.scattering[:, None]
    fraction = scattered / jnp.where(depth > 0.0, depth, 1.0)[None]
    sun_cosine = jnp.cos(scene.sun_zenith)
    cosine = sun_cosine + jnp.zeros_like(height)
    slant = slant_columns([c.profile for c in constituents], height, cosine, resolution.geometry)
    slant = jnp.where((np.arange(height.shape[0]) == 0)[None] & (sun_cosine >= 0.0), 0.0, slant)
    sun_depth = slant.T @ scaled.extinction
    lit = sunlit(height, cosine, resolution.geometry)
    return Layers(
        height,
        depth,
        jnp.where(lit[:, None], jnp.exp(-sun_depth), 0.0),
        jnp.maximum(jnp.diff(sun_depth, axis=0), 0.0),
        jnp.einsum("skw,lsw->lkw", fraction, scaled.moments),
        scene.sun_zenith,
        ground_albedo,
        None if scaled.matrix is None else jnp.einsum("skw,elsw->elkw", fraction, scaled.matrix),
    )
