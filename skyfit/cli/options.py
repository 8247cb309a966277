"""What the commands share: the application, options, checks and the way they print."""

import os
from collections.abc import Callable
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from ..atmosphere import AbstractPhase, Aerosol, Atmosphere, Exponential, Ground, Ozone, Rayleigh
from ..transport import AbstractSolver, SOLVERS


app = typer.Typer(
    add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None,
    help="A differentiable daylight sky: simulate it, fit it, refit Preetham's model.",
)  # fmt: skip
console = Console()
notices = Console(stderr=True)


class PresetName(StrEnum):
    """How finely a solver resolves."""

    draft = "draft"
    normal = "normal"
    fine = "fine"


class GeometryName(StrEnum):
    """The shape of the Earth."""

    flat = "flat"
    spherical = "spherical"


class LossName(StrEnum):
    """Losses of a fit."""

    squares = "squares"
    huber = "huber"
    cauchy = "cauchy"


SolverOption = Annotated[
    str,
    typer.Option(
        metavar=f"[{'|'.join(SOLVERS)}]",
        help="all orders of scattering, two, one, Klassen's shells, Hoffman's uniform air",
    ),
]
PresetOption = Annotated[PresetName, typer.Option(help="resolution of the solver")]
GeometryOption = Annotated[GeometryName, typer.Option(help="curved paths, or a flat Earth")]
AngstromExponent = Annotated[float, typer.Option(help="of the haze's optical depth")]
SingleScatteringAlbedo = Annotated[float, typer.Option(help="of the haze")]
GroundAlbedo = Annotated[float, typer.Option(help="of a Lambertian ground")]
OzoneColumn = Annotated[float, typer.Option("--ozone", help="Dobson units")]
Pressure = Annotated[float, typer.Option(help="Pa at the ground: scales the air's scattering")]
HazeHeight = Annotated[float, typer.Option(help="scale height of the haze, m")]
OutFolder = Annotated[Path, typer.Option("--out", help="folder for the results")]
PolarisedOption = Annotated[
    bool | None, typer.Option("--polarised/--scalar", help="(default: polarised for spectra by the solver orders)")
]
LineShape = Annotated[float | None, typer.Option(help="Gaussian line shape of the instrument, nm")]


def make_solver(name: str, preset: PresetName, geometry: GeometryName, polarised: bool = False) -> AbstractSolver:
    """The solver of some words; only `orders` may be polarised."""
    if name not in SOLVERS:
        raise ValueError(f"`--solver` must be one of {', '.join(SOLVERS)}, got {name!r}")
    if polarised and name != "orders":
        raise ValueError(f"`--polarised` must be left out with `--solver {name}`: only orders knows polarisation")
    settings = {"polarised": True} if polarised else {}
    return getattr(SOLVERS[name], preset.value)(geometry.value, **settings)


def make_atmosphere(
    phase: AbstractPhase,
    angstrom_exponent: float,
    single_scattering_albedo: float,
    haze_height: float,
    ground_albedo: float,
    ozone: float,
    pressure: float,
) -> Callable:
    """An `Atmosphere` by the haze's optical depth at 550 nm, which may be traced; checks what the user gave."""
    haze = {
        "angstrom_exponent": in_range("--angstrom-exponent", angstrom_exponent, -1.0, 4.0),
        "single_scattering_albedo": in_range("--single-scattering-albedo", single_scattering_albedo, 0.0, 1.0),
        "profile": Exponential(in_range("--haze-height", haze_height, 50.0, 20000.0)),
        "phase": phase,
    }
    gas = Ozone(column=in_range("--ozone", ozone, 0.0, 1000.0))
    ground = Ground(albedo=in_range("--ground-albedo", ground_albedo, 0.0, 1.0))
    air = Rayleigh(pressure=in_range("--pressure", pressure, 0.0, 2e6))
    return lambda depth: Atmosphere(rayleigh=air, aerosol=Aerosol(depth, **haze), ozone=gas, ground=ground)


@contextmanager
def progress(title: str):
    """A bar on standard error; yields `progress(done, of)`."""
    columns = SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
    with Progress(*columns, console=notices, transient=True) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, of: bar.update(task, completed=done, total=of)


def table(title: str) -> Table:
    return Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)


def in_range(name: str, value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise ValueError(f"`{name}` must be between {low:g} and {high:g}, got {value:g}")
    return value


def check_folder(path: Path) -> None:
    """Before the work: whether the folder is there or can be made; it is made when there is something to write."""
    nearest = next(place for place in (path, *path.absolute().parents) if place.exists())
    if not (nearest.is_dir() and os.access(nearest, os.W_OK)):
        raise ValueError(f"`--out` must be a folder that can be made, got {path}")
