"""Scattered samples onto the grid of times, directions and wavelengths."""

import numpy as np


class Axis:
    """Different values in order of first appearance, each with its position."""

    def __init__(self):
        self.positions: dict = {}

    def place(self, value) -> int:
        """The position of `value`, a new one if it has not appeared."""
        return self.positions.setdefault(value, len(self.positions))

    def __len__(self) -> int:
        return len(self.positions)

    def values(self) -> list:
        """The different values, by position."""
        return list(self.positions)


def fill(shape: tuple[int, int, int], places: np.ndarray, values: np.ndarray, absent: float) -> np.ndarray:
    """Values at their places of a grid, `absent` elsewhere.

    **Arguments** `places`: int, [3, sample]; `values`: [sample].

    **Returns** the grid, [time, direction, wavelength].
    """
    grid = np.full(shape, absent, dtype=np.float64)
    grid[tuple(places)] = values
    return grid


def repeated(shape: tuple[int, int, int], places: np.ndarray) -> tuple[int, int] | None:
    """The first two samples that share a place, or None.

    **Arguments** `places`: int, [3, sample].
    """
    flat = np.asarray(np.ravel_multi_index(tuple(places), shape))
    order = np.argsort(flat, kind="stable")
    same = np.flatnonzero(np.diff(flat[order]) == 0)
    if same.size == 0:
        return None
    second = np.min(order[same + 1])
    first = np.min(np.flatnonzero(flat == flat[second]))
    return int(first), int(second)
