"""The position of the sun from time and place."""

import numpy as np
from jaxtyping import Float, Shaped

from ..extras import require


# true elevation of a sun whose upper edge is seen at the horizon: the source gives refraction down to it
_SETTING_DEG = -0.83337


def solar_position(
    time: Shaped[np.ndarray, " time"],
    latitude: float | int,
    longitude: float | int,
    altitude: float | int = 0.0,
    pressure: float | int | None = None,
    refracted: float = 1.0,
) -> tuple[Float[np.ndarray, " time"], Float[np.ndarray, " time"]]:
    """Apparent zenith angle and azimuth of the sun.

    The zenith angle is the apparent one, with refraction: it is where an instrument sees the sun.
    Refraction is 0.02 degrees at zenith angle 45 and 0.5 at the horizon. After sunset it keeps its value at sunset.

    **Arguments**

    - `time`: datetime64, UTC, [time]
    - `latitude`, `longitude`: degrees, north and east positive
    - `altitude`: m above sea level
    - `pressure`: Pa, for the refraction; that of the standard atmosphere at `altitude` if None
    - `refracted`: the share of the refraction that counts. With one half of it, the light of a low sun along straight
      rays is nearest to that along bent rays (experiments/results/refraction.json)

    **Returns** zenith and azimuth (clockwise from north), rad, [time].

    **Valid** years 1678 to 2261; NaT is a `ValueError`.

    **Source** NREL's solar position algorithm (Reda and Andreas 2004), as in pvlib; refraction: its eq. 42.
    """
    require("pandas", "pvlib")
    import pandas
    from pvlib.atmosphere import alt2pres
    from pvlib.solarposition import get_solarposition

    time = np.asarray(time).astype("datetime64[ns]")
    if np.any(np.isnat(time)):
        raise ValueError("`time` must be known (UTC) for the sun's position, found NaT")
    if not -90.0 <= latitude <= 90.0:
        raise ValueError(f"`latitude` must be in [-90, 90] degrees, got {latitude:g}")
    if not -180.0 <= longitude <= 360.0:
        raise ValueError(f"`longitude` must be in [-180, 360] degrees, got {longitude:g}")
    table = get_solarposition(
        pandas.DatetimeIndex(time, tz="UTC"),
        float(latitude),
        float((longitude + 180.0) % 360.0 - 180.0),
        altitude=float(altitude),
    )
    pressure = float(alt2pres(altitude) if pressure is None else pressure)
    true = np.asarray(table["zenith"], dtype=np.float64)
    zenith = np.deg2rad(true - refracted * refraction(90.0 - true, pressure))
    azimuth = np.deg2rad(np.asarray(table["azimuth"], dtype=np.float64))
    return zenith, azimuth


def refraction(elevation_deg: Float[np.ndarray, " time"], pressure: float) -> Float[np.ndarray, " time"]:
    """How much higher the sun is seen than it is, degrees; after sunset the value at sunset.

    **Arguments:** `elevation_deg`, the true elevation; `pressure`, Pa; at 12 degrees Celsius.
    """
    above = np.maximum(elevation_deg, _SETTING_DEG)
    bent = 1.02 / (60.0 * np.tan(np.deg2rad(above + 10.3 / (above + 5.11))))
    return pressure / 101000.0 * 283.0 / 285.0 * bent
