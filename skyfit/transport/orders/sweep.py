"""Sweeps through layers: radiance on discrete streams, down and up, from sources that are linear within each layer."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...numerics import exp_mean, phi1, phi_functions
from ..columns import stream_paths
from ..contract import Geometry


def sloped(source: Float[Array, "layer ..."], depth: Float[Array, "layer ..."]) -> Float[Array, "layer ..."]:
    """Change of a source from the first to the last end of each layer, from the means of its neighbours.

    `depth` has the rank of `source`. The change is reduced in thick layers, where a straight line through means would
    turn negative.
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
    """How light passes and leaves layers, in the order in which it meets them; made by `sweeps_through`.

    Axes of radiance and sources: direction of travel (down, up), layer from the top, mode, stream, wavelength. The mode
    axis may hold other quantities too. `through`, `emits` and `leans` are pairs: their contribution to the light that
    leaves a layer and to the mean light in it. `through` weights the light that enters, `emits` the layer's source,
    `leans` the step of that source along the way. `turns` interpolates to other local angles.
    """

    slant: Float[Array, "layer direction stream wavelength"]
    thickness: Float[Array, "layer direction mode stream wavelength"]
    turns: Float[Array, "layer direction stream stream"] | None
    through: Float[Array, "layer pair direction stream wavelength"]
    emits: Float[Array, "layer pair direction stream wavelength"]
    leans: Float[Array, "layer pair direction stream wavelength"]

    def of_source(self, source):
        """Contribution of a source to the light that leaves each layer and to its mean there, for `run`."""
        met = _as_met(source)
        step = sloped(met, self.thickness)
        return self.emits[:, :, :, None] * met[:, None] + self.leans[:, :, :, None] * step[:, None]

    def of_beam(self, source, beam_depth: Float[Array, "layer wavelength"]):
        """As `of_source`, for a source that falls exponentially by `beam_depth` from its value at each layer's top."""
        beam = _both_as_met(beam_depth)[:, :, None]
        down, up = self.slant[:, 0], self.slant[:, 1]
        mean = jnp.stack([exp_mean(beam[:, 0] + jnp.zeros_like(down), down), phi1(beam[:, 1] + up)], axis=1)
        weights = jnp.stack([self.slant * mean, phi1(beam) - mean], axis=1)
        return weights[:, :, :, None] * _as_met(source)[:, None]

    def run(self, emission):
        """Radiance that leaves the last layer, and its mean in each layer from the top, down and up."""
        last, mean = self._run(jnp.zeros_like(emission[0, 0]), emission)
        return last, mean[:, 0], mean[::-1, 1]

    def shine(self):
        """Radiance at the top, and mean upward radiance in each layer, from a ground that reflects a unit of flux."""
        start = jnp.asarray(np.array([0.0, 1.0 / np.pi])[:, None, None, None], self.slant.dtype)
        last, mean = self._run(start + jnp.zeros_like(self.slant[0, :, None]), None)
        return last[1, 0], mean[::-1, 1]

    def _run(self, start, emission):
        def step(radiance, layer):
            through, turn, emitted = layer
            if turn is not None:
                radiance = jnp.einsum("dij,dmjw->dmiw", turn, radiance)
            both = through[:, :, None] * radiance[None]
            both = both if emitted is None else both + emitted
            return both[0], both[1]

        return jax.lax.scan(step, start, (self.through, self.turns, emission))


def sweeps_through(
    height: Float[Array, " level"],
    depth: Float[Array, "layer wavelength"],
    cosine: Float[Array, " stream"],
    geometry: Geometry,
) -> Sweeps:
    """The sweeps of some streams, `cosine` increasing, through layers from top to ground."""
    paths = stream_paths(height, cosine, geometry)
    thickness = _both_as_met(depth)
    slant = _as_met([p.airmass for p in paths])[..., None] * thickness[:, :, None]
    first, second = phi_functions(slant)
    lean = 0.5 * first - second
    bends = [path.turn for path in paths if path.turn is not None]
    return Sweeps(
        slant,
        thickness[:, :, None, None],
        _as_met(bends) if bends else None,
        jnp.stack([jnp.exp(-slant), first], axis=1),
        jnp.stack([slant * first, slant * second], axis=1),
        jnp.stack([-slant * lean, lean], axis=1),
    )


def _as_met(array):
    """`[direction, layer from the top, ...]` to `[layer in the order met, direction, ...]`."""
    return jnp.stack([array[0], array[1][::-1]], axis=1)


def _both_as_met(array):
    """As `_as_met`, for an array that is the same in both directions."""
    return _as_met([array, array])
