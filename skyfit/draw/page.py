"""Figures on paper: made without a display, written whole or not at all."""

import os
from pathlib import Path

from ..extras import require
from ..measured import atomic


def figure_maker(path: str | os.PathLike):
    """A maker of figures of a size in inches, once the suffix of `path` is known to be writable."""
    require("matplotlib")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    target = Path(path)
    if target.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise ValueError(f"{target.name}: expected a suffix of .png, .pdf, .svg, found {target.suffix!r}")

    def make(size):
        figure = Figure(figsize=size, facecolor="white")
        FigureCanvasAgg(figure)
        return figure

    return make


def write_figure(figure, path: str | os.PathLike) -> None:
    """The figure's file, which a failure leaves as it was."""
    with atomic(path) as part:
        figure.savefig(part, dpi=150)
