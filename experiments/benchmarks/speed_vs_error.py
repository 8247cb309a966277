"""Time against error of every tier, preset and geometry, and of the rivals that are installed, over twelve scenes.

    python -m experiments.benchmarks.speed_vs_error [--repeats 5] [--scenes 12] [--no-rivals] [--plot-only]
        [--out FOLDER]

Scenes are seeded: sun zenith 10-88 degrees, turbidity 1.5-8, ground albedo 0-0.8, each range cut into as many strata
as there are scenes. 343 directions (49 zenith angles to 85 degrees x 7 azimuths, a product as nanodisort wants it) x
41 wavelengths, air, haze and ground. float64 and float32 each have a process of their own. The error is relative to
`OrdersOfScattering.fine(polarised=True)` of the row's own geometry in float64, over directions and wavelengths, where
that is not zero: column `reference`. So a tier of lower order pays for the orders that it leaves out, and one without
polarisation, the rivals' rows too, for that. Writes speed_vs_error.csv, one row per scene, solver, preset, geometry
and dtype, failures with the exception's name, and speed_vs_error.png.
"""

import argparse
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import warnings

import jax
import jax.numpy as jnp
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import skyfit
from experiments.benchmarks.rivals import installed, View
from experiments.benchmarks.tiers import (
    compiled,
    GEOMETRIES,
    HERE,
    made_with,
    make,
    models,
    rival_optics,
    seconds,
    WAVELENGTH_NM,
)
from skyfit.atmosphere import Aerosol, Ground, Rayleigh, turbidity_to_optical_depth


SEED = 12
ZENITH, AZIMUTH = np.linspace(0.0, 85.0, 49), np.linspace(0.0, 180.0, 7)
RANGES = np.array([[10.0, 88.0], [1.5, 8.0], [0.0, 0.8]])
# s: what takes longer is timed once a scene
SLOW = 1.0
ROWS = ("solver", "preset", "geometry", "dtype")
MARKERS = {"draft": "v", "normal": "o", "fine": "^"}


def scenes(count: int) -> np.ndarray:
    """Sun zenith (degrees), turbidity, ground albedo `[scene, 3]`: a Latin hypercube."""
    draw = np.random.default_rng(SEED)
    share = np.stack([draw.permutation(count) + draw.uniform(size=count) for _ in RANGES], axis=1) / count
    return np.round(RANGES[:, 0] + share * (RANGES[:, 1] - RANGES[:, 0]), 3)


def sky(values) -> tuple[skyfit.Atmosphere, skyfit.Scene]:
    """The atmosphere and the scene of one row of `scenes`; values may be traced."""
    sun, turbidity, albedo = values
    haze = Aerosol(turbidity_to_optical_depth(turbidity))
    zenith, azimuth = np.meshgrid(ZENITH, AZIMUTH, indexing="ij")
    scene = skyfit.Scene.from_degrees(
        sun, skyfit.Directions.from_degrees(zenith, azimuth), WAVELENGTH_NM, irradiance="unit"
    )
    return skyfit.Atmosphere(Rayleigh(), haze, None, Ground(albedo)), scene


def errors(found, reference) -> dict:
    """Median, 95th percentile and maximum of the relative error; the count of what is not finite."""
    light = reference > 0.0
    error = np.abs(found[light] / reference[light] - 1.0)
    finite = np.isfinite(error)
    record = dict.fromkeys(("median_error", "p95_error", "max_error"), np.nan)
    if np.any(finite):
        good = error[finite]
        record = {"median_error": np.median(good), "p95_error": np.quantile(good, 0.95), "max_error": good.max()}
    return record | {"non_finite": int(np.sum(~finite))}


def references(cases, folder: pathlib.Path) -> dict:
    """Polarised `fine` by geometry, `[scene, direction, wavelength]`: made in the float64 process, then read."""
    path = folder / "references.npz"
    if not path.exists():
        values = {}
        for geometry in GEOMETRIES:
            solver = make("orders polarised", "fine", geometry)
            run = jax.jit(lambda v, solver=solver: solver.radiance(*sky(v)))
            values[geometry] = np.array([run(jnp.asarray(case, float)) for case in cases])
        np.savez(path, **values)
    return dict(np.load(path))


def own_rows(cases, right, repeats: int) -> list[dict]:
    """Every tier: one program each for all scenes, timed in turns over the scenes."""
    rows = []
    for model in models():
        name = {"solver": model.name, "preset": model.preset, "geometry": model.geometry}
        name |= {"dtype": str(jnp.result_type(float)), "reference": f"orders polarised fine {model.geometry} float64"}
        try:
            skies = [jax.block_until_ready(sky(jnp.asarray(case, float))) for case in cases]
            run, compiling = compiled(model.solver.radiance, *skies[0])
            found = [np.asarray(run(*each), float) for each in skies]
            times = [[seconds(run, *each) for each in skies]]
            again = repeats if max(times[0]) < SLOW else 1
            times += [[seconds(run, *each) for each in skies] for _ in range(again - 1)]
        except Exception as failure:
            rows += [row_of(case, i, name, failure=type(failure).__name__) for i, case in enumerate(cases)]
            print(f"{model.name} {model.preset} {model.geometry}: {failure!r}", flush=True)
            continue
        for i, case in enumerate(cases):
            took = {"seconds": statistics.median(turn[i] for turn in times), "compile_seconds": compiling}
            rows.append(row_of(case, i, name) | took | errors(found[i], right[model.geometry][i]))
        print(f"{model.name} {model.preset} {model.geometry}: {report(rows[-len(cases) :])}", flush=True)
    return rows


def rival_rows(cases, right, repeats: int) -> list[dict]:
    """The rivals, scene after scene."""
    rows = []
    for (solver, preset), (_, geometries, prepare) in installed().items():
        for geometry in geometries:
            name = {"solver": solver, "preset": preset, "geometry": geometry, "dtype": "float64"}
            name |= {"reference": f"orders polarised fine {geometry} float64"}
            for i, case in enumerate(cases):
                try:
                    solve = prepare(rival_optics(sky(case)[0], WAVELENGTH_NM), View(ZENITH, AZIMUTH, case[0]), geometry)
                    found = solve()
                    times = [seconds(solve)]
                    times += [seconds(solve) for _ in range(repeats - 1) if times[0] < SLOW]
                    result = {"seconds": statistics.median(times)} | errors(found, right[geometry][i])
                    rows.append(row_of(case, i, name) | result)
                except Exception as failure:
                    print(f"{solver} {preset} {geometry}, scene {i}: {failure!r}", flush=True)
                    rows.append(row_of(case, i, name, failure=type(failure).__name__))
            print(f"{solver} {preset} {geometry}: {report(rows[-len(cases) :])}", flush=True)
    return rows


def row_of(case, number: int, name: dict, failure: str = "") -> dict:
    keys = ("sun_zenith_deg", "turbidity", "ground_albedo")
    return {"scene": number} | dict(zip(keys, map(float, case), strict=True)) | name | {"failure": failure}


def report(rows: list[dict]) -> str:
    table = pd.DataFrame(rows)
    if "seconds" not in table:
        return f"{len(rows)} failures"
    failures = int((table.failure != "").sum())
    return (
        f"{1e3 * table.seconds.median():.1f} ms, median error {100.0 * table.median_error.median():.3f} %, "
        f"{failures} failures, {int(table.non_finite.sum())} not finite"
    )


def front(middle: pd.DataFrame) -> pd.DataFrame:
    """What nothing else is both faster and closer than, fastest first."""
    ordered = middle.sort_values(["seconds", "median_error"])
    return ordered[ordered.median_error < ordered.median_error.cummin().shift(fill_value=np.inf)]


def plot(table: pd.DataFrame, path: pathlib.Path):
    """Medians over the scenes: time of a sky against median error; hollow marks are float64, the line is the front."""
    # polarised `fine` in float64 is its own reference
    good = table[table.median_error > 1e-12]
    middle = good.groupby(list(ROWS), sort=False)[["seconds", "median_error"]].median().reset_index()
    kinds, presets = list(dict.fromkeys(middle.solver)), list(dict.fromkeys(middle.preset))
    colours = dict(zip(kinds, matplotlib.colormaps["tab10"].colors, strict=False))
    others = (p for p in presets if p not in MARKERS)
    marks = MARKERS | dict(zip(others, "sDPX*hp<>", strict=False))
    figure, panels = plt.subplots(1, 2, figsize=(9.0, 5.0), dpi=100, sharex=True, sharey=True, layout="constrained")
    for panel, geometry in zip(panels, GEOMETRIES, strict=True):
        here = middle[middle.geometry == geometry]
        best = front(here)
        panel.loglog(1e3 * best.seconds, best.median_error, color="0.6", lw=1.0, zorder=1)
        for row in here.itertuples():
            face = "none" if row.dtype == "float64" else colours[row.solver]
            style = {"marker": marks[row.preset], "mfc": face, "mec": colours[row.solver], "ms": 8, "mew": 1.5}
            panel.loglog([1e3 * row.seconds], [row.median_error], ls="", **style)
        panel.set_title(f"{geometry} (error against polarised fine, {geometry})", size=10)
        panel.set_xlabel("time of one sky, ms")
        panel.grid(which="major", alpha=0.3)
        panel.margins(0.08)
    panels[0].set_ylabel("median relative error")
    legend = [plt.Line2D([], [], color=colours[k], lw=6, label=k) for k in kinds]
    legend += [plt.Line2D([], [], color="0.3", marker=marks[p], ls="", label=p) for p in presets]
    legend.append(plt.Line2D([], [], color="0.3", marker="o", mfc="none", ls="", label="float64: hollow"))
    figure.legend(handles=legend, loc="outside lower center", ncols=6, fontsize=9, frameon=False)
    figure.savefig(path)
    plt.close(figure)


def child(arguments):
    """One dtype's rows, as CSV."""
    jax.config.update("jax_enable_x64", arguments.child == "float64")
    warnings.filterwarnings("ignore", module="PythonicDISORT")
    cases = scenes(arguments.scenes)
    right = references(cases, arguments.out)
    rows = own_rows(cases, right, arguments.repeats)
    if arguments.child == "float64" and not arguments.no_rivals:
        rows += rival_rows(cases, right, arguments.repeats)
    pd.DataFrame(rows).to_csv(arguments.out / f"{arguments.child}.csv", index=False)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--scenes", type=int, default=12)
    parser.add_argument("--no-rivals", action="store_true")
    parser.add_argument("--plot-only", action="store_true", help="the picture anew from the table that is there")
    parser.add_argument("--out", type=pathlib.Path, default=HERE / "results")
    parser.add_argument("--child", choices=("float64", "float32"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        child(arguments)
        return
    target = arguments.out / "speed_vs_error.csv"
    if not arguments.plot_only:
        arguments.out.mkdir(parents=True, exist_ok=True)
        parts = []
        with tempfile.TemporaryDirectory() as folder:
            for dtype in ("float64", "float32"):
                command = [sys.executable, __file__, "--child", dtype, "--out", folder]
                command += ["--repeats", str(arguments.repeats), "--scenes", str(arguments.scenes)]
                command += ["--no-rivals"] * arguments.no_rivals
                place = os.pathsep.join([str(HERE.parent), os.environ.get("PYTHONPATH", "")])
                subprocess.run(command, check=True, env=os.environ | {"PYTHONPATH": place})
                parts.append(pd.read_csv(pathlib.Path(folder) / f"{dtype}.csv"))
        table = pd.concat(parts)
        packages = () if arguments.no_rivals else tuple({module for module, *_ in installed().values()})
        for key, value in made_with(SEED, packages).items():
            if key in ("commit", "machine", "jax", "seed", *packages):
                table[key] = value
        table.to_csv(target, index=False, float_format="%.6g")
    plot(pd.read_csv(target), arguments.out / "speed_vs_error.png")


if __name__ == "__main__":
    main()
