"""Estimate the instrument's line shape from the solar lines of the measurement itself."""

import numpy as np

from ...light import extraterrestrial_irradiance
from ..samples import Sky


# range in nm, between the ultraviolet edge and the first strong water band
_RANGE = (380.0, 680.0)
_COARSEST_STEP = 2.5
_NARROWEST, _WIDEST = 0.5, 15.0
# steps between the widths tried: over the whole range, then around the best of them
_STEPS = 1.0, 0.25


def estimate_fwhm(sky: Sky) -> float:
    r"""Full width at half maximum (nm) of the Gaussian line shape that best explains the sun's lines.

    The ratio of sky light to sunlight is smooth in wavelength. The width is the one for which the second difference of
    $\ln(L / E_0)$ of the mean spectrum is smallest: the best in steps of 1 nm, then of 0.25 nm around it.

    **Arguments:** `sky`, sampled every 2.5 nm or finer somewhere in 380-680 nm.
    **Returns:** nm, or NaN if the sampling is too coarse.
    **Valid:** widths of 0.5-15 nm. **Source:** Fraunhofer line matching, as in DOAS calibration (Platt & Stutz 2008).
    """
    wavelength = sky.wavelength_nm
    inside = (wavelength >= _RANGE[0]) & (wavelength <= _RANGE[1])
    if inside.sum() < 40 or np.median(np.diff(wavelength[inside])) > _COARSEST_STEP:
        return float("nan")
    complete = np.all(sky.usable[..., inside], axis=-1)
    if not complete.any():
        return float("nan")
    spectrum = np.mean(sky.radiance[complete][:, inside], axis=0)
    if not np.all(spectrum > 0.0):
        return float("nan")

    def roughness(fwhm):
        sun = extraterrestrial_irradiance(wavelength[inside], fwhm)
        return np.sum(np.diff(np.log(spectrum / sun), 2) ** 2)

    def best(low, high, step):
        widths = np.arange(max(low, _NARROWEST), min(high, _WIDEST) + 0.01, step)
        return float(widths[np.argmin([roughness(width) for width in widths])])

    near = best(_NARROWEST, _WIDEST, _STEPS[0])
    return best(near - _STEPS[0], near + _STEPS[0], _STEPS[1])
