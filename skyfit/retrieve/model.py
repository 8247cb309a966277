"""All that can be fitted: the atmosphere and the instrument."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..atmosphere import Atmosphere
from ..numerics import as_float
from ..scene import Scene


class Instrument(eqx.Module):
    """How its frame is turned: its views are stated so many radians too far from the zenith and clockwise."""

    pointing_zenith: Float[Array, ""] = eqx.field(converter=as_float, default=0.0)
    pointing_azimuth: Float[Array, ""] = eqx.field(converter=as_float, default=0.0)

    def sees(self, scene: Scene) -> Scene:
        """The scene with the views where they really were; none leaves the sky, and the sun stands."""
        zenith, azimuth = scene.view.zenith - self.pointing_zenith, scene.view.azimuth - self.pointing_azimuth
        beyond = zenith < 0.0
        azimuth = jnp.where(beyond, azimuth + np.pi, azimuth)
        zenith = jnp.where(beyond, -zenith, zenith)
        zenith = jnp.where(scene.view.zenith <= 0.5 * np.pi, jnp.minimum(zenith, 0.5 * np.pi), zenith)
        return eqx.tree_at(lambda s: (s.view.zenith, s.view.azimuth), scene, (zenith, azimuth))


class SkyModel(eqx.Module):
    """All that can be fitted: the atmosphere and the instrument."""

    atmosphere: Atmosphere
    instrument: Instrument = eqx.field(default_factory=Instrument)
