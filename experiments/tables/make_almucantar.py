"""Make the shipped photometer scan, data/skies/almucantar.alm and .lev20, with sasktran2, a solver foreign to skyfit.

    python -m experiments.tables.make_almucantar

One almucantar in the layout of AERONET's raw sky scans and the optical depths beside it, of a site that does not exist:
haze of two lognormal modes by sasktran2's Mie code, its sky by discrete ordinates with polarisation. Noise of 1 %, each
filter's scale 0.5 % off, optical depths 0.005 off. almucantar_truth.json says what went in.
"""

import json
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE
from experiments.validation.almucantars import AZIMUTHS, BEAM, CALIBRATION, LAYERS, modes, MOMENTS, NM, NOISE, spheres
from experiments.validation.recovery import foreign


SKIES = HERE.parent / "data" / "skies"
SEED = 21
HAZE = {
    "depth": 0.25, "fine_share": 0.7, "fine_radius": 0.16, "fine_width": 0.45, "coarse_radius": 2.4,
    "coarse_width": 0.65, "index": 1.45, "absorption": 0.008,
}  # fmt: skip
GROUND = 0.15
SITE, LATITUDE, LONGITUDE, ELEVATION = "Nowhere", 40.0, 5.0, 120.0
# when the first filter begins, and how long each takes
START, STEP = np.datetime64("2024-06-21T06:50:00", "s"), np.timedelta64(42, "s")
HEAD = "AERONET Version 3", SITE, "Version 3: Raw Sky Scan", "Contact: none", "UNITS: see names", "All Points", ""
COLUMNS = (
    "AERONET_Site,Date(dd:mm:yyyy),Time(hh:mm:ss),Instrument_Number,Nominal_Wavelength(nm),Exact_Wavelength(um),"
    "Solar_Zenith_Angle(Degrees),Sky_Scan_Type,Latitude(Degrees),Longitude(Degrees),Elevation(m),"
    "Radiance_for_Azimuth_Angle_in_Degrees(uW/cm^2/sr/nm)"
)
# W m-2 in uW cm-2
MICROWATT = 100.0


def main():
    import pandas
    import pvlib

    random = np.random.default_rng(SEED)
    haze = spheres(modes(HAZE), HAZE["index"] - 1j * HAZE["absorption"], HAZE["depth"])
    pressure = 101325.0 * np.exp(-ELEVATION / 8435.0)
    air = skyfit.Atmosphere(skyfit.Rayleigh(pressure), None, skyfit.Ozone(300.0), skyfit.Ground(GROUND))
    azimuth = np.concatenate([np.array(AZIMUTHS), -np.array(AZIMUTHS[:-1])[::-1]])
    times = START + STEP * np.arange(NM.size)
    place = pvlib.solarposition.get_solarposition(pandas.DatetimeIndex(times), LATITUDE, LONGITUDE, ELEVATION)
    day = pandas.Timestamp(START).day_of_year
    irradiance = np.asarray(skyfit.light.extraterrestrial_irradiance(jnp.asarray(NM), 10.0), float)
    irradiance = irradiance * float(skyfit.light.earth_sun_factor(day))
    rows = []
    # the wheel turns from long waves to short
    for turn, i in enumerate(np.argsort(-NM)):
        sun = float(place["zenith"].iloc[turn])
        only = SimpleNamespace(constituents=(*air.constituents, haze.at(i)), ground=air.ground)
        stokes = foreign.sasktran2_stokes(
            only, sun, np.full(azimuth.size, sun), azimuth, NM[i : i + 1], True, "spherical", layers=LAYERS,
            moments=MOMENTS,
        )  # fmt: skip
        scale = irradiance[i] * (1.0 + CALIBRATION * random.standard_normal())
        light = MICROWATT * stokes[0][:, 0] * scale * (1.0 + NOISE * random.standard_normal(azimuth.size))
        moment = times[turn].astype(object)
        start = f"{SITE},{moment:%d:%m:%Y},{moment:%H:%M:%S},7,{NM[i]:.0f},{NM[i] / 1e3:.4f},{sun:.5f},Almucantar"
        rows.append(",".join([start, f"{LATITUDE},{LONGITUDE},{ELEVATION}", *(f"{value:.5f}" for value in light)]))
    names = COLUMNS + "," * (azimuth.size - 1)
    angles = "," * COLUMNS.count(",") + ",".join(f"{angle:.3f}" for angle in azimuth)
    (SKIES / "almucantar.alm").write_text("\n".join([*HEAD, names, angles, *rows]) + "\n")

    off = BEAM * random.standard_normal(NM.size)
    names = ["Date(dd:mm:yyyy)", "Time(hh:mm:ss)", "Day_of_Year", *(f"AOD_{nm:.0f}nm" for nm in NM)]
    names += ["Ozone(Dobson)", "AERONET_Site_Name", "Site_Elevation(m)"]
    names += [f"Exact_Wavelengths_of_AOD(um)_{nm:.0f}nm" for nm in NM]
    rows = []
    for minutes in (-4, 7):
        moment = (START + np.timedelta64(minutes, "m")).astype(object)
        cells = [f"{moment:%d:%m:%Y}", f"{moment:%H:%M:%S}", f"{day}", *(f"{d:.6f}" for d in haze.depth + off)]
        rows.append(",".join([*cells, "300.0", SITE, f"{ELEVATION}", *(f"{nm / 1e3:.4f}" for nm in NM)]))
    head = ["AERONET Version 3;", SITE, "Version 3: AOD Level 2.0", "", "", ""]
    (SKIES / "almucantar.lev20").write_text("\n".join([*head, ",".join(names), *rows]) + "\n")

    optics = {
        "wavelength_nm": NM.tolist(), "aerosol_optical_depth": haze.depth.round(5).tolist(),
        "single_scattering_albedo": haze.albedo.round(5).tolist(), "asymmetry": haze.greek["a1"][1].round(5).tolist(),
    }  # fmt: skip
    truth = {"haze": HAZE, "ground_albedo": GROUND, "optics": optics, "seed": SEED}
    (SKIES / "almucantar_truth.json").write_text(json.dumps(truth, indent=1) + "\n")


if __name__ == "__main__":
    main()
