"""The pressure and the sun's distance at a station, from its place and the day."""

import numpy as np
from jaxtyping import Float

from ..atmosphere import pressure_at_altitude, SEA_LEVEL_PRESSURE
from ..light import earth_sun_factor
from .samples import Sky


# effect of the pressure on the optical depth of Rayleigh scattering, 0.097 at 550 nm and sea level
_PRICE = "1 % off is 0.001 of optical depth at 550 nm"


def day_of_year(time: np.datetime64) -> int:
    """The day of the year, 1 for 1 January."""
    return int((time.astype("datetime64[D]") - time.astype("datetime64[Y]")).astype(int)) + 1


def station_pressure(sky: Sky) -> tuple[float, str]:
    """The pressure at the station, Pa, by the file or by its altitude, and a note if it is assumed."""
    if np.isfinite(sky.pressure_pa):
        return sky.pressure_pa, ""
    if np.isfinite(sky.altitude_m) and sky.altitude_m != 0.0:
        pressure, source = float(pressure_at_altitude(sky.altitude_m)), f"the altitude of {sky.altitude_m:g} m"
        return pressure, f"pressure {pressure / 100.0:.0f} hPa from {source} by the standard atmosphere: {_PRICE}"
    told = "altitude 0 m and no pressure" if sky.altitude_m == 0.0 else "no pressure or altitude"
    return SEA_LEVEL_PRESSURE, f"{told} in the file: 1013 hPa of sea level assumed, wrong higher up: {_PRICE}"


def sun_factor(sky: Sky) -> tuple[Float[np.ndarray, " time"], str]:
    """The sun's irradiance at each time over that at 1 au, and a note where neither its distance nor a date is known.

    **Returns:** `[time]`, dimensionless; 1 at times whose date is not known.
    """
    if np.isfinite(sky.sun_distance_au):
        return np.full(len(sky.time), sky.sun_distance_au**-2), ""
    unknown = np.isnat(sky.time)
    factor = np.array([1.0 if np.isnat(t) else float(earth_sun_factor(day_of_year(t))) for t in sky.time])
    if not unknown.any():
        return factor, ""
    which = "" if unknown.all() else f" at {int(unknown.sum())} of {len(unknown)} times"
    return factor, (
        f"no date{which} in the file: the sun taken at 1 au, its irradiance is off by up to 3.4 % with the season, and "
        "single-scattering albedo by 0.02 to 0.04 with it"
    )
