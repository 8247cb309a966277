"""Drawing of one dome of the sky: zenith at the centre, horizon at the rim, north up, east right."""

import numpy as np


# Width of a dome, pixels
_SIZE = 360
# Cosine of the zenith angle below which the horizon is stretched for interpolation
_STRETCH = 0.1
# Zenith angle beyond which the picture is that at it, rad: few directions lie there, and the last pixels are two
_RIM = np.radians(89.0)
_INK, _FAINT, _EMPTY = "#222222", "#8a8a8a", "#e9e9e9"


def place(zenith, azimuth):
    r"""The position of a direction in a dome, $(x, y) = \frac{2\theta}{\pi} (\sin\phi, \cos\phi)$, with the rim at 1.

    **Arguments:** zenith angle and azimuth clockwise from north, radians, of one shape.
    **Returns:** x and y, of that shape.
    """
    radius = np.asarray(zenith) / (0.5 * np.pi)
    return radius * np.sin(azimuth), radius * np.cos(azimuth)


def pixels() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Zenith angle and azimuth (radians) of a dome's pixels, top row first, and which lie above the horizon."""
    edge = (np.arange(_SIZE) + 0.5) / _SIZE * 2.0 - 1.0
    x, y = np.meshgrid(edge, edge[::-1])
    radius = np.hypot(x, y)
    return 0.5 * np.pi * radius, np.arctan2(x, y), radius <= 1.0


def cells(zenith: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """The index of the direction nearest to each pixel of a dome, -1 if none is near: Voronoi cells on the sphere.

    **Arguments:** the directions, radians. **Returns:** indices, `[row, column]`.
    """
    from scipy.spatial import KDTree

    above = np.flatnonzero(zenith <= 0.5 * np.pi)
    result = np.full((_SIZE, _SIZE), -1)
    if above.size == 0:
        return result
    tree = KDTree(_unit(zenith[above], azimuth[above]))
    pixel_zenith, pixel_azimuth, inside = pixels()
    away, nearest = tree.query(_unit(pixel_zenith[inside], pixel_azimuth[inside]))
    if above.size > 1:
        # A cell extends no farther than the distance between samples
        reach = max(np.percentile(tree.query(tree.data, k=2)[0][:, 1], 90.0), 0.02)
    else:
        reach = 0.3
    result[inside] = np.where(away <= reach, above[nearest], -1)
    return result


def interpolated(zenith: np.ndarray, azimuth: np.ndarray, values: np.ndarray) -> np.ndarray:
    """A smooth picture interpolated from values at directions, NaN outside the dome.

    **Arguments:** directions in radians, ten or more above the horizon; `values` `[direction, channel]`.
    **Returns:** `[row, column, channel]`.
    **Valid:** the horizon is stretched while interpolating. A few hundred directions, seven degrees apart, do not
    resolve how a clear sky brightens there: the picture would have a bead at each of them.
    **Source:** thin-plate splines of the nearest 24 directions (scipy's `RBFInterpolator`).
    """
    from scipy.interpolate import RBFInterpolator

    def stretched(zenith, azimuth):
        far = zenith + _STRETCH * (1.0 / (np.cos(zenith) + _STRETCH) - 1.0 / (1.0 + _STRETCH))
        return np.stack(place(far, azimuth), axis=-1)

    # A direction that occurs twice, such as the zenith, would make the spline singular
    above = np.minimum(zenith, 0.5 * np.pi)
    points = np.round(stretched(above, azimuth), 9)
    _, once = np.unique(points, axis=0, return_index=True)
    once = once[zenith[once] <= 0.5 * np.pi + 1e-6]
    pixel_zenith, pixel_azimuth, inside = pixels()
    spline = RBFInterpolator(points[once], values[once], neighbors=24)
    result = np.full((_SIZE, _SIZE, values.shape[-1]), np.nan)
    result[inside] = spline(stretched(np.minimum(pixel_zenith[inside], _RIM), pixel_azimuth[inside]))
    return result


def draw_dome(axes, picture, sun: tuple[float, float], *, compass: bool = True, **style):
    """Draw a dome's picture into axes with its rim, rings and the sun; return matplotlib's image."""
    from matplotlib.patches import Circle

    axes.set_xlim(-1.16, 1.16)
    axes.set_ylim(-1.16, 1.16)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.add_patch(Circle((0.0, 0.0), 1.0, facecolor=_EMPTY, edgecolor="none", zorder=0))
    image = axes.imshow(picture, extent=(-1.0, 1.0, -1.0, 1.0), interpolation="nearest", zorder=1, **style)
    image.set_clip_path(Circle((0.0, 0.0), 1.0, transform=axes.transData))
    axes.add_patch(Circle((0.0, 0.0), 1.0, fill=False, edgecolor=_INK, linewidth=0.8, zorder=4))
    if compass:
        for radius in (1.0 / 3.0, 2.0 / 3.0):
            ring = Circle((0.0, 0.0), radius, fill=False, edgecolor="white", linewidth=0.5, alpha=0.55)
            ring.set_zorder(2)
            axes.add_patch(ring)
        for text, azimuth in (("N", 0.0), ("E", 90.0), ("S", 180.0), ("W", 270.0)):
            x, y = place(0.5 * np.pi * 1.09, np.radians(azimuth))
            axes.text(x, y, text, ha="center", va="center", fontsize=7, color=_FAINT)
    if sun[0] <= 0.5 * np.pi:
        x, y = place(*sun)
        axes.plot(x, y, "o", markersize=7, markerfacecolor="none", markeredgecolor="white", zorder=6,
                  markeredgewidth=2.4)  # fmt: skip
        axes.plot(x, y, "o", markersize=7, markerfacecolor="none", markeredgecolor=_INK, zorder=7,
                  markeredgewidth=1.0)  # fmt: skip
        axes.plot(x, y, ".", markersize=2.5, color=_INK, zorder=7)
    return image


def _unit(zenith, azimuth):
    sine = np.sin(zenith)
    return np.stack([sine * np.sin(azimuth), sine * np.cos(azimuth), np.cos(zenith)], axis=-1)
