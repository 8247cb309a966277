"""How long a user waits for a first result: each command in a process of its own, with no compiled code and with it.

    python -m experiments.benchmarks.first_result [--only help,simulate] [--shared ../shared] [--repeats 3]

Writes experiments/results/first_result.json: seconds of the clock and of the processor, cold (an empty cache folder)
and warm (the quickest of some repeats); how many programs XLA compiled or fetched, and the seconds that lowering and
compiling took; which were the slowest, and the size of the biggest in the cache. Parts that are not asked
for keep their last figures. The measured scan is the one of 10:00, where ../shared has it.
"""

import argparse
import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time

import jax

from experiments.benchmarks.tiers import made_with


HERE = pathlib.Path(__file__).resolve().parents[1]
RESULT = HERE / "results" / "first_result.json"
COMMAND = (sys.executable, "-c", "from skyfit.cli import main; main()")
SAMPLE = str(HERE.parent / "data" / "skies" / "sample.nc")
SCAN = pathlib.Path("measured", "kider2014", "2013-05-27___10.00.00")
STATION = ("--latitude", "42.443449", "--longitude", "-76.481962", "--utc-offset", "-4")
PARTICLES = ("--free", "particles")
# every parameter's slope of one number: reverse mode, in the precision of the command
REVERSE = """
import jax, numpy as np, skyfit
scene = skyfit.Scene.from_degrees(60.0, skyfit.hemisphere(343), np.arange(380.0, 781.0, 10.0))
solver = skyfit.OrdersOfScattering.normal(polarised=True)
slope = jax.jit(jax.grad(lambda air: solver.radiance(air, scene).mean()))
assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(slope(skyfit.Atmosphere.from_turbidity(3.0))))
"""
PARTS = {
    "help": (*COMMAND, "--help"),
    "simulate": (*COMMAND, "simulate", "--sun-zenith", "60", "--turbidity", "3", "--out", "sky.nc"),
    "invert": (*COMMAND, "invert", SAMPLE, "--out", "fit"),
    "invert particles": (*COMMAND, "invert", SAMPLE, "--out", "fit", *PARTICLES),
    "reverse": (sys.executable, "-c", REVERSE),
}
# what JAX logs of its work: the stage, the program, seconds
LOGGED = re.compile(r"Finished (jaxpr to MLIR module conversion|XLA compilation of) (\S+) in ([\d.e+-]+) sec")
LOWERED, COMPILED = "jaxpr to MLIR module conversion", "XLA compilation of"
SLOWEST = 5


def measured(shared: pathlib.Path) -> dict[str, tuple[str, ...]]:
    """The parts that invert a measured scan; none, and a word about it, where it is absent."""
    scan = shared.resolve() / SCAN
    if not scan.is_dir():
        print(f"{scan} is absent: its figures stay as they were")
        return {}
    usual = (*COMMAND, "invert", str(scan), *STATION, "--out", "fit")
    return {"scan": usual, "scan particles": (*usual, *PARTICLES)}


def run(words: tuple[str, ...], folder: pathlib.Path, cache: pathlib.Path) -> dict:
    """One process: what it took, and what JAX logged of its programs."""
    inherited = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "XLA_"))}
    own = {
        "XDG_CACHE_HOME": str(cache), "COLUMNS": "80", "PYTHONPATH": str(HERE.parent), "JAX_LOG_COMPILES": "1",
        "JAX_ENABLE_X64": "1", "JAX_COMPILATION_CACHE_DIR": str(cache / "skyfit"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
    }  # fmt: skip
    with (folder / "log").open("w+") as log:
        start = time.perf_counter()
        child = subprocess.Popen(words, cwd=folder, env=inherited | own, stdout=subprocess.DEVNULL, stderr=log)
        _, status, used = os.wait4(child.pid, 0)
        wall = time.perf_counter() - start
        child.returncode = os.waitstatus_to_exitcode(status)
        log.seek(0)
        text = log.read()
    if child.returncode:
        raise RuntimeError(f"{' '.join(words)} ended with {child.returncode}:\n{text[-2000:]}")
    return {"wall_s": wall, "user_s": used.ru_utime, "system_s": used.ru_stime} | programs(text)


def programs(log: str) -> dict:
    """Seconds of each stage, and the programs that XLA compiled or fetched."""
    found = [(stage, name, float(seconds)) for stage, name, seconds in LOGGED.findall(log)]
    compiled = sorted(((s, name) for stage, name, s in found if stage == COMPILED), reverse=True)
    return {
        "programs": len(compiled),
        "fetched": log.count("Persistent compilation cache hit"),
        "lower_s": sum(s for stage, _, s in found if stage == LOWERED),
        "compile_s": sum(s for s, _ in compiled),
        "slowest": [{"name": name, "seconds": s} for s, name in compiled[:SLOWEST]],
    }


def cached(cache: pathlib.Path) -> dict:
    """What the cache folder holds after a cold run."""
    sizes = {path.name: path.stat().st_size for path in cache.rglob("*") if path.is_file()}
    biggest = max(sizes, key=sizes.__getitem__, default="")
    name = re.sub(r"-[0-9a-f]{16,}.*", "", biggest)
    return {"files": len(sizes), "bytes": sum(sizes.values()), "biggest": name, "biggest_bytes": sizes.get(biggest, 0)}


def measure(words: tuple[str, ...], repeats: int) -> dict:
    """Cold once, then warm some times, of which the quickest counts."""
    with tempfile.TemporaryDirectory() as place:
        folder = pathlib.Path(place)
        cold = run(words, folder, folder / "cache")
        left = cached(folder / "cache")
        warm = min((run(words, folder, folder / "cache") for _ in range(repeats)), key=lambda one: one["user_s"])
    return {"cold": cold, "warm": warm, "warm_repeats": repeats, "cache": left}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--only", help=f"of {', '.join(PARTS)}, scan, scan particles; with commas")
    parser.add_argument("--shared", type=pathlib.Path, default=HERE.parent.parent / "shared")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=pathlib.Path, default=RESULT)
    arguments = parser.parse_args()
    parts = PARTS | measured(arguments.shared)
    names = list(parts) if arguments.only is None else [name.strip() for name in arguments.only.split(",")]
    unknown = [name for name in names if name not in parts]
    if unknown:
        parser.error(f"--only must name parts of {', '.join(parts)}, got {', '.join(unknown)}")
    record = json.loads(arguments.out.read_text()) if arguments.out.exists() else {"parts": {}}
    # of the command, which computes in float64; read by made_with
    jax.config.update("jax_enable_x64", True)
    for name in names:
        found = measure(parts[name], arguments.repeats)
        record["parts"][name] = found | {"made_with": made_with(0, ("lazy_loader", "optimistix", "typer"))}
        for kind in ("cold", "warm"):
            one = found[kind]
            print(f"{name:18s} {kind}: {one['wall_s']:7.2f} s, processor {one['user_s']:7.2f} s, "
                  f"{one['programs']} programs, {one['fetched']} fetched", flush=True)  # fmt: skip
        arguments.out.write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main()
