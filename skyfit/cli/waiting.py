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
    yield _words(known.get(kind, {}), size)
    took = time.monotonic() - began
    compiled = _programs(Path(folder)) != before
    # another process may have kept some of its own in the meantime
    known = _read(Path(folder))
    entry = known.setdefault(kind, {"compiled": None, "sizes": {}})
    if compiled:
        entry["compiled"] = took
    # what compiled once is quicker the next time
    entry["sizes"][size] = None if compiled else took
    # a folder that cannot be written to costs the estimate, no result
    with suppress(OSError):
        (Path(folder) / _FILE).write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")


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
