"""Make the shipped sample sky, data/skies/sample.nc, with sasktran2 in its vector mode, a solver foreign to skyfit.

The radiance is the I of a sky with I, Q and U; the haze's scattering matrix is skyfit's. Beside it, sample_truth.json
says what went in, what sasktran2 made of it and how well it converged.
"""

import importlib.metadata
import json
import os
from pathlib import Path

import jax
import numpy as np
import pvlib
import sasktran2 as sk
import xarray as xr
from pvlib.spectrum.spectrl2 import _SPECTRL2_COEFFS

from experiments.validation.recovery import foreign
from skyfit import Aerosol, Atmosphere, Ground, Ozone, Rayleigh
from skyfit.atmosphere import describe, Exponential, HenyeyGreenstein
from skyfit.atmosphere.phase import HAZE_POLARISATION


EARTH_RADIUS_M = 6.371e6
FLAT_RADIUS_M = 6.371e8  # sasktran2 refuses ground-up views in its plane-parallel modes
TOP_M = 1.0e5
CLIMATOLOGY_PRESSURE_PA = 101300.0  # at sea level in sasktran2's us76 table
# ozone column above h, Lacis & Hansen 1974, J. Atmos. Sci. 31, 118: peak height and width, m
OZONE_PEAK_M, OZONE_WIDTH_M = 20.0e3, 5.0e3
MOMENTS = 128

SEED, NOISE = 1976, 0.01
FWHM_NM, PRESSURE_PA = 6.0, 101325.0
# the Earth-Sun factor of this day is 1 within 1e-4; the sun's position is given apart
WHEN = np.datetime64("2025-10-05T12:00:00", "ns")
SUN_ZENITH_DEG, SUN_AZIMUTH_DEG = 50.0, 160.0
WAVELENGTH_NM = np.arange(400.0, 720.1, 10.0)
CHECK_NM = np.array([400.0, 550.0, 720.0])
SKY = {
    "aod550": 0.18,
    "angstrom_exponent": 1.35,
    "aerosol_albedo": 0.93,
    "asymmetry": 0.68,
    "haze_polarisation": HAZE_POLARISATION,
    "scale_height_m": 1200.0,
    "ozone_du": 310.0,
    "ground_albedo": 0.12,
    "pressure_pa": PRESSURE_PA,
}
UNITS = {"scale_height_m": "m", "ozone_du": "DU", "pressure_pa": "Pa"}  # the others: 1
# view zenith and number of azimuths, evenly spaced from north
RINGS = {15.0: 8, 30.0: 12, 45.0: 12, 60.0: 16, 70.0: 16, 78.0: 12}
# azimuth from the sun's, either side, on the almucantar: 7 degrees are 5.4 degrees from the sun
ALMUCANTAR_DEG = (7.0, 10.0, 14.0, 20.0, 26.0, 45.0, 90.0, 135.0)


def levels(count: int) -> np.ndarray:
    """Heights, m, whose spacing grows as 2 km + height: 33 m at the ground with 241 levels."""
    return 2.0e3 * np.expm1(np.linspace(0.0, np.log1p(TOP_M / 2.0e3), count))


def _layered(shape, height_m, depth, albedo, moments=None):
    """Constituent of the given vertical shape, normalised so that its column is `depth` exactly."""
    extinction = (shape / np.trapezoid(shape, height_m))[:, None] * depth[None, :]
    if moments is not None:
        moments = np.broadcast_to(moments[:, None], (len(moments), *extinction.shape)).copy()
    return sk.constituent.Manual(extinction, np.full_like(extinction, albedo), moments)


def _air(wavelength_nm, height_m, pressure_pa, config, cos_sun=1.0, radius_m=EARTH_RADIUS_M):
    """Geometry and atmosphere with sasktran2's own us76 and Rayleigh scattering, nothing else."""
    geometry = sk.Geometry1D(cos_sun, 0.0, radius_m, height_m)
    air = sk.Atmosphere(geometry, config, wavelength_nm, calculate_derivatives=False)
    sk.climatology.us76.add_us76_standard_atmosphere(air)
    air.pressure_pa = air.pressure_pa * (pressure_pa / CLIMATOLOGY_PRESSURE_PA)
    air["rayleigh"] = sk.constituent.Rayleigh()
    return geometry, air


def sasktran2_rayleigh(
    wavelength_nm: np.ndarray, pressure_pa: float = PRESSURE_PA, level_count: int = 241
) -> tuple[np.ndarray, np.ndarray]:
    """Rayleigh optical depth and depolarisation p that sasktran2 uses, each [wavelength].

    The second Legendre coefficient of its phase function is (1 - p) / (2 + p).
    """
    config = sk.Config()
    height_m = levels(level_count)
    _, air = _air(np.asarray(wavelength_nm, float), height_m, pressure_pa, config)
    air.internal_object()
    depth = np.trapezoid(np.array(air.storage.total_extinction), height_m, axis=0)
    second = np.array(air.storage.leg_coeff)[2, 0]
    return depth, (1.0 - 2.0 * second) / (1.0 + second)


def sasktran2_radiance(
    wavelength_nm: np.ndarray,
    sun_zenith: float,
    view_zenith: np.ndarray,
    relative_azimuth: np.ndarray,
    *,
    aod550: float,
    angstrom_exponent: float,
    aerosol_albedo: float,
    asymmetry: float,
    haze_polarisation: float,
    scale_height_m: float,
    ozone_du: float,
    ground_albedo: float,
    pressure_pa: float = PRESSURE_PA,
    geometry: str = "spherical",
    streams: int = 24,
    level_count: int = 241,
    sun_positions: int = 3,
    polarised: bool = True,
) -> np.ndarray:
    """Sky radiance (I of I, Q and U) at sea level for a solar irradiance of 1, by sasktran2; scalar unless `polarised`.

    Single scattering is exact, multiple scattering by discrete ordinates (pseudo-spherical columns
    at `sun_positions` sun zeniths). No refraction, no gas but ozone, no direct beam.

    **Arguments** wavelength [nm]; angles [rad], azimuth relative to the sun's, 0 toward the sun;
    `aod550` with Angstrom's exponent; grey single-scattering albedo and Henyey-Greenstein
    asymmetry with skyfit's scattering matrix, polarised so much at 90 degrees; scale height [m];
    ozone column [DU]; Lambertian ground; station pressure [Pa], which scales sasktran2's US
    Standard Atmosphere 1976; `geometry` "spherical" or "flat" (huge Earth).

    **Returns** radiance [direction, wavelength], sr^-1.

    **Valid** sun zenith <= 85 degrees; view zenith 0 or 15 to 80 degrees, for between the two
    sasktran2 interpolates its diffuse source too coarsely (1 % off at 5 degrees). Flat: 0.1 %;
    spherical: multiple scattering is some 0.5 % bright against Monte Carlo in spherical shells.
    Both figures are of scalar skies; a vector one, flat, is within 0.1 % of published tables.

    **Source** ozone in height: Lacis & Hansen 1974, column above h ~ 1 / (1 + exp((h - b) / c)).
    """
    if geometry not in ("spherical", "flat"):
        raise ValueError(f"`geometry` must be 'spherical' or 'flat', got {geometry!r}")
    wavelength_nm = np.asarray(wavelength_nm, float)
    config = sk.Config()
    config.num_threads = os.cpu_count() or 1
    config.num_streams = streams
    config.num_stokes = 3 if polarised else 1
    config.num_singlescatter_moments = MOMENTS
    config.single_scatter_source = sk.SingleScatterSource.Exact
    config.multiple_scatter_source = sk.MultipleScatterSource.DiscreteOrdinates
    config.delta_m_scaling = True
    config.num_sza = sun_positions

    height_m = levels(level_count)
    cos_sun = float(np.cos(sun_zenith))
    radius_m = EARTH_RADIUS_M if geometry == "spherical" else FLAT_RADIUS_M
    model, air = _air(wavelength_nm, height_m, pressure_pa, config, cos_sun, radius_m)

    phase = HenyeyGreenstein(asymmetry, haze_polarisation)
    greek = foreign.greek_coefficients(phase, MOMENTS, wavelength_nm, polarised)
    aerosol_depth = aod550 * (wavelength_nm / 550.0) ** -angstrom_exponent
    haze = np.exp(-height_m / scale_height_m)
    air["aerosol"] = _layered(haze, height_m, aerosol_depth, aerosol_albedo, greek)
    # minus the derivative of the column above: a symmetric bump about the peak
    bump = np.cosh((height_m - OZONE_PEAK_M) / (2.0 * OZONE_WIDTH_M)) ** -2
    # Bird & Riordan 1986, (atm-cm)^-1
    table = _SPECTRL2_COEFFS
    absorption = np.interp(wavelength_nm, table["wavelength"], table["ozone_absorption"])
    ozone_depth = absorption * ozone_du / 1000.0
    air["ozone"] = _layered(bump, height_m, ozone_depth, 0.0)
    air["ground"] = sk.constituent.LambertianSurface(ground_albedo)

    views = sk.ViewingGeometry()
    for zenith, azimuth in zip(view_zenith, relative_azimuth, strict=True):
        ray = sk.SolarAnglesObserverLocation(cos_sun, float(azimuth), float(np.cos(zenith)), 0.0)
        views.add_ray(ray)
    result = sk.Engine(config, model, views).calculate_radiance(air)
    return result["radiance"].transpose("los", "wavelength", "stokes").to_numpy()[:, :, 0]


def solar_irradiance(wavelength_nm: np.ndarray, fwhm_nm: float) -> np.ndarray:
    """ASTM G173 extraterrestrial irradiance, W m^-2 nm^-1, seen through a Gaussian line shape."""
    table = pvlib.spectrum.get_reference_spectra(standard="ASTM G173-03")["extraterrestrial"]
    grid, sun = table.index.to_numpy(), table.to_numpy()
    line = np.exp(-4.0 * np.log(2.0) * ((grid - wavelength_nm[:, None]) / fwhm_nm) ** 2)
    return np.trapezoid(line * sun, grid) / np.trapezoid(line, grid)


def scan_directions() -> tuple[np.ndarray, np.ndarray]:
    """View zenith and azimuth, degrees: zenith, rings, almucantar; 5 degrees clear of the sun."""
    pairs = [(0.0, 0.0)]
    for zenith, count in RINGS.items():
        pairs += [(zenith, 360.0 * k / count) for k in range(count)]
    offsets = sorted({side * step for step in ALMUCANTAR_DEG for side in (-1, 1)} | {180.0})
    pairs += [(SUN_ZENITH_DEG, (SUN_AZIMUTH_DEG + offset) % 360.0) for offset in offsets]
    zenith_deg, azimuth_deg = np.array(pairs).T
    return zenith_deg, azimuth_deg


def nearest_atmosphere() -> Atmosphere:
    """The sample's air as skyfit has it: that of sasktran2's US Standard Atmosphere is no exponential."""
    phase = HenyeyGreenstein(SKY["asymmetry"], SKY["haze_polarisation"])
    profile = Exponential(SKY["scale_height_m"])
    haze = Aerosol(SKY["aod550"], SKY["angstrom_exponent"], SKY["aerosol_albedo"], phase=phase, profile=profile)
    return Atmosphere(Rayleigh(SKY["pressure_pa"]), haze, Ozone(SKY["ozone_du"]), Ground(SKY["ground_albedo"]))


def convergence(*place) -> dict:
    """Largest and median change of the radiance, %, from the default to another resolution."""
    trials = {"streams": (16, 32), "level_count": (121, 481), "sun_positions": (1, 7)}
    changes = [{key: value} for key, values in trials.items() for value in values]
    # no errors of resolution: what the Earth's curve does, and what polarisation does
    changes += [{"geometry": "flat"}, {"polarised": False}]
    default = sasktran2_radiance(CHECK_NM, *place, **SKY)
    report: dict = {"against": "24 streams, 241 levels, 3 sun positions; at 400, 550, 720 nm"}
    for change in changes:
        gap = np.abs(sasktran2_radiance(CHECK_NM, *place, **SKY, **change) / default - 1.0)
        figures = {"max_percent": gap.max(), "median_percent": np.median(gap)}
        name = " ".join(f"{key} {value}" for key, value in change.items())
        report[name] = {key: round(100.0 * float(value), 4) for key, value in figures.items()}
    return report


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    out = Path(__file__).resolve().parents[2] / "data" / "skies"
    out.mkdir(parents=True, exist_ok=True)
    zenith_deg, azimuth_deg = scan_directions()
    angles_deg = (SUN_ZENITH_DEG, zenith_deg, azimuth_deg - SUN_AZIMUTH_DEG)
    place = [np.radians(angle) for angle in angles_deg]
    day = int((WHEN - WHEN.astype("datetime64[Y]")) // np.timedelta64(1, "D")) + 1
    factor = float(pvlib.irradiance.get_extra_radiation(day, solar_constant=1.0, method="spencer"))
    sun = factor * solar_irradiance(WAVELENGTH_NM, FWHM_NM)
    clean = sasktran2_radiance(WAVELENGTH_NM, *place, **SKY) * sun
    if not (np.isfinite(clean).all() and (clean > 0.0).all()):
        raise RuntimeError("sasktran2 gave radiances that are not finite and positive")
    noise = np.random.default_rng(SEED).standard_normal(clean.shape)
    packages = "sasktran2 pvlib numpy xarray h5netcdf".split()
    versions = {name: importlib.metadata.version(name) for name in packages}
    axes = ("time", "direction", "wavelength")
    spectral = {"units": "W m-2 sr-1 nm-1"}
    degree, north = {"units": "degree"}, {"units": "degree", "comment": "clockwise from north"}
    sky = xr.Dataset(
        {
            "radiance": (axes, (clean * (1.0 + NOISE * noise))[None], spectral),
            "sigma": (axes, (NOISE * clean)[None], spectral | {"long_name": "standard deviation"}),
            "view_zenith": ("direction", zenith_deg, degree),
            "view_azimuth": ("direction", azimuth_deg, north),
            "sun_zenith": ("time", [SUN_ZENITH_DEG], degree),
            "sun_azimuth": ("time", [SUN_AZIMUTH_DEG], north),
        },
        coords={"time": [WHEN], "wavelength": ("wavelength", WAVELENGTH_NM, {"units": "nm"})},
        attrs={
            "title": "Computed clear sky with 1 % noise: the sample of skyfit",
            "source": f"sasktran2 {versions['sasktran2']}, vector, experiments/tables/make_sample_sky.py",
            "fwhm_nm": FWHM_NM,
            "pressure_pa": PRESSURE_PA,
            "altitude_m": 0.0,
            "made_by": json.dumps({"model": "sasktran2", "atmosphere": describe(nearest_atmosphere())}),
            "licence": "CC0-1.0",
        },
    )
    packed = {"dtype": "float32", "zlib": True, "complevel": 9, "shuffle": True}
    encoding = {name: packed for name in (*sky.data_vars, "wavelength")}
    encoding["time"] = {"units": "seconds since 1970-01-01", "dtype": "int64"}

    depth, depolarisation = sasktran2_rayleigh(CHECK_NM)
    truth = {
        "parameters": {k: {"value": v, "unit": UNITS.get(k, "1")} for k, v in SKY.items()},
        "scene": {
            "sun_zenith_deg": SUN_ZENITH_DEG,
            "sun_azimuth_deg": SUN_AZIMUTH_DEG,
            "time": str(WHEN)[:19],
            "directions": len(zenith_deg),
            "altitude_m": 0.0,
            "earth_radius_m": EARTH_RADIUS_M,
        },
        "sun": f"ASTM G173-03 extraterrestrial, Gaussian of FWHM {FWHM_NM:g} nm, earth_sun_factor",
        "earth_sun_factor": {"value": factor, "unit": "1", "source": f"Spencer, day {day}"},
        "solver": "sasktran2, vector (I, Q, U), of which the file has I: discrete ordinates, exact single scattering",
        "aerosol": f"Angstrom depth, grey Henyey-Greenstein, scattering matrix as of air with its F12 times "
        f"haze_polarisation (skyfit's HenyeyGreenstein), exponential profile to {TOP_M:g} m",
        "ozone": "Bird & Riordan 1986 coefficients in pvlib, linear in wavelength; Lacis & Hansen "
        f"1974 profile, peak {OZONE_PEAK_M:g} m, width {OZONE_WIDTH_M:g} m",
        "rayleigh": {
            "source": "sasktran2 Rayleigh constituent (bates) in its us76, scaled to pressure_pa",
            "wavelength_nm": CHECK_NM.tolist(),
            "optical_depth": depth.round(7).tolist(),
            "depolarisation": depolarisation.round(6).tolist(),
        },
        "left_out": "circular polarisation, refraction, gases other than ozone, structure inside a band",
        "noise": {"relative": NOISE, "kind": "Gaussian, multiplicative, independent", "seed": SEED},
        "versions": versions,
        "convergence": convergence(*place),
    }
    # each file beside its place first, so that none is left half-written
    sky.to_netcdf(out / "sample.nc.part", engine="h5netcdf", encoding=encoding)
    (out / "sample_truth.json.part").write_text(json.dumps(truth, indent=2) + "\n")
    for name in ("sample.nc", "sample_truth.json"):
        os.replace(out / f"{name}.part", out / name)
    print(json.dumps(truth["convergence"], indent=2))


if __name__ == "__main__":
    main()
