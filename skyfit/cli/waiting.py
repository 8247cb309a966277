"""How long a call will take: as long as the like of it took here before, which is kept beside the programs."""

import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


# s: less is no wait
_SHORT = 2.0
_FILE = "durations.json"


@contextmanager
def waiting(kind: str, size: str) -> Iterator[str]:
    """Yields words to go with the title of the work, and keeps how long the block took if it succeeds.

    **Arguments:** `kind` of call, "" of which nothing is kept; `size`, of which programs are compiled anew.
    """
    folder = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    if not kind or folder is None:
        yield ""
        return
    known, before, began = _read(Path(folder)), _programs(Path(folder)), time.monotonic()
    yield _words(known[kind] if _is_entry(known.get(kind)) else {}, size)
    took = time.monotonic() - began
    compiled = _programs(Path(folder)) != before
    # another process may have kept some of its own in the meantime
    known = _read(Path(folder))
    if not _is_entry(known.get(kind)):
        known[kind] = {"compiled": None, "sizes": {}}
    entry = known[kind]
    if compiled:
        entry["compiled"] = took
    # what compiled once is quicker the next time
    entry["sizes"][size] = None if compiled else took
    from ..measured import atomic

    # a folder that cannot be written to costs the estimate, no result
    with suppress(OSError, ValueError):
        Path(folder).mkdir(parents=True, exist_ok=True)
        with atomic(Path(folder) / _FILE) as part:
            part.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")


def _is_entry(known: object) -> bool:
    """Whether it is what `waiting` keeps: of a foreign file nothing is told."""
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
    # a file that is cut or foreign tells nothing
    except (OSError, ValueError, TypeError):
        return {}


def _programs(folder: Path) -> set[str]:
    """The files of compiled programs in a folder."""
    return {path.name for path in folder.glob("*") if path.name != _FILE and not path.name.endswith("-atime")}
