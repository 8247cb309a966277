"""Every solver against lines of sight from the ground to space, from noon to deep twilight.

    python -m experiments.validation.space FILE [--solver bruneton,single,...] [--out experiments/results/space.json]

FILE has the layout of the shared oracle_space.npz: flat lists `case`, `height_m`, `sza`, `vza`, `raz`, `radiance`,
`sigma`, `tangent_height_m`, one entry a line of sight, and `cases` with `case_fields`; exponential air and haze of 8
and 1.2 km, ozone a Gaussian layer about 22 km, per unit irradiance. By range of the sun: the median and worst relative
error, the shares within the tolerance and within 0.3 %, plus 3 sigma each, the rms of z by sigma plus 0.1 %; what a
solver refuses or flags is counted, not judged. Seconds are those of a second run; they are of this machine under
whatever else it did.

A solver that is prepared once answers all lines of a case from one field.
"""

import argparse
import json
import pathlib
import statistics
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from skyfit.atmosphere import Exponential, Ground, HenyeyGreenstein, Levels, Prescribed, RayleighPhase


RESULT = HERE / "results" / "space.json"
WAVELENGTH = np.array([550.0])
# m: scale heights of air and haze; centre and width of the ozone, and where the oracle's air ends
AIR_HEIGHT, HAZE_HEIGHT, OZONE_HEIGHT, OZONE_WIDTH, LID = 8e3, 1.2e3, 22e3, 5e3, 100e3
EARTH_RADIUS, SPACE = 6371e3, 400e3
# the darkest sky that is judged, and what is added to sigma, relative
DARKEST, SYSTEMATIC = 1e-9, 1e-3
# largest sun zenith angle, relative tolerance
RANGES = {"sun <= 89": (89.0, 0.007), "sun 89-96": (96.0, 0.015), "sun 96-108": (108.0, 0.04)}
# directions at once: one program serves every group of lines
TOGETHER = 16
REPEATS = 5


class Candidate(NamedTuple):
    """A solver of the table. `prepared`: it is prepared once for an atmosphere; `aloft`: it knows observers above the
    ground; `spectral`: whether eight wavelengths are prepared, too; `slow`: its seconds are those of the first run,
    with compilation in them."""

    solver: skyfit.transport.AbstractSolver
    prepared: bool = False
    aloft: bool = True
    spectral: bool = False
    slow: bool = False


SOLVERS: dict[str, Callable[[], Candidate]] = {
    "single": lambda: Candidate(skyfit.SingleScattering.normal()),
    "double": lambda: Candidate(skyfit.DoubleScattering.normal(), aloft=False),
    "orders": lambda: Candidate(skyfit.OrdersOfScattering.normal(), aloft=False),
    "spherical": lambda: Candidate(skyfit.Spherical.normal(), prepared=True, spectral=True),
    "spherical-draft": lambda: Candidate(skyfit.Spherical.draft(), prepared=True, spectral=True),
    "spherical-fine": lambda: Candidate(skyfit.Spherical.fine(), prepared=True, slow=True),
    "bruneton": lambda: Candidate(skyfit.Bruneton.normal(), prepared=True, spectral=True),
    "bruneton-draft": lambda: Candidate(skyfit.Bruneton.draft(), prepared=True, spectral=True),
    "bruneton-rescaled-8-orders": lambda: Candidate(skyfit.Bruneton(orders=8, rescaled=True), prepared=True),
    "bruneton-fine": lambda: Candidate(skyfit.Bruneton.fine(), prepared=True, slow=True),
}


def atmosphere_of(case: dict[str, float]) -> skyfit.Atmosphere:
    """The oracle's atmosphere; what has no optical depth is left out."""
    # renormalised under the lid, so that the column is what is stated
    share = 1.0 - np.exp(-LID / AIR_HEIGHT)
    air = Prescribed([case["tau_rayleigh"] / share], Exponential(AIR_HEIGHT), RayleighPhase(0.0))
    haze, ozone = None, None
    if case["aod"]:
        phase = HenyeyGreenstein(case["g"])
        haze = Prescribed([case["aod"]], Exponential(HAZE_HEIGHT), phase, case["ssa_aerosol"])
    if case["ozone_tau"]:
        height = np.linspace(0.0, 60e3, 61)
        density = np.exp(-0.5 * ((height - OZONE_HEIGHT) / OZONE_WIDTH) ** 2)
        ozone = Prescribed([case["ozone_tau"]], Levels(height, np.maximum(density, 1e-12)))
    return skyfit.Atmosphere(air, haze, ozone, Ground(case["albedo"]))


def scene_of(height: float, sun: float, zenith, azimuth, wavelength=WAVELENGTH) -> skyfit.Scene:
    view = skyfit.Directions.from_degrees(zenith, azimuth)
    on_ground = None if height == 0.0 else height
    return skyfit.Scene.from_degrees(sun, view, wavelength, irradiance="unit", height=on_ground)


def sun_at_tangent(data) -> np.ndarray:
    """Zenith angle (degrees) of the sun at the point of each line nearest to the Earth's centre, or the observer's."""
    sun, view, turn = (np.radians(data[name]) for name in ("sza", "vza", "raz"))
    radius = EARTH_RADIUS + data["height_m"]
    along = np.maximum(-radius * np.cos(view), 0.0)
    to_sun = np.cos(view) * np.cos(sun) + np.sin(view) * np.sin(sun) * np.cos(turn)
    nearest = np.sqrt(np.maximum(radius**2 + 2.0 * radius * along * np.cos(view) + along**2, 1.0))
    cosine = (radius * np.cos(sun) + along * to_sun) / nearest
    return np.where(data["vza"] > 90.0, np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))), data["sza"])


def seconds_of(call) -> float:
    """The median of some runs after a first one."""
    jax.block_until_ready(call())
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def timed(call, slow: bool = False):
    """A result and the seconds of a second run, or of the first."""
    if not slow:
        jax.block_until_ready(jax.tree.leaves(call()))
    start = time.perf_counter()
    result = call()
    jax.block_until_ready(jax.tree.leaves(result))
    return result, time.perf_counter() - start


def answers(candidate: Candidate, data) -> tuple[np.ndarray, dict]:
    """Radiance of every line, NaN where it is refused or flagged, and what preparation and lookup cost."""
    found, solver = np.full(len(data["sza"]), np.nan), candidate.solver
    prepare, lookup, size = [], [], []
    names = [str(name) for name in data["case_fields"]]
    for number, row in enumerate(data["cases"]):
        atmosphere = atmosphere_of(dict(zip(names, map(float, row), strict=True)))
        field = None
        if candidate.prepared:
            field, spent = timed(lambda atmosphere=atmosphere: solver.prepare(atmosphere, WAVELENGTH), candidate.slow)
            prepare.append(spent)
            size.append(sum(table.nbytes for table in jax.tree.leaves(field)))

        def ask(scene, field=field, atmosphere=atmosphere):
            return solver.radiance(atmosphere, scene) if field is None else field.radiance(scene)

        sky = skyfit.hemisphere()
        scene = skyfit.Scene.from_degrees(60.0, sky, WAVELENGTH, irradiance="unit")
        lookup.append(seconds_of(lambda ask=ask, scene=scene: ask(scene)))
        lines = np.flatnonzero(data["case"] == number)
        for height, sun in sorted({(data["height_m"][i], data["sza"][i]) for i in lines}):
            group = lines[(data["height_m"][lines] == height) & (data["sza"][lines] == sun)]
            if sun > solver.suns.largest_deg or (height > 0.0 and not candidate.aloft):
                continue
            for part in np.array_split(group, -(-len(group) // TOGETHER)):
                padded = np.pad(part, (0, TOGETHER - len(part)), "edge")
                scene = scene_of(height, sun, data["vza"][padded], data["raz"][padded])
                values = np.asarray(ask(scene), float)[:, 0]
                if isinstance(field, skyfit.transport.BrunetonField):
                    values = np.where(np.asarray(field.known(scene)), values, np.nan)
                found[part] = values[: len(part)]
    cost = {"lookup of 343 directions, s": statistics.median(lookup)}
    if candidate.prepared:
        how = "prepare 1 wavelength with compilation, s" if candidate.slow else "prepare 1 wavelength, s"
        cost |= {how: statistics.median(prepare), "field, bytes": max(size)}
    if candidate.spectral:
        hazy, spectrum = skyfit.Atmosphere.from_optical_depth(0.1), np.linspace(400.0, 700.0, 8)
        field, spent = timed(lambda: solver.prepare(hazy, spectrum))
        cost |= {"prepare 8 wavelengths, s": spent, "field of 8 wavelengths, bytes": field.nbytes}
    return found, cost


def judged(found, data, chosen, tolerance) -> dict:
    """One range of one solver."""
    value, truth, sigma = found[chosen], data["radiance"][chosen], data["sigma"][chosen]
    answered = np.isfinite(value)
    row = {"lines": int(chosen.sum()), "refused": int((~answered).sum())}
    if not answered.any():
        return row
    value, truth, sigma, limit = (v[answered] for v in (value, truth, sigma, tolerance[chosen]))
    error = np.abs(value / truth - 1.0)
    z = (value - truth) / (sigma + SYSTEMATIC * truth)
    at = np.flatnonzero(chosen)[answered][np.argmax(error)]
    return row | {
        "median": float(np.median(error)),
        "bias": float(np.median(value / truth - 1.0)),
        "worst": float(error.max()),
        "worst at": {k: float(data[k][at]) for k in ("case", "height_m", "sza", "vza", "raz")},
        "within tolerance + 3 sigma": float(np.mean(np.abs(value - truth) <= limit * truth + 3.0 * sigma)),
        "within 0.3 % + 3 sigma": float(np.mean(np.abs(value - truth) <= 0.003 * truth + 3.0 * sigma)),
        "z rms": float(np.sqrt(np.mean(z**2))),
        "negative": int(np.sum(value < 0.0)),
    }


def table(found, data) -> dict:
    """All ranges of one solver."""
    limb = (data["height_m"] >= SPACE) & (data["vza"] > 90.0) & (np.nan_to_num(data["tangent_height_m"], nan=-1.0) > 0)
    bright, tangent = data["radiance"] > DARKEST, sun_at_tangent(data)
    rows, low = {}, -1.0
    for name, (high, tolerance) in RANGES.items():
        limits = np.full(len(bright), tolerance)
        inside = (data["sza"] > low) & (data["sza"] <= high) & bright
        rows[name] = judged(found, data, inside & ~limb, limits)
        inside = (tangent > low) & (tangent <= high) & bright
        rows[f"limb from space, {name} at the tangent point"] = judged(found, data, inside & limb, limits)
        low = high
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("file", type=pathlib.Path)
    parser.add_argument("--solver", default=",".join(SOLVERS), help="names, apart by commas (default: all)")
    parser.add_argument("--out", type=pathlib.Path, default=RESULT)
    options = parser.parse_args()
    asked = options.solver.split(",")
    for name in asked:
        if name not in SOLVERS:
            parser.error(f"--solver: one of {', '.join(SOLVERS)}, got {name!r}")
    data = dict(np.load(options.file))
    record = json.loads(options.out.read_text()) if options.out.exists() else {}
    if record.get("file") != options.file.name:
        record = {"file": options.file.name, "tolerance": {k: v[1] for k, v in RANGES.items()}, "solvers": {}}
    for name in asked:
        found, cost = answers(SOLVERS[name](), data)
        # rows of other runs stay: each says what it was made with
        record["solvers"][name] = {"made with": made_with(0), "cost": cost, "ranges": table(found, data)}
        options.out.write_text(json.dumps(record, indent=1) + "\n")
        print(f"\n{name}: {cost}")
        for title, row in record["solvers"][name]["ranges"].items():
            if "median" not in row:
                print(f"  {title:48s} {row['lines']:4d} lines, all refused")
                continue
            print(
                f"  {title:48s} {row['lines']:4d} lines, {row['refused']:3d} refused, "
                f"median {100 * row['median']:7.2f} %, worst {100 * row['worst']:8.1f} %, "
                f"within {100 * row['within tolerance + 3 sigma']:5.1f} %, z rms {row['z rms']:8.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
