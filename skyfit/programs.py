"""Compiled programs kept between processes, to avoid tracing and lowering them again."""

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
    """The folder in which this process keeps programs (None: nowhere), and the programs it has made or read."""

    folder: Path | None = None
    sources: str = ""
    programs: dict[str, Callable] = {}


def keep_in(folder: str | os.PathLike | None) -> None:
    """Keep programs of `kept` functions in a folder from now on, which may be XLA's cache; None: keep none."""
    _Shelf.folder = None if folder is None else Path(folder)
    # Digest of the sources loaded now, because the files may change later
    _Shelf.sources = "" if folder is None else _sources_digest()
    _Shelf.programs = {}


def kept(function: Callable, answer: Callable[..., Any], **compiling: Any) -> Callable:
    """`function` compiled; programs are read from the folder of `keep_in` or, if absent, written there.

    **Arguments:** `function` takes trees of arrays and static values and returns arrays; `answer` takes the same
    arguments and returns any tree of the same structure as the result; `compiling`, options of `jax.jit`.
    **Returns:** a function of the same arguments; with traced arguments it is `function` itself.
    **Valid:** a program belongs to one state of skyfit's sources and of the libraries it uses, one backend and
    precision, and one structure, shape and static part of the arguments; its name encodes all of them.
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
                # If the folder is not writable the program is not kept, but the result is the same
                with suppress(OSError, ValueError):
                    _leave(program, _Shelf.folder, name)
            _Shelf.programs[name] = jax.jit(program.call, **compiling)
        return jax.tree.unflatten(expected, _Shelf.programs[name](*leaves))

    return call


def _read(path: Path) -> export.Exported | None:
    try:
        return export.deserialize(bytearray(path.read_bytes()))
    # A truncated or foreign file is no program, and its reader may raise any exception
    except Exception:
        return None


def _leave(program: export.Exported, folder: Path, name: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with atomic(folder / f"{name}.exported") as part:
        part.write_bytes(program.serialize())
    # Programs of other sources will not be used again
    function, sources, _ = name.rsplit("-", 2)
    for old in folder.glob(f"{function}-*.exported"):
        if not old.name.startswith(f"{function}-{sources}-"):
            old.unlink(missing_ok=True)


def _sources_digest() -> str:
    """Digest of skyfit's files, of the versions of the libraries it uses, and of the backend."""
    files = sorted((str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in _sources())
    beneath = [version(name) for name in ("jax", "jaxlib", "equinox", "optimistix")]
    return _digest((files, beneath, jax.default_backend()))


def _sources():
    """All files that affect a program: skyfit's modules and tables."""
    yield from _PACKAGE.rglob("*.py")
    yield from data_path("astm_g173_extraterrestrial.csv").parent.glob("*.*")


def _digest(of: object) -> str:
    return hashlib.sha256(repr(of).encode()).hexdigest()[:16]
