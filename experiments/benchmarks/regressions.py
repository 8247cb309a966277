"""Whether anything has become slower since the kept result: times over a rival's of the same run, before and now.

    python -m experiments.benchmarks.regressions NOW.json [--kept experiments/results/benchmark.json] [--most 0.2]

The rival's time stands for the machine, so that only what skyfit does counts. What is slower by more than `--most` is
printed with the commits in between, and the exit code is 1.
"""

import argparse
import json
import pathlib
import subprocess


# no import of the benchmarks, whose rivals take long to load
HERE = pathlib.Path(__file__).resolve().parents[1]
KEPT = HERE / "results" / "benchmark.json"
# what stands for the machine: a rival that no commit of ours changes
YARDSTICK = "nanodisort 16 streams flat"
RIVALS = ("nanodisort", "sasktran2", "PythonicDISORT")


def changes(kept: dict, now: dict) -> dict[str, float]:
    """By how much each of our times has grown over the yardstick's, relative: 0.2 is a fifth slower."""
    before, after = kept["rows"], now["rows"]
    if YARDSTICK not in before or YARDSTICK not in after:
        raise ValueError(f"both results must have the row {YARDSTICK!r}: `pip install '.[bench]'`")
    machine = after[YARDSTICK]["seconds"] / before[YARDSTICK]["seconds"]
    ours = [name for name in before if name in after and not name.startswith(RIVALS)]
    return {name: after[name]["seconds"] / before[name]["seconds"] / machine - 1.0 for name in ours}


def between(before: str, after: str) -> str:
    """The commits that changed the package between two, a line each."""
    listed = subprocess.run(
        ["git", "log", "--oneline", f"{before}..{after}", "--", "skyfit"],
        cwd=HERE.parent, capture_output=True, text=True,
    )  # fmt: skip
    return listed.stdout if listed.returncode == 0 else f"(git does not know {before}..{after})\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("now", type=pathlib.Path)
    parser.add_argument("--kept", type=pathlib.Path, default=KEPT)
    parser.add_argument("--most", type=float, default=0.2)
    given = parser.parse_args()
    kept, now = (json.loads(path.read_text()) for path in (given.kept, given.now))
    grown = changes(kept, now)
    for name, change in grown.items():
        print(f"{name:30} {100 * change:+6.0f} %{'   slower' if change > given.most else ''}")
    if max(grown.values(), default=0.0) > given.most:
        before, after = kept["made_with"]["commit"], now["made_with"]["commit"]
        print(f"\nslower than at {before}; commits since:\n{between(before, after)}", end="")
        raise SystemExit(1)


if __name__ == "__main__":
    main()
