"""Where the sun stands, from time and place."""

import numpy as np
from jaxtyping import Float, Shaped


def solar_position(
    time: Shaped[np.ndarray, " time"],
    latitude: float | int,
    longitude: float | int,
    altitude: float | int = 0.0,
    pressure: float | int | None = None,
) -> tuple[Float[np.ndarray, " time"], Float[np.ndarray, " time"]]:
    """Apparent zenith angle and azimuth of the sun.

    The zenith angle is the apparent one, with refraction: it is where an instrument sees the sun.
    Refraction is 0.02 degrees at zenith angle 45, 0.5 at the horizon.

    **Arguments**

    - `time`: datetime64, UTC, [time]
    - `latitude`, `longitude`: degrees, north and east positive
    - `altitude`: m above sea level
    - `pressure`: Pa, for the refraction; of the standard atmosphere at `altitude` if None

    **Returns** zenith and azimuth (clockwise from north), rad, [time].

    **Valid** years 1678 to 2261; NaT is a `ValueError`.

    **Source** NREL's solar position algorithm (Reda and Andreas 2004), as in pvlib.
    """
    import pandas
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
        pressure=None if pressure is None else float(pressure),
    )
    zenith = np.deg2rad(np.asarray(table["apparent_zenith"], dtype=np.float64))
    azimuth = np.deg2rad(np.asarray(table["azimuth"], dtype=np.float64))
    return zenith, azimuth
