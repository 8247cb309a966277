"""The sun's position in a picture of the sky, from its disc, the light around it or the pattern of the whole sky."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..measured.quality.placed_sun import angle_from_sun, cosine_from_sun


How = Literal["disc", "patch", "aureole", "pattern"]
# Inner and outer radius of the ring around a disc, rad, and the least ratio of disc to ring; no aureole and no cloud
# reaches that ratio
_RING, _OUTSHINES = np.radians([4.0, 8.0]), 30.0
# Limits for a saturated patch taken as the sun: distance from the pattern's sun and radius, rad, and the ratio of its
# reach to its radius
_PATCH, _LARGEST, _ROUND = np.radians(25.0), np.radians(25.0), 2.5
# Radius of the spoilt region: a constant, rad, plus a multiple of the disc's radius; sigma of a patch's centre as a
# share of its radius
_BLOOM, _SPREAD, _OFF = np.radians(2.0), 1.2, 0.3
# Largest distance of the sun from a first guess, rad
_WITHIN = np.radians(35.0)
# Settings of the pattern fit: number of pixels, least angle from the horizon, grid spacing of trial suns, sigma; rad
_COUNT, _LOW, _STEP, _COARSE = 600, np.radians(10.0), np.radians(15.0), np.radians(5.0)
# Widths of the exponentials that add up to the light around the sun, rad
_WIDTHS = np.radians([1.5, 4.0, 12.0, 36.0])
# Exponents b of gradations exp(b / cos z), among those of CIE S 011
_GRADATIONS = (-0.15, -0.5)
# Radii of the successive fits to the aureole, rad, and the solar zenith angle below which the last one uses a parabola
# as gradation
_LOOKS, _HIGH = np.radians([25.0, 15.0, 8.0]), np.radians(78.0)
# Least number of pixels; least share of the variance left by the gradation that the aureole must explain; least sigma,
# rad
_PIXELS, _EXPLAINED, _FINEST = 60, 0.5, np.radians(0.1)


class FoundSun(NamedTuple):
    """Zenith angle and azimuth of the sun in a picture, rad, and their standard deviation `sigma`, rad.

    `how` it was found; `blinded`: the radius of the region spoilt by disc and bloom, rad; `explained`: the share of the
    variance of the sky's log luminance that the sun's pattern explains.
    """

    zenith: float
    azimuth: float
    sigma: float
    how: How
    blinded: float
    explained: float


class Sight(NamedTuple):
    """The pixels of a picture in which the sun is searched, `[pixel]`.

    `luminance` in any unit; `full`, mask of pixels at the file's limit; `used`, mask of sky pixels that are not full;
    zenith angles and azimuths, rad; `size`, solid angle, sr.
    """

    luminance: Float[np.ndarray, " pixel"]
    used: Bool[np.ndarray, " pixel"]
    full: Bool[np.ndarray, " pixel"]
    zenith: Float[np.ndarray, " pixel"]
    azimuth: Float[np.ndarray, " pixel"]
    size: Float[np.ndarray, " pixel"]

    def take(self, where) -> "Sight":
        return Sight(*(part[where] for part in self))

    def within(self, place, angle: float) -> Bool[np.ndarray, " pixel"]:
        return cosine_from_sun(self.zenith, self.azimuth, *place) > np.cos(angle)


def find_sun(sight: Sight, near: tuple[float, float] | None = None) -> FoundSun:
    """Find the sun of a picture: by its disc, else a saturated patch, else the aureole, else the pattern of the sky.

    **Arguments:** `near`, zenith angle and azimuth of a first guess, rad, at most 35 degrees from the sun.
    **Errors:** `ValueError` if too little of the sky is seen. **Valid:** `explained` below one half means that the sky
    is not clear. A nearly unobstructed sun is found within 0.1 degrees, a low sun by its aureole within two degrees.
    """
    disc = _disc(sight)
    if disc is not None:
        sight = sight._replace(used=sight.used & ~sight.within(disc[:2], disc[3]))
        near = disc[:2]
    place, explained = _by_pattern(sight.take(sight.used), near)
    if disc is not None:
        return FoundSun(*disc[:3], "disc", disc[3], explained)
    patch = _patch(sight, place)
    # The aureole around a patch begins at its rim
    place, rim = (place, 0.0) if patch is None else (patch[:2], (patch[3] - _BLOOM) / _SPREAD)
    aureole = _by_aureole(sight.take(sight.used), place, rim)
    if patch is not None:
        # The patch extends farther on the brighter side of the sky, so the aureole gives the better centre
        if aureole is not None and cosine_from_sun(*aureole[:2], *patch[:2]) > np.cos(patch[3]):
            patch = *aureole[:2], max(aureole[2], 0.25 * patch[2]), patch[3]
        return FoundSun(*patch[:3], "patch", patch[3], explained)
    if aureole is not None:
        return FoundSun(*aureole, "aureole", 0.0, explained)
    return FoundSun(*place, _COARSE, "pattern", 0.0, explained)


def _disc(sight: Sight):
    """Zenith angle, azimuth, sigma and spoilt radius of a disc much brighter than its surroundings, or None."""
    seen = sight.take(sight.used | sight.full)
    if not seen.luminance.size:
        return None
    top = int(np.argmax(seen.luminance))
    place = float(seen.zenith[top]), float(seen.azimuth[top])
    ring = seen.luminance[seen.within(place, _RING[1]) & ~seen.within(place, _RING[0])]
    if ring.size == 0 or seen.luminance[top] < _OUTSHINES * np.median(ring):
        return None
    bright = seen.within(place, _RING[0]) & (seen.luminance > _OUTSHINES * np.median(ring))
    return _middle(seen.take(bright), seen.luminance[bright], 0.0)


def _patch(sight: Sight, place):
    """Zenith angle, azimuth, sigma and spoilt radius of the saturated pixels near a place, or None."""
    full = sight.take(sight.full & sight.within(place, _PATCH))
    if not full.size.size:
        return None
    zenith, azimuth, sigma, spoilt = _middle(full, np.ones(full.size.size), _OFF)
    radius = np.sqrt(full.size.sum() / np.pi)
    reach = np.arccos(np.clip(cosine_from_sun(full.zenith, full.azimuth, zenith, azimuth).min(), -1.0, 1.0))
    if radius > _LARGEST or reach > _ROUND * radius + np.sqrt(full.size.max()):
        return None
    return zenith, azimuth, sigma, spoilt


def _middle(patch: Sight, light, off: float):
    """Zenith angle, azimuth, sigma and spoilt radius of a patch; `off` is the error as a share of its radius."""
    weight = light * patch.size
    east, north = (weight @ (np.sin(patch.zenith) * turn(patch.azimuth)) for turn in (np.sin, np.cos))
    zenith = float(np.arctan2(np.hypot(east, north), weight @ np.cos(patch.zenith)))
    radius, pixel = np.sqrt(patch.size.sum() / np.pi), np.sqrt(patch.size.max())
    sigma = float(np.hypot(0.25 * pixel, off * radius))
    return zenith, float(np.arctan2(east, north) % (2.0 * np.pi)), sigma, float(_BLOOM + _SPREAD * radius)


def _by_pattern(sky: Sight, near) -> tuple[tuple[float, float], float]:
    r"""The sun fitted to the pattern of the whole sky, and the share of the variance that it explains.

    $\ln L = f(\theta) + h(\gamma)$, with gradation f and scattering part h as sums of given functions, fitted by least
    squares for each trial sun. If the sky does not separate into these two parts the sun is a few degrees off.
    """
    high = sky.take(sky.zenith < 0.5 * np.pi - _LOW)
    if high.size.size < _PIXELS:
        raise ValueError(f"{high.size.size} pixels of sky are seen above {np.degrees(_LOW):.0f} degrees: too few")
    some = np.random.default_rng(0).choice(high.size.size, _COUNT, p=high.size / high.size.sum())
    high = high.take(some)
    cosine, bright = np.cos(high.zenith), np.log(high.luminance)
    steep = [1.0 / (cosine + 0.03), 1.0 / (cosine + 0.15)]
    gradation = [np.ones_like(cosine), high.zenith, high.zenith**2, high.zenith**4, *steep]

    def left(sun):
        away = cosine_from_sun(high.zenith, high.azimuth, *sun)
        return _left(bright, gradation, [*_around(away, _WIDTHS), away, away**2])

    grid = [(z, a) for z in np.arange(0.5 * _STEP, 0.5 * np.pi, _STEP) for a in np.arange(0.0, 2.0 * np.pi, _STEP)]
    if near is not None:
        grid = [sun for sun in grid if cosine_from_sun(*sun, *near) > np.cos(_WITHIN)] + [near]
    begin = min(grid, key=left)
    zenith, azimuth = _least(lambda move: left(_moved(begin, move)), 0.1)
    zenith, azimuth = _moved(begin, (zenith, azimuth))
    explained = 1.0 - left((zenith, azimuth)) / max(float(np.var(bright)), 1e-9)
    return (min(zenith, np.radians(89.0)), azimuth), explained


def _by_aureole(sky: Sight, place, rim: float):
    """The sun fitted to the aureole in regions of decreasing radius, with sigma; None if there is too little light."""
    sigma = _COARSE
    for look in _LOOKS + rim:
        before = place
        for _ in range(2):
            some = sky.take(sky.within(place, look))
            if some.size.size < _PIXELS:
                break
            bright, level = np.log(some.luminance), np.cos(some.zenith) + 0.01
            gradation = [np.ones_like(level), some.zenith]
            if look == _LOOKS[-1] and place[0] < _HIGH:
                gradation.append(some.zenith**2)
            else:
                gradation += [np.exp(b / level) for b in _GRADATIONS]

            def left(move, some=some, place=place, bright=bright, gradation=gradation, look=look):
                away = cosine_from_sun(some.zenith, some.azimuth, *_moved(place, move))
                # A sun outside the region explains nothing
                beyond = max(float(np.hypot(*move)) - look, 0.0)
                return _left(bright, gradation, _around(away, _WIDTHS[:-1]), some.size) + beyond

            move = _least(left, 0.25 * look)
            if 1.0 - left(move) / max(_left(bright, gradation, [], some.size), 1e-12) < _EXPLAINED:
                return None
            place = _moved(place, move)
        else:
            sigma = max(float(angle_from_sun(*before, *place)), _FINEST)
            continue
        return None if look == _LOOKS[0] + rim else (*place, sigma)
    return *place, sigma


def _around(cosine, widths):
    """Exponentials of the negative angle from the sun over each width."""
    return np.exp(-np.arccos(np.clip(cosine, -1.0, 1.0))[None] / widths[:, None])


def _left(bright, gradation, around, size=None) -> float:
    """The residual variance of a least squares fit by given functions, pixels weighted by size."""
    root = np.ones(bright.size) if size is None else np.sqrt(size)
    columns = np.stack([*gradation, *around], axis=1) * root[:, None]
    found = np.linalg.lstsq(columns, bright * root, rcond=1e-10)[0]
    return float(np.sum((root * bright - columns @ found) ** 2) / np.sum(root**2))


def _least(left, step: float) -> tuple[float, float]:
    """The move, rad down and right, that minimises `left`, starting from no move."""
    from scipy.optimize import minimize

    options = {"initial_simplex": np.array([[0.0, 0.0], [step, 0.0], [0.0, step]]), "xatol": 1e-4, "fatol": 1e-10}
    end = minimize(left, np.zeros(2), method="Nelder-Mead", options=options)
    return float(end.x[0]), float(end.x[1])


def _moved(place, move) -> tuple[float, float]:
    """A place moved by so many radians down and to the right, at most to the horizon."""
    zenith, azimuth = place
    sine, cosine = np.sin(zenith), np.cos(zenith)
    out, up = sine + move[0] * cosine, cosine - move[0] * sine
    east, north = out * np.sin(azimuth) + move[1] * np.cos(azimuth), out * np.cos(azimuth) - move[1] * np.sin(azimuth)
    below = np.arctan2(np.hypot(east, north), up)
    return float(min(below, 0.5 * np.pi)), float(np.arctan2(east, north) % (2.0 * np.pi))
