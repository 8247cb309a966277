"""How fast many skies are inverted, and whether their error bars hold.

    python -m experiments.benchmarks.fit_many [--skies 1000] [--batches 1 4] [--out FILE.json]

Each sky has 30 directions and 8 wavelengths and a haze and a sun of its own, drawn at random; it is made by skyfit's
own scalar solver with 1 % noise, so that no model error is allowed for, and fitted by `fit_many` and that solver for
4 parameters. The chunks are compiled before. Seconds are of the wall and of the processor: other work on the machine
moves the first. `batches`: how many of the first 64 skies go in lock-step; `polarised`: those skies by the default
solver, whose light is not theirs, for the seconds alone.
"""

import argparse
import json
import os
import pathlib
import time
from dataclasses import replace

import equinox as eqx
import jax
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from skyfit.light import extraterrestrial_irradiance
from skyfit.measured import NoiseModel
from skyfit.retrieve import simulate, SkyModel, start_model, with_values


SEED = 0
# the truths are drawn evenly between these, the optical depth in its logarithm
TRUTH = {
    "aerosol_optical_depth": (0.05, 0.6), "angstrom_exponent": (0.3, 2.0), "single_scattering_albedo": (0.8, 0.98),
    "asymmetry": (0.55, 0.8),
}  # fmt: skip
FREE = tuple(TRUTH)
SUN_DEG = (20.0, 75.0)
DIRECTIONS, MOST_ZENITH_DEG = 30, 85.0
WAVELENGTH_NM = np.linspace(380.0, 780.0, 8)
NOISE, FWHM_NM, PRESSURE = 0.01, 6.0, 101325.0
TRIED = 64
MEASUREMENT = NoiseModel(model_error=0.0, calibration=0.0)
SCALAR, POLARISED = (skyfit.OrdersOfScattering.normal(polarised=vector) for vector in (False, True))


def skies(count: int) -> tuple[skyfit.Sky, np.ndarray]:
    """Skies as the pixels of one, and their truths `[time, parameter]`."""
    random = np.random.default_rng(SEED)
    truth = np.stack([random.uniform(*ends, count) for ends in TRUTH.values()], axis=1)
    low, high = np.log(TRUTH[FREE[0]])
    truth[:, 0] = np.exp(random.uniform(low, high, count))
    sun = np.radians(random.uniform(*SUN_DEG, count))
    view = skyfit.hemisphere(DIRECTIONS, np.radians(MOST_ZENITH_DEG))
    irradiance = np.asarray(extraterrestrial_irradiance(WAVELENGTH_NM, FWHM_NM), float)
    model = start_model(FREE, PRESSURE)

    def light(model: SkyModel, item):
        values, zenith = item
        scene = skyfit.Scene(zenith, 0.0, view, WAVELENGTH_NM, irradiance)
        return simulate(SCALAR, with_values(model, FREE, values), scene)

    made = eqx.filter_jit(lambda model, items: jax.lax.map(lambda item: light(model, item), items))
    radiance = np.asarray(made(model, (jax.numpy.asarray(truth), jax.numpy.asarray(sun))), float)
    sigma = NOISE * radiance
    sky = skyfit.Sky(
        radiance=radiance + sigma * random.standard_normal(radiance.shape), sigma=sigma,
        usable=np.ones(radiance.shape, bool), view_zenith=np.asarray(view.zenith, float),
        view_azimuth=np.asarray(view.azimuth, float), wavelength_nm=WAVELENGTH_NM, sun_zenith=sun,
        sun_azimuth=np.zeros(count), time=np.full(count, "NaT", "datetime64[ns]"), pressure_pa=PRESSURE,
        fwhm_nm=FWHM_NM,
    )  # fmt: skip
    return sky, truth


def first(sky: skyfit.Sky, count: int) -> skyfit.Sky:
    """The first times of a sky."""
    names = ("radiance", "sigma", "usable", "view_zenith", "view_azimuth", "sun_zenith", "sun_azimuth", "time")
    return replace(sky, **{name: getattr(sky, name)[:count] for name in names})


def timed(sky: skyfit.Sky, batch: int, solver=SCALAR) -> tuple[skyfit.Fits, dict[str, float]]:
    """The fits of a sky after compilation, and what one took."""
    begin = time.perf_counter()
    skyfit.fit_many(sky.at(0), FREE, solver, measurement=MEASUREMENT, batch_size=batch)
    compiled, processor = time.perf_counter(), os.times()
    found = skyfit.fit_many(sky, FREE, solver, measurement=MEASUREMENT, batch_size=batch)
    wall, used = time.perf_counter() - compiled, os.times()
    count = len(sky.time)
    seconds = used.user + used.system - processor.user - processor.system
    return found, {
        "skies": count,
        "s to compile": round(compiled - begin, 1),
        "skies per second": round(count / wall, 1),
        "ms of wall per sky": round(1e3 * wall / count, 1),
        "ms of processor per sky": round(1e3 * seconds / count, 1),
    }


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--skies", type=int, default=1000)
    arguments.add_argument("--batches", type=int, nargs="*", default=[1, 4])
    arguments.add_argument("--out", type=pathlib.Path, default=HERE / "results" / "fit_many.json")
    given = arguments.parse_args()

    sky, truth = skies(given.skies)
    few = first(sky, min(TRIED, given.skies))
    tried = {batch: timed(few, batch)[1] for batch in given.batches}
    vector = timed(few, 1, POLARISED)[1]
    found, seconds = timed(sky, 1)
    off = np.abs(found.values - truth) / found.sigma
    report = {
        "directions": DIRECTIONS, "wavelengths": WAVELENGTH_NM.size, "relative noise": NOISE, "truths between": TRUTH,
        "sun zenith": SUN_DEG,
        "results": {str(name): int(count) for name, count in zip(*np.unique(found.result, return_counts=True),
                                                                 strict=True)},
        "steps, mean and most": [round(float(found.steps.mean()), 2), int(found.steps.max())],
        "reduced chi-square, mean": round(float(np.nanmean(found.reduced_chi_square)), 4),
        # a time without a value counts as not held
        "% of truths within 68 % interval": _shares(off, 0.9945),
        "% of truths within 95 % interval": _shares(off, 1.9600),
        "sigma, median": {n: float(f"{v:.3g}") for n, v in zip(FREE, np.nanmedian(found.sigma, axis=0), strict=True)},
        "at a bound": {n: int(v) for n, v in zip(FREE, found.at_bound.sum(axis=0), strict=True)},
        **seconds,
        "load of the machine": [round(v, 1) for v in os.getloadavg()],
        "polarised": vector,
        "in lock-step": {str(batch): about for batch, about in tried.items()},
        **made_with(SEED, ("optimistix",)),
    }  # fmt: skip
    given.out.write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))


def _shares(off: np.ndarray, limit: float) -> dict[str, float]:
    return {name: round(100.0 * float(v), 1) for name, v in zip(FREE, (off <= limit).mean(axis=0), strict=True)}


if __name__ == "__main__":
    main()
