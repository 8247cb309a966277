"""How far simplifications of a sky are off, by a model that was fitted to skies of the finest solver."""

import numpy as np

from ..tables import read_table
from .deciding import Deciding, STREAMS


TABLE = "error_model.csv"
# the rows of the table: what is raised to powers, each without a dimension
FEATURES = (
    "constant", "view airmass", "sun airmass", "low sun", "depth", "depth of haze", "depth along the view",
    "depth of haze along the view", "forward peak", "nearness to the sun", "ground albedo", "bent paths", "left out",
)  # fmt: skip
# what the largest of a scene may be before the model is asked for more than it was fitted to
RANGED = ("view airmass", "sun airmass", "depth", "depth of haze", "forward peak", "nearness to the sun")
_LOW_SUN, _FAR, _SOME_HAZE, _LITTLE, _DARK = 3.0, 2.0, 1e-3, 1e-6, 0.1


def features(numbers: Deciding, streams: int, constituent: int | None = None) -> dict[str, np.ndarray]:
    """The logarithms of `FEATURES`, `[direction, wavelength]` (or with leading axes, as `numbers` has them).

    **Arguments:** `streams`, of which `forward peak` is what they miss: the next of `STREAMS`; `constituent`, place of
    one that is left out.
    """
    log, d = np.log, jax_free(numbers)
    place = min((i for i, n in enumerate(STREAMS) if n >= streams), default=len(STREAMS) - 1)
    gone = np.zeros_like(d.depth) if constituent is None else d.without[..., constituent, :, :]
    rows = (
        np.zeros_like(d.depth) + 1.0,
        log(d.view_airmass),
        log(d.sun_airmass),
        log(np.maximum(d.sun_airmass / _LOW_SUN, 1.0)),
        log(d.depth),
        log(d.depth * d.haze + _SOME_HAZE),
        log(d.depth * d.view_airmass),
        log(d.depth * d.haze * d.view_airmass + _SOME_HAZE),
        log(d.forward[..., place, :, :] + _LITTLE),
        log(np.maximum(d.nearness * _FAR, 1.0)),
        log(d.albedo + _DARK),
        log(d.bent + 10.0 * _LITTLE),
        log(gone + _LITTLE),
    )
    return dict(zip(FEATURES, rows, strict=True))


def jax_free(numbers: Deciding) -> Deciding:
    """The numbers as numpy has them, in float64."""
    return Deciding(*(np.asarray(value, np.float64) for value in numbers))


def predicted(effect: str, of: dict[str, np.ndarray], median: bool = False) -> np.ndarray:
    """The relative error by one effect: a sum over mechanisms, each a product of powers of `FEATURES`.

    **Arguments:** `effect`, as the columns of data/error_model.csv have it before their colon; `of`, by `features`;
    `median`: such that the median of a scene's errors is safe, else their maximum.
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
    """What of a scene is larger than in all scenes of the model, in words."""
    most = read_table(TABLE)["range:most"]
    found = []
    for key in RANGED:
        largest, known = float(np.exp(of[key].max())), float(np.exp(most[FEATURES.index(key)]))
        if largest > 1.02 * known:
            found.append(f"{key} {largest:.3g}, where the error model knows up to {known:.3g}")
    return found
