"""Read the station and the instrument from the head of a file, with keys and units in any common spelling."""

import json
import re
from dataclasses import dataclass, field
from datetime import datetime, UTC

import numpy as np

from ...light import earth_sun_factor
from ..station import day_of_year


_LENGTH = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("km", "kilometer", "kilometers", "kilometre", "kilometres"), 1e3),
    **dict.fromkeys(("ft", "foot", "feet"), 0.3048),
}
_PRESSURE = {
    **dict.fromkeys(("pa", "pascal"), 1.0),
    **dict.fromkeys(("hpa", "mbar", "mbars", "mb", "millibar", "millibars"), 1e2),
    "kpa": 1e3, "bar": 1e5, "atm": 101325.0,
    **dict.fromkeys(("mmhg", "torr"), 101325.0 / 760.0),
}  # fmt: skip
_NORTH = {
    **dict.fromkeys(("deg", "degree", "degrees", "n", "north", "degree_north", "degrees_north"), 1.0),
    **dict.fromkeys(("s", "south", "degree_south", "degrees_south"), -1.0),
}
_EAST = {
    **dict.fromkeys(("deg", "degree", "degrees", "e", "east", "degree_east", "degrees_east"), 1.0),
    **dict.fromkeys(("w", "west", "degree_west", "degrees_west"), -1.0),
}
_SEA = ("asl", "amsl", "msl", "above_sea_level", "above_mean_sea_level")
# the package's name of each number: the units that it may have, and its names in files without unit. A height is that
# of the station only if it says above what; a pressure reduced to sea level is not that of the station
_QUANTITIES = {
    "latitude": (_NORTH, ("latitude", "lat")),
    "longitude": (_EAST, ("longitude", "lon", "long", "lng")),
    "altitude_m": (
        _LENGTH,
        (
            *("altitude", "alt", "elevation", "elev", "station_height", "site_height"),
            *(f"{name}_{sea}" for name in ("altitude", "alt", "elevation", "elev", "height") for sea in _SEA),
        ),
    ),
    "pressure_pa": (_PRESSURE, ("pressure", "press", "air_pressure", "atmospheric_pressure", "barometric_pressure")),
    "fwhm_nm": ({"nm": 1.0, "nanometer": 1.0, "angstrom": 0.1}, ("fwhm", "bandwidth", "spectral_resolution")),
    "ozone_du": (
        {"du": 1.0, "dobson": 1.0, "dobson_unit": 1.0, "dobson_units": 1.0, "atm_cm": 1e3},
        ("ozone", "o3", "ozone_column", "total_ozone", "total_column_ozone", "column_ozone"),
    ),
    "sun_distance_au": ({"au": 1.0, "ua": 1.0}, ("sun_distance", "earth_sun_distance", "sun_earth_distance")),
}  # fmt: skip
_PLACES = ("station", "site", "surface", "ground", "observer", "location")
_NAMES = {name: quantity for quantity, (_, names) in _QUANTITIES.items() for name in names}
_MOMENTS = ("time", "date", "datetime", "timestamp", "utc")
_REMARKS = ("note", "notes", "comment", "comments", "remark", "remarks")
_UNITS = ("units", "unit", "radiance_units", "radiance_unit")
# ranges of a pressure without unit, which do not overlap
_BARE_PRESSURES = ((3e4, 1.2e5, "Pa"), (3e2, 1.2e3, "hPa"), (3e1, 1.2e2, "kPa"))
_VALUE = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*[\[(]?\s*(.*?)\s*[\])]?")
_LINE = re.compile(r"([A-Za-z][\w .()\[\]/°-]*?)\s*[:=]\s*(.*)")
_BARE = re.compile(r"([A-Za-z_]+)\s+([-+.]?\d.*)")
_MOST_WORDS = 4
_DAY = re.compile(r"\d{4}-\d\d-\d\d|\d{8}")
# datetime holds microseconds: NumPy reads finer times
_NANOSECONDS = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d\.\d{7,9}[Zz]?")


@dataclass
class Head:
    """The content of a file's keys so far.

    `station`: numbers by the names of `Contents.station`; `moment`: when all samples were taken, NaT if not stated;
    `units`: text as in the file, with its place for errors; `saturation`: number as in the file; `calibration_sigma`
    and `follows_sun` as in `Sky`; `made_by`: what made a simulated sky; `unknown`: keys that are not understood.
    """

    name: str
    station: dict[str, float] = field(default_factory=dict)
    moment: np.datetime64 = field(default_factory=lambda: np.datetime64("NaT", "ns"))
    units: tuple[str, str] | None = None
    saturation: float | None = None
    calibration_sigma: float = float("nan")
    follows_sun: bool = False
    made_by: dict = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)

    def line(self, place: str, text: str) -> None:
        """Read a line of comment: `key: value`, `key = value`, or a number after a known name; others are prose."""
        pair = _LINE.fullmatch(text)
        if pair is None:
            pair = _BARE.fullmatch(text)
            if pair is None or quantity_of(pair[1]) is None:
                return
        words = pair[1].split()
        key = len(words) <= _MOST_WORDS and not any(word.isdigit() for word in words)
        if pair[2] and (key or quantity_of(pair[1]) is not None):
            self.entry(place, *pair.groups())

    def entry(self, place: str, key: str, value: object) -> None:
        """Read a key and its value; a key that is not understood is added to `unknown`."""
        word = plain(key)
        if quantity_of(key) is not None:
            self.number(place, key, str(value))
        elif word in _UNITS:
            self.units = str(value), f"{place} `{key}`"
        elif word == "saturation":
            self.saturation = self._parsed(place, key, str(value), {})[0]
        elif word == "calibration_sigma":
            self.calibration_sigma = self._parsed(place, key, str(value), {})[0]
        elif word == "follows_sun":
            self.follows_sun = self._parsed(place, key, str(value), {})[0] != 0.0
        elif word in _REMARKS:
            self.notes += str(value).splitlines()
        elif word == "made_by":
            self._maker(place, str(value))
        elif not (word.removesuffix("_utc") in _MOMENTS and self._time(str(value))):
            self.unknown.append(key)

    def number(self, place: str, key: str, text: str, units: str = "") -> None:
        """Read a number of the station, with its unit in the key, after the number, or in `units`."""
        quantity, said = quantity_of(key) or ("", "")
        known = _QUANTITIES[quantity][0]
        value, own = self._parsed(place, key, text, known)
        of_variable = plain(units)
        told = {unit for unit in (said, own, of_variable) if unit}
        if not told <= known.keys() or len({known[unit] for unit in told}) > 1:
            found = ", ".join(sorted(told))
            raise ValueError(f"{self.name}: {place} `{key}`: expected one unit, such as {_some(known)}, found {found}")
        if not told and quantity == "pressure_pa":
            told = {self._bare_pressure(place, key, value)}
        value *= known[told.pop()] if told else 1.0
        before = self.station.setdefault(quantity, value)
        if not np.isclose(before, value, rtol=1e-6):
            raise ValueError(
                f"{self.name}: {place} `{key}`: expected `{quantity}` as told before, {before:g}, found {value:g}"
            )

    def _parsed(self, place, key, text, known):
        match = _VALUE.fullmatch(text.strip().replace("°", " deg "))
        unit = plain(match[2]) if match else ""
        # "42.4 deg N"
        unit = unit.removeprefix("deg_") if unit.removeprefix("deg_") in known else unit
        if match is None or (unit and unit not in known):
            expected = f"a number{f' and a unit such as {_some(known)}' if known else ''}"
            raise ValueError(f"{self.name}: {place} `{key}`: expected {expected}, found {text[:60]!r}")
        return float(match[1]), unit

    def _bare_pressure(self, place, key, value):
        for low, high, unit in _BARE_PRESSURES:
            if low <= value <= high:
                if unit != "Pa":
                    self.notes.append(f"`{key}` {value:g} has no unit: taken as {unit}")
                return unit.lower()
        raise ValueError(f"{self.name}: {place} `{key}`: expected a pressure with its unit, found {value:g}")

    def _time(self, text) -> bool:
        """Read a time in UTC, or a day, which gives the sun's distance; False if the text is neither."""
        try:
            moment = moment_of(text.strip().removesuffix("UTC").strip())
        except ValueError:
            return False
        if _DAY.fullmatch(text.strip()):
            distance = float(earth_sun_factor(np.float64(day_of_year(moment)))) ** -0.5
            self.station.setdefault("sun_distance_au", distance)
        else:
            self.moment = moment
        return True

    def _maker(self, place, text):
        try:
            self.made_by = json.loads(text)
        except ValueError:
            self.made_by = {}
        if not isinstance(self.made_by, dict):
            self.made_by = {}
        if not self.made_by:
            raise ValueError(f"{self.name}: {place} `made_by`: expected a JSON object, found {text[:60]!r}")


def moment_of(text: str) -> np.datetime64:
    """A time in ISO 8601, in UTC if it states no zone; `ValueError` for any other text."""
    moment = datetime.fromisoformat(text)
    if not 1678 < moment.year < 2262:
        raise ValueError(f"expected a year between 1678 and 2262, found {moment.year}")
    if _NANOSECONDS.fullmatch(text):
        return np.datetime64(text.rstrip("Zz"), "ns")
    if moment.tzinfo is not None:
        try:
            moment = moment.astimezone(UTC).replace(tzinfo=None)
        except OverflowError as error:
            raise ValueError(str(error)) from None
    return np.datetime64(moment, "ns")


def quantity_of(key: str) -> tuple[str, str] | None:
    """The package's name of the station's number that a key means, and the key's unit; None if there is none."""
    words = plain(key).split("_")
    for rest in (words, words[1:]) if words[0] in _PLACES else (words,):
        for at in range(1, len(rest) + 1):
            for width in (2, 1, 0):
                unit = "_".join(rest[at : at + width])
                name = "_".join(rest[:at] + rest[at + width :])
                quantity = _NAMES.get(name)
                if quantity is not None and (not width or unit in _QUANTITIES[quantity][0]):
                    return quantity, unit
    return None


def plain(text: str) -> str:
    """A key or unit in lower case, its words with _ between."""
    return "_".join(re.findall(r"[a-z0-9]+", text.lower().replace("°", " deg ")))


def _some(units: dict[str, float]) -> str:
    return ", ".join(list({factor: unit for unit, factor in reversed(units.items())}.values())[::-1][:4])
