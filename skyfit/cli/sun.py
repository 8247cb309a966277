"""The sun's position for a simulation, from its angles or from time and place."""

import numpy as np

from ..measured import solar_position
from ..measured.readers.header import moment_of
from .options import in_range


def sun_of(
    zenith: float | None, azimuth: float | None, time: str | None, at: str | None, pressure: float, lowest: float
) -> tuple[float, float, dict]:
    """Zenith angle and azimuth in degrees, and the fields of a `Sky` for time and place.

    **Arguments:** the options as given; `lowest`, the largest zenith angle in the model's range.
    """
    moment = np.datetime64("NaT", "ns") if time is None else moment_in("--time", time)
    about: dict = {"time": np.array([moment])}
    if at is None:
        if zenith is None:
            raise ValueError("`--sun-zenith`, or `--time` and `--at`, must be given")
        return in_range("--sun-zenith", zenith, 0.0, lowest), 180.0 if azimuth is None else azimuth, about
    if time is None or zenith is not None or azimuth is not None:
        raise ValueError("`--at` must come with `--time`, and without `--sun-zenith` and `--sun-azimuth`")
    latitude, longitude = _place(at)
    # Half of the refraction: light of straight rays is then closest to that of refracted rays (see `solar_position`)
    found = solar_position(about["time"], latitude, longitude, pressure=pressure, refracted=0.5)
    zenith, azimuth = (round(float(np.degrees(angle[0])), 10) for angle in found)
    in_range("--time and --at: sun zenith", zenith, 0.0, lowest)
    return zenith, azimuth, about | {"latitude_deg": latitude, "longitude_deg": longitude}


def seen_at(zenith: float, time: str | None, at: str | None, pressure: float) -> float:
    """Refracted zenith angle of the sun of `sun_of`, degrees; without time and place the given angle."""
    if time is None or at is None:
        return zenith
    found, _ = solar_position(np.array([moment_in("--time", time)]), *_place(at), pressure=pressure)
    return round(float(np.degrees(found[0])), 10)


def moment_in(name: str, text: str) -> np.datetime64:
    """The time of an option."""
    try:
        return moment_of(text.strip())
    except ValueError:
        raise ValueError(f"`{name}` must be an ISO time in UTC such as 2013-05-27T14:00:00Z, got {text!r}") from None


def _place(text: str) -> tuple[float, float]:
    try:
        latitude, longitude = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"`--at` must be LAT,LON in degrees, north and east positive, got {text!r}") from None
    return in_range("--at latitude", latitude, -90.0, 90.0), in_range("--at longitude", longitude, -180.0, 360.0)
