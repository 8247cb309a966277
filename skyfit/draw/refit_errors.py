"""A drawing of the errors of refitted coefficients against simulated skies."""

import os

import numpy as np

from ..analytic import Refit
from .page import figure_maker, write_figure


_MODELS = ("published", "refitted", "best five")
_LOW, _HIGH = 0.05, 1000.0


def plot_refit(refit: Refit, path: str | os.PathLike) -> None:
    """Draw each sky's median luminance error over the sun's zenith angle, coloured by turbidity, for each model.

    **Arguments:** `refit`, from `skyfit.refit`; `path`, `*.png`, `*.pdf` or `*.svg`.
    **Valid:** lines are the skies of the fit, one for each turbidity, circles those held out; per cent, view zenith to
    80 degrees. The published coefficients are shown only within their range. A failure leaves no file.
    """
    figure = figure_maker(path)((11.0, 4.1))
    from matplotlib import colormaps
    from matplotlib.colors import LogNorm

    fitted, held = refit.fitted, refit.held_out
    everything = np.concatenate([fitted.turbidity, held.turbidity])
    # A single turbidity would give a colour scale of zero width
    low, high = everything.min(), max(everything.max(), everything.min() + 0.1)
    norm = LogNorm(low, high)
    colours = colormaps["viridis"]
    axes = figure.subplots(1, len(_MODELS), sharey=True)
    for axis, name in zip(axes, _MODELS, strict=True):
        for turbidity in np.unique(fitted.turbidity):
            chosen = fitted.turbidity == turbidity
            error = 100.0 * fitted.luminance_error[name][chosen]
            axis.plot(np.degrees(fitted.sun_zenith[chosen]), error, color=colours(norm(turbidity)), linewidth=1.3)
        error = 100.0 * held.luminance_error[name]
        axis.scatter(
            np.degrees(held.sun_zenith), error, s=16, linewidths=0.9, facecolors="none",
            edgecolors=colours(norm(held.turbidity)),
        )  # fmt: skip
        axis.set_yscale("log")
        axis.set_ylim(_LOW, _HIGH)
        axis.set_title(name, fontsize=10)
        axis.set_xlabel("sun zenith, degrees", fontsize=9)
        axis.grid(True, which="major", color="#dddddd", linewidth=0.6)
        axis.tick_params(labelsize=8)
    axes[0].set_ylabel("median luminance error of a sky, %", fontsize=9)
    figure.subplots_adjust(left=0.07, right=0.9, bottom=0.17, top=0.91, wspace=0.06)
    from matplotlib.cm import ScalarMappable

    bar = figure.colorbar(ScalarMappable(norm, colours), cax=figure.add_axes((0.92, 0.17, 0.013, 0.74)))
    ticks = [t for t in (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 10.0) if low <= t <= high]
    bar.set_ticks(ticks, labels=[f"{t:g}" for t in ticks])
    bar.minorticks_off()
    bar.set_label("turbidity", fontsize=9)
    figure.text(0.07, 0.02, "Lines: skies of the fit. Circles: held out.", fontsize=8, color="#555555")
    write_figure(figure, path)
