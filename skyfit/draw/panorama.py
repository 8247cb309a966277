"""A drawing of a picture of the sky, the fitted sky and the residual."""

import os

import numpy as np
from jaxtyping import Bool, Float

from ..light import srgb_from_linear, SRGB_LUMINANCE
from .page import figure_maker, write_figure


# White as a multiple of the median luminance; limit of the colour scale of the residual, per cent
_WHITE, _END = 4.0, 30.0


def plot_panorama(
    picture: Float[np.ndarray, "row column 3"],
    predicted: Float[np.ndarray, "row column 3"],
    used: Bool[np.ndarray, "row column"],
    path: str | os.PathLike,
) -> None:
    """Draw the picture, the fitted sky, and the relative luminance residual (picture over fit) of the used pixels.

    **Arguments:** `picture` and `predicted`, linear sRGB in one unit; `used`, mask with at least one used pixel;
    `path`, `*.png`, `*.pdf` or `*.svg`.
    """
    # The rows that hold used sky, and some below
    last = int(np.flatnonzero(used.any(axis=1))[-1]) + used.shape[0] // 20
    picture, predicted, used = picture[:last], predicted[:last], used[:last]
    height, width = used.shape
    across = 8.0 if width > 1.5 * height else 4.5
    figure = figure_maker(path)((across, 3.0 * (across * height / width + 0.4) + 0.5))
    axes = figure.subplots(3, 1)
    light, made = (colour @ SRGB_LUMINANCE for colour in (picture, predicted))
    white = _WHITE * np.median(light[used])
    for axis, colours, title in ((axes[0], picture, "picture"), (axes[1], predicted, "fitted sky")):
        axis.imshow(np.clip(np.asarray(srgb_from_linear(np.maximum(colours, 0.0) / white)), 0.0, 1.0))
        axis.set_title(title, fontsize=9)
    with np.errstate(divide="ignore", invalid="ignore"):
        residual = np.where(used, 100.0 * (light / made - 1.0), np.nan)
    drawn = axes[2].imshow(residual, cmap="RdBu_r", vmin=-_END, vmax=_END)
    axes[2].set_facecolor("0.85")
    typical = np.nanmedian(np.abs(residual))
    axes[2].set_title(f"picture by fitted sky, per cent (median {typical:.2g}); grey: not used", fontsize=9)
    bar = figure.add_axes((0.2, 0.045, 0.6, 0.012))
    figure.colorbar(drawn, cax=bar, orientation="horizontal", extend="both")
    figure.subplots_adjust(left=0.02, right=0.98, bottom=0.08, top=0.97, hspace=0.12)
    for axis in axes:
        axis.set_xticks([])
        axis.set_yticks([])
    write_figure(figure, path)
