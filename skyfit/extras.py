"""What is installed only by those who ask for it: a fit of a table needs no more than the rest."""

from importlib.util import find_spec


def require(*modules: str) -> None:
    """Goes on where these modules can be imported.

    **Errors:** `ModuleNotFoundError` that names those that lack, and the extra that brings them.
    """
    lacking = [name for name in modules if not _is_there(name)]
    if lacking:
        raise ModuleNotFoundError(f"{' and '.join(lacking)} must be there: pip install 'skyfit[all]'", name=lacking[0])


def _is_there(module: str) -> bool:
    # what colour-science puts in the place of a module that lacks has no specification
    try:
        return find_spec(module) is not None
    except ValueError:
        return False
