"""Read scans of PREDE's sky radiometers in SKYRAD.pack's form (SKYNET's `DT5`), with the calibration beside them."""

import re
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...light import extraterrestrial_irradiance
from ...light.solar import SPECTRUM_NM
from ..possible import STATION_RANGES
from ..quality.placed_sun import angle_from_sun
from ..samples import Sky
from .scans import ALMUCANTAR, FILTER_FWHM_NM, PRINCIPAL_PLANE, series_of, Sweep
from .screening import screened


_NUMBER = re.compile(r"[\s,]*([-+]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][-+]?\d+)?)")
# SKYRAD writes wavelengths in cm
_NM_PER_CM = 1e7
# largest difference in nm of the same filter in both files
_SAME_FILTER = 0.5
# degrees: largest distance of the first view from the sun, tolerance of a kind of scan, and angles up to which there is
# none (-99, -999)
_TOWARD, _SAME_ANGLE, _NO_ANGLE = 1.0, 0.5, -98.0
_MOST_FILTERS, _MOST_VIEWS = 40, 1000
# degrees; a file whose place changes by more, as on a ship, gets a note
_SAME_PLACE = 0.1
# relative sigma: of the current outside the air by Langley's method, 0.5 to 2.4 % by Nakajima et al. 2020 (Atmos. Meas.
# Tech. 13, 4195), and of that together with the solid angle, which is assumed
_OF_THE_SUN, _OF_THE_SKY = 0.02, 0.03
CALIBRATION_FILE = "ins.para"


@dataclass
class Records:
    """The lines of a text as Fortran's free form reads them: each record begins a line and may extend over the next."""

    name: str
    lines: list[str]
    row: int = 0

    def numbers(self, what: str, count: int) -> list[float]:
        """The next `count` numbers; the rest of their last line is skipped. `ValueError` says what they should be."""
        found: list[float] = []
        start = self.row
        while len(found) < count:
            own, rest = leading(self.lines[self.row] if self.row < len(self.lines) else "the end of the file")
            found += own
            self.row += 1
            # text may follow only the last number
            if rest and len(found) < count:
                raise ValueError(
                    f"{self.name}: row {start + 1}: expected {count} numbers, {what}, found {len(found)}, then "
                    f"{rest[:40]!r}"
                )
        return found[:count]

    def text(self) -> str:
        """The next line."""
        self.row += 1
        return self.lines[self.row - 1].strip() if self.row <= len(self.lines) else ""

    @property
    def more(self) -> bool:
        """Whether anything is left."""
        return any(line.strip() for line in self.lines[self.row :])


@dataclass
class Scan:
    """One scan of a file.

    `current` `[wavelength]`: current of the sun's beam, A, as at 1 au. `ratio` `[direction, wavelength]`: a view's
    current over that of the beam, the air mass and the solid angle, sr^-1. `zenith`, `azimuth` (from the sun)
    `[direction, wavelength]`: degrees.
    """

    row: int
    moment: np.datetime64
    place: tuple[float, float, float]
    sun: tuple[float, float]
    distance_au: float
    wavelength: Float[np.ndarray, " wavelength"]
    current: Float[np.ndarray, " wavelength"]
    zenith: Float[np.ndarray, "direction wavelength"]
    azimuth: Float[np.ndarray, "direction wavelength"]
    ratio: Float[np.ndarray, "direction wavelength"]


@dataclass
class Calibration:
    """The content of `ins.para`.

    `solid_angle`: sr. `outside` `[date, wavelength]`: currents outside the air at 1 au, A, NaN where not calibrated.
    `moment` `[date]`: UTC.
    """

    name: str
    serial: str
    wavelength: Float[np.ndarray, " wavelength"]
    solid_angle: Float[np.ndarray, " wavelength"]
    moment: np.ndarray
    outside: Float[np.ndarray, "date wavelength"]


def leading(line: str) -> tuple[list[float], str]:
    """The numbers with which a line begins, and what follows them."""
    found, at = [], 0
    while match := _NUMBER.match(line, at):
        found.append(float(match[1].upper().replace("D", "E")))
        at = match.end()
    return found, line[at:].strip(" ,")


def is_skyrad(lines: list[str]) -> bool:
    """Whether the first lines are the head of a scan: date and hour, place, sun, wavelengths."""
    head = [leading(line)[0] for line in lines if line.strip()][:4]
    if [len(numbers) for numbers in head[:3]] not in ([7, 4, 4], [4, 4, 4]) or len(head) < 4 or not head[3]:
        return False
    (year, month, day, *_), _, (views, zenith, _, distance), (filters, *_) = head
    whole = all(number == int(number) for number in (year, month, day, views, filters))
    right = 1950 <= year <= 2100 and 1 <= month <= 12 and 1 <= day <= 31 and 0.0 <= zenith <= 180.0
    return whole and right and 0.5 < distance < 2.0 and 1 <= filters <= _MOST_FILTERS and 1 <= views <= _MOST_VIEWS


def read_skyrad(path: Path, station: dict[str, float]) -> Sky:
    r"""Read a file of scans as SKYRAD.pack writes them as a `Sky`, with the sun's beam.

    $L = R m \frac{F}{F_0} \frac{E_0}{d^2}$, $E = \frac{F}{F_0} \frac{E_0}{d^2}$, $m = 1 / \cos\theta_s$

    **Arguments**

    - `path`: text; for each scan a date and hour, the longitude of its clock, longitude, latitude and altitude; number
      of views, sun's zenith angle, azimuth from south and distance; the wavelengths in cm; then for each view and
      wavelength zenith angle, azimuth from the sun and R. The first view is toward the sun and has the sun's current F
      at 1 au in place of R. The currents outside the air F0 are in `ins.para` (or `ins.para.*`) in the same folder or
      in the one above
    - `station`: numbers that replace the file's own, by name

    **Returns** a `Sky` of the scans in time; E0 is the sun's spectrum through filters of 10 nm, or of the width given.

    **Valid** 300-1100 nm, where the sun's spectrum is known; other wavelengths, and those without F0, are left out and
    named. A scan that does not begin toward the sun, or a file without its calibration, is a `ValueError`.
    **Source:** what SKYRAD.pack 5 (Nakajima, Yamano, Hashimoto) reads and writes.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except OSError as error:
        raise ValueError(f"{path.name}: cannot be read: {error.strerror}") from None
    records = Records(path.name, lines)
    scans = []
    while records.more:
        scans.append(_scan(records))
    beside = calibration_beside(path)
    notes: list[str] = []
    known = _known_filters(path.name, scans, beside, notes)
    width = station.get("fwhm_nm", FILTER_FWHM_NM)
    sunlight = dict(zip(known, np.asarray(extraterrestrial_irradiance(np.array(known), width), float), strict=True))
    sweeps = [sweep for scan in scans for sweep in _sweeps(scan, beside, sunlight)]
    _say_what_lacks(scans, sweeps, notes)
    longitude, latitude, altitude = scans[0].place
    told = {"latitude": latitude, "longitude": longitude, "altitude_m": altitude}
    distances = {scan.distance_au for scan in scans}
    if len(distances) == 1:
        told["sun_distance_au"] = distances.pop()
    serial = f" {beside.serial}" if beside.serial else ""
    kinds = ", ".join(dict.fromkeys(sweep.kind for sweep in sweeps))
    instrument = f"PREDE sky radiometer{serial}: {kinds}"
    series = series_of(path.name, sweeps, told | station, notes, instrument, _OF_THE_SKY, _OF_THE_SUN)
    return screened(series.contents)


def _scan(records: Records) -> Scan:
    """The next scan."""
    while not records.lines[records.row].strip():
        records.row += 1
    row = records.row + 1
    # older files have only the hour, without minute and second
    parts = 7 if len(leading(records.lines[records.row])[0]) >= 7 else 4
    date = records.numbers("the date and hour of a scan", parts)
    clock, *place = records.numbers("longitudes of clock and place, latitude and altitude", 4)
    count, zenith, azimuth, distance = records.numbers("number of views, sun's zenith angle, azimuth and distance", 4)
    (filters,) = records.numbers("number of wavelengths", 1)
    count, filters = _whole(records, count, _MOST_VIEWS), _whole(records, filters, _MOST_FILTERS)
    wavelength = _NM_PER_CM * np.array(records.numbers("wavelengths in cm", filters))
    # skip the names of the columns
    records.text()
    cells = [records.numbers(f"zenith angle, azimuth and R of view {view + 1} of {count} at {filters} wavelengths",
                             3 * filters) for view in range(count)]  # fmt: skip
    zeniths, azimuths, values = np.moveaxis(np.array(cells).reshape(count, filters, 3), 2, 0)
    lost = (zeniths <= _NO_ANGLE) | (np.abs(azimuths) > 540.0)
    zeniths, azimuths = np.where(lost, np.nan, zeniths), np.where(lost, np.nan, azimuths)
    # negative zenith angles continue the vertical plane beyond the zenith
    azimuths = np.where(zeniths < 0.0, azimuths + 180.0, azimuths)
    zeniths = np.abs(zeniths)
    values = np.where(values > 0.0, values, np.nan)
    if not 0.0 <= zenith < 90.0:
        raise ValueError(f"{records.name}: row {row}: expected the sun's zenith angle in [0, 90), found {zenith:g}")
    low, high, _ = STATION_RANGES["sun_distance_au"]
    if not low <= distance <= high:
        raise ValueError(f"{records.name}: row {row}: expected the sun at {low:g} to {high:g} au, found {distance:g}")
    from_sun = np.nan_to_num(_degrees_from_sun(zeniths[0], azimuths[0], zenith)) * np.isfinite(values[0])
    if from_sun.max() > _TOWARD:
        raise ValueError(
            f"{records.name}: row {row}: expected the first view toward the sun, found it {from_sun.max():.1f} degrees "
            "off"
        )
    return Scan(
        row, _moment(records.name, row, date, clock), (place[0], place[1], place[2]), (zenith, 180.0 + azimuth),
        distance, np.round(wavelength, 4), values[0], zeniths[1:], azimuths[1:], values[1:],
    )  # fmt: skip


def _whole(records: Records, number: float, most: int) -> int:
    if number != int(number) or not 1 <= number <= most:
        raise ValueError(f"{records.name}: row {records.row}: expected a count from 1 to {most}, found {number:g}")
    return int(number)


def _degrees_from_sun(zenith, azimuth, sun_zenith):
    return np.degrees(angle_from_sun(np.radians(zenith), np.radians(azimuth), np.radians(sun_zenith), 0.0))


def _moment(name: str, row: int, date: list[float], clock: float) -> np.datetime64:
    """UTC of a date whose clock shows the time of a longitude, degrees east."""
    year, month, day, *hours = date
    seconds = 3600.0 * hours[0] if len(hours) == 1 else 3600.0 * hours[0] + 60.0 * hours[1] + hours[2]
    try:
        midnight = datetime(int(year), int(month), int(day))
    except ValueError:
        raise ValueError(f"{name}: row {row}: expected year, month and day, found {year:g} {month:g} {day:g}") from None
    if not (0.0 <= seconds <= 86400.0 and abs(clock) <= 360.0):
        raise ValueError(f"{name}: row {row}: expected an hour of the day, found {seconds / 3600.0:g} at {clock:g} E")
    return np.datetime64(midnight, "s") + np.timedelta64(round(seconds - 240.0 * clock), "s")


def calibration_beside(path: Path) -> Calibration:
    """The calibration of a file's instrument: `ins.para` in its folder, or in the one above, or the only `ins.para.*`.

    **Errors:** `ValueError` where there is none, or several.
    """
    for folder in (path.absolute().parent, path.absolute().parent.parent):
        plain = folder / CALIBRATION_FILE
        found = [plain] if plain.is_file() else sorted(folder.glob(f"{CALIBRATION_FILE}.*"))
        if len(found) == 1:
            return _calibration(found[0])
        if found:
            names = ", ".join(one.name for one in found)
            raise ValueError(f"{path.name}: expected one {CALIBRATION_FILE} beside it, found {names}")
    raise ValueError(
        f"{path.name}: expected a file {CALIBRATION_FILE} beside it with the currents outside the air, found none: "
        "without them there is no radiance"
    )


def _calibration(path: Path) -> Calibration:
    records = Records(path.name, path.read_text(encoding="utf-8-sig", errors="replace").splitlines())
    records.text()
    serial = re.sub(r"\s*:.*", "", records.text()).strip().strip("\"'")
    records.numbers("the type of the instrument", 1)
    count = _whole(records, records.numbers("number of wavelengths", 1)[0], _MOST_FILTERS)
    wavelength = _NM_PER_CM * np.array(records.numbers("wavelengths in cm", count))
    solid_angle = np.array(records.numbers("solid angles in sr", count))
    dates = int(records.numbers("number of dates", 1)[0])
    rows = [records.numbers("year, month, day, hour and the current outside the air at each wavelength", 4 + count)
            for _ in range(dates)]  # fmt: skip
    outside = np.array([row[4:] for row in rows]).reshape(dates, count)
    return Calibration(
        path.name, serial, wavelength, solid_angle,
        np.array([_moment(path.name, records.row, row[:4], 0.0) for row in rows], "datetime64[s]"),
        np.where(outside > 0.0, outside, np.nan),
    )  # fmt: skip


def _outside(beside: Calibration, wavelength: float, moment: np.datetime64) -> float:
    """The current outside the air, linear between the dates and held beyond them; NaN where not calibrated."""
    place = int(np.argmin(np.abs(beside.wavelength - wavelength)))
    known = np.isfinite(beside.outside[:, place])
    if abs(beside.wavelength[place] - wavelength) > _SAME_FILTER or not known.any():
        return np.nan
    seconds = (beside.moment[known] - moment) / np.timedelta64(1, "s")
    order = np.argsort(seconds)
    return float(np.interp(0.0, seconds[order], beside.outside[known, place][order]))


def _known_filters(name: str, scans: list[Scan], beside: Calibration, notes: list[str]) -> list[float]:
    """The wavelengths that can be read as radiance, by increasing wavelength."""
    every = sorted({float(one) for scan in scans for one in scan.wavelength})
    dark = [one for one in every if not SPECTRUM_NM[0] <= one <= SPECTRUM_NM[1]]
    moment = scans[0].moment
    dull = [one for one in every if one not in dark and np.isnan(_outside(beside, one, moment))]
    known = [one for one in every if one not in dark and one not in dull]
    for lost, why in ((dark, "beyond the sun's spectrum, 300-1100 nm"), (dull, f"without a current in {beside.name}")):
        if lost:
            notes.append(f"{', '.join(f'{one:g}' for one in lost)} nm left out, {why}")
    if not known:
        raise ValueError(f"{name}: expected a calibrated wavelength in {beside.name}, found none: {'; '.join(notes)}")
    dates = beside.moment.astype("datetime64[D]")
    span = " to ".join(dict.fromkeys(str(end) for end in (dates.min(), dates.max())))
    cone = np.degrees(2.0 * np.sqrt(np.median(beside.solid_angle) / np.pi))
    notes.append(f"radiance and beam by the currents outside the air of {beside.name}, {span}")
    if np.isfinite(cone) and cone > 0.0:
        notes.append(f"its solid angles are cones of {cone:.2f} degrees, which a fit heeds if it is told so")
    return known


def _sweeps(scan: Scan, beside: Calibration, sunlight: dict[float, float]) -> list[Sweep]:
    """The sweeps of a scan, one for each filter in `sunlight` (W m^-2 nm^-1 at 1 au)."""
    zenith, azimuth = scan.sun
    kind = _kind(scan)
    sweeps = []
    for w, wavelength in enumerate(scan.wavelength.tolist()):
        if wavelength not in sunlight:
            continue
        outside = _outside(beside, wavelength, scan.moment)
        beam = scan.current[w] / outside * sunlight[wavelength] / scan.distance_au**2
        placed = np.isfinite(scan.zenith[:, w]) & np.isfinite(scan.azimuth[:, w])
        radiance = np.where(placed, scan.ratio[:, w] * beam / np.cos(np.radians(zenith)), np.nan)
        # a sample without a view is missing: any view will do
        view = np.where(placed, scan.zenith[:, w], zenith), np.where(placed, scan.azimuth[:, w], 0.0)
        sun = azimuth % 360.0, float(beam)
        sweeps.append(Sweep(scan.moment, wavelength, zenith, *view, radiance, kind, scan.row, *sun))
    return sweeps


def _kind(scan: Scan) -> str:
    if np.nan_to_num(np.abs(scan.zenith - scan.sun[0])).max(initial=0.0) <= _SAME_ANGLE:
        return ALMUCANTAR
    across = np.nan_to_num(np.abs(np.sin(np.radians(scan.azimuth))) * np.sin(np.radians(scan.zenith)))
    return PRINCIPAL_PLANE if across.max(initial=0.0) < np.sin(np.radians(_SAME_ANGLE)) else "sky scan"


def _say_what_lacks(scans: list[Scan], sweeps: list[Sweep], notes: list[str]) -> None:
    lost = sum(int((np.isnan(scan.zenith) & np.isfinite(scan.ratio)).sum()) for scan in scans)
    if lost:
        notes.append(f"{lost} samples have no zenith angle or azimuth: left out")
    sunless = sum(bool(np.isnan(sweep.beam)) for sweep in sweeps)
    if sunless:
        notes.append(f"{sunless} of {len(sweeps)} scans and wavelengths have no current of the sun: no radiance either")
    way = np.ptp(np.array([scan.place[:2] for scan in scans]), axis=0).max()
    if way > _SAME_PLACE:
        notes.append(f"the place changes by up to {way:.1f} degrees: that of the first scan stands")
