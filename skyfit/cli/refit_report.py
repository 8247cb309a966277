"""The printed report and the drawing of `skyfit refit`."""

from pathlib import Path

import numpy as np

from ..analytic import Comparison, model_xyz, Refit
from ..draw import plot_skies
from .printing import say, show, table


# Largest number of skies with one row each; if there are more, the table has one row per sun
_MOST_ROWS = 100
# Sun zenith angle in degrees and turbidity of the drawn skies
_DRAWN = {
    "linear": ((22.5, 2.0), (45.0, 3.0), (60.0, 4.0), (75.0, 6.0)),
    "extended": ((30.0, 1.0), (60.0, 2.0), (77.0, 4.0), (85.5, 6.5), (91.0, 2.0)),
}


def print_refit(result: Refit) -> None:
    names = tuple(result.fitted.luminance_error)
    rows = _table_rows(result.fitted)
    fitted = result.fitted
    each = table("Luminance error to view zenith 80, %: median / 95th percentile")
    for heading in ("sun zenith", "turbidity", *names):
        each.add_column(heading, justify="right")
    for sun, turbidity, chosen in rows:
        pairs = (
            _pair(_middle(fitted.luminance_error[n][chosen]), _middle(fitted.luminance_95[n][chosen])) for n in names
        )
        each.add_row(sun, turbidity, *pairs)
    show(each)
    total = table("All together: luminance error, % (median / 95th percentile); xy distance")
    for heading in ("skies", "of", *names):
        total.add_column(heading, justify="right" if heading in names else "left", no_wrap=True)
    for kind, errors in (
        ("fitted", fitted.overall),
        ("held out", result.held_out.overall),
        ("fitted, rest *", fitted.rest),
        ("held out, rest *", result.held_out.rest),
    ):
        total.add_row(kind, "luminance", *(_pair(errors[n].luminance, errors[n].luminance_95) for n in names))
        total.add_row("", "xy", *(_text(errors[n].chromaticity, 4) for n in names))
    show(total)
    say("* view zenith beyond 80 degrees or sun beyond 85")
    say("best five: Perez' formula fitted to each sky alone, what it can do at all")


def _table_rows(skies: Comparison):
    """Sun, turbidity and the selected skies for each row: one row per sky, or per sun if there are many skies."""
    degrees = np.degrees(skies.sun_zenith)
    if degrees.size <= _MOST_ROWS:
        return [(f"{degrees[i]:.1f}", f"{skies.turbidity[i]:g}", [i]) for i in range(degrees.size)]
    every = f"{skies.turbidity.min():g}-{skies.turbidity.max():g}"
    return [(f"{sun:.1f}", every, np.isclose(degrees, sun)) for sun in np.unique(np.round(degrees, 6))]


def _middle(errors) -> float:
    known = np.asarray(errors)[np.isfinite(errors)]
    return float(np.median(known)) if known.size else np.nan


def _pair(median: float, high: float) -> str:
    return f"{_text(100.0 * median, 1)} / {_text(100.0 * high, 1)}"


def _text(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "-"


def draw_skies(result: Refit, path: Path, form: str) -> None:
    """Draw some skies as simulated and by both models."""
    fitted, degrees = result.fitted, np.degrees(result.fitted.sun_zenith)
    drawn = [int(np.argmin(np.abs(degrees - s) + 100.0 * np.abs(fitted.turbidity - t))) for s, t in _DRAWN[form]]
    models = {"published": result.published, "refitted": result.refitted}
    # A model that is not valid for all drawn skies is omitted
    known = {n: m for n, m in models.items() if np.all(np.isfinite(fitted.luminance_error[n][drawn]))}
    answers = {n: model_xyz(m, result.view, fitted) for n, m in known.items()}
    rows = [
        (
            f"sun zenith {degrees[i]:.0f}, T {fitted.turbidity[i]:g}",
            {"simulated": fitted.simulated[i]} | {n: answer[i] for n, answer in answers.items()},
        )
        for i in drawn
    ]
    plot_skies(result.view, rows, path, [(float(fitted.sun_zenith[i]), 0.0) for i in drawn])
