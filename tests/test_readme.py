"""The README says what is measured and its code runs."""

import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest


ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_figures_are_those_of_the_result_file():
    module = importlib.import_module("experiments.readme_tables")
    assert module.updated(README, json.loads(module.RESULT.read_text())) == README


def test_what_it_points_to_exists():
    targets = re.findall(r"\]\(([^)#:]+)\)", README)
    assert targets
    for target in targets:
        assert (ROOT / target).exists(), target


@pytest.mark.slow
def test_its_python_runs(tmp_path: Path):
    blocks = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len(blocks) >= 3
    (tmp_path / "data").symlink_to(ROOT / "data")
    check = (
        "\nassert radiance.shape == (343, 41) and slope.shape == radiance.shape\nassert fit.result == ('successful',)\n"
        "assert np.all(np.isfinite(image)) and pixels.shape == (3, 256, 256)\n"
    )
    script = tmp_path / "readme.py"
    script.write_text("\n".join(blocks) + check)
    done = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "fit.png").exists() and (tmp_path / "fit.json").exists()
