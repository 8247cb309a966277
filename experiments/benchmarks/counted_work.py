"""The least time that a sky takes by its counted work, and how much more it takes, measured.

    python -m experiments.benchmarks.counted_work [--repeats 15]

Measures each solver that `skyfit.choose` chooses from, in float32, 343 directions and 41 wavelengths, in turns; the
fastest turn counts, so that other work on the machine matters little. Writes experiments/results/counted_work.json:
`skyfit.transport.work` takes its ratios from there.
"""

import argparse
import json

import jax
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, interleaved, made_with
from skyfit import Atmosphere, Scene
from skyfit.transport.choose import RUNGS, streams_of
from skyfit.transport.work import BATCHED_FLOPS, counted, EXPONENTIALS, LARGE_FLOPS


RESULT = HERE / "results" / "counted_work.json"


def floor(solver, atmosphere: Atmosphere, scene: Scene) -> dict:
    """The counted work as a record: by part, and the least seconds altogether."""
    parts = counted(solver, atmosphere, scene)
    record = {
        name: {
            "multiply_adds": part.multiply_adds,
            "exponentials": part.exponentials,
            "seconds": part.seconds()[0],
            "seconds_slow_rate": part.seconds()[1],
        }
        for name, part in parts.items()
    }
    return {
        "parts": record,
        "seconds": sum(part["seconds"] for part in record.values()),
        "seconds_slow_rate": sum(part["seconds_slow_rate"] for part in record.values()),
        "rates": {
            "exponentials_per_second": EXPONENTIALS,
            "flops_small_batches": BATCHED_FLOPS,
            "flops_large": LARGE_FLOPS,
        },
    }


def solvers() -> dict:
    """Those whose work is counted, by what they are called."""
    return {
        "single": skyfit.SingleScattering.normal(),
        "double": skyfit.DoubleScattering.normal(),
        **{f"orders {name}": streams_of(name, "spherical", False) for name in RUNGS},
        "orders 8 streams flat": streams_of("8 streams", "flat", False),
        "orders 8 streams polarised": streams_of("8 streams", "spherical", True),
        "orders 8 streams, every wavelength": streams_of("8 streams", "spherical", False, 0),
        "orders fine polarised": skyfit.OrdersOfScattering.fine(polarised=True),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--repeats", type=int, default=15)
    options = parser.parse_args()
    air = Atmosphere.from_turbidity(3.0)
    scene = Scene.from_degrees(60.0, skyfit.hemisphere(343), np.arange(380.0, 781.0, 10.0))
    known = solvers()
    runs = {}
    for name, solver in known.items():
        # with wavelengths that are known, of which few are solved
        runs[name] = lambda solver=solver: jax.block_until_ready(solver.radiance(air, scene))
    rows = interleaved(runs, options.repeats, slow=0.2)
    for name, solver in known.items():
        least = floor(solver, air, scene)["seconds"]
        rows[name] |= {"counted": least, "measured_over_counted": rows[name]["fastest"] / least}
        print(f"{name}: {1e3 * rows[name]['fastest']:.2f} ms, {rows[name]['measured_over_counted']:.2f} x counted")
    RESULT.write_text(json.dumps({"made with": made_with(0), "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
