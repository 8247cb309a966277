"""`skyfit invert` and `skyfit predict`."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ..draw import plot
from ..files import load, read, save, write_prediction
from ..fit import (
    check_free,
    DEFAULT_FREE,
    Fit,
    invert,
    PARAMETERS,
    predict,
    SkyModel,
    start_model,
    station_pressure,
    time_names,
    with_values,
)
from ..scene import Sky
from .options import (
    app,
    check_folder,
    console,
    GeometryName,
    GeometryOption,
    in_range,
    LineShape,
    make_solver,
    OutFolder,
    PresetName,
    PresetOption,
    progress,
    SolverName,
    SolverOption,
    table,
)


Latitude = Annotated[float | None, typer.Option(help="degrees north, if the file does not tell")]
Longitude = Annotated[float | None, typer.Option(help="degrees east, if the file does not tell")]
UtcOffset = Annotated[float | None, typer.Option(help="hours of local time ahead of UTC (EDT: -4)")]
Altitude = Annotated[float | None, typer.Option(help="of the station, metres")]
FreeOption = Annotated[str, typer.Option(help=f"with commas, of: {', '.join(PARAMETERS)}")]
DEFAULT_FREE_TEXT = ",".join(DEFAULT_FREE)


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
    check_folder(out)
    with progress("compiling and fitting") as report:
        fit = invert(measured, names, make_solver(solver, preset, geometry), start, progress=report)
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
    return name, in_range(f"--fix {name}", number, PARAMETERS[name].lower, PARAMETERS[name].upper)


def _print_fit(fit: Fit) -> None:
    count = len(fit.sky.time)
    scans = table(f"{fit.sky.source}: {count} {'sky' if count == 1 else 'skies'}")
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
        values = table(name)
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
    with progress("predicting"):
        radiance = predict(fitted, sky)
    write_prediction(sky, radiance, out)
    console.print(f"{out}: {' x '.join(map(str, radiance.shape))} (time, direction, wavelength)", highlight=False)


def _read(path: Path, latitude, longitude, utc_offset, altitude, fwhm) -> Sky:
    return read(path, latitude=latitude, longitude=longitude, utc_offset=utc_offset, altitude=altitude, fwhm_nm=fwhm)
