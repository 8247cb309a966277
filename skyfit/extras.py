"""Check for optional dependencies. A fit of a table needs none of them."""

from importlib.util import find_spec


def require(*modules: str) -> None:
    """Check that modules can be imported.

    **Errors:** `ModuleNotFoundError` that names the missing modules and the extra that installs them.
    """
    lacking = [name for name in modules if not _is_there(name)]
    if lacking:
        raise ModuleNotFoundError(f"{' and '.join(lacking)} must be there: pip install 'skyfit[all]'", name=lacking[0])


def _is_there(module: str) -> bool:
    # colour-science may replace a missing module by a stub without a specification
    try:
        return find_spec(module) is not None
    except ValueError:
        return False
