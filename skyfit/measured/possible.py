"""Checks of the shapes and the values of a sky and its station."""

import numpy as np


# possible values of a station, which lies in the troposphere, whose pressure `pressure_at_altitude` knows; the
# narrowest line shape distinguishes nm from m
STATION_RANGES = {
    "latitude_deg": (-90.0, 90.0, "degrees, north positive"),
    "longitude_deg": (-180.0, 360.0, "degrees, east positive"),
    "altitude_m": (-500.0, 11e3, "m"),
    "pressure_pa": (2e3, 120e3, "Pa"),
    "fwhm_nm": (1e-3, 1000.0, "nm"),
    "ozone_du": (0.0, 1000.0, "Dobson units"),
    "sun_distance_au": (0.98, 1.02, "au"),
}
# An azimuth may be unwrapped by a turn or two; past seven half turns it must be in degrees.
_LARGEST_AZIMUTH = 7.0 * np.pi


def check_shapes(sky) -> None:
    """Raise unless the arrays of a sky have the shape that its radiance gives them."""
    if sky.radiance.ndim != 3:
        raise ValueError(f"`radiance` must have the axes time, direction, wavelength, got shape {sky.radiance.shape}")
    times, directions, wavelengths = sky.radiance.shape
    if 0 in sky.radiance.shape:
        raise ValueError(f"`radiance` must not be empty, got shape {sky.radiance.shape}")
    expected = {
        "sigma": sky.radiance.shape,
        "usable": sky.radiance.shape,
        "view_zenith": (times, directions),
        "view_azimuth": (times, directions),
        "wavelength_nm": (wavelengths,),
        "sun_zenith": (times, wavelengths)[: sky.sun_zenith.ndim or 1],
        "sun_azimuth": (times, wavelengths)[: sky.sun_zenith.ndim or 1],
        "time": (times,),
        "direct_irradiance": (times, wavelengths),
        "direct_sigma": (times, wavelengths),
        "aerosol_optical_depth": (times, wavelengths),
        "aerosol_optical_depth_sigma": (times, wavelengths),
        "degree_of_polarisation": sky.radiance.shape,
        "degree_of_polarisation_sigma": sky.radiance.shape,
        "view_zenith_by_wavelength": sky.radiance.shape,
        "view_azimuth_by_wavelength": sky.radiance.shape,
    }
    for name, shape in expected.items():
        value = getattr(sky, name)
        if value is not None and value.shape != shape:
            other = f" or {shape[1:]}" if name in ("view_zenith", "view_azimuth") else ""
            other = f" or {(times, wavelengths)}" if name.startswith("sun") and len(shape) == 1 else other
            raise ValueError(
                f"`{name}` must have shape {shape}{other} to agree with `radiance` "
                f"{sky.radiance.shape}, got {value.shape}"
            )


def check_values(sky) -> None:
    """Raise unless the numbers of a sky are possible."""
    # directions past the end of a shorter scan
    absent = np.isnan(sky.view_zenith) & np.isnan(sky.view_azimuth)
    nowhere = {"view_zenith": absent, "view_azimuth": absent}
    for name in ("view_zenith", "sun_zenith"):
        value = getattr(sky, name)
        if not np.all((value >= 0.0) & (value <= np.pi) | nowhere.get(name, False)):
            raise ValueError(f"`{name}` must be in [0, pi] rad, got {extremes(value)}")
    for name in ("view_azimuth", "sun_azimuth"):
        value = getattr(sky, name)
        if not np.all((np.abs(value) < _LARGEST_AZIMUTH) | nowhere.get(name, False)):
            raise ValueError(f"`{name}` must be finite and in rad, got {extremes(value)}")
    _check_moving_views(sky, absent)
    wavelength = sky.wavelength_nm
    if sky.response is not None:
        _check_response(sky)
    elif not (np.all(np.isfinite(wavelength)) and np.all(np.diff(wavelength) > 0.0)):
        raise ValueError(f"`wavelength_nm` must increase, got {extremes(wavelength)}")
    if wavelength.min() <= 0.0 or wavelength.max() < 10.0:
        raise ValueError(f"`wavelength_nm` must be in nm, got {extremes(wavelength)}")
    for name, (low, high, unit) in STATION_RANGES.items():
        value = getattr(sky, name)
        if not (np.isnan(value) or low <= value <= high):
            raise ValueError(f"`{name}` must be {low:g} to {high:g} {unit}, or NaN, got {value:g}")
    if not (np.isnan(sky.calibration_sigma) or 0.0 <= sky.calibration_sigma < 1.0):
        raise ValueError(f"`calibration_sigma` must be in [0, 1), or NaN, got {sky.calibration_sigma:g}")
    degree = sky.degree_of_polarisation
    if degree is not None and np.any((degree < 0.0) | (degree > 1.0)):
        raise ValueError(f"`degree_of_polarisation` must be in [0, 1], or NaN, got {extremes(degree)}")
    if not np.all(np.isfinite(sky.radiance[sky.usable])):
        raise ValueError("`usable` must be False where `radiance` is not finite")
    used = sky.usable.any(axis=2)
    if np.any(used & absent):
        raise ValueError("`usable` must be False where `view_zenith` and `view_azimuth` are NaN")
    if np.any(used & (sky.view_zenith > 0.5 * np.pi + 1e-6)):
        raise ValueError("`usable` must be False where `view_zenith` is below the horizon, past pi/2 rad")
    if sky.sigma is not None:
        sigma = sky.sigma[sky.usable]
        if not np.all((sigma > 0.0) & np.isfinite(sigma)):
            raise ValueError("`usable` must be False where `sigma` is not positive and finite")


def _check_moving_views(sky, absent):
    zenith, azimuth = sky.view_zenith_by_wavelength, sky.view_azimuth_by_wavelength
    if zenith is None and azimuth is None:
        return
    if zenith is None or azimuth is None or sky.response is not None:
        raise ValueError(
            "`view_zenith_by_wavelength` and `view_azimuth_by_wavelength` must be given together, and not with a "
            "`response`"
        )
    for name, value, limit in (("zenith", zenith, np.pi), ("azimuth", azimuth, _LARGEST_AZIMUTH)):
        low = 0.0 if name == "zenith" else -limit
        if not np.all((value >= low) & (value <= limit) | absent[..., None]):
            raise ValueError(f"`view_{name}_by_wavelength` must be in [{low:g}, {limit:g}] rad, got {extremes(value)}")
    if np.any(sky.usable & (zenith > 0.5 * np.pi + 1e-6)):
        raise ValueError("`usable` must be False where `view_zenith_by_wavelength` is below the horizon, past pi/2 rad")


def _check_response(sky):
    wavelength, channels = sky.wavelength_nm, len(sky.response.weight) if sky.response else 0
    if channels != len(wavelength):
        raise ValueError(
            f"`response` must have a channel for each of the sky's {len(wavelength)} wavelengths, got {channels}"
        )
    if not np.all(np.isfinite(wavelength)) or len(np.unique(wavelength)) < channels:
        raise ValueError(f"`wavelength_nm` must differ between channels, got {extremes(wavelength)}")
    if np.isfinite(sky.fwhm_nm):
        raise ValueError(
            f"`fwhm_nm` must be NaN with a `response`, which says how the instrument sees, got {sky.fwhm_nm:g}"
        )


def extremes(values) -> str:
    """The smallest and largest of some numbers as text, for an error of one line."""
    values = np.asarray(values)
    if values.size == 0:
        return "none"
    if not np.all(np.isfinite(values)):
        return "values that are not finite"
    return f"{values.min():g} to {values.max():g}"
