"""Read AERONET's raw sky scans (Version 3 text: almucantar, principal plane, hybrid), with optical depths beside."""

import re
from pathlib import Path

import numpy as np

from ..quality.placed_sun import angle_from_sun
from ..samples import Sky
from ..units import radiance_factor
from .aeronet_table import COLUMNS, moment_in, only, Table, table_of
from .header import plain
from .optical_depths import beside, joined
from .scans import ALMUCANTAR, azimuth_of_hybrid, HYBRID, PRINCIPAL_PLANE, series_of, Sweep, view_of
from .screening import screened


# unit of the radiances if the names of older files do not state it
_USUAL_UNITS = "uW/cm^2/sr/nm"
_NEEDED = ("date", "time", "exact", "sun_zenith", "kind")
# largest difference of equal angles, degrees
_SAME_ANGLE = 0.5
_KINDS = {
    "almucantar": ALMUCANTAR, "alm": ALMUCANTAR, "principal_plane": PRINCIPAL_PLANE, "ppl": PRINCIPAL_PLANE,
    "hybrid": HYBRID, "hyb": HYBRID,
}  # fmt: skip
# "Radiance_for_Azimuth_Angle_in_Degrees(uW/cm^2/sr/nm)_-6.000", of files whose two lines of names were joined
_JOINED = re.compile(r"(.*\S)_(-?\d+(?:\.\d*)?)")
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?")
_UNITS = re.compile(r"\(([^()]*(?:\([^()]*\))?[^()]*)\)\s*$")


def read_scan(path: Path, station: dict[str, float]) -> Sky:
    """Read a file of AERONET's raw sky scans as a `Sky`.

    **Arguments**

    - `path`: Version 3 text: lines of a head, a line of names, a line of angles under the last names, then a row for
      each wavelength of each scan with its own time and sun's zenith angle; radiance in uW cm-2 sr-1 nm-1, -999 missing
    - `station`: numbers that replace the file's own, by name

    **Returns** a `Sky` of the scans in time, each wavelength with its own views. An optical-depth file (`.lev15`,
    `.lev20`, `.lev10`) of the same site in the same folder is read too, that of the best level.

    **Valid** scans in the almucantar and the principal plane, and hybrid ones. The angles of a hybrid scan are azimuths
    from the sun or scattering angles; their name and the file's own scattering angles show which. Other scans, and a
    file of several sites, are a `ValueError`.
    """
    table = table_of(path, "Solar_Zenith_Angle")
    places = {what: table.place(what) for what in COLUMNS}
    lacking = [COLUMNS[what][0] for what in _NEEDED if places[what] is None]
    angles, units, unnamed, by_scattering = _radiances(table)
    stated, others = _other_groups(table)
    if lacking or not angles:
        found = ", ".join(filter(None, table.names))[:200]
        raise ValueError(f"{table.name}: expected columns {', '.join(lacking) or 'of radiance'}, found {found}")
    try:
        factor = radiance_factor(units)
    except ValueError as error:
        raise ValueError(f"{table.name}: column `Radiance`: {error}") from None
    notes = [f"radiance converted from {units} to W m-2 sr-1 nm-1"]
    if others:
        notes.append(f"columns not used: {', '.join(others)}")
    if unnamed:
        notes.append(f"{unnamed} columns of radiance have no angle: left out")
    site = only(table, places["site"], "site")
    number = (
        ", ".join(dict.fromkeys(cells[places["number"]] for _, cells in table.rows))
        if places["number"] is not None
        else ""
    )
    told = {
        what: float(only(table, place, what))
        for what in ("latitude", "longitude", "altitude_m")
        for place in (places[what],)
        if place is not None
    }
    columns, degrees = np.array(list(angles)), np.array(list(angles.values()))
    sweeps = [_sweep(table, row, cells, places, columns, degrees, factor) for row, cells in table.rows]
    worst = _misfit(table, sweeps, degrees, stated)
    if any(sweep.kind == HYBRID for sweep in sweeps):
        if by_scattering or worst > _SAME_ANGLE:
            sweeps = [_sweep(table, row, cells, places, columns, degrees, factor, True) for row, cells in table.rows]
            worst, by_scattering = _misfit(table, sweeps, degrees, stated), True
        notes.append(f"angles of a hybrid scan taken as {'scattering angles' if by_scattering else 'azimuths'}")
    if worst > _SAME_ANGLE:
        notes.append(
            f"the file's scattering angles are {worst:.1f} degrees from those of its views: another kind of scan?"
        )
    sun = degrees == 0.0
    toward = sum(int(np.isfinite(sweep.radiance[sun]).sum()) for sweep in sweeps)
    if toward:
        notes.append(f"{toward} samples toward the sun itself left out")
    for sweep in sweeps:
        sweep.radiance[sun] = np.nan
    kinds = ", ".join(dict.fromkeys(sweep.kind for sweep in sweeps))
    instrument = f"AERONET photometer{number and f' {number}'}{site and f', {site}'}: {kinds}"
    series = series_of(table.name, sweeps, told | station, notes, instrument)
    depths = beside(path, site)
    if depths is not None:
        joined(series, depths)
    return screened(series.contents)


def _sweep(table, row, cells, places, columns, degrees, factor, by_scattering=False) -> Sweep:
    word = plain(cells[places["kind"]])
    kind = next((kind for key, kind in _KINDS.items() if word.startswith(key)), None)
    if kind is None:
        raise ValueError(
            f"{table.name}: row {row}: expected a scan in the almucantar, the principal plane or a hybrid one, found "
            f"{cells[places['kind']][:40]!r}"
        )
    wavelength = 1e3 * table.number(row, cells, places["exact"])
    if np.isnan(wavelength) and places["nominal"] is not None:
        wavelength = table.number(row, cells, places["nominal"])
    sun_zenith = table.number(row, cells, places["sun_zenith"])
    for what, value in (("wavelength", wavelength), ("solar zenith angle", sun_zenith)):
        if np.isnan(value):
            raise ValueError(f"{table.name}: row {row}: expected a {what}, found none")
    radiance = factor * np.array([table.number(row, cells, place) for place in columns.tolist()])
    if kind == HYBRID and by_scattering:
        degrees = azimuth_of_hybrid(degrees, sun_zenith)
        lost = np.isnan(degrees)
        if np.isfinite(radiance[lost]).any():
            raise ValueError(f"{table.name}: row {row}: a hybrid scan has no view at some of these scattering angles")
        degrees = np.where(lost, 0.0, degrees)
    moment = moment_in(table, row, cells, places["date"], places["time"])
    return Sweep(moment, round(wavelength, 4), sun_zenith, *view_of(kind, degrees, sun_zenith), radiance, kind, row)


def _radiances(table: Table) -> tuple[dict[int, float], str, int, bool]:
    """The angle of each column of radiance, their units, how many have none, and whether they are scattering angles."""
    angles, units, group, unnamed, scattering = {}, _USUAL_UNITS, "", 0, False
    for place, (name, under) in enumerate(zip(table.names, table.below, strict=True)):
        label = under
        match = _JOINED.fullmatch(name)
        if _NUMBER.fullmatch(name):
            # older files have the angles among the names
            group, label = "radiance", name
        elif match is not None and "radiance" in plain(match[1]):
            group, label = match[1], match[2]
        elif name:
            group = name
        if "radiance" not in plain(group):
            continue
        scattering |= "scattering" in plain(group)
        told = _UNITS.search(group)
        units = told[1].replace("\\", "/") if told else units
        if _NUMBER.fullmatch(label):
            angles[place] = float(label)
        elif any(cells[place] for _, cells in table.rows):
            unnamed += 1
    return angles, units, unnamed, scattering


def _other_groups(table: Table) -> tuple[dict[float, int], list[str]]:
    """The columns of scattering angles by the angle in their name, and the names of columns that are not understood."""
    known = {name for names in COLUMNS.values() for name in names} | {"day_of_year", "last_processing_date"}
    stated, others, group = {}, [], ""
    for place, (name, under) in enumerate(zip(table.names, table.below, strict=True)):
        match = _JOINED.fullmatch(name)
        if _NUMBER.fullmatch(name):
            group = "radiance"
        elif name:
            group, under = (name, under) if match is None else (match[1], match[2])
        word = plain(group)
        if "scattering_angle" in word and "radiance" not in word and _NUMBER.fullmatch(under):
            stated[float(under)] = place
        elif name and "radiance" not in word and word not in known and "scattering_angle" not in word:
            others += [] if group in others else [group]
    return stated, others


def _misfit(table: Table, sweeps: list[Sweep], degrees, stated: dict[float, int]) -> float:
    """The largest difference between the file's scattering angles and those of the views assumed, degrees."""
    worst = 0.0
    columns = [(i, stated[angle]) for i, angle in enumerate(degrees.tolist()) if angle in stated]
    for sweep, (row, cells) in zip(sweeps, table.rows, strict=True):
        for i, place in columns:
            told = table.number(row, cells, place)
            zenith, around = np.radians([sweep.zenith[i], sweep.azimuth[i]])
            away = np.degrees(angle_from_sun(zenith, around, np.radians(sweep.sun_zenith), 0.0))
            if np.isfinite(told):
                worst = max(worst, abs(float(away) - told))
    return worst
