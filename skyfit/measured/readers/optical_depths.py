"""Aerosol optical depths that AERONET derives from the sun's beam (Version 3, direct sun), beside a scan of the sky."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from ..samples import Sky
from .aeronet_table import moment_in, Table, table_of
from .header import plain
from .scans import Series


# an optical depth further in time from a scan than this is not used
_FARTHEST = np.timedelta64(30, "m")
# sigma of field instruments, above and below 400 nm (Giles et al. 2019, Atmos. Meas. Tech. 12, 169)
_SIGMA, _SIGMA_UV, _UV_NM = 0.01, 0.02, 400.0
# filters are the same if their wavelengths are this near, nm
_SAME_FILTER = 3.0
_DEPTH = re.compile(r"aod_(\d+)nm")
_EXACT = re.compile(r"exact_wavelengths_of_aod_um_(\d+)nm")
_LEVELS = re.compile(r"\.lev(10|15|20)", re.IGNORECASE)


@dataclass
class Depths:
    """Optical depths of a file: `depth` `[time, wavelength]`, NaN where missing; `moment` UTC; `ozone_du` `[time]`."""

    name: str
    site: str
    level: str
    moment: np.ndarray
    wavelength: np.ndarray
    depth: np.ndarray
    ozone_du: np.ndarray


def refuse_depths(path: Path, station: dict[str, float]) -> NoReturn:
    """Raise a `ValueError` that says where optical depths belong: alone they make no sky."""
    raise ValueError(
        f"{path.name}: found aerosol optical depths without a sky: expected a sky scan of AERONET (.alm, .ppl, .hyb), "
        "which takes this file along if it lies beside it"
    )


def beside(path: Path, site: str) -> Depths | None:
    """The optical depths of the same site in the folder of a file, of the best level; None without any."""
    found = []
    for file in sorted(path.parent.iterdir()):
        if _LEVELS.fullmatch(file.suffix) and file.is_file():
            try:
                depths = depths_of(file)
            except ValueError:
                # the user did not ask for this file, so its errors do not matter
                continue
            if depths.site == site:
                found.append(depths)
    return max(found, key=lambda depths: depths.level, default=None)


def depths_of(path: Path) -> Depths:
    """The optical depths of a file by AERONET; `ValueError` if it holds none."""
    table = table_of(path, "AOD_")
    names = [plain(name) for name in table.names]
    places = {match[1]: place for place, name in enumerate(names) if (match := _DEPTH.fullmatch(name))}
    exact = {match[1]: place for place, name in enumerate(names) if (match := _EXACT.fullmatch(name))}
    date, time = table.place("date"), table.place("time")
    if not places or date is None or time is None:
        raise ValueError(f"{table.name}: expected columns AOD_..nm with a date and a time, found none")
    depth = _columns(table, places.values())
    wavelength = np.array([float(nominal) for nominal in places])
    for column, nominal in enumerate(places):
        if nominal in exact:
            own = 1e3 * _columns(table, [exact[nominal]])[:, 0]
            known = own[np.isfinite(own) & (own > 0.0)]
            wavelength[column] = np.median(known) if known.size else wavelength[column]
    moment = np.array([moment_in(table, row, cells, date, time) for row, cells in table.rows])
    order = np.argsort(moment, kind="stable")
    ozone = names.index("ozone_dobson") if "ozone_dobson" in names else None
    site = table.place("site")
    level = _LEVELS.fullmatch(path.suffix)
    return Depths(
        name=path.name,
        site="" if site is None else table.rows[0][1][site],
        level=level[1] if level else "",
        moment=moment[order],
        wavelength=wavelength,
        depth=depth[order],
        ozone_du=np.full(len(moment), np.nan) if ozone is None else _columns(table, [ozone])[order, 0],
    )


def _columns(table: Table, places) -> np.ndarray:
    return np.array([[table.number(row, cells, place) for place in places] for row, cells in table.rows])


def joined(series: Series, depths: Depths) -> None:
    """Put the optical depths at the time of each sweep into a series of scans, with ozone and a note.

    Between two measurements they are interpolated, with the sigma of the instrument and half of their difference.
    Before the first and after the last measurement the nearest one holds for half an hour.
    """
    contents = series.contents
    value, sigma = (np.full(series.moment.shape, np.nan) for _ in range(2))
    for w, wavelength in enumerate(contents.wavelength):
        column = int(np.argmin(np.abs(depths.wavelength - wavelength)))
        if abs(depths.wavelength[column] - wavelength) > _SAME_FILTER:
            continue
        least = _SIGMA_UV if wavelength < _UV_NM else _SIGMA
        for t, moment in enumerate(series.moment[:, w]):
            value[t, w], change = _at(moment, depths.moment, depths.depth[:, column])
            sigma[t, w] = np.hypot(least, 0.5 * change)
    known = np.isfinite(value)
    if not known.any():
        contents.notes.append(f"{depths.name} beside it has no optical depth within 30 minutes of a scan: not used")
        return
    contents.aerosol_depth, contents.aerosol_depth_sigma = value, np.where(known, sigma, np.nan)
    contents.notes.append(
        f"aerosol optical depths of {depths.name} within 30 minutes taken along: {int(known.sum())} of {known.size}, "
        f"sigma {np.nanmin(sigma):.2g} to {np.nanmax(sigma):.2g}"
    )
    ozone = [_at(moment, depths.moment, depths.ozone_du)[0] for moment in series.moment.ravel()]
    ozone = float(np.nanmean(ozone)) if np.isfinite(ozone).any() else np.nan
    if np.isfinite(ozone) and "ozone_du" not in contents.station:
        contents.station = {"ozone_du": ozone} | contents.station
        contents.notes.append(f"ozone {ozone:.0f} DU from {depths.name}")


def _at(moment: np.datetime64, moments: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """The value of a series at a time, and the difference of its neighbours; NaN if none is near."""
    near = np.isfinite(values) & (np.abs(moments - moment) <= _FARTHEST)
    if not near.any():
        return np.nan, np.nan
    seconds = (moments[near] - moment) / np.timedelta64(1, "s")
    own = values[near]
    value = float(np.interp(0.0, seconds, own))
    after = int(np.searchsorted(seconds, 0.0))
    between = own[max(after - 1, 0) : after + 1]
    return value, float(np.ptp(between))


def optical_depths_in(sky: Sky) -> int:
    """How many optical depths a sky holds."""
    return 0 if sky.aerosol_optical_depth is None else int(np.isfinite(sky.aerosol_optical_depth).sum())
