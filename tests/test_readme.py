"""README and docs say what is measured, point to what exists, and their code runs."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest


ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])


def test_the_figures_are_those_of_the_result_files():
    for path, text in importlib.import_module("experiments.figures").updated().items():
        assert text == path.read_text(encoding="utf-8"), f"python -m experiments.figures makes another {path.name}"


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 150


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_what_it_points_to_exists(page: Path):
    for target in re.findall(r"\]\(([^)#:]+)[^)]*\)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target


@pytest.mark.slow
def test_its_python_runs(tmp_path: Path):
    pages = [(ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "docs/guide.md")]
    blocks = [block for page in pages for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL)]
    assert len(blocks) >= 5
    (tmp_path / "data").symlink_to(ROOT / "data")
    check = (
        "\nassert radiance.shape == (343, 41) and slope.shape == radiance.shape\nassert fit.result == ('successful',)\n"
        "assert np.all(np.isfinite(image)) and pixels.shape == (3, 256, 256)\n"
    )
    script = tmp_path / "readme.py"
    script.write_text("\n".join(blocks) + check)
    done = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert all((tmp_path / name).exists() for name in ("fit.png", "fit.json", "sunset.png"))
