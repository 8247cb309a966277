"""The command line: simulate a sky, refit Preetham's coefficients, convert and invert a measured sky, predict."""

import os
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from . import convert, export, invert, perez, refit, render, sensitivity, simulate
from .options import app


# importing a command registers it
_COMMANDS = (simulate, render, refit, export, convert, invert, perez, sensitivity)
# These flags halve the compile time, and the programs run as fast. XLA aborts on an unknown flag, so they are used only
# with the jaxlib on which they were tested
_FLAGS = "--xla_cpu_use_fusion_emitters=false", "--xla_backend_optimization_level=1"
_TRIED_ON = "0.10.2"


def _print_version(asked: bool | None) -> None:
    if asked:
        print(version("skyfit"))
        raise typer.Exit


@app.callback()
def _program(
    shown: Annotated[
        bool | None, typer.Option("--version", callback=_print_version, is_eager=True, help="the version, and no more")
    ] = None,
) -> None:
    """What holds for all commands."""


def main() -> None:
    """The entry point: double precision, a persistent compilation cache, one-line errors with exit code 2."""
    # Show only fatal messages: XLA would ask users to report long compilations
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "skyfit"
    # Settings of JAX, which a command loads when it runs
    os.environ.update(
        JAX_ENABLE_X64="1",
        JAX_COMPILATION_CACHE_DIR=str(cache),
        JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS="0.2",
    )
    if version("jaxlib") == _TRIED_ON:
        given = os.environ.get("XLA_FLAGS", "")
        more = (flag for flag in _FLAGS if flag.partition("=")[0] not in given)
        os.environ["XLA_FLAGS"] = " ".join([given, *more]).strip()
    try:
        app()
    except (ValueError, OSError, ModuleNotFoundError) as error:
        from .printing import complain

        complain(str(error))
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
