"""`skyfit export`."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from .options import app


class LanguageName(StrEnum):
    """What an analytic sky is written in."""

    glsl = "glsl"
    hlsl = "hlsl"
    c = "c"
    python = "python"


@app.command()
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
    if not out.absolute().parent.is_dir() or out.is_dir():
        raise ValueError(f"`--out` must be a file in a folder that is there, got {out}")
    if (turbidity is None) != (sun_zenith is None):
        raise ValueError("`--turbidity` and `--sun-zenith` must be given together, of one sky, or left out")
    import math

    import jax

    from ..records import write_evaluator
    from .models import analytic_of, FORMULAS
    from .printing import console

    if sky not in FORMULAS and not Path(sky).is_file():
        raise ValueError(f"the sky must be one of {', '.join(FORMULAS)} or a coefficients.json, got {sky!r}")
    # shaders compute in float32
    context.with_resource(jax.enable_x64(False))
    down = None if sun_zenith is None else math.radians(sun_zenith)
    write_evaluator(analytic_of(sky), out, to.value, turbidity=turbidity, sun_zenith=down)
    console.print(f"{out}: {len(out.read_text().splitlines())} lines of {to.value}", highlight=False)
