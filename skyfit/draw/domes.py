"""Pictures of fitted and simulated skies."""

import os

import numpy as np

from ..light import srgb_from_xyz
from ..measured import time_names
from ..numerics import as_float
from ..retrieve import Fit
from ..scene import Directions
from .dome import cells, draw_dome, interpolated, place
from .fit_table import draw_shared, draw_table, lines, shared_height, table_height
from .page import figure_maker, write_figure


# Largest number of times on a page; if there are more, evenly spaced ones are drawn
_MOST_ROWS = 8
# Width of a fit's page, inches
_WIDE = 14.2
# Wavelengths whose mean is drawn, nm
_BAND = (400.0, 700.0)
# Mean luminance of a sky in linear sRGB: a bright blue sky, white only around the sun
_GREY = 0.36
# Smallest drawn value, as a share of a sky's greatest luminance
_BLACK = 1e-6
# Limit of the colour scale of luminance errors, per cent
_MOST_ERROR = 50.0
_MEASURED, _MODEL, _DIFFERENCE, _REJECTED = "#1b1b1b", "#d55e00", "RdBu_r", "#e6007e"
_UNIT = "mW m\u207b\u00b2 sr\u207b\u00b9 nm\u207b\u00b9"


def plot(fit: Fit, path: str | os.PathLike) -> None:
    """Draw a fit: measured, model and residual domes, the mean spectrum and the parameters.

    **Arguments:** `fit`, from `skyfit.invert`; `path`, `*.png`, `*.pdf` or `*.svg`.
    **Valid:** the parameters shared by all times, then a row for each time (8 evenly spaced ones if there are more). A
    dome shows the mean over the fitted wavelengths at 400-700 nm (all, if there are none). A failure leaves no file.

    **Example:**

        >>> sky = skyfit.read("data/skies/sample.nc")
        >>> fit = skyfit.invert(sky, ["turbidity"], skyfit.SingleScattering.draft("flat"))
        >>> skyfit.plot(fit, "fit.png")
        >>> from pathlib import Path
        >>> Path("fit.png").exists()
        True
    """
    figure_of = figure_maker(path)
    count = len(fit.sky.time)
    rows = np.linspace(0, count - 1, min(count, _MOST_ROWS)).round().astype(int).tolist()
    # Sizes in inches
    heading, bottom = 0.62, 0.55
    top = heading + shared_height(fit)
    heights = [max(3.04, 0.75 + table_height(fit, t)) for t in rows]
    tall = top + bottom + sum(heights)
    figure = figure_of((_WIDE, tall))
    band = _band(fit)
    base = tall - top
    for t, height in zip(rows, heights, strict=True):
        base -= height
        _draw_row(figure, fit, t, band, base, height, tall)
    shown = "" if len(rows) == count else f", {len(rows)} of its {count} times"
    figure.text(0.012, 1.0 - 0.2 / tall, f"{fit.sky.source or 'sky'}{shown}", fontsize=12, va="center",
                weight="bold")  # fmt: skip
    figure.text(0.012, 1.0 - 0.43 / tall, _settings(fit), fontsize=8.5, va="center", color="#555555")
    draw_shared(figure, fit, 0.012 * _WIDE, tall - heading - 0.05)
    ends = np.unique([fit.sky.wavelength_nm[band].min(), fit.sky.wavelength_nm[band].max()])
    ends = "-".join(f"{end:g}" for end in ends)
    caption = (
        f"Domes: mean radiance of the fitted samples at {ends} nm, as on a map: zenith in the "
        "middle, north up, azimuth clockwise (east right), rings at 30 and 60\N{DEGREE SIGN} from it.\n"
        "Dots: measured directions; hollow: masked; crosses: rejected as outliers. Ringed dot: the sun. Residual: "
        "model minus measured, per cent of that time's measured mean."
    )
    figure.text(0.012, 0.12 / tall, caption, fontsize=8, va="bottom", color="#555555", linespacing=1.35)
    write_figure(figure, path)


def plot_skies(
    directions: Directions,
    rows: list[tuple[str, dict[str, np.ndarray]]],
    path: str | os.PathLike,
    sun: list[tuple[float, float]],
) -> None:
    """Draw skies side by side in visible colours, and the luminance error of each relative to the first.

    **Arguments:** `directions`, dense over the sky; `rows`, a label and the skies by name, each XYZ in
    cd m^-2, `[direction, 3]`, the same names in every row and the reference first; `path`, `*.png`, `*.pdf`
    or `*.svg`; `sun`, zenith angle and azimuth for each row, radians.
    **Valid:** ten directions or more above the horizon. Each row has one exposure, from the mean luminance
    of the reference. A failure leaves no file.
    """
    figure_of = figure_maker(path)
    names = list(rows[0][1]) if rows else []
    if not names or any(list(skies) != names for _, skies in rows):
        raise ValueError("`rows` must hold one or more skies, of the same names in every row")
    if len(sun) != len(rows):
        raise ValueError(f"`sun` must have an entry for each of the {len(rows)} rows, got {len(sun)}")
    zenith, azimuth = np.asarray(directions.zenith, float), np.asarray(directions.azimuth, float)
    for label, skies in rows:
        for name, tristimulus in skies.items():
            if np.shape(tristimulus) != (zenith.size, 3):
                raise ValueError(
                    f"`rows` must hold XYZ of shape {(zenith.size, 3)}, got {np.shape(tristimulus)} "
                    f"for {name!r} of {label!r}"
                )
    if np.sum(zenith <= 0.5 * np.pi) < 10:
        raise ValueError(f"`directions` must hold ten or more above the horizon, got {zenith.size} in all")
    pictures = _pictures(zenith, azimuth, [list(skies.values()) for _, skies in rows])
    columns = names + [f"{name}: error" for name in names[1:]]
    # Sizes in inches
    side, left, top, bottom = 2.15, 1.45, 0.5, 0.85 if len(names) > 1 else 0.3
    wide, tall = left + side * len(columns) + 0.1, top + bottom + side * len(rows)
    figure = figure_of((wide, tall))
    image = None
    for r, ((label, skies), where) in enumerate(zip(rows, sun, strict=True)):
        y = (bottom + side * (len(rows) - 1 - r)) / tall
        figure.text(0.12 / wide, y + 0.5 * side / tall, lines(label, 21), fontsize=9, va="center")
        exposure = _GREY / max(float(np.mean(np.asarray(skies[names[0]])[:, 1])), 1e-30)
        for c, column in enumerate(columns):
            box = ((left + side * c) / wide, y, side / wide, side / tall)
            axes = figure.add_axes(box)
            if r == 0:
                axes.set_title(column, fontsize=9.5, pad=4)
            if c < len(names):
                draw_dome(axes, _screen(pictures[r][c], exposure), where, compass=False)
            else:
                style = {"cmap": _DIFFERENCE, "vmin": -_MOST_ERROR, "vmax": _MOST_ERROR}
                image = draw_dome(axes, pictures[r][c], where, compass=False, **style)
    if image is not None:
        errors = len(names) - 1
        box = ((left + side * (len(names) + 0.5 * errors - 0.45)) / wide, 0.55 / tall, 0.9 * side / wide,
               0.09 / tall)  # fmt: skip
        bar = figure.colorbar(image, cax=figure.add_axes(box), orientation="horizontal", extend="both")
        bar.ax.tick_params(labelsize=7.5, length=2)
        bar.set_label(f"luminance against {names[0]}, %", fontsize=8)
        bar.outline.set_linewidth(0.5)
    caption = "As on a map: zenith in the middle, north up, east right.\nOne exposure in each row. Ringed dot: sun."
    figure.text(0.12 / wide, 0.14 / tall, caption, fontsize=8, va="bottom", color="#555555")
    write_figure(figure, path)


def _band(fit: Fit) -> np.ndarray:
    wavelength = fit.sky.wavelength_nm
    fitted = fit.used.any(axis=(0, 1))
    visible = fitted & (wavelength >= _BAND[0]) & (wavelength <= _BAND[1])
    return np.flatnonzero(visible if visible.any() else fitted)


def _settings(fit: Fit) -> str:
    width = f"line shape {fit.fwhm_nm:g} nm FWHM" if np.isfinite(fit.fwhm_nm) else "no line shape"
    factor, unit = _unit(fit)
    return (
        f"{type(fit.solver).__name__}, {fit.solver.geometry}; {width}; {np.sum(fit.used)} samples; "
        f"rmse {factor * fit.total_rmse:.3g} {unit}"
    )


def _unit(fit: Fit) -> tuple[float, str]:
    """The factor to the drawn unit and its name: mW for radiance, or the unit of a camera's channels."""
    return (1e3, _UNIT) if fit.response is None else (1.0, "in the channels' unit")


def _draw_row(figure, fit: Fit, t: int, band, base: float, height: float, tall: float) -> None:
    """Draw one time: title, three domes with their scales, spectra and table; `base`, `height`, `tall` in inches."""
    sky, used = fit.sky, fit.used[t][:, band]
    kept = 2 * used.sum(axis=1) >= len(band)
    count = np.maximum(used.sum(axis=1), 1)
    measured = np.where(kept, np.where(used, sky.radiance[t][:, band], 0.0).sum(axis=1) / count, np.nan)
    same = np.where(kept, np.where(used, fit.model[t][:, band], 0.0).sum(axis=1) / count, np.nan)
    model = fit.model[t][:, band].mean(axis=1)
    model = np.where(sky.view_zenith[t] <= 0.5 * np.pi, model, np.nan)
    difference = 100.0 * (same - measured) / (np.nanmean(measured) if kept.any() else 1.0)
    sun = sky.sun_at(t)
    view = sky.view_zenith[t], sky.view_azimuth[t]
    nearest = cells(*view)
    limit = _limit(difference)
    side, top = 2.1, base + height

    def box(x, y, wide, high_):
        return figure.add_axes((x / _WIDE, y / tall, wide / _WIDE, high_ / tall))

    rule = box(0.16, top - 0.02, _WIDE - 0.32, 0.01)
    rule.set_axis_off()
    rule.axhline(0.5, color="#cccccc", linewidth=0.8)
    figure.text(0.16 / _WIDE, (top - 0.2) / tall, _title(fit, t), fontsize=9, va="center")
    factor, unit = _unit(fit)
    radiance = {"cmap": "viridis", "norm": _norm(factor * np.concatenate([measured, model]))}
    panels = (
        ("measured", factor * measured, kept, radiance),
        ("model", factor * model, np.isfinite(model), radiance),
        ("residual", difference, kept, {"cmap": _DIFFERENCE, "vmin": -limit, "vmax": limit}),
    )
    images = []
    for i, (name, values, whole, style) in enumerate(panels):
        axes = box(0.12 + i * (side + 0.06), top - 0.54 - side, side, side)
        axes.text(-1.12, 1.0, name, fontsize=8.5)
        picture = np.where(nearest >= 0, values[nearest], np.nan)
        images.append(draw_dome(axes, picture, sun, **style))
        _draw_samples(axes, *view, whole, "#777777" if name == "residual" else "white")
        if name != "model":
            x, y = place(*(angle[fit.rejected[t]] for angle in view))
            axes.plot(x, y, "x", markersize=5.0, markeredgewidth=1.1, color=_REJECTED, zorder=4)
    bar_y = top - 0.6 - side
    _bar(figure, images[0], box(0.6, bar_y, 2.0 * side - 0.9, 0.07), unit)
    _bar(figure, images[2], box(0.12 + 2.0 * (side + 0.06) + 0.3, bar_y, side - 0.6, 0.07), "%")
    _draw_spectra(box(7.15, top - 0.45 - side, 2.3, side - 0.12), fit, t)
    draw_table(box(9.75, base, _WIDE - 9.85, height - 0.24), fit, t)


def _title(fit: Fit, t: int) -> str:
    sky = fit.sky
    zenith, azimuth = sky.sun_at(t)
    degrees = np.degrees([zenith, azimuth % (2.0 * np.pi)])
    return (
        f"{time_names(sky)[t].replace('T', ' ').removesuffix('Z')}{'' if np.isnat(sky.time[t]) else ' UTC'}"
        f"    sun zenith {degrees[0]:.1f}\N{DEGREE SIGN}, azimuth {degrees[1]:.1f}\N{DEGREE SIGN}"
        f"    {fit.result[t]}, {fit.steps[t]} steps    rmse {_unit(fit)[0] * fit.rmse[t]:.3g}"
        f"{' mW' if fit.response is None else ''}"
        f"    reduced chi-square {fit.reduced_chi_square[t]:.2g}"
    )


def _norm(values):
    """A colour scale, logarithmic for a wide range, from the darkest sample to the 98th percentile."""
    from matplotlib.colors import LogNorm, Normalize

    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(np.percentile(values, 98.0))) if values.size else (0.0, 1.0)
    if high > 3.0 * low > 0.0:
        return LogNorm(low, high)
    return Normalize(low, high if high > low else low + max(abs(low), 1e-30))


def _limit(difference) -> float:
    """The smallest round number of per cent, at least 1, that is above 98 % of the residuals."""
    size = np.abs(difference[np.isfinite(difference)])
    wanted = float(np.percentile(size, 98.0)) if size.size else 0.0
    return next((step for step in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0) if wanted <= step), 100.0)


def _draw_samples(axes, zenith, azimuth, kept, colour: str) -> None:
    above = zenith <= 0.5 * np.pi
    x, y = place(zenith, azimuth)
    axes.plot(x[above & kept], y[above & kept], ".", markersize=1.4, color=colour, alpha=0.75, zorder=3)
    hollow = {"markerfacecolor": "none", "markeredgecolor": "#777777", "markeredgewidth": 0.6}
    axes.plot(x[above & ~kept], y[above & ~kept], "o", markersize=3.2, zorder=3, **hollow)


def _bar(figure, image, axes, unit: str) -> None:
    from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator, StrMethodFormatter

    values = np.asarray(np.ma.compressed(image.get_array()))
    low, high = image.get_clim()
    over, under = np.any(values > high), np.any(values < low)
    extend = "both" if over and under else "max" if over else "min" if under else "neither"
    bar = figure.colorbar(image, cax=axes, orientation="horizontal", extend=extend)
    if low > 0.0 and high / low > 3.0:
        bar.locator = LogLocator(subs=(1.0, 2.0, 5.0), numticks=12)
        bar.minorlocator = NullLocator()
    else:
        bar.locator = MaxNLocator(5)
    bar.formatter = StrMethodFormatter("{x:g}")
    bar.update_ticks()
    bar.ax.tick_params(labelsize=7.5, length=2, pad=2)
    bar.set_label(unit, fontsize=7.5, labelpad=1)
    bar.outline.set_linewidth(0.5)


def _draw_spectra(axes, fit: Fit, t: int) -> None:
    """Draw the mean measured and model spectra, over the same used samples of each wavelength."""
    used = fit.used[t]
    count = np.where(used.any(axis=0), used.sum(axis=0), 1)
    wavelength = fit.sky.wavelength_nm
    many, peak = len(wavelength) > 80, 0.0
    factor, unit = _unit(fit)
    dots = {"color": _MEASURED, "marker": "o", "markersize": 1.5 if many else 3.5, "linewidth": 0.0}
    line = {"color": _MODEL, "marker": ".", "markersize": 1.0 if many else 2.5, "linewidth": 1.1}
    for name, values, style in (("measured", fit.sky.radiance[t], dots), ("model", fit.model[t], line)):
        mean = np.where(used.any(axis=0), np.where(used, values, 0.0).sum(axis=0) / count, np.nan)
        order = np.argsort(wavelength)
        axes.plot(wavelength[order], factor * mean[order], label=name, **style)
        peak = max(peak, factor * float(np.nanmax(mean)))
    axes.set_ylim(0.0, 1.15 * max(peak, 1e-30))
    axes.tick_params(labelsize=7.5, length=2.5, width=0.6)
    axes.set_xlabel("wavelength, nm", fontsize=8, labelpad=1.5)
    axes.set_title(f"mean radiance, {unit}", fontsize=8, loc="left", pad=4)
    axes.legend(fontsize=7.5, frameon=False, loc="best", handlelength=1.4)
    axes.grid(linewidth=0.4, color="#dddddd")
    axes.set_axisbelow(True)
    for name, spine in axes.spines.items():
        spine.set_visible(name in ("left", "bottom"))
        spine.set_linewidth(0.6)


def _pictures(zenith, azimuth, rows: list[list[np.ndarray]]) -> list[list[np.ndarray]]:
    """For each row the pictures of its skies, `[row, column, 3]`, then the luminance errors, `[row, column]`."""
    channels = []
    for skies in rows:
        first = np.maximum(np.asarray(skies[0], float)[:, 1], 1e-30)
        # Logarithms, because a spline through a bright horizon would become negative beside it
        channels += [np.log(np.maximum(np.asarray(sky, float), _BLACK * first.max())) for sky in skies]
        channels += [100.0 * (np.asarray(sky, float)[:, 1:2] / first[:, None] - 1.0) for sky in skies[1:]]
    # One spline for all channels: the neighbours of each pixel are searched once
    whole = interpolated(zenith, azimuth, np.concatenate(channels, axis=1))
    parts = iter(np.split(whole, np.cumsum([c.shape[1] for c in channels])[:-1], axis=-1))
    return [[np.exp(next(parts)) for _ in skies] + [next(parts)[..., 0] for _ in skies[1:]] for skies in rows]


def _screen(picture, exposure: float):
    """sRGB pixels of XYZ pixels, transparent outside the dome."""
    inside = np.all(np.isfinite(picture), axis=-1)
    colour = np.asarray(srgb_from_xyz(as_float(np.maximum(np.nan_to_num(picture), 0.0)), exposure), float)
    return np.concatenate([np.clip(colour, 0.0, 1.0), inside[..., None].astype(float)], axis=-1)
