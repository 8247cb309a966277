"""Check whether the sky is brightest where the file places the sun."""

import numpy as np
from jaxtyping import Bool, Float

from ..samples import Sky


# a pattern of fewer directions does not determine the place of the sun
_FEWEST = 6
# correlations with the pattern of a clear sky: skies up to optical depth 4 with suns down to zenith angle 88 gave 0.55
# and more if the sun was at its stated place
_UNLIKELY, _CONVINCING = 0.5, 0.85
# least correlation with zenith angles turned into elevations, and largest share of the unexplained rest that turning
# may leave: only then the zenith angles are doubted
_TURNED, _SHARE_LEFT = 0.93, 0.35
# degrees: a sun this far off is reported; scans over a smaller range of zenith angles do not show how they were counted
_FAR, _WIDE = 20.0, 30.0
# largest variance of views across a vertical plane over that along it, for views that count as in the plane
_PLANE = 0.02
_STEP = 10
# CIE S 011, type 12 (clear, low turbidity)
_GRADATION, _LOBE, _LOBE_FALL, _SQUARE = -0.32, 10.0, -3.0, 0.45


def misplaced_sun(sky: Sky, used: Bool[np.ndarray, "time direction wavelength"], time: int) -> str:
    r"""Return a sentence if the brightness of the sky contradicts the stated angles, else "".

    The mean of $\ln L$ over the wavelengths is compared with the clear sky of CIE S 011 in two ways. For the azimuth it
    is compared with the scattering part alone. A constant, $\theta$ and $\theta^2$ are taken out of both, so that
    neither haze nor a low sun matters. For the zenith angles it is compared with the whole pattern, with angles as
    stated or turned over.

    **Arguments:** `sky`; `used`, the samples that count; `time`, its index.
    **Returns:** a sentence that names the angle between the stated sun and the apparent one and the likely cause.
    **Valid:** six directions or more, for the azimuth not in one vertical plane; else there is no sentence.
    """
    seen = _brightness(sky, used, time)
    if seen is None:
        return ""
    bright, zenith, azimuth = seen
    sun = sky.sun_at(time)
    rest = _without_zenith(zenith)
    stated = _correlation(rest(_lobe(zenith, azimuth, *sun)), rest(bright))
    if stated >= _UNLIKELY:
        return _turned_zenith(bright, zenith, azimuth, *sun, stated)
    if _in_one_plane(zenith, azimuth):
        return ""
    grid = np.radians(np.arange(0.5 * _STEP, 90.0, _STEP)), np.radians(np.arange(0.0, 360.0, _STEP))
    suns = np.stack([axis.ravel() for axis in np.meshgrid(*grid, indexing="ij")])
    scores = _correlation(rest(_lobe(zenith[None], azimuth[None], suns[0][:, None], suns[1][:, None])), rest(bright))
    best = float(suns[0][np.argmax(scores)]), float(suns[1][np.argmax(scores)])
    apart = np.degrees(angle_from_sun(*best, *sun))
    causes = {
        "azimuths counted counter-clockwise": _lobe(zenith, -azimuth, *sun),
        "azimuths counted from south": _lobe(zenith, azimuth + np.pi, *sun),
        "azimuths counted counter-clockwise from south": _lobe(zenith, np.pi - azimuth, *sun),
    }
    likely = {cause: _correlation(rest(pattern), rest(bright)) for cause, pattern in causes.items()}
    cause = max(likely, key=likely.__getitem__)
    if max(np.max(scores), likely[cause]) < _CONVINCING:
        return "no place of the sun explains where this sky is bright" if stated < 0.0 else ""
    if apart < _FAR:
        return ""
    if likely[cause] < _CONVINCING or likely[cause] < np.max(scores) - 0.05:
        cause = "local time in place of UTC, another place, radians, or another azimuth"
    toward = f"zenith {np.degrees(best[0]):.0f}, azimuth {np.degrees(best[1]):.0f}"
    return f"the sky is brightest {apart:.0f} degrees from the stated sun, toward {toward}: {cause}?"


def _turned_zenith(bright, zenith, azimuth, sun_zenith, sun_azimuth, stated) -> str:
    if np.ptp(zenith) < np.radians(_WIDE):
        return ""
    turned, sun_turned = 0.5 * np.pi - zenith, 0.5 * np.pi - sun_zenith
    causes = {
        "view angles": (turned, azimuth, sun_zenith, sun_azimuth),
        "sun angles": (zenith, azimuth, sun_turned, sun_azimuth),
        "view and sun angles": (turned, azimuth, sun_turned, sun_azimuth),
    }
    scores = {cause: _correlation(_clear(*angles), bright) for cause, angles in causes.items()}
    cause = max(scores, key=scores.__getitem__)
    left = 1.0 - _correlation(_clear(zenith, azimuth, sun_zenith, sun_azimuth), bright)
    if scores[cause] < _TURNED or 1.0 - scores[cause] > _SHARE_LEFT * left:
        return ""
    # thick haze darkens the horizon, but it does not move the scattering part
    rest = _without_zenith(causes[cause][0])
    if _correlation(rest(_lobe(*causes[cause])), rest(bright)) < stated:
        return ""
    return f"this sky looks more like one whose {cause} are elevations, given in place of zenith angles"


def _in_one_plane(zenith, azimuth) -> bool:
    """Whether all views lie in one vertical plane, which does not determine the azimuth of the sun."""
    across = np.cov(np.stack([np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth)]))
    small, large = np.linalg.eigvalsh(across)
    return bool(small <= _PLANE * large)


def _brightness(sky: Sky, used, time: int):
    """(mean log radiance, zenith, azimuth) of the directions that have samples; None where they are too few."""
    at = used[time] & (sky.radiance[time] > 0.0)
    directions, wavelengths = at.any(axis=1), at.any(axis=0)
    at = at[directions][:, wavelengths]
    if at.shape[0] < _FEWEST:
        return None
    logs = np.where(at, np.log(np.where(at, sky.radiance[time][directions][:, wavelengths], 1.0)), 0.0)
    # subtract the mean of each wavelength first, so that a gap in one direction does not pass for darkness
    logs = np.where(at, logs - logs.sum(axis=0) / at.sum(axis=0), 0.0)
    return logs.sum(axis=1) / at.sum(axis=1), sky.view_zenith[time, directions], sky.view_azimuth[time, directions]


def _without_zenith(zenith):
    """A function that removes a constant, the zenith angle and its square from a pattern, `[..., direction]`."""
    vectors, sizes, _ = np.linalg.svd(np.stack([np.ones_like(zenith), zenith, zenith**2], axis=1), full_matrices=False)
    known = vectors[:, sizes > 1e-6 * sizes[0]]
    return lambda pattern: pattern - pattern @ known @ known.T


def _correlation(pattern, bright) -> Float[np.ndarray, "..."]:
    pattern, bright = pattern - pattern.mean(axis=-1, keepdims=True), bright - bright.mean()
    size = np.sqrt((pattern**2).sum(axis=-1) * (bright**2).sum())
    # a pattern of the size of rounding correlates with nothing
    return np.where(size > 1e-9, pattern @ bright / np.maximum(size, 1e-9), 0.0)


def cosine_from_sun(zenith, azimuth, sun_zenith, sun_azimuth):
    """The cosine of the angle from the sun. **Arguments:** radians, broadcastable.

    It runs on the host: under JAX each file's number of directions would need a new compilation.
    """
    aside = np.sin(zenith) * np.sin(sun_zenith) * np.cos(azimuth - sun_azimuth)
    return np.cos(zenith) * np.cos(sun_zenith) + aside


def angle_from_sun(zenith, azimuth, sun_zenith, sun_azimuth):
    """The angle from the sun, rad. **Arguments:** as `cosine_from_sun`."""
    return np.arccos(np.clip(cosine_from_sun(zenith, azimuth, sun_zenith, sun_azimuth), -1.0, 1.0))


def _lobe(zenith, azimuth, sun_zenith, sun_azimuth):
    """The log of the scattering part of the clear sky of CIE S 011."""
    cosine = np.clip(cosine_from_sun(zenith, azimuth, sun_zenith, sun_azimuth), -1.0, 1.0)
    fall = np.exp(_LOBE_FALL * np.arccos(cosine)) - np.exp(_LOBE_FALL * 0.5 * np.pi)
    return np.log(1.0 + _LOBE * fall + _SQUARE * cosine**2)


def _clear(zenith, azimuth, sun_zenith, sun_azimuth):
    """The log of the whole clear sky, its gradation held above 88 degrees."""
    gradation = 1.0 - np.exp(_GRADATION / np.maximum(np.cos(zenith), 0.03))
    return np.log(gradation) + _lobe(zenith, azimuth, sun_zenith, sun_azimuth)
