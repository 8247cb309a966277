"""Write NetCDF along time, direction, and wavelength or channel."""

import json
from pathlib import Path

import numpy as np

from ...extras import require
from ..readers.netcdf import AXES, BEAM, DEPTH
from ..samples import DEGREE, Sky
from ..units import IRRADIANCE, LUMINANCE, RADIANCE


_PLACES = ("view_zenith", "view_azimuth")
# the integer with which NumPy and xarray mark an unknown time
_NO_TIME = np.iinfo(np.int64).min


def write_netcdf(sky: Sky, path: Path) -> None:
    """Write `sky` as NetCDF 4 in the layout that `read_netcdf` reads.

    **Arguments** `path`: the file; written in place, see `writing.atomic`.
    """
    require("h5netcdf", "h5py")
    # xarray would import pandas, which takes longer than all the rest of the writing
    import h5netcdf

    whole = axes(sky)
    of_sun = whole[::2][: sky.sun_zenith.ndim]
    moves = sky.view_zenith_by_wavelength is not None
    views = [degrees(view[0] if sky.one_pattern and not moves else view) for view in sky.views]
    of_views = whole if moves else whole[:2][-views[0].ndim :]
    clockwise = {"units": "degree", "comment": "clockwise from north"}
    by_unit = sky.response is not None and sky.response.by_unit
    light = (
        {"units": LUMINANCE, "long_name": "luminance"}
        if by_unit
        else {"units": RADIANCE, "long_name": "spectral radiance"}
        if sky.response is None
        else {"long_name": "reading of the channel, the sum of response times spectral radiance"}
    )
    variables = {
        "wavelength": (whole[2:], sky.wavelength_nm, {"units": "nm"}),
        "view_zenith": (of_views, views[0], {"units": "degree"}),
        "view_azimuth": (of_views, views[1], clockwise),
        "time": (("time",), *_moments(sky.time)),
        "radiance": (whole, sky.radiance, light),
        "suspect": (whole, (~sky.usable).astype(np.int8), {"long_name": "1 where masked"}),
        "sun_zenith": (of_sun, degrees(sky.sun_zenith), {"units": "degree"}),
        "sun_azimuth": (of_sun, degrees(sky.sun_azimuth), {"units": "degree"}),
    }
    if sky.sigma is not None:
        variables["sigma"] = (whole, sky.sigma, light | {"long_name": "standard deviation of radiance"})
    for key in DEGREE:
        if getattr(sky, key) is not None:
            variables[key] = (whole, getattr(sky, key), {"units": "1", "long_name": f"{key.replace('_', ' ')}, linear"})
    if sky.direct_irradiance is not None:
        about = {"units": IRRADIANCE, "long_name": "irradiance of the sun's beam on a plane normal to it"}
        variables[BEAM] = (whole[::2], sky.direct_irradiance, about)
    if sky.direct_sigma is not None:
        about = {"units": IRRADIANCE, "long_name": f"standard deviation of {BEAM}"}
        variables[f"{BEAM}_sigma"] = (whole[::2], sky.direct_sigma, about)
    for key, values in ((DEPTH, sky.aerosol_optical_depth), (f"{DEPTH}_sigma", sky.aerosol_optical_depth_sigma)):
        if values is not None:
            variables[key] = (whole[::2], values, {"units": "1", "long_name": f"{key.replace('_', ' ')}, vertical"})
    dimensions = dict(zip(whole, sky.radiance.shape, strict=True))
    if sky.response is not None and not by_unit:
        about = {"long_name": f"weights of spectral radiance in {RADIANCE}, widths of the spectrum's steps included"}
        variables["response"] = (("channel", "spectrum"), sky.response.weight, about)
        variables["spectrum"] = (("spectrum",), sky.response.wavelength_nm, {"units": "nm"})
        variables["channel"] = (("channel",), np.array(sky.response.names, object), {})
        dimensions["spectrum"] = len(sky.response.wavelength_nm)
    with h5netcdf.File(path, "w") as file:
        file.dimensions = dimensions
        for name, variable in variables.items():
            _put(file, name, *variable, packed=variable[0] == whole)
        file.attrs.update(attributes(sky))
        if sky.made_by:
            file.attrs["made_by"] = json.dumps(sky.made_by)
        if sky.instrument:
            file.attrs["instrument"] = sky.instrument
        if sky.notes:
            file.attrs["notes"] = "\n".join(sky.notes)


def _put(file, name: str, axes: tuple[str, ...], values: np.ndarray, about: dict, packed: bool) -> None:
    """Write one variable; a packed one is compressed, and one with directions names their coordinates."""
    import h5py

    missing = np.nan if values.dtype.kind == "f" else None
    packing = {"compression": "gzip", "compression_opts": 4, "shuffle": True} if packed else {}
    kind = h5py.string_dtype() if values.dtype.kind == "O" else values.dtype
    variable = file.create_variable(name, axes, kind, values, fillvalue=missing, **packing)
    variable.attrs.update(about)
    if "direction" in axes and name not in _PLACES:
        variable.attrs["coordinates"] = " ".join(_PLACES)


def _moments(time: np.ndarray) -> tuple[np.ndarray, dict]:
    """Times as integers, with their unit: seconds, or nanoseconds if those are not whole; NaT is NumPy's integer."""
    nanoseconds = time.astype("datetime64[ns]").astype(np.int64)
    known = nanoseconds != _NO_TIME
    whole = not np.any(nanoseconds[known] % 1_000_000_000)
    unit, step = ("seconds", 1_000_000_000) if whole else ("nanoseconds", 1)
    counted = np.where(known, nanoseconds // step, _NO_TIME)
    return counted, {"units": f"{unit} since 1970-01-01", "calendar": "proleptic_gregorian"}


def axes(sky: Sky) -> tuple[str, str, str]:
    """The dimensions of a sky's samples in a file."""
    return AXES if sky.response is None or sky.response.by_unit else (*AXES[:2], "channel")


def degrees(radians: np.ndarray) -> np.ndarray:
    """Degrees, rounded to 1e-10 so that a written angle reads back as it was typed."""
    return np.round(np.rad2deg(radians), 10)


def attributes(sky: Sky) -> dict[str, float]:
    """The station, line shape, calibration and tracking of `sky`, by their names in files; NaN is left out."""
    values = {
        "latitude": sky.latitude_deg,
        "longitude": sky.longitude_deg,
        "altitude_m": sky.altitude_m,
        "pressure_pa": sky.pressure_pa,
        "fwhm_nm": sky.fwhm_nm,
        "ozone_du": sky.ozone_du,
        "sun_distance_au": sky.sun_distance_au,
        "calibration_sigma": sky.calibration_sigma,
        "follows_sun": 1.0 if sky.follows_sun else np.nan,
    }
    return {name: float(value) for name, value in values.items() if np.isfinite(value)}
