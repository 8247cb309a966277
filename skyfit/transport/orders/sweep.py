"""Sweeps through layers: radiance on discrete streams, down and up, of sources that are linear within each layer."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...numerics import exp_mean, phi1, phi_functions
from ..columns import stream_paths
from ..contract import Geometry


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


class Sweeps(NamedTuple):
    """How light passes and leaves layers, in the order in which it meets them; from `sweeps_through`.

    Axes of radiance and sources: direction of travel (down, up), layer from the top, mode, stream, wavelength; those
    of modes may stand for other quantities too. `through`, `emits`, `leans`: what leaves a layer and its mean, of what
    enters it, of its source and of the source's step along the way. `turns` interpolates to other local angles.
    """

    slant: Float[Array, "direction layer stream wavelength"]
    thickness: Float[Array, "layer direction mode stream wavelength"]
    turns: Float[Array, "layer direction stream stream"] | None
    through: Float[Array, "layer pair direction stream wavelength"]
    emits: Float[Array, "layer pair direction stream wavelength"]
    leans: Float[Array, "layer pair direction stream wavelength"]

    def of_source(self, source):
        """Radiance that leaves the last layer, and its mean in each layer from the top."""
        met = _as_met(source)
        return self._run(jnp.zeros_like(met[0]), self.emits, met, sloped(met, self.thickness))

    def of_beam(self, source, beam_depth: Float[Array, "layer wavelength"]):
        """As `of_source`, of a source that falls exponentially by `beam_depth` from its value at each layer's top."""
        beam = beam_depth[:, None] + jnp.zeros_like(self.slant[0])
        mean = jnp.stack([exp_mean(beam, self.slant[0]), phi1(beam + self.slant[1])])
        met = _as_met(source)
        weights = _pair_as_met(self.slant * mean, phi1(beam)[None] - mean)
        return self._run(jnp.zeros_like(met[0]), weights, met, None)

    def shine(self):
        """What leaves the top, and the mean upward radiance, of a ground that reflects a unit of flux."""
        _, layers, streams, wavelengths = self.slant.shape
        nothing = jnp.zeros((layers, 2, 1, streams, wavelengths), self.slant.dtype)
        top, mean = self._run(nothing[0].at[1].set(1.0 / np.pi), self.emits, nothing, None)
        return top[1, 0], mean[1, :, 0]

    def _run(self, start, weights, source, rise):
        def step(radiance, layer):
            pass_on, turn, weight, lean, level, change = layer
            if turn is not None:
                radiance = jnp.einsum("dij,dmjw->dmiw", turn, radiance)
            leaves, mean = weight[:, :, None] * level[None] + pass_on[:, :, None] * radiance[None]
            if change is not None:
                leaves, mean = leaves + lean[0, :, None] * change, mean + lean[1, :, None] * change
            return leaves, mean

        last, mean = jax.lax.scan(step, start, (self.through, self.turns, weights, self.leans, source, rise))
        return last, _from_top(mean)


def sweeps_through(
    height: Float[Array, " level"],
    depth: Float[Array, "layer wavelength"],
    cosine: Float[Array, " stream"],
    geometry: Geometry,
) -> Sweeps:
    """The sweeps of some streams, `cosine` increasing, through layers from top to ground."""
    paths = stream_paths(height, cosine, geometry)
    slant = jnp.stack([p.airmass for p in paths])[..., None] * depth[None, :, None]
    first, second = phi_functions(slant)
    lean = 0.5 * first - second
    bends = [path.turn for path in paths if path.turn is not None]
    return Sweeps(
        slant,
        _as_met(jnp.stack([depth, depth]))[:, :, None, None],
        _as_met(jnp.stack(bends)) if bends else None,
        _pair_as_met(jnp.exp(-slant), first),
        _pair_as_met(slant * first, slant * second),
        _pair_as_met(-slant * lean, lean),
    )


def _as_met(array):
    """`[direction, layer from the top, ...]` to `[layer in the order met, direction, ...]`."""
    return jnp.stack([array[0], array[1, ::-1]], axis=1)


def _pair_as_met(one, other):
    return jnp.stack([_as_met(one), _as_met(other)], axis=1)


def _from_top(array):
    """The inverse of `_as_met`."""
    return jnp.stack([array[:, 0], array[::-1, 1]])
