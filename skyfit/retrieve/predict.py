"""Predict what the instrument would read of fitted skies at other directions or wavelengths."""

import numpy as np

from ..measured import Response, Sky
from .result import Fit, Fitted
from .sampling import Sampling, scale_at


def predict(fit: Fit | Fitted, sky: Sky, response: Response | None = None) -> np.ndarray:
    """Predict the fitted skies at the times, directions and wavelengths of another sky, as the instrument reads them.

    **Arguments:** `fit` (of `skyfit.invert` or `skyfit.load`); `sky`, whose radiance is not used. Its wavelengths are
    seen through the fit's line shape, or through the channels of its `response`, which can also be the argument
    `response` (`Sky.with_response`).
    **Returns:** radiance `[time, direction, wavelength]`, W m^-2 sr^-1 nm^-1, NaN beyond 300-1100 nm, or the reading of
    the channels. It includes the fitted pointing offsets. It includes the fitted calibration, interpolated, if both
    skies are seen by the same channels or both by wavelength.
    **Errors:** `ValueError` for a time of `sky` that was not fitted; one sky without a time matches one fit.
    """
    fitted, sky = fit.fitted if isinstance(fit, Fit) else fit, sky.with_response(response)
    sampling = Sampling(sky, fitted.fwhm_nm if sky.response is None else None)
    order = [_matching(fitted.time, sky.time, t) for t in range(len(sky.time))]
    read = np.stack([sampling.readings(fitted.solver, fitted.models[i], t) for t, i in enumerate(order)])
    both = sky.response, fitted.response
    if both != (None, None) and not (both[0] is not None and both[0].same_as(both[1])):
        # the calibration of another instrument is unknown
        return read
    scale = np.stack([scale_at(sky.wavelength_nm, fitted.fitted_nm, fitted.calibration[i]) for i in order])
    return read * scale[:, None]


def _matching(fitted_time: np.ndarray, time: np.ndarray, index: int) -> int:
    wanted = time[index]
    if len(fitted_time) == len(time) and np.array_equal(fitted_time, time, equal_nan=True):
        return index
    if len(fitted_time) == 1 and len(time) == 1 and (np.isnat(wanted) or np.isnat(fitted_time[0])):
        return 0
    near = np.flatnonzero(np.abs(fitted_time - wanted) <= np.timedelta64(1, "s"))
    if near.size == 0:
        raise ValueError(
            f"`sky` has the time {wanted}, which was not fitted; fitted: {', '.join(map(str, fitted_time))}"
        )
    return int(near[0])
