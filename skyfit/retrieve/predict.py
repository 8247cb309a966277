"""What the instrument would read of fitted skies elsewhere: at other directions or wavelengths."""

import numpy as np

from ..measured import Sky
from .result import Fit, Fitted
from .sampling import Sampling


def predict(fit: Fit | Fitted, sky: Sky) -> np.ndarray:
    """The fitted skies at the times, directions and wavelengths of another sky, as the instrument would read them.

    **Arguments:** `fit` (of `skyfit.invert`, or what `skyfit.load` gives); `sky`, whose radiance is not used.
    **Returns:** radiance `[time, direction, wavelength]`, W m^-2 sr^-1 nm^-1, NaN beyond 300-1100 nm; the fitted
    pointing offsets and, interpolated, the fitted calibration are in it.
    **Errors:** `ValueError` for a time of `sky` that was not fitted; one sky without a time matches one fit.
    """
    fitted = fit.fitted if isinstance(fit, Fit) else fit
    sampling = Sampling(sky, fitted.fwhm_nm)
    order = [_matching(fitted.time, sky.time, t) for t in range(len(sky.time))]
    read = np.stack([sampling.readings(fitted.solver, fitted.models[i], t) for t, i in enumerate(order)])
    scale = np.stack([np.interp(sky.wavelength_nm, fitted.fitted_nm, fitted.calibration[i]) for i in order])
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
