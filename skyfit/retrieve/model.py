"""All that can be fitted: the atmosphere and the instrument."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..atmosphere import Atmosphere
from ..numerics import as_float
from ..scene import Scene


class Instrument(eqx.Module):
    """The rotation of the instrument's frame and the offset of its sun, radians.

    `pointing_zenith`, `pointing_azimuth`: how much too far from the zenith and too far clockwise the views are stated.
    `sun_zenith`: how much farther from the zenith the sun is than stated.
    """

    pointing_zenith: Float[Array, ""] = eqx.field(converter=as_float, default=0.0)
    pointing_azimuth: Float[Array, ""] = eqx.field(converter=as_float, default=0.0)
    sun_zenith: Float[Array, ""] = eqx.field(converter=as_float, default=0.0)

    def sees(self, scene: Scene) -> Scene:
        """The scene with the true views and the true sun; those stated in the sky stay above the horizon."""
        zenith, azimuth = scene.view.zenith - self.pointing_zenith, scene.view.azimuth - self.pointing_azimuth
        beyond = zenith < 0.0
        azimuth = jnp.where(beyond, azimuth + np.pi, azimuth)
        zenith = jnp.where(beyond, -zenith, zenith)
        zenith = jnp.where(scene.view.zenith <= 0.5 * np.pi, jnp.minimum(zenith, 0.5 * np.pi), zenith)
        sun = jnp.maximum(scene.sun_zenith + self.sun_zenith, 0.0)
        sun = jnp.where(scene.sun_zenith <= 0.5 * np.pi, jnp.minimum(sun, 0.5 * np.pi), sun)
        return eqx.tree_at(lambda s: (s.view.zenith, s.view.azimuth, s.sun_zenith), scene, (zenith, azimuth, sun))


class SkyModel(eqx.Module):
    """All that can be fitted: the atmosphere and the instrument."""

    atmosphere: Atmosphere
    instrument: Instrument = eqx.field(default_factory=Instrument)
