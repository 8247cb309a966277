"""The parameters of a fit as text: shared ones once at the top of the page, those of each time beside its domes."""

import math
import textwrap
from typing import NamedTuple

import numpy as np

from ..retrieve import Fit, PARAMETERS


# Height of a line and width of an entry in the block of shared parameters, inches
LINE, _ENTRY = 0.152, 4.6
# Width of a line of text beside the domes, characters
_NARROW = 58
_SURE, _OPEN = "#1b1b1b", "#a0522d"
_MINUS = "\u2212"


class _Entry(NamedTuple):
    name: str
    value: str
    spread: str
    colour: str


def lines(text: str, width: int) -> str:
    """The text with its own line breaks, and with further ones where a line would be longer than `width`."""
    return "\n".join(textwrap.fill(line, width) for line in text.split("\n"))


def unit_after(name: str) -> str:
    """A parameter's unit as written after a number."""
    unit = PARAMETERS[name].unit
    return {"1": "", "degree": "\N{DEGREE SIGN}"}.get(unit, f" {unit}")


def shared_height(fit: Fit) -> float:
    """Height of the block drawn by `draw_shared`, inches."""
    if not fit.shared:
        return 0.0
    return LINE * (1 + math.ceil(len(fit.shared) / 3) + len(_common_sentences(fit))) + 0.1


def draw_shared(figure, fit: Fit, left: float, y: float) -> None:
    """Draw the parameters shared by all times, three per line, and what is undetermined at all times.

    **Arguments:** `left`, `y`, position of the block's top left corner from the figure's left and bottom, inches.
    """
    if not fit.shared:
        return
    wide, tall = figure.get_size_inches()

    def write(x, text, **style):
        figure.text((left + x) / wide, y / tall, text, fontsize=8, va="center", **style)

    write(0.0, "all times", weight="bold")
    for place, name in enumerate(fit.shared):
        if place % 3 == 0:
            y -= LINE
        entry, x = _entry(fit, 0, fit.free.index(name)), _ENTRY * (place % 3)
        write(x, entry.name, color=entry.colour)
        write(x + 2.35, entry.value, ha="right", color=entry.colour)
        write(x + 2.42, entry.spread, color=entry.colour)
    for sentence in _common_sentences(fit):
        y -= LINE
        write(0.0, sentence.replace("_", " "), color=_OPEN, style="italic")


def table_height(fit: Fit, t: int) -> float:
    """Height of the table drawn by `draw_table` below its first line, inches."""
    return LINE * (len(fit.free) - len(fit.shared) + len(_noise(fit, t)) + len(_own_sentences(fit, t)))


def draw_table(axes, fit: Fit, t: int) -> None:
    """Draw the parameters of one time and what is undetermined at it."""
    axes.set_axis_off()
    tall = axes.get_position().height * axes.figure.get_size_inches()[1]
    # Position of the current line below the top, inches
    y = 0.3

    def write(x, text, **style):
        axes.text(x, 1.0 - y / tall, text, transform=axes.transAxes, fontsize=8, va="center", **style)

    write(0.0, "parameter", weight="bold")
    write(0.50, "value", weight="bold", ha="right")
    write(0.525, "\N{PLUS-MINUS SIGN} sigma", weight="bold")
    for p, name in enumerate(fit.free):
        if name in fit.shared:
            continue
        y += LINE
        entry = _entry(fit, t, p)
        write(0.0, entry.name, color=entry.colour)
        write(0.50, entry.value, ha="right", color=entry.colour)
        write(0.525, entry.spread, color=entry.colour)
    for sentence in _noise(fit, t):
        y += LINE
        write(0.0, sentence, color=_SURE)
    for sentence in _own_sentences(fit, t):
        y += LINE
        write(0.0, sentence, color=_OPEN, style="italic")


def _entry(fit: Fit, t: int, p: int) -> _Entry:
    value, sigma, sure = fit.values[t, p], fit.sigma[t, p], bool(fit.determined[t, p])
    decimals = _decimals(sigma)
    shown = f"{value:.{decimals}f}" if decimals is not None else f"{value:.3g}"
    spread = f"{sigma:.{decimals}f}" if decimals is not None else f"{sigma:.2g}"
    spread = spread if np.isfinite(sigma) else "\N{EM DASH}"
    unit = unit_after(fit.free[p])
    flags = ", ".join(text for text, yes in (("at bound", fit.at_bound[t, p]), ("undetermined", not sure)) if yes)
    return _Entry(
        fit.free[p].replace("_", " "),
        shown.replace("-", _MINUS),
        f"\N{PLUS-MINUS SIGN} {spread}{unit}  {flags}",
        _SURE if sure and not fit.at_bound[t, p] else _OPEN,
    )


def _decimals(sigma: float) -> int | None:
    """Number of decimals that shows two digits of sigma; None for very small, very large or infinite sigma."""
    if not np.isfinite(sigma) or not 1e-5 < sigma < 1e3:
        return None
    return int(np.clip(1 - np.floor(np.log10(sigma)), 0, 6))


def _told(fit: Fit, t: int) -> list[str]:
    """Sentences on what is undetermined at a time, without those that the flags express."""
    return [s for s in fit.undetermined[t] if not s.endswith("is not determined by these data")]


def _noise(fit: Fit, t: int) -> list[str]:
    """Lines on the error components of a time, and on the residual of the direct beam."""
    level, colour, pointing, broad_level, broad_colour = fit.common[t]
    said = [
        f"noise: {fit.scale[t]:.2g} sigma, level {100.0 * level:.2g} %, colour {100.0 * colour:.2g} %, "
        f"pointing {np.degrees(pointing):.2g}\N{DEGREE SIGN}",
        f"broad: level {100.0 * broad_level:.2g} %, colour {100.0 * broad_colour:.2g} %",
    ]
    if np.isfinite(fit.beam_residual[t]).any():
        said.append(f"direct beam: within {np.nanmax(np.abs(fit.beam_residual[t])):.2g} sigma of the fit's")
    return said


def _common_sentences(fit: Fit) -> list[str]:
    """Sentences on what is undetermined at all times; none without shared parameters."""
    if not fit.shared:
        return []
    return [s for s in _told(fit, 0) if all(s in sentences for sentences in fit.undetermined)]


def _own_sentences(fit: Fit, t: int) -> list[str]:
    """Sentences on what is undetermined at one time only, in lines short enough for its table."""
    common = _common_sentences(fit)
    own = (s for s in _told(fit, t) if s not in common)
    return [line for s in own for line in lines(s.replace("_", " "), _NARROW).split("\n")]
