"""Errors of simplified skies, by a model that was fitted to skies of the finest solver."""

import numpy as np

from ..tables import read_table
from .deciding import Deciding, STREAMS


TABLE = "error_model.csv"
# Rows of the table: dimensionless quantities that are raised to powers.
FEATURES = (
    "constant", "view airmass", "sun airmass", "low sun", "depth", "depth of haze", "depth along the view",
    "depth of haze along the view", "forward peak", "nearness to the sun", "ground albedo", "bent paths", "left out",
)  # fmt: skip
# Features whose largest value in a scene must stay within the range that the model was fitted to.
RANGED = ("view airmass", "sun airmass", "depth", "depth of haze", "forward peak", "nearness to the sun")
_LOW_SUN, _FAR, _SOME_HAZE, _LITTLE, _DARK = 3.0, 2.0, 1e-3, 1e-6, 0.1


def shared_features(numbers: Deciding) -> dict[str, np.ndarray]:
    """Logarithms of those of `FEATURES` that depend neither on streams nor on what is left out; the others are 0.

    **Returns:** `[direction, wavelength]` each, with leading axes where `numbers` has them.
    """
    log, d = np.log, numbers
    hazy = d.depth * d.haze
    zero = np.zeros_like(d.depth)
    rows = (
        zero + 1.0, log(d.view_airmass), log(d.sun_airmass), log(np.maximum(d.sun_airmass / _LOW_SUN, 1.0)),
        log(d.depth), log(hazy + _SOME_HAZE), log(d.depth * d.view_airmass), log(hazy * d.view_airmass + _SOME_HAZE),
        zero, log(np.maximum(d.nearness * _FAR, 1.0)), log(d.albedo + _DARK), log(d.bent + 10.0 * _LITTLE), zero,
    )  # fmt: skip
    return dict(zip(FEATURES, rows, strict=True))


def with_streams(shared: dict[str, np.ndarray], numbers: Deciding, streams: int) -> dict[str, np.ndarray]:
    """Features for an effect of streams; `forward peak` is the moment that the next of `STREAMS` miss."""
    place = min((i for i, n in enumerate(STREAMS) if n >= streams), default=len(STREAMS) - 1)
    return shared | {"forward peak": np.log(numbers.forward[..., place, :, :] + _LITTLE)}


def with_left_out(shared: dict[str, np.ndarray], numbers: Deciding, constituent: int) -> dict[str, np.ndarray]:
    """Features for leaving out the constituent of an index."""
    return shared | {"left out": np.log(numbers.without[..., constituent, :, :] + _LITTLE)}


def predicted(effect: str, of: dict[str, np.ndarray], median: bool = False) -> np.ndarray:
    """Relative error by one effect: a sum over mechanisms, each a product of powers of `FEATURES`.

    **Arguments:** `effect`, the name before the colon in the columns of data/error_model.csv; `of`, features; `median`:
    whether the median of a scene's errors is safe, else their maximum.
    **Returns:** `[direction, wavelength]`, as `of`.
    """
    table = read_table(TABLE)
    total = np.zeros_like(of["constant"])
    for name, column in table.items():
        if name.partition(":")[0] == effect:
            exponent = sum(power * of[key] for key, power in zip(FEATURES, column, strict=False) if power)
            total = total + column[len(FEATURES) + median] * np.exp(exponent)
    return total


def beyond(of: dict[str, np.ndarray]) -> list[str]:
    """Say, in words, which features of a scene are larger than in all scenes of the model."""
    most = read_table(TABLE)["range:most"]
    found = []
    for key in RANGED:
        largest, known = float(np.exp(of[key].max())), float(np.exp(most[FEATURES.index(key)]))
        if largest > 1.02 * known:
            found.append(f"{key} {largest:.3g}, where the error model knows up to {known:.3g}")
    return found
