"""Does `choose` keep to its tolerance on scenes that its model of errors has not seen, and is `estimate_error` a bound?

    python -m experiments.validation.choose --work FOLDER [--scenes 256] [--seed 99]

Scenes as those of experiments/tables/make_error_model.py, by another seed; FOLDER keeps their radiances, some 1 s a
scene on one core. What a choice answers is composed of what was computed: the radiance by its streams, polarised, in
its geometry, times the ratios by which polarisation and each constituent change that of 8 streams. Truth is
`OrdersOfScattering.fine("spherical", polarised=True)`; scenes that are given to `fine` itself or to `Spherical` are
counted, not judged. Writes experiments/results/choose.json: by tolerance the share of scenes whose largest error is
within it, how often no solver was found, the time of the choice over that of the cheapest solver that would have done
(both by `skyfit.transport.work`), and what `estimate_error` makes of each program. The first scenes go into
data/choose_scenes.npz with their radiance.
"""

import argparse
import json
import statistics
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from experiments.tables.make_error_model import measured, scenes, sky
from skyfit.transport.choose import candidates_of, RUNGS
from skyfit.transport.estimate import bound_of, picked
from skyfit.transport.work import seconds


RESULT = HERE / "results" / "choose.json"
# scenes that are shipped with their radiance, for tests
SHIPPED, SHIPPED_SCENES = HERE.parent / "data" / "choose_scenes.npz", 16
TOLERANCES = (0.1, 0.03, 0.01, 0.003)
LEFT_OUT = {"ozone": "no ozone", "aerosol": "no haze"}
# programs that are estimated, and the program of the refined solver
ESTIMATED = {
    **dict.fromkeys(("6 flat", "8 flat", "12 flat", "6 spherical", "8 spherical", "12 spherical"), "16 spherical"),
    **dict.fromkeys(("8 spherical scalar", "single", "double"), "16 spherical"),
    "16 spherical": "truth",
}


def program_of(solver) -> str | None:
    """The program that has the solver's radiance but for polarisation; None where none has."""
    if isinstance(solver, skyfit.SingleScattering):
        return "single"
    if isinstance(solver, skyfit.DoubleScattering):
        return "double"
    if not isinstance(solver, skyfit.OrdersOfScattering):
        return None
    numbers = (solver.streams, solver.modes, solver.levels, solver.orders, solver.nodes)
    names = [name for name, known in RUNGS.items() if known == numbers]
    return f"{names[0].removesuffix(' streams')} {solver.geometry}" if names else "truth"


def answered(solver, left: set[str], found: dict[str, np.ndarray], i: int) -> np.ndarray | None:
    """The radiance of a solver without some constituents in scene i, composed."""
    program = program_of(solver)
    if program is None or (program in ("single", "double") and solver.geometry == "flat"):
        return None
    light, eight = found[program][i], found["8 spherical"][i]
    if isinstance(solver, skyfit.OrdersOfScattering) and not solver.polarised:
        light = light * found["8 spherical scalar"][i] / eight
    for name in left:
        light = light * found[LEFT_OUT[name]][i] / eight
    return light


def largest(light: np.ndarray, truth: np.ndarray) -> float:
    return float(np.abs(light / truth - 1.0).max())


def judged(tolerance: float, skies, found: dict[str, np.ndarray]) -> dict:
    """What became of all scenes under one tolerance."""
    rows, took = [], []
    for i, (air, scene) in enumerate(skies):
        start = time.perf_counter()
        choice = skyfit.choose(air, scene, tolerance)
        took.append(time.perf_counter() - start)
        gone = set(air.names) - set(choice.atmosphere.names)
        light = None if "rayleigh" in gone else answered(choice.solver, gone, found, i)
        row = {"met": choice.met, "known": choice.known, "kind": type(choice.solver).__name__}
        row["kind"] += f" {program_of(choice.solver) or ''}"
        row["left out"] = sorted(gone)
        row["error"] = None if light is None else largest(light, found["truth"][i])
        row["expected"] = choice.expected_error
        if choice.met and row["error"] is not None:
            done = []
            for solver in candidates_of(air, scene):
                other = answered(solver, set(), found, i)
                if other is not None and largest(other, found["truth"][i]) <= tolerance:
                    done.append(seconds(solver, air, scene))
            if done:
                row["time over the best"] = seconds(choice.solver, air, scene) / min(done)
        rows.append(row)
    sure = [row for row in rows if row["met"] and row["error"] is not None and "truth" not in row["kind"]]
    over = [row["time over the best"] for row in rows if "time over the best" in row]
    kinds = [row["kind"].strip() for row in rows]
    return {
        "scenes": len(rows),
        "no solver found": sum(not row["met"] for row in rows),
        "judged": len(sure),
        "within the tolerance": float(np.mean([row["error"] <= tolerance for row in sure])) if sure else None,
        "largest error over the tolerance": max((row["error"] / tolerance for row in sure), default=None),
        "median of expected over true error": float(np.median([r["expected"] / r["error"] for r in sure]))
        if sure
        else 0,
        "time within 1.5 x the best": float(np.mean([ratio <= 1.5 for ratio in over])) if over else None,
        "median time over the best": statistics.median(over) if over else None,
        "chosen": {kind: kinds.count(kind) for kind in sorted(set(kinds))},
        "left out": {name: sum(name in row["left out"] for row in rows) for name in LEFT_OUT},
        "milliseconds of choose, median (shared machine)": 1e3 * statistics.median(took),
    }


def estimates(skies, found: dict[str, np.ndarray]) -> dict:
    """Of each program: how often the bound of `estimate_error` holds, and how far above the true error it is."""
    rows, every = {}, []
    for program, refined in ESTIMATED.items():
        ratios = []
        for i, (air, scene) in enumerate(skies):
            views, colours = picked(air, scene, 8, 3)
            here = np.ix_(views, colours)
            bound, _ = bound_of(found[program][i][here], found[refined][i][here])
            ratios.append(bound / largest(found[program][i], found["truth"][i]))
        rows[program] = {"covered": float(np.mean(np.array(ratios) >= 1.0)), "median ratio": float(np.median(ratios))}
        every += ratios
    rows["all"] = {"covered": float(np.mean(np.array(every) >= 1.0)), "median ratio": float(np.median(every))}
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--work", type=Path, required=True, help="folder that keeps the radiances")
    parser.add_argument("--scenes", type=int, default=256, help="a multiple of 32")
    parser.add_argument("--seed", type=int, default=99)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    found = measured(options.work, options.scenes, options.seed, spectra=False)
    drawn = scenes(options.scenes, options.seed)
    shipped = {name: part[:SHIPPED_SCENES] for name, part in drawn._asdict().items()}
    np.savez_compressed(SHIPPED, **shipped, radiance=found["truth"][:SHIPPED_SCENES])
    skies = [sky(*(jnp.asarray(part[i]) for part in drawn)) for i in range(options.scenes)]
    record = {
        "made with": made_with(options.seed),
        "tolerances": {f"{100 * tolerance:g} %": judged(tolerance, skies, found) for tolerance in TOLERANCES},
        "estimate_error": estimates(skies, found),
    }
    RESULT.write_text(json.dumps(record, indent=1) + "\n")
    print(json.dumps(record, indent=1))


if __name__ == "__main__":
    main()
