"""Eight measured skies of one day (Kider et al. 2014) inverted: in the sample, held out, and beside the peers.

    python experiments/measured_sky.py [--shared ../shared] [--halves 10]

Scored as the peers were: model and data interpolated linearly at 360 + 11.75 k nm, k < 31, root mean square in
mW m-2 sr-1 nm-1. Writes experiments/results/measured_sky.json and measured_sky.png.
"""

import argparse
import csv
import importlib.metadata
import json
import os
import pathlib
import platform
import subprocess
import sys


os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from dataclasses import replace

import jax
import numpy as np

import skyfit
from skyfit.fit import DEFAULT_FREE, SLOW
from skyfit.scene import haversine


HERE = pathlib.Path(__file__).resolve().parent
RESULT = HERE / "results" / "measured_sky.json"
GRID = 360.0 + 11.75 * np.arange(31)
# scans before the clouds of noon; degrees from the sun
SETTLED, NEAR = 6, 20.0
BINS, COLOURS = np.arange(15.0, 106.0, 15.0), (383, 430, 500, 580, 650, 710)


def from_sun(sky: skyfit.Sky) -> np.ndarray:
    """Degrees between each direction and the sun, `[time, direction]`, the sun as the file has it."""
    half = [
        haversine(sky.view_zenith, zenith, sky.view_azimuth - azimuth)
        for zenith, azimuth in zip(sky.sun_zenith, sky.sun_azimuth, strict=True)
    ]
    return np.degrees(2.0 * np.arcsin(np.sqrt(np.asarray(half))))


def error(fit, sky: skyfit.Sky) -> tuple[np.ndarray, np.ndarray]:
    """Model minus data on the peers' grid, mW, and which samples count."""
    scored = sky.select(GRID)
    model = np.apply_along_axis(lambda row: np.interp(GRID, sky.wavelength_nm, row), -1, fit.model)
    return 1e3 * (model - scored.radiance), scored.usable


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def by_angle(fit, sky: skyfit.Sky) -> dict[str, list[float]]:
    """Median of model over data minus one, per cent, by angle from the sun, settled scans."""
    angle = from_sun(sky)[:SETTLED]
    table = {}
    for colour in COLOURS:
        w = int(np.argmin(np.abs(sky.wavelength_nm - colour)))
        ratio = 100.0 * (fit.model[:SETTLED, :, w] / sky.radiance[:SETTLED, :, w] - 1.0)
        usable = sky.usable[:SETTLED, :, w]
        table[str(colour)] = [
            float(np.median(ratio[usable & (angle >= low) & (angle < low + 15.0)])) for low in BINS[:-1]
        ]
    return table


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--shared", type=pathlib.Path, default=HERE.parent.parent / "shared")
    parser.add_argument("--halves", type=int, default=10, help="seeds of the held-out halves")
    arguments = parser.parse_args()
    folder = arguments.shared / "measured" / "kider2014"
    if not folder.exists():
        sys.exit(f"{folder} is absent: nothing to invert")
    jax.config.update("jax_enable_x64", True)
    sky = skyfit.read(folder / "2013-05-27.nc")
    shared = [name for name in DEFAULT_FREE if name in SLOW]
    far = from_sun(sky) > NEAR
    fits, record = {}, {}
    for name, settings in (("together", {"shared": shared}), ("alone", {})):
        fit = fits[name] = skyfit.invert(sky, **settings)
        off, usable = error(fit, sky)
        record[name] = {
            "all": rms(off[usable]),
            "beyond_20": rms(off[usable & far[..., None]]),
            "scans": [rms(e[u]) for e, u in zip(off, usable, strict=True)],
            "results": list(fit.result),
            "reduced_chi_square": fit.reduced_chi_square.tolist(),
            "parameters": {
                p: [[float(v), float(s)] for v, s in zip(fit.values[:, i], fit.sigma[:, i], strict=True)]
                for i, p in enumerate(fit.free)
            },
            "median_residual_percent": by_angle(fit, sky),
        }
        print(name, {k: record[name][k] for k in ("all", "beyond_20", "scans")}, flush=True)
    record["halves"] = []
    for seed in range(arguments.halves):
        half = np.zeros(len(sky.view_zenith), bool)
        half[np.random.default_rng(seed).permutation(half.size)[: half.size // 2]] = True
        for name, settings in (("together", {"shared": shared}), ("alone", {})):
            if name == "alone" and seed >= 3:
                continue
            fit = skyfit.invert(replace(sky, usable=sky.usable & half[None, :, None]), **settings)
            off, usable = error(fit, sky)
            held = usable & ~half[None, :, None]
            record["halves"].append(
                {
                    "seed": seed,
                    "fit": name,
                    "fitted": rms(off[usable & half[None, :, None]]),
                    "held_out": rms(off[held]),
                    "held_out_beyond_20": rms(off[held & far[..., None]]),
                    "held_out_beyond_10": rms(off[held & (from_sun(sky) > 10.0)[..., None]]),
                }
            )
            print(record["halves"][-1], flush=True)
    with (folder / "peer_rmse.csv").open() as file:
        rows = list(csv.DictReader(file))
    columns = {"all": "rmse_mW_m2_sr_nm", "beyond_20": "rmse_beyond_20deg_of_sun"}
    record["peers"] = {
        model: {
            key: float(np.sqrt(np.mean([float(r[column]) ** 2 for r in rows if r["model"] == model])))
            for key, column in columns.items()
        }
        for model in dict.fromkeys(row["model"] for row in rows)
    }
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=HERE)
    record["made_with"] = {
        "commit": commit.stdout.strip(),
        "dtype": "float64",
        "machine": platform.machine(),
        "versions": {name: importlib.metadata.version(name) for name in ("jax", "optimistix", "numpy")},
    }
    RESULT.write_text(json.dumps(record, indent=2) + "\n")
    skyfit.plot(fits["together"], RESULT.with_suffix(".png"))
    print(f"{'model':18s}{'all':>8s}{'beyond 20 deg':>15s}   mW m-2 sr-1 nm-1")
    for model, row in {
        "skyfit, together": record["together"],
        "skyfit, alone": record["alone"],
        **record["peers"],
    }.items():
        print(f"{model:18s}{row['all']:8.2f}{row['beyond_20']:15.2f}")
    for key in ("held_out", "held_out_beyond_20", "held_out_beyond_10"):
        values = sorted(h[key] for h in record["halves"] if h["fit"] == "together")
        print(f"{key}: median {np.median(values):.2f}, {values[0]:.2f} to {values[-1]:.2f}")


if __name__ == "__main__":
    main()
