"""Which public names of skyfit lack a docstring or a place in the pages of the API."""

import inspect
import re
import types
from pathlib import Path

import skyfit


API = Path(__file__).resolve().parents[1] / "api"


def undocumented() -> list[str]:
    """Public names, and public methods of public classes, without a docstring of their own or inherited."""
    missing = []
    for name in skyfit.__all__:
        thing = getattr(skyfit, name)
        # a folder's pages are its names'; a dict's words are those of its class
        if isinstance(thing, (types.ModuleType, dict)):
            continue
        members = [m for m in vars(thing) if not m.startswith("_")] if inspect.isclass(thing) else []
        told = {name: thing} | {f"{name}.{m}": inspect.getattr_static(thing, m) for m in members}
        asked = (type, types.FunctionType, property, classmethod, staticmethod)
        for full, part in told.items():
            short = full.rpartition(".")[2]
            found = inspect.getdoc(getattr(thing, short) if part is not thing else thing)
            if isinstance(part, asked) and not found:
                missing.append(full)
    return missing


def without_a_page() -> list[str]:
    """Public names that no page of `docs/api/` shows."""
    pages = "\n".join(path.read_text(encoding="utf-8") for path in API.glob("*.md"))
    shown = set(re.findall(r"^::: skyfit\.[\w.]*?(\w+)$", pages, re.MULTILINE))
    named = [name for name in skyfit.__all__ if not isinstance(getattr(skyfit, name), types.ModuleType)]
    return [name for name in named if name not in shown]
