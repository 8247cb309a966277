"""Read tables of sky scanners: the luminance of Tregenza's 145 patches, one row for each time."""

import csv
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..response import Response
from ..samples import Sky
from ..units import luminance_factor
from .header import Head
from .screening import Contents, screened


# elevation in degrees and number of patches of each band (Tregenza 1987, Lighting Res. Technol. 19, 13)
BANDS = ((6.0, 30), (18.0, 30), (30.0, 24), (42.0, 24), (54.0, 18), (66.0, 12), (78.0, 6), (90.0, 1))
PATCHES = sum(count for _, count in BANDS)
_CLOCKS = (
    "%Y-%m-%dT%H:%M:%S", "%Y-%m-%d %H:%M:%S", "%Y-%m-%dT%H:%M", "%Y-%m-%d %H:%M", "%Y/%m/%d %H:%M:%S",
    "%Y/%m/%d %H:%M",
)  # fmt: skip
_MISSING = (-999.0, -9999.0)
# median luminance that is doubted, cd m-2: a sky by day has a thousand or more, a file in kcd m-2 a few
_DIM = 100.0
# largest roughness of one order of the patches over that of the other for which the first is believed
_CLEARER = 0.9


def is_scanner(lines: list[str]) -> bool:
    """Whether one of the first lines holds a time and the numbers of 145 patches."""
    return any(_patches(cells) is not None for cells in csv.reader(lines))


def _patches(cells: list[str]) -> int | None:
    """The index in a row at which the numbers of the patches begin, None if it is no row of a scanner."""
    while cells and not cells[-1].strip():
        cells = cells[:-1]
    start = len(cells) - PATCHES
    # a time, or a day and a time
    if start not in (1, 2) or not re.match(r"\d{4}[-/]\d", cells[0].strip()):
        return None
    return start


def read_scanner(path: Path, station: dict[str, float], utc_offset: float | int | None = None) -> Sky:
    """Read a sky scanner's table as a `Sky` of luminance, cd m^-2.

    **Arguments**

    - `path`: CSV; rows of a time (or a day and a time) and 145 luminances, in cd m-2, or in the unit of a line
      `# units: kcd m-2` or of the names, in Tregenza's order: bands of 30, 30, 24, 24, 18, 12 and 6 patches at 6 to 78
      degrees elevation from north, then the zenith; lines `# key: value` above state the station (`header`)
    - `station`: numbers that replace the file's own, by name; `utc_offset`: hours of local time ahead of UTC

    **Returns** a `Sky` of one channel, the eye's. The sky itself shows whether all bands go clockwise, or every other
    one goes back: neighbours are alike. -999 and empty cells are missing.

    **Valid** latitude and longitude, from the file or `station`, place the sun; without them `ValueError`.
    """
    name = path.name
    text = path.read_text(encoding="utf-8-sig")
    head, names, times, values = Head(name), "", [], []
    for row, line in enumerate(text.splitlines(), start=1):
        if line.lstrip().startswith("#"):
            head.line(f"row {row}, key", line.lstrip().lstrip("#").strip())
            continue
        (cells,) = list(csv.reader([line])) or [[]]
        start = _patches(cells)
        if start is None:
            if not times:
                names += line
            elif line.strip():
                raise ValueError(
                    f"{name}: row {row}: expected a time and {PATCHES} luminances, found {len(cells)} cells"
                )
            continue
        times.append(_moment(name, row, " ".join(cell.strip() for cell in cells[:start])))
        values.append([_number(name, row, cell) for cell in cells[start : start + PATCHES]])
    if not times:
        raise ValueError(f"{name}: expected rows of a time and {PATCHES} luminances, found none")
    light = np.array(values)
    light[np.isin(light, _MISSING)] = np.nan
    factor, notes = _scale(name, head, names, light)
    light = light * factor
    order, said = _order(light)
    notes += [said]
    if head.unknown:
        notes.append(f"header keys not used: {', '.join(head.unknown)}")
    time = np.array(times)
    if utc_offset is None:
        notes.append("times taken as UTC: give the offset of local time if they are not")
    else:
        time = time - np.timedelta64(round(3600.0 * utc_offset), "s")
        notes.append(f"local time taken as UTC{utc_offset:+g} h")
    zenith, azimuth = tregenza()
    unknown = np.full(len(times), np.nan)
    response = Response.eye()
    return screened(
        Contents(
            name=name,
            radiance=light[:, order, None],
            view_zenith=zenith,
            view_azimuth=azimuth,
            wavelength=response.centre_nm,
            time=time,
            sun_zenith=unknown,
            sun_azimuth=unknown.copy(),
            station=head.station | station,
            notes=head.notes + notes,
            response=response,
            instrument=f"sky scanner, {PATCHES} patches",
        )
    )


def tregenza() -> tuple[Float[np.ndarray, " direction"], Float[np.ndarray, " direction"]]:
    """Zenith angles and azimuths of the patches, degrees, each band clockwise from north."""
    zenith = np.concatenate([np.full(count, 90.0 - elevation) for elevation, count in BANDS])
    azimuth = np.concatenate([360.0 / count * np.arange(count) for _, count in BANDS])
    return zenith, azimuth


def _order(light: Float[np.ndarray, "time direction"]) -> tuple[np.ndarray, str]:
    """The index in a row of each patch of `tregenza`, and a note: all bands go clockwise, or every other goes back."""
    clockwise, back, start = np.arange(PATCHES), [], 0
    for band, (_, count) in enumerate(BANDS):
        places = start + np.arange(count)
        back.append(places[::-1] if band % 2 else places)
        start += count
    back = np.concatenate(back)
    rough = _roughness(light[:, clockwise]), _roughness(light[:, back])
    if rough[1] < _CLEARER * rough[0]:
        return back, "every other band of patches goes back, counter-clockwise: so the sky is smooth"
    told = "" if rough[0] < _CLEARER * rough[1] else ", though the sky does not tell"
    return clockwise, f"all bands of patches taken clockwise from north{told}"


def _roughness(light) -> float:
    """The difference of neighbouring bands at the same azimuths, in the logarithm of luminance."""
    logs = np.log(np.where(light > 0.0, light, np.nan))
    total, start = 0.0, 0
    bands = []
    for _, count in BANDS[:-1]:
        bands.append(logs[:, start : start + count])
        start += count
    for lower, upper in zip(bands[:-1], bands[1:], strict=True):
        places = np.arange(upper.shape[1]) * lower.shape[1] // upper.shape[1]
        step = lower[:, places] - upper
        step = step - np.nanmedian(step) if np.isfinite(step).any() else step
        total += float(np.nansum(np.abs(step)))
    return total


def _scale(name, head, names, light) -> tuple[float, list[str]]:
    told = head.units[0] if head.units else None
    if told is None:
        found = re.search(r"k?cd\s*(?:/|\.)?\s*m\s*\^?-?2", names)
        told = None if found is None else found[0]
    if told is not None:
        factor = luminance_factor(told)
        if factor is None:
            raise ValueError(f"{name}: expected units cd m-2 of luminance, found {told!r}")
        return factor, [] if factor == 1.0 else [f"luminance converted from {told} to cd m-2"]
    median = float(np.nanmedian(light)) if np.isfinite(light).any() else np.nan
    doubt = f"; a median of {median:.3g} is dim for a day: is this kcd m-2?" if median < _DIM else ""
    return 1.0, [f"luminance taken to be in cd m-2, the file does not say{doubt}"]


def _moment(name, row, text):
    from datetime import datetime

    for form in _CLOCKS:
        try:
            return np.datetime64(datetime.strptime(text.removesuffix("Z"), form), "ns")
        except ValueError:
            continue
    raise ValueError(f"{name}: row {row}: expected a time such as 2024-06-21T12:00:00, found {text[:40]!r}")


def _number(name, row, cell):
    if not cell.strip():
        return np.nan
    try:
        return float(cell)
    except ValueError:
        raise ValueError(f"{name}: row {row}: expected a luminance, found {cell[:40]!r}") from None
