"""What `skyfit perez` prints, at 80 columns."""

from ..analytic.perez_of_sky import SkyPerez
from ..measured import time_names
from .printing import console, table


def print_perez(found: SkyPerez) -> None:
    """A row for each time and kind of light, then what a user should know of the sky and of what did not settle."""
    name = f"{found.light[0]} of " if len(found.light) == 1 else ""
    rows = table(f"Perez' parameters of the {name}{found.sky.source}, +- sigma")
    for head in ("time", *([] if name else ["light"]), "A", "B", "C", "D", "E", "rmse"):
        rows.add_column(head, justify="left" if head in ("time", "light") else "right")
    for t, time in enumerate(time_names(found.sky)):
        for k, light in enumerate(found.light):
            cells = [
                f"{value:.3g}\n+-{sigma:.2g}"
                for value, sigma in zip(found.coefficients[t, k], found.sigma[t, k], strict=True)
            ]
            rows.add_row(time, *([] if name else [light]), *cells, f"{found.rmse[t, k]:.1%}")
    console.print(rows, highlight=False)
    for note in found.sky.notes:
        console.print(f"note: {note}", highlight=False, markup=False)
    open_ends = int((~found.settled).sum())
    if open_ends:
        console.print(
            f"{open_ends} of {found.settled.size} fits are not to be used: too few directions, or no minimum in bounds",
            highlight=False,
        )
