"""How fast a sky is inverted, and from where: against scipy, against scipy over sasktran2, and from random starts.

    python -m experiments.benchmarks.inversion_speed [--shared ../shared] [--only scan,starts]

Writes experiments/results/inversion_speed.json. The scan is the measured one of 11:30 (80 directions, 31 wavelengths,
10 parameters), least squares without calibration or outliers so that all solvers have the same cost. `gradient` is the
derivative of the fitted optical depth by all samples, through `retrieve`.
"""

import argparse
import importlib.metadata
import json
import pathlib
import platform
import statistics
import subprocess
import time

import equinox as eqx
import jax
import numpy as np
import scipy.optimize

import skyfit
from skyfit.measured import NoiseModel
from skyfit.numerics import as_float
from skyfit.retrieve import LOBES_FREE, retrieve, start_model, with_values
from skyfit.retrieve.forward import observe
from skyfit.retrieve.invert import solve
from skyfit.retrieve.prepared import first_points, prepared
from skyfit.retrieve.residuals import bound


HERE = pathlib.Path(__file__).resolve().parents[1]
RESULT = HERE / "results" / "inversion_speed.json"
GRID = 360.0 + 11.75 * np.arange(31)
SCAN, REPEATS = 4, 5
PLAIN = NoiseModel(loss="squares", calibration=0.0)
STARTS_FREE = (
    "aerosol_optical_depth", "angstrom_exponent", "single_scattering_albedo", "asymmetry", "ground_albedo",
)  # fmt: skip


def scan(shared: pathlib.Path) -> dict:
    """One measured scan by `invert`, by scipy over the same jitted residual, and scipy's calls over sasktran2."""
    sky = skyfit.read(shared / "measured" / "kider2014" / "2013-05-27.nc").at(SCAN).select(GRID)
    asked = prepared(sky, LOBES_FREE, measurement=PLAIN, fwhm_nm=5.75)
    here = np.array([0])
    one = asked.problem.at(0)

    @eqx.filter_jit
    def residual(free):
        model = with_values(asked.start, asked.names, bound(asked.names, free))
        return ((observe(asked.solver, model, one)[0] - one.measured) * one.weight).reshape(-1)

    def ours():
        return solve(asked, here, first_points(asked, here))

    def whole():
        return skyfit.invert(sky, measurement=PLAIN, fwhm_nm=5.75)

    def by_scipy(calls):
        def counted(free):
            calls.append(1)
            return np.asarray(residual(as_float(free)))

        return scipy.optimize.least_squares(counted, start, bounds=(-8.0, 8.0), x_scale="jac", method="trf")

    start = np.asarray(first_points(asked, here).own[0, 0], float)
    for call in (ours, whole):
        jax.block_until_ready(jax.tree.leaves(call().cost))
    np.asarray(residual(as_float(start)))
    seconds: dict[str, list[float]] = {"ours": [], "whole": [], "scipy": [], "forward": []}
    costs, calls, steps = {}, [], 0
    for _ in range(REPEATS):
        begin = time.perf_counter()
        estimate = jax.block_until_ready(ours())
        seconds["ours"].append(time.perf_counter() - begin)
        costs["ours"], steps = float(estimate.cost), int(estimate.steps)
        begin = time.perf_counter()
        whole()
        seconds["whole"].append(time.perf_counter() - begin)
        begin = time.perf_counter()
        for _ in range(10):
            residual(as_float(start)).block_until_ready()
        seconds["forward"].append((time.perf_counter() - begin) / 10)
        calls = []
        begin = time.perf_counter()
        costs["scipy"] = float(by_scipy(calls).cost)
        seconds["scipy"].append(time.perf_counter() - begin)
    median = {name: statistics.median(values) for name, values in seconds.items()}
    record = {
        "seconds": median,
        "cost": costs,
        "steps": steps,
        "scipy_calls": len(calls),
        "scipy_over_ours": statistics.median([s / o for s, o in zip(seconds["scipy"], seconds["ours"], strict=True)]),
        "scipy_over_whole": statistics.median([s / o for s, o in zip(seconds["scipy"], seconds["whole"], strict=True)]),
    }
    record["gradient"] = through_retrieve(asked, here, median["ours"])
    try:
        record |= over_sasktran2(sky, len(calls), median)
    except ImportError:
        print("sasktran2 is not installed: its forward is not timed")
    return record


def through_retrieve(asked, here, fitted: float) -> dict:
    """Reverse mode through a whole retrieval: seconds of compiling, of a call, and over those of the fit alone."""
    options = asked.options() | {"priors": asked.rows, "start": first_points(asked, here)}

    def depth(measured):
        problem = eqx.tree_at(lambda p: p.measured, asked.problem, measured)
        return retrieve(problem, asked.start, asked.names, **options).values[0, 0]

    measured = asked.problem.measured
    begin = time.perf_counter()
    program = jax.jit(jax.value_and_grad(depth)).lower(measured).compile()
    compiling, took = time.perf_counter() - begin, []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        _, slope = jax.block_until_ready(program(measured))
        took.append(time.perf_counter() - begin)
    return {
        "parameter": asked.names[0], "finite": bool(np.all(np.isfinite(slope))), "compile_seconds": compiling,
        "seconds": statistics.median(took), "over_fit": statistics.median(took) / fitted,
        "temporary_MiB": program.memory_analysis().temp_size_in_bytes / 2**20,
    }  # fmt: skip


def over_sasktran2(sky: skyfit.Sky, calls: int, median: dict) -> dict:
    """One forward of sasktran2 for as many directions and wavelengths, timed, times scipy's calls."""
    from experiments.benchmarks.rivals import Optics, prepare_sasktran2, View

    depth = 0.1 * (GRID / 550.0) ** -1.3
    flat = np.ones_like(GRID)
    optics = Optics(
        np.asarray(skyfit.Rayleigh().optical_depth_at(as_float(GRID))), depth, 0.9 * flat, 0.7 * flat, 0.1, 0.1 * flat
    )
    view = View(np.linspace(0.0, 78.0, 8), np.linspace(0.0, 180.0, 10), float(np.degrees(sky.sun_zenith[0])))
    forward = prepare_sasktran2(optics, view, "DiscreteOrdinates", streams=16)
    forward()
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        forward()
        times.append(time.perf_counter() - begin)
    seconds = statistics.median(times)
    return {"sasktran2_forward": seconds, "scipy_over_sasktran2_over_ours": seconds * calls / median["ours"]}


def starts(skies: int = 20, each: int = 25) -> dict:
    """From how many random starts the best chi-square is reached, without any guess from the data."""
    solver = skyfit.OrdersOfScattering.draft("flat")
    random = np.random.default_rng(7)
    wavelength, view = np.array([400.0, 440.0, 500.0, 550.0, 600.0, 650.0, 675.0, 710.0]), skyfit.hemisphere(30, 1.4)
    exact = NoiseModel(model_error=0.0, calibration=0.0)
    reached, beyond, flagged, unflagged, below_truth, steps = 0, 0, 0, 0, 0, []
    for number in range(skies):
        truth = [
            np.exp(random.uniform(np.log(0.03), np.log(0.6))), random.uniform(0.2, 2.0), random.uniform(0.8, 0.98),
            random.uniform(0.5, 0.8), random.uniform(0.05, 0.5),
        ]  # fmt: skip
        zenith = random.uniform(20.0, 70.0)
        model = with_values(start_model(STARTS_FREE, 101325.0), STARTS_FREE, truth)
        scene = skyfit.Scene.from_degrees(zenith, view, wavelength)
        clean = np.asarray(solver.radiance(model.atmosphere, scene), float)
        radiance = clean * (1.0 + 0.01 * random.standard_normal(clean.shape))
        sky = skyfit.Sky(
            radiance=radiance[None], sigma=0.01 * clean[None], usable=np.ones((1, *clean.shape), bool),
            view_zenith=np.asarray(view.zenith, float), view_azimuth=np.asarray(view.azimuth, float),
            wavelength_nm=wavelength, sun_zenith=[np.radians(zenith)], sun_azimuth=[0.0],
            time=np.array(["NaT"], "datetime64[ns]"), pressure_pa=101325.0,
        )  # fmt: skip
        asked = prepared(sky, STARTS_FREE, solver, measurement=exact)
        here = np.array([0])
        points = first_points(asked, here, guess=False, starts=each + 1, seed=number)
        ends = []
        for k in range(1, each + 1):
            one = jax.tree.map(lambda v, k=k: v[k : k + 1], points)
            ends.append(solve(asked, here, one))
        # by the stated noise: each end's cost is by the noise that its own residuals showed
        chi_squares = np.array([float(e.chi_square[0]) for e in ends])
        best = np.nanmin(chi_squares)
        at_truth = float(np.sum(((radiance - clean) / (0.01 * clean)) ** 2)) / (clean.size - len(STARTS_FREE))
        below_truth += best <= at_truth
        reached += int(np.sum(chi_squares <= 1.01 * best))
        beyond += int(np.sum(~(chi_squares <= 1.01 * best)))
        finite = np.array([bool(e.finite) for e in ends])
        flagged += int(np.sum(~finite))
        unflagged += int(np.sum(~np.isfinite(chi_squares) & finite))
        steps += [int(e.steps) for e in ends]
        print(number, best, at_truth, np.sum(chi_squares <= 1.01 * best), flush=True)
    return {
        "starts": skies * each,
        "reached": reached,
        "share": reached / (skies * each),
        "beyond_one_per_cent": beyond,
        "flagged": flagged,
        "not_finite_unflagged": unflagged,
        "best_no_worse_than_truth": int(below_truth),
        "skies": skies,
        "median_steps": statistics.median(steps),
        "most_steps": max(steps),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--shared", type=pathlib.Path, default=HERE.parent.parent / "shared")
    parser.add_argument("--only", default="scan,starts")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    record = json.loads(RESULT.read_text()) if RESULT.exists() else {}
    if "scan" in arguments.only:
        if arguments.shared.exists():
            record["scan"] = scan(arguments.shared)
            print(json.dumps(record["scan"], indent=2), flush=True)
        else:
            print(f"{arguments.shared} is absent: the scan keeps its last figures")
    if "starts" in arguments.only:
        record["starts"] = starts()
        print(json.dumps(record["starts"], indent=2))
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=HERE)
    record["made_with"] = {
        "commit": commit.stdout.strip(),
        "dtype": "float64",
        "machine": platform.machine(),
        "versions": {name: importlib.metadata.version(name) for name in ("jax", "optimistix", "scipy", "numpy")},
    }
    RESULT.write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main()
