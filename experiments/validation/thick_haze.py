"""Haze from thin to thick and from broad to forward scattering, inverted: does the truth lie within the error bars?

    python -m experiments.validation.thick_haze [--skies 300] [--seed 13]

Skies of `OrdersOfScattering.fine("flat")`, which is within 0.2 % of DISORT with 48 streams there, with optical depths
of 0.05 to 4 (even in the logarithm), asymmetry parameters of 0.5 to 0.88, single-scattering albedos, grounds and suns
at random and 0.5 % of noise, inverted by `fit_many` with `OrdersOfScattering.normal("flat")`. Writes
experiments/results/thick_haze.json: how often the truth lies within one and two sigma, and how far off the worst are.
"""

import argparse
import json

import jax
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, made_with


RESULT = HERE / "results" / "thick_haze.json"
FREE = ("aerosol_optical_depth", "angstrom_exponent", "single_scattering_albedo", "asymmetry", "ground_albedo")
WAVELENGTH = np.array([440.0, 500.0, 600.0, 675.0])
NOISE = 0.005
# zenith and azimuth from the sun: an almucantar's azimuths at four heights
ZENITH, AZIMUTH = (
    v.ravel() for v in np.meshgrid([10.0, 35.0, 55.0, 72.0], [6.0, 12.0, 25.0, 50.0, 90.0, 135.0, 180.0])
)


def truths(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Parameters `[sky, parameter]` and zenith angles of the sun in degrees."""
    draw = np.random.default_rng(seed)
    depth = np.exp(draw.uniform(np.log(0.05), np.log(4.0), count))
    rows = depth, draw.uniform(0.1, 1.8, count), draw.uniform(0.85, 0.99, count), draw.uniform(0.5, 0.88, count)
    return np.stack([*rows, draw.uniform(0.05, 0.4, count)], axis=1), draw.uniform(25.0, 70.0, count)


def atmosphere_of(row) -> skyfit.Atmosphere:
    depth, exponent, albedo, asymmetry, ground = row
    haze = {"angstrom_exponent": exponent, "single_scattering_albedo": albedo}
    sky = skyfit.Atmosphere.from_optical_depth(depth, phase=skyfit.HenyeyGreenstein(asymmetry), **haze)
    return sky.replace(ground=skyfit.Ground(ground))


def simulated(rows: np.ndarray, suns: np.ndarray, seed: int) -> skyfit.Sky:
    """The skies, a time each."""
    view, solver = skyfit.Directions.from_degrees(ZENITH, AZIMUTH), skyfit.OrdersOfScattering.fine("flat")
    light = np.stack(
        [
            np.asarray(solver.radiance(atmosphere_of(row), skyfit.Scene.from_degrees(sun, view, WAVELENGTH)))
            for row, sun in zip(rows, suns, strict=True)
        ]
    )
    light = light * (1.0 + NOISE * np.random.default_rng(seed + 1).standard_normal(light.shape))
    return skyfit.Sky(
        radiance=light, sigma=NOISE * light, usable=np.ones(light.shape, bool), view_zenith=np.radians(ZENITH),
        view_azimuth=np.radians(AZIMUTH), wavelength_nm=WAVELENGTH, sun_zenith=np.radians(suns),
        sun_azimuth=np.zeros(len(suns)), time=np.full(len(suns), np.datetime64("NaT")), pressure_pa=101325.0,
        source="thick haze",
    )  # fmt: skip


def within(pull: np.ndarray) -> dict:
    """Shares of pulls within 1 and 2 sigma, and the largest, by parameter."""
    return {
        name: {"1 sigma": float(np.mean(p < 1.0)), "2 sigma": float(np.mean(p < 2.0)), "largest": float(p.max())}
        for name, p in zip(FREE, pull.T, strict=True)
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--skies", type=int, default=300)
    parser.add_argument("--seed", type=int, default=13)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    rows, suns = truths(options.skies, options.seed)
    sky = simulated(rows, suns, options.seed)
    fits = skyfit.fit_many(
        sky, FREE, solver=skyfit.OrdersOfScattering.normal("flat"), fwhm_nm=np.nan,
        progress=lambda done, of: print(f"{done} of {of}", flush=True),
    )  # fmt: skip
    ended = np.array([result == "successful" for result in fits.result])
    pull = np.abs(fits.values - rows) / fits.sigma
    thick = rows[:, 0] > 1.0
    record = made_with(options.seed) | {
        "skies": options.skies,
        "noise": NOISE,
        "results": {name: int(sum(r == name for r in fits.result)) for name in sorted(set(fits.result))},
        "successful": within(pull[ended]),
        "successful, optical depth above 1": within(pull[ended & thick]),
        "worst": [
            {
                "truth": rows[i].tolist(),
                "sun": suns[i],
                "found": fits.values[i].tolist(),
                "sigma": fits.sigma[i].tolist(),
            }
            for i in np.argsort(-np.where(ended, pull.max(axis=1), 0.0))[:5]
        ],
    }
    RESULT.write_text(json.dumps(record, indent=1) + "\n")
    print(json.dumps({key: record[key] for key in ("results", "successful")}, indent=1))


if __name__ == "__main__":
    main()
