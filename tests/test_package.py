"""The wheel installs and fits a sky; an import stays light; each floor stands only on those beneath it."""

import ast
import csv
import json
import os
import re
import subprocess
import sys
import sysconfig
import tomllib
import venv
from pathlib import Path

import pytest


ROOT = Path(__file__).resolve().parents[1]
# a floor imports only from the floors under it; what shares a line imports nothing from its neighbour
FLOORS = (
    {"extras", "tables", "numerics"},
    {"light"},
    {"scene"},
    {"atmosphere"},
    {"transport", "measured"},
    {"programs"},
    {"analytic", "retrieve"},
    {"records"},
    {"draw", "image"},
    {"cli"},
)
HEIGHT = {name: height for height, names in enumerate(FLOORS) for name in names}
HEAVY = ("colour", "matplotlib", "pandas", "pvlib", "scipy", "xarray")
SOURCES = sorted((ROOT / "skyfit").rglob("*.py"))


def run(*command: object, cwd: Path, **environment: str) -> str:
    """Standard output of a command that sees no other skyfit than its own environment's."""
    inherited = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env=inherited | environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`bin` of a fresh environment with the wheel in it; what skyfit depends on is borrowed from this one."""
    folder = tmp_path_factory.mktemp("wheel")
    build = (sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, ROOT)
    run(*build, cwd=folder)
    (wheel,) = folder.glob("skyfit-*.whl")
    venv.create(folder / "venv", with_pip=False, symlinks=True)
    python = folder / "venv/bin/python"
    purelib = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder).strip())
    # a folder named in a .pth does not have its own .pth files read: an editable skyfit stays out of sight
    paths = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    (purelib / "dependencies.pth").write_text("\n".join(sorted(paths)) + "\n")
    install = (
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "--no-deps",
        "--no-index",
        wheel,
    )
    run(sys.executable, "-m", "pip", "--python", python, *install, cwd=folder)
    return folder / "venv/bin"


def test_the_wheel_holds_the_package_and_every_table(installed: Path, tmp_path: Path):
    found = run(installed / "python", "-c", "import skyfit; print(skyfit.__file__)", cwd=tmp_path)
    package = Path(found.strip()).parent
    assert package.is_relative_to(installed.parent)
    for folder, target in ((ROOT / "skyfit", package), (ROOT / "data", package / "data")):
        names = {path.relative_to(folder) for path in folder.rglob("*") if path.is_file()}
        wanted = {name for name in names if "__pycache__" not in name.parts}
        got = {path.relative_to(target) for path in target.rglob("*") if path.is_file()}
        assert wanted <= got


def test_the_wheel_fits_a_sky(installed: Path, tmp_path: Path):
    skyfit = installed / "skyfit"
    assert "invert" in run(skyfit, "--help", cwd=tmp_path)
    with (tmp_path / "dirs.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["view_zenith", "view_azimuth"])
        rows.writerows([zenith, azimuth] for zenith in (20, 50, 75) for azimuth in (10, 100, 190, 280))
    simulate = "simulate --sun-zenith 60 --turbidity 3 --solver single --out sky.nc --directions dirs.csv"
    run(skyfit, *simulate.split(), cwd=tmp_path)
    run(skyfit, *"invert sky.nc --solver single --free turbidity --out out".split(), cwd=tmp_path)
    fit = json.loads((tmp_path / "out/fit.json").read_text())
    turbidity = fit["times"][0]["parameters"]["turbidity"]["value"]
    assert turbidity == pytest.approx(3.0, abs=0.01)


def loaded(program: str, folder: Path) -> set[str]:
    """Modules that a program loads, counted from where it sets `was`."""
    program = f"import sys\n{program}\nprint(*set(sys.modules) - was)"
    return set(run(sys.executable, "-c", program, cwd=folder, PYTHONPATH=str(ROOT)).split())


def test_the_import_is_light(tmp_path: Path):
    assert not roots(loaded("was = set(sys.modules); import skyfit", tmp_path)) & {*HEAVY, "jax", "equinox", "numpy"}
    # what jax and equinox load of themselves is not skyfit's doing
    every = "import jax, equinox; was = set(sys.modules); import skyfit; [getattr(skyfit, n) for n in skyfit.__all__]"
    modules = loaded(every, tmp_path)
    assert {"skyfit.transport", "skyfit.retrieve", "skyfit.draw"} <= modules
    assert not roots(modules) & set(HEAVY)


BASE = """
import json, sys
extra = json.loads(sys.argv[1])
# as if they were not installed
sys.modules |= dict.fromkeys(extra)
import numpy as np
import skyfit
from skyfit.cli import main
sky = skyfit.Sky(
    np.ones((1, 2, 2)), None, np.ones((1, 2, 2), bool), np.zeros(2), np.zeros(2), np.array([450.0, 550.0]),
    np.array([0.9]), np.array([3.0]), np.array(["NaT"], "datetime64[ns]"),
)
model, camera = skyfit.Preetham.published(), skyfit.Camera("equirect", 16, 8)
refused = {
    "h5netcdf": lambda: skyfit.write_sky(sky, "sky.nc"),
    "pvlib": lambda: skyfit.measured.solar_position(np.array(["2020-06-01"], "datetime64[ns]"), 50.0, 7.0),
    "matplotlib": lambda: skyfit.draw.plot_contact_sheet(["a.png"], ["a"], "sheet.png"),
    "OpenImageIO": lambda: skyfit.render(model, camera, turbidity=3.0, sun_zenith=0.9).save("sky.png"),
}
for module, call in refused.items():
    try:
        call()
    except ModuleNotFoundError as error:
        assert module in str(error) and str(error).endswith("pip install 'skyfit[all]'"), error
    else:
        raise AssertionError(module)
for words in (
    "simulate --sun-zenith 60 --turbidity 3 --solver single --geometry flat --wavelengths 450,550,650 --out sky.csv",
    "invert sky.csv --solver single --geometry flat --preset draft --free turbidity --out fit",
    "simulate --sun-zenith 60 --turbidity 3 --solver single --out sky.nc",
):
    sys.argv[1:] = words.split()
    try:
        main()
    except SystemExit as end:
        print("code", end.code)
# colour-science puts an empty module in the place of matplotlib
assert not {name for name in extra if sys.modules.get(name) is not None} - {"matplotlib"}
"""


def test_a_fit_of_a_table_needs_no_extra(python, tmp_path: Path):
    """With all of the extra blocked: what needs it says so in a line, the numbers of a fit are there."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extra = [re.split("[>=]", line)[0] for line in project["optional-dependencies"]["all"]]
    done = python(BASE, json.dumps(extra), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    fit = json.loads((tmp_path / "fit/fit.json").read_text())
    assert fit["times"][0]["parameters"]["turbidity"]["value"] == pytest.approx(3.0, abs=0.01)
    notes = done.stderr.splitlines()
    assert [line.partition(":")[0] for line in notes] == ["note", "note", "skyfit"], notes
    assert "no fit.nc: xarray and h5netcdf must be there" in notes[0] and "no fit.png: matplotlib" in notes[1]
    assert done.stdout.endswith("code 2\n") and not (tmp_path / "sky.nc").exists()


def roots(modules: set[str]) -> set[str]:
    return {name.split(".")[0] for name in modules}


SUMS = """
import jax, jax.numpy as jnp, skyfit
rows = jnp.stack([jnp.arange(32769.0), jnp.zeros(32769), jnp.zeros(32769)], axis=1)
squares = jax.vmap(lambda row: jnp.sum((jnp.eye(3) @ row) ** 2))
print(float(jnp.max(jnp.abs(jax.jit(squares)(rows) - squares(rows)))))
"""


def test_sums_of_products_are_right(python, tmp_path: Path):
    # of jaxlib 0.10.2 alone they are 2e6 off: github.com/jax-ml/jax/issues/39103
    done = python(SUMS, cwd=tmp_path)
    assert done.stdout.strip() == "0.0", done.stderr


def test_every_name_is_that_of_its_home_whatever_else_is_loaded(tmp_path: Path):
    homes = {}
    for node in ast.parse((ROOT / "skyfit/__init__.pyi").read_text(encoding="utf-8")).body:
        assert isinstance(node, ast.ImportFrom) and node.level == 1
        homes |= {alias.name: node.module for alias in node.names}
    folders = {path.parent.name for path in ROOT.glob("skyfit/*/__init__.py")}
    assert {name for name, home in homes.items() if home is None} == folders - {"cli"} | {"tables"}
    (tmp_path / "homes.json").write_text(json.dumps(homes))
    program = """
import importlib, json, pkgutil, sys
import skyfit
was = set(sys.modules)
homes = json.load(open("homes.json"))
for module in pkgutil.walk_packages(skyfit.__path__, "skyfit."):
    importlib.import_module(module.name)
assert sorted(dir(skyfit)) == sorted(skyfit.__all__) == sorted(homes)
for name, home in homes.items():
    exec(f"from skyfit import {name} as found")
    wanted = sys.modules[f"skyfit.{name}"] if home is None else getattr(sys.modules[f"skyfit.{home}"], name)
    assert found is wanted and getattr(skyfit, name) is wanted, name
try:
    skyfit.none_such
except AttributeError as error:
    assert "none_such" in str(error)
"""
    loaded(program, tmp_path)


def floor(path: Path) -> str:
    """Folder or module right under skyfit/ that a source file belongs to; "" for skyfit/__init__.py."""
    first = path.relative_to(ROOT / "skyfit").parts[0]
    return "" if first == "__init__.py" else first.removesuffix(".py")


def imports(path: Path) -> set[str]:
    """Modules that a source file imports, anywhere in it, by their absolute names."""
    package = path.relative_to(ROOT).parent.parts
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            start = package[: len(package) + 1 - node.level] if node.level else ()
            module = ".".join((*start, *filter(None, [node.module])))
            # `from skyfit import x` names a floor only with x
            found |= {f"{module}.{alias.name}" for alias in node.names} if module == "skyfit" else {module}
    return found


def test_every_folder_has_its_floor():
    assert {floor(path) for path in SOURCES} <= {"", *HEIGHT}


def test_floors():
    for path in SOURCES:
        own = floor(path)
        modules = [name.split(".") for name in imports(path)]
        inside = {name[1] for name in modules if name[0] == "skyfit" and len(name) > 1}
        if own:
            # a name that is no floor is the top's own, which stands on all floors but the last
            above = {name for name in inside - {own} if HEIGHT.get(name, len(FLOORS) - 2) >= HEIGHT[own]}
            assert not above, f"{path} imports {sorted(above)}, which is not beneath {own}"
        if own not in {"numerics", "retrieve"}:
            assert "optimistix" not in {name[0] for name in modules}, path


def test_a_file_says_what_is_in_it_and_is_not_long():
    for path in SOURCES:
        assert path.stem not in {"common", "helper", "helpers", "misc", "util", "utils"}, path
        assert len(path.read_text(encoding="utf-8").splitlines()) <= 400, path


def test_no_machine_path_and_no_index_address():
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
    )
    if listed.returncode:
        pytest.skip("no git checkout, so no list of tracked files")
    # written so that this file does not hold what it looks for
    machine = re.compile(rb"(?<![\w.:/-])(?:/(?:work|tmp|home|root|Users|opt)/\w|file:/{2})")
    files = [ROOT / os.fsdecode(name) for name in listed.stdout.split(b"\0") if name]
    found = [str(path.relative_to(ROOT)) for path in files if path.is_file() and machine.search(path.read_bytes())]
    assert not found
    assert "://" not in (ROOT / "requirements.lock").read_text()
