"""Mask samples of a sky that a user leaves out."""

from dataclasses import replace

import numpy as np

from .quality.placed_sun import cosine_from_sun
from .samples import Sky


def mask_sun(sky: Sky, angle: float) -> Sky:
    """Mask the samples within an angle of the sun, with a reason of their own.

    **Arguments:** `angle`, radians, 0 to pi. **Returns:** a `Sky` whose other samples are unchanged.
    """
    if not 0.0 <= angle <= np.pi:
        raise ValueError(f"`angle` must be between 0 and pi rad, got {angle:g}")
    sun = [one if one.ndim == 2 else one[:, None] for one in (sky.sun_zenith, sky.sun_azimuth)]
    zenith, azimuth = sky.views
    if zenith.ndim == 2:
        zenith, azimuth = zenith[..., None], azimuth[..., None]
    cosine = cosine_from_sun(zenith, azimuth, *(one[:, None] for one in sun))
    near = np.broadcast_to(cosine > np.cos(angle), sky.usable.shape) & sky.usable
    if not near.any():
        return sky
    counts = sky.masked | {f"within {np.degrees(angle):g} degrees of the sun": int(near.sum())}
    known = np.full(sky.usable.shape, -1) if sky.reason is None else sky.reason
    # if other samples are masked for reasons that are not known, no reasons are held
    reason = np.where(near, len(counts) - 1, known) if sky.reason is not None or not sky.masked else None
    return replace(sky, usable=sky.usable & ~near, masked=counts, reason=reason)
