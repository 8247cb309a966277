"""What a careful reader of a fit would ask: can this be a sky, and has the model explained it?"""

import numpy as np
from jaxtyping import Bool, Float

from ..atmosphere import bodhaine_optical_depth, pressure_at_altitude
from ..light import extraterrestrial_irradiance
from ..scene import Sky
from .placed_sun import cosine_from_sun, misplaced_sun


# of the sun's irradiance per steradian. A white ground under the sky returns E/pi at most, 0.32, and air and cloud
# over it little more: 0.4 is doubted. 1 is no sky beyond the aureole; there cirrus has come to some 70
_BRIGHT, _BRIGHTEST, _BRIGHTEST_AUREOLE = 0.4, 1.0, 100.0
_AUREOLE = np.radians(15.0)
# the sun's disc itself: 1 / 6.8e-5 sr, seen through the air and spread over the field of view
_DISC = 10.0
# of what air alone scatters once. Partial eclipses and smoke go to a tenth; 0.01 is night or a wrong unit
_DARK, _DARKEST = 0.3, 0.01
# relative spread over the directions below which a sky has no pattern; the flattest overcast has 0.3
_FLAT = 0.03
# residuals by the mean radiance, and by sigma, that no error bar covers; the measured days of 2013 have 0.08 and less
_POOR, _LARGE_RESIDUAL = 0.25, 3.0
# a station at 0.325 m is one at 325 m whose altitude is in km, more often than not
_HIGHEST_KM = 9.0
# pressure against altitude: weather moves it by 5 % at most
_WEATHER = 0.08
_PLATEAU, _PLATEAU_SHARE = 5, 0.01
_SPECTRUM_NM = (300.0, 1100.0)


def examine(sky: Sky, used: Bool[np.ndarray, "time direction wavelength"]) -> tuple[str, ...]:
    """What is odd about a measured sky before any fit: sentences for the user.

    **Arguments:** `sky`; `used`, the samples that will be fitted.
    **Returns:** sentences, none for a sky in order: brighter or darker than skies are, the sun not where the sky is
    bright, no pattern, one sample many times, altitude or pressure in another unit, too few directions or
    wavelengths for error bars that stand alone.
    **Errors:** `ValueError` where sunlight cannot make this: beyond any sky, or a hundredth of what air scatters.
    """
    inside = (sky.wavelength_nm >= _SPECTRUM_NM[0]) & (sky.wavelength_nm <= _SPECTRUM_NM[1])
    used = used & inside
    found = [*_station(sky), *_repeated(sky, used)]
    for time in range(len(sky.time)):
        # the sun below the horizon is for the fit to refuse
        if used[time].any() and sky.sun_zenith[time] < 0.5 * np.pi:
            said = [*_light(sky, used, time), *_pattern(sky, used, time), *_extent(sky, used, time)]
            found += [_where(sky, time) + sentence for sentence in said]
    return tuple(dict.fromkeys(found))


def doubts(
    sky: Sky,
    model: Float[np.ndarray, "time direction wavelength"],
    used: Bool[np.ndarray, "time direction wavelength"],
    reduced_chi_square: Float[np.ndarray, " time"],
) -> tuple[str, ...]:
    """What a fit leaves to doubt, in sentences: residuals far beyond the noise or beyond any use.

    **Arguments:** `sky`; `model`, the fitted radiance; `used`, the samples that the fit was to explain, rejected
    ones too; `reduced_chi_square` of the residuals without robust weights.
    **Returns:** a sentence for each time that is poor (`poor_fit`) or whose residuals are 3 sigma and more.
    """
    found = []
    shares, poor = _share(sky, model, used), poor_fit(sky, model, used)
    for time, (share, chi_square) in enumerate(zip(shares, reduced_chi_square, strict=True)):
        ratio = np.sqrt(chi_square)
        if poor[time]:
            left = f"{100.0 * share:.0f} % of the mean radiance" if np.isfinite(share) else "not finite"
            found.append(f"{_where(sky, time)}poor fit, the residuals are {left}: neither values nor sigmas hold")
        elif not ratio <= _LARGE_RESIDUAL:
            found.append(
                f"{_where(sky, time)}the residuals are {ratio:.3g} times their sigma: it is understated, or the model "
                "lacks something that the error bars do not know"
            )
    return tuple(found)


def poor_fit(
    sky: Sky,
    model: Float[np.ndarray, "time direction wavelength"],
    used: Bool[np.ndarray, "time direction wavelength"],
) -> Bool[np.ndarray, " time"]:
    """Whether the root mean square of the residuals exceeds a quarter of the mean radiance, or is not finite.

    **Arguments:** as `doubts`. **Returns:** `[time]`; a fit of which this is true is no success.
    """
    return ~(_share(sky, model, used) <= _POOR)


def _share(sky: Sky, model, used):
    """Root mean square residual over mean radiance, `[time]`, infinite where there is no light."""
    count = np.maximum(used.sum(axis=(1, 2)), 1)
    radiance = np.where(used, sky.radiance, 0.0)
    error = np.sqrt((np.where(used, model - radiance, 0.0) ** 2).sum(axis=(1, 2)) / count)
    mean = radiance.sum(axis=(1, 2)) / count
    return np.where(mean > 0.0, error / np.where(mean > 0.0, mean, 1.0), np.inf)


def _where(sky: Sky, time: int) -> str:
    return "" if len(sky.time) == 1 else f"time {time}: "


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
    angles = np.round(np.degrees(np.stack([sky.view_zenith, sky.view_azimuth % (2.0 * np.pi)], axis=1)), 6)
    order = np.lexsort(angles.T)
    for first, second in zip(order[:-1], order[1:], strict=True):
        if np.array_equal(angles[first], angles[second]) and used[:, first].any():
            if np.array_equal(light[:, first], light[:, second], equal_nan=True):
                yield f"directions {first} and {second} hold the same samples: their noise counts as independent"
    samples = sky.radiance[used]
    if samples.size:
        top = int(np.count_nonzero(samples == samples.max()))
        if top >= max(_PLATEAU, _PLATEAU_SHARE * samples.size):
            yield f"the largest radiance, {samples.max():g}, stands in {top} samples: a saturated detector?"


def _light(sky: Sky, used, time: int):
    """Whether sunlight can make this radiance."""
    at = used[time]
    irradiance = np.ones(sky.wavelength_nm.shape)
    inside = used.any(axis=(0, 1))
    irradiance[inside] = np.asarray(extraterrestrial_irradiance(sky.wavelength_nm[inside]))
    share = sky.radiance[time] / irradiance[None]
    angle = _angle_from_sun(sky, time)[:, None] + np.zeros_like(share)
    far = at & (angle > _AUREOLE)
    counted, limit = (far, _BRIGHTEST) if far.any() else (at, _BRIGHTEST_AUREOLE)
    middle = float(np.median(share[counted]))
    if middle > limit:
        raise ValueError(
            f"`sky` at time {time} is {middle:.3g} times the sun's irradiance per sr, in the median; no sky passes "
            f"{limit:g}: is the radiance in mW or per um (1000 times the W m-2 sr-1 nm-1 expected) or in uW cm-2 (100)?"
        )
    if far.any() and middle > _BRIGHT:
        yield f"brighter than skies are: {middle:.2g} of the sun's irradiance per sr, in the median; another unit?"
    disc = at & (share > np.where(angle > _AUREOLE, 2.0 * _BRIGHTEST, _DISC))
    if disc.any():
        yield f"{int(disc.sum())} samples are brighter than any sky: the sun's disc in the field of view?"
    dimness = share / np.maximum(_air(sky, time), 1e-30)
    middle = float(np.median(dimness[at]))
    if middle < _DARKEST:
        raise ValueError(
            f"`sky` at time {time} has {middle:.2g} of the light that air alone scatters with the sun at zenith angle "
            f"{np.degrees(sky.sun_zenith[time]):.1f}, in the median: is it night, or the radiance in another unit?"
        )
    if middle < _DARK:
        yield f"darker than air without haze: {middle:.2g} of its light, in the median; an eclipse, or another unit?"


def _air(sky: Sky, time: int):
    r"""What air at sea level scatters once over a flat Earth, per irradiance, sr^-1, `[direction, wavelength]`.

    $\frac{3}{16\pi} (1 + \cos^2\gamma) \frac{\tau}{\mu} e^{-\tau/\mu_s} \frac{1 - e^{-x}}{x}$,
    $x = \tau (1/\mu - 1/\mu_s)$ (Chandrasekhar 1960, sec. 9).
    """
    depth = bodhaine_optical_depth(sky.wavelength_nm)[None]
    view = np.maximum(np.cos(sky.view_zenith), 0.02)[:, None]
    sun = max(float(np.cos(sky.sun_zenith[time])), 0.02)
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
    """Whether the error bars stand alone, without what is held fixed."""
    seen = used[time].any(axis=1)
    angles = np.round(np.stack([sky.view_zenith, sky.view_azimuth % (2.0 * np.pi)], axis=1)[seen], 6)
    if len(np.unique(angles, axis=0)) < 3 or np.ptp(_angle_from_sun(sky, time)[seen]) < np.radians(10.0):
        yield "too few directions to tell the haze's amount from its phase function: sigmas hold for what is held fixed"
    wavelengths = sky.wavelength_nm[used[time].any(axis=0)]
    if wavelengths[-1] < 1.1 * wavelengths[0]:
        yield (
            f"wavelengths of {wavelengths[0]:g}-{wavelengths[-1]:g} nm only: what is said of 550 nm or of other "
            "colours leans on what is held fixed"
        )


def _cosine(sky: Sky, time: int):
    return cosine_from_sun(sky.view_zenith, sky.view_azimuth, sky.sun_zenith[time], sky.sun_azimuth[time])


def _angle_from_sun(sky: Sky, time: int):
    """Radians, `[direction]`."""
    return np.arccos(np.clip(_cosine(sky, time), -1.0, 1.0))
