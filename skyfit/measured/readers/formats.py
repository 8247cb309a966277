"""Find the format of a file by its content, not by its name."""

from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from ..samples import Sky
from .aeronet import read_scan
from .colours import colour_names
from .netcdf import read_netcdf
from .normalised import normalised_name
from .optical_depths import refuse_depths
from .scanner import is_scanner, read_scanner
from .skyrad import is_skyrad, read_skyrad
from .tidy import read_tidy, REQUIRED


# number of bytes and lines that are examined: a line of names may be long
_START, _LINES = 1 << 16, 60
_NETCDF = (b"CDF\x01", b"CDF\x02", b"CDF\x05", b"\x89HDF")


def known_format(path: Path) -> Callable[..., Sky] | Callable[..., NoReturn] | None:
    """The reader of a file by its content, None if the content shows no known format.

    **Arguments:** `path`, a file.
    **Returns:** a reader `(path, station) -> Sky`; for a known file without a sky, a reader that raises and says so.
    """
    with open(path, "rb") as stream:
        start = stream.read(_START)
    if start[:4] in _NETCDF:
        return read_netcdf
    if b"\0" in start:
        return None
    lines = start.decode("utf-8-sig", errors="replace").splitlines()[:_LINES]
    if _is_tidy(lines):
        return read_tidy
    names = next((line for line in lines if "Date(dd" in line and "," in line), "")
    if "Sky_Scan_Type" in names or ("Radiance" in names and "Solar_Zenith_Angle" in names):
        return read_scan
    if "AOD_" in names:
        return refuse_depths
    if names or (lines and lines[0].startswith("AERONET")):
        return _refuse_product
    if is_skyrad(lines):
        return read_skyrad
    return read_scanner if is_scanner([line for line in lines if _is_row(line)]) else None


def _is_tidy(lines: list[str]) -> bool:
    header = [cell.strip() for cell in next(filter(_is_row, lines), "").split(",")]
    named = {"radiance" if cell == normalised_name(header) else cell for cell in header}
    return set(REQUIRED) <= named or (colour_names(header) is not None and set(REQUIRED[:2]) <= named)


def _is_row(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _refuse_product(path: Path, station: dict[str, float]) -> NoReturn:
    raise ValueError(
        f"{path.name}: found a file of AERONET without radiances: expected a raw sky scan, in the almucantar (.alm) or "
        "the principal plane (.ppl), or a hybrid one (.hyb)"
    )
