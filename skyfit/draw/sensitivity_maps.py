"""A drawing of the sensitivity of the radiance in each direction to the parameters."""

import os
import textwrap
from collections.abc import Mapping, Sequence

import numpy as np

from ..retrieve import PARAMETERS
from ..scene import Directions, Scene
from .dome import draw_dome, interpolated, place
from .fit_table import unit_after
from .page import figure_maker, write_figure


# Sizes of a dome, the margins, and the lower part with the curves and the numbered dome, inches
_SIDE, _LEFT, _TOP, _BAR, _BOTTOM, _LOWER = 1.95, 0.75, 0.78, 0.5, 0.55, 3.7
# Largest number of wavelengths on a page
_MOST_ROWS = 3
# Step of each parameter whose effect the colours show, in its unit; 1 for other parameters
_STEP = {
    "turbidity": 0.1,
    "aerosol_optical_depth": 0.01,
    "angstrom_exponent": 0.1,
    "single_scattering_albedo": 0.01,
    "single_scattering_albedo_slope": 0.1,
    "asymmetry": 0.01,
    "asymmetry_second": 0.1,
    "forward_fraction": 0.01,
    "aerosol_scale_height": 100.0,
    "ozone": 10.0,
    "ground_albedo": 0.1,
    "ground_albedo_slope": 0.1,
    "pressure": 1000.0,
}
_COLOURS = "RdBu_r"
_INK = "#1b1b1b"
_LINES = ("#d55e00", _INK, "#0072b2", "#009e73", "#cc79a7")


def plot_sensitivity(
    scene: Scene,
    names: Sequence[str],
    relative: np.ndarray,
    path: str | os.PathLike,
    chosen: Directions | None = None,
    sigmas: Mapping[str, np.ndarray] | None = None,
    title: str = "",
) -> None:
    r"""Draw domes of $\partial \ln L / \partial p$: a column for each parameter, a row for each of a few wavelengths.

    **Arguments:** `scene`, dense over the sky; `names` of the parameters; `relative`, `sensitivity` divided by
    radiance, `[parameter, direction, wavelength]`; `path`, `*.png`, `*.pdf` or `*.svg`; `chosen`, directions to number
    in order; `sigmas`, for each label a curve of the sigma of the first parameter after 1, 2, ... directions (nan: not
    drawn); `title` of the page.
    **Valid:** ten directions or more above the horizon. With more than 3 wavelengths the first, middle and last are
    drawn. Each parameter has one colour scale, to the 98th percentile. Colours give the change of radiance, per cent,
    for a small step of the parameter. A failure leaves no file.
    """
    figure_of = figure_maker(path)
    names, relative = tuple(names), np.asarray(relative, float)
    zenith, azimuth = np.asarray(scene.view.zenith, float), np.asarray(scene.view.azimuth, float)
    wavelength = np.asarray(scene.wavelength_nm, float)
    if relative.shape != (len(names), zenith.size, wavelength.size) or not names:
        raise ValueError(
            f"`relative` must have shape {(len(names), zenith.size, wavelength.size)}, got {relative.shape}"
        )
    if not set(names) <= set(PARAMETERS):
        raise ValueError(f"`names` must be among {', '.join(PARAMETERS)}; got {', '.join(names)}")
    if np.sum(zenith <= 0.5 * np.pi) < 10:
        raise ValueError(f"`scene` must have ten or more directions above the horizon, got {zenith.size} in all")
    rows = np.linspace(0, wavelength.size - 1, min(wavelength.size, _MOST_ROWS)).round().astype(int)
    steps = np.array([_STEP.get(name, 1.0) for name in names])
    change = 100.0 * steps[:, None, None] * relative[:, :, rows]
    # One spline for all pictures; black directions have no relative change
    seen = np.all(np.isfinite(change), axis=(0, 2))
    flat = np.moveaxis(change, 1, 0)[seen].reshape(seen.sum(), -1)
    pictures = interpolated(zenith[seen], azimuth[seen], flat)
    pictures = pictures.reshape(*pictures.shape[:2], len(names), len(rows))
    sun = (float(scene.sun_zenith), float(scene.sun_azimuth))
    lower = _LOWER if chosen is not None or sigmas else 0.0
    # Size in inches; a page with few columns is at least as wide as its lower part
    wide = max(_LEFT + _SIDE * len(names) + 0.15, 7.6 if lower else 4.0)
    tall = _TOP + _SIDE * len(rows) + _BAR + lower + _BOTTOM
    figure = figure_of((wide, tall))

    def box(x, y, width, height):
        return figure.add_axes((x / wide, y / tall, width / wide, height / tall))

    figure.text(0.12 / wide, 1.0 - 0.22 / tall, title or "Sensitivity of sky radiance", fontsize=12, va="center",
                weight="bold")  # fmt: skip
    styles = []
    base = tall - _TOP - _SIDE * len(rows)
    for p, name in enumerate(names):
        limit = float(np.percentile(np.abs(change[p][seen]), 98.0)) or 1.0
        styles.append({"cmap": _COLOURS, "vmin": -limit, "vmax": limit})
        x, image = _LEFT + _SIDE * p, None
        for r, index in enumerate(rows):
            axes = box(x, base + _SIDE * (len(rows) - 1 - r), _SIDE, _SIDE)
            image = draw_dome(axes, pictures[:, :, p, r], sun, compass=False, **styles[p])
            if r == 0:
                axes.set_title(name.replace("_", " "), fontsize=9.5, pad=3)
            if p == 0:
                y = (base + _SIDE * (len(rows) - 0.5 - r)) / tall
                figure.text(0.12 / wide, y, f"{wavelength[index]:g} nm", fontsize=9, va="center")
        bar = box(x + 0.22, base - 0.08, _SIDE - 0.44, 0.08)
        _bar(figure, image, bar, f"% per +{steps[p]:g}{unit_after(name)}")
    caption = (
        "As on a map: zenith in the middle, north up, east right. Ringed dot: sun. "
        "Red: brighter, blue: darker as the parameter grows."
    )
    if chosen is not None:
        caption += f" Below right: {names[0].replace('_', ' ')} at {wavelength[rows[0]]:g} nm, faint."
    caption = textwrap.fill(caption, int(15.5 * wide))
    figure.text(0.12 / wide, 0.14 / tall, caption, fontsize=8, va="bottom", color="#555555")
    if chosen is not None:
        axes = box(wide - 3.45, _BOTTOM - 0.1, 3.2, 3.2)
        draw_dome(axes, pictures[:, :, 0, 0], sun, compass=False, alpha=0.45, **styles[0])
        axes.set_title(f"best directions for {names[0].replace('_', ' ')}, in order", fontsize=9.5, pad=1)
        _number(axes, chosen)
    if sigmas:
        _draw_curves(box(_LEFT, _BOTTOM + 0.5, wide - 1.3 - (3.45 if chosen is not None else 0.0), 2.45), names[0],
                     sigmas)  # fmt: skip
    write_figure(figure, path)


def _bar(figure, image, axes, label: str) -> None:
    from matplotlib.ticker import MaxNLocator

    bar = figure.colorbar(image, cax=axes, orientation="horizontal", extend="both")
    bar.locator = MaxNLocator(4, symmetric=True)
    bar.update_ticks()
    bar.ax.tick_params(labelsize=7.5, length=2, pad=2)
    bar.set_label(label, fontsize=8, labelpad=1)
    bar.outline.set_linewidth(0.5)


def _number(axes, chosen: Directions) -> None:
    """Draw dots, each with its number beside it, placed farthest from all others."""
    from matplotlib.patheffects import withStroke

    dots = np.stack(place(np.asarray(chosen.zenith, float), np.asarray(chosen.azimuth, float)), axis=-1)
    axes.plot(*dots.T, "o", markersize=4.5, color=_INK, markeredgecolor="white", markeredgewidth=0.7, zorder=8)
    angles = np.arange(16) * (np.pi / 8.0)
    around = 0.085 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    taken = dots
    for i, dot in enumerate(dots):
        others = np.delete(taken, i, axis=0)
        places = dot + around
        room = np.full(len(places), 1.0) if not len(others) else np.min(
            np.linalg.norm(places[:, None] - others, axis=-1), axis=1
        )  # fmt: skip
        spot = places[np.argmax(np.where(np.linalg.norm(places, axis=1) < 1.12, np.minimum(room, 0.2), -1.0))]
        taken = np.concatenate([taken, spot[None]])
        axes.text(*spot, str(i + 1), fontsize=8.5, weight="bold", zorder=9, ha="center", va="center", color=_INK,
                  path_effects=[withStroke(linewidth=2.2, foreground="white")])  # fmt: skip


def _draw_curves(axes, name: str, sigmas: Mapping[str, np.ndarray]) -> None:
    from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator, StrMethodFormatter

    for i, (label, values) in enumerate(sigmas.items()):
        values = np.asarray(values, float)
        count = np.arange(1, values.size + 1)
        known = np.isfinite(values)
        axes.plot(count[known], values[known], color=_LINES[i % len(_LINES)], linewidth=1.6, marker=".", markersize=5,
                  label=label)  # fmt: skip
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_major_locator(MaxNLocator(10, integer=True))
    axes.set_xlabel("number of directions", fontsize=9, labelpad=2)
    unit = PARAMETERS[name].unit
    axes.set_title(f"sigma of {name.replace('_', ' ')}{'' if unit == '1' else f', {unit}'}", fontsize=9.5, loc="left")
    axes.tick_params(labelsize=8, length=2.5, width=0.6)
    axes.grid(True, linewidth=0.4, color="#dddddd")
    axes.set_axisbelow(True)
    axes.legend(fontsize=8.5, frameon=False)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_linewidth(0.6)
