"""`skyfit refit`."""

from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, TYPE_CHECKING

import typer

from .known import SEA_LEVEL_PRESSURE
from .options import (
    AngstromExponent,
    AtmosphereOption,
    check_folder,
    command,
    Context,
    end,
    GeometryName,
    GeometryOption,
    GroundAlbedo,
    HazeHeight,
    in_range,
    OF_ATMOSPHERES,
    OutFolder,
    OzoneColumn,
    PresetName,
    PresetOption,
    Pressure,
    refuse,
    SingleScatteringAlbedo,
    SolverOption,
    ToleranceOption,
)


if TYPE_CHECKING:
    from ..atmosphere import Atmosphere


class FormName(StrEnum):
    """How the coefficients follow turbidity and sun."""

    linear = "linear"
    extended = "extended"


class HazeName(StrEnum):
    """Phase functions of the haze by their short names."""

    bullrich = "bullrich"
    henyey_greenstein = "henyey-greenstein"


_OUT_FILES = ("coefficients.json", "errors.png", "skies.png")


@command("refit", "skyfit refit --out refit --form extended")
def refit_command(
    context: Context,
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
    atmosphere: AtmosphereOption = None,
    solver: SolverOption = "orders",
    preset: PresetOption = PresetName.normal,
    geometry: GeometryOption = GeometryName.spherical,
    flat_below: Annotated[
        float | None, typer.Option(help="degrees: flat for views and suns nearer to the zenith (the paper: 70)")
    ] = None,
    tolerance: ToleranceOption = None,
):
    """Refit Preetham's coefficients against skies simulated on the spot.

    Of the atmosphere of a file the optical depth of `aerosol` follows turbidity; all else in it stays.

    Exit code 3 if the fit did not come to its end: the files are written, and the report names what did not.
    """
    import json

    import numpy as np

    from ..analytic import refit
    from ..analytic.refit import (
        EXTENDED_SUN_ZENITH_DEG,
        EXTENDED_TURBIDITY,
        SUN_ZENITH_DEG,
        TURBIDITY,
        WAVELENGTH_NM,
    )
    from ..atmosphere import describe, HenyeyGreenstein, Tabulated, turbidity_to_optical_depth
    from ..draw import plot_refit
    from ..extras import require
    from ..records import write_coefficients
    from ..scene import hemisphere, Scene
    from ..transport.choose import choose_for_all
    from .chosen import allowed_of, print_choice, record_of
    from .models import atmosphere_of, make_atmosphere, make_solver, settings_of
    from .printing import give, progress, written
    from .refit_report import draw_skies, print_refit

    in_range("--directions", directions, 20, 100000)
    allowed = allowed_of(context, solver, tolerance, ("preset", "geometry", "flat_below"))
    if flat_below is not None:
        in_range("--flat-below", flat_below, 0.0, 85.0)
    given = {name: value for name, value in context.params.items() if name not in ("out", "atmosphere")}
    if atmosphere is None:
        kind, lobe = _haze(form, haze, asymmetry)
        given |= {"haze": kind, "asymmetry": lobe}
        by_depth = make_atmosphere(
            Tabulated.bullrich() if lobe is None else HenyeyGreenstein(lobe),
            angstrom_exponent, single_scattering_albedo, haze_height, ground_albedo, ozone, pressure,
        )  # fmt: skip
    else:
        held = ("haze", *OF_ATMOSPHERES)
        refuse(context, held, "`--atmosphere`, whose file holds it")
        air = atmosphere_of(atmosphere)
        by_depth = _by_depth(air, atmosphere)
        given = {name: value for name, value in given.items() if name not in held} | {"atmosphere": describe(air)}
    check_folder(out)
    require("matplotlib")
    choice = None
    if allowed is None:
        chosen = make_solver(solver, preset, geometry)
    else:
        suns, hazes = SUN_ZENITH_DEG, TURBIDITY
        if form is FormName.extended:
            suns, hazes = EXTENDED_SUN_ZENITH_DEG, EXTENDED_TURBIDITY
        dome, colours = hemisphere(directions), np.array(WAVELENGTH_NM)
        ends = [(sun, haze) for sun in (suns[0], suns[-1]) for haze in (hazes[0], hazes[-1])]
        skies = [
            (by_depth(turbidity_to_optical_depth(haze)), Scene.from_degrees(sun, dome, colours)) for sun, haze in ends
        ]
        choice = choose_for_all(skies, allowed)
        chosen, given["choice"] = choice.solver, record_of(choice)
    size = f"{directions}, {', '.join(by_depth(0.1).names)}"
    with progress("simulating skies and fitting", f"refit {form.value}, {settings_of(chosen)}", size) as report:
        result = refit(
            chosen, lambda turbidity: by_depth(turbidity_to_optical_depth(turbidity)),
            directions=directions, form=form.value, flat_below_deg=flat_below, progress=report,
        )  # fmt: skip
    out.mkdir(parents=True, exist_ok=True)
    coefficients, errors, skies = (out / name for name in _OUT_FILES)
    write_coefficients(result, coefficients, given)
    plot_refit(result, errors)
    draw_skies(result, skies, form.value)
    print_refit(result)
    if choice is not None:
        print_choice(choice)
    written([coefficients, errors, skies])
    give(json.loads(coefficients.read_text(encoding="utf-8")))
    end(result.result.items())


def _by_depth(air: "Atmosphere", path: Path) -> Callable:
    """A function from the haze's optical depth at 550 nm, maybe traced, to the file's atmosphere with that haze."""
    from ..atmosphere import Aerosol, TwoModeAerosol

    haze = air.aerosol if "aerosol" in air else None
    if not isinstance(haze, Aerosol | TwoModeAerosol):
        raise ValueError(f"`--atmosphere`: {path}: must hold an `aerosol` of one optical depth for a refit")
    return lambda depth: air.replace(aerosol=replace(haze, optical_depth=depth))


def _haze(form: FormName, haze: HazeName | None, asymmetry: float | None) -> tuple[HazeName, float | None]:
    """The phase function and its asymmetry, as given by the options or the default of the form."""
    if haze is HazeName.bullrich and asymmetry is not None:
        raise ValueError("`--asymmetry` must be left out with `--haze bullrich`, a table")
    usual = HazeName.bullrich if form is FormName.linear and asymmetry is None else HazeName.henyey_greenstein
    if (haze or usual) is HazeName.bullrich:
        return HazeName.bullrich, None
    return HazeName.henyey_greenstein, in_range("--asymmetry", 0.7 if asymmetry is None else asymmetry, -0.98, 0.98)
