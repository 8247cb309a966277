"""Convert the contents of a file to a `Sky`: check angles, screen samples, place the sun."""

from dataclasses import dataclass, field

import numpy as np

from ..possible import STATION_RANGES
from ..quality.sun_agreement import sun_agreement
from ..response import Response
from ..samples import Sky
from ..solar_position import solar_position


# Past this, a number is NetCDF's default fill value (9.97e36), not a radiance.
_FILL = 1e30
# A detector at its limit repeats the same number: this many neighbours or more.
_SATURATED_RUN = 4
# The widest zenith angle that could be pi/2 in radians, with room for rounding.
_RADIAN_LIMIT = 1.6
# largest beam, W m^-2 nm^-1; the sun sends 2.3 at most at the top of the air, a few per cent more in January (ASTM
# G173)
_BRIGHTEST_BEAM = 3.0
# a wavelength past this is not in nm: spectrometers of sky light end at 2500 nm, and 3000 angstrom is 300 nm
_LONGEST_NM = 2600.0


@dataclass
class Contents:
    """The contents of a file as a reader finds them, in the file's units (degrees), before any screening.

    **Arguments** arrays as in `Sky`, angles in degrees; views may be NaN where a time has no samples, and views
    are [time, direction, wavelength] if the instrument moves between wavelengths; `station` holds
    numbers by the names latitude, longitude, altitude_m, pressure_pa, fwhm_nm, ozone_du, sun_distance_au; `made_by`:
    what made a simulated sky; `suspect` is True where masked, as is each of `reasons`;
    `rows`: axis -> the row where each of its values first appears, for errors ("direction": in the shape of the views,
    "sun": rows of the sun's angles, if not those of "time");
    `angles_known`: small angles are not suspicious, for instance because the file stated radians; `turned`: azimuths
    are in the instrument's own frame. `direct`, `direct_sigma`: irradiance of the sun's beam and its standard
    deviation, W m^-2 nm^-1, [time, wavelength]; `aerosol_depth`, `aerosol_depth_sigma`: optical depth of the haze and
    its standard deviation, [time, wavelength]; `degree`, `degree_sigma`: degree of linear polarisation, in the shape of
    `radiance`. `response`: that of the channels that replace wavelengths. `instrument` and `follows_sun` as in `Sky`.
    """

    name: str
    radiance: np.ndarray
    view_zenith: np.ndarray
    view_azimuth: np.ndarray
    wavelength: np.ndarray
    time: np.ndarray
    sun_zenith: np.ndarray
    sun_azimuth: np.ndarray
    sigma: np.ndarray | None = None
    suspect: np.ndarray | None = None
    reasons: dict[str, np.ndarray] = field(default_factory=dict)
    direct: np.ndarray | None = None
    direct_sigma: np.ndarray | None = None
    degree: np.ndarray | None = None
    degree_sigma: np.ndarray | None = None
    aerosol_depth: np.ndarray | None = None
    aerosol_depth_sigma: np.ndarray | None = None
    instrument: str = ""
    follows_sun: bool = False
    calibration_sigma: float = float("nan")
    station: dict[str, float] = field(default_factory=dict)
    saturation: float | None = None
    notes: list[str] = field(default_factory=list)
    angles_known: bool = False
    turned: bool = False
    response: Response | None = None
    made_by: dict = field(default_factory=dict)
    rows: dict[str, list] = field(default_factory=dict)


def screened(found: Contents) -> Sky:
    """The `Sky` of a file's contents: checked, screened, with the sun in place.

    **Arguments** `found`: the contents of the file.

    **Returns** a `Sky`; samples that cannot be used are masked and counted by reason.

    **Valid** an angle, a wavelength or a station that makes no sense is a `ValueError`.
    """
    name = found.name
    _check_station(name, found.station)
    zenith, azimuth = _check_directions(found)
    wavelength, order = _check_wavelengths(found)
    if zenith.ndim == 3:
        zenith, azimuth = zenith[..., order], azimuth[..., order]
    radiance = found.radiance[..., order]
    sigma = None if found.sigma is None else found.sigma[..., order]
    reasons = {reason: where[..., order] for reason, where in found.reasons.items()}
    if found.suspect is not None:
        reasons["suspect"] = found.suspect[..., order]
    radiance, usable, masked, reason = screen(
        radiance, sigma, reasons, zenith, found.saturation, _signed(found.response)
    )
    direct, direct_sigma = _check_beam(found, order)
    sun_zenith, sun_azimuth = _place_sun(found, order)
    found.notes += _small_angles(found, zenith, azimuth, sun_zenith, sun_azimuth)
    station = found.station
    moving = None, None
    if zenith.ndim == 3:
        views = zenith, azimuth
        zenith, azimuth = zenith.mean(axis=2), _mean_azimuth(azimuth)
        if not all(np.array_equal(v, np.broadcast_to(v[..., :1], v.shape), equal_nan=True) for v in views):
            moving = np.deg2rad(views[0]), np.deg2rad(views[1])
    depths = (None if depth is None else depth[:, order] for depth in (found.aerosol_depth, found.aerosol_depth_sigma))
    depth, depth_sigma = depths
    degree, degree_sigma = (None if v is None else v[..., order] for v in (found.degree, found.degree_sigma))
    try:
        return Sky(
            radiance=radiance,
            sigma=sigma,
            usable=usable,
            view_zenith=np.deg2rad(zenith),
            view_azimuth=np.deg2rad(azimuth),
            wavelength_nm=wavelength,
            sun_zenith=np.deg2rad(sun_zenith),
            sun_azimuth=np.deg2rad(sun_azimuth),
            time=found.time.astype("datetime64[ns]"),
            latitude_deg=station.get("latitude", np.nan),
            longitude_deg=station.get("longitude", np.nan),
            altitude_m=station.get("altitude_m", np.nan),
            pressure_pa=station.get("pressure_pa", np.nan),
            fwhm_nm=station.get("fwhm_nm", np.nan),
            ozone_du=station.get("ozone_du", np.nan),
            sun_distance_au=station.get("sun_distance_au", np.nan),
            made_by=found.made_by,
            response=found.response,
            direct_irradiance=direct,
            direct_sigma=direct_sigma,
            aerosol_optical_depth=depth,
            aerosol_optical_depth_sigma=depth_sigma,
            degree_of_polarisation=degree,
            degree_of_polarisation_sigma=degree_sigma,
            view_zenith_by_wavelength=moving[0],
            view_azimuth_by_wavelength=moving[1],
            instrument=found.instrument,
            follows_sun=found.follows_sun,
            calibration_sigma=found.calibration_sigma,
            masked=masked,
            reason=reason,
            # A file that skyfit wrote already carries its notes: keep each once.
            notes=tuple(dict.fromkeys(found.notes)),
            source=name,
        )
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def _check_beam(found, order):
    """The sun's beam by wavelength, NaN where it is no irradiance; `ValueError` if no sun sends so much."""
    if found.direct is None:
        return None, None
    direct = np.array(found.direct[:, order], dtype=np.float64)
    beam = np.isfinite(direct) & (direct >= 0.0) & (direct < _FILL)
    if found.response is None and np.any(beam & (direct > _BRIGHTEST_BEAM)):
        raise ValueError(
            f"{found.name}: variable `direct_normal_irradiance`: expected {_BRIGHTEST_BEAM:g} W m-2 nm-1 at most, "
            f"found {np.max(direct[beam]):g}; is this mW, or per um?"
        )
    left_out = int(np.count_nonzero(~beam & ~np.isnan(direct)))
    if left_out:
        found.notes.append(f"{left_out} direct irradiances that are negative or infinite left out")
    return np.where(beam, direct, np.nan), None if found.direct_sigma is None else found.direct_sigma[:, order]


def _signed(response):
    """Whether the channels may read less than 0, like red, green and blue of a colour that no screen shows."""
    return response is not None and bool(np.any(response.weight < 0.0))


def screen(
    radiance: np.ndarray,
    sigma: np.ndarray | None,
    stated: dict[str, np.ndarray],
    view_zenith_deg: np.ndarray,
    saturation: float | None = None,
    signed: bool = False,
) -> tuple[np.ndarray, np.ndarray, dict[str, int], np.ndarray]:
    """Mask the samples that must not be used, and count them by the first reason that holds.

    **Arguments** arrays [time, direction, wavelength]; `stated`: reasons of the file's own; `view_zenith_deg`
    [direction], [time, direction] or [time, direction, wavelength]; `saturation`: the radiance at which the detector
    saturates, if known; `signed`: less than 0 is no error.

    **Returns** radiance with NaN where not finite, `usable`, the counts, and each sample's index among them, or -1.
    """
    radiance = np.array(radiance, dtype=np.float64)
    below = view_zenith_deg > 90.0
    below = np.broadcast_to(below if below.ndim == 3 else below[..., None], radiance.shape)
    with np.errstate(invalid="ignore"):
        reasons = {
            "missing": np.isnan(radiance) | (np.isfinite(radiance) & (radiance > _FILL)),
            "infinite": np.isinf(radiance),
            "negative": (radiance < 0.0) & (not signed),
            "below horizon": below,
            "saturated": _saturated(radiance, saturation),
        }
        reasons |= stated
        if sigma is not None:
            reasons["sigma not positive"] = ~((sigma > 0.0) & np.isfinite(sigma))
    usable = np.ones(radiance.shape, dtype=bool)
    masked, which = {}, np.full(radiance.shape, -1, np.int8)
    for reason, where in reasons.items():
        count = int(np.count_nonzero(usable & where))
        if count:
            which[usable & where] = len(masked)
            masked[reason] = count
        usable &= ~where
    radiance[~np.isfinite(radiance) | reasons["missing"]] = np.nan
    return radiance, usable, masked, which


def _saturated(radiance, saturation):
    """Samples at the given limit, or at a maximum repeated over neighbouring wavelengths."""
    finite = np.where(np.isfinite(radiance), radiance, -np.inf)
    highest = np.max(finite, axis=-1, keepdims=True)
    at_highest = (finite == highest) & (highest > 0.0)
    found = np.zeros(radiance.shape, dtype=bool)
    count = radiance.shape[-1] - _SATURATED_RUN + 1
    if count > 0:
        run = np.ones((*radiance.shape[:-1], count), dtype=bool)
        for shift in range(_SATURATED_RUN):
            run &= at_highest[..., shift : shift + count]
        found = at_highest & np.any(run, axis=-1, keepdims=True)
    if saturation is not None:
        found |= finite >= saturation
    return found


def check_angles(name: str, zenith: np.ndarray, azimuth: np.ndarray, known: bool = False) -> None:
    """Raise where view angles in degrees look like radians.

    **Arguments** `zenith`, `azimuth`: degrees; `known`: the file's units were radians, converted.

    **Valid** certain only for a scan: more than three directions, none past 1.6.
    """
    known_ones = np.isfinite(zenith) & np.isfinite(azimuth)
    zenith, azimuth = zenith[known_ones], azimuth[known_ones]
    directions = len(set(zip(zenith.tolist(), azimuth.tolist(), strict=True)))
    if not known and directions > 3 and 0.0 < np.max(zenith) <= _RADIAN_LIMIT:
        raise ValueError(
            f"{name}: column `view_zenith`: expected degrees, found {directions} directions none "
            f"past {np.max(zenith):g}; are these radians?"
        )


def _check_directions(found):
    zenith, azimuth = found.view_zenith.astype(np.float64), found.view_azimuth.astype(np.float64)
    # At the zenith an azimuth means nothing, and files leave it out.
    azimuth = np.where(np.isnan(azimuth) & (zenith == 0.0), 0.0, azimuth)
    absent = np.zeros(zenith.shape, bool)
    if zenith.ndim >= 2:
        # directions past the end of a scan that is shorter than the longest
        empty = np.isnan(found.radiance).all(axis=2)
        absent = np.isnan(zenith) & np.isnan(azimuth) & (empty if zenith.ndim == 2 else empty[..., None])
    for column, values, low, high in (
        ("view_zenith", zenith, 0.0, 180.0),
        ("view_azimuth", azimuth, -360.0, 720.0),
    ):
        wrong = np.argwhere(~((values >= low) & (values <= high) | absent))
        if wrong.size:
            index = tuple(wrong[0])
            raise ValueError(
                f"{found.name}: {_row(found, 'direction', index)}, column `{column}`: "
                f"expected degrees in [{low:g}, {high:g}], found {values[index]:g}"
            )
    check_angles(found.name, zenith, azimuth, found.angles_known)
    return zenith, azimuth % 360.0


def _row(found, axis, index):
    """The place of a value for errors: the row where it first appears, or its index, after that of its time."""
    rows, index = found.rows.get(axis), np.atleast_1d(index)
    if rows is not None:
        return f"row {np.asarray(rows)[tuple(index)]}"
    return "".join(f"time {time}, " for time in index[:-1]) + f"{axis} {index[-1]}"


def _check_wavelengths(found):
    wavelength = found.wavelength.astype(np.float64)
    start = f"{found.name}: column `wavelength`: expected"
    wrong = ~(np.isfinite(wavelength) & (wavelength > 0.0))
    if np.any(wrong):
        index = int(np.argmax(wrong))
        raise ValueError(
            f"{found.name}: {_row(found, 'wavelength', index)}, column `wavelength`: expected "
            f"positive nm, found {wavelength[index]:g}"
        )
    if np.max(wavelength) < 10.0:
        unit = "m" if np.max(wavelength) < 1e-3 else "um"
        raise ValueError(f"{start} nm, found none past {np.max(wavelength):g}; are these {unit}?")
    if np.min(wavelength) > _LONGEST_NM:
        raise ValueError(f"{start} nm, found none below {np.min(wavelength):g}; are these angstrom?")
    # channels keep the order of their response
    order = np.argsort(wavelength, kind="stable") if found.response is None else np.arange(len(wavelength))
    by_size = np.argsort(wavelength, kind="stable")
    same = np.flatnonzero(np.diff(wavelength[by_size]) == 0.0)
    if same.size:
        first, second = by_size[same[0]], by_size[same[0] + 1]
        raise ValueError(f"{start} different values, found {wavelength[first]:g} nm at positions {first} and {second}")
    return wavelength[order], order


def _small_angles(found, zenith, azimuth, sun_zenith, sun_azimuth):
    """Yield notes on degrees that look like radians, if the scan could also be of a small part of the sky."""
    turn = 2.0 * np.pi + 0.01
    around = azimuth[zenith > 0.0]
    if not found.angles_known and len(np.unique(around)) > 3 and np.max(around) <= turn:
        yield f"view azimuths lie within {np.max(around):.2f} degrees of north: are these radians?"
    if np.all((sun_zenith <= _RADIAN_LIMIT) & (sun_azimuth <= turn)):
        yield f"the sun is within {np.max(sun_zenith):.2f} degrees of the zenith: are these radians?"
    latitude, longitude = (found.station.get(key, np.nan) for key in ("latitude", "longitude"))
    if 0.0 < abs(latitude) <= 0.5 * np.pi and 0.0 < abs(longitude) <= np.pi:
        yield f"the station is at latitude {latitude:g}, longitude {longitude:g}, in degrees: are these radians?"


def _check_station(name, station):
    ranges = {key.removesuffix("_deg"): limits for key, limits in STATION_RANGES.items()}
    for key, value in station.items():
        low, high, unit = ranges[key]
        if not low <= value <= high:
            raise ValueError(f"{name}: `{key}`: expected {low:g} to {high:g} {unit}, found {value:g}")


def _place_sun(found, order):
    """Zenith and azimuth in degrees, by increasing wavelength: the file's where finite, else from time and place."""
    zenith, azimuth = found.sun_zenith.astype(np.float64), found.sun_azimuth.astype(np.float64)
    for column, values, low, high in (
        ("sun_zenith", zenith, 0.0, 180.0),
        ("sun_azimuth", azimuth, -360.0, 720.0),
    ):
        wrong = np.argwhere(np.isinf(values) | (values < low) | (values > high))
        if wrong.size:
            index = tuple(wrong[0])
            place = _row(found, "sun", index) if "sun" in found.rows else _row(found, "time", index[0])
            raise ValueError(
                f"{found.name}: {place}, column `{column}`: expected degrees in [{low:g}, {high:g}], "
                f"found {values[index]:g}"
            )
    if zenith.ndim == 2:
        zenith, azimuth = _without_holes(zenith[:, order]), _without_holes(azimuth[:, order], turns=True)
    middle = (zenith, azimuth) if zenith.ndim == 1 else (zenith.mean(axis=1), _mean_azimuth(azimuth))
    without = ~(np.isfinite(middle[0]) & np.isfinite(middle[1]))
    station = found.station
    if np.any(without):
        lacks = [key for key in ("latitude", "longitude") if key not in station]
        if np.any(np.isnat(found.time[without])):
            lacks.append("time")
        if lacks:
            raise ValueError(
                f"{found.name}: expected columns `sun_zenith` and `sun_azimuth`, or `latitude`, "
                f"`longitude` and `time` to compute them; found no " + ", ".join(lacks)
            )
        computed = solar_position(
            found.time[without],
            station["latitude"],
            station["longitude"],
            station.get("altitude_m", 0.0),
            station.get("pressure_pa"),
        )
        for values, filled in zip((zenith, azimuth), computed, strict=True):
            filled = np.rad2deg(filled).reshape(-1, *[1] * (values.ndim - 1))
            values[without] = np.where(np.isfinite(values[without]), values[without], filled)
        found.notes.append(
            f"sun position of {int(np.sum(without))} of {len(without)} times computed (pvlib, "
            "apparent zenith with refraction)"
        )
    stated = ~without & ~np.isnat(found.time)
    if np.any(stated) and "latitude" in station and "longitude" in station:
        place = float(station["latitude"]), float(station["longitude"])
        sentence = sun_agreement(middle[0][stated], middle[1][stated], found.time[stated], *place, found.turned)
        found.notes += [sentence] if sentence else []
    return zenith, azimuth % 360.0


def _without_holes(angles, turns=False):
    """The sun's angles of each time, `[time, wavelength]`, with their mean where a wavelength has none."""
    known = np.isfinite(angles)
    if turns:
        mean = _mean_azimuth(angles)
    else:
        mean = np.where(known, angles, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return np.where(known | ~known.any(axis=1, keepdims=True), angles, mean[:, None])


def _mean_azimuth(angles):
    """The mean of the known azimuths over the last axis, degrees, also across north; NaN if none is known."""
    known = np.isfinite(angles)
    turned = np.exp(1j * np.deg2rad(np.where(known, angles, 0.0)))
    mean = np.rad2deg(np.angle(np.where(known, turned, 0.0).sum(axis=-1))) % 360.0
    return np.where(known.any(axis=-1), mean, np.nan)
