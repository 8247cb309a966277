"""What is known about a measurement besides its numbers: noise, calibration, field of view, outliers."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..numerics import check_range
from .samples import Sky


Loss = Literal["squares", "huber", "cauchy"]

# noise where a file gives none, as shares of each sample and of the time's median radiance: about the lower end of the
# residuals of fits (experiments/studies/measured_sky.py)
_RELATIVE, _FLOOR = 0.02, 0.05
# assumed sizes of the shared errors before the residuals are seen, in the order of `shared_errors`, and the number of
# directions, or bumps of a broad error, that they count for: small, so that skies without any keep their error bars
_TAKEN, _STRENGTH = (5e-4, 3e-4, 2e-4, 5e-4, 3e-4), 1.0
# sigma of the calibration's prior where the noise is not known either
_CALIBRATION = 0.01


@dataclass(frozen=True)
class NoiseModel:
    """What is known about the measurement of a sky.

    - `relative`, `floor`: standard deviation of a sample's noise, as a share of the sample and of the time's median
      radiance, added in quadrature. None: the file's sigma, or 0.02 and 0.05 where it has none.
    - `calibration`: standard deviation of the scale of each wavelength, which all times share and the fit finds with
      this prior; 0: exact. None: the file's, or 0 if the noise is given, by the file or here, else 0.01.
    - `model_error`: relative size of each of the model's smooth errors that `sigma` includes (`error_shapes`).
      Comparison with other solvers gives 0.006 for leaving polarisation out and 0.003 for a haze at another height; for
      skies that a solver of the same kind made, of known haze height, 0.001 (flat: 0.0005; drafts 0.004 and 0.002).
      None: that of the solver.
    - `level`, `colour`, `pointing`: standard deviations of errors that all wavelengths of a direction share. Level and
      colour are relative; colour is a slope and a bend in the logarithm of wavelength, of this size at the ends.
      Pointing is in radians, on each of two axes. These errors widen sigma but weight no sample. None: as large as the
      residuals show; 0: there are none.
      If each wavelength has its own views, each sample has its own pointing error
    - `broad_level`, `broad_colour`: standard deviations of relative errors, of level and of a slope in the logarithm of
      wavelength, that views within some 0.6 rad share: stray light, an aerosol or a ground unlike the model's
    - `time_level`: relative error that all samples of a time share, which no residual shows
    - `field_of_view`: full cone angle of the instrument's view, radians; 0: a ray.
    - `loss`: loss of a residual beyond `threshold` standard deviations: "squares", "huber" (linear) or "cauchy"
      (logarithmic), against clouds, masts and flare.

    **Example:**

        >>> sky = skyfit.read("data/skies/sample.nc")
        >>> noise = skyfit.NoiseModel(relative=0.01, floor=0.0)
        >>> sigma = noise.sigma(sky, sky.usable)
        >>> bool(np.allclose(sigma[sky.usable], 0.01 * sky.radiance[sky.usable]))
        True
    """

    relative: float | None = None
    floor: float | None = None
    calibration: float | None = None
    model_error: float | None = None
    field_of_view: float = 0.0
    loss: Loss = "huber"
    threshold: float = 3.0
    level: float | None = None
    colour: float | None = None
    pointing: float | None = None
    time_level: float = 0.0
    broad_level: float | None = None
    broad_colour: float | None = None

    def __post_init__(self):
        for name, low, high in (
            ("relative", 0.0, 1.0), ("floor", 0.0, 1.0), ("calibration", 0.0, 1.0), ("model_error", 0.0, 1.0),
            ("field_of_view", 0.0, 0.5), ("threshold", 0.5, 1e3), ("level", 0.0, 1.0), ("colour", 0.0, 1.0),
            ("pointing", 0.0, 0.2), ("broad_level", 0.0, 1.0), ("broad_colour", 0.0, 1.0), ("time_level", 0.0, 1.0),
        ):  # fmt: skip
            check_range(name, getattr(self, name), low, high)
        if self.loss not in ("squares", "huber", "cauchy"):
            raise ValueError(f'`loss` must be "squares", "huber" or "cauchy", got {self.loss!r}')
        if (self.relative is not None or self.floor is not None) and not (self.relative or self.floor):
            raise ValueError("`relative` and `floor` must not both be 0: no sample is exact")

    def stated(self, sky: Sky) -> bool:
        """Whether the noise is given, by this model or by the sky's file."""
        return self.relative is not None or self.floor is not None or sky.sigma is not None

    def sigma(self, sky: Sky, used: np.ndarray) -> np.ndarray:
        """Standard deviation of every sample, `[time, direction, wavelength]`, 1 where it is not used."""
        given = self.relative is not None or self.floor is not None
        if sky.sigma is not None and not given:
            return np.where(used, sky.sigma, 1.0)
        relative = self.relative if self.relative is not None else 0.0 if given else _RELATIVE
        floor = self.floor if self.floor is not None else 0.0 if given else _FLOOR
        result = np.ones(sky.radiance.shape)
        for t in range(len(sky.time)):
            if used[t].any():
                level = floor * np.median(sky.radiance[t][used[t]])
                result[t] = np.where(used[t], np.hypot(relative * sky.radiance[t], level), 1.0)
        # a sample of 0 with relative noise only would count infinitely
        least = 1e-6 * np.max(np.where(used, sky.radiance, 0.0), initial=0.0)
        return np.maximum(result, least if least > 0.0 else 1.0)

    def shared_errors(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The assumed sizes of the shared errors, and how much each counts; inf: given."""
        given = self.level, self.colour, self.pointing, self.broad_level, self.broad_colour
        sizes = tuple(t if g is None else g for g, t in zip(given, _TAKEN, strict=True))
        return sizes, tuple(_STRENGTH if g is None else float("inf") for g in given)

    def calibration_prior(self, sky: Sky) -> float:
        """The standard deviation of each wavelength's scale."""
        if self.calibration is not None:
            return self.calibration
        if np.isfinite(sky.calibration_sigma):
            return sky.calibration_sigma
        return 0.0 if self.stated(sky) else _CALIBRATION
