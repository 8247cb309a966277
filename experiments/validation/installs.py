"""Whether the built package installs and runs in clean environments.

    python -m experiments.validation.installs python3.11 python3.12 python3.13

Builds the sdist and the wheel, and installs one of them into a new environment of each interpreter that is named, with
the newest versions of what skyfit depends on and with the lowest that pyproject.toml declares, all together. In each
the first two blocks of Python of README.md run, one after the other, and `skyfit simulate`; in one more, without the
extra `all`, a sky is simulated to a table and fitted. Writes experiments/results/installs.json: versions, and of each
step "passed" or the last line of what it said. Programs are compiled without optimising: speed is not asked here.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

from experiments.benchmarks.tiers import HERE


ROOT, RESULT = HERE.parent, HERE / "results" / "installs.json"
DRAFT = ("--solver", "single", "--geometry", "flat", "--preset", "draft")
SIMULATE = ("simulate", "--sun-zenith", "60", "--turbidity", "3", "--out", "sky.nc")
BASE = (
    ("simulate", "--sun-zenith", "60", "--turbidity", "3", *DRAFT, "--wavelengths", "450,550,650", "--out", "sky.csv"),
    ("invert", "sky.csv", *DRAFT, "--free", "turbidity", "--out", "fit"),
)
VERSIONS = """
import json, sys
from importlib.metadata import distributions
print(json.dumps({d.name: d.version for d in distributions()}))
"""
TOLD = ("equinox", "h5netcdf", "h5py", "jax", "jaxtyping", "lineax", "matplotlib", "numpy", "optimistix", "pandas",
        "pvlib", "scipy", "typer", "xarray")  # fmt: skip


def lowest() -> str:
    """The lower bounds of pyproject.toml as constraints of pip."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    bounds = [*project["dependencies"], *project["optional-dependencies"]["all"]]
    return "\n".join(bound.replace(">=", "==") for bound in bounds) + "\n"


def step(words: list, folder: Path, cache: Path) -> tuple[str, str]:
    """How a command ended, and its standard output."""
    inherited = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "JAX_", "XLA_"))}
    own = {
        "JAX_COMPILATION_CACHE_DIR": str(cache), "XDG_CACHE_HOME": str(cache),
        "XLA_FLAGS": "--xla_backend_optimization_level=0",
    }  # fmt: skip
    done = subprocess.run(list(map(str, words)), cwd=folder, env=inherited | own, capture_output=True, text=True)
    if done.returncode == 0:
        return "passed", done.stdout
    lines = (done.stderr.strip() or done.stdout.strip() or f"code {done.returncode}").splitlines()
    # no place of this machine goes into the record
    return re.sub(r"(/[\w.+-]+)+/", "", lines[-1]), done.stdout


def tried(python: str, built: Path, extra: str, which: str, folder: Path, cache: Path) -> dict:
    """One environment: what came of each step, up to the first that failed."""
    found: dict = {"from": "sdist" if built.suffix == ".gz" else "wheel", "dependencies": which, "extra": extra}
    steps: dict[str, str] = found.setdefault("steps", {})
    step([python, "-m", "venv", "env"], folder, cache)
    own, skyfit = folder / "env/bin/python", folder / "env/bin/skyfit"
    pip = [own, "-m", "pip", "install", "--quiet", "--no-compile", "--disable-pip-version-check"]
    (folder / "lowest.txt").write_text(lowest())
    constraints = ["--constraint", "lowest.txt"] if which == "lowest" else []
    steps["install"], _ = step([*pip, *constraints, f"{built}[{extra}]" if extra else built], folder, cache)
    if steps["install"] != "passed":
        return found
    _, said = step([own, "-c", VERSIONS], folder, cache)
    installed = {name.lower(): version for name, version in json.loads(said).items()}
    found["skyfit"] = installed["skyfit"]
    found["versions"] = {name: installed[name] for name in TOLD if name in installed}
    if not extra:
        for words in BASE:
            steps[f"skyfit {words[0]}"], _ = step([skyfit, *words], folder, cache)
        return found
    os.symlink(ROOT / "data", folder / "data")
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)[:2]
    steps["README.md"], _ = step([own, "-W", "ignore", "-c", "\n".join(blocks)], folder, cache)
    steps["skyfit simulate"], _ = step([skyfit, *SIMULATE], folder, cache)
    return found


def main() -> None:
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=ROOT)
    rows = []
    with tempfile.TemporaryDirectory() as place:
        top = Path(place)
        dist, cache = top / "dist", top / "cache"
        made = step([sys.executable, "-m", "build", "--no-isolation", "--outdir", dist, ROOT], top, cache)
        assert made[0] == "passed", made
        (sdist,), (wheel,) = dist.glob("*.tar.gz"), dist.glob("*.whl")
        sizes = {"sdist": round(sdist.stat().st_size / 1e6, 1), "wheel": round(wheel.stat().st_size / 1e6, 1)}
        cases = [(python, which, "all") for python in sys.argv[1:] for which in ("newest", "lowest")]
        for number, (python, which, extra) in enumerate([*cases, (sys.argv[1:][-1], "newest", "")]):
            with tempfile.TemporaryDirectory(dir=top) as folder:
                said = step([python, "-c", "import platform; print(platform.python_version())"], top, top)[1].strip()
                # an sdist makes the same wheel, so one suffices
                row = tried(python, wheel if number else sdist, extra, which, Path(folder), cache)
            rows.append({"python": said, **row})
            record = {"commit": commit.stdout.strip(), "size_mb": sizes, "environments": rows}
            RESULT.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
