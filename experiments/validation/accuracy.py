"""The accuracy figures that the README shows: against oracles, scalar and vector, and the sample sky's truth.

    python -m experiments.validation.accuracy [--shared ../shared] [--skip oracles,vector,cost,sample]

Writes experiments/results/accuracy.json; parts whose inputs are absent keep their last figures and say so.
`python -m experiments.readme_tables` puts the figures into README.md.
"""

import argparse
import importlib.metadata
import itertools
import json
import pathlib
import platform
import statistics
import subprocess
import time

import jax
import jax.numpy as jnp
import numpy as np

import skyfit
from experiments.benchmarks.benchmark import atmosphere_of, PARAMETERS, scene_of, SUN_ZENITH
from experiments.benchmarks.tiers import compiled, GEOMETRIES, interleaved, PRESETS
from experiments.validation.oracle_check import compare
from experiments.validation.recovery import tests_module


HERE = pathlib.Path(__file__).resolve().parents[1]
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


def vector(folder: pathlib.Path) -> list[dict]:
    """Errors of the flat presets, scalar and polarised, against the tables of Natraj et al. 2009.

    Rayleigh air of optical depth 0.02-1 (their wavelengths), ground albedo 0-0.8, sun and view cosines from 0.1, all
    azimuths. The error of Q and U is over I.
    """
    skies = tests_module("vector_skies")
    zenith, azimuth, kept = skies.natraj_views()
    view = skyfit.Directions.from_degrees(zenith, azimuth)
    right = skies.natraj(folder)[:, :, :, kept]
    # stand for the depths
    wavelength = np.linspace(400.0, 700.0, len(skies.DEPTHS))
    rows = []
    for preset, polarised in itertools.product(PRESETS, (False, True)):
        solver = getattr(skyfit.OrdersOfScattering, preset)("flat", polarised=polarised)
        found = np.empty((3 if polarised else 1, *right.shape[1:]))
        for (a, albedo), (s, cosine) in itertools.product(enumerate(skies.ALBEDOS), enumerate(skies.SUN_COSINES)):
            scene = skyfit.Scene.from_degrees(np.degrees(np.arccos(cosine)), view, wavelength, irradiance="unit")
            air = skies.natraj_air(albedo)
            light = solver.stokes(air, scene) if polarised else [solver.radiance(air, scene)]
            found[:, a, s] = np.reshape(light, found[:, a, s].shape)
        error = np.abs(found - right[: len(found)]) / right[:1]
        worst = np.unravel_index(np.argmax(error[0]), error.shape[1:])
        axes = skies.ALBEDOS, skies.SUN_COSINES, skies.COSINES[kept], skies.AZIMUTHS_DEG, skies.DEPTHS
        names = "ground_albedo", "sun_cosine", "view_cosine", "azimuth_deg", "optical_depth"
        rows.append(
            {
                "solver": "orders",
                "preset": preset,
                "geometry": "flat",
                "polarised": polarised,
                "points": int(error[0].size),
                "max_relative_error": float(np.max(error[0])),
                "median_relative_error": float(np.median(error[0])),
                "max_error_q_u_over_i": float(np.max(error[1:])) if polarised else None,
                "max_relative_error_by_depth": {
                    str(d): float(np.max(error[0, ..., i])) for i, d in enumerate(skies.DEPTHS)
                },
                "worst": {n: float(axis[i]) for n, axis, i in zip(names, axes, worst, strict=True)},
            }
        )
        print(rows[-1], flush=True)
    return rows


def cost() -> dict:
    """Seconds of scalar and polarised skies, in turns, the fastest of each: what a shared machine leaves undisturbed.

    The flat presets; of `normal`, by geometry, the radiance, the gradient of its mean and its Jacobian, both by the
    eight `PARAMETERS`.
    """
    values, scene = jnp.asarray(list(PARAMETERS.values()), float), scene_of(SUN_ZENITH)
    air, runs = atmosphere_of(values, ozone=False), {}
    for preset, polarised in itertools.product(PRESETS, (False, True)):
        solver = getattr(skyfit.OrdersOfScattering, preset)("flat", polarised=polarised)
        program, _ = compiled(solver.radiance, air, scene)
        runs[f"{preset}, {'polarised' if polarised else 'scalar'}"] = lambda program=program: program(air, scene)
    record: dict = {"presets": {name: row["fastest"] for name, row in interleaved(runs, 40, slow=0.1).items()}}
    print(record, flush=True)
    for geometry in GEOMETRIES:
        runs = {}
        for polarised in (False, True):
            solver = skyfit.OrdersOfScattering.normal(geometry, polarised=polarised)

            def radiance(values, solver=solver):
                return solver.radiance(atmosphere_of(values), scene)

            kinds = {
                "radiance": radiance,
                "gradient": jax.grad(lambda v, radiance=radiance: jnp.mean(radiance(v))),
                "jacobian": jax.jacfwd(radiance),
            }
            for kind, function in kinds.items():
                program, _ = compiled(function, values)
                runs[kind, polarised] = lambda program=program: program(values)
        times = {key: row["fastest"] for key, row in interleaved(runs, 40).items()}
        record[geometry] = {
            kind: {
                "scalar": times[kind, False],
                "polarised": times[kind, True],
                "polarised over scalar": times[kind, True] / times[kind, False],
            }
            for kind in ("radiance", "gradient", "jacobian")
        }
        print(geometry, record[geometry], flush=True)
    return record


def made_with(dtype: str) -> dict:
    """Commit, versions and machine."""
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=HERE)
    return {
        "commit": commit.stdout.strip(),
        "dtype": dtype,
        "python": platform.python_version(),
        "machine": f"{platform.machine()}, 2 shared cores",
        **{name: importlib.metadata.version(name) for name in ("jax", "optimistix", "equinox", "numpy")},
    }


def sample() -> dict:
    """The shipped sample sky, made by sasktran2, inverted: truth, value and sigma of each parameter."""
    truth = json.loads((HERE.parent / "data" / "skies" / "sample_truth.json").read_text())["parameters"]
    # made by a polarised solver, with the haze at the height and of the polarisation that are assumed
    measurement = skyfit.NoiseModel(model_error=0.001)
    sky = skyfit.read(HERE.parent / "data" / "skies" / "sample.nc")
    fit = skyfit.invert(sky, FREE, measurement=measurement)
    parameters = {
        name: {"truth": truth[TRUTH[name]]["value"], "value": float(fit.values[0, i]), "sigma": float(fit.sigma[0, i])}
        for i, name in enumerate(FREE)
    }
    return {
        "parameters": parameters,
        "result": fit.result[0],
        "reduced_chi_square": float(fit.reduced_chi_square[0]),
        # what the README shows, with the default model error
        "printed": str(skyfit.invert(sky, FREE)),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--shared", type=pathlib.Path, default=HERE.parent.parent / "shared")
    parser.add_argument("--skip", default="", help="parts to leave as they are, with commas")
    arguments = parser.parse_args()
    skip = set(arguments.skip.split(","))
    record = json.loads(RESULT.read_text()) if RESULT.exists() else {}
    if not arguments.shared.exists():
        print(f"{arguments.shared} is absent: the oracles and the vector tables keep their last figures")
        skip |= {"oracles", "vector"}
    if "oracles" not in skip:
        record["oracles"] = oracles(arguments.shared)
    if "vector" not in skip:
        rows = vector(arguments.shared / "oracles" / "natraj2009")
        record["vector"] = {"rows": rows, "made_with": made_with("float32")}
    if "cost" not in skip:
        record["polarised_over_scalar"] = cost() | {"made_with": made_with("float32")}
    jax.config.update("jax_enable_x64", True)
    jax.clear_caches()
    if "sample" not in skip:
        record["sample"] = sample()
        print("sample", record["sample"], flush=True)
    if not {"oracles", "sample"} <= skip:
        record["made_with"] = made_with("float32 for the oracles, float64 for the fits")
    RESULT.parent.mkdir(exist_ok=True)
    RESULT.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
