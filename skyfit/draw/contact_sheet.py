"""A contact sheet: many small pictures on one page."""

import os
from collections.abc import Sequence

import numpy as np

from .page import figure_maker, write_figure


_ACROSS = 11.0  # width of the page, inches
# Largest number of pictures on a page and in a row; with more in a row their titles would overlap
_MOST, _MOST_ACROSS = 48, 5
# Largest width of a drawn picture, pixels
_PIXELS = 512


def plot_contact_sheet(pictures: Sequence[str | os.PathLike], titles: Sequence[str], path: str | os.PathLike) -> None:
    """Draw PNG files of one size in rows, each with its title.

    **Arguments:** `pictures`, at least one, and as many `titles`; `path`, `*.png`, `*.pdf` or `*.svg`.
    **Valid:** if there are more than 48 pictures, 48 evenly spaced ones are drawn. **Errors:** `ValueError` without
    pictures, or if the numbers of pictures and titles differ.
    """
    figure_of = figure_maker(path)
    from matplotlib.image import imread

    if not pictures or len(pictures) != len(titles):
        raise ValueError(f"`pictures` must be one or more, with as many titles, got {len(pictures)} and {len(titles)}")
    chosen = np.unique(np.linspace(0, len(pictures) - 1, min(len(pictures), _MOST)).round().astype(int))
    images = []
    for picture in (os.fspath(pictures[k]) for k in chosen):
        image = imread(picture)
        step = -(-image.shape[1] // _PIXELS)
        images.append(image[::step, ::step].copy())
    height, width = images[0].shape[:2]
    # The number of columns follows from the shape of the pictures
    columns = max(1, min(len(images), _MOST_ACROSS, round(np.sqrt(len(images) * 1.5 * height / width))))
    rows = -(-len(images) // columns)
    each = _ACROSS / columns
    figure = figure_of((_ACROSS, rows * (each * height / width + 0.25)))
    places = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis in places:
        axis.axis("off")
    for axis, image, k in zip(places, images, chosen, strict=False):
        axis.imshow(image)
        axis.set_title(titles[k], fontsize=7, pad=2.0)
    figure.subplots_adjust(left=0.005, right=0.995, bottom=0.005, top=1.0 - 0.22 / figure.get_figheight(), wspace=0.03)
    write_figure(figure, path)
