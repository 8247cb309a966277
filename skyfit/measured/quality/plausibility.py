"""Check whether the model has explained a sky."""

import numpy as np
from jaxtyping import Bool, Float

from ..samples import Sky, time_names


# largest root mean square residual over the mean radiance; the eight scans of 2013-05-27 have 0.06 to 0.09
POOR = 0.25
# largest root mean square residual over sigma, if a file states sigma, and if the noise is assumed (`NoiseModel`). With
# the assumed noise those scans have 0.9 to 1.7
_LARGE_STATED, _LARGE_ASSUMED = 2.0, 3.0


def doubts(
    sky: Sky,
    model: Float[np.ndarray, "time direction wavelength"],
    used: Bool[np.ndarray, "time direction wavelength"],
    reduced_chi_square: Float[np.ndarray, " time"],
) -> tuple[str, ...]:
    """Doubts about a fit, in sentences: residuals far beyond the noise or beyond any use.

    **Arguments:** `sky`; `model`, the fitted radiance; `used`, the samples that the fit was to explain, without
    outliers; `reduced_chi_square` of their residuals without robust weights.
    **Returns:** a sentence for each time that is poor (`poor_fit`) or whose residuals are large: beyond 2 sigma if the
    file states sigma, beyond 3 if the noise is assumed.
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
    """A sentence if the residuals of a time are far beyond the noise, as in `doubts`, else none."""
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

    **Arguments:** as in `doubts`. **Returns:** `[time]`; a fit for which this is true is no success.
    """
    return ~(_share(sky, model, used) <= POOR)


def _share(sky: Sky, model, used):
    """Root mean square residual over mean radiance, `[time]`, infinite if there is no light."""
    count = np.maximum(used.sum(axis=(1, 2)), 1)
    radiance = np.where(used, sky.radiance, 0.0)
    error = np.sqrt((np.where(used, model - radiance, 0.0) ** 2).sum(axis=(1, 2)) / count)
    mean = radiance.sum(axis=(1, 2)) / count
    return np.where(mean > 0.0, error / np.where(mean > 0.0, mean, 1.0), np.inf)


def at_time(sky: Sky, time: int) -> str:
    """The beginning of a sentence about one time: its name, if there are several times."""
    return "" if len(sky.time) == 1 else f"{time_names(sky)[time]}: "
