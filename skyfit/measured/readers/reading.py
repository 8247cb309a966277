"""Read a measured sky from a file or folder of any known format."""

import os
from pathlib import Path

from ..response import Response
from ..samples import Sky
from .asd import read_asd
from .formats import known_format
from .netcdf import read_netcdf
from .scanner import read_scanner
from .tidy import read_tidy


# readers by suffix, for content that `formats` does not know; a folder holds ASD text exports
READERS = {".nc": read_netcdf, ".nc4": read_netcdf, ".cdf": read_netcdf, ".csv": read_tidy}
# readers that take units of channels
_OF_CHANNELS = (read_netcdf, read_tidy)


def read(
    path: str | os.PathLike,
    *,
    latitude: float | int | None = None,
    longitude: float | int | None = None,
    utc_offset: float | int | None = None,
    altitude: float | int | None = None,
    fwhm_nm: float | int | None = None,
    response: Response | None = None,
) -> Sky:
    """Read sky radiance, or luminance, from an instrument's file, NetCDF, a tidy CSV or a folder of ASD text.

    **Arguments**

    - `path`: a file of any name, known by its content, or a folder: NetCDF and tidy CSV as `write_sky` writes them;
      AERONET's raw sky scans (`.alm`, `.ppl`, `.hyb`), with the optical depths (`.lev15`, `.lev20`) that lie beside
      them; SKYNET's scans (`.DT5`) with `ins.para` beside them; ARM csphot almucantars in NetCDF; a sky scanner's table
      of 145 luminances; a folder of ASD text exports
    - `latitude`, `longitude`: degrees, north and east positive; instead of the file's own
    - `utc_offset`: hours that local time is ahead of UTC (EDT is -4); for a folder or a sky scanner only, since
      the times of the others are UTC
    - `altitude`: m above sea level; instead of the file's own
    - `fwhm_nm`: full width at half maximum of the instrument's line shape, nm
    - `response`: response of the samples' channels, if the file does not hold it; the file's units are then those of
      the channels, whatever they are called. Luminance (cd m-2) in one channel needs none: the eye's is known

    **Returns** a `Sky`; samples that are missing, negative, infinite, saturated, below the horizon
    or marked as suspect are masked and counted, never silently used.

    **Valid** anything that cannot be understood is a one-line `ValueError` that names the file, the
    row or the column, what was expected and what was found.

    **Example:**

        >>> sky = skyfit.read("data/skies/sample.nc")
        >>> sky.radiance.shape, sky.masked
        ((1, 94, 33), {})
    """
    path = Path(path)
    given = {
        "latitude": latitude,
        "longitude": longitude,
        "altitude_m": altitude,
        "fwhm_nm": fwhm_nm,
    }

    def seen(sky: Sky) -> Sky:
        try:
            return sky.with_response(response)
        except ValueError as error:
            raise ValueError(f"{path.name}: {error}") from None

    station = {key: float(value) for key, value in given.items() if value is not None}
    try:
        if path.is_dir():
            return seen(read_asd(path, station, utc_offset))
        if not path.exists():
            raise ValueError(f"{path}: expected a file or a folder, found none")
        if not path.is_file():
            raise ValueError(f"{path}: expected a file or a folder, found a pipe or a device")
        reader = known_format(path) or READERS.get(path.suffix.lower())
        if reader is None:
            raise ValueError(
                f"{path.name}: expected NetCDF, a tidy CSV, a sky scan of AERONET or SKYNET, a sky scanner's table or "
                f"a folder of ASD text exports, found none of these under the suffix {path.suffix!r}"
            )
        if reader is read_scanner:
            return seen(read_scanner(path, station, utc_offset))
        if utc_offset is not None:
            raise ValueError(
                f"{path.name}: `utc_offset` is for a sky scanner or a folder of ASD text exports; times in this file "
                "are UTC"
            )
        # a reader that a user has added may not know channels
        own = {} if response is None or reader not in _OF_CHANNELS else {"own_units": True}
        return seen(reader(path, station, **own))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from error
