"""Tables of AERONET's Version 3 as text: lines of a head, names, and rows in time."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .header import plain


# numbers up to this are missing: AERONET writes -999, or a number that rounds to it
_MISSING = -998.0
# names of the columns, in the spelling of `plain`
COLUMNS = {
    "site": ("aeronet_site", "aeronet_site_name", "site"),
    "date": ("date_dd_mm_yyyy", "date_dd_mm_yy", "date"),
    "time": ("time_hh_mm_ss", "time"),
    "number": ("instrument_number", "device_number", "aeronet_instrument_number"),
    "exact": ("exact_wavelength_um", "exact_wavelength"),
    "nominal": ("nominal_wavelength_nm", "nominal_wavelength"),
    "sun_zenith": ("solar_zenith_angle_degrees", "solar_zenith_angle"),
    "kind": ("sky_scan_type", "scan_type"),
    "latitude": ("latitude_degrees", "site_latitude_degrees", "latitude"),
    "longitude": ("longitude_degrees", "site_longitude_degrees", "longitude"),
    "altitude_m": ("elevation_m", "site_elevation_m", "elevation"),
}


@dataclass
class Table:
    """The rows of a file by AERONET, with names and cells as in the file."""

    name: str
    head: list[str]
    names: list[str]
    below: list[str]
    rows: list[tuple[int, list[str]]]

    def place(self, what: str) -> int | None:
        """The column of one of `COLUMNS`, None where there is none."""
        known = [plain(name) for name in self.names]
        return next((known.index(name) for name in COLUMNS[what] if name in known), None)

    def number(self, row: int, cells: list[str], place: int) -> float:
        """A cell as a number, NaN if it is missing."""
        try:
            value = float(cells[place])
        except ValueError:
            raise ValueError(
                f"{self.name}: row {row}, column `{self.names[place] or place + 1}`: expected a number, found "
                f"{cells[place][:60]!r}"
            ) from None
        return value if _MISSING < value and np.isfinite(value) else np.nan


def table_of(path: Path, start: str) -> Table:
    """The rows under the line of names, which holds the word `start`."""
    name = path.name
    try:
        lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except OSError as error:
        raise ValueError(f"{name}: cannot be read: {error.strerror}") from None
    at = next((i for i, line in enumerate(lines) if start in line and "Date(dd" in line), None)
    if at is None:
        raise ValueError(f"{name}: expected a line of names with {start}, found none")
    names = [cell.strip() for cell in lines[at].split(",")]
    cells = [(i + 1, [cell.strip() for cell in line.split(",")]) for i, line in enumerate(lines) if i > at]
    cells = [(row, line) for row, line in cells if any(line)]
    below: list[str] = []
    # a second line of names holds angles alone, under the last name
    if cells and not any(cells[0][1][: names.index(next(n for n in names if "Date(dd" in n)) + 1]):
        below = cells.pop(0)[1]
    width = max(len(names), len(below))
    names, below = names + [""] * (width - len(names)), below + [""] * (width - len(below))
    for row, line in cells:
        # spreadsheets and AERONET itself end a line with an empty cell or none
        del line[width:]
        if any(names[len(line) :]) or any(below[len(line) :]):
            raise ValueError(
                f"{name}: row {row}: expected {width} cells as in the names, found {len(line)}: cut short?"
            )
        line += [""] * (width - len(line))
    if not cells:
        raise ValueError(f"{name}: expected rows below the names, found none")
    return Table(name, lines[:at], names, below, cells)


def moment_in(table: Table, row: int, cells: list[str], date: int, time: int) -> np.datetime64:
    """The time of a row, UTC."""
    day, clock = (re.findall(r"\d+", cells[place]) for place in (date, time))
    try:
        return np.datetime64(
            f"{day[2]:0>4}-{day[1]:0>2}-{day[0]:0>2}T{clock[0]:0>2}:{clock[1]:0>2}:{clock[2]:0>2}", "ns"
        )
    except (IndexError, ValueError):
        raise ValueError(
            f"{table.name}: row {row}: expected a date dd:mm:yyyy and a time hh:mm:ss, found "
            f"{cells[date][:20]!r} and {cells[time][:20]!r}"
        ) from None


def only(table: Table, place: int | None, what: str) -> str:
    """The one text of a column, which all rows share, "" without such a column."""
    if place is None:
        return ""
    found = list(dict.fromkeys(cells[place] for _, cells in table.rows))
    if len(found) > 1:
        raise ValueError(
            f"{table.name}: column `{table.names[place]}`: expected one {what} in a file, found {len(found)}: "
            f"{', '.join(found[:3])}"
        )
    return found[0]
