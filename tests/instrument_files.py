"""Files as instruments leave them, made of invented numbers."""

from pathlib import Path

import numpy as np
import xarray


FILTERS = (1.0203, 0.8701, 0.6749, 0.4402)  # um, in the order in which the wheel turns
AZIMUTHS = (0.0, -6.0, -3.0, 3.0, 6.0, 6.0, 20.0, 60.0, 120.0, 180.0, -180.0, -120.0, -60.0, -20.0, -6.0)
PLANE = (-6.0, -3.0, 0.0, 3.0, 6.0, 20.0, 50.0, 90.0, 120.0)
HEAD = (
    "AERONET Version 3",
    "Nowhere",
    "Version 3: Raw Sky Scan",
    "Contact: none",
    "UNITS: see names",
    "All Points",
    "",
)
COLUMNS = (
    "AERONET_Site,Date(dd:mm:yyyy),Time(hh:mm:ss),Instrument_Number,Nominal_Wavelength(nm),Exact_Wavelength(um),"
    "Solar_Zenith_Angle(Degrees),Sky_Scan_Type,Latitude(Degrees),Longitude(Degrees),Elevation(m)"
)
UNITS = "uW/cm^2/sr/nm"
START = np.datetime64("2024-06-21T06:30:00", "s")
# where pvlib sees the sun then, at 40 N 5 E, and how fast it rises
SUN_ZENITH, RISE = 65.9, 0.28
MISSING = "-999.000000"


def radiance(angles, filter_um: float) -> np.ndarray:
    """uW cm-2 sr-1 nm-1: a lobe about the sun over a level."""
    away = np.abs(np.asarray(angles))
    return (0.5 + 30.0 * np.exp(-away / 8.0) + 4.0 * np.exp(-away / 60.0)) / filter_um


def row(
    number: int, angles=AZIMUTHS, filter_um=0.4402, kind="Almucantar", begin=START, site="Nowhere", light=None
) -> str:
    """One filter's row, `number` times 84 s after the beginning; toward the sun there is nothing."""
    moment = (begin + np.timedelta64(84 * number, "s")).astype(object)
    light = radiance(angles, filter_um) if light is None else light
    cells = [MISSING if a == 0.0 else f"{v:.6f}" for a, v in zip(angles, light, strict=True)]
    sun = SUN_ZENITH - RISE * number
    start = f"{site},{moment:%d:%m:%Y},{moment:%H:%M:%S},7,{1e3 * filter_um:.0f},{filter_um},{sun:.5f},{kind}"
    return ",".join([start, "40.0,5.0,120.0", *cells])


def scan(angles=AZIMUTHS, kind="Almucantar", begin=START, site="Nowhere", filters=FILTERS) -> list[str]:
    return [row(n, angles, f, kind, begin, site) for n, f in enumerate(filters)]


def aeronet(path: Path, rows: list[str], angles=AZIMUTHS, units=UNITS, head=HEAD, columns=COLUMNS) -> Path:
    """A file of AERONET's raw sky scans, its angles in a second line of names."""
    names = ",".join([columns, f"Radiance_for_Azimuth_Angle_in_Degrees({units})", *[""] * (len(angles) - 1)])
    below = "," * (columns.count(",") + 1) + ",".join("" if a is None else f"{a:.3f}" for a in angles)
    path.write_text("\n".join([*head, names, below, *rows]) + "\n")
    return path


def old_aeronet(path: Path, rows: list[str], angles=AZIMUTHS) -> Path:
    """The same with the angles among the names, no place and no unit."""
    names = ",".join([*COLUMNS.split(",")[:8], *(f"{a:.6f}" for a in angles)])
    cut = [",".join([*cells[:8], *cells[11:]]) for cells in (line.split(",") for line in rows)]
    path.write_text("\n".join([*HEAD, names, *cut]) + "\n")
    return path


DEPTHS = {1020: 0.14, 870: 0.17, 675: 0.25, 440: 0.48}


def optical_depths(path: Path, minutes=(-3.0, 6.0), site="Nowhere", change=0.0, columns=tuple(DEPTHS)) -> Path:
    """A file of AERONET's direct sun, `minutes` from the beginning; the depth grows by `change` from row to row."""
    names = ["Date(dd:mm:yyyy)", "Time(hh:mm:ss)", "Day_of_Year", *(f"AOD_{nm}nm" for nm in (1640, *columns))]
    names += ["440-870_Angstrom_Exponent", "Ozone(Dobson)", "AERONET_Site_Name", "Site_Elevation(m)"]
    names += [f"Exact_Wavelengths_of_AOD(um)_{nm}nm" for nm in columns]
    rows = []
    for number, minute in enumerate(minutes):
        moment = (START + np.timedelta64(round(60 * minute), "s")).astype(object)
        cells = [f"{moment:%d:%m:%Y}", f"{moment:%H:%M:%S}", "173", MISSING]
        cells += [f"{DEPTHS[nm] + number * change:.6f}" for nm in columns]
        cells += ["1.4", "310.0", site, "120.0", *(f"{(nm + 0.2) / 1e3:.4f}" for nm in columns)]
        rows.append(",".join(cells))
    path.write_text(
        "\n".join(["AERONET Version 3;", site, "Version 3: AOD", "", "", "", ",".join(names), *rows]) + "\n"
    )
    return path


def csphot(path: Path, units="microWatt/(cm^2 * nm * ster)", drop=(), **changed) -> Path:
    """An almucantar of ARM's photometer: a row a filter, azimuths from the sun."""
    light = np.array([radiance(AZIMUTHS, f) for f in FILTERS])
    light[:, 0] = -9999.0
    time = START + np.arange(len(FILTERS)) * np.timedelta64(84, "s")
    variables = {
        "wavelength": ("time", np.array(FILTERS), {"units": "um"}),
        "zenith": ("time", SUN_ZENITH - RISE * np.arange(4), {"units": "degree", "long_name": "Solar Zenith Angle"}),
        "alm_rad": (("time", "azimuth"), light, {"units": units, "missing_value": -9999.0}),
        "lat": ((), 40.0), "lon": ((), 5.0), "alt": ((), 120.0),
    } | changed  # fmt: skip
    data = xarray.Dataset(variables, {"time": time.astype("datetime64[ns]"), "azimuth": np.array(AZIMUTHS)})
    data.drop_vars(list(drop)).to_netcdf(path, engine="h5netcdf")
    return path


def patches(sun_zenith=40.0, sun_azimuth=150.0) -> np.ndarray:
    """Luminances of the 145 patches, each band clockwise from north, cd m-2."""
    counts, elevations = (30, 30, 24, 24, 18, 12, 6, 1), (6, 18, 30, 42, 54, 66, 78, 90)
    zenith = np.radians(np.concatenate([np.full(n, 90.0 - e) for n, e in zip(counts, elevations, strict=True)]))
    azimuth = np.radians(np.concatenate([360.0 / n * np.arange(n) for n in counts]))
    sun = np.radians([sun_zenith, sun_azimuth])
    cosine = np.cos(zenith) * np.cos(sun[0]) + np.sin(zenith) * np.sin(sun[0]) * np.cos(azimuth - sun[1])
    return (
        3000.0 * (1.0 + 4.0 * np.exp(-3.0 * np.arccos(np.clip(cosine, -1.0, 1.0)))) * (1.0 + 0.5 * np.sin(zenith) ** 4)
    )


def boustrophedon(values: np.ndarray) -> np.ndarray:
    """The same in the order of makes that turn back at the end of each band."""
    bands = np.split(values, np.cumsum((30, 30, 24, 24, 18, 12, 6)))
    return np.concatenate([band[::-1] if number % 2 else band for number, band in enumerate(bands)])


CURRENTS = {400.0: 1.428e-4, 500.0: 2.915e-4, 675.0: 3.554e-4, 870.0: 2.465e-4, 1020.0: 2.076e-4}


def ins_para(path: Path, outside=None, dates=("2024  6  1  0.0",), factors=(1.0,)) -> Path:
    """The calibration of a sky radiometer: wavelengths in cm, solid angles, currents outside the air, A."""
    outside = CURRENTS if outside is None else outside
    rows = [
        f"{date} " + " ".join(f"{f * v:.6E}" for v in outside.values()) for date, f in zip(dates, factors, strict=True)
    ]
    lines = ["- instrument -", '"PS1"  : S/N', "30 : type", f" {len(outside)} : NW", _wavelengths(outside)]
    lines += [" ".join(["2.400E-04"] * len(outside)), f"{len(dates)} : NDAY", *rows]
    path.write_text("\n".join(lines) + "\n")
    return path


def _wavelengths(nm) -> str:
    return "\n".join("".join(f"{1e-7 * v:26.6E}" for v in part) for part in _threes(list(nm)))


def _threes(values):
    return [values[i : i + 3] for i in range(0, len(values), 3)]


def dt5_scan(
    wavelength, zenith, azimuth, ratio, current, sun, time, distance=1.0162, clock=135.0, place=(139.32, 35.75, 40.0)
) -> str:
    """A scan as SKYRAD.pack writes it: `ratio` `[direction, wavelength]`, `current` toward the sun, `sun` zenith angle
    and azimuth from south, `time` on the clock of a longitude."""
    moment = time.astype("datetime64[s]").astype(object)
    hour = moment.hour + moment.minute / 60.0 + moment.second / 3600.0
    lines = [f"{moment:%Y %m %d %H %M %S}{hour:9.4f} : IY IM ID IHH IMM ISS TM(hr)"]
    lines += ["".join(f"{v:8.2f}" for v in (clock, *place)) + " : ALNGS ALNG ALAT ALT(m)"]
    lines += [
        f"{len(ratio) + 1:8d}{sun[0]:8.1f}{sun[1]:8.1f}{distance:8.4f} : NA TH0 FI0 DST",
        f"{len(wavelength):4d} : NW/ WL",
    ]
    lines += [_wavelengths(wavelength), "   TH     FI    F (IF SCA=0)  or R=U/F/M/SOLID"]
    views = [(sun[0], 0.0, current), *zip(zenith, azimuth, ratio, strict=True)]
    for down, around, values in views:
        for part in _threes(list(values)):
            lines.append("".join(f"{down:7.1f}{around:7.1f}{v:12.4E}" for v in part))
    return "\n".join(lines) + "\n"
