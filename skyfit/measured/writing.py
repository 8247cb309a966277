"""Write a `Sky`, whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from uuid import uuid4

from .samples import Sky
from .writers import write_netcdf, write_tidy


_WRITERS = {".nc": write_netcdf, ".csv": write_tidy}


@contextmanager
def atomic(path: str | os.PathLike) -> Iterator[Path]:
    """Yield a temporary path beside `path` that replaces it once the block has succeeded.

    **Arguments** `path`: the file to write; an existing one is replaced.

    **Returns** (yields) a path of the same folder and suffix, removed if the block fails.

    **Valid** a regular file in a folder that exists; otherwise `ValueError`.
    """
    # A link stays a link: its target is replaced.
    target = Path(os.path.realpath(path))
    if not target.parent.is_dir():
        raise ValueError(f"{os.fspath(path)}: expected an existing folder to write to, found none")
    if target.exists() and not target.is_file():
        raise ValueError(f"{os.fspath(path)}: expected a file to write, found a folder or device")
    part = target.with_name(f".{target.stem}-{uuid4().hex[:12]}{target.suffix}")
    try:
        yield part
        os.replace(part, target)
    except OSError as error:
        reason = error.strerror or str(error)
        raise ValueError(f"{os.fspath(path)}: cannot be written: {reason}") from error
    finally:
        part.unlink(missing_ok=True)


def write_sky(sky: Sky, path: str | os.PathLike) -> None:
    """Write measured or simulated samples to a file that `read` reads back.

    **Arguments** `path`: `*.nc` (NetCDF 4) or `*.csv` (tidy table).

    **Valid** any other suffix is a `ValueError`; a failure leaves no file and keeps an old one.
    The reason of each masked sample is not written: it reads back as "suspect" unless its value
    shows the reason.

    **Example:**

        >>> sky = skyfit.read("data/skies/sample.nc")
        >>> skyfit.write_sky(sky, "sky.csv")
        >>> skyfit.read("sky.csv").radiance.shape
        (1, 94, 33)
    """
    target = Path(path)
    writer = _WRITERS.get(target.suffix.lower())
    if writer is None:
        raise ValueError(f"{target.name}: expected a suffix of {', '.join(_WRITERS)}, found {target.suffix!r}")
    with atomic(target) as part:
        try:
            writer(sky, part)
        except ValueError as error:
            raise ValueError(f"{target.name}: {error}") from error


def skyfit_version() -> str | None:
    """The installed version of the package, None for a bare checkout."""
    try:
        return metadata.version("skyfit")
    except metadata.PackageNotFoundError:
        return None
