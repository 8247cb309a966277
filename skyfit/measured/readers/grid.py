"""Put scattered samples onto the grid of times, directions and wavelengths."""

import numpy as np
from jaxtyping import Int


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


def by_time(
    times: Int[np.ndarray, " sample"], directions: Int[np.ndarray, " sample"]
) -> tuple[Int[np.ndarray, " sample"], Int[np.ndarray, "*axes"]]:
    """The positions of samples on an axis of directions: one for all times, or one for each time if they share few.

    **Arguments** the indices of each sample's time and of its direction among all.

    **Returns** each sample's position, and the direction at each position: `[direction]` for one axis of all times, or
    `[time, direction]`, -1 past the last direction of a time, if half of the former axis or more would be empty.
    """
    count = int(directions.max()) + 1
    pairs, first, sample = np.unique(times * count + directions, return_index=True, return_inverse=True)
    own = pairs // count
    longest = int(np.bincount(own).max())
    if longest == count or 2 * pairs.size > count * (int(times.max()) + 1):
        return directions, np.arange(count)
    # in the order of their first appearance within the time
    order = np.lexsort((first, own))
    starts = np.searchsorted(own[order], np.arange(int(times.max()) + 1))
    place = np.empty(pairs.size, int)
    place[order] = np.arange(pairs.size) - starts[own[order]]
    which = np.full((starts.size, longest), -1)
    which[own, place] = pairs % count
    return place[sample], which


def fill(shape: tuple[int, int, int], places: np.ndarray, values: np.ndarray, absent: float) -> np.ndarray:
    """Put values at their places of a grid, `absent` elsewhere.

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
