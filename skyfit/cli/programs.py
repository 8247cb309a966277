"""Programs kept between calls of the command: what was traced and lowered once is only read the next time."""

import hashlib
from contextlib import suppress
from pathlib import Path

import jax
from jax import export
from jaxtyping import Array, Float

from ..atmosphere import Atmosphere
from ..measured import atomic
from ..scene import Scene
from ..tables import data_path
from ..transport import AbstractSolver, check_scene


_PACKAGE, _NAME = Path(__file__).resolve().parents[1], "radiance"


def kept_radiance(
    solver: AbstractSolver, atmosphere: Atmosphere, scene: Scene, folder: str | None
) -> Float[Array, "direction wavelength"]:
    """`solver.radiance(atmosphere, scene)` by the program that an earlier call left, else by one that is left here.

    **Arguments:** `folder` of such programs, where XLA's compiled code may be too, or None: then nothing is kept.
    **Returns:** W m^-2 sr^-1 nm^-1.
    **Valid:** a program holds for one state of skyfit's sources and of JAX, one backend, one solver, and one structure
    and shape of atmosphere and scene; its name says which.
    """
    if folder is None:
        return solver.radiance(atmosphere, scene)
    # what is traced is not checked
    check_scene(solver, atmosphere, scene)
    leaves, structure = jax.tree.flatten((atmosphere, scene))
    sources = _digest(sorted((str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in _sources()))
    shapes = [(leaf.shape, str(leaf.dtype)) for leaf in leaves]
    asked = _digest((jax.__version__, jax.default_backend(), solver, structure, shapes))
    path = Path(folder) / f"{_NAME}-{sources}-{asked}.exported"
    program = _read(path)
    if program is None:
        traced = jax.jit(lambda *given: solver.radiance(*jax.tree.unflatten(structure, given)))
        program = export.export(traced)(*leaves)
        # a folder that cannot be written to costs time, no result
        with suppress(OSError, ValueError):
            _leave(program, path, sources)
    return jax.jit(program.call)(*leaves)


def _read(path: Path) -> export.Exported | None:
    try:
        return export.deserialize(bytearray(path.read_bytes()))
    # a file that is cut or foreign is no program, whatever its reader stumbles over
    except Exception:
        return None


def _leave(program: export.Exported, path: Path, sources: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic(path) as part:
        part.write_bytes(program.serialize())
    # programs of other sources will not be asked for again
    for old in path.parent.glob(f"{_NAME}-*.exported"):
        if not old.name.startswith(f"{_NAME}-{sources}-"):
            old.unlink(missing_ok=True)


def _sources():
    """Every file of which a program is made: skyfit's modules and tables."""
    yield from _PACKAGE.rglob("*.py")
    yield from data_path("astm_g173_extraterrestrial.csv").parent.glob("*.*")


def _digest(of: object) -> str:
    return hashlib.sha256(repr(of).encode()).hexdigest()[:16]
