"""Read almucantars of the ARM sites' sun photometers (csphot) in NetCDF: a row for each filter, angles from the sun."""

import numpy as np

from ..samples import Sky
from ..units import is_radian, radiance_factor
from .header import quantity_of
from .scans import ALMUCANTAR, series_of, Sweep, view_of
from .screening import screened


RADIANCES = ("alm_rad", "almucantar_radiance", "sky_radiance")
_SUN = ("zenith", "solar_zenith_angle", "solar_zenith", "sun_zenith")
_LENGTHS = {"um": 1e3, "micron": 1e3, "micrometer": 1e3, "nm": 1.0, "nanometer": 1.0}
_DONE = ("time", "azimuth", "wavelength", "base_time", "time_offset")


def is_photometer(data) -> bool:
    """Whether a dataset holds almucantars: radiance over time and azimuth, and a filter's wavelength at each time."""
    return _radiance(data) is not None


def _radiance(data) -> str | None:
    found = (name for name in RADIANCES if name in data and set(data[name].dims) == {"time", "azimuth"})
    return next(found, None) if "wavelength" in data and data["wavelength"].dims == ("time",) else None


def read_photometer(name: str, data, station: dict[str, float]) -> Sky:
    """Read a dataset of almucantars as a `Sky`.

    **Arguments**

    - `data`: `alm_rad` [time, azimuth] in a unit of spectral radiance, `azimuth` from the sun (degrees), `wavelength`
      and `zenith`, the sun's, [time], `lat`, `lon`, `alt`
    - `station`: numbers that replace the file's own, by name

    **Returns** a `Sky` of the scans in time, each wavelength with its own views.

    **Valid** times in UTC; anything that is missing is a `ValueError` that names it.
    """
    key = str(_radiance(data))
    sun = next((one for one in _SUN if one in data), None)
    if sun is None:
        raise ValueError(
            f"{name}: expected a variable `zenith`, the sun's, found {', '.join(map(str, data.variables))}"
        )
    if data["time"].dtype.kind != "M":
        raise ValueError(f"{name}: variable `time`: expected units such as 'seconds since 1970-01-01', found none")
    units = data[key].attrs.get("units")
    try:
        factor = radiance_factor(str(units))
    except ValueError as error:
        raise ValueError(f"{name}: variable `{key}`: {error}") from None
    notes = [] if factor == 1.0 else [f"radiance converted from {units} to W m-2 sr-1 nm-1"]
    told, taken = _station(data)
    unused = [str(v) for v in data.variables if v not in {key, sun, *taken, *_DONE}]
    notes += [f"variables not used: {', '.join(unused)}"] if unused else []
    light = factor * _numbers(name, data, key, ("time", "azimuth"))
    azimuth = _azimuths(name, data, light, notes)
    wavelength = _wavelengths(name, data)
    zenith = _numbers(name, data, sun, ("time",))
    if is_radian(str(data[sun].attrs.get("units", ""))):
        zenith = np.rad2deg(zenith)
    light[:, azimuth == 0.0] = np.nan
    moments = data["time"].values.astype("datetime64[ns]")
    sweeps = []
    for row, (moment, length, sun_zenith) in enumerate(zip(moments, wavelength, zenith, strict=True)):
        if np.isnat(moment) or not (np.isfinite(length) and np.isfinite(sun_zenith)):
            notes.append(f"row {row} has no time, wavelength or sun: left out")
            continue
        around = np.where(np.isfinite(azimuth), azimuth, 0.0)
        view = view_of(ALMUCANTAR, around, float(sun_zenith))
        sweeps.append(Sweep(moment, round(float(length), 4), float(sun_zenith), *view, light[row], row=row))
    if not sweeps:
        raise ValueError(f"{name}: expected rows with a time, a wavelength and the sun's zenith angle, found none")
    return screened(series_of(name, sweeps, told | station, notes, "ARM csphot photometer: almucantar").contents)


def _azimuths(name, data, light, notes):
    """Azimuths from the sun, degrees, NaN where the file has none; samples there are removed from `light`."""
    azimuth = _numbers(name, data, "azimuth", ("azimuth",)) if "azimuth" in data.variables else np.zeros(0)
    if not np.isfinite(azimuth).any():
        raise ValueError(f"{name}: variable `azimuth`: expected angles from the sun in degrees, found none")
    unknown = ~np.isfinite(azimuth)
    lost = int(np.isfinite(light[:, unknown]).sum())
    if lost:
        notes.append(f"{lost} samples have no azimuth: left out")
    light[:, unknown] = np.nan
    return azimuth


def _wavelengths(name, data):
    units = str(data["wavelength"].attrs.get("units", "um"))
    scale = _LENGTHS.get(units.strip().lower().removesuffix("s"))
    if scale is None:
        raise ValueError(f"{name}: variable `wavelength`: expected um or nm, found {units!r}")
    return scale * _numbers(name, data, "wavelength", ("time",))


def _numbers(name, data, key, axes):
    variable = data[key]
    if variable.dtype.kind not in "fiu" or set(variable.dims) != set(axes):
        found = ", ".join(map(str, variable.dims)) or "none"
        raise ValueError(f"{name}: variable `{key}`: expected numbers along {', '.join(axes)}, found {found}")
    numbers = variable.transpose(*axes).values.astype(float)
    # files mark missing numbers this way even if no attribute says so
    return np.where(numbers <= -9998.5, np.nan, numbers)


def _station(data):
    """Latitude, longitude and altitude, and the names of their variables."""
    told, taken = {}, []
    for key in map(str, data.variables):
        quantity = quantity_of(key)
        if quantity is not None and quantity[0] in ("latitude", "longitude", "altitude_m"):
            numbers = np.unique(np.asarray(data[key].values, float))
            if numbers.size == 1 and np.isfinite(numbers[0]):
                told[quantity[0]] = float(numbers[0])
                taken.append(key)
    return told, taken
