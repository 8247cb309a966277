"""All that can be fitted: the atmosphere and the instrument."""

import equinox as eqx
from jaxtyping import Array, Float

from ..atmosphere import Atmosphere
from ..numerics import as_float
from ..scene import Scene


class Instrument(eqx.Module):
    """Where the instrument really looked: offsets of the sun in its frame, radians."""

    pointing_zenith: Float[Array, ""] = eqx.field(converter=as_float, default=0.0)
    pointing_azimuth: Float[Array, ""] = eqx.field(converter=as_float, default=0.0)

    def sees(self, scene: Scene) -> Scene:
        """The scene as it stands in the instrument's frame."""
        moved = scene.sun_zenith + self.pointing_zenith, scene.sun_azimuth + self.pointing_azimuth
        return eqx.tree_at(lambda s: (s.sun_zenith, s.sun_azimuth), scene, moved)


class SkyModel(eqx.Module):
    """All that can be fitted: the atmosphere and the instrument."""

    atmosphere: Atmosphere
    instrument: Instrument = eqx.field(default_factory=Instrument)
