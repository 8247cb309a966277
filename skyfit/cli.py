"""The command line: simulate a sky, refit Preetham's coefficients, invert a measured sky, predict from a fit."""

import os
import sys
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import jax
import numpy as np
import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from .atmosphere import Aerosol, Atmosphere, Ground, HenyeyGreenstein, Ozone, turbidity_to_optical_depth
from .draw import plot, plot_skies
from .files import (
    load,
    read,
    read_directions,
    save,
    write_coefficients,
    write_prediction,
    write_sky,
)
from .fit import (
    check_free,
    DEFAULT_FREE,
    Fit,
    invert,
    model_xyz,
    PARAMETERS,
    predict,
    Refit,
    refit,
    SkyModel,
    start_model,
    station_pressure,
    time_names,
    with_values,
)
from .scene import Directions, hemisphere, Scene, Sky
from .transport import AbstractSolver, DoubleScattering, OrdersOfScattering, Shells, SingleScattering, Uniform


app = typer.Typer(
    add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None,
    help="A differentiable daylight sky: simulate it, fit it, refit Preetham's model.",
)  # fmt: skip
console = Console()
notices = Console(stderr=True)


class SolverName(StrEnum):
    """Transport solvers by their short names."""

    orders = "orders"
    double = "double"
    single = "single"
    shells = "shells"
    uniform = "uniform"


class PresetName(StrEnum):
    """How finely a solver resolves."""

    draft = "draft"
    normal = "normal"
    fine = "fine"


class GeometryName(StrEnum):
    """The shape of the Earth."""

    flat = "flat"
    spherical = "spherical"


SolverOption = Annotated[
    SolverName, typer.Option(help="all orders of scattering, two, one, Klassen's shells, Hoffman's uniform air")
]
PresetOption = Annotated[PresetName, typer.Option(help="resolution of the solver")]
GeometryOption = Annotated[GeometryName, typer.Option(help="curved paths, or a flat Earth")]
OutFolder = Annotated[Path, typer.Option("--out", help="folder for the results")]
Latitude = Annotated[float | None, typer.Option(help="degrees north, if the file does not tell")]
Longitude = Annotated[float | None, typer.Option(help="degrees east, if the file does not tell")]
UtcOffset = Annotated[float | None, typer.Option(help="hours of local time ahead of UTC (EDT: -4)")]
Altitude = Annotated[float | None, typer.Option(help="of the station, metres")]
FreeOption = Annotated[str, typer.Option(help=f"with commas, of: {', '.join(PARAMETERS)}")]
DEFAULT_FREE_TEXT = ",".join(DEFAULT_FREE)
LineShape = Annotated[float | None, typer.Option(help="Gaussian line shape of the instrument, nm")]


def _solver(name: SolverName, preset: PresetName, geometry: GeometryName) -> AbstractSolver:
    kinds = {
        SolverName.orders: OrdersOfScattering,
        SolverName.double: DoubleScattering,
        SolverName.single: SingleScattering,
        SolverName.shells: Shells,
        SolverName.uniform: Uniform,
    }
    return getattr(kinds[name], preset.value)(geometry.value)


@contextmanager
def _progress(title: str):
    """A bar on standard error; yields `progress(done, of)`."""
    columns = SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
    with Progress(*columns, console=notices, transient=True) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, of: bar.update(task, completed=done, total=of)


def _table(title: str) -> Table:
    return Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)


def _wavelengths(text: str) -> np.ndarray:
    """Wavelengths from "first:last:step" or a list with commas, nm."""
    try:
        parts = np.array([float(part) for part in text.split(":" if ":" in text else ",")])
    except ValueError:
        parts = np.array([np.nan])
    if not np.all(np.isfinite(parts)):
        raise ValueError(f"`--wavelengths` must be first:last:step or a list in nm, got {text!r}")
    if ":" not in text:
        if np.any(np.diff(parts) <= 0.0):
            raise ValueError(f"`--wavelengths` must increase, got {text!r}")
        return parts
    if parts.size != 3 or parts[2] <= 0.0 or not 0.0 <= parts[1] - parts[0] <= 1e4 * parts[2]:
        raise ValueError(f"`--wavelengths` must be first:last:step in nm, 10000 steps at most, got {text!r}")
    return np.arange(parts[0], parts[1] + 0.5 * parts[2], parts[2])


def _in_range(name: str, value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise ValueError(f"`{name}` must be between {low:g} and {high:g}, got {value:g}")
    return value


@app.command()
def simulate(
    out: Annotated[Path, typer.Option(help="file to write, .nc or .csv")],
    sun_zenith: Annotated[float, typer.Option(help="degrees")],
    sun_azimuth: Annotated[float, typer.Option(help="degrees clockwise from north")] = 180.0,
    turbidity: Annotated[float | None, typer.Option(help="Preetham's, at 550 nm (>= 1)")] = None,
    aerosol_optical_depth: Annotated[float | None, typer.Option(help="at 550 nm, instead")] = None,
    angstrom_exponent: float = 1.3,
    single_scattering_albedo: float = 0.95,
    asymmetry: float = 0.7,
    ground_albedo: float = 0.1,
    ozone: Annotated[float, typer.Option(help="Dobson units")] = 300.0,
    wavelengths: Annotated[str, typer.Option(help="nm, first:last:step or a,b,c")] = "380:780:10",
    directions: Annotated[Path | None, typer.Option(help="CSV with view_zenith, view_azimuth")] = None,
    fwhm: LineShape = None,
    solver: SolverOption = SolverName.orders,
    preset: PresetOption = PresetName.normal,
    geometry: GeometryOption = GeometryName.spherical,
):
    """Simulate the spectral radiance of a clear sky."""
    if (turbidity is None) == (aerosol_optical_depth is None):
        raise ValueError("exactly one of `--turbidity` and `--aerosol-optical-depth` must be given")
    if turbidity is not None:
        depth = turbidity_to_optical_depth(_in_range("--turbidity", turbidity, 1.0, 50.0))
    elif aerosol_optical_depth is not None:
        depth = _in_range("--aerosol-optical-depth", aerosol_optical_depth, 0.0, 5.0)
    _in_range("--sun-zenith", sun_zenith, 0.0, 90.0)
    if out.suffix not in (".nc", ".csv") or not out.absolute().parent.is_dir():
        raise ValueError(f"`--out` must be a .nc or .csv file in a folder that is there, got {out}")
    aerosol = Aerosol(
        optical_depth=depth,
        angstrom_exponent=_in_range("--angstrom-exponent", angstrom_exponent, -1.0, 4.0),
        single_scattering_albedo=_in_range("--single-scattering-albedo", single_scattering_albedo, 0.0, 1.0),
        phase=HenyeyGreenstein(_in_range("--asymmetry", asymmetry, -0.98, 0.98)),
    )
    atmosphere = Atmosphere(
        aerosol=aerosol,
        ozone=Ozone(column=_in_range("--ozone", ozone, 0.0, 1000.0)),
        ground=Ground(albedo=_in_range("--ground-albedo", ground_albedo, 0.0, 1.0)),
    )
    view = hemisphere(343) if directions is None else Directions(*read_directions(directions))
    spectrum = _wavelengths(wavelengths)
    scene = Scene.from_degrees(sun_zenith, view, spectrum, sun_azimuth, fwhm_nm=fwhm)
    with _progress("simulating"):
        radiance = np.asarray(_solver(solver, preset, geometry).radiance(atmosphere, scene), float)
    sky = Sky(
        radiance=radiance[None], sigma=None, usable=np.isfinite(radiance[None]),
        view_zenith=np.asarray(view.zenith), view_azimuth=np.asarray(view.azimuth), wavelength_nm=spectrum,
        sun_zenith=np.radians([sun_zenith]), sun_azimuth=np.radians([sun_azimuth]),
        time=np.array(["NaT"], "datetime64[ns]"), fwhm_nm=np.nan if fwhm is None else fwhm, altitude_m=0.0,
        source=out.name,
    )  # fmt: skip
    write_sky(sky, out)
    console.print(f"{out}: {radiance.shape[0]} directions, {radiance.shape[1]} wavelengths", highlight=False)


@app.command("refit")
def refit_command(
    out: OutFolder,
    directions: Annotated[int, typer.Option(help="over the sky, as many for each")] = 343,
    solver: SolverOption = SolverName.orders,
    preset: PresetOption = PresetName.normal,
    geometry: GeometryOption = GeometryName.spherical,
):
    """Refit Preetham's coefficients against skies simulated on the spot."""
    _in_range("--directions", directions, 20, 100000)
    _check_folder(out)
    with _progress("simulating 60 skies and fitting") as report:
        result = refit(_solver(solver, preset, geometry), directions=directions, progress=report)
    out.mkdir(parents=True, exist_ok=True)
    write_coefficients(result, out / "coefficients.json")
    _draw_refit(result, out / "skies.png")
    _print_refit(result)
    console.print(f"written: {out / 'coefficients.json'}, {out / 'skies.png'}", highlight=False)


def _print_refit(result: Refit) -> None:
    names = tuple(result.luminance_error)
    table = _table("Median luminance error of each sky, %, view zenith to 80 degrees")
    for heading in ("sun zenith", "turbidity", *names):
        table.add_column(heading, justify="right")
    for i, sun in enumerate(np.degrees(result.sun_zenith)):
        errors = (f"{100.0 * result.luminance_error[n][i]:.1f}" for n in names)
        table.add_row(f"{sun:.1f}", f"{result.turbidity[i]:g}", *errors)
    table.add_section()
    overall = (f"{100.0 * result.overall[n][0]:.1f}" for n in names)
    table.add_row("all skies", "", *overall, style="bold")
    chromaticity = (f"{result.overall[n][1]:.4f}" for n in names)
    table.add_row("xy distance", "", *chromaticity)
    console.print(table)
    for quantity, word in result.result.items():
        if word != "successful":
            console.print(f"the joint fit of {quantity} ended with: {word}", highlight=False)


def _draw_refit(result: Refit, path: Path) -> None:
    chosen = [(22.5, 2.0), (45.0, 3.0), (60.0, 4.0), (75.0, 6.0)]
    rows, suns = [], []
    published, refitted = model_xyz(result.published, result), model_xyz(result.refitted, result)
    for sun, haze in chosen:
        i = np.argmin(np.abs(np.degrees(result.sun_zenith) - sun) + 100.0 * np.abs(result.turbidity - haze))
        label = f"sun zenith {np.degrees(result.sun_zenith[i]):.0f}, T {result.turbidity[i]:g}"
        columns = {"simulated": result.simulated[i], "published": published[i], "refitted": refitted[i]}
        rows.append((label, columns))
        suns.append((float(result.sun_zenith[i]), 0.0))
    plot_skies(result.view, rows, path, suns)


@app.command("invert")
def invert_command(
    sky: Annotated[Path, typer.Argument(help="NetCDF, CSV or a folder of ASD text exports")],
    out: OutFolder,
    free: FreeOption = DEFAULT_FREE_TEXT,
    fix: Annotated[list[str] | None, typer.Option(help="name=value of a parameter that is known")] = None,
    latitude: Latitude = None,
    longitude: Longitude = None,
    utc_offset: UtcOffset = None,
    altitude: Altitude = None,
    fwhm: LineShape = None,
    solver: SolverOption = SolverName.orders,
    preset: PresetOption = PresetName.normal,
    geometry: GeometryOption = GeometryName.spherical,
):
    """Recover turbidity or aerosol optical depth, and more, from a measured sky."""
    names = tuple(name.strip() for name in free.split(",") if name.strip())
    measured = _read(sky, latitude, longitude, utc_offset, altitude, fwhm)
    start = _start(names, fix or [], measured)
    _check_folder(out)
    with _progress("compiling and fitting") as report:
        fit = invert(measured, names, _solver(solver, preset, geometry), start, progress=report)
    out.mkdir(parents=True, exist_ok=True)
    save(fit, out / "fit.json")
    save(fit, out / "fit.nc")
    plot(fit, out / "fit.png")
    _print_fit(fit)
    written = ", ".join(str(out / f"fit.{end}") for end in ("json", "nc", "png"))
    console.print(f"written: {written}", highlight=False)


def _start(free: tuple[str, ...], fix: list[str], sky: Sky) -> SkyModel:
    """The first guess, with the values that the user knows."""
    start = start_model(free, station_pressure(sky)[0])
    check_free(free, start)
    known: dict[str, float] = {}
    for name, value in map(_known, fix):
        if name in known or name in free:
            raise ValueError(f"`--fix` must name each parameter once and none of `--free`, got {name!r}")
        known[name] = value
    try:
        check_free((*free, *known), start)
    except ValueError as error:
        raise ValueError(f"`--fix` with `--free`: {error}") from None
    return with_values(start, tuple(known), list(known.values()))


def _known(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    if name not in PARAMETERS:
        raise ValueError(f"`--fix` must name a parameter among {', '.join(PARAMETERS)}; got {name!r}")
    try:
        number = float(value)
    except ValueError:
        raise ValueError(f"`--fix` must be name=value with a number, got {text!r}") from None
    return name, _in_range(f"--fix {name}", number, PARAMETERS[name].lower, PARAMETERS[name].upper)


def _print_fit(fit: Fit) -> None:
    count = len(fit.sky.time)
    scans = _table(f"{fit.sky.source}: {count} {'sky' if count == 1 else 'skies'}")
    headings = ("time (UTC)", "sun zenith", "azimuth", "RMSE mW", "chi2", "steps", "result")
    for heading in headings:
        scans.add_column(heading, justify="right", no_wrap=True)
    for t, name in enumerate(time_names(fit.sky)):
        angles = (f"{np.degrees(angle[t]):.2f}" for angle in (fit.sky.sun_zenith, fit.sky.sun_azimuth))
        numbers = f"{1e3 * fit.rmse[t]:.2f}", f"{fit.reduced_chi_square[t]:.2f}", f"{fit.steps[t]}"
        scans.add_row(name.replace("T", " ").removesuffix(":00Z"), *angles, *numbers, fit.result[t])
    console.print(scans)
    console.print(
        f"RMSE over all: {1e3 * fit.total_rmse:.2f} mW m-2 sr-1 nm-1 ({int(fit.used.sum())} samples)",
        highlight=False,
    )
    for t, name in enumerate(time_names(fit.sky)):
        values = _table(name)
        for heading in ("parameter", "value", "sigma", "unit", "remarks"):
            values.add_column(heading, justify="right" if heading in ("value", "sigma") else "left")
        for p, parameter in enumerate(fit.free):
            flags = ["at bound"] * bool(fit.at_bound[t, p]) + ["not determined"] * (not fit.determined[t, p])
            values.add_row(
                parameter, f"{fit.values[t, p]:.5g}", f"{fit.sigma[t, p]:.2g}", PARAMETERS[parameter].unit,
                ", ".join(flags),
            )  # fmt: skip
        console.print(values)
        open_ends = fit.undetermined[t] or ("all of these are determined by the data",)
        for sentence in open_ends:
            console.print(f"  {sentence}", highlight=False)
    held = (f"{name} {value:.5g} {PARAMETERS[name].unit}".removesuffix(" 1") for name, value in fit.fixed.items())
    console.print(f"held fixed: {', '.join(held)}", highlight=False)
    for note in fit.notes:
        console.print(f"note: {note}", highlight=False)
    for reason, count in fit.sky.masked.items():
        console.print(f"masked: {count} samples {reason}", highlight=False)


@app.command("predict")
def predict_command(
    fit: Annotated[Path, typer.Argument(help="fit.json of skyfit invert")],
    at: Annotated[Path, typer.Option(help="a sky whose times, directions and wavelengths are wanted")],
    out: Annotated[Path, typer.Option(help="NetCDF file to write")],
    latitude: Latitude = None,
    longitude: Longitude = None,
    utc_offset: UtcOffset = None,
    altitude: Altitude = None,
):
    """Predict the radiance of fitted skies in other directions or at other wavelengths."""
    fitted = load(fit)
    sky = _read(at, latitude, longitude, utc_offset, altitude, None)
    with _progress("predicting"):
        radiance = predict(fitted, sky)
    write_prediction(sky, radiance, out)
    console.print(f"{out}: {' x '.join(map(str, radiance.shape))} (time, direction, wavelength)", highlight=False)


def _read(path: Path, latitude, longitude, utc_offset, altitude, fwhm) -> Sky:
    return read(path, latitude=latitude, longitude=longitude, utc_offset=utc_offset, altitude=altitude, fwhm_nm=fwhm)


def _check_folder(path: Path) -> None:
    """Before the work: whether the folder is there or can be made; it is made when there is something to write."""
    nearest = next(place for place in (path, *path.absolute().parents) if place.exists())
    if not (nearest.is_dir() and os.access(nearest, os.W_OK)):
        raise ValueError(f"`--out` must be a folder that can be made, got {path}")


def main() -> None:
    """The entry point: double precision, a persistent compilation cache, one-line errors with exit code 2."""
    jax.config.update("jax_enable_x64", True)
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "skyfit"
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    try:
        app()
    except (ValueError, OSError) as error:
        notices.print(f"skyfit: {error}", style="red", highlight=False, markup=False, soft_wrap=True)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
