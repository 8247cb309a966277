"""Scenes over everything that a scene can be: is anything not finite, negative, or another in float32?

    python -m experiments.validation.hard_cases --work FOLDER [--scenes 20000] [--gradients 1000] [--spheres 60]
        [--sphere-gradients 16]

Whole it is `--scenes 100000 --gradients 5000 --spheres 1000 --sphere-gradients 250`. Scenes are Sobol sequences over
sun, observer, views, wavelengths, air, haze, ozone and ground (`RANGES`, `scenes`), one for each program: of each
number one in fourteen lies at one end of its range, the first view looks into the sun, the second a ten-thousandth of
a radian past it, the third along the horizon. `PROGRAMS` answer them in batches, in float32 and in float64, each in a
process of its own; FOLDER keeps what was answered: a run that was cut off goes on there. Gradients are backward, by
every number of the atmosphere and of the scene, in float32, which has the narrower range.

Writes experiments/results/hard_cases.json: by program what is not finite, what is negative, and how far float32 is from
float64 of the same numbers, a share of the radiance and of the brightest view.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from skyfit.transport import AbstractSolver


RESULT = HERE / "results" / "hard_cases.json"
VIEWS, COLOURS = 8, 3
# the place of the view along the horizon
HORIZONTAL = 2
# low and high ends; those of `LOGARITHMIC` are drawn evenly in the logarithm, and their low end is none at all
RANGES = {
    "sun_zenith_deg": (0.0, 108.0), "optical_depth": (1e-5, 50.0), "asymmetry": (-0.95, 0.999), "albedo": (0.0, 1.0),
    "albedo_slope": (-0.5, 0.5), "exponent": (-1.0, 4.0), "scale_height": (50.0, 2e4), "ozone": (0.0, 1000.0),
    "pressure": (2e3, 1.2e5), "ground": (0.0, 1.0), "ground_slope": (-0.5, 0.5), "red_edge": (0.0, 0.5),
    "height": (1.0, 1e6),
}  # fmt: skip
LOGARITHMIC = ("optical_depth", "height")
SHORTEST, LONGEST = 300.0, 1100.0
# of a number, the share of scenes in which it lies at one end
AT_AN_END = 0.035
# relative: what float32 may be off
NEAR = 1e-3
# optical depth of haze beyond which little light is left
THICK = 5.0
# by program; a batch is one call of a program that is compiled once
BATCH, SPHERES = 64, 8
# compiles in two thirds of the time
FLAGS = "--xla_cpu_use_fusion_emitters=false"


class Program(NamedTuple):
    """A solver, where its observer stands, and whether it is one of the few that solve a whole sphere."""

    solver: AbstractSolver
    aloft: bool = False
    sphere: bool = False


PROGRAMS = {
    "orders flat": Program(skyfit.OrdersOfScattering.draft("flat")),
    "orders flat polarised": Program(skyfit.OrdersOfScattering.draft("flat", polarised=True)),
    "orders spherical": Program(skyfit.OrdersOfScattering.draft("spherical")),
    "orders spherical polarised": Program(skyfit.OrdersOfScattering.draft("spherical", polarised=True)),
    "orders flat aloft": Program(skyfit.OrdersOfScattering.draft("flat"), aloft=True),
    "orders flat aloft polarised": Program(skyfit.OrdersOfScattering.draft("flat", polarised=True), aloft=True),
    "single flat aloft": Program(skyfit.SingleScattering.draft("flat"), aloft=True),
    "single spherical aloft": Program(skyfit.SingleScattering.draft("spherical"), aloft=True),
    "sphere": Program(skyfit.Spherical.draft(), sphere=True),
    "sphere aloft": Program(skyfit.Spherical.draft(), aloft=True, sphere=True),
}


class Scenes(NamedTuple):
    """Parameters in the order of `RANGES`, `[scene, parameter]`; zenith and azimuth of views, rad; wavelengths, nm."""

    values: np.ndarray
    zenith: np.ndarray
    azimuth: np.ndarray
    wavelength: np.ndarray


def scenes(count: int, seed: int) -> Scenes:
    """The scenes of a seed, in numbers that float32 holds; more of them begin with the same."""
    numbers = len(RANGES)
    drawn = qmc.Sobol(numbers + 2 * VIEWS + COLOURS, seed=seed).random_base2((count - 1).bit_length())[:count]
    low, high = np.array(list(RANGES.values())).T
    share = np.clip((drawn - AT_AN_END) / (1.0 - 2.0 * AT_AN_END), 0.0, 1.0)
    values = low + share[:, :numbers] * (high - low)
    for i, name in enumerate(RANGES):
        if name in LOGARITHMIC:
            values[:, i] = np.where(share[:, i] > 0.0, low[i] * (high[i] / low[i]) ** share[:, i], 0.0)
    zenith = np.arccos(1.0 - 2.0 * share[:, numbers : numbers + VIEWS])
    azimuth = 2.0 * np.pi * share[:, numbers + VIEWS : numbers + 2 * VIEWS]
    sun = np.radians(values[:, 0])
    zenith[:, 0], zenith[:, 1], zenith[:, HORIZONTAL] = sun, np.abs(sun - 1e-4), 0.5 * np.pi
    azimuth[:, :2] = 0.0
    colour = SHORTEST * (LONGEST / SHORTEST) ** ((np.arange(COLOURS) + share[:, -COLOURS:]) / COLOURS)
    # float32 of pi is above it
    zenith = np.minimum(zenith.astype(np.float32), np.float32(3.1415925))
    return Scenes(*(np.asarray(part, np.float32) for part in (values, zenith, azimuth, colour)))


def sky(values, zenith, azimuth, wavelength, aloft: bool) -> tuple[skyfit.Atmosphere, skyfit.Scene]:
    """The atmosphere and the scene of one row; values may be traced."""
    sun, depth, asymmetry, albedo, slope, exponent, thick, ozone, pressure, ground, ground_slope, edge, height = values
    haze = skyfit.Aerosol(depth, exponent, albedo, slope, skyfit.HenyeyGreenstein(asymmetry), skyfit.Exponential(thick))
    below = skyfit.Ground(ground, ground_slope, edge)
    air = skyfit.Atmosphere(skyfit.Rayleigh(pressure), haze, skyfit.Ozone(ozone), below)
    view = skyfit.Directions(zenith, azimuth)
    return air, skyfit.Scene(jnp.radians(sun), 0.0, view, wavelength, jnp.ones(COLOURS), height if aloft else None)


def light_of(program: Program):
    """Radiances of a batch of rows."""

    def light(*row):
        return program.solver.radiance(*sky(*row, program.aloft))

    return jax.jit(jax.vmap(light), compiler_options={"xla_backend_optimization_level": 1})


def slopes_of(program: Program):
    """Of a batch of rows, whether each leaf of atmosphere and scene has a finite gradient, `[scene, leaf]`."""

    def finite(*row):
        slopes = jax.grad(lambda pair: program.solver.radiance(*pair).sum())(sky(*row, program.aloft))
        return jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(slopes)])

    # compilation is most of the time
    return jax.jit(jax.vmap(finite), compiler_options={"xla_backend_optimization_level": 0})


def places(name: str, dtype: str, count: int, batch: int, folder: Path) -> list[tuple[Path, slice]]:
    """The file of each batch of a program's scenes, and which of them it holds."""
    stem = f"{name.replace(' ', '_')}-{dtype}"
    parts = [slice(first, min(first + batch, count)) for first in range(0, count, batch)]
    return [(folder / f"{stem}-{part.start:06d}-{part.stop:06d}.npy", part) for part in parts]


def answered(name: str, run, drawn: Scenes, count: int, batch: int, folder: Path) -> None:
    """Each batch that is not there yet is computed and kept."""
    start, made, dtype = time.perf_counter(), 0, str(jnp.result_type(float))
    for path, part in places(name, dtype, count, batch, folder):
        if not path.exists():
            # the last batch begins anew, so that one program serves all
            some = np.resize(np.arange(part.start, part.stop), batch)
            found = np.asarray(run(*(jnp.asarray(each[some], float) for each in drawn)))[: part.stop - part.start]
            begun = path.with_suffix(".part.npy")
            np.save(begun, found)
            begun.rename(path)
            made += len(found)
    print(f"{dtype} {name}: {made} scenes, {time.perf_counter() - start:.0f} s", flush=True)


def kept(name: str, dtype: str, count: int, batch: int, folder: Path) -> np.ndarray | None:
    """What was answered so far, None where nothing was."""
    parts = [np.load(path) for path, _ in places(name, dtype, count, batch, folder) if path.exists()]
    return np.concatenate(parts) if parts else None


class Share(NamedTuple):
    """A program, its scenes, of how many of them it makes gradients, and how many are one batch."""

    name: str
    program: Program
    drawn: Scenes
    slopes: int
    batch: int


def shared_out(options: argparse.Namespace) -> list[Share]:
    """What each program has to do."""
    found = []
    for sphere in (False, True):
        names = [name for name, program in PROGRAMS.items() if program.sphere == sphere]
        count, slopes = options.scenes, options.gradients
        if sphere:
            count, slopes = options.spheres, options.sphere_gradients
        for name in names:
            drawn = scenes(-(-count // len(names)), options.seed + list(PROGRAMS).index(name))
            found.append(Share(name, PROGRAMS[name], drawn, -(-slopes // len(names)), SPHERES if sphere else BATCH))
    return found


def worker(options: argparse.Namespace) -> None:
    """What one process has to do: all radiances in one dtype, or all gradients."""
    jax.config.update("jax_enable_x64", options.part == "float64")
    for name, program, drawn, few, batch in shared_out(options):
        if options.part == "slopes":
            answered(f"{name} slopes", slopes_of(program), drawn, few, batch // 4, options.work)
        else:
            answered(name, light_of(program), drawn, len(drawn.values), batch, options.work)


def names_of_leaves(program: Program) -> list[str]:
    drawn = scenes(2, 0)
    pair = sky(*(jnp.asarray(part[0], float) for part in drawn), program.aloft)
    return [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(pair)]


def told(drawn: Scenes, row: int, program: Program) -> dict:
    """What a scene is, to be made again."""
    numbers = dict(zip(RANGES, drawn.values[row].tolist(), strict=True))
    if not program.aloft:
        del numbers["height"]
    return {"scene": int(row)} | numbers | {
        "view_zenith": drawn.zenith[row].tolist(), "view_azimuth": drawn.azimuth[row].tolist(),
        "wavelength_nm": drawn.wavelength[row].tolist(),
    }  # fmt: skip


def judged(share: Share, folder: Path) -> dict:
    """What is wrong with the answers of a program."""
    name, program, drawn, few, batch = share
    count, leaves = len(drawn.values), np.array(names_of_leaves(program))
    light = {}
    for dtype in ("float32", "float64"):
        light[dtype] = kept(name, dtype, count, batch, folder)
        if light[dtype] is None or len(light[dtype]) < count:
            raise ValueError(f"`--work`: {folder} holds fewer radiances by {name} in {dtype} than were asked for")
    finite = kept(f"{name} slopes", "float32", few, batch // 4, folder)
    found: dict = {"scenes": count, "scenes with gradients": 0 if finite is None else len(finite)}
    for dtype, values in light.items():
        bad = {"not finite": (~np.isfinite(values)).any(axis=(1, 2)), "negative": (values < 0.0).any(axis=(1, 2))}
        if dtype == "float32" and finite is not None:
            bad["gradients not finite"] = (~finite).any(axis=1)
            if not finite.all():
                found["leaves whose gradients are not finite"] = leaves[(~finite).any(axis=0)].tolist()
        found[dtype] = {what: int(some.sum()) for what, some in bad.items()}
        found[dtype] |= {f"first {what}": told(drawn, int(np.argmax(s)), program) for what, s in bad.items() if s.any()}
    return found | compared(light["float32"].astype(float), light["float64"], drawn, program)


def compared(low: np.ndarray, high: np.ndarray, drawn: Scenes, program: Program) -> dict:
    """How far float32 is from float64, by what may make it so."""
    bright = np.maximum(high.max(axis=1, keepdims=True), 1e-30)
    # a radiance below what float32 holds is none
    share, level = np.abs(low - high) / np.maximum(high, 1e-30), np.abs(low - high) / bright
    values = dict(zip(RANGES, drawn.values.T[:, :, None], strict=True))
    thick = values["optical_depth"] * (drawn.wavelength / 550.0) ** -values["exponent"] > THICK
    other = np.delete(share, HORIZONTAL, axis=1)
    causes = {
        "the horizontal view alone": ~(other > NEAR).any(axis=1),
        f"haze of optical depth above {THICK:g}": thick,
        "sun below 85 degrees": np.broadcast_to(values["sun_zenith_deg"] > 85.0, thick.shape),
        "haze scatters backward, asymmetry below -0.5": np.broadcast_to(values["asymmetry"] < -0.5, thick.shape),
        "forward peak, asymmetry above 0.9": np.broadcast_to(values["asymmetry"] > 0.9, thick.shape),
    }
    far = (share > NEAR).any(axis=1)
    found: dict = {"spectra": int(far.size), "float32 farther than 1e-3": int(far.sum())}
    for cause, here in causes.items():
        found[f"of them, {cause}"] = int((far & here).sum())
        far = far & ~here
    found["of them, none of these"] = int(far.sum())
    found |= {
        "float32 farther than 1e-3 of the brightest view": int((level > NEAR).any(axis=1).sum()),
        "largest difference": float(share.max()),
        "largest difference, share of the brightest view": float(level.max()),
        "median of the largest difference": float(np.median(share.max(axis=1))),
    }
    if far.any():
        worst = np.where(far, share.max(axis=1), 0.0).max(axis=1)
        found["farthest of these"] = told(drawn, int(np.argmax(worst)), program)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--work", type=Path, required=True, help="folder that keeps what was answered")
    parser.add_argument("--scenes", type=int, default=20000)
    parser.add_argument("--gradients", type=int, default=1000)
    parser.add_argument("--spheres", type=int, default=60)
    parser.add_argument("--sphere-gradients", type=int, default=16)
    parser.add_argument("--seed", type=int, default=68)
    parser.add_argument("--judge-only", action="store_true", help="what was answered so far; all radiances are needed")
    parser.add_argument("--part", choices=("float32", "float64", "slopes"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    if options.part is not None:
        worker(options)
        return
    again = [sys.executable, "-m", "experiments.validation.hard_cases", *sys.argv[1:], "--part"]
    for part in () if options.judge_only else ("float32", "float64", "slopes"):
        subprocess.run([*again, part], check=True, env=os.environ | {"XLA_FLAGS": FLAGS})
    jax.config.update("jax_enable_x64", True)
    record = {
        "made with": made_with(options.seed),
        "asked for": {
            name: value
            for name, value in vars(options).items()
            if name in ("scenes", "gradients", "spheres", "sphere_gradients")
        },
        "programs": {share.name: judged(share, options.work) for share in shared_out(options)},
    }
    RESULT.write_text(json.dumps(record, indent=1) + "\n")
    print(json.dumps(record, indent=1))


if __name__ == "__main__":
    main()
