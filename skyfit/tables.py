"""Reading of the data tables that are shipped with the package."""

import csv
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

import numpy as np


_PACKAGE = Path(__file__).resolve().parent


def data_path(name: str) -> Path:
    """Path of a shipped data file: in the installed package, else in the checkout.

    **Arguments**: `name`, file name below the data folder, such as `"preetham_table1_eta.csv"`.
    **Returns**: the path of an existing file.
    **Valid**: names that exist; otherwise `FileNotFoundError`.
    """
    for folder in (_PACKAGE / "data", _PACKAGE.parent / "data"):
        path = folder / name
        if path.exists():
            return path
    raise FileNotFoundError(f"`name` must be a file of skyfit's data folder, got {name!r}")


def read_table(name: str) -> dict[str, np.ndarray]:
    """Columns of a shipped CSV table, read once and cached.

    **Arguments**: `name`, file name below the data folder.
    **Returns**: column name to float64 array, one value per row; an empty cell is NaN. The arrays
    are read-only.
    **Valid**: lines that start with `#` are comments; the first other line names the columns. A
    non-numeric cell, or a row of another length, is a `ValueError` with file, row and, for a cell, column.
    """
    return dict(_columns(name))


@lru_cache(maxsize=8)
def read_arrays(name: str) -> MappingProxyType[str, np.ndarray]:
    """Arrays of a shipped NPZ file, read once and cached.

    **Arguments**: `name`, file name below the data folder.
    **Returns**: array name to array, both read-only.
    **Valid**: files without pickled objects; otherwise `ValueError`.
    """
    with np.load(data_path(name), allow_pickle=False) as file:
        arrays = {key: file[key] for key in file.files}
    for values in arrays.values():
        values.setflags(write=False)
    return MappingProxyType(arrays)


@lru_cache(maxsize=64)
def _columns(name: str) -> dict[str, np.ndarray]:
    path = data_path(name)
    header: list[str] | None = None
    rows: list[list[float]] = []
    with path.open(encoding="utf-8", newline="") as file:
        for number, line in enumerate(file, start=1):
            if line.startswith("#") or not line.strip():
                continue
            cells = next(csv.reader([line.strip()]))
            if header is None:
                header = cells
                continue
            if len(cells) != len(header):
                raise ValueError(f"{path.name}, row {number}: expected {len(header)} cells, found {len(cells)}")
            rows.append([_number(path.name, number, *pair) for pair in zip(header, cells, strict=True)])
    if header is None or not rows:
        raise ValueError(f"{path.name}: expected a header row and data rows, found none")
    columns = {key: np.array(values) for key, values in zip(header, zip(*rows, strict=True), strict=True)}
    for values in columns.values():
        values.setflags(write=False)
    return columns


def _number(file: str, row: int, column: str, cell: str) -> float:
    if not cell:
        return float("nan")
    try:
        return float(cell)
    except ValueError:
        raise ValueError(f"{file}, row {row}, column {column}: expected a number, found {cell!r}") from None
