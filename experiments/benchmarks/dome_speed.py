"""The dome of 1024 x 1024 pixels in float32: Preetham's sky here, Mitsuba's `sunsky`, and the exponentials alone.

    python -m experiments.benchmarks.dome_speed [--repeats 41] [--llvm PATH] [--out FILE.json]

Everything is taken in turn, Mitsuba in processes of its own, whose threads would otherwise turn idly beside ours.
Preetham's sky needs six exponentials a pixel: XLA's time for six of them in one loop is the floor. Mitsuba's `sunsky`
is another model (Hosek and Wilkie 2012), so that speeds are compared and not values; its disc of the sun is off, which
is its faster way. Its vectorised variant needs a libLLVM with `fminimum` (14 and 15 have none and abort): the
candidates are tried. Its scalar variant takes no arrays: it renders an image of that size that shows the sky alone.
"core seconds" are those of all threads: on a busy machine they say more than the clock.
"""

import argparse
import glob
import json
import os
import pathlib
import re
import statistics
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from skyfit.scene import fisheye, unit_vectors


SIZE, TURBIDITY, SUN_ZENITH = 1024, 3.0, 40.0
EXPONENTIALS = 6
# a process that takes one turn a line, and answers with the seconds of the clock and of all cores
RIVAL = """
import json, sys, time
import mitsuba
variant, size, sky = sys.argv[1], int(sys.argv[2]), json.loads(sys.argv[3])
mitsuba.set_variant(variant)
if variant == "scalar_rgb":
    look = mitsuba.ScalarTransform4f().look_at([0, 0, 0], [0, 0, 1], [0, 1, 0])
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    camera = {"type": "perspective", "fov": 100, "to_world": look, "film": film,
              "sampler": {"type": "independent", "sample_count": 1}}
    scene = mitsuba.load_dict({"type": "scene", "integrator": {"type": "direct"}, "sky": sky, "camera": camera})
    def turn():
        mitsuba.render(scene, spp=1)
    mean, threads = None, None
else:
    import drjit, numpy
    from skyfit.scene import fisheye
    emitter, view = mitsuba.load_dict(sky), numpy.asarray(fisheye(size)).reshape(3, -1)
    where = drjit.zeros(mitsuba.SurfaceInteraction3f, size * size)
    where.wi = -mitsuba.Vector3f(view)  # back to the eye
    drjit.eval(where)
    def turn():
        colours = emitter.eval(where)
        drjit.eval(colours)
        drjit.sync_thread()
        return colours
    mean, threads = numpy.array(turn())[:, view[2] > 0.1].mean(axis=1).tolist(), drjit.thread_count()
print(json.dumps({"mean": mean, "threads": threads}), flush=True)
for _ in sys.stdin:
    start, used = time.perf_counter(), time.process_time()
    turn()
    print(time.perf_counter() - start, time.process_time() - used, flush=True)
"""


class Rival:
    """Mitsuba in a process of its own; `said` is what it told of itself, None where it does not run."""

    def __init__(self, variant: str, sun, llvm: str | None = None):
        direction = [float(component) for component in sun]
        sky = {"type": "sunsky", "turbidity": TURBIDITY, "sun_direction": direction, "sun_scale": 0.0}
        environment = os.environ | ({"DRJIT_LIBLLVM_PATH": llvm} if llvm else {})
        self.process = subprocess.Popen(
            [sys.executable, "-c", RIVAL, variant, str(SIZE), json.dumps(sky)],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        first = self._line()
        self.said = json.loads(first) if first else None

    def __call__(self) -> tuple[float, float]:
        assert self.process.stdin
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        wall, core = map(float, self._line().split())
        return wall, core

    def _line(self) -> str:
        assert self.process.stdout
        return self.process.stdout.readline()


def vectorised(sun, given: str | None) -> tuple[Rival | None, str]:
    """Mitsuba's vectorised variant with the given libLLVM, else with the newest that it runs with."""
    found = {os.path.realpath(path) for path in glob.glob("/usr/lib/*/libLLVM*.so*")}
    by_version = sorted(found, key=lambda path: [int(n) for n in re.findall(r"\d+", path.rsplit("LLVM")[-1])])
    for path in [given] if given else by_version[::-1]:
        rival = Rival("llvm_ad_rgb", sun, path)
        if rival.said:
            return rival, pathlib.Path(path).name
    return None, "none works"


def timed(run):
    """A turn of our own: seconds of the clock and of all cores."""

    def turn() -> tuple[float, float]:
        start, used = time.perf_counter(), time.process_time()
        jax.block_until_ready(run())
        return time.perf_counter() - start, time.process_time() - used

    return turn


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--repeats", type=int, default=41)
    arguments.add_argument("--llvm", help="path of a libLLVM for Mitsuba's vectorised variant")
    arguments.add_argument("--out", type=pathlib.Path, default=HERE / "results" / "dome_speed.json")
    given = arguments.parse_args()

    sun, view = unit_vectors(np.radians(SUN_ZENITH), 0.3), fisheye(SIZE)
    model, turbidity = skyfit.Preetham.published(), jnp.asarray(TURBIDITY)
    exponents = -1.0 - view[2]
    alone = jax.jit(lambda x: sum(jnp.exp((1.0 + 0.1 * k) * x) for k in range(EXPONENTIALS)))
    # a bound method has no hash
    one_program = jax.jit(lambda *at: model.rgb(*at))
    turns = {
        "skyfit": timed(lambda: model.rgb(turbidity, sun, view)),
        "skyfit, one program": timed(lambda: one_program(turbidity, sun, view)),
        "exponentials": timed(lambda: alone(exponents)),
        "mitsuba, scalar render": Rival("scalar_rgb", sun),
    }
    fast, library = vectorised(sun, given.llvm)
    colours = {"skyfit": np.asarray(model.rgb(turbidity, sun, view))[:, np.asarray(view[2]) > 0.1].mean(axis=1)}
    if fast:
        turns["mitsuba, vectorised"] = fast
        colours["mitsuba"] = fast.said["mean"]

    times = {name: [] for name in turns}
    for repeat in range(given.repeats + 1):
        for name, turn in turns.items():
            # the scalar one is slow; the first turn of each compiles
            if repeat < 8 or name != "mitsuba, scalar render":
                times[name].append(turn())
    rows = {}
    for name, pairs in times.items():
        wall, core = zip(*pairs[1:], strict=True)
        rows[name] = {
            "seconds": statistics.median(wall),
            "fastest": min(wall),
            "core seconds": statistics.median(core),
            "repeats": len(wall),
            "ns a pixel": 1e9 * statistics.median(wall) / SIZE**2,
        }
    for name, row in rows.items():
        ratios = {kind: round(row[kind] / rows["skyfit"][kind], 2) for kind in ("seconds", "fastest", "core seconds")}
        row["times skyfit's"] = ratios
        print(f"{name:24} {1e3 * row['seconds']:8.2f} ms, fastest {1e3 * row['fastest']:8.2f} ms, {ratios}")
    result = {
        "pixels": SIZE**2,
        "turbidity": TURBIDITY,
        "sun zenith": SUN_ZENITH,
        "rows": rows,
        "libLLVM of mitsuba": library,
        "threads of mitsuba": fast.said["threads"] if fast else None,
        "red and blue over green, mean above 6 degrees": {
            name: [round(float(mean[k] / mean[1]), 3) for k in (0, 2)] for name, mean in colours.items()
        },
        "processes waiting": round(os.getloadavg()[0], 1),
        **made_with(0, ("mitsuba", "drjit")),
    }
    given.out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
