"""Checks of a measured sky before any fit: whether it can be a sky, and what is odd about it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from ...atmosphere import bodhaine_optical_depth, pressure_at_altitude
from ...light import extraterrestrial_irradiance
from ...light.solar import SPECTRUM_NM
from ..samples import Sky
from .placed_sun import cosine_from_sun, misplaced_sun
from .plausibility import at_time


# radiance over the sun's irradiance, per steradian. A white ground under the sky returns E/pi at most, 0.32, and air
# and cloud over it little more: 0.4 is doubted. 1 is no sky beyond the aureole; in the aureole cirrus has reached some
# 70
_BRIGHT, _BRIGHTEST, _BRIGHTEST_AUREOLE = 0.4, 1.0, 100.0
_AUREOLE = np.radians(15.0)
# limit for the sun's disc itself: 1 / 6.8e-5 sr, seen through the air and spread over the field of view
_DISC = 10.0
# radiance over the single scattering of air alone. Partial eclipses and smoke reach a tenth; 0.01 is night or a wrong
# unit
_DARK, _DARKEST = 0.3, 0.01
# relative spread over the directions below which a sky has no pattern; the flattest overcast sky has 0.3
_FLAT = 0.03
# altitudes below this may be in km: a station at 0.325 m is more often than not one at 325 m
_HIGHEST_KM = 9.0
# pressure against altitude: weather moves it by 5 % at most
_WEATHER = 0.08
_PLATEAU, _PLATEAU_SHARE = 5, 0.01


def examine(sky: Sky, used: Bool[np.ndarray, "time direction wavelength"]) -> tuple[str, ...]:
    """Find what is odd about a measured sky before any fit, in sentences for the user.

    **Arguments:** `sky`; `used`, the samples that will be fitted.
    **Returns:** sentences, none for a sky without oddities: brighter or darker than skies are, the sun not where the
    sky is bright, no pattern, one sample many times, altitude or pressure in another unit, too few directions or
    wavelengths for error bars that stand alone.
    **Errors:** `ValueError` if no time can be a sky in sunlight: each is brighter than any sky, or darker than a
    hundredth of the light that air scatters. If only some times are, sentences name them.
    """
    inside = (sky.wavelength_nm >= SPECTRUM_NM[0]) & (sky.wavelength_nm <= SPECTRUM_NM[1])
    used = used & inside
    found, impossible = [*_station(sky), *_repeated(sky, used)], []
    # the fit refuses times with the sun below the horizon or without samples
    times = [time for time in range(len(sky.time)) if used[time].any() and sky.sun_at(time)[0] < 0.5 * np.pi]
    for time in times:
        light = _light(sky, used, time)
        impossible += _impossible(light)
        said = [*_impossible(light), *_odd(light), *_pattern(sky, used, time), *_extent(sky, used, time)]
        found += [at_time(sky, time) + sentence for sentence in said]
    if times and len(impossible) == len(times):
        raise ValueError(f"`sky` {impossible[0]}")
    return tuple(dict.fromkeys(found))


def _station(sky: Sky):
    altitude, pressure = sky.altitude_m, sky.pressure_pa
    if 0.0 < altitude < _HIGHEST_KM and altitude != round(altitude):
        yield f"the station's altitude is {altitude:g} m: is this km?"
    if np.isfinite(altitude) and np.isfinite(pressure):
        expected = float(pressure_at_altitude(altitude))
        if abs(pressure / expected - 1.0) > _WEATHER:
            yield (
                f"a pressure of {pressure:g} Pa does not go with an altitude of {altitude:g} m ({expected:.0f} Pa): "
                "reduced to sea level, or another unit?"
            )


def _repeated(sky: Sky, used):
    known = sky.time[~np.isnat(sky.time)]
    if len(np.unique(known)) < len(known):
        yield "a time stands more than once: each counts as a sky of its own"
    light = np.where(used, sky.radiance, np.nan)
    # the angles of all times in a row for each direction
    angles = np.round(np.degrees(np.concatenate([sky.view_zenith, sky.view_azimuth % (2.0 * np.pi)]).T), 6)
    order = np.lexsort(angles.T)
    for first, second in zip(order[:-1], order[1:], strict=True):
        if np.array_equal(angles[first], angles[second], equal_nan=True) and used[:, first].any():
            if np.array_equal(light[:, first], light[:, second], equal_nan=True):
                yield f"directions {first} and {second} hold the same samples: their noise counts as independent"
    samples = sky.radiance[used]
    if samples.size:
        top = int(np.count_nonzero(samples == samples.max()))
        if top >= max(_PLATEAU, _PLATEAU_SHARE * samples.size):
            yield f"the largest radiance, {samples.max():g}, stands in {top} samples: a saturated detector?"


class _Light(NamedTuple):
    """How bright a sky is: medians over the samples, and the number of samples brighter than any sky."""

    share: float  # of the sun's irradiance, sr^-1, beyond the aureole if there are samples
    limit: float
    beyond: int
    of_air: float  # of what air alone scatters


def _light(sky: Sky, used, time: int) -> _Light:
    at = used[time]
    irradiance = np.ones(sky.wavelength_nm.shape)
    inside = used.any(axis=(0, 1))
    irradiance[inside] = np.asarray(extraterrestrial_irradiance(sky.wavelength_nm[inside]))
    share = sky.radiance[time] / irradiance[None]
    far = np.broadcast_to((_angle_from_sun(sky, time) > _AUREOLE)[:, None], share.shape)
    counted, limit = (at & far, _BRIGHTEST) if (at & far).any() else (at, _BRIGHTEST_AUREOLE)
    beyond = at & (share > np.where(far, 2.0 * _BRIGHTEST, _DISC))
    of_air = share[at] / np.maximum(_air(sky, time)[at], 1e-30)
    return _Light(float(np.median(share[counted])), limit, int(beyond.sum()), float(np.median(of_air)))


def _impossible(light: _Light):
    if light.share > light.limit:
        yield (
            f"has {light.share:.3g} times the sun's irradiance per sr, in the median, and no sky passes "
            f"{light.limit:g}: is the radiance in mW or per um (1000 times W m-2 sr-1 nm-1), or in uW cm-2 (100 times)?"
        )
    elif light.of_air < _DARKEST:
        yield (
            f"has {light.of_air:.2g} of the light that air alone scatters, in the median: is it night, or the "
            "radiance in another unit?"
        )


def _odd(light: _Light):
    if light.share > light.limit or light.of_air < _DARKEST:
        return
    if light.limit == _BRIGHTEST and light.share > _BRIGHT:
        yield f"brighter than skies are: {light.share:.2g} of the sun's irradiance per sr, in the median; another unit?"
    if light.of_air < _DARK:
        yield f"darker than air without haze: {light.of_air:.2g} of its light in the median; eclipse, or another unit?"
    if light.beyond:
        yield f"{light.beyond} samples are brighter than any sky: the sun's disc in the field of view?"


def _air(sky: Sky, time: int):
    r"""Single scattering of air at sea level over a flat Earth, per irradiance, sr^-1, `[direction, wavelength]`.

    $\frac{3}{16\pi} (1 + \cos^2\gamma) \frac{\tau}{\mu} e^{-\tau/\mu_s} \frac{1 - e^{-x}}{x}$,
    $x = \tau (1/\mu - 1/\mu_s)$ (Chandrasekhar 1960, sec. 9).
    """
    depth = bodhaine_optical_depth(sky.wavelength_nm)[None]
    view = np.maximum(np.cos(sky.view_zenith[time]), 0.02)[:, None]
    sun = max(float(np.cos(sky.sun_at(time)[0])), 0.02)
    gap = depth * (1.0 / view - 1.0 / sun)
    gap = np.where(np.abs(gap) < 1e-6, 1e-6, gap)
    path = depth / view * np.exp(-depth / sun) * -np.expm1(-gap) / gap
    cosine = _cosine(sky, time)[:, None]
    return 3.0 / (16.0 * np.pi) * (1.0 + cosine**2) * path


def _pattern(sky: Sky, used, time: int):
    at = used[time] & (sky.radiance[time] > 0.0)
    counts = at.sum(axis=0)
    full = counts >= 4
    angle = _angle_from_sun(sky, time)
    if full.any() and np.ptp(angle[at.any(axis=1)]) > np.radians(30.0):
        light = np.where(at, sky.radiance[time], 0.0)[:, full]
        mean = light.sum(axis=0) / counts[full]
        spread = np.sqrt((np.where(at[:, full], light - mean[None], 0.0) ** 2).sum(axis=0) / counts[full]) / mean
        if np.median(spread) < _FLAT:
            alike = f"{100.0 * np.median(spread):.1g} %"
            yield f"all directions are alike within {alike}: no clear sky, but a cloud, a lamp or a constant?"
            return
    sentence = misplaced_sun(sky, used, time)
    if sentence:
        yield sentence


def _extent(sky: Sky, used, time: int):
    """Yield notes if the directions or wavelengths are too few for error bars that do not rely on fixed values."""
    seen = used[time].any(axis=1)
    angles = np.round(np.stack([sky.view_zenith[time], sky.view_azimuth[time] % (2.0 * np.pi)], axis=1)[seen], 6)
    if len(np.unique(angles, axis=0)) < 3 or np.ptp(_angle_from_sun(sky, time)[seen]) < np.radians(10.0):
        yield "too few directions to tell the haze's amount from its phase function: sigmas hold for what is held fixed"
    wavelengths = sky.wavelength_nm[used[time].any(axis=0)]
    if wavelengths[-1] < 1.1 * wavelengths[0]:
        yield (
            f"wavelengths of {wavelengths[0]:g}-{wavelengths[-1]:g} nm only: what is said of 550 nm or of other "
            "colours leans on what is held fixed"
        )


def _cosine(sky: Sky, time: int):
    return cosine_from_sun(sky.view_zenith[time], sky.view_azimuth[time], *sky.sun_at(time))


def _angle_from_sun(sky: Sky, time: int):
    """The angle from the sun in radians, `[direction]`."""
    return np.arccos(np.clip(_cosine(sky, time), -1.0, 1.0))
