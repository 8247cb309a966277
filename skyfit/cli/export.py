"""`skyfit export`."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from .options import (
    check_file,
    check_folder,
    command,
    Context,
    GeometryName,
    in_range,
    PresetName,
    PresetOption,
    refuse,
)


class LanguageName(StrEnum):
    """What a sky is written in."""

    glsl = "glsl"
    hlsl = "hlsl"
    c = "c"
    python = "python"
    lut = "lut"


# Options for tables only
_OF_TABLES = ("preset", "height", "sun_azimuth", "azimuth", "elevation", "field_of_view")


@command("export", "skyfit export refit/coefficients.json --to glsl --out sky.glsl")
def export(
    context: Context,
    sky: Annotated[
        str,
        typer.Argument(
            metavar="[extended|published|spherical|FILE]",
            help="analytic sky, FILE: coefficients.json of refit; of lut: spherical, or an atmosphere, TOML or JSON",
        ),
    ],
    out: Annotated[Path, typer.Option(help="file to write; of lut a folder")],
    to: Annotated[LanguageName, typer.Option(help="language; numpy alone with python; lut: tables for engines, .exr")],
    turbidity: Annotated[
        float | None, typer.Option(help="with --sun-zenith: of one sky, 18 numbers in place of the table")
    ] = None,
    sun_zenith: Annotated[float | None, typer.Option(help="degrees, with --turbidity; of lut the sun")] = None,
    sun_azimuth: Annotated[float, typer.Option(help="degrees clockwise from north, of lut")] = 180.0,
    preset: PresetOption = PresetName.normal,
    height: Annotated[float, typer.Option(help="of the eye, m, of lut")] = 2.0,
    azimuth: Annotated[
        float | None,
        typer.Option(help="degrees, of the middle of the view that lut cuts  [default: the sun's]", show_default=False),
    ] = None,
    elevation: Annotated[float, typer.Option(help="degrees, of the same")] = 0.0,
    field_of_view: Annotated[float, typer.Option(help="degrees, of the same, 16 to 9")] = 70.0,
):
    """Write an analytic sky as source code that needs no skyfit, or tables of the air for an engine.

    Source says what its functions take, and holds one value to test them by; luts.json says how tables are read.
    """
    if to is LanguageName.lut:
        _write_tables(context, sky, out, turbidity, sun_zenith)
        return
    refuse(context, _OF_TABLES, f"`--to {to.value}`: it is of lut")
    check_file(out)
    if (turbidity is None) != (sun_zenith is None):
        raise ValueError("`--turbidity` and `--sun-zenith` must be given together, of one sky, or left out")
    import math

    import jax

    from ..records import write_evaluator
    from .models import analytic_of
    from .printing import give, say

    # Shaders compute in float32
    context.with_resource(jax.enable_x64(False))
    model, down = analytic_of(sky), None
    if sun_zenith is not None:
        highest, lowest = map(math.degrees, model.fitted_sun)
        down = math.radians(in_range("--sun-zenith", sun_zenith, highest, lowest))
    write_evaluator(model, out, to.value, turbidity=turbidity, sun_zenith=down)
    lines = len(out.read_text().splitlines())
    say(f"{out}: {lines} lines of {to.value}")
    give({"file": str(out), "language": to.value, "lines": lines})


def _write_tables(context: Context, sky: str, out: Path, turbidity: float | None, sun_zenith: float | None):
    """Write Hillaire's tables with the options of the command."""
    import json
    from math import radians

    import jax

    from ..atmosphere import Atmosphere
    from ..image import Camera, write_luts
    from ..transport import Spherical
    from .models import atmosphere_of, make_solver
    from .printing import give, progress, written

    check_folder(out)
    told = context.params
    solver = make_solver("spherical", told["preset"], GeometryName.spherical)
    assert isinstance(solver, Spherical)
    if sun_zenith is None:
        raise ValueError("`--sun-zenith` must be given with `--to lut`")
    sun = in_range("--sun-zenith", sun_zenith, 0.0, solver.suns.largest_deg)
    height = in_range("--height", told["height"], 0.0, 90e3)
    context.with_resource(jax.enable_x64(False))
    if sky == "spherical":
        air = Atmosphere.from_turbidity(in_range("--turbidity", 3.0 if turbidity is None else turbidity, 1.0, 50.0))
    elif turbidity is not None or not Path(sky).is_file():
        raise ValueError(
            f"the sky of `--to lut` must be spherical, or the file of an atmosphere without `--turbidity`, got {sky!r}"
        )
    else:
        air = atmosphere_of(Path(sky))
    ahead = told["sun_azimuth"] if told["azimuth"] is None else told["azimuth"]
    camera = Camera(
        "perspective", azimuth=radians(ahead), elevation=radians(told["elevation"]),
        field_of_view=radians(told["field_of_view"]),
    )  # fmt: skip
    with progress("solving"):
        write_luts(
            air, out, camera, solver, sun_zenith=radians(sun), sun_azimuth=radians(told["sun_azimuth"]), height=height
        )
    written([out / "luts.json"])
    give(json.loads((out / "luts.json").read_text(encoding="utf-8")))
