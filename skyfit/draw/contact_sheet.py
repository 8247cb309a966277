"""Many small pictures on one page."""

import os
from collections.abc import Sequence

import numpy as np

from .page import figure_maker, write_figure


_ACROSS = 11.0  # inches


def plot_contact_sheet(pictures: Sequence[str | os.PathLike], titles: Sequence[str], path: str | os.PathLike) -> None:
    """PNG files of one size side by side, in rows, each with its title.

    **Arguments:** `pictures`, at least one, and as many `titles`; `path`, `*.png`, `*.pdf` or `*.svg`.
    """
    from matplotlib.image import imread

    images = [imread(os.fspath(picture)) for picture in pictures]
    height, width = images[0].shape[:2]
    # about as wide as high, by the shape of the pictures
    columns = max(1, min(len(images), round(np.sqrt(len(images) * 1.5 * height / width))))
    rows = -(-len(images) // columns)
    each = _ACROSS / columns
    figure = figure_maker(path)((_ACROSS, rows * (each * height / width + 0.25)))
    for axis in (axes := figure.subplots(rows, columns, squeeze=False).ravel()):
        axis.axis("off")
    for axis, image, title in zip(axes, images, titles, strict=False):
        axis.imshow(image)
        axis.set_title(title, fontsize=7, pad=2.0)
    figure.subplots_adjust(left=0.005, right=0.995, bottom=0.005, top=1.0 - 0.22 / figure.get_figheight(), wspace=0.03)
    write_figure(figure, path)
