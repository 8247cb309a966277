"""What `Spherical` costs: preparing a field, looking it up, gradients; beside sasktran2's successive orders.

    python -m experiments.benchmarks.spherical [--repeats 5] [--only prepare,lookup,gradient,rival]

Air, haze of 0.1 and ozone, `normal`, in the precision of the process. Times are after compilation, whose own stand
beside them. Writes experiments/results/spherical.json.
"""

import argparse
import json
import time

import jax
import jax.numpy as jnp
import numpy as np

import skyfit
from experiments.benchmarks.rivals import prepare_sasktran2_orders, View
from experiments.benchmarks.tiers import HERE, interleaved, made_with, rival_optics


RESULT = HERE / "results" / "spherical.json"
NM = np.linspace(400.0, 700.0, 8)
FIELDS = {"one observer, sun 60": 60.0, "one observer, sun 90": 90.0, "one observer, sun 96": 96.0, "all": None}


def mebibytes(tree) -> float:
    return sum(leaf.nbytes for leaf in jax.tree.leaves(tree)) / 2**20


def prepared(solver, repeats: int) -> list[dict]:
    atmosphere, rows = skyfit.Atmosphere.from_optical_depth(0.1), []
    runs = {}
    for name, sun in FIELDS.items():
        zenith = None if sun is None else np.radians(sun)

        def run(zenith=zenith):
            return solver.prepare(atmosphere, NM, sun_zenith=zenith).solution

        start = time.perf_counter()
        field = solver.prepare(atmosphere, NM, sun_zenith=zenith)
        jax.block_until_ready(field.solution)
        first = time.perf_counter() - start
        runs[name] = run
        size = {"suns": field.sun_place.size, "field_MiB": mebibytes(field.solution)}
        rows.append({"field": name, "first_call_seconds": first} | size)
    for row, timed in zip(rows, interleaved(runs, repeats).values(), strict=True):
        row |= timed
    return rows


def lookups(solver, repeats: int) -> dict:
    wavelengths = np.arange(380.0, 781.0, 10.0)
    atmosphere, once = skyfit.Atmosphere.from_optical_depth(0.1), skyfit.SingleScattering.normal()
    field = solver.prepare(atmosphere, wavelengths, sun_zenith=np.radians(85.0))
    sky = skyfit.Scene.from_degrees(85.0, skyfit.hemisphere(343), wavelengths)
    whole = solver.prepare(atmosphere, NM)
    aloft = skyfit.Scene.from_degrees(85.0, skyfit.hemisphere(343), NM, height=10e3)
    rows = interleaved(
        {
            "343 x 41, ground": lambda: field.radiance(sky),
            "single scattering alone, 343 x 41, ground": lambda: once.radiance(atmosphere, sky),
            "343 x 8, from 10 km, all suns": lambda: whole.radiance(aloft),
        },
        repeats,
    )
    return rows | picture(solver, atmosphere)


def picture(solver, atmosphere) -> dict:
    """A frame of 1024 x 768 over the upper hemisphere at 8 wavelengths through `upsample`, `prepare` in it.

    Beside the field's own light of some of its pixels, above 88 degrees.
    """
    zenith, azimuth = np.meshgrid(np.linspace(0.0, 89.9, 768), np.linspace(0.0, 359.9, 1024), indexing="ij")
    frame = skyfit.Scene.from_degrees(85.0, skyfit.Directions.from_degrees(zenith, azimuth), NM)
    light = skyfit.upsample(solver, atmosphere, frame)
    some = np.random.default_rng(0).choice(np.flatnonzero(zenith.ravel() < 88.0), 2048, replace=False)
    few = skyfit.Scene.from_degrees(
        85.0, skyfit.Directions.from_degrees(zenith.ravel()[some], azimuth.ravel()[some]), NM
    )
    field = solver.prepare(atmosphere, NM, sun_zenith=few.sun_zenith)
    off = np.abs(np.asarray(light.radiance)[some] / np.asarray(field.radiance(few)) - 1.0)
    row = interleaved({"1024 x 768 x 8, ground": lambda: skyfit.upsample(solver, atmosphere, frame)}, 2)
    row["1024 x 768 x 8, ground"] |= {
        "median_difference": float(np.median(off)),
        "largest_difference": float(off.max()),
    }
    return row


def gradients(solver, repeats: int) -> dict:
    """Of a mean radiance by eight parameters, through `prepare`."""
    view = skyfit.hemisphere(40)
    scene = skyfit.Scene.from_degrees(80.0, view, NM)

    def mean(values):
        air = skyfit.Rayleigh(pressure=values[0], profile=skyfit.Exponential(values[1]))
        haze = skyfit.Aerosol(
            values[2],
            values[3],
            values[4],
            phase=skyfit.HenyeyGreenstein(values[5]),
            profile=skyfit.Exponential(1200.0),
        )
        atmosphere = skyfit.Atmosphere(
            rayleigh=air, aerosol=haze, ozone=skyfit.Ozone(values[6]), ground=skyfit.Ground(values[7])
        )
        return jnp.mean(solver.radiance(atmosphere, scene))

    start = jnp.array([1e5, 8e3, 0.1, 1.3, 0.95, 0.7, 300.0, 0.2])
    programs = {"value": mean, "reverse": jax.value_and_grad(mean), "forward, 8 parameters": jax.jacfwd(mean)}
    compiled, record = {}, {}
    for name, function in programs.items():
        begin = time.perf_counter()
        compiled[name] = jax.jit(function).lower(start).compile()
        record[name] = {"compile_seconds": time.perf_counter() - begin}
        memory = compiled[name].memory_analysis()
        record[name]["temporary_MiB"] = memory.temp_size_in_bytes / 2**20
    timed = interleaved({name: lambda p=p: p(start) for name, p in compiled.items()}, repeats)
    for name, row in timed.items():
        record[name] |= row | {"times_the_value": row["seconds"] / timed["value"]["seconds"]}
    return record


def rival(solver, repeats: int) -> dict:
    """One sky of 343 directions at 8 wavelengths, the sun at 88 degrees: same atmosphere, cut at the same height.

    What sasktran2 prepares, its rays for one sun and all views, stands apart from its solution and is timed once.
    """
    zenith, azimuth = np.linspace(0.0, 88.0, 49), np.linspace(0.0, 180.0, 7)
    atmosphere = skyfit.Atmosphere.from_optical_depth(0.1).replace(ozone=None)
    optics = rival_optics(atmosphere, NM)
    start = time.perf_counter()
    theirs = prepare_sasktran2_orders(optics, View(zenith, azimuth, 88.0), suns=15)
    geometry = time.perf_counter() - start
    views = skyfit.Directions.from_degrees(zenith[:, None], azimuth[None])
    scene = skyfit.Scene.from_degrees(88.0, views, NM, irradiance="unit")
    ours = np.asarray(solver.radiance(atmosphere, scene))
    apart = np.abs(theirs() / ours - 1.0)
    timed = interleaved(
        {"Spherical, prepare and look up": lambda: solver.radiance(atmosphere, scene), "sasktran2, 15 suns": theirs},
        repeats,
    )
    seconds, their_seconds = (row["seconds"] for row in timed.values())
    return timed | {
        "sasktran2, rays of one sun, seconds": geometry,
        "times_faster": (geometry + their_seconds) / seconds,
        "times_faster_without_their_rays": their_seconds / seconds,
        "median_difference": float(np.median(apart)),
        "largest_difference": float(apart.max()),
    }


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--repeats", type=int, default=5)
    arguments.add_argument("--only", default="prepare,lookup,gradient,rival")
    given = arguments.parse_args()
    parts = {"prepare": prepared, "lookup": lookups, "gradient": gradients, "rival": rival}
    record = json.loads(RESULT.read_text()) if RESULT.exists() else {}
    record["made_with"] = made_with(0, ("sasktran2",))
    for name in given.only.split(","):
        record[name] = parts[name](skyfit.Spherical.normal(), given.repeats)
        RESULT.write_text(json.dumps(record, indent=1) + "\n")
        print(name, json.dumps(record[name], indent=1))


if __name__ == "__main__":
    main()
