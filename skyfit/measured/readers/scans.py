"""Convert scans about the sun, one filter after the other, to skies: almucantar, principal plane, and others."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ..solar_position import solar_position
from .screening import Contents


ALMUCANTAR, PRINCIPAL_PLANE, HYBRID = "almucantar", "principal plane", "hybrid scan"
# largest view zenith angle of a hybrid scan, degrees: the scan leaves the sun at right angles to its vertical plane,
# down to this angle, along which it continues around the sky (Sinyuk et al. 2020, Atmos. Meas. Tech. 13, 3375)
_LOWEST_OF_HYBRID = 75.0
# longest gap between filters of one scan; the next scan of a photometer begins a quarter of an hour later
_LONGEST_GAP = np.timedelta64(300, "s")
# azimuth of the sun if its place is not known: views are counted from it
_NO_AZIMUTH = 180.0
# width of the interference filters of CIMEL's photometers from 440 to 1020 nm (Holben et al. 1998, Remote Sens.
# Environ. 66)
FILTER_FWHM_NM = 10.0
# relative sigma of a sample's noise: readings repeat to a per cent, and the two sides of an almucantar agree to some;
# and of each filter's calibration by integrating spheres, better than 5 % (Holben et al. 1998)
_NOISE, _CALIBRATION = 0.02, 0.05


@dataclass
class Sweep:
    """The samples of one filter about the sun.

    `moment` UTC; `wavelength` nm; `sun_zenith` degrees; `zenith`, `azimuth` `[direction]` degrees, those of the view,
    azimuth clockwise from the sun; `radiance` `[direction]` W m^-2 sr^-1 nm^-1, NaN where missing. Sweeps of one scan
    have the same directions in the same order. `kind`: that of the scan; `row`: that in the file. `sun_azimuth`
    degrees, clockwise from north, and `beam`, the sun's irradiance on a plane normal to it, W m^-2 nm^-1, are NaN if
    the file does not state them.
    """

    moment: np.datetime64
    wavelength: float
    sun_zenith: float
    zenith: Float[np.ndarray, " direction"]
    azimuth: Float[np.ndarray, " direction"]
    radiance: Float[np.ndarray, " direction"]
    kind: str = ALMUCANTAR
    row: int = 0
    sun_azimuth: float = np.nan
    beam: float = np.nan


@dataclass
class Series:
    """The scans of a file as contents of a `Sky`, and the moment of each sweep, `[time, wavelength]`."""

    contents: Contents
    moment: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), "datetime64[ns]"))


def view_of(kind: str, angle: Float[np.ndarray, " direction"], sun_zenith: float):
    """Zenith angle and azimuth from the sun, degrees, of views at the angles of a kind of scan.

    **Arguments:** `angle`, degrees: for an almucantar, at the sun's zenith angle, the azimuth from the sun; for a
    hybrid scan the azimuth too; in the principal plane the angle from the sun, positive upward and beyond the zenith.
    """
    if kind == ALMUCANTAR:
        return np.full(angle.shape, sun_zenith), angle
    if kind == HYBRID:
        # a great circle through the sun, at right angles to its vertical plane: tan(zenith) = tan(sun) / cos(azimuth)
        sun, forward = np.radians(sun_zenith), np.maximum(np.cos(np.radians(angle)), 0.0)
        circle = np.degrees(np.arctan2(np.sin(sun), np.cos(sun) * forward))
        return np.minimum(circle, max(_LOWEST_OF_HYBRID, sun_zenith)), angle
    along = sun_zenith - angle
    return np.abs(along), np.where(along < 0.0, 180.0, 0.0)


def azimuth_of_hybrid(scattering: Float[np.ndarray, " direction"], sun_zenith: float):
    """Azimuth from the sun, degrees, of a hybrid scan at a scattering angle, degrees, with the same sign.

    **Returns:** NaN at scattering angles that no view of the scan has.
    """
    sun, lowest = np.radians(sun_zenith), np.radians(max(_LOWEST_OF_HYBRID, sun_zenith))
    away = np.radians(np.abs(scattering))
    on_circle = np.cos(away) * np.cos(sun) >= np.cos(lowest)
    circle = np.arctan2(np.sin(away), np.cos(away) * np.sin(sun))
    with np.errstate(invalid="ignore", divide="ignore"):
        around = np.arccos((np.cos(away) - np.cos(lowest) * np.cos(sun)) / (np.sin(lowest) * np.sin(sun)))
    return np.sign(scattering) * np.degrees(np.where(on_circle, circle, around))


def series_of(
    name: str,
    sweeps: list[Sweep],
    station: dict[str, float],
    notes: list[str],
    instrument: str,
    calibration: float = _CALIBRATION,
    beam_sigma: float = np.nan,
) -> Series:
    """Join all sweeps of a file to scans in time, each wavelength with the views of its filter.

    **Arguments:** `station`, numbers by the names of `Contents.station`; `notes` of the reader, to which more are
    added; `calibration`, relative sigma of each filter's scale, and `beam_sigma` of the sun's beam.
    **Returns:** contents with views `[time, direction, wavelength]` and a sun `[time, wavelength]`, at the file's
    zenith angle and its azimuth, or that of time and place. Directions without any sample are left out; missing
    samples are counted.
    """
    scans = _scans(name, sweeps, notes)
    wavelength = np.unique([sweep.wavelength for sweep in sweeps])
    azimuth = _sun_azimuth(sweeps, station, notes)
    kept = [_kept(scan) for scan in scans]
    missing = sum(int(np.isnan(sweep.radiance).sum()) for sweep in sweeps)
    if missing:
        total = sum(sweep.radiance.size for sweep in sweeps)
        notes.append(f"{missing} of {total} samples missing, as the file says")
    shape = len(scans), max(int(places.size) for places in kept), wavelength.size
    if not shape[1]:
        raise ValueError(f"{name}: expected samples of the sky, found none in {len(sweeps)} rows")
    radiance, zenith, around = (np.full(shape, np.nan) for _ in range(3))
    sun_zenith, sun_azimuth, beam = (np.full(shape[::2], np.nan) for _ in range(3))
    moment = np.full(shape[::2], np.datetime64("NaT"), "datetime64[ns]")
    for t, (scan, places) in enumerate(zip(scans, kept, strict=True)):
        count = places.size
        for sweep in scan:
            w = int(np.searchsorted(wavelength, sweep.wavelength))
            sun_zenith[t, w], sun_azimuth[t, w], moment[t, w] = sweep.sun_zenith, azimuth[id(sweep)], sweep.moment
            beam[t, w] = sweep.beam
            radiance[t, :count, w] = sweep.radiance[places]
            zenith[t, :count, w] = sweep.zenith[places]
            around[t, :count, w] = sweep.azimuth[places] + azimuth[id(sweep)]
        # a filter that this scan lacks gets the views of another one
        known = np.flatnonzero(np.isfinite(sun_zenith[t]))
        for w in np.flatnonzero(np.isnan(sun_zenith[t])):
            near = known[np.argmin(np.abs(known - w))]
            for values in (sun_zenith, sun_azimuth, moment):
                values[t, w] = values[t, near]
            zenith[t, :, w], around[t, :, w] = zenith[t, :, near], around[t, :, near]
    width = "" if "fwhm_nm" in station else f"filters of {FILTER_FWHM_NM:g} nm full width, "
    seen = bool(np.isfinite(beam).any())
    of_beam = f", the sun's beam {beam_sigma:.0%}" if seen else ""
    notes.append(
        f"assumed, as the file does not say: {width}noise {_NOISE:.0%}, calibration {calibration:.0%}{of_beam}"
    )
    return Series(
        Contents(
            name=name,
            radiance=radiance,
            sigma=_NOISE * radiance,
            calibration_sigma=calibration,
            view_zenith=zenith,
            view_azimuth=around % 360.0,
            wavelength=wavelength,
            time=_middle(moment),
            sun_zenith=sun_zenith,
            sun_azimuth=sun_azimuth % 360.0,
            direct=beam if seen else None,
            direct_sigma=beam_sigma * beam if seen else None,
            station={"fwhm_nm": FILTER_FWHM_NM} | station,
            notes=notes,
            # a small zenith angle of the sun does not mean radians
            angles_known=True,
            instrument=instrument,
            follows_sun=True,
        ),
        moment,
    )


def _scans(name, sweeps, notes) -> list[list[Sweep]]:
    """Divide the sweeps in time into scans: at a long gap, another kind of scan, or a repeated wavelength."""
    scans: list[list[Sweep]] = []
    repeats = 0
    for sweep in sorted(sweeps, key=lambda sweep: sweep.moment):
        last = scans[-1] if scans else None
        if last is not None and sweep.kind == last[-1].kind and sweep.moment - last[-1].moment <= _LONGEST_GAP:
            if sweep.wavelength not in [one.wavelength for one in last]:
                last.append(sweep)
                continue
            repeats += 1
        scans.append([sweep])
    short = [scan for scan in scans if len(scan) < len(max(scans, key=len))]
    if repeats and short:
        again = short[0][0]
        notes.append(
            f"a wavelength comes again within a scan, such as {again.wavelength:g} nm in row {again.row}: each time "
            "begins a scan of its own"
        )
    return scans


def _kept(scan: list[Sweep]) -> np.ndarray:
    """The directions at which any filter has a sample; there is no sky toward the sun itself."""
    seen = np.isfinite([sweep.radiance for sweep in scan]).any(axis=0)
    return np.flatnonzero(seen)


def _sun_azimuth(sweeps: list[Sweep], station: dict[str, float], notes: list[str]) -> dict[int, float]:
    """The sun's azimuth of each sweep, degrees: as stated, by time and place, or a fixed one without a place."""
    if all(np.isfinite(sweep.sun_azimuth) for sweep in sweeps):
        return {id(sweep): sweep.sun_azimuth for sweep in sweeps}
    if not {"latitude", "longitude"} <= station.keys():
        notes.append("no latitude and longitude: azimuths are counted from the sun, taken in the south")
        return {id(sweep): _NO_AZIMUTH for sweep in sweeps}
    moments = np.array([sweep.moment for sweep in sweeps])
    _, azimuth = solar_position(moments, station["latitude"], station["longitude"], station.get("altitude_m", 0.0))
    return {id(sweep): float(a) for sweep, a in zip(sweeps, np.rad2deg(azimuth), strict=True)}


def _middle(moment: np.ndarray) -> np.ndarray:
    """The middle of each scan's times, whole seconds."""
    return moment.astype("datetime64[s]").astype(np.int64).mean(axis=1).round().astype("datetime64[s]")
