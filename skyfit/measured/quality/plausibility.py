"""Whether the model has explained a sky: what a fit leaves to doubt."""

import numpy as np
from jaxtyping import Bool, Float

from ..samples import Sky, time_names


# root mean square residual by the mean radiance; the eight scans of 2013-05-27 have 0.06 to 0.09
POOR = 0.25
# and by sigma: of a file that states it, and of the noise that is taken where it does not, by which those scans have
# 0.9 to 1.7 (`NoiseModel`)
_LARGE_STATED, _LARGE_ASSUMED = 2.0, 3.0


def doubts(
    sky: Sky,
    model: Float[np.ndarray, "time direction wavelength"],
    used: Bool[np.ndarray, "time direction wavelength"],
    reduced_chi_square: Float[np.ndarray, " time"],
) -> tuple[str, ...]:
    """What a fit leaves to doubt, in sentences: residuals far beyond the noise or beyond any use.

    **Arguments:** `sky`; `model`, the fitted radiance; `used`, the samples that the fit was to explain, without
    outliers; `reduced_chi_square` of their residuals without robust weights.
    **Returns:** a sentence for each time that is poor (`poor_fit`) or whose residuals are large: 2 sigma of a file that
    states it, 3 of the noise that is taken where it does not.
    """
    found = []
    shares, poor = _share(sky, model, used), poor_fit(sky, model, used)
    for time, (share, chi_square) in enumerate(zip(shares, reduced_chi_square, strict=True)):
        if poor[time]:
            left = f"{100.0 * share:.0f} % of the mean radiance" if np.isfinite(share) else "not finite"
            found.append(f"{at_time(sky, time)}poor fit, the residuals are {left}: neither values nor sigmas hold")
        else:
            found += [at_time(sky, time) + sentence for sentence in beyond_sigma(sky, chi_square)]
    return tuple(found)


def beyond_sigma(sky: Sky, reduced_chi_square: float) -> tuple[str, ...]:
    """A sentence where the residuals of a time are far beyond the noise, as in `doubts`, else nothing."""
    ratio = np.sqrt(reduced_chi_square)
    if ratio <= (_LARGE_ASSUMED if sky.sigma is None else _LARGE_STATED):
        return ()
    return (
        f"the residuals are {ratio:.3g} times their sigma: it is understated, or the model lacks something that the "
        "error bars do not know",
    )


def poor_fit(
    sky: Sky,
    model: Float[np.ndarray, "time direction wavelength"],
    used: Bool[np.ndarray, "time direction wavelength"],
) -> Bool[np.ndarray, " time"]:
    """Whether the root mean square of the residuals exceeds a quarter of the mean radiance, or is not finite.

    **Arguments:** as `doubts`. **Returns:** `[time]`; a fit of which this is true is no success.
    """
    return ~(_share(sky, model, used) <= POOR)


def _share(sky: Sky, model, used):
    """Root mean square residual over mean radiance, `[time]`, infinite where there is no light."""
    count = np.maximum(used.sum(axis=(1, 2)), 1)
    radiance = np.where(used, sky.radiance, 0.0)
    error = np.sqrt((np.where(used, model - radiance, 0.0) ** 2).sum(axis=(1, 2)) / count)
    mean = radiance.sum(axis=(1, 2)) / count
    return np.where(mean > 0.0, error / np.where(mean > 0.0, mean, 1.0), np.inf)


def at_time(sky: Sky, time: int) -> str:
    """How a sentence about one time begins: with its name, where there are several."""
    return "" if len(sky.time) == 1 else f"{time_names(sky)[time]}: "
