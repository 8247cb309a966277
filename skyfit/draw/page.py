"""Making of figures without a display, and writing of complete files."""

import os
from pathlib import Path

from ..extras import require
from ..measured import atomic


def figure_maker(path: str | os.PathLike):
    """A function that makes a figure of a size in inches; raises first if the suffix of `path` is not supported."""
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
    """Write the figure's file; a failure leaves an existing file unchanged."""
    with atomic(path) as part:
        figure.savefig(part, dpi=150)
