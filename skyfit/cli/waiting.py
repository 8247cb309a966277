"""Estimate of a call's duration from earlier similar calls; durations are stored beside the compiled programs."""

import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


# Shorter durations are not reported, s
_SHORT = 2.0
_FILE = "durations.json"


@contextmanager
def waiting(kind: str, size: str) -> Iterator[str]:
    """Yield a text for the title of the work, and store how long the block took if it succeeds.

    **Arguments:** `kind` of call, "" to store nothing; `size`: each size needs programs of its own.
    """
    folder = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    if not kind or folder is None:
        yield ""
        return
    known, before, began = _read(Path(folder)), _programs(Path(folder)), time.monotonic()
    yield _words(known[kind] if _is_entry(known.get(kind)) else {}, size)
    took = time.monotonic() - began
    compiled = _programs(Path(folder)) != before
    # Another process may have stored durations in the meantime
    known = _read(Path(folder))
    if not _is_entry(known.get(kind)):
        known[kind] = {"compiled": None, "sizes": {}}
    entry = known[kind]
    if compiled:
        entry["compiled"] = took
    # A call that compiled will be faster the next time
    entry["sizes"][size] = None if compiled else took
    from ..measured import atomic

    # If the folder is not writable only the estimate is lost
    with suppress(OSError, ValueError):
        Path(folder).mkdir(parents=True, exist_ok=True)
        with atomic(Path(folder) / _FILE) as part:
            part.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")


def _is_entry(known: object) -> bool:
    """Whether `known` has the structure that `waiting` stores; entries of foreign files are ignored."""
    if not isinstance(known, dict) or not isinstance(known.get("sizes"), dict):
        return False
    return all(isinstance(v, float | None) for v in (known.get("compiled"), *known["sizes"].values()))


def _words(known: dict, size: str) -> str:
    compiled, again = known.get("compiled"), known.get("sizes", {}).get(size)
    if again is not None:
        return f", {_about(again)} as before" if again > _SHORT else ""
    if size in known.get("sizes", {}):
        return "" if compiled is None else f", less than the {compiled:.0f} s of the first time"
    first = ", compiling, which is kept for the next time"
    return first if compiled is None or compiled < _SHORT else f", compiling: {_about(compiled)} the last time it did"


def _about(seconds: float) -> str:
    return f"about {seconds:.0f} s"


def _read(folder: Path) -> dict:
    try:
        return dict(json.loads((folder / _FILE).read_text(encoding="utf-8")))
    # A truncated or foreign file is ignored
    except (OSError, ValueError, TypeError):
        return {}


def _programs(folder: Path) -> set[str]:
    """The files of compiled programs in a folder."""
    return {path.name for path in folder.glob("*") if path.name != _FILE and not path.name.endswith("-atime")}
