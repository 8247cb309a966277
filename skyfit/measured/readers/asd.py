"""Read a folder of ASD spectrometer text exports, in which one file is one direction."""

import re
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from ..samples import Sky
from .grid import Axis, fill, repeated
from .screening import Contents, screened


_SUFFIX = ".asd.rad.txt"
_EXPECTED = "<date>___<hh.mm.ss>_-_<index>____<azimuth>___<elevation>" + _SUFFIX
_NAME = re.compile(
    r"(?P<date>\d{4}-\d\d-\d\d)___(?P<time>\d\d\.\d\d\.\d\d)_-_(?P<index>\d+)"
    r"____(?P<azimuth>[-+]?\d+(?:\.\d*)?)___(?P<elevation>[-+]?\d+(?:\.\d*)?)\.asd\.rad\.txt"
)
_PLACE = ("latitude", "longitude")
# The clocks of the world lie within these hours of UTC.
_EARLIEST, _LATEST = -12.0, 14.0


def read_asd(path: Path, station: dict[str, float], utc_offset: float | int | None) -> Sky:
    """Read a folder of ASD text exports (or a folder of such folders) as a `Sky`.

    **Arguments**

    - `path`: the folder; file names carry date, local time, index, azimuth (degrees,
      counter-clockwise from north) and elevation (degrees); the content is a header line, then
      wavelength (nm) and radiance (W m^-2 sr^-1 nm^-1)
    - `station`: latitude and longitude (degrees), optionally altitude_m, fwhm_nm
    - `utc_offset`: hours that the local time is ahead of UTC; -4 for EDT

    **Returns** a `Sky`: directions in the order of the index, azimuth clockwise, the sun from
    pvlib at the time in the file names, which is the beginning of the scan.

    **Valid** without `utc_offset`, latitude and longitude the sun is unknown: `ValueError`.
    """
    name = path.name
    files = sorted(path.glob("*" + _SUFFIX)) or sorted(path.glob("*/*" + _SUFFIX))
    if not files:
        raise ValueError(f"{name}: expected a folder of files {_EXPECTED}, found none")
    given = {"utc_offset": utc_offset, **{key: station.get(key) for key in _PLACE}}
    lacking = [f"`{key}`" for key, value in given.items() if value is None]
    if lacking or utc_offset is None:
        raise ValueError(
            f"{name}: ASD exports carry local time and no place: expected `utc_offset`, "
            f"`latitude` and `longitude`, found no {', '.join(lacking)}"
        )
    if not _EARLIEST <= utc_offset <= _LATEST:
        raise ValueError(f"`utc_offset` must be in [{_EARLIEST:g}, {_LATEST:g}] hours, got {utc_offset:g}")
    labels = sorted((_label(file.name) for file in files), key=lambda label: label[:2])
    found = {file.name: file for file in files}
    times, directions = Axis(), Axis()
    places, spectra, names = [], [], []
    wavelength = np.empty(0)
    for moment, _, angles, file in labels:
        own, spectrum = _spectrum(found[file])
        if not spectra:
            wavelength = own
        if own.shape != wavelength.shape or np.any(own != wavelength):
            raise ValueError(
                f"{file}: column `Wavelength`: expected the wavelengths of {names[0]}, "
                f"found {own[0]:g} to {own[-1]:g} nm ({len(own)} rows)"
            )
        places.append((times.place(moment), directions.place(angles), 0))
        spectra.append(spectrum)
        names.append(file)
    shape = (len(times), len(directions), 1)
    index = np.array(places).T
    twice = repeated(shape, index)
    if twice is not None:
        raise ValueError(f"{names[twice[1]]}: expected each time and direction once, found that of {names[twice[0]]}")
    # Which spectrum belongs where; -1 where a time lacks a direction.
    which = fill(shape, index, np.arange(len(spectra)), -1.0)[..., 0].astype(int)
    radiance = np.where(which[..., None] < 0, np.nan, np.array(spectra)[which])
    counterclockwise, elevation = np.array(directions.values()).T
    unknown = np.full(len(times), np.nan)
    local = np.array(times.values(), dtype="datetime64[ns]")
    behind = np.timedelta64(timedelta(hours=float(utc_offset)))
    return screened(
        Contents(
            name=name,
            radiance=radiance,
            view_zenith=90.0 - elevation,
            view_azimuth=(360.0 - counterclockwise) % 360.0,
            wavelength=wavelength,
            time=local - behind.astype("timedelta64[ns]"),
            sun_zenith=unknown,
            sun_azimuth=unknown.copy(),
            station=station,
            notes=[f"local time taken as UTC{utc_offset:+g} h"],
        )
    )


def _label(file):
    """(local time, index, (azimuth, elevation), file name) from the file name."""
    match = _NAME.fullmatch(file)
    try:
        if match is None:
            raise ValueError
        moment = datetime.strptime(f"{match['date']} {match['time']}", "%Y-%m-%d %H.%M.%S")
    except ValueError:
        raise ValueError(f"{file}: expected a file name {_EXPECTED}") from None
    return moment, int(match["index"]), (float(match["azimuth"]), float(match["elevation"])), file


def _spectrum(path):
    """Wavelength and radiance of one file."""
    file = path.name
    try:
        lines = path.read_text(encoding="utf-8-sig").split("\n")
    except UnicodeDecodeError:
        raise ValueError(f"{file}: expected text, found bytes") from None
    while lines and not lines[-1].strip():
        lines.pop()
    if not lines:
        raise ValueError(f"{file}: expected a header line and a spectrum, found an empty file")
    if not lines[0].lower().startswith("wavelength"):
        raise ValueError(f"{file}: row 1: expected the header Wavelength<TAB>name, found {lines[0][:60]!r}")
    if len(lines) < 2:
        raise ValueError(f"{file}: expected rows below the header, found none")
    values = np.empty((len(lines) - 1, 2))
    for row, line in enumerate(lines[1:], start=2):
        cells = line.split()
        if len(cells) != 2:
            raise ValueError(f"{file}: row {row}: expected wavelength and radiance, found {line[:60]!r}")
        for column, text in enumerate(cells):
            try:
                values[row - 2, column] = float(text)
            except ValueError:
                key = ("Wavelength", "radiance")[column]
                raise ValueError(f"{file}: row {row}, column `{key}`: expected a number, found {text[:60]!r}") from None
    return values[:, 0], values[:, 1]
