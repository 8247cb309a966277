"""What is known of a measurement besides its numbers: noise, calibration, spectral response, outliers."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..light.colour import observer_weights, SRGB_FROM_XYZ
from ..scene import Sky
from ..transport import AbstractSolver, OrdersOfScattering


Loss = Literal["squares", "huber", "cauchy"]

# where a file gives none, of each sample and of the time's median radiance: so are the residuals of settled measured
# scans (experiments/measured_sky.py)
_RELATIVE, _FLOOR = 0.02, 0.05
# of polarised solvers and of others
_MODEL_ERROR = {True: 0.003, False: 0.007}
# the calibration's prior where the noise is not known either
_CALIBRATION = 0.01


@dataclass(frozen=True)
class Measurement:
    """What is known of how a sky was measured.

    - `relative`, `floor`: standard deviation of a sample's noise, as a share of the sample and of the time's median
      radiance, added in quadrature. None: the file's sigma, or 0.02 and 0.05 where it has none.
    - `calibration`: standard deviation of the scale of each wavelength, which all times share and the fit finds with
      this prior; 0: exact. None: 0 if the noise is given, by the file or here, else 0.01.
    - `model_error`: relative size of each of the smooth errors of the model that `sigma` allows for (`error_shapes`):
      by comparison with other solvers 0.006 for leaving polarisation out and 0.003 for a haze at another height; for
      skies that a solver of the same kind made, of known haze height, 0.001 (flat: 0.0005; drafts 0.004 and 0.002).
      None: 0.003 with a polarised solver, else 0.007.
    - `field_of_view`: full cone angle of what the instrument sees, radians; 0: a ray.
    - `loss`: of a residual beyond `threshold` standard deviations: "squares", "huber" (linear) or "cauchy"
      (logarithmic), against clouds, masts and flare.
    """

    relative: float | None = None
    floor: float | None = None
    calibration: float | None = None
    model_error: float | None = None
    field_of_view: float = 0.0
    loss: Loss = "huber"
    threshold: float = 3.0

    def __post_init__(self):
        for name, low, high in (
            ("relative", 0.0, 1.0), ("floor", 0.0, 1.0), ("calibration", 0.0, 1.0), ("model_error", 0.0, 1.0),
            ("field_of_view", 0.0, 0.5), ("threshold", 0.5, 1e3),
        ):  # fmt: skip
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise ValueError(f"`{name}` must be between {low:g} and {high:g}, got {value!r}")
        if self.loss not in ("squares", "huber", "cauchy"):
            raise ValueError(f'`loss` must be "squares", "huber" or "cauchy", got {self.loss!r}')
        if (self.relative is not None or self.floor is not None) and not (self.relative or self.floor):
            raise ValueError("`relative` and `floor` must not both be 0: no sample is exact")

    def stated(self, sky: Sky) -> bool:
        """Whether the noise is given, by the measurement's owner or the sky's file."""
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

    def calibration_prior(self, sky: Sky) -> float:
        """The standard deviation of each wavelength's scale."""
        if self.calibration is not None:
            return self.calibration
        return 0.0 if self.stated(sky) else _CALIBRATION

    def allowed_error(self, solver: AbstractSolver) -> float:
        """The relative size of the model's errors with a solver."""
        if self.model_error is not None:
            return self.model_error
        return _MODEL_ERROR[isinstance(solver, OrdersOfScattering) and solver.polarised]


class Robust(NamedTuple):
    """A whitened residual after the loss: `value`, whose square is the loss, its slope, and the sample's weight."""

    value: Array
    slope: Array
    weight: Array


def robust(residual: Array, loss: Loss, threshold: float) -> Robust:
    r"""Residuals that grow less than linearly beyond a threshold $k$.

    Huber: $f^2 = 2 k |z| - k^2$ beyond k; Cauchy: $f^2 = k^2 \ln(1 + z^2 / k^2)$. With $w = f f' / z$ the weight of
    iteratively reweighted least squares, the gradient of $\frac12 f^2$ is that of the reweighted residuals.

    **Arguments:** `residual`, divided by sigma; `threshold` k in standard deviations.
    **Source:** Huber 1964, Ann. Math. Stat. 35, 73; Holland & Welsch 1977, Commun. Stat. A6, 813.
    """
    one = jnp.ones_like(residual)
    if loss == "squares":
        return Robust(residual, one, one)
    size = jnp.abs(residual)
    if loss == "huber":
        far = size > threshold
        beyond = jnp.where(far, size, threshold)
        root = jnp.sqrt(2.0 * threshold * beyond - threshold**2)
        value = jnp.where(far, jnp.sign(residual) * root, residual)
        return Robust(value, jnp.where(far, threshold / root, 1.0), jnp.where(far, threshold / beyond, 1.0))
    square = (residual / threshold) ** 2
    # ln(1 + s) / s is 1 at 0
    safe = jnp.where(square > 1e-6, square, 1.0)
    share = jnp.where(square > 1e-6, jnp.sqrt(jnp.log1p(safe) / safe), 1.0 - 0.25 * square)
    weight = 1.0 / (1.0 + square)
    return Robust(residual * share, weight / share, weight)


def error_shapes(airmass: Array, cosine: Array, wavelength_nm: Array) -> Float[Array, "shape direction wavelength"]:
    """Smooth relative errors that a radiative transfer model makes, each of size 1 or less.

    Constant, a slope in the logarithm of wavelength, more toward the horizon, and four Legendre polynomials of the
    angle from the sun. **Arguments:** `airmass` and `cosine` of the angle from the sun, `[direction]`.
    """
    colour = jnp.log(wavelength_nm) - jnp.mean(jnp.log(wavelength_nm))
    colour = colour / jnp.maximum(jnp.max(jnp.abs(colour)), 0.1)
    flat = jnp.ones_like(wavelength_nm)
    by_angle = [
        jnp.ones_like(cosine), 1.0 - 2.0 / airmass, cosine, 1.5 * cosine**2 - 0.5, 2.5 * cosine**3 - 1.5 * cosine,
        4.375 * cosine**4 - 3.75 * cosine**2 + 0.375,
    ]  # fmt: skip
    shapes = [a[:, None] * flat[None] for a in by_angle] + [by_angle[0][:, None] * colour[None]]
    return jnp.stack(shapes)


@dataclass(frozen=True, eq=False)
class Response:
    """Channels of a camera or photometer: what each makes of a spectrum.

    `wavelength_nm` `[wavelength]`, increasing and fine enough for a sum over them; `weight` `[channel, wavelength]`:
    a channel's value is the sum of weight times spectral radiance (so that a width of band is in the weight).
    Channels stand in the order of the sky's `wavelength_nm`, which gives each a place and a label.
    """

    wavelength_nm: np.ndarray
    weight: np.ndarray

    def __post_init__(self):
        wavelength = np.atleast_1d(np.asarray(self.wavelength_nm, float))
        weight = np.atleast_2d(np.asarray(self.weight, float))
        if weight.shape[1:] != wavelength.shape or not np.all(np.diff(wavelength) > 0.0):
            raise ValueError(
                "`weight` must be [channel, wavelength] and `wavelength_nm` increase, got shapes "
                f"{weight.shape} and {wavelength.shape}"
            )
        if not (np.all(np.isfinite(weight)) and np.all((wavelength >= 300.0) & (wavelength <= 1100.0))):
            raise ValueError("`weight` must be finite and `wavelength_nm` within 300-1100 nm")
        object.__setattr__(self, "wavelength_nm", wavelength)
        object.__setattr__(self, "weight", weight)

    @property
    def centre_nm(self) -> np.ndarray:
        """The mean wavelength of each channel, nm: what to give a sky as its `wavelength_nm`, in this order."""
        size = np.abs(self.weight)
        return size @ self.wavelength_nm / np.sum(size, axis=1)

    @classmethod
    def xyz(cls) -> "Response":
        """CIE 1931 Z, Y, X in cd m^-2, by increasing wavelength; x, y, Y give X = x Y / y, Z = (1 - x - y) Y / y."""
        wavelength = np.arange(380.0, 781.0, 10.0)
        return cls(wavelength, np.asarray(observer_weights(wavelength), float).T[::-1])

    @classmethod
    def linear_srgb(cls) -> "Response":
        """Linear sRGB of a calibrated camera in cd m^-2, blue, green, red by increasing wavelength."""
        wavelength = np.arange(380.0, 781.0, 10.0)
        weights = np.asarray(observer_weights(wavelength), float)
        return cls(wavelength, (np.asarray(SRGB_FROM_XYZ, float) @ weights.T)[::-1])
