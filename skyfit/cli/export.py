"""`skyfit export`."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from .options import check_file, command, in_range


class LanguageName(StrEnum):
    """What an analytic sky is written in."""

    glsl = "glsl"
    hlsl = "hlsl"
    c = "c"
    python = "python"


@command("export", "skyfit export refit/coefficients.json --to glsl --out sky.glsl")
def export(
    context: typer.Context,
    sky: Annotated[
        str, typer.Argument(metavar="[extended|published|FILE]", help="analytic sky; FILE: coefficients.json of refit")
    ],
    out: Annotated[Path, typer.Option(help="file to write")],
    to: Annotated[LanguageName, typer.Option(help="language; numpy alone with python")],
    turbidity: Annotated[
        float | None, typer.Option(help="with --sun-zenith: of one sky, 18 numbers in place of the table")
    ] = None,
    sun_zenith: Annotated[float | None, typer.Option(help="degrees, with --turbidity")] = None,
):
    """Write an analytic sky as source code that needs no skyfit.

    The file says what its functions take, and holds one value to test them by.
    """
    check_file(out)
    if (turbidity is None) != (sun_zenith is None):
        raise ValueError("`--turbidity` and `--sun-zenith` must be given together, of one sky, or left out")
    import math

    import jax

    from ..records import write_evaluator
    from .models import analytic_of
    from .printing import give, say

    # shaders compute in float32
    context.with_resource(jax.enable_x64(False))
    model, down = analytic_of(sky), None
    if sun_zenith is not None:
        highest, lowest = map(math.degrees, model.fitted_sun)
        down = math.radians(in_range("--sun-zenith", sun_zenith, highest, lowest))
    write_evaluator(model, out, to.value, turbidity=turbidity, sun_zenith=down)
    lines = len(out.read_text().splitlines())
    say(f"{out}: {lines} lines of {to.value}")
    give({"file": str(out), "language": to.value, "lines": lines})
