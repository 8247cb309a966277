"""The command line: simulate a sky, refit Preetham's coefficients, invert a measured sky, predict from a fit."""

import os
import sys
from pathlib import Path

import jax

from . import invert, refit, simulate
from .options import app, notices


# importing a command registers it
_COMMANDS = (simulate, refit, invert)


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
