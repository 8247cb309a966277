"""The application, and the options and checks shared by commands. Help texts load neither jax nor a solver."""

import os
from collections.abc import Callable, Iterable
from enum import StrEnum
from functools import wraps
from inspect import Parameter, signature
from pathlib import Path
from typing import Annotated, TYPE_CHECKING

import typer

from .known import SOLVER_NAMES


if TYPE_CHECKING:
    Context = typer.Context
else:
    # typer passes an instance of the base class of its own Context
    Context = typer.Context.__base__

app = typer.Typer(
    no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None,
    help="A differentiable daylight sky: simulate it, fit it, refit Preetham's model.",
)  # fmt: skip


def _speak(**how: bool) -> None:
    from .printing import speak

    speak(**how)


# Options of every command: they affect the output only
_OF_EVERY_COMMAND = {
    "quiet": typer.Option(
        "--quiet", help="only warnings and errors", expose_value=False, callback=lambda value: _speak(quiet=value)
    ),
    "as_json": typer.Option(
        "--json", help="the result as one JSON document on standard output, all else on standard error",
        expose_value=False, callback=lambda value: _speak(as_json=value),
    ),
}  # fmt: skip


def command(name: str, example: str) -> Callable[[Callable], Callable]:
    """Register a function as the command `name`, with an example in its help and the options of every command."""

    def register(function: Callable) -> Callable:
        @wraps(function)
        def run(quiet, as_json, **named):
            function(**named)

        own = signature(function)
        shared = [
            Parameter(key, Parameter.KEYWORD_ONLY, default=False, annotation=Annotated[bool, option])
            for key, option in _OF_EVERY_COMMAND.items()
        ]
        # typer reads a command's options from its signature
        run.__signature__ = own.replace(parameters=[*own.parameters.values(), *shared])  # pyright: ignore[reportAttributeAccessIssue]
        app.command(name, epilog=f"Example: {example}")(run)
        return function

    return register


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


_SOLVERS = "all orders of scattering, the same on into night, two, one, Klassen's shells, Hoffman's uniform air"
NamedSolverOption = Annotated[str, typer.Option(metavar=f"[{'|'.join(SOLVER_NAMES)}]", help=_SOLVERS)]
SolverOption = Annotated[
    str, typer.Option(metavar=f"[{'|'.join(SOLVER_NAMES)}|auto]", help=f"{_SOLVERS}; auto: by --tolerance")
]
PresetOption = Annotated[PresetName, typer.Option(help="resolution of the solver")]
GeometryOption = Annotated[GeometryName, typer.Option(help="curved paths, or a flat Earth")]
AngstromExponent = Annotated[float, typer.Option(help="of the haze's optical depth")]
SingleScatteringAlbedo = Annotated[float, typer.Option(help="of the haze")]
SunZenith = Annotated[float | None, typer.Option(help="degrees; or --time and --at")]
SunAzimuth = Annotated[
    float | None, typer.Option(help="degrees clockwise from north  [default: 180]", show_default=False)
]
SunAngle = Annotated[float | None, typer.Option(help="degrees, a first guess of a picture's sun")]
Place = Annotated[str | None, typer.Option(help="LAT,LON in degrees, north and east positive")]
GroundAlbedo = Annotated[float, typer.Option(help="of a Lambertian ground")]
OzoneColumn = Annotated[float, typer.Option("--ozone", help="Dobson units")]
Pressure = Annotated[float, typer.Option(help="Pa at the ground: scales the air's scattering")]
HazeHeight = Annotated[float, typer.Option(help="scale height of the haze, m")]
OutFolder = Annotated[Path, typer.Option("--out", help="folder for the results")]
PolarisedOption = Annotated[
    bool | None, typer.Option("--polarised/--scalar", help="(default: polarised for spectra by the solver orders)")
]
ToleranceOption = Annotated[
    str | None,
    typer.Option(metavar="1%", help="largest error, instead of a solver: the cheapest that keeps to it is chosen"),
]
LineShape = Annotated[float | None, typer.Option(help="Gaussian line shape of the instrument, nm")]


AtmosphereOption = Annotated[
    Path | None,
    typer.Option("--atmosphere", help="TOML or JSON with constituents and ground, instead of their options"),
]
# Options that a file given by `--atmosphere` replaces
OF_ATMOSPHERES = (
    "angstrom_exponent", "single_scattering_albedo", "asymmetry", "haze_height", "ground_albedo", "ozone", "pressure",
)  # fmt: skip


def in_range(name: str, value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise ValueError(f"`{name}` must be between {low:g} and {high:g}, got {value:g}")
    return value


def check_file(path: Path) -> None:
    """Raise `ValueError`, before the work, if a file cannot be written there."""
    if not path.absolute().parent.is_dir() or path.is_dir():
        raise ValueError(f"`--out` must be a file in a folder that is there, got {path}")


def check_folder(path: Path) -> None:
    """Raise `ValueError`, before the work, if the folder neither exists nor can be made. It is not made here."""
    nearest = next(place for place in (path, *path.absolute().parents) if place.exists())
    if not (nearest.is_dir() and os.access(nearest, os.W_OK)):
        raise ValueError(f"`--out` must be a folder that can be made, got {path}")


def end(results: Iterable[tuple[str, str]]) -> None:
    """Exit with code 3 if a search did not converge, for example at its limit of steps.

    **Arguments:** pairs of what was searched and how the search ended.
    """
    from .printing import warn

    ended = [f"{what} {word}" for what, word in results if word not in ("successful", "poor_fit")]
    if ended:
        warn(f"a search did not come to its end: {', '.join(ended)}")
        raise typer.Exit(3)


def refuse(context: Context, options: tuple[str, ...], beside: str) -> None:
    """Raise `ValueError` if one of `options` is on the command line although `beside` replaces it."""
    for held in options:
        source = context.get_parameter_source(held)
        if source is not None and source.name == "COMMANDLINE":
            raise ValueError(f"`--{held.replace('_', '-')}` must be left out with {beside}")
