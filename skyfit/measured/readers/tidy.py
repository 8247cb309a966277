"""Read tidy CSV, in which one row is one sample."""

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..samples import DEGREE, Sky
from .colours import colour_names, coloured_rows
from .flags import FLAG_NAMES, flagged_cells
from .grid import Axis, by_time, fill, repeated
from .header import Head, moment_of, quantity_of
from .normalised import in_sunlight, normalised_name, share_of
from .scale import scale_of
from .screening import check_angles, Contents, screened


REQUIRED = ("view_zenith", "view_azimuth", "wavelength", "radiance")
# What an empty cell means; None where it is an error.
_EMPTY = {
    **dict.fromkeys(REQUIRED),
    "radiance": np.nan,
    "sigma": np.nan,
    "suspect": 0.0,
    **dict.fromkeys(("sun_zenith", "sun_azimuth"), np.nan),
    **dict.fromkeys(("direct_normal_irradiance", "direct_normal_irradiance_sigma", *DEGREE), np.nan),
}
# These have one value per time and wavelength
SUN = ("sun_zenith", "sun_azimuth")
BEAM = ("direct_normal_irradiance", "direct_normal_irradiance_sigma")
# these may not change within a file
_OF_PLACE = ("latitude", "longitude")
# A grid this large and this empty comes from samples that share no grid.
_LARGEST_GRID = 20_000_000
_EMPTIEST_GRID = 100


def read_tidy(path: Path, station: dict[str, float], own_units: bool = False) -> Sky:
    """Read a tidy CSV of sky radiance as a `Sky`.

    **Arguments**

    - `path`: columns view_zenith, view_azimuth (degrees), wavelength (nm), radiance
      (W m^-2 sr^-1 nm^-1), or luminance (cd m^-2), alone or with x and y (CIE 1931), in place of the last two,
      or normalized_radiance (pi L / E0) in place of radiance; radiance in sr-1 (L / E0) is normalised too;
      optionally time (ISO, UTC), sigma, suspect (1 = masked), quality_flag (0 = good, other masked),
      degree_of_polarisation and its `_sigma`, and, the same in all rows of a time and wavelength, sun_zenith,
      sun_azimuth, direct_normal_irradiance and its `_sigma` (W m^-2 nm^-1); lines `# key: value` above, or columns of
      one value, carry latitude, longitude, altitude_m, pressure_pa, fwhm_nm, ozone_du, sun_distance_au in the
      spellings and units that `header` knows; only lines carry units, saturation, notes, and time without a column
    - `station`: numbers that replace the file's own, by name; `own_units`: units are those of channels, of any name

    **Returns** a `Sky`; directions are the union over times, with masked samples where absent, or those of each time
    if half of the union or more would have no samples, as for an almucantar, which moves with the sun.

    **Valid** a sample given twice, or text where a number belongs, is a `ValueError` with its row.
    """
    name = path.name
    header, comments, rows = _open(path)
    normalised = normalised_name(header)
    header = ["radiance" if key == normalised else key for key in header]
    colours = None if "radiance" in header else colour_names(header)
    _require(name, header, REQUIRED if colours is None else (*REQUIRED[:2], colours[0]))
    lines, cells = [], []
    for line, row in rows:
        lines.append(line)
        cells.append(row)
    if not lines:
        raise ValueError(f"{name}: expected rows of samples below the header, found none")
    texts = dict(zip(header, zip(*cells, strict=True), strict=True))
    light = () if colours is None else (colours[0], *(colours[1] or ()))
    kinds = _EMPTY | dict.fromkeys(light, np.nan)
    number = {key: _column(name, lines, key, texts[key], empty) for key, empty in kinds.items() if key in texts}
    times, directions, wavelengths = Axis(), Axis(), Axis()
    head = Head(name)
    for line, text in comments:
        head.line(f"row {line}, key", text)
    flags = {key: flagged_cells(key, texts[key]) for key in header if key.lower() in FLAG_NAMES}
    of_file = _of_file(head, lines, texts, {*kinds, *flags})
    unused = {
        "columns": [key for key in header if key not in {*number, *flags, *of_file, "time"}],
        "header keys": head.unknown,
    }
    stated = {reason: where for reasons, _ in flags.values() for reason, where in reasons.items()}
    # Without a column `time` all samples are of one time, known only if the head says it.
    moments = _moments(name, lines, texts["time"]) if "time" in texts else [head.moment.astype(int).item()] * len(lines)
    factor, converted, response, share = 1.0, [], None, None
    if colours is not None:
        number, response, converted = _coloured(head, colours, number)
        count = len(number["radiance"]) // len(lines)
        lines, moments = lines * count, moments * count
        stated = {reason: np.tile(where, count) for reason, where in stated.items()}
    angles = zip(number["view_zenith"].tolist(), number["view_azimuth"].tolist(), strict=True)
    index = np.array(
        [
            [times.place(moment) for moment in moments],
            [directions.place(pair) for pair in angles],
            [wavelengths.place(value) for value in number["wavelength"].tolist()],
        ]
    )
    views = np.array(directions.values())
    which = index[1].copy()
    index[1], view = by_time(index[0], which)
    shape = (len(times), view.shape[-1], len(wavelengths))
    _check_grid(name, shape, len(lines))
    twice = repeated(shape, index)
    if twice is not None:
        raise ValueError(
            f"{name}: rows {lines[twice[0]]} and {lines[twice[1]]}: expected each time, direction "
            "and wavelength once, found the same sample twice"
        )
    if colours is None:
        share = _share(head, own_units, normalised is not None)
        if share is None:
            factor, converted, response = _units(head, len(wavelengths), own_units)
    sun, sun_rows = _sun(name, lines, number, index, shape)
    beam = [_per_band(name, lines, key, number, index, shape) for key in BEAM]
    numbers = head.station | station
    notes = head.notes + converted + [note for _, note in flags.values()]
    notes += [f"{what} not used: {', '.join(keys)}" for what, keys in unused.items() if keys]
    time = np.array(times.values(), dtype=np.int64).view("datetime64[ns]")
    order = np.argsort(time, kind="stable")

    first = {
        axis: np.array(lines)[np.unique(places, return_index=True)[1]]
        for axis, places in zip(("time", "direction", "wavelength"), (index[0], which, index[2]), strict=True)
    }
    if sun_rows is not None:
        first["sun"] = sun_rows[order]
    first["time"], view = first["time"][order], view if view.ndim == 1 else view[order]
    # the row of a direction's first appearance at any time, where wrong angles appear first
    first["direction"] = first["direction"][view]
    zenith, azimuth = (np.where(view < 0, np.nan, angle[view]) for angle in views.T)

    def gridded(values, absent):
        return fill(shape, index, values, absent)[order]

    degree = [gridded(number[key], np.nan) if key in number else None for key in DEGREE]
    sky = screened(
        Contents(
            name=name,
            degree=degree[0],
            degree_sigma=degree[1],
            radiance=gridded(number["radiance"], np.nan) * factor,
            sigma=gridded(number["sigma"], np.nan) * factor if "sigma" in number else None,
            suspect=gridded(number["suspect"], 0.0) != 0.0 if "suspect" in number else None,
            reasons={reason: gridded(where, 0.0) != 0.0 for reason, where in stated.items()},
            direct=None if beam[0] is None else beam[0][order],
            direct_sigma=None if beam[1] is None else beam[1][order],
            view_zenith=zenith,
            view_azimuth=azimuth,
            wavelength=np.array(wavelengths.values()),
            time=time[order],
            sun_zenith=sun[0][order],
            sun_azimuth=sun[1][order],
            station=numbers,
            saturation=None if head.saturation is None else head.saturation * factor,
            notes=notes,
            made_by=head.made_by,
            calibration_sigma=head.calibration_sigma,
            follows_sun=head.follows_sun,
            response=response,
            rows={axis: rows.tolist() for axis, rows in first.items()},
        )
    )
    return sky if share is None else in_sunlight(sky, share)


def read_directions(
    path: str | Path,
) -> tuple[Float[np.ndarray, " direction"], Float[np.ndarray, " direction"]]:
    """View directions from a CSV with the columns view_zenith and view_azimuth in degrees.

    **Arguments** `path`: the file; other columns are ignored.

    **Returns** zenith and azimuth (clockwise from north), rad, [direction], in the file's order.

    **Valid** zenith angles of 0 to 90 degrees; a direction below the horizon is a `ValueError`.
    """
    path = Path(path)
    name = path.name
    header, _, rows = _open(path)
    _require(name, header, REQUIRED[:2])
    angles = []
    for line, cells in rows:
        pair = [_number(name, line, key, cells[header.index(key)], None) for key in REQUIRED[:2]]
        for key, value, low, high in zip(REQUIRED[:2], pair, (0.0, -360.0), (90.0, 720.0), strict=True):
            if not low <= value <= high:
                raise ValueError(
                    f"{name}: row {line}, column `{key}`: expected degrees in [{low:g}, {high:g}], found {value:g}"
                )
        angles.append(pair)
    if not angles:
        raise ValueError(f"{name}: expected rows of directions below the header, found none")
    zenith, azimuth = np.array(angles).T
    check_angles(name, zenith, azimuth)
    return np.deg2rad(zenith), np.deg2rad(azimuth)


def read_numbers(path: Path) -> tuple[list[str], Float[np.ndarray, "row column"]]:
    """The header and the numbers of a CSV of numbers alone.

    **Valid** a cell that is no finite number is a `ValueError` with its row.
    """
    header, _, rows = _open(path)
    numbers = [
        [_number(path.name, line, key, cell, None) for key, cell in zip(header, cells, strict=True)]
        for line, cells in rows
    ]
    return header, np.array(numbers).reshape(-1, len(header))


def _open(path):
    """Header, `# key: value` comments and (line number, cells) of the rows, all checked."""
    name = path.name
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{name}: expected CSV text in UTF-8, found bytes ({error})") from None
    except OSError as error:
        raise ValueError(f"{name}: cannot be read: {error.strerror}") from None
    comments, lines, numbers = [], [], []
    for number, line in enumerate(text.split("\n"), start=1):
        if line.lstrip().startswith("#"):
            comments.append((number, line.lstrip().lstrip("#").strip()))
        elif line.strip():
            lines.append(line)
            numbers.append(number)
    if not lines:
        raise ValueError(f"{name}: expected a header row and samples, found an empty file")
    try:
        header = [cell.strip() for cell in next(csv.reader(lines[:1], strict=True))]
    except csv.Error as error:
        raise ValueError(f"{name}: row {numbers[0]}: expected CSV, found {error}") from None
    for position, key in enumerate(header):
        if key in header[:position]:
            raise ValueError(f"{name}: row {numbers[0]}: expected different columns, found `{key}` twice")
    return header, comments, _rows(name, header, lines, numbers)


def _rows(name, header, lines, numbers) -> Iterator[tuple[int, list[str]]]:
    reader = csv.reader(lines[1:], strict=True)
    while True:
        # A quote that is never closed would swallow the lines after it.
        line = numbers[min(reader.line_num + 1, len(numbers) - 1)]
        try:
            cells = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            raise ValueError(f"{name}: row {line}: expected CSV, found {error}") from None
        if len(cells) != len(header):
            raise ValueError(f"{name}: row {line}: expected {len(header)} columns as in the header, found {len(cells)}")
        yield line, cells


def _require(name, header, keys):
    lacking = [key for key in keys if key not in header]
    if lacking:
        raise ValueError(
            f"{name}: expected column {', '.join(f'`{key}`' for key in lacking)}, found {', '.join(header)[:200]}"
        )


def _number(name, line, key, text, empty):
    text = text.strip()
    if text == "" and empty is not None:
        return empty
    try:
        # Python takes 1_000 for a number; a table does not mean that.
        value = float("none" if "_" in text else text)
    except ValueError:
        value = None
    if value is None or (empty is None and not np.isfinite(value)):
        raise ValueError(f"{name}: row {line}, column `{key}`: expected a number, found {text[:60]!r}")
    return value


def _column(name, lines, key, texts, empty):
    """A column as numbers; an empty cell is `empty`, or an error if that is None."""
    known = {}
    for line, text in zip(lines, texts, strict=True):
        if text not in known:
            known[text] = _number(name, line, key, text, empty)
    return np.array([known[text] for text in texts])


def _moments(name, lines, texts):
    """Times as nanoseconds since 1970."""
    known = {}
    for line, text in zip(lines, texts, strict=True):
        if text not in known:
            known[text] = _moment(name, line, text.strip()).astype(np.int64).item()
    return [known[text] for text in texts]


def _moment(name, line, text):
    try:
        return moment_of(text)
    except ValueError:
        raise ValueError(
            f"{name}: row {line}, column `time`: expected an ISO time such as 2013-05-27T14:00:00Z, found {text[:60]!r}"
        ) from None


def _shared(name, lines, key, values, group, scope):
    """The one value of each group; rows of one group must not differ."""
    _, first = np.unique(group, return_index=True)
    expected = values[first][group]
    differs = (values != expected) & ~(np.isnan(values) & np.isnan(expected))
    if np.any(differs):
        row = int(np.argmax(differs))
        raise ValueError(
            f"{name}: row {lines[row]}, column `{key}`: expected one value per {scope}, found "
            f"{values[row]:g} after {expected[row]:g} in row {lines[first[group[row]]]}"
        )
    return values[first]


def _sun(name, lines, number, index, shape):
    """The sun's angles, `[time]`, or `[time, wavelength]` if it moves, NaN in holes, and then the row of each."""
    grids = [_per_band(name, lines, key, number, index, shape) for key in SUN]
    grids = [np.full(shape[::2], np.nan) if grid is None else grid for grid in grids]
    known = [~np.isnan(grid) for grid in grids]
    first = [grid[np.arange(shape[0]), there.argmax(axis=1)] for grid, there in zip(grids, known, strict=True)]
    if all(np.all((g == f[:, None]) | ~k) for g, f, k in zip(grids, first, known, strict=True)):
        return first, None
    rows = np.zeros(shape[::2], int)
    rows[index[0][::-1], index[2][::-1]] = lines[::-1]
    return grids, rows


def _per_band(name, lines, key, number, index, shape):
    """A column of one number per time and wavelength on these axes, NaN where the table has no row; None if absent."""
    if key not in number:
        return None
    places, group = np.unique(index[0] * shape[2] + index[2], return_inverse=True)
    values = np.full(shape[0] * shape[2], np.nan)
    values[places] = _shared(name, lines, key, number[key], group, "time and wavelength")
    return values.reshape(shape[0], shape[2])


def _check_grid(name, shape, count):
    size = shape[0] * shape[1] * shape[2]
    if size > _LARGEST_GRID and size > _EMPTIEST_GRID * count:
        raise ValueError(
            f"{name}: columns `time`, `view_zenith`, `view_azimuth`, `wavelength`: expected "
            f"samples on a shared grid, found {count} samples on {shape[0]} times, {shape[1]} "
            f"directions and {shape[2]} wavelengths"
        )


def _of_file(head, lines, texts, others):
    """The columns with one value of the station in all rows, which `head` takes, without those in `others`."""
    taken = []
    for key in texts:
        quantity = quantity_of(key)
        if key in others or quantity is None:
            continue
        values = _column(head.name, lines, key, texts[key], np.nan)
        if quantity[0] in _OF_PLACE:
            _shared(head.name, lines, key, values, np.zeros(len(lines), int), "file")
        first = values[0]
        # a pressure that varies between rows is not that of the file
        if np.all((values == first) | np.isnan(values) & np.isnan(first)):
            taken.append(key)
            if np.isfinite(first):
                head.number(f"row {lines[0]}, column", key, f"{float(first)!r}")
    return taken


def _coloured(head, colours, number):
    text, place = (None, "") if head.units is None else head.units
    try:
        return coloured_rows(colours, number, text)
    except ValueError as error:
        raise ValueError(f"{head.name}: {place}{place and ': '}{error}") from None


def _share(head, own, normalised):
    """The factor of samples that are a share of the sun's irradiance; None if they are in a unit of their own."""
    text, place = (None, "") if head.units is None else head.units
    try:
        return None if own else share_of(text, normalised)
    except ValueError as error:
        raise ValueError(f"{head.name}: {place}{place and ': '}{error}") from None


def _units(head, channels, own):
    """The factor of the units that a file states, a note on conversion, and the eye's response for luminance."""
    if head.units is None:
        return 1.0, [], None
    text, place = head.units
    try:
        return scale_of(text, channels, own)
    except ValueError as error:
        raise ValueError(f"{head.name}: {place}: {error}") from None
