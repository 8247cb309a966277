"""NetCDF: time, direction, wavelength or channel."""

from pathlib import Path

import numpy as np

from ..readers.netcdf import AXES, BEAM
from ..samples import Sky
from ..units import IRRADIANCE, RADIANCE


def write_netcdf(sky: Sky, path: Path) -> None:
    """Write `sky` as NetCDF 4 in the layout that `read_netcdf` reads.

    **Arguments** `path`: the file; written in place, see `writing.atomic`.
    """
    import xarray

    whole = axes(sky)
    of_sun = whole[::2][: sky.sun_zenith.ndim]
    light = (
        {"units": RADIANCE, "long_name": "spectral radiance"}
        if sky.response is None
        else {"long_name": "reading of the channel, the sum of response times spectral radiance"}
    )
    variables = {
        "radiance": (whole, sky.radiance, light),
        "suspect": (whole, (~sky.usable).astype(np.int8), {"long_name": "1 where masked"}),
        "sun_zenith": (of_sun, degrees(sky.sun_zenith), {"units": "degree"}),
        "sun_azimuth": (of_sun, degrees(sky.sun_azimuth), {"units": "degree"}),
    }
    if sky.sigma is not None:
        variables["sigma"] = (whole, sky.sigma, light | {"long_name": "standard deviation of radiance"})
    if sky.direct_irradiance is not None:
        about = {"units": IRRADIANCE, "long_name": "irradiance of the sun's beam on a plane normal to it"}
        variables[BEAM] = (whole[::2], sky.direct_irradiance, about)
    if sky.direct_sigma is not None:
        about = {"units": IRRADIANCE, "long_name": f"standard deviation of {BEAM}"}
        variables[f"{BEAM}_sigma"] = (whole[::2], sky.direct_sigma, about)
    clockwise = {"units": "degree", "comment": "clockwise from north"}
    views = [degrees(view[0] if sky.one_pattern else view) for view in (sky.view_zenith, sky.view_azimuth)]
    of_views = ("time", "direction")[-views[0].ndim :]
    coordinates = {
        "wavelength": (whole[2], sky.wavelength_nm, {"units": "nm"}),
        "view_zenith": (of_views, views[0], {"units": "degree"}),
        "view_azimuth": (of_views, views[1], clockwise),
        "time": ("time", sky.time),
    }
    if sky.response is not None:
        about = {"long_name": f"weights of spectral radiance in {RADIANCE}, widths of the spectrum's steps included"}
        variables["response"] = (("channel", "spectrum"), sky.response.weight, about)
        coordinates["spectrum"] = ("spectrum", sky.response.wavelength_nm, {"units": "nm"})
        coordinates["channel"] = ("channel", np.array(sky.response.names, object))
    data = xarray.Dataset(variables, coordinates, attributes(sky))
    if sky.notes:
        data.attrs["notes"] = "\n".join(sky.notes)
    encoding = {name: {"zlib": True} for name in ("radiance", "suspect")}
    data.to_netcdf(path, engine="h5netcdf", encoding=encoding)


def axes(sky: Sky) -> tuple[str, str, str]:
    """The dimensions of a sky's samples in a file."""
    return AXES if sky.response is None else (*AXES[:2], "channel")


def degrees(radians: np.ndarray) -> np.ndarray:
    """Degrees, rounded to 1e-10 so that a written angle reads as it was typed."""
    return np.round(np.rad2deg(radians), 10)


def attributes(sky: Sky) -> dict[str, float]:
    """The station and the line shape of `sky`, by their names in files; what is NaN is left out."""
    values = {
        "latitude": sky.latitude_deg,
        "longitude": sky.longitude_deg,
        "altitude_m": sky.altitude_m,
        "pressure_pa": sky.pressure_pa,
        "fwhm_nm": sky.fwhm_nm,
    }
    return {name: float(value) for name, value in values.items() if np.isfinite(value)}
