"""The report of `skyfit perez`: a printed table of 80 columns, and a record of the written file for programs."""

import csv
import math
from pathlib import Path

from ..analytic.perez_of_sky import SkyPerez
from .printing import note, show, table
from .sky_report import short_times


def print_perez(found: SkyPerez) -> None:
    """Print a row for each time and kind of light, then notes on the sky and the number of unusable fits."""
    name = f"{found.light[0]} of " if len(found.light) == 1 else ""
    day, names = short_times(found.sky)
    rows = table(f"Perez' parameters of the {name}{found.sky.source}{day and f', {day}'}, +- sigma")
    for head in ("time", *([] if name else ["light"]), "A", "B", "C", "D", "E", "rmse"):
        rows.add_column(head, justify="left" if head in ("time", "light") else "right")
    for t, time in enumerate(names):
        for k, light in enumerate(found.light):
            cells = [
                f"{value:.3g}\n+-{sigma:.2g}"
                for value, sigma in zip(found.coefficients[t, k], found.sigma[t, k], strict=True)
            ]
            rows.add_row(time, *([] if name else [light]), *cells, f"{found.rmse[t, k]:.1%}")
    show(rows)
    for sentence in found.sky.notes:
        note(sentence)
    open_ends = int((~found.settled).sum())
    if open_ends:
        note(
            f"{open_ends} of {found.settled.size} fits are not to be used: too few directions, or no minimum in bounds"
        )


def record_of(path: Path) -> dict:
    """The rows of the written file; numbers that are not finite become null."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return {"file": str(path), "fits": [{name: _value(name, text) for name, text in row.items()} for row in rows]}


def _value(name: str, text: str) -> str | float | None:
    if name in ("time", "light"):
        return text
    number = float(text)
    return number if math.isfinite(number) else None
