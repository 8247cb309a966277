"""Write Perez' parameters of measured skies as a table."""

import os
from math import degrees
from pathlib import Path

from ..analytic.perez_of_sky import COEFFICIENTS, SkyPerez
from ..measured import atomic, time_names


def write_perez(found: SkyPerez, path: str | os.PathLike) -> None:
    """Write a table with a row for each time and kind of light.

    The columns are time (UTC), light, the sun's zenith angle (degrees), the five coefficients, sigma of each,
    covariance of each two, the zenith's light and its sigma, relative rmse, directions, settled.

    **Errors:** `ValueError` for a suffix other than .csv, and if nothing can be written; an older file then stays.
    """
    path = Path(path)
    if path.suffix != ".csv":
        raise ValueError(f"{path.name}: expected a suffix of .csv, found {path.suffix!r}")
    pairs = [(i, j) for i in range(5) for j in range(i)]
    names = ["time", "light", "sun_zenith", *COEFFICIENTS, *(f"{name}_sigma" for name in COEFFICIENTS)]
    names += [f"covariance_{COEFFICIENTS[j]}_{COEFFICIENTS[i]}" for i, j in pairs]
    lines = [",".join([*names, "zenith", "zenith_sigma", "rmse", "directions", "settled"])]
    for t, time in enumerate(time_names(found.sky)):
        down = degrees(found.sky.sun_at(t)[0])
        for k, light in enumerate(found.light):
            numbers = [down, *found.coefficients[t, k], *found.sigma[t, k]]
            numbers += [found.covariance[t, k, i, j] for i, j in pairs]
            numbers += [found.zenith[t, k], found.zenith_sigma[t, k], found.rmse[t, k]]
            last = str(found.directions[t, k]), str(int(found.settled[t, k]))
            lines.append(",".join([time, light, *(f"{number:.9g}" for number in numbers), *last]))
    with atomic(path) as part:
        part.write_text("\n".join(lines) + "\n", encoding="utf-8")
