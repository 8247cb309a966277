"""`skyfit refit`."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ..analytic import Comparison, model_xyz, Refit, refit
from ..atmosphere import AbstractPhase, HenyeyGreenstein, SEA_LEVEL_PRESSURE, Tabulated, turbidity_to_optical_depth
from ..draw import plot_refit, plot_skies
from ..records import write_coefficients
from .options import (
    AngstromExponent,
    app,
    check_folder,
    console,
    GeometryName,
    GeometryOption,
    GroundAlbedo,
    HazeHeight,
    in_range,
    make_atmosphere,
    make_solver,
    OutFolder,
    OzoneColumn,
    PresetName,
    PresetOption,
    Pressure,
    progress,
    SingleScatteringAlbedo,
    SolverOption,
    table,
)


class FormName(StrEnum):
    """How the coefficients follow turbidity and sun."""

    linear = "linear"
    extended = "extended"


class HazeName(StrEnum):
    """Phase functions of the haze by their short names."""

    bullrich = "bullrich"
    henyey_greenstein = "henyey-greenstein"


# a table of more skies than this is one of suns
_MOST_ROWS = 100
_OUT_FILES = ("coefficients.json", "errors.png", "skies.png")
# sun zenith in degrees and turbidity of the skies that are drawn
_DRAWN = {
    FormName.linear: ((22.5, 2.0), (45.0, 3.0), (60.0, 4.0), (75.0, 6.0)),
    FormName.extended: ((30.0, 1.0), (60.0, 2.0), (77.0, 4.0), (85.5, 6.5), (91.0, 2.0)),
}


@app.command("refit")
def refit_command(
    context: typer.Context,
    out: OutFolder,
    form: Annotated[FormName, typer.Option(help="linear in turbidity as published, or T 1-10 and sun to 92")] = (
        FormName.linear
    ),
    directions: Annotated[int, typer.Option(help="over the sky, as many for each")] = 343,
    haze: Annotated[
        HazeName | None, typer.Option(help="phase function; else the paper's Bullrich, extended: henyey-greenstein")
    ] = None,
    asymmetry: Annotated[
        float | None, typer.Option(help="of henyey-greenstein, which it implies  [default: 0.7]")
    ] = None,
    angstrom_exponent: AngstromExponent = 1.3,
    single_scattering_albedo: SingleScatteringAlbedo = 0.95,
    haze_height: HazeHeight = 1200.0,
    ground_albedo: GroundAlbedo = 0.1,
    ozone: OzoneColumn = 300.0,
    pressure: Pressure = SEA_LEVEL_PRESSURE,
    solver: SolverOption = "orders",
    preset: PresetOption = PresetName.normal,
    geometry: GeometryOption = GeometryName.spherical,
    flat_below: Annotated[
        float | None, typer.Option(help="degrees: flat for views and suns nearer to the zenith (the paper: 70)")
    ] = None,
):
    """Refit Preetham's coefficients against skies simulated on the spot."""
    in_range("--directions", directions, 20, 100000)
    if flat_below is not None:
        in_range("--flat-below", flat_below, 0.0, 90.0)
    phase = _phase(form, haze, asymmetry)
    by_depth = make_atmosphere(
        phase, angstrom_exponent, single_scattering_albedo, haze_height, ground_albedo, ozone, pressure
    )
    check_folder(out)
    with progress("simulating skies and fitting") as report:
        result = refit(
            make_solver(solver, preset, geometry), lambda turbidity: by_depth(turbidity_to_optical_depth(turbidity)),
            directions=directions, form=form.value, flat_below_deg=flat_below, progress=report,
        )  # fmt: skip
    out.mkdir(parents=True, exist_ok=True)
    coefficients, errors, skies = (out / name for name in _OUT_FILES)
    write_coefficients(result, coefficients, _settings(context, phase))
    plot_refit(result, errors)
    _draw_skies(result, skies, _DRAWN[form])
    _print_refit(result)
    console.print(f"written: {coefficients}, {errors}, {skies}", highlight=False)


def _phase(form: FormName, haze: HazeName | None, asymmetry: float | None) -> AbstractPhase:
    """The haze's phase function: as named, of the asymmetry that was given, or the usual one of the form."""
    if haze is HazeName.bullrich and asymmetry is not None:
        raise ValueError("`--asymmetry` must be left out with `--haze bullrich`, a table")
    usual = HazeName.bullrich if form is FormName.linear and asymmetry is None else HazeName.henyey_greenstein
    if (haze or usual) is HazeName.bullrich:
        return Tabulated.bullrich()
    return HenyeyGreenstein(in_range("--asymmetry", 0.7 if asymmetry is None else asymmetry, -0.98, 0.98))


def _settings(context: typer.Context, phase: AbstractPhase) -> dict:
    """The options that made the skies, with the phase function that was meant."""
    henyey = isinstance(phase, HenyeyGreenstein)
    haze = HazeName.henyey_greenstein if henyey else HazeName.bullrich
    meant = {"haze": haze, "asymmetry": float(phase.asymmetry) if henyey else None}
    return {name: value for name, value in (context.params | meant).items() if name != "out"}


def _print_refit(result: Refit) -> None:
    names = tuple(result.fitted.luminance_error)
    rows = _table_rows(result.fitted)
    fitted = result.fitted
    each = table("Luminance error to view zenith 80, %: median / 95th percentile")
    for heading in ("sun zenith", "turbidity", *names):
        each.add_column(heading, justify="right")
    for sun, turbidity, chosen in rows:
        pairs = (
            _pair(_middle(fitted.luminance_error[n][chosen]), _middle(fitted.luminance_95[n][chosen])) for n in names
        )
        each.add_row(sun, turbidity, *pairs)
    console.print(each)
    total = table("All together: luminance error, % (median / 95th percentile); xy distance")
    for heading in ("skies", "of", *names):
        total.add_column(heading, justify="right" if heading in names else "left", no_wrap=True)
    for kind, errors in (
        ("fitted", fitted.overall),
        ("held out", result.held_out.overall),
        ("fitted, rest *", fitted.rest),
        ("held out, rest *", result.held_out.rest),
    ):
        total.add_row(kind, "luminance", *(_pair(errors[n].luminance, errors[n].luminance_95) for n in names))
        total.add_row("", "xy", *(_text(errors[n].chromaticity, 4) for n in names))
    console.print(total)
    console.print("* view zenith beyond 80 degrees or sun beyond 85", highlight=False)
    console.print("best five: Perez' formula fitted to each sky alone, what it can do at all", highlight=False)
    for quantity, word in result.result.items():
        if word != "successful":
            console.print(f"the joint fit of {quantity} ended with: {word}", highlight=False)


def _table_rows(skies: Comparison):
    """Sun, turbidity and which skies of a row: each sky, or each sun where they are many."""
    degrees = np.degrees(skies.sun_zenith)
    if degrees.size <= _MOST_ROWS:
        return [(f"{degrees[i]:.1f}", f"{skies.turbidity[i]:g}", [i]) for i in range(degrees.size)]
    every = f"{skies.turbidity.min():g}-{skies.turbidity.max():g}"
    return [(f"{sun:.1f}", every, np.isclose(degrees, sun)) for sun in np.unique(np.round(degrees, 6))]


def _middle(errors) -> float:
    known = np.asarray(errors)[np.isfinite(errors)]
    return float(np.median(known)) if known.size else np.nan


def _pair(median: float, high: float) -> str:
    return f"{_text(100.0 * median, 1)} / {_text(100.0 * high, 1)}"


def _text(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "-"


def _draw_skies(result: Refit, path: Path, chosen) -> None:
    fitted, degrees = result.fitted, np.degrees(result.fitted.sun_zenith)
    drawn = [int(np.argmin(np.abs(degrees - s) + 100.0 * np.abs(fitted.turbidity - t))) for s, t in chosen]
    models = {"published": result.published, "refitted": result.refitted}
    # a model without an answer in one of them would only be noise
    known = {n: m for n, m in models.items() if np.all(np.isfinite(fitted.luminance_error[n][drawn]))}
    answers = {n: model_xyz(m, result.view, fitted) for n, m in known.items()}
    rows = [
        (
            f"sun zenith {degrees[i]:.0f}, T {fitted.turbidity[i]:g}",
            {"simulated": fitted.simulated[i]} | {n: answer[i] for n, answer in answers.items()},
        )
        for i in drawn
    ]
    plot_skies(result.view, rows, path, [(float(fitted.sun_zenith[i]), 0.0) for i in drawn])
