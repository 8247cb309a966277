"""Programs kept between processes: what was traced and lowered once is only read the next time."""

import hashlib
import os
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax import export
from jax.core import Tracer

from .measured import atomic
from .tables import data_path


_PACKAGE = Path(__file__).resolve().parent


class _Shelf:
    """Where this process keeps programs, if anywhere, and those that it has made or read."""

    folder: Path | None = None
    sources: str = ""
    programs: dict[str, Callable] = {}


def keep_in(folder: str | os.PathLike | None) -> None:
    """Keeps programs of `kept` functions in a folder from now on, where XLA may keep its own; None: no more."""
    _Shelf.folder = None if folder is None else Path(folder)
    # of what is loaded now, whatever happens to the files later
    _Shelf.sources = "" if folder is None else _sources_digest()
    _Shelf.programs = {}


def kept(function: Callable, answer: Callable[..., Any], **compiling: Any) -> Callable:
    """`function` compiled, by the program that an earlier process left where `keep_in` says, or by one left there.

    **Arguments:** `function` of trees of numbers and of what is static, which gives arrays; `answer`, of the same
    arguments, any tree of the structure of what it gives; `compiling`, as `jax.jit` takes it.
    **Returns:** a function of the same arguments; of what is traced it is `function` itself.
    **Valid:** a program holds for one state of skyfit's sources and of what is beneath them, one backend and precision,
    and one structure, shape and static part of the arguments; its name says which.
    """
    plain = eqx.filter_jit(function, **compiling)

    def call(*given, **named):
        numbers, rest = eqx.partition((given, named), lambda v: isinstance(v, jax.Array | np.ndarray))
        leaves, structure = jax.tree.flatten(numbers)
        if any(isinstance(leaf, Tracer) for leaf in leaves):
            return function(*given, **named)
        if _Shelf.folder is None:
            return plain(*given, **named)
        shapes = [(leaf.shape, str(leaf.dtype)) for leaf in leaves]
        double = jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]
        asked = _digest((double, rest, structure, shapes))
        expected = jax.tree.structure(answer(*given, **named))

        def flat(*leaves):
            given, named = eqx.combine(jax.tree.unflatten(structure, leaves), rest)
            found = function(*given, **named)
            assert jax.tree.structure(found) == expected, f"{function.__name__} gives another structure than `answer`"
            return jax.tree.leaves(found)

        name = f"{function.__name__.strip('_')}-{_Shelf.sources}-{asked}"
        if name not in _Shelf.programs:
            program = _read(_Shelf.folder / f"{name}.exported")
            if program is None:
                program = export.export(jax.jit(flat))(*leaves)
                # a folder that cannot be written to costs time, no result
                with suppress(OSError, ValueError):
                    _leave(program, _Shelf.folder, name)
            _Shelf.programs[name] = jax.jit(program.call, **compiling)
        return jax.tree.unflatten(expected, _Shelf.programs[name](*leaves))

    return call


def _read(path: Path) -> export.Exported | None:
    try:
        return export.deserialize(bytearray(path.read_bytes()))
    # a file that is cut or foreign is no program, whatever its reader stumbles over
    except Exception:
        return None


def _leave(program: export.Exported, folder: Path, name: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with atomic(folder / f"{name}.exported") as part:
        part.write_bytes(program.serialize())
    # programs of other sources will not be asked for again
    function, sources, _ = name.rsplit("-", 2)
    for old in folder.glob(f"{function}-*.exported"):
        if not old.name.startswith(f"{function}-{sources}-"):
            old.unlink(missing_ok=True)


def _sources_digest() -> str:
    """Of skyfit's files, and of what is beneath them."""
    files = sorted((str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in _sources())
    beneath = [version(name) for name in ("jax", "jaxlib", "equinox", "optimistix")]
    return _digest((files, beneath, jax.default_backend()))


def _sources():
    """Every file of which a program is made: skyfit's modules and tables."""
    yield from _PACKAGE.rglob("*.py")
    yield from data_path("astm_g173_extraterrestrial.csv").parent.glob("*.*")


def _digest(of: object) -> str:
    return hashlib.sha256(repr(of).encode()).hexdigest()[:16]
