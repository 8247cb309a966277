"""Run time, compile time, Jacobians and time to the first result, with rivals in the same run.

    python -m experiments.benchmarks.benchmark [--repeats 15] [--no-rivals] [--shared ../shared] [--out FILE.json]

One sky is 343 directions x 41 wavelengths (380-780 nm) of air, haze and ground under a sun at 60 degrees, in float32;
rivals, in float64 as they are, see 7 zenith angles x 49 azimuths, the product that costs them least. Medians of
interleaved repeats after a warm-up. Errors: the flat oracles, sun and view zenith to 85 degrees.
"""

import argparse
import itertools
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time
import warnings

import jax
import jax.numpy as jnp
import numpy as np

import skyfit
from experiments.benchmarks.counted_work import floor
from experiments.benchmarks.rivals import installed, Optics, prepare_sasktran2_jacobian, View
from experiments.benchmarks.tiers import (
    compiled,
    HERE,
    interleaved,
    made_with,
    make,
    PRESETS,
    rival_optics,
    WAVELENGTH_NM,
)
from experiments.validation.oracle_check import compare, load
from skyfit.atmosphere import Aerosol, Exponential, Ground, HenyeyGreenstein, Ozone, Rayleigh


SEED = 0
BATCH = 60
SUN_ZENITH = 60.0
PARAMETERS = {
    "aerosol optical depth": 0.15, "exponent": 1.3, "single-scattering albedo": 0.95, "asymmetry": 0.7,
    "ground albedo": 0.1, "ozone": 300.0, "haze scale height": 1200.0, "pressure": 101325.0,
}  # fmt: skip
ORACLES = ("oracle_pp_rayleigh.npz", "oracle_pp_aerosol.npz")
FIRST = """
import time
start = time.perf_counter()
import numpy as np
import skyfit
imported = time.perf_counter() - start
scene = skyfit.Scene.from_degrees(60.0, skyfit.hemisphere(343), np.arange(380.0, 781.0, 10.0))
solver = skyfit.OrdersOfScattering.normal()
solver.radiance(skyfit.Atmosphere.from_turbidity(3.0), scene).block_until_ready()
print(imported, time.perf_counter() - start)
"""


def atmosphere_of(values, ozone: bool = True) -> skyfit.Atmosphere:
    """The atmosphere of the eight `PARAMETERS`."""
    depth, exponent, albedo, asymmetry, ground, column, height, pressure = values
    haze = Aerosol(depth, exponent, albedo, 0.0, HenyeyGreenstein(asymmetry), Exponential(height))
    return skyfit.Atmosphere(Rayleigh(pressure), haze, Ozone(column) if ozone else None, Ground(ground))


def scene_of(sun_zenith) -> skyfit.Scene:
    return skyfit.Scene.from_degrees(sun_zenith, skyfit.hemisphere(343), WAVELENGTH_NM, irradiance="unit")


def own_runs() -> tuple[dict, dict]:
    """Compiled calls by name, and the seconds that compiling each took."""
    values = jnp.asarray(list(PARAMETERS.values()), float)
    clear, full, scene = atmosphere_of(values, ozone=False), atmosphere_of(values), scene_of(SUN_ZENITH)
    draw = np.random.default_rng(SEED)
    suns = jnp.asarray(np.radians(draw.uniform(10.0, 80.0, BATCH)), float)
    hazes = jnp.asarray(draw.uniform(0.02, 0.5, BATCH), float)
    runs, compiling = {}, {}

    def add(name, function, *arguments):
        program, compiling[name] = compiled(function, *arguments)
        runs[name] = lambda: program(*arguments)
        print(f"{name}: compiled in {compiling[name]:.1f} s", flush=True)

    for preset, geometry in itertools.product(PRESETS, ("flat", "spherical")):
        add(f"orders {preset} {geometry}", make("orders", preset, geometry).radiance, clear, scene)
    for geometry in ("flat", "spherical"):
        solver = make("orders", "normal", geometry)

        def one(haze, sun, solver=solver):
            sky = atmosphere_of(values.at[0].set(haze), ozone=False)
            view, spectrum = scene.view, scene.wavelength_nm
            return solver.radiance(sky, skyfit.Scene(sun, 0.0, view, spectrum, scene.solar_irradiance))

        add(f"batch vmap {geometry}", jax.vmap(one), hazes, suns)
        add(f"batch map {geometry}", lambda h, s, one=one: jax.lax.map(lambda x: one(*x), (h, s)), hazes, suns)
        add(f"forward with ozone {geometry}", solver.radiance, full, scene)
        add(
            f"jacobian {geometry}",
            jax.jacfwd(lambda p, solver=solver: solver.radiance(atmosphere_of(p), scene)),
            values,
        )
    return runs, compiling


def rival_runs() -> dict:
    """The rivals that are installed, ready to solve the one sky."""
    values = list(PARAMETERS.values())
    optics = rival_optics(atmosphere_of(values, ozone=False), WAVELENGTH_NM)
    view = View(np.linspace(2.0, 85.0, 7), np.linspace(0.0, 180.0, 49), SUN_ZENITH)
    runs = {
        f"{name} {preset} flat": prepare(optics, view, "flat")
        for (name, preset), (_, _, prepare) in installed().items()
    }
    if any(name == "sasktran2" for name, _ in installed()):
        for name, derivatives in (("forward", False), ("jacobian", True)):
            runs[f"sasktran2 {name} flat"] = prepare_sasktran2_jacobian(optics, view, WAVELENGTH_NM, derivatives)
    return runs


def own_errors(shared: pathlib.Path) -> dict:
    """Maximum and median relative error of the presets, the larger of the flat oracle files."""
    errors = {}
    for preset in PRESETS:
        settings = argparse.Namespace(
            solver="orders", preset=preset, geometry="flat", max_sun_zenith=85.0, max_view_zenith=85.0
        )
        rows = [compare(shared / "oracles" / file, settings) for file in ORACLES]
        errors[f"orders {preset} flat"] = {
            key: max(row[key] for row in rows) for key in ("max_relative_error", "median_relative_error")
        }
    return errors


def rival_errors(shared: pathlib.Path) -> dict:
    """As `own_errors`: a rival takes the cases of a file as its wavelengths."""
    errors = {}
    for (name, preset), (_, _, prepare) in installed().items():
        worst = []
        for file in ORACLES:
            cases, (sza, vza, raz), reference, _ = load(shared / "oracles" / file, "radiance")
            air, haze, albedo, asymmetry, ground = cases.T
            few = vza <= 85.0
            found = []
            for i, sun in enumerate(sza):
                if sun <= 85.0:
                    solve = prepare(Optics(air, haze, albedo, asymmetry, 0.1, ground), View(vza[few], raz, sun), "flat")
                    right = reference[:, i][:, few].reshape(len(cases), -1).T
                    found.append(np.abs(solve() / right - 1.0))
            worst.append((np.nanmax(found), np.nanmedian(found), int(np.sum(~np.isfinite(found)))))
        keys = ("max_relative_error", "median_relative_error", "non_finite")
        errors[f"{name} {preset} flat"] = {
            key: float(np.max(v)) for key, v in zip(keys, zip(*worst, strict=True), strict=True)
        }
    return errors


def first_result(repeats: int) -> dict:
    """Seconds of `import skyfit` and to the first `normal` sky in a new process: no cache, and a warm one."""
    record = {}
    with tempfile.TemporaryDirectory() as folder:
        # what the command line turns on
        warm = {"JAX_COMPILATION_CACHE_DIR": folder, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2"}
        for name, change in (("no cache", {"JAX_ENABLE_COMPILATION_CACHE": "false"}), ("warm cache", warm)):
            environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")} | change
            environment["PYTHONPATH"] = os.pathsep.join([str(HERE.parent), os.environ.get("PYTHONPATH", "")])
            # a GPU's memory is this process's too
            environment["XLA_PYTHON_CLIENT_PREALLOCATE"] = "false"
            if platforms := os.environ.get("JAX_PLATFORMS"):
                environment["JAX_PLATFORMS"] = platforms
            times = []
            for turn in range(repeats + (name == "warm cache")):
                start = time.perf_counter()
                done = subprocess.run(
                    [sys.executable, "-c", FIRST], env=environment, capture_output=True, text=True, check=True
                )
                if turn or name == "no cache":
                    times.append((*map(float, done.stdout.split()), time.perf_counter() - start))
            keys = ("import_seconds", "first_result_seconds", "whole_process_seconds")
            record[name] = {k: statistics.median(v) for k, v in zip(keys, zip(*times, strict=True), strict=True)}
            print(f"first result, {name}: {record[name]}", flush=True)
    return record


def ratios(rows: dict) -> dict:
    """What the claims are about."""
    record = {}
    for geometry in ("flat", "spherical"):
        batch = {way: rows[f"batch {way} {geometry}"]["seconds"] / BATCH for way in ("vmap", "map")}
        best = min(batch, key=batch.__getitem__)
        forward = rows[f"forward with ozone {geometry}"]["seconds"]
        record[f"batch of {BATCH}, {geometry}"] = {"seconds_per_sky": batch[best], "by": best, "both": batch}
        record[f"jacobian over forward, {geometry}"] = rows[f"jacobian {geometry}"]["seconds"] / forward
    for name, row in rows.items():
        if "streams" in name:
            for preset in PRESETS:
                record[f"{name} over orders {preset} flat"] = row["seconds"] / rows[f"orders {preset} flat"]["seconds"]
    if "sasktran2 jacobian flat" in rows:
        slow = rows["sasktran2 jacobian flat"]["seconds"]
        record["sasktran2 jacobian over its forward"] = slow / rows["sasktran2 forward flat"]["seconds"]
        record["sasktran2 jacobian over ours, flat"] = slow / rows["jacobian flat"]["seconds"]
    return record


def floors(rows: dict) -> dict:
    """Counted floor of `normal` by the rates of the 2-core machine, and how near it runs; nothing on a GPU."""
    if jax.devices()[0].platform != "cpu":
        return {}
    clear = atmosphere_of(list(PARAMETERS.values()), ozone=False)
    record = {}
    for geometry in ("flat", "spherical"):
        least = floor(make("orders", "normal", geometry), clear, scene_of(SUN_ZENITH))
        measured = rows[f"orders normal {geometry}"]["seconds"]
        record[geometry] = least | {"measured_seconds": measured, "measured_over_floor": measured / least["seconds"]}
    return record


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--no-rivals", action="store_true")
    parser.add_argument("--shared", type=pathlib.Path, default=HERE.parent.parent / "shared")
    parser.add_argument("--out", type=pathlib.Path, default=HERE / "results" / "benchmark.json")
    arguments = parser.parse_args()
    # PythonicDISORT remarks on the moment of degree 0, which is 1
    warnings.filterwarnings("ignore", module="PythonicDISORT")
    first = first_result(3)
    runs, compiling = own_runs()
    if not arguments.no_rivals:
        runs |= rival_runs()
    rows = interleaved(runs, arguments.repeats)
    errors = {}
    if (arguments.shared / "oracles").exists():
        errors = own_errors(arguments.shared)
        errors |= {} if arguments.no_rivals else rival_errors(arguments.shared)
    else:
        print(f"{arguments.shared} is absent: no errors against oracles")
    for name, row in rows.items():
        row |= {"compile_seconds": compiling.get(name)} | errors.get(name, {})
        error = f"{100.0 * row['max_relative_error']:8.3f} % max" if "max_relative_error" in row else ""
        print(f"{name:36s} {1e3 * row['seconds']:10.1f} ms {error}")
    packages = () if arguments.no_rivals else tuple({module for module, *_ in installed().values()})
    record = {
        "sky": f"343 directions x {len(WAVELENGTH_NM)} wavelengths, sun zenith {SUN_ZENITH:g}, {PARAMETERS}",
        "rows": rows,
        "ratios": ratios(rows),
        "first_result": first,
        "floor": floors(rows),
        "made_with": made_with(SEED, packages),
    }
    print(json.dumps({key: record[key] for key in ("ratios", "floor")}, indent=1))
    arguments.out.parent.mkdir(exist_ok=True)
    arguments.out.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
