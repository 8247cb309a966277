"""How time and memory grow with the size of a question, each axis in a process of its own.

    python -m experiments.benchmarks.scaling [--only directions,spectrum,...] [--out FILE.json]

Axes: directions of `OrdersOfScattering.normal` and of `upsample` over it; wavelengths; skies of `fit_many`;
parameters of a forward-mode Jacobian (radius bins of a `BinnedAerosol`); times in a joint fit; devices that XLA is
made to see on one CPU. float32, after compilation, the faster of two calls. `exponent` is the slope of the logarithm
of the time between the two largest sizes; `memory_GiB` is the largest resident size of the process so far, of which
`start_GiB` was there before the first call. Writes experiments/results/scaling.json after each axis.
"""

import argparse
import json
import math
import os
import pathlib
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from skyfit.atmosphere import BIN_RADII
from skyfit.light import extraterrestrial_irradiance
from skyfit.measured import NoiseModel
from skyfit.retrieve import start_model, with_values


RESULT = HERE / "results" / "scaling.json"
EXACT = NoiseModel(model_error=0.0, calibration=0.0)
FREE = ("aerosol_optical_depth", "angstrom_exponent", "asymmetry")
FEW_NM = np.array([440.0, 550.0, 675.0, 870.0])
ONCE = skyfit.SingleScattering.draft("flat")
DEVICES = (1, 2, 4)
# s: what takes longer is not timed a third time, nor a second
LONG, LONGEST = 5.0, 60.0


def scene_of(directions: int, wavelength_nm) -> skyfit.Scene:
    return skyfit.Scene.from_degrees(50.0, skyfit.hemisphere(directions, np.radians(85.0)), wavelength_nm)


def directions() -> Iterator[tuple[int, Callable]]:
    solver, air = skyfit.OrdersOfScattering.normal(), skyfit.Atmosphere.from_optical_depth(0.2)
    run = jax.jit(solver.radiance)
    for count in (10, 100, 1000, 10_000, 100_000, 1_000_000):
        scene = scene_of(count, FEW_NM)
        yield count, lambda scene=scene: run(air, scene)


def upsampled() -> Iterator[tuple[int, Callable]]:
    solver, air = skyfit.OrdersOfScattering.normal(), skyfit.Atmosphere.from_optical_depth(0.2)
    for count in (1000, 10_000, 100_000, 1_000_000):
        scene = scene_of(count, FEW_NM)
        yield count, lambda scene=scene: skyfit.upsample(solver, air, scene).radiance


def spectrum() -> Iterator[tuple[int, Callable]]:
    solver, air = skyfit.OrdersOfScattering.normal(), skyfit.Atmosphere.from_optical_depth(0.2)
    run = jax.jit(solver.radiance)
    for count in (1, 4, 16, 41, 118, 471):
        scene = scene_of(100, np.linspace(360.0, 830.0, count) if count > 1 else np.array([550.0]))
        yield count, lambda scene=scene: run(air, scene)


def series(times: int) -> skyfit.Sky:
    """Skies of single scattering with 1 % noise, of a haze that all have in common."""
    random, view = np.random.default_rng(0), skyfit.hemisphere(20, np.radians(80.0))
    sun = np.radians(random.uniform(20.0, 70.0, times))
    air = with_values(start_model(FREE, 101325.0), FREE, (0.2, 1.2, 0.68)).atmosphere
    light = np.asarray(extraterrestrial_irradiance(FEW_NM, 6.0), float)

    def one(zenith):
        return ONCE.radiance(air, skyfit.Scene(zenith, 0.0, view, FEW_NM, light))

    clean = np.asarray(jax.jit(lambda suns: jax.lax.map(one, suns))(jnp.asarray(sun)), float)
    sigma = 0.01 * clean
    return skyfit.Sky(
        radiance=clean + sigma * random.standard_normal(clean.shape), sigma=sigma, usable=np.ones(clean.shape, bool),
        view_zenith=np.asarray(view.zenith, float), view_azimuth=np.asarray(view.azimuth, float),
        wavelength_nm=FEW_NM, sun_zenith=sun, sun_azimuth=np.zeros(times),
        time=np.datetime64("2026-06-01T06:00") + np.arange(times) * np.timedelta64(3, "m"), pressure_pa=101325.0,
        fwhm_nm=6.0,
    )  # fmt: skip


def skies() -> Iterator[tuple[int, Callable]]:
    whole = series(10_000)
    for count in (100, 1000, 10_000):
        part = whole.at_times(range(count))
        yield count, lambda part=part: skyfit.fit_many(part, FREE, ONCE, measurement=EXACT, draft=ONCE).cost


def parameters() -> Iterator[tuple[int, Callable]]:
    solver, scene = skyfit.OrdersOfScattering.normal(), scene_of(100, FEW_NM)
    haze = skyfit.BinnedAerosol.like(skyfit.TwoModeAerosol(0.2))
    air = skyfit.Atmosphere(skyfit.Rayleigh(), haze)

    def sky(some, air):
        bins = air.aerosol.bins.at[: some.size].set(some)
        return solver.radiance(eqx.tree_at(lambda a: a.aerosol.bins, air, bins), scene)

    run = jax.jit(jax.jacfwd(sky))
    for count in (1, 2, 4, 8, 16, BIN_RADII.size):
        some = haze.bins[:count]
        yield count, lambda some=some: run(some, air)


def joint() -> Iterator[tuple[int, Callable]]:
    whole = series(200)
    for count in (1, 5, 20, 50, 100, 200):
        part = whole.at_times(range(count))
        shared = FREE[1:] if count > 1 else ()
        yield (
            count,
            lambda part=part, shared=shared: (
                skyfit.invert(part, FREE, ONCE, measurement=EXACT, draft=ONCE, shared=shared).cost
            ),
        )


def devices() -> Iterator[tuple[int, Callable]]:
    part = series(512)
    yield len(jax.devices()), lambda: skyfit.fit_many(part, FREE, ONCE, measurement=EXACT, draft=ONCE).cost


AXES = {
    "directions": directions, "directions upsampled": upsampled, "wavelengths": spectrum, "skies": skies,
    "parameters": parameters, "times in a joint fit": joint,
}  # fmt: skip


def memory() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def measured(cases) -> list[dict]:
    """Seconds of the first call, compilation in it, and of the faster of two more; GiB of the process."""
    rows, before = [], round(memory(), 3)
    for size, call in cases:
        took = []
        try:
            for _ in range(3):
                begin = time.perf_counter()
                jax.block_until_ready(call())
                took.append(time.perf_counter() - begin)
                if took[-1] > (LONGEST if len(took) == 1 else LONG):
                    break
        except Exception as failure:
            rows.append({"size": size, "failure": type(failure).__name__, "memory_GiB": round(memory(), 3)})
            print(rows[-1], flush=True)
            break
        row = {"size": size, "first_s": took[0], "seconds": min(took[1:] or took), "warm": len(took) > 1}
        rows.append(row | {"memory_GiB": round(memory(), 3), "start_GiB": before})
        print(rows[-1], flush=True)
    return rows


def exponent(rows: list[dict]) -> float | None:
    """The slope of the logarithms between the two largest sizes that were reached."""
    good = [row for row in rows if "seconds" in row][-2:]
    if len(good) < 2 or good[0]["size"] == good[1]["size"]:
        return None
    rise = math.log(good[1]["seconds"] / good[0]["seconds"])
    return round(rise / math.log(good[1]["size"] / good[0]["size"]), 2)


def child(axis: str, environment: dict[str, str]) -> list[dict]:
    """The rows of an axis in a process of its own."""
    place = os.pathsep.join([str(HERE.parent), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-m", "experiments.benchmarks.scaling", "--child", axis]
    done = subprocess.run(
        command, env=os.environ | {"PYTHONPATH": place} | environment, capture_output=True, text=True, cwd=HERE.parent
    )
    print(done.stdout, done.stderr[-2000:], flush=True)
    lines = [line for line in done.stdout.splitlines() if line.startswith("[")]
    return json.loads(lines[-1]) if lines else [{"failure": f"the process ended with {done.returncode}"}]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default=",".join([*AXES, "devices"]))
    parser.add_argument("--out", type=pathlib.Path, default=RESULT)
    parser.add_argument("--child", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        rows = measured((AXES | {"devices": devices})[given.child]())
        print(json.dumps(rows))
        return
    record = json.loads(given.out.read_text()) if given.out.exists() else {"axes": {}}
    for axis in given.only.split(","):
        print(axis, flush=True)
        if axis == "devices":
            rows = []
            for count in DEVICES:
                flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={count}"
                rows += child(axis, {"XLA_FLAGS": flags.strip()})
        else:
            rows = child(axis, {})
        record["axes"][axis] = {"rows": rows, "exponent": exponent(rows)} | {"commit": made_with(0)["commit"]}
        record |= {"cores": os.cpu_count(), "load": [round(v, 1) for v in os.getloadavg()], **made_with(0)}
        given.out.write_text(json.dumps(record, indent=1) + "\n")
        print(axis, "exponent", record["axes"][axis]["exponent"], flush=True)


if __name__ == "__main__":
    main()
