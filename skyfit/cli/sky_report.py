"""The report of `skyfit convert` on a sky: its printed form, and a record for programs."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.table import Table

from ..light.solar import SPECTRUM_NM
from ..measured import Sky, time_names
from ..measured.units import LUMINANCE, RADIANCE
from ..retrieve.sampling import GAS_BANDS_NM
from .printing import console, note, say


# Largest number of wavelengths that are listed
_MOST = 12


def print_sky(sky: Sky) -> None:
    """Print the instrument, station, times, sun, wavelengths, views, samples and unit, then notes."""
    say(f"{sky.source}: {sky.instrument or 'a sky'}")
    lines = Table.grid(padding=(0, 2, 0, 0))
    lines.add_column(no_wrap=True)
    lines.add_column()
    for name, told in _understood(sky):
        lines.add_row(name, told)
    console.print(lines, markup=False)
    for sentence in sky.notes:
        note(sentence)
    for reason, count in sky.masked.items():
        say(f"masked: {count} samples {reason}")


def record_of(sky: Sky, path: Path) -> dict:
    """What was understood of a sky written to a file, and its number of usable samples."""
    return {
        "file": str(path), "source": sky.source, "instrument": sky.instrument, "times": list(time_names(sky)),
        "understood": {name: told for name, told in _understood(sky) if name}, **sky.counts(),
        "masked": dict(sky.masked), "notes": list(sky.notes),
    }  # fmt: skip


def short_times(sky: Sky) -> tuple[str, list[str]]:
    """The day, if it is the same for all times (else ""), and the times, without the day if it is."""
    names = [name.replace("T", " ").removesuffix(":00Z") for name in time_names(sky)]
    day = names[0].partition(" ")[0]
    if np.isnat(sky.time).any() or not all(name.startswith(f"{day} ") for name in names):
        return "", names
    return day, [name.removeprefix(f"{day} ") for name in names]


def _understood(sky: Sky) -> Iterator[tuple[str, str]]:
    yield "station", _station(sky)
    yield "times", _times(sky)
    yield "sun", f"zenith {_span(np.degrees(sky.sun_zenith), 1)} degrees{_each(sky.sun_zenith.ndim > 1)}"
    yield from _wavelengths(sky)
    yield "views", _views(sky)
    counts = sky.counts()
    sigma = "the noise is not told" if sky.sigma is None else "with the sigma of each"
    if np.isfinite(sky.calibration_sigma):
        sigma += f", calibration {sky.calibration_sigma:.1%}"
    yield "samples", f"{counts['usable']} usable of {counts['samples']}, {sigma}"
    yield "unit", _unit(sky)
    if sky.aerosol_optical_depth is not None:
        yield "beam", f"aerosol optical depth, {_known(sky.aerosol_optical_depth)} times and wavelengths"
    if sky.direct_irradiance is not None:
        yield "beam", f"direct normal irradiance, {_known(sky.direct_irradiance)} times and wavelengths"


def _station(sky: Sky) -> str:
    north, east = sky.latitude_deg, sky.longitude_deg
    place = f"{abs(north):.4f} {'NS'[int(north < 0)]}, {abs(east):.4f} {'EW'[int(east < 0)]}"
    told = [place if np.isfinite(north) and np.isfinite(east) else "place not told"]
    told.append(f"{sky.altitude_m:g} m" if np.isfinite(sky.altitude_m) else "altitude not told")
    told.append(f"{sky.pressure_pa / 100.0:g} hPa" if np.isfinite(sky.pressure_pa) else "pressure not told")
    if np.isfinite(sky.ozone_du):
        told.append(f"ozone {sky.ozone_du:.0f} DU")
    return ", ".join(told)


def _times(sky: Sky) -> str:
    known = np.sort(sky.time[~np.isnat(sky.time)])
    if not known.size:
        return f"{len(sky.time)}, dates not told"
    names = [time_names(sky.at(int(np.flatnonzero(sky.time == end)[0])))[0] for end in (known[0], known[-1])]
    lost = f", {len(sky.time) - known.size} without a date" if known.size < len(sky.time) else ""
    return f"{len(sky.time)}: {' to '.join(dict.fromkeys(names))}{lost}"


def _wavelengths(sky: Sky) -> Iterator[tuple[str, str]]:
    own = sky.wavelength_nm
    if sky.response is not None:
        yield "channels", ", ".join(sky.response.names)
        return
    width = f", line shape {sky.fwhm_nm:g} nm" if np.isfinite(sky.fwhm_nm) else ""
    yield "wavelengths", f"{len(own)}: {_names(own)} nm{width}"
    beyond = (own < SPECTRUM_NM[0]) | (own > SPECTRUM_NM[1])
    bands = np.any([(own >= low) & (own <= high) for low, high in GAS_BANDS_NM], axis=0) & ~beyond
    kept = "kept in the file, left out of a fit"
    if beyond.any():
        yield "", f"{_names(own[beyond])} nm beyond the sun's table, 300-1100 nm: {kept}"
    if bands.any():
        yield "", f"{_names(own[bands])} nm in bands of oxygen and water vapour: {kept}"


def _names(wavelength: np.ndarray) -> str:
    if len(wavelength) <= _MOST:
        return ", ".join(f"{one:g}" for one in wavelength)
    return f"{wavelength[0]:g} to {wavelength[-1]:g}"


def _views(sky: Sky) -> str:
    count = int(np.isfinite(sky.view_zenith).sum(axis=1).max())
    each = "the same at all times" if sky.one_pattern else "each time its own"
    each = "they follow the sun from one wavelength to the next" if sky.view_zenith_by_wavelength is not None else each
    return f"{count} directions, zenith {_span(np.degrees(sky.view_zenith), 1)} degrees; {each}"


def _unit(sky: Sky) -> str:
    if sky.response is None:
        return f"{RADIANCE}, spectral radiance"
    return f"{LUMINANCE}, luminance" if sky.response.by_unit else "that of the channels"


def _known(values: np.ndarray) -> str:
    return f"{int(np.isfinite(values).sum())} of {values.size}"


def _each(moves: bool) -> str:
    return ", one for each wavelength" if moves else ""


def _span(values: np.ndarray, decimals: int) -> str:
    low, high = f"{np.nanmin(values):.{decimals}f}", f"{np.nanmax(values):.{decimals}f}"
    return low if low == high else f"{low} to {high}"
