"""The accuracy figures that the README shows: against oracles, and the sample sky's truth.

    python experiments/accuracy.py [--shared ../shared] [--skip oracles,sample]

Writes experiments/results/accuracy.json; parts whose inputs are absent keep their last figures and say so.
`python experiments/readme_tables.py` puts the figures into README.md.
"""

import argparse
import importlib.metadata
import json
import pathlib
import platform
import statistics
import subprocess
import time

import jax
import numpy as np
from oracle_check import compare

import skyfit


HERE = pathlib.Path(__file__).resolve().parent
RESULT = HERE / "results" / "accuracy.json"
FREE = (
    "aerosol_optical_depth", "angstrom_exponent", "single_scattering_albedo", "asymmetry", "ground_albedo",
    "ozone",
)  # fmt: skip
TRUTH = {
    "aerosol_optical_depth": "aod550",
    "angstrom_exponent": "angstrom_exponent",
    "single_scattering_albedo": "aerosol_albedo",
    "asymmetry": "asymmetry",
    "ground_albedo": "ground_albedo",
    "ozone": "ozone_du",
}


def oracles(shared: pathlib.Path) -> list[dict]:
    """Errors of every preset against the reference radiances, with the time of one sky of 343 x 41."""
    cases = []
    for solver, preset, geometry, sun, view in (
        ("single", "normal", "flat", 85.0, 85.0),
        ("single", "normal", "spherical", 95.0, 89.0),
        ("orders", "draft", "flat", 85.0, 85.0),
        ("orders", "normal", "flat", 85.0, 85.0),
        ("orders", "fine", "flat", 85.0, 85.0),
        ("orders", "draft", "spherical", 80.0, 80.0),
        ("orders", "normal", "spherical", 80.0, 80.0),
        ("orders", "fine", "spherical", 80.0, 80.0),
        ("orders", "normal", "spherical", 85.0, 85.0),
        ("orders", "normal", "spherical", 89.0, 89.0),
    ):
        arguments = argparse.Namespace(
            solver=solver, preset=preset, geometry=geometry, max_sun_zenith=sun, max_view_zenith=view
        )
        kind = "pp" if geometry == "flat" else "sph"
        files = [shared / "oracles" / f"oracle_{kind}_{name}.npz" for name in ("rayleigh", "aerosol")]
        rows = [compare(path, arguments) for path in files]
        cases.append(
            {
                "solver": solver,
                "preset": preset,
                "geometry": geometry,
                "max_sun_zenith": sun,
                "max_view_zenith": view,
                "max_relative_error": max(row["max_relative_error"] for row in rows),
                "max_error_beyond_3_sigma": max(row["max_error_beyond_3_sigma"] for row in rows),
                "median_relative_error": max(row["median_relative_error"] for row in rows),
                "seconds_per_sky": seconds_per_sky(solver, preset, geometry),
            }
        )
        print(cases[-1], flush=True)
    return cases


def seconds_per_sky(solver: str, preset: str, geometry: str) -> float:
    """The median time of one sky of 343 directions and 41 wavelengths after compilation."""
    kinds = {"orders": skyfit.OrdersOfScattering, "single": skyfit.SingleScattering}
    model = getattr(kinds[solver], preset)(geometry)
    scene = skyfit.Scene.from_degrees(60.0, skyfit.hemisphere(343), np.arange(380.0, 781.0, 10.0))
    times = []
    for repeat in range(8):
        atmosphere = skyfit.Atmosphere.from_turbidity(2.0 + 0.1 * repeat)
        start = time.perf_counter()
        model.radiance(atmosphere, scene).block_until_ready()
        times.append(time.perf_counter() - start)
    return statistics.median(times[1:])


def sample() -> dict:
    """The shipped sample sky, made by sasktran2, inverted: truth, value and sigma of each parameter."""
    truth = json.loads((HERE.parent / "data" / "skies" / "sample_truth.json").read_text())["parameters"]
    # made by a polarised solver, with the haze at the height and of the polarisation that are assumed
    measurement = skyfit.Measurement(model_error=0.001)
    fit = skyfit.invert(skyfit.read(HERE.parent / "data" / "skies" / "sample.nc"), FREE, measurement=measurement)
    parameters = {
        name: {"truth": truth[TRUTH[name]]["value"], "value": float(fit.values[0, i]), "sigma": float(fit.sigma[0, i])}
        for i, name in enumerate(FREE)
    }
    return {"parameters": parameters, "result": fit.result[0], "reduced_chi_square": float(fit.reduced_chi_square[0])}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--shared", type=pathlib.Path, default=HERE.parent.parent / "shared")
    parser.add_argument("--skip", default="", help="parts to leave as they are, with commas")
    arguments = parser.parse_args()
    skip = set(arguments.skip.split(","))
    record = json.loads(RESULT.read_text()) if RESULT.exists() else {}
    if not arguments.shared.exists():
        print(f"{arguments.shared} is absent: the oracles keep their last figures")
        skip |= {"oracles"}
    if "oracles" not in skip:
        record["oracles"] = oracles(arguments.shared)
    jax.config.update("jax_enable_x64", True)
    jax.clear_caches()
    if "sample" not in skip:
        record["sample"] = sample()
        print("sample", record["sample"], flush=True)
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=HERE)
    record["made_with"] = {
        "commit": commit.stdout.strip(),
        "dtype": "float32 for the oracles, float64 for the fits",
        "python": platform.python_version(),
        "machine": f"{platform.machine()}, 2 shared cores",
        **{name: importlib.metadata.version(name) for name in ("jax", "optimistix", "equinox", "numpy")},
    }
    RESULT.parent.mkdir(exist_ok=True)
    RESULT.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
