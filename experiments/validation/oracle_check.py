"""Error of a solver against reference radiances of independent solvers.

    python -m experiments.validation.oracle_check FILE... --solver orders --preset normal --json OUT

A file has either parameter axes (`tau_rayleigh`, optional `aod`, `ssa_aerosol`, `albedo`, `g`) or a table
`cases` with `case_fields`; both end in the axes sza, vza, raz (degrees). Radiance per unit normal irradiance.
"""

import argparse
import itertools
import json
import pathlib
import time

import jax
import jax.numpy as jnp
import numpy as np

import skyfit
from skyfit.atmosphere import Exponential, Ground, HenyeyGreenstein, Prescribed, RayleighPhase


FIELDS = ("tau_rayleigh", "aod", "ssa_aerosol", "g", "albedo")
DEFAULTS = {"aod": 0.0, "ssa_aerosol": 1.0, "g": 0.7, "albedo": 0.0}
SOLVERS = {"orders": skyfit.OrdersOfScattering, "single": skyfit.SingleScattering}


def load(path: pathlib.Path, variable: str):
    """Cases `[case, field]`, the angles in degrees and the reference `[case, sza, vza, raz]` with its sigma."""
    data = np.load(path)
    angles = [np.asarray(data[name], float) for name in ("sza", "vza", "raz")]
    grid = tuple(len(a) for a in angles)
    if "cases" in data:
        columns = [list(data["case_fields"]).index(name) for name in FIELDS]
        cases = data["cases"][:, columns]
        reference = data[variable]
    else:
        axes = [
            name
            for name in ("tau_rayleigh", "aod", "ssa_aerosol", "g", "albedo")
            if name in data and np.ndim(data[name]) == 1
        ]
        if variable == "single_scatter":
            axes.remove("albedo")
        fixed = {n: float(data[n]) for n in FIELDS if n in data and np.ndim(data[n]) == 0}
        values = {**DEFAULTS, **fixed}
        rows = itertools.product(*(data[name] for name in axes))
        cases = np.array([[{**values, **dict(zip(axes, row, strict=True))}[n] for n in FIELDS] for row in rows])
        reference = data[variable].reshape(len(cases), *grid)
    sigma = data["sigma"] if "sigma" in data and variable == "radiance" else np.zeros_like(reference)
    return cases, angles, reference, sigma


def simulate(solver, cases, angles):
    """The solver's radiances `[case, sza, vza, raz]`, and the seconds of a second, compiled run."""
    sza, vza, raz = angles
    zenith, azimuth = np.meshgrid(vza, raz, indexing="ij")
    view = skyfit.Directions.from_degrees(zenith, azimuth)
    one = np.array([550.0])
    absent_aerosol = bool(np.all(cases[:, 1] == 0.0))

    def sky(case, sun):
        tau, aod, albedo_single, asymmetry, albedo = case
        aerosol = (
            None
            if absent_aerosol
            else Prescribed(aod[None], Exponential(1200.0), HenyeyGreenstein(asymmetry), albedo_single[None])
        )
        atmosphere = skyfit.Atmosphere(
            Prescribed(tau[None], Exponential(8000.0), RayleighPhase(0.0)), aerosol, None, Ground(albedo)
        )
        scene = skyfit.Scene.from_degrees(sun, view, one, irradiance="unit")
        return solver.radiance(atmosphere, scene)[:, 0]

    run = jax.jit(lambda c, s: jax.lax.map(lambda x: jax.vmap(sky, (None, 0))(x, s), c))
    arguments = jnp.asarray(cases, float), jnp.asarray(sza, float)
    run(*arguments).block_until_ready()
    start = time.perf_counter()
    result = np.asarray(run(*arguments))
    seconds = time.perf_counter() - start
    return result.reshape(len(cases), len(sza), len(vza), len(raz)), seconds


def compare(path, arguments):
    """One row of the result: maximum and median relative error and where the worst lies."""
    variable = "single_scatter" if arguments.solver == "single" else "radiance"
    cases, angles, reference, sigma = load(path, variable)
    solver = getattr(SOLVERS[arguments.solver], arguments.preset)(arguments.geometry)
    result, seconds = simulate(solver, cases, angles)
    sza, vza, _ = angles
    chosen = (sza <= arguments.max_sun_zenith)[:, None] & (vza <= arguments.max_view_zenith)[None]
    chosen = np.broadcast_to(chosen[None, :, :, None], reference.shape) & (reference > 0.0)
    safe = np.where(reference > 0.0, reference, 1.0)
    error = np.where(chosen, np.abs(result - reference) / safe, -1.0)
    beyond = np.where(chosen, np.maximum(np.abs(result - reference) - 3.0 * sigma, 0.0) / safe, -1.0)
    worst = np.unravel_index(np.argmax(error), error.shape)
    names = dict(zip(FIELDS, map(float, cases[worst[0]]), strict=True))
    names |= {n: float(a[i]) for n, a, i in zip(("sza", "vza", "raz"), angles, worst[1:], strict=True)}
    return {
        "file": path.name,
        "solver": arguments.solver,
        "preset": arguments.preset,
        "geometry": arguments.geometry,
        "dtype": str(jnp.result_type(float)),
        "points": int(chosen.sum()),
        "non_finite": int(np.sum(~np.isfinite(result[chosen]))),
        "max_relative_error": float(error.max()),
        "median_relative_error": float(np.median(error[chosen])),
        "max_error_beyond_3_sigma": float(beyond.max()),
        "worst": names,
        "seconds": seconds,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("files", nargs="+", type=pathlib.Path)
    parser.add_argument("--solver", choices=SOLVERS, default="orders")
    parser.add_argument("--preset", choices=("draft", "normal", "fine"), default="normal")
    parser.add_argument("--geometry", choices=("flat", "spherical"), default="flat")
    parser.add_argument("--max-sun-zenith", type=float, default=85.0)
    parser.add_argument("--max-view-zenith", type=float, default=85.0)
    parser.add_argument("--float64", action="store_true")
    parser.add_argument("--json", type=pathlib.Path)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", arguments.float64)
    rows = [compare(path, arguments) for path in arguments.files]
    for row in rows:
        print(
            f"{row['file']:28s} max {100 * row['max_relative_error']:8.4f} %  median "
            f"{100 * row['median_relative_error']:8.4f} %  {row['seconds']:.2f} s  {row['worst']}"
        )
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
