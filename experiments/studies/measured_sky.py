"""Eight measured skies of one day (Kider et al. 2014) inverted: in the sample, held out, and beside the peers.

    python -m experiments.studies.measured_sky [--shared ../shared] [--halves 10] [--only together,models]

Scored as the peers were: model and data interpolated linearly at 360 + 11.75 k nm, k < 31, root mean square in
mW m-2 sr-1 nm-1. `models`: the same scans, each alone, by a scalar and a polarised solver and by particles, in the
sample and held out, and what explains the rest. Writes experiments/results/measured_sky.json and measured_sky.png.
"""

import argparse
import csv
import importlib.metadata
import json
import pathlib
import platform
import subprocess
import sys
from dataclasses import replace

import equinox as eqx
import jax
import numpy as np

import skyfit
from skyfit.retrieve import LOBES_FREE, PARTICLE_FREE, SLOW
from skyfit.scene import haversine


HERE = pathlib.Path(__file__).resolve().parents[1]
RESULT = HERE / "results" / "measured_sky.json"
GRID = 360.0 + 11.75 * np.arange(31)
# scans before the clouds of noon; degrees from the sun
SETTLED, NEAR = 6, 20.0
BINS, COLOURS = np.arange(15.0, 106.0, 15.0), (383, 430, 500, 580, 650, 710)
# one phase function of two lobes for all wavelengths; the ground of a green landscape in all of them
TWO_LOBES = (*(name for name in LOBES_FREE if name != "forward_fraction_slope"), "ground_red_edge")
MODELS = {
    "scalar, two lobes": (skyfit.OrdersOfScattering.normal(), TWO_LOBES),
    "polarised, two lobes": (skyfit.OrdersOfScattering.normal(polarised=True), TWO_LOBES),
    "polarised, particles": (skyfit.OrdersOfScattering.normal(polarised=True), PARTICLE_FREE),
}
HALVES_OF_MODELS = 3


def from_sun(sky: skyfit.Sky) -> np.ndarray:
    """Degrees between each direction and the sun, `[time, direction]`, the sun as the file has it."""
    half = [
        haversine(sky.view_zenith[0], zenith, sky.view_azimuth[0] - azimuth)
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


def errors_of(fit, sky: skyfit.Sky, chosen: np.ndarray) -> dict[str, float]:
    """Root mean squares over some directions, of all scans and of the settled ones, all and beyond 20 degrees."""
    off, usable = error(fit, sky)
    usable = usable & chosen[None, :, None]
    far = usable & (from_sun(sky) > NEAR)[..., None]
    return {
        "all": rms(off[usable]),
        "beyond_20": rms(off[far]),
        "settled": rms(off[:SETTLED][usable[:SETTLED]]),
        "settled_beyond_20": rms(off[:SETTLED][far[:SETTLED]]),
    }


def compared(sky: skyfit.Sky) -> dict:
    """Each of `MODELS` in the sample and on held-out halves."""
    everywhere = np.ones(sky.radiance.shape[1], bool)
    record = {}
    for name, (solver, free) in MODELS.items():
        fit = skyfit.invert(sky, free, solver)
        row = record[name] = {
            "fitted": errors_of(fit, sky, everywhere),
            "median_residual_percent": by_angle(fit, sky),
            "results": list(fit.result),
            "parameters": {p: fit.values[:, i].tolist() for i, p in enumerate(fit.free)},
            "haze": {
                q: {"value": d.value.tolist(), "sigma": d.sigma.tolist()} for q, d in skyfit.aerosol_optics(fit).items()
            },
        }
        if solver.polarised:
            row["remains"] = remains(fit, sky)
        halves = []
        for seed in range(HALVES_OF_MODELS):
            half = random_half(sky, seed)
            part = skyfit.invert(replace(sky, usable=sky.usable & half[None, :, None]), free, solver)
            halves.append(errors_of(part, sky, ~half))
        row["held_out"] = {key: float(np.mean([h[key] for h in halves])) for key in halves[0]}
        print(name, {k: row[k] for k in ("fitted", "held_out")}, row.get("remains"), flush=True)
        for colour, values in row["median_residual_percent"].items():
            print(f"  {colour:>4s}", *(f"{v:6.1f}" for v in values), flush=True)
    return record


def random_half(sky: skyfit.Sky, seed: int) -> np.ndarray:
    """Half of the directions."""
    half = np.zeros(sky.radiance.shape[1], bool)
    half[np.random.default_rng(seed).permutation(half.size)[: half.size // 2]] = True
    return half


def remains(fit, sky: skyfit.Sky) -> dict[str, float]:
    """Root mean square of the settled scans' residuals beyond 15 degrees, per cent, after regression on some causes.

    Each scan and colour has a level of its own. Causes: rings of one view zenith angle, whatever the sun; the
    instrument's sensitivity to polarisation (Q/I and U/I of the model); a tilt; stray light and non-linearity.
    """
    angle, rows, residuals, causes = from_sun(sky), [], [], {}
    places = [int(np.argmin(np.abs(sky.wavelength_nm - colour))) for colour in COLOURS[:-1]]
    colours = sky.wavelength_nm[places]
    zenith, azimuth = sky.view_zenith[0], sky.view_azimuth[0]
    ring = np.degrees(zenith)

    @eqx.filter_jit
    def polarised(model, zenith, sun_zenith, sun_azimuth):
        view = skyfit.Directions(zenith, azimuth)
        scene = skyfit.Scene(sun_zenith, sun_azimuth, view, colours, np.ones(colours.size))
        return fit.solver.stokes(model.atmosphere, model.instrument.sees(scene))

    for t, model in enumerate(fit.fitted.models[:SETTLED]):
        sun = float(sky.sun_zenith[t]), float(sky.sun_azimuth[t])
        here, above = (polarised(model, zenith + step, *sun) for step in (0.0, 1e-3))
        light, q, u = (np.asarray(part) for part in here)
        slope = (np.log(np.asarray(above.radiance)) - np.log(light)) / 1e-3
        for i, w in enumerate(places):
            good = sky.usable[t, :, w] & (angle[t] > BINS[0])
            causes = {
                "ring at 56": np.abs(ring - 56.0) < 3.0, "rings to 18": ring < 25.0, "q": q[:, i] / light[:, i],
                "u": u[:, i] / light[:, i], "tilt north": slope[:, i] * np.cos(azimuth),
                "tilt east": slope[:, i] * np.sin(azimuth), "stray": 1.0 / light[:, i],
                "log radiance": np.log(light[:, i]),
            }  # fmt: skip
            rows.append(np.array([c[good] for c in causes.values()], float).T)
            residuals.append(100.0 * np.log(fit.model[t, good, w] / sky.radiance[t, good, w]))
    names = list(causes)
    matrix = np.concatenate([r - r.mean(axis=0) for r in rows])
    left = np.concatenate([r - r.mean() for r in residuals])
    sets = {
        "nothing": (), "tilt": ("tilt north", "tilt east"), "stray": ("stray",), "log radiance": ("log radiance",),
        "polarisation of the instrument": ("q", "u"), "rings": ("ring at 56", "rings to 18"),
        "rings and polarisation of the instrument": ("ring at 56", "rings to 18", "q", "u"), "all": tuple(names),
    }  # fmt: skip
    record = {}
    for name, chosen in sets.items():
        columns = matrix[:, [names.index(c) for c in chosen]]
        found = np.linalg.lstsq(columns, left, rcond=None)[0] if chosen else np.zeros(0)
        record[name] = {"rms": rms(left - columns @ found), **dict(zip(chosen, map(float, found), strict=True))}
    return record


def usual(sky: skyfit.Sky, halves: int) -> tuple[dict, skyfit.Fit]:
    """The default fit of the scans together and of each alone, in the sample and held out, and the first of these."""
    shared = [name for name in LOBES_FREE if name in SLOW]
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
    for seed in range(halves):
        half = random_half(sky, seed)
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
    return record, fits["together"]


def peers(path: pathlib.Path) -> dict:
    """What the peers score on the same scans, which they did not fit."""
    with path.open() as file:
        rows = list(csv.DictReader(file))
    columns = {"all": "rmse_mW_m2_sr_nm", "beyond_20": "rmse_beyond_20deg_of_sun"}
    return {
        model: {
            key: float(np.sqrt(np.mean([float(r[column]) ** 2 for r in rows if r["model"] == model])))
            for key, column in columns.items()
        }
        for model in dict.fromkeys(row["model"] for row in rows)
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--shared", type=pathlib.Path, default=HERE.parent.parent / "shared")
    parser.add_argument("--halves", type=int, default=10, help="seeds of the held-out halves")
    parser.add_argument("--only", default="together,models", help="the parts to make anew, with commas")
    arguments = parser.parse_args()
    folder, parts = arguments.shared / "measured" / "kider2014", arguments.only.split(",")
    if not folder.exists():
        sys.exit(f"{folder} is absent: nothing to invert")
    jax.config.update("jax_enable_x64", True)
    sky = skyfit.read(folder / "2013-05-27.nc")
    record = json.loads(RESULT.read_text()) if RESULT.exists() else {}
    if "together" in parts:
        found, together = usual(sky, arguments.halves)
        record |= found | {"peers": peers(folder / "peer_rmse.csv")}
        skyfit.plot(together, RESULT.with_suffix(".png"))
    if "models" in parts:
        record["models"] = compared(sky)
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=HERE)
    record["made_with"] = {
        "commit": commit.stdout.strip(),
        "dtype": "float64",
        "machine": platform.machine(),
        "versions": {name: importlib.metadata.version(name) for name in ("jax", "optimistix", "numpy")},
    }
    RESULT.write_text(json.dumps(record, indent=2) + "\n")
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
