"""The corpus of broken skies: named ways to break what a faultless instrument gives, in Python and in files."""

import os
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray

import skyfit
from skyfit.measured import solar_position
from skyfit.retrieve import Fitted, start_model, with_values


SOLVER = skyfit.SingleScattering(8, "flat")
TRUTH = {"aerosol_optical_depth": 0.2, "angstrom_exponent": 1.1, "asymmetry": 0.65}
FREE = tuple(TRUTH)
# as many directions as wavelengths, so that one can be taken for the other
ZENITH = np.radians([0.0, 25, 25, 25, 50, 50, 50, 50, 75, 75, 75, 75])
AZIMUTH = np.radians([0.0, 10, 130, 250, 40, 130, 220, 310, 85, 175, 265, 355])
NM = np.linspace(420.0, 680.0, 12)
LATITUDE, LONGITUDE = 48.0, 11.0
TIME = np.array(["2024-06-01T06:30"], "datetime64[ns]")
NOISE = 0.01


@cache
def good(times=1) -> skyfit.Sky:
    """What a faultless instrument gives, with 1 % of noise; the sun rises from one time to the next."""
    time = TIME + np.arange(times) * np.timedelta64(20, "m")
    sun_zenith, sun_azimuth = solar_position(time, LATITUDE, LONGITUDE)
    shape = (times, ZENITH.size, NM.size)
    sky = skyfit.Sky(
        radiance=np.ones(shape), sigma=None, usable=np.ones(shape, bool), view_zenith=ZENITH, view_azimuth=AZIMUTH,
        wavelength_nm=NM, sun_zenith=sun_zenith, sun_azimuth=sun_azimuth, time=time, latitude_deg=LATITUDE,
        longitude_deg=LONGITUDE, altitude_m=120.0, pressure_pa=100000.0, fwhm_nm=6.0, source="made",
    )  # fmt: skip
    model = with_values(start_model(FREE, 100000.0), FREE, list(TRUTH.values()))
    clean = skyfit.predict(Fitted(time, (model,) * times, SOLVER, 6.0, NM, np.ones((times, NM.size))), sky)
    noise = NOISE * np.random.default_rng(1).standard_normal(shape)
    return replace(sky, radiance=clean * (1.0 + noise), sigma=NOISE * clean)


class Case(NamedTuple):
    """How an input is broken, and what its error or its flags must say; "right" asks for the true parameters."""

    make: Callable[[Path], skyfit.Sky | tuple[Path, dict]]
    parts: tuple[str, ...]
    ends: str
    free: tuple[str, ...] = FREE


def error(make, *parts, free=FREE):
    return Case(make, parts, "error", free)


def flag(make, *parts, free=FREE):
    return Case(make, parts, "flag", free)


def right(make, *parts):
    return Case(make, parts, "right")


# skies made in Python


def with_fields(change, times=1):
    """The good sky with the fields that `change` makes of it."""
    return lambda _: replace(good(times), **change(good(times)))


def with_radiance(change, sigma=False):
    """The good sky with another radiance, by default without sigma."""

    def make(_):
        sky = good()
        radiance = np.array(change(sky.radiance), float)
        return replace(sky, radiance=radiance, sigma=sky.sigma if sigma else None, usable=radiance >= 0.0)

    return make


def with_wavelengths(nm):
    return with_fields(lambda _: {"wavelength_nm": nm})


def only(directions=slice(None), wavelengths=slice(None)):
    def change(sky):
        usable = np.zeros(sky.usable.shape, bool)
        usable[:, directions, wavelengths] = True
        return {"usable": usable}

    return with_fields(change)


def noise_of_a_shutter(radiance):
    return np.random.default_rng(5).uniform(0.0, 0.2, radiance.shape)


def sun_in_view(radiance):
    sun = radiance.copy()
    sun[:, 8] *= 1e5
    return sun


def overcast(radiance):
    """CIE S 011, type 1: three times as bright overhead as at the horizon."""
    return radiance.mean(axis=1, keepdims=True) * ((1.0 + 2.0 * np.cos(ZENITH)) / 3.0)[None, :, None]


def twice(values, first=0, second=1):
    doubled = np.array(values)
    doubled[..., second] = doubled[..., first]
    return doubled


TIMED = ("time", "radiance", "sigma", "view_zenith", "view_azimuth", "sun_zenith", "sun_azimuth")
# h c, J m: what a photon carries, times its wavelength
PLANCK_LIGHT = 6.62607015e-34 * 299792458.0
SKIES = {
    "nothing": right(with_fields(lambda sky: {})),
    "no sigma": right(with_fields(lambda sky: {"sigma": None})),
    "mW": error(with_radiance(lambda light: 1e3 * light), "`sky`", "mW"),
    "mW, sigma too": error(with_fields(lambda s: {"radiance": 1e3 * s.radiance, "sigma": 1e3 * s.sigma}), "mW"),
    "uW cm-2": error(with_radiance(lambda light: 1e2 * light), "uW cm-2"),
    "mW cm-2 um-1": error(with_radiance(lambda light: 1e2 * light, sigma=True), "uW cm-2"),
    "per m": error(with_radiance(lambda light: 1e9 * light), "per um"),
    "photons": error(with_radiance(lambda light: light * NM * 1e-9 / PLANCK_LIGHT), "no sky"),
    "counts of a detector": error(with_radiance(lambda light: np.round(3e4 * light)), "no sky"),
    "ten times": flag(with_radiance(lambda light: 10.0 * light), "poor fit"),
    "per angstrom": flag(with_radiance(lambda light: 0.1 * light), "poor fit"),
    "kW": error(with_radiance(lambda light: 1e-3 * light), "of the light that air alone"),
    "night": error(with_radiance(lambda light: 1e-9 * np.ones_like(light)), "night"),
    "zero": error(with_radiance(np.zeros_like), "night"),
    "zero with sigma": error(with_radiance(np.zeros_like, sigma=True), "night"),
    "negative": error(with_radiance(np.negative), "no usable sample"),
    "nan": error(with_radiance(lambda light: np.nan * light), "no usable sample"),
    "nan that is usable": error(with_fields(lambda s: {"radiance": np.nan * s.radiance}), "`usable`", "not finite"),
    "infinite": error(with_fields(lambda s: {"radiance": np.inf * s.radiance}), "`usable`", "not finite"),
    "constant": flag(with_radiance(lambda light: np.full_like(light, 0.1)), "alike", "poor fit"),
    "a lamp": flag(with_radiance(lambda light: light.mean(axis=1, keepdims=True) + 0.0 * light), "alike"),
    "overcast": flag(with_radiance(overcast), "poor fit"),
    "noise": flag(with_radiance(noise_of_a_shutter), "poor fit"),
    "noise with sigma": flag(with_radiance(noise_of_a_shutter, sigma=True), "poor fit"),
    "clipped": flag(with_radiance(lambda light: np.minimum(light, np.quantile(light, 0.8))), "saturated"),
    "the sun's disc": flag(with_radiance(sun_in_view), "the sun's disc"),
    "sigma zero": error(with_fields(lambda s: {"sigma": 0.0 * s.sigma}), "`usable`", "`sigma`"),
    "sigma negative": error(with_fields(lambda s: {"sigma": -s.sigma}), "`usable`", "`sigma`"),
    "sigma nan": error(with_fields(lambda s: {"sigma": np.nan * s.sigma}), "`usable`", "`sigma`"),
    "sigma above the radiance": flag(with_fields(lambda s: {"sigma": 2.0 * s.radiance}), "not determined"),
    "sigma in mW": flag(with_fields(lambda s: {"sigma": 1e3 * s.sigma}), "not determined"),
    "sigma too small": flag(with_fields(lambda s: {"sigma": 1e-3 * s.sigma}), "times their sigma"),
    "view in degrees": error(with_fields(lambda s: {"view_zenith": np.degrees(ZENITH)}), "`view_zenith`", "rad"),
    "azimuth in degrees": error(with_fields(lambda s: {"view_azimuth": np.degrees(AZIMUTH)}), "`view_azimuth`"),
    "sun in degrees": error(with_fields(lambda s: {"sun_zenith": np.degrees(s.sun_zenith)}), "`sun_zenith`"),
    "view twice to radians": flag(
        with_fields(lambda s: {"view_zenith": np.radians(ZENITH), "view_azimuth": np.radians(AZIMUTH)}), "poor fit"
    ),
    "azimuth twice to radians": flag(with_fields(lambda s: {"view_azimuth": np.radians(AZIMUTH)}), "poor fit"),
    "sun twice to radians": flag(
        with_fields(lambda s: {"sun_zenith": np.radians(s.sun_zenith), "sun_azimuth": np.radians(s.sun_azimuth)}),
        "from the stated sun", "radians",
    ),
    "elevation of the views": flag(with_fields(lambda s: {"view_zenith": 0.5 * np.pi - ZENITH}), "view angles are"),
    "elevation of the sun": flag(with_fields(lambda s: {"sun_zenith": 0.5 * np.pi - s.sun_zenith}), "sun angles are"),
    "elevations": flag(
        with_fields(lambda s: {"view_zenith": 0.5 * np.pi - ZENITH, "sun_zenith": 0.5 * np.pi - s.sun_zenith}),
        "view and sun angles are elevations",
    ),
    "azimuth from south": flag(with_fields(lambda s: {"view_azimuth": AZIMUTH + np.pi}), "from south?"),
    "azimuth backwards": flag(with_fields(lambda s: {"view_azimuth": -AZIMUTH}), "counter-clockwise?"),
    "azimuth backwards from south": flag(
        with_fields(lambda s: {"view_azimuth": np.pi - AZIMUTH, "sun_azimuth": s.sun_azimuth + 0.6}), "poor fit"
    ),
    "azimuth from east": flag(with_fields(lambda s: {"view_azimuth": AZIMUTH + 0.5 * np.pi}), "from the stated sun"),
    "sun the other way": flag(with_fields(lambda s: {"sun_azimuth": s.sun_azimuth + np.pi}), "from the stated sun"),
    "sun an hour late": flag(
        with_fields(lambda s: {"sun_zenith": s.sun_zenith - 0.17, "sun_azimuth": s.sun_azimuth + 0.2}), "poor fit"
    ),
    "directions reversed": flag(with_radiance(lambda light: light[:, ::-1]), "poor fit"),
    "wavelengths reversed": flag(with_radiance(lambda light: light[..., ::-1]), "the residuals are"),
    "transposed": flag(with_radiance(lambda light: light.transpose(0, 2, 1)), "poor fit"),
    "axes exchanged": error(with_radiance(lambda light: light.transpose(1, 0, 2)), "`radiance`"),
    "a direction twice": flag(
        with_fields(
            lambda s: {
                "view_zenith": twice(ZENITH), "view_azimuth": twice(AZIMUTH),
                "radiance": twice(s.radiance.swapaxes(1, 2)).swapaxes(1, 2),
            }
        ),
        "directions 0 and 1 hold the same samples",
    ),
    "one direction for all": flag(
        with_fields(lambda s: {"view_zenith": np.full(12, 0.5), "view_azimuth": np.full(12, 1.0)}), "too few directions"
    ),
    "one direction": flag(only(directions=slice(4, 5)), "too few directions", free=FREE[:2]),
    "two directions": flag(only(directions=slice(4, 6)), "too few directions"),
    "one wavelength": flag(only(wavelengths=slice(4, 5)), "nm only", "not determined"),
    "one sample": error(only(slice(4, 5), slice(4, 5)), "1 usable samples", "3 free"),
    "no sample": error(only(slice(0), slice(0)), "no usable sample"),
    "no direction": error(with_fields(lambda s: {"radiance": s.radiance[:, :0]}), "`radiance`", "(1, 0, 12)"),
    "directions below the horizon": error(with_fields(lambda s: {"view_zenith": np.pi - 0.9 * ZENITH}), "`usable`"),
    "wavelengths in um": error(with_wavelengths(1e-3 * NM), "`wavelength_nm`", "nm"),
    "wavelengths in m": error(with_wavelengths(1e-9 * NM), "`wavelength_nm`", "nm"),
    "wavelengths in angstrom": error(with_wavelengths(10.0 * NM), "300-1100 nm"),
    "wavelengths of the infrared": error(with_wavelengths(NM + 800.0), "300-1100 nm"),
    "wavelengths in gas bands": error(with_wavelengths(np.linspace(900.0, 990.0, 12)), "no usable sample"),
    "wavelengths backwards": error(with_wavelengths(NM[::-1]), "`wavelength_nm`", "increase"),
    "a wavelength twice": error(with_wavelengths(twice(NM)), "`wavelength_nm`", "increase"),
    "pressure in hPa": error(with_fields(lambda _: {"pressure_pa": 1000.0}), "`pressure_pa`", "Pa"),
    "pressure of the sea": flag(with_fields(lambda _: {"altitude_m": 2000.0, "pressure_pa": 101300.0}), "sea level"),
    "altitude in km": flag(with_fields(lambda _: {"altitude_m": 0.12}), "km?"),
    "altitude in cm": error(with_fields(lambda _: {"altitude_m": 32500.0}), "`altitude_m`", "m"),
    "line shape in m": error(with_fields(lambda _: {"fwhm_nm": 6e-9}), "`fwhm_nm`", "nm"),
    "latitude in arc minutes": error(with_fields(lambda _: {"latitude_deg": 2880.0}), "`latitude_deg`"),
    "sun down at one time": flag(
        with_fields(lambda s: {"sun_zenith": s.sun_zenith + np.array([0.0, 0.6])}, 2), "not fitted: the sun is at"
    ),
    "a time twice": flag(with_fields(lambda s: {"time": s.time[[0, 0]]}, 2), "more than once"),
    "a shutter closed at one time": flag(
        with_fields(lambda s: {"radiance": s.radiance * [[[1.0]], [[0.0]]]}, 2), "night"
    ),
    "times unsorted": right(
        with_fields(lambda s: {n: getattr(s, n)[::-1] for n in TIMED}, 2)
    ),
    "more parameters than samples": error(
        only(slice(3), slice(2)), "6 usable samples", "7 free",
        free=(*FREE, "ozone", "single_scattering_albedo", "pointing_zenith", "pointing_azimuth"),
    ),
    "unknown parameter": error(with_fields(lambda s: {}), "`free`", "'visibility'", free=("visibility",)),
    "contradicting parameters": error(
        with_fields(lambda s: {}), "`free`", "both turbidity", free=("turbidity", "aerosol_optical_depth")
    ),
    "a parameter twice": error(with_fields(lambda s: {}), "`free`", "once", free=("asymmetry", "asymmetry")),
    "no parameter": error(with_fields(lambda s: {}), "`free`", free=()),
}  # fmt: skip


# files


def netcdf(change=lambda data: data, times=1, name="sky.nc", **options):
    """The good sky as NetCDF, changed."""

    def make(folder):
        sky = good(times)
        axes = ("time", "direction", "wavelength")
        data = xarray.Dataset(
            {
                "radiance": (axes, sky.radiance, {"units": "W m-2 sr-1 nm-1"}),
                "sigma": (axes, sky.sigma),
                "sun_zenith": ("time", np.degrees(sky.sun_zenith)),
                "sun_azimuth": ("time", np.degrees(sky.sun_azimuth)),
            },
            {
                "view_zenith": ("direction", np.degrees(ZENITH)),
                "view_azimuth": ("direction", np.degrees(AZIMUTH)),
                "wavelength": ("wavelength", NM),
                "time": sky.time,
            },
            {"latitude": LATITUDE, "longitude": LONGITUDE, "altitude_m": 120.0, "pressure_pa": 1e5, "fwhm_nm": 6.0},
        )
        change(data.copy(deep=True)).to_netcdf(folder / name, engine="h5netcdf")
        return folder / name, options

    return make


def assigned(**variables):
    """Each a function of the variable that it stands for."""
    return lambda data: data.assign({name: change(data[name]) for name, change in variables.items()})


def relit(change):
    return assigned(radiance=lambda light: (light.dims, change(light.values), light.attrs))


def attributed(**attributes):
    return lambda data: data.assign_attrs(attributes)


def in_unit(units, factor):
    def change(data):
        data["radiance"] = (data["radiance"] * factor).assign_attrs(units=units)
        data["sigma"] = data["sigma"] * factor
        return data

    return change


def shifted(hours, sun=True):
    """Times of a clock that is ahead of UTC."""

    def change(data):
        data = data.assign_coords(time=data["time"] + np.timedelta64(hours, "h"))
        return data if sun else data.drop_vars(["sun_zenith", "sun_azimuth"])

    return change


def placed(latitude, longitude, sun=False):
    def change(data):
        data = data.assign_attrs(latitude=latitude, longitude=longitude)
        return data if sun else data.drop_vars(["sun_zenith", "sun_azimuth"])

    return change


def holed(data):
    """A wavelength that most directions lack, and a direction of the format's fill value."""
    data["radiance"].values[:, 1:, 3] = np.nan
    data["radiance"].values[:, 2] = 9.969209968386869e36
    return data


def saturated(data):
    light = data["radiance"].values
    light[:, 8:] = np.minimum(light[:, 8:], 0.5 * light[:, 8:].max())
    return data


def table(change=lambda text: text, comments=(), name="sky.csv", encoding="utf-8", light=1.0, **options):
    """The good sky as a tidy CSV, its text changed."""

    def make(folder):
        sky = good()
        lines = [f"# {comment}" for comment in ("altitude_m: 120", "pressure_pa: 100000", "fwhm_nm: 6", *comments)]
        lines.append("time,view_zenith,view_azimuth,wavelength,radiance,sigma,sun_zenith,sun_azimuth")
        sun = f"{np.degrees(sky.sun_zenith[0]):.4f},{np.degrees(sky.sun_azimuth[0]):.4f}"
        for d, angles in enumerate(np.degrees([ZENITH, AZIMUTH]).T.round(6)):
            for w, nm in enumerate(NM.round(3)):
                value, sigma = light * sky.radiance[0, d, w], light * sky.sigma[0, d, w]
                lines.append(f"2024-06-01T06:30:00Z,{angles[0]},{angles[1]},{nm},{value:.6e},{sigma:.6e},{sun}")
        (folder / name).write_bytes(change("\n".join(lines) + "\n").encode(encoding))
        return folder / name, options

    return make


def replaced(old, new):
    return lambda text: text.replace(old, new)


def without_columns(*names):
    def change(text):
        lines = [line for line in text.splitlines() if not line.startswith("#")]
        header = lines[0].split(",")
        kept = [place for place, name in enumerate(header) if name not in names]
        return "\n".join(",".join(line.split(",")[place] for place in kept) for line in lines) + "\n"

    return change


def scan(change=lambda text: text, azimuth=lambda degrees: -degrees, zenith=lambda degrees: 90.0 - degrees, **options):
    """The good sky as a folder of spectra, local time two hours ahead; azimuths counter-clockwise, elevations."""
    settings = {"latitude": LATITUDE, "longitude": LONGITUDE, "utc_offset": 2, "altitude": 120, "fwhm_nm": 6} | options

    def make(folder):
        place = folder / "scan"
        place.mkdir()
        for d, angles in enumerate(zip(np.degrees(ZENITH), np.degrees(AZIMUTH), strict=True)):
            rows = [f"{nm:.3f}\t{light:.8e}" for nm, light in zip(NM, good().radiance[0, d], strict=True)]
            text = "\n".join(["Wavelength\tx", *rows]) + "\n"
            stem = f"2024-06-01___08.30.00_-_{d}____{azimuth(angles[1]):.4f}___{zenith(angles[0]):.4f}"
            (place / f"{stem}.asd.rad.txt").write_text(change(text))
        return place, {name: value for name, value in settings.items() if value is not None}

    return make


def plain(name, content=b""):
    def make(folder):
        (folder / name).write_bytes(content)
        return folder / name, {}

    return make


def whole_and(after):
    """The good NetCDF, then damaged on disk."""

    def make(folder):
        path, options = netcdf()(folder)
        after(path)
        return path, options

    return make


def cut(share):
    return lambda path: path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])


def unreadable(folder):
    path, options = table()(folder)
    if os.geteuid() == 0:
        # nothing is closed to root: a file whose every read fails
        path.unlink()
        path.symlink_to("/proc/self/mem")
    else:
        path.chmod(0)
    return path, options


def pipe(folder):
    os.mkfifo(folder / "sky.csv")
    return folder / "sky.csv", {}


def directory(name):
    def make(folder):
        (folder / name).mkdir()
        return folder / name, {}

    return make


def scaled(factor):
    def change(text):
        head, *rows = text.splitlines()
        pairs = (row.split("\t") for row in rows)
        return "\n".join([head, *(f"{nm}\t{factor * float(light):.8e}" for nm, light in pairs)]) + "\n"

    return change


RADIANS = np.pi / 180.0
FILES = {
    "netcdf": right(netcdf()),
    "netcdf in mW": right(netcdf(in_unit("mW m-2 sr-1 nm-1", 1e3)), "converted"),
    "netcdf per um": right(netcdf(in_unit("W m-2 sr-1 um-1", 1e3)), "converted"),
    "netcdf in uW cm-2": right(netcdf(in_unit("uW cm-2 sr-1 nm-1", 1e2)), "converted"),
    "netcdf in photons": error(netcdf(in_unit("photons s-1 m-2 sr-1 nm-1", 2.5e18)), "sky.nc", "'photons s-1"),
    "netcdf in candela": error(netcdf(in_unit("cd m-2", 683.0)), "sky.nc", "cd m-2 of", "wavelengths"),
    "netcdf of irradiance": error(netcdf(in_unit("W m-2 nm-1", 3.0)), "sky.nc", "'W m-2 nm-1'"),
    "netcdf without unit": error(netcdf(assigned(radiance=lambda r: r.drop_attrs())), "units", "none"),
    "netcdf in mW called W": error(netcdf(in_unit("W m-2 sr-1 nm-1", 1e3)), "mW"),
    "netcdf in W called mW": error(netcdf(in_unit("mW m-2 sr-1 nm-1", 1.0)), "of the light that air alone"),
    "netcdf wavelengths in angstrom": error(netcdf(assigned(wavelength=lambda w: 10.0 * w)), "sky.nc", "angstrom?"),
    "netcdf wavelengths in m": error(netcdf(assigned(wavelength=lambda w: 1e-9 * w)), "sky.nc", "are these m?"),
    "netcdf wavelengths in um": error(netcdf(assigned(wavelength=lambda w: 1e-3 * w)), "sky.nc", "are these um?"),
    "netcdf wavelengths backwards": right(netcdf(lambda data: data.isel(wavelength=slice(None, None, -1)))),
    "netcdf radiance alone backwards": flag(netcdf(relit(lambda light: light[..., ::-1])), "poor fit"),
    "netcdf axes in another order": right(netcdf(lambda data: data.transpose("wavelength", "time", "direction"))),
    "netcdf axes under each other's name": flag(netcdf(relit(lambda light: light.transpose(0, 2, 1))), "poor fit"),
    "netcdf angles in radians": error(
        netcdf(assigned(view_zenith=lambda z: RADIANS * z, view_azimuth=lambda a: RADIANS * a)), "sky.nc", "radians?"
    ),
    "netcdf azimuths in radians": flag(
        netcdf(assigned(view_azimuth=lambda a: RADIANS * a)), "view azimuths", "are these radians?"
    ),
    "netcdf sun in radians": flag(
        netcdf(assigned(sun_zenith=lambda z: RADIANS * z, sun_azimuth=lambda a: RADIANS * a)), "radians?"
    ),
    "netcdf zeniths that are elevations": flag(netcdf(assigned(view_zenith=lambda z: 90.0 - z)), "elevations"),
    "netcdf sun that is an elevation": flag(
        netcdf(assigned(sun_zenith=lambda z: 90.0 - z)), "the stated sun is 32 degrees", "elevations in place"
    ),
    "netcdf sun from south": flag(
        netcdf(assigned(sun_azimuth=lambda a: a + 180.0)), "the stated sun is", "counted from south?"
    ),
    "netcdf local time beside the sun": right(netcdf(shifted(2)), "the stated sun is", "UTC+2 h?"),
    "netcdf local time": flag(netcdf(shifted(5, sun=False)), "from the stated sun", "local time"),
    "netcdf local time before sunrise": error(netcdf(shifted(-5, sun=False)), "sun", "horizon"),
    "netcdf place exchanged beside the sun": right(netcdf(placed(LONGITUDE, LATITUDE, True)), "exchanged?"),
    "netcdf place exchanged": flag(netcdf(placed(LONGITUDE, LATITUDE))),
    "netcdf place in radians": flag(
        netcdf(placed(RADIANS * LATITUDE, RADIANS * LONGITUDE)), "in degrees: are these radians?"
    ),
    "netcdf west called east": flag(netcdf(placed(LATITUDE, -100.0, True)), "the stated sun is"),
    "netcdf latitude of no place": error(netcdf(placed(480.0, LONGITUDE)), "sky.nc", "`latitude`", "480"),
    "netcdf pressure in hPa": error(netcdf(attributed(pressure_pa=1000.0)), "sky.nc", "`pressure_pa`", "Pa"),
    "netcdf altitude in km": flag(netcdf(attributed(altitude_m=0.12)), "km?"),
    "netcdf line shape in m": error(netcdf(attributed(fwhm_nm=6e-9)), "sky.nc", "`fwhm_nm`", "6e-09"),
    "netcdf with holes": right(netcdf(holed), "missing"),
    "netcdf negative": error(netcdf(relit(np.negative)), "no usable sample"),
    "netcdf dark subtracted twice": error(netcdf(relit(lambda light: light - 10.0)), "no usable sample"),
    "netcdf saturated": flag(netcdf(saturated), "saturated"),
    "netcdf all suspect": error(netcdf(lambda data: data.assign(suspect=1)), "no usable sample"),
    "netcdf sigma zero": error(netcdf(assigned(sigma=lambda s: 0.0 * s)), "no usable sample"),
    "netcdf sigma nan": error(netcdf(assigned(sigma=lambda s: np.nan * s)), "no usable sample"),
    "netcdf below the horizon": error(netcdf(assigned(view_zenith=lambda z: 180.0 - 0.9 * z)), "no usable sample"),
    "netcdf sun down at one time": flag(
        netcdf(assigned(sun_zenith=lambda z: z + [0.0, 40.0]), 2), "not fitted: the sun is at or below the horizon"
    ),
    "netcdf a time twice": flag(netcdf(lambda data: data.isel(time=[0, 0])), "more than once"),
    "netcdf times unsorted": right(netcdf(lambda data: data.isel(time=[1, 0]), 2)),
    "netcdf no wavelength": error(netcdf(lambda data: data.isel(wavelength=slice(0))), "sky.nc", "(1, 12, 0)"),
    "netcdf of text": error(netcdf(relit(lambda light: light.astype(str).astype(object))), "sky.nc", "numbers"),
    "netcdf empty": error(whole_and(cut(0.0)), "sky.nc", "an empty file"),
    "netcdf cut short": error(whole_and(cut(0.4)), "sky.nc", "truncated"),
    "netcdf nearly whole": error(whole_and(cut(0.95)), "sky.nc", "truncated"),
    "a picture called nc": error(plain("sky.nc", b"\x89PNG\r\n\x1a\n" + bytes(64)), "sky.nc", "expected NetCDF"),
    "a text called nc": error(plain("sky.nc", b"view_zenith,radiance\n"), "sky.nc", "expected NetCDF"),
    "a directory called csv": error(directory("sky.csv"), "sky.csv", "folder of files", "found none"),
    "a directory called nc": error(directory("sky.nc"), "sky.nc", "folder of files", "found none"),
    "a missing file": error(lambda folder: (folder / "sky.nc", {}), "sky.nc", "found none"),
    "an unreadable file": error(unreadable, "sky.csv", "cannot be read"),
    "a pipe": error(pipe, "sky.csv", "pipe"),
    "a suffix unknown": error(plain("sky.xlsx", b"PK"), "sky.xlsx", "'.xlsx'"),
    "csv": right(table()),
    "csv in mW": right(table(comments=["units: mW m-2 sr-1 nm-1"], light=1e3), "converted"),
    "csv in mW without a word": error(table(light=1e3), "mW"),
    "csv in W called per um": error(table(comments=["units: W m-2 sr-1 um-1"]), "of the light that air alone"),
    "csv with decimal commas": error(table(replaced(".", ",")), "sky.csv", "columns"),
    "csv with quoted decimal commas": error(
        table(replaced(",25.0,", ',"25,0",')), "sky.csv", "`view_zenith`", "'25,0'"
    ),
    "csv with semicolons": error(table(replaced(",", ";")), "sky.csv", "expected column"),
    "csv with tabs": error(table(replaced(",", "\t")), "sky.csv", "expected column"),
    "csv with a mark of its bytes": right(table(encoding="utf-8-sig")),
    "csv of another system": right(table(replaced("\n", "\r\n"))),
    "csv in UTF-16": error(table(encoding="utf-16"), "sky.csv", "UTF-8"),
    "csv empty": error(plain("sky.csv"), "sky.csv", "an empty file"),
    "csv without header": error(table(lambda text: text[text.index("2024") :]), "sky.csv", "row 1", "columns"),
    "csv without rows": error(table(lambda text: text[: text.index("2024")]), "sky.csv", "expected rows"),
    "csv cut short": error(table(lambda text: text[: len(text) // 2 - 20]), "sky.csv", "row"),
    "csv with words": error(table(replaced(",50.0,", ",fifty,")), "sky.csv", "`view_zenith`", "'fifty'"),
    "csv with nan for angles": error(table(replaced(",50.0,", ",nan,")), "sky.csv", "`view_zenith`", "'nan'"),
    "csv a sample twice": error(table(lambda text: text + text.splitlines()[-1]), "sky.csv", "twice"),
    "csv of one sample": error(
        table(lambda text: "\n".join(text.splitlines()[:5]) + "\n"), "1 usable samples", "3 free"
    ),
    "csv without sun": error(
        table(without_columns("sun_zenith", "sun_azimuth")), "sky.csv", "`sun_zenith`", "latitude, longitude"
    ),
    "csv with an offset of its times": error(table(utc_offset=2), "sky.csv", "`utc_offset`"),
    "scan": right(scan(), "computed", "local time taken as UTC+2 h", "pressure 999 hPa from the altitude of 120 m"),
    "scan without the clock": error(scan(utc_offset=None), "scan", "`utc_offset`"),
    "scan with the clock reversed": flag(scan(utc_offset=-2), "local time"),
    "scan with minutes for hours": error(scan(utc_offset=120), "`utc_offset`", "120"),
    "scan with azimuths clockwise": flag(scan(azimuth=lambda degrees: degrees), "counter-clockwise?"),
    "scan with zenith angles": flag(scan(zenith=lambda degrees: degrees), "elevations"),
    "scan in mW": error(scan(scaled(1e3)), "mW"),
    "scan of counts": error(scan(scaled(3e5)), "no sky"),
    "scan with decimal commas": error(scan(replaced(".", ",")), "row 2", "expected a number"),
    "scan of empty files": error(scan(lambda text: ""), "asd.rad.txt", "an empty file"),
}  # fmt: skip
