"""README and docs say what is measured, point to what exists, and their code runs."""

import doctest
import importlib
import inspect
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import skyfit


ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
# what the site has besides: pages made of notebooks
NOTEBOOKS = {path.with_suffix(".md") for path in (ROOT / "docs/notebooks").glob("*.py")}


def test_the_figures_are_those_of_the_result_files():
    for path, text in importlib.import_module("experiments.figures").updated().items():
        assert text == path.read_text(encoding="utf-8"), f"python -m experiments.figures makes another {path.name}"


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 150


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_what_it_points_to_exists(page: Path):
    for target, anchor in re.findall(r"\]\(([^)#:]+)(?:#([^)]*))?\)", page.read_text(encoding="utf-8")):
        path = Path(os.path.normpath(page.parent / target))
        assert path.exists() or path in NOTEBOOKS, target
        if anchor:
            heads = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in {re.sub(r"[^\w -]", "", head).lower().replace(" ", "-") for head in heads}, anchor


def test_every_public_name_has_words_and_a_page(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(ROOT / "docs/config")
    names = importlib.import_module("names")
    assert names.undocumented() == [] and names.without_a_page() == []


# what compiles a fit, a refit, or a solver of more than one order of scattering
DEAR = {
    "AerialPerspective", "aerosol_optics", "aerosol_products", "Bruneton", "DoubleScattering", "Estimate",
    "estimate_error", "Fit", "fit_many", "Fits", "invert", "load", "OrdersOfScattering", "Panorama", "plot", "predict",
    "read_coefficients", "read_fits", "read_panorama", "refit", "save", "scattered_light", "Spherical",
    "SphericalField", "Stokes", "upsample", "Upsampled", "write_products", "write_luts",
}  # fmt: skip
# what runs for longer than it compiles: examples, and pages of fits, which go first as README takes their programs
LONG_EXAMPLES = ("write_luts",)
LONG_PAGES = (
    "docs/how-to/error-bars.md", "docs/how-to/twilight-and-space.md", "docs/index.md", "docs/tutorials/scientist.md",
)  # fmt: skip


def examples() -> dict[str, list[doctest.DocTest]]:
    """The examples of each public name: in its docstring, or under its entry in the pages of the API."""
    pages = "\n".join(path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs/api").glob("*.md")))
    entries = re.split(r"^::: skyfit\.(?:[\w.]+\.)?(\w+)$", pages, flags=re.MULTILINE)
    under = dict(zip(entries[1::2], entries[2::2], strict=True))
    finder, parser = doctest.DocTestFinder(recurse=False), doctest.DocTestParser()
    known, found = {"jnp": jnp, "np": np, "skyfit": skyfit}, {}
    for name in skyfit.__all__:
        thing = getattr(skyfit, name)
        if inspect.ismodule(thing):
            continue
        told = finder.find(thing, name, globs=known) if callable(thing) else []
        tests = [*told, parser.get_doctest(under.get(name, ""), known, name, None, 0)]
        found[name] = [test for test in tests if test.examples]
    return found


def test_every_public_name_has_an_example():
    found = examples()
    assert [name for name, tests in found.items() if not tests] == [] and set(found) > DEAR


@pytest.mark.parametrize("dear", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["cheap", "dear"])
def test_the_examples_of_public_names(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, dear: bool):
    (tmp_path / "data").symlink_to(ROOT / "data")
    monkeypatch.chdir(tmp_path)
    runner = doctest.DocTestRunner()
    try:
        for name, tests in examples().items():
            jax.config.update("jax_disable_most_optimizations", name not in LONG_EXAMPLES)
            for test in tests if (name in DEAR) == dear else ():
                runner.run(test)
    finally:
        jax.config.update("jax_disable_most_optimizations", False)
    assert runner.summarize().failed == 0


def test_every_page_is_in_the_navigation():
    listed = set(re.findall(r"[\w/-]+\.md", (ROOT / "docs/config/mkdocs.yml").read_text(encoding="utf-8")))
    pages = {str(path.relative_to(ROOT / "docs")) for path in {*(ROOT / "docs").rglob("*.md"), *NOTEBOOKS}}
    assert pages | {"contributing.md", "changelog.md"} == listed


def test_the_version_is_one():
    told = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    assert f"\nversion: {told}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\n## {told}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_what_became_slower_is_told_from_a_slower_machine():
    regressions = importlib.import_module("experiments.benchmarks.regressions")
    kept = json.loads(regressions.KEPT.read_text(encoding="utf-8"))
    twice = {"rows": {name: {"seconds": 2.0 * row["seconds"]} for name, row in kept["rows"].items()}}
    assert max(abs(change) for change in regressions.changes(kept, twice).values()) < 1e-12
    twice["rows"]["jacobian flat"]["seconds"] *= 1.5
    grown = regressions.changes(kept, twice)
    assert grown["jacobian flat"] == pytest.approx(0.5) and sorted(grown.values())[-2] == pytest.approx(0.0)


@pytest.mark.slow
def test_its_python_runs(tmp_path: Path):
    """The blocks of a page run one after the other, each page by itself; all share one process and its programs."""
    blocks = {
        str(page.relative_to(ROOT)): "\n".join(
            re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
        )
        for page in PAGES
        if page.name != "CONTRIBUTING.md"
    }
    blocks = {page: text for page, text in blocks.items() if text}
    assert len(blocks) >= 12
    blocks["README.md"] += (
        "\nassert radiance.shape == (343, 41) and slope.shape == radiance.shape\nassert fit.result == ('successful',)\n"
    )
    blocks["docs/how-to/aerial-perspective.md"] += "\nassert np.all(np.isfinite(image))\n"
    blocks["docs/how-to/analytic-skies.md"] += "\nassert pixels.shape == (3, 256, 256)\n"
    (tmp_path / "data").symlink_to(ROOT / "data")
    order = [*LONG_PAGES, *sorted(set(blocks) - set(LONG_PAGES))]
    (tmp_path / "blocks.json").write_text(json.dumps([(page in LONG_PAGES, page, blocks[page]) for page in order]))
    script = (
        "import jax, json\nfor long, page, text in json.load(open('blocks.json')):\n"
        "    jax.config.update('jax_disable_most_optimizations', not long)\n"
        "    exec(compile(text, page, 'exec'), {'__name__': page})\n"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert all((tmp_path / name).exists() for name in ("fit.png", "fit.json", "sunset.png"))
