"""Check whether the sun that a file states agrees with its time and place."""

import numpy as np
from jaxtyping import Float, Shaped

from ..solar_position import solar_position
from .placed_sun import cosine_from_sun


# tolerances in degrees. Instruments are turned by several degrees, and mounts lean by less; an hour moves the sun by 7
# and more
_AZIMUTH_SLACK, _ZENITH_SLACK = 10.0, 3.0
# a cause is named if it brings the two suns this near, degrees
_NEAR = 2.0
_CLOCKS = [hours for hours in range(-12, 15) if hours]


def sun_agreement(
    zenith: Float[np.ndarray, " time"],
    azimuth: Float[np.ndarray, " time"],
    time: Shaped[np.ndarray, " time"],
    latitude: float,
    longitude: float,
    turned: bool = False,
) -> str:
    """Return a sentence if the stated sun is not that of time and place, "" if they agree.

    **Arguments:** stated `zenith` and `azimuth`, degrees; `time` UTC; `latitude`, `longitude`, degrees; `turned`:
    azimuths are in the instrument's frame, which the place does not determine.
    **Returns:** the largest angle between the two, and what would explain it: another clock, latitude and longitude
    exchanged, elevations in place of zenith angles, azimuths from south or counter-clockwise.
    **Valid:** 10 degrees apart, or 3 in zenith angle, count as agreement: less is refraction, or a leaning mount.
    """

    def computed(hours=0, north=latitude, east=longitude):
        angles = solar_position(time + np.timedelta64(hours, "h"), north, east)
        return np.rad2deg(angles[0]), np.rad2deg(angles[1])

    true_zenith, true_azimuth = computed()
    off = np.abs(zenith - true_zenith)
    apart = off if turned else _apart((zenith, azimuth), (true_zenith, true_azimuth))
    if np.max(off) <= _ZENITH_SLACK and (turned or np.max(apart) <= _AZIMUTH_SLACK):
        return ""
    causes = {
        "elevations in place of zenith angles": (90.0 - zenith, azimuth),
        "azimuths counted from south": (zenith, azimuth + 180.0),
        "azimuths counted counter-clockwise": (zenith, -azimuth),
        "radians": (np.rad2deg(zenith), np.rad2deg(azimuth)),
    }
    explained = {name: (angles, (true_zenith, true_azimuth)) for name, angles in causes.items()}
    if abs(longitude) <= 90.0:
        exchanged = computed(north=longitude, east=latitude)
        explained["latitude and longitude exchanged"] = (zenith, azimuth), exchanged
    explained |= {f"times of UTC{hours:+d} h": ((zenith, azimuth), computed(-hours)) for hours in _CLOCKS}
    cause = "times that are not UTC, another place, or angles of another kind"
    for name, (stated, expected) in explained.items():
        if not turned and np.max(_apart(stated, expected)) < _NEAR:
            cause = name
            break
    worst = int(np.argmax(apart))
    return (
        f"the stated sun is {apart[worst]:.0f} degrees from where time and place put it (zenith "
        f"{true_zenith[worst]:.1f}, azimuth {true_azimuth[worst]:.1f}): {cause}?"
    )


def _apart(one, other):
    """The angle between two directions, each zenith and azimuth in degrees; degrees."""
    cosine = cosine_from_sun(*np.deg2rad(one), *np.deg2rad(other))
    return np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))
