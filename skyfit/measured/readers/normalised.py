"""Convert radiance that files give as a share of the sun's irradiance, and not in watts."""

from dataclasses import replace

import numpy as np

from ...light.solar import SPECTRUM_NM
from ..samples import Sky
from ..station import sun_factor


# names of pi L / E0, which is dimensionless, or of L / E0, which has one of the units `_PER_SUN`
NAMES = ("normalized_radiance", "normalised_radiance")
_DIMENSIONLESS = ("1", "", "none", "dimensionless", "unitless")
_PER_SUN = ("sr-1", "sr^-1", "1/sr", "/sr", "sr⁻¹", "1 / sr")


def normalised_name(names) -> str | None:
    """The name of the normalised radiance in a file without `radiance`; None if there is none."""
    if "radiance" in names:
        return None
    return next((name for name in names if str(name).lower() in NAMES), None)


def share_of(units: str | None, normalised: bool) -> float | None:
    """The factor that makes a sample a share of the sun's irradiance per steradian.

    **Arguments:** `units` of the samples; `normalised`: whether their name says that they are normalised.
    **Returns:** 1 for L / E0, 1/pi for pi L / E0; None for samples in watts.
    **Errors:** `ValueError` for samples that are named normalised in another unit.
    """
    plain = "" if units is None else " ".join(units.split()).lower()
    if plain in _PER_SUN:
        return 1.0
    if not normalised:
        return None
    if plain not in _DIMENSIONLESS:
        raise ValueError(f"expected units 1 (pi L / E0) or sr-1 (L / E0) of a normalised radiance, found {units!r}")
    return 1.0 / np.pi


def in_sunlight(sky: Sky, share: float) -> Sky:
    """Multiply a sky's samples by `share` and the sun's irradiance, which gives W m^-2 sr^-1 nm^-1.

    A fit takes the same spectrum, line shape and distance of the sun on the day, so that they cancel in it. Samples
    beyond the sun's table, 300-1100 nm, are masked.
    """
    own = sky.wavelength_nm
    known = (own >= SPECTRUM_NM[0]) & (own <= SPECTRUM_NM[1])
    sunlight = np.full(own.shape, np.nan)
    sunlight[known] = sky.seen.sunlight(own[known])
    scale = share * sun_factor(sky)[0][:, None, None] * sunlight
    lost = sky.usable & ~known
    masked, reason = dict(sky.masked), sky.reason
    if lost.any():
        masked["beyond the sun's table"] = int(lost.sum())
        reason = None if reason is None else np.where(lost, len(masked) - 1, reason)
    note = "normalised radiance times the sun's irradiance of ASTM G173 on that day"
    return replace(
        sky,
        radiance=sky.radiance * scale,
        sigma=None if sky.sigma is None else sky.sigma * scale,
        usable=sky.usable & known,
        masked=masked,
        reason=reason,
        notes=(*sky.notes, note),
    )
