"""Write tidy CSV, in which one row is one sample."""

import csv
import json
from pathlib import Path

import numpy as np

from ..readers.tidy import BEAM, REQUIRED, SUN
from ..samples import DEGREE, Sky
from ..units import LUMINANCE, RADIANCE
from .netcdf import attributes, degrees


def write_tidy(sky: Sky, path: Path) -> None:
    """Write `sky` as the tidy CSV that `read_tidy` reads; a sample that is NaN has an empty cell.

    **Arguments** `path`: the file; written in place, see `writing.atomic`.

    **Valid** times that are known and differ, unless there is only one; directions that differ.
    """
    by_unit = sky.response is not None and sky.response.by_unit
    if sky.response is not None and not by_unit:
        raise ValueError("a CSV has no place for the response of channels: write NetCDF")
    timed = not (len(sky.time) == 1 and np.isnat(sky.time[0]))
    if timed and (np.any(np.isnat(sky.time)) or len(np.unique(sky.time)) < len(sky.time)):
        raise ValueError("a CSV tells times apart by `time`: expected all to be known and to differ; write NetCDF")
    if sky.aerosol_optical_depth is not None:
        raise ValueError("a CSV has no place for aerosol optical depths: write NetCDF")
    if sky.view_zenith_by_wavelength is not None:
        raise ValueError("a CSV has no place for views that move between wavelengths: write NetCDF")
    views = np.stack([degrees(sky.view_zenith), degrees(sky.view_azimuth)], axis=2)
    there = np.asarray(np.isfinite(views).all(axis=2))
    for pattern, known in zip(views[:1] if sky.one_pattern else views, there, strict=False):
        if len(np.unique(pattern[known], axis=0)) < known.sum():
            raise ValueError(
                "a CSV tells directions apart by `view_zenith` and `view_azimuth`: expected all to differ; write NetCDF"
            )
    header = (["time"] if timed else []) + list(REQUIRED)
    each = {"sigma": sky.sigma} | {key: getattr(sky, key) for key in DEGREE}
    each = {key: values for key, values in each.items() if values is not None}
    header += [*each, "suspect", *SUN]
    beam = [values for values in (sky.direct_irradiance, sky.direct_sigma) if values is not None]
    header += BEAM[: len(beam)]
    grid = sky.radiance.shape[::2]
    sun = [degrees(angle).reshape(len(angle), -1) for angle in (sky.sun_zenith, sky.sun_azimuth)]
    sun = [np.broadcast_to(angle, grid).tolist() for angle in sun]
    wavelengths = sky.wavelength_nm.tolist()
    with open(path, "w", encoding="utf-8", newline="") as stream:
        for key, value in attributes(sky).items():
            stream.write(f"# {key}: {value!r}\n")
        if sky.made_by:
            stream.write(f"# made_by: {json.dumps(sky.made_by)}\n")
        stream.write(f"# units: {LUMINANCE if by_unit else RADIANCE}\n")
        for note in sky.notes:
            stream.write(f"# note: {' '.join(note.split())}\n")
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header)
        for time, moment in enumerate(sky.time):
            start = [_iso(moment)] if timed else []
            for direction in np.flatnonzero(there[time]):
                angles = views[time, direction].tolist()
                rows = sky.radiance[time, direction].tolist()
                masked = (~sky.usable[time, direction]).astype(int).tolist()
                for place, wavelength in enumerate(wavelengths):
                    row = [*start, *angles, wavelength, _cell(rows[place])]
                    row += [_cell(float(values[time, direction, place])) for values in each.values()]
                    row += [masked[place], sun[0][time][place], sun[1][time][place]]
                    writer.writerow([*row, *(_cell(float(values[time, place])) for values in beam)])


def _iso(moment):
    whole = moment.astype("datetime64[s]")
    return f"{whole if whole == moment else moment}Z"


def _cell(value):
    return "" if np.isnan(value) else value
