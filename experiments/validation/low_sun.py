"""Skies under a low and a set sun, inverted by `Spherical`: aerosol and ozone of another solver's skies.

    python -m experiments.validation.low_sun [--suns 85,88,90,92]

Skies of sasktran2's successive orders under 15 suns (scalar, spherical, haze of 0.15 at 550 nm, 300 DU of ozone) with
1 % of noise, inverted from the default start. Writes experiments/results/low_sun.json.
"""

import argparse
import json
import time

import numpy as np

import skyfit
from experiments.benchmarks.rivals import prepare_sasktran2_orders, View
from experiments.benchmarks.tiers import HERE, made_with, rival_optics


RESULT = HERE / "results" / "low_sun.json"
NM = np.array([430.0, 470.0, 510.0, 550.0, 575.0, 600.0, 640.0, 680.0])
ZENITH, AZIMUTH = np.array([5.0, 30.0, 55.0, 75.0]), np.array([0.0, 30.0, 90.0, 180.0])
FREE = ("aerosol_optical_depth", "ozone")
TRUTH = {"aerosol_optical_depth": 0.15, "ozone": 300.0}
LIMITS = {"aerosol_optical_depth": 0.01, "ozone": 10.0}
SEED, NOISE = 4, 0.01


def sky_under(sun_deg: float) -> skyfit.Sky:
    """The sky as sasktran2 has it, with noise."""
    atmosphere = skyfit.Atmosphere.from_optical_depth(TRUTH["aerosol_optical_depth"])
    ozone = atmosphere.ozone
    optics = rival_optics(atmosphere.replace(ozone=None), NM)
    view = View(ZENITH, AZIMUTH, sun_deg)
    absorber = np.asarray(ozone.optical_depth_at(NM)), lambda height: np.asarray(ozone.profile.density(height))
    light = prepare_sasktran2_orders(optics, view, 15, absorber)()
    zenith, azimuth = (v.ravel() for v in np.meshgrid(ZENITH, AZIMUTH, indexing="ij"))
    irradiance = np.asarray(skyfit.Scene.from_degrees(0.0, skyfit.hemisphere(1), NM).solar_irradiance)
    radiance = light * irradiance[None]
    radiance = radiance * (1.0 + NOISE * np.random.default_rng(SEED).standard_normal(radiance.shape))
    return skyfit.Sky(
        radiance=radiance[None], sigma=NOISE * radiance[None], usable=np.ones((1, *radiance.shape), bool),
        view_zenith=np.radians(zenith), view_azimuth=np.radians(azimuth), wavelength_nm=NM,
        sun_zenith=np.radians([sun_deg]), sun_azimuth=np.zeros(1), time=np.full(1, np.datetime64("NaT")),
        sun_distance_au=1.0, pressure_pa=101325.0, source=f"sun at {sun_deg:g}",
    )  # fmt: skip


def inverted(sun_deg: float) -> dict:
    sky = sky_under(sun_deg)
    start = time.perf_counter()
    noise = skyfit.NoiseModel(model_error=0.002)
    fit = skyfit.invert(sky, FREE, solver=skyfit.Spherical.normal(), draft=skyfit.Spherical.draft(), measurement=noise)
    seconds = time.perf_counter() - start
    row = {"sun_deg": sun_deg, "result": fit.result[0], "steps": int(fit.steps[0]), "seconds_with_compilation": seconds}
    for k, name in enumerate(FREE):
        value, sigma = float(fit.values[0, k]), float(fit.sigma[0, k])
        row[name] = {"value": value, "sigma": sigma, "off": value - TRUTH[name]}
    row["within"] = all(abs(row[name]["off"]) <= LIMITS[name] for name in FREE)
    return row


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--suns", default="85,88,90,92")
    given = arguments.parse_args()
    rows = []
    for sun in given.suns.split(","):
        rows.append(inverted(float(sun)))
        print(json.dumps(rows[-1]), flush=True)
    record = {"made_with": made_with(SEED, ("sasktran2",)), "limits": LIMITS, "skies": rows}
    RESULT.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
