"""The result of a fit of a sky."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ..atmosphere import BIN_RADII
from ..measured import NoiseModel, Response, Sky, time_names
from ..transport import AbstractSolver
from .model import SkyModel
from .parameters import fixed_values, PARAMETERS, SIZE_BINS, with_values


@dataclass(frozen=True, eq=False)
class Fitted:
    """The fitted skies alone, all that a prediction needs: one model per time, solver and line shape.

    `time` `[time]`, UTC, NaT where unknown; `models`, one a time; `fwhm_nm` NaN for no line shape; `calibration`
    `[time, wavelength]`, the instrument's scale at `fitted_nm`; `response`, whose channels were measured, or None.
    """

    time: np.ndarray
    models: tuple[SkyModel, ...]
    solver: AbstractSolver
    fwhm_nm: float
    fitted_nm: np.ndarray
    calibration: np.ndarray
    response: Response | None = None


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters of a sky with their uncertainty, and the sky that they give; host-side arrays.

    - `values`, `sigma`, `at_bound`, `determined` are `[time, parameter]` in the order of `free`, units as in
      `PARAMETERS`; `covariance` `[time, parameter, parameter]`. Those of `shared` parameters are the same at all times
    - `sigma` includes noise of all kinds, priors, and `model_sigma`, the part of the model's stated error;
      `reduced_chi_square` `[time]` is that of all samples with the stated noise
    - `scale` `[time]`: the samples' own noise over the stated noise. `common` `[time, kind]`: sizes of the errors that
      all wavelengths of a direction share (relative level, relative colour, pointing in radians) and that a broad part
      of the sky shares (relative level, relative colour). `error_share` `[time, kind]`: share of the samples' own
      error, then of each of these, in the sum of squares. `widening` `[time]`: factor by which sigma is larger because
      samples are trusted less
    - `residual_correlation` `[time, 2]`: correlation of the residuals, freed of these errors, with the next wavelength
      and the nearest direction
    - `beam_residual` `[time, fitted wavelength]`: model minus measured direct beam (or optical depth) over its sigma,
      NaN where none was measured
    - `model` is what the instrument would read of the fitted sky on the input's times, directions and wavelengths;
      `rmse` `[time]` is over usable samples, W m^-2 sr^-1 nm^-1
    - `weight` `[time, direction, fitted wavelength]`: 1, less for samples that the loss trusts less, NaN where not used
    - `gain` `[time, parameter, direction, fitted wavelength]`: derivative of a parameter by a sample of its time
    - `calibration`, `calibration_sigma` `[time, fitted wavelength]`: the instrument's scale, 1 where it is not fitted
    - `jackknife_sigma` `[time, parameter]`: the error by noise, found by leaving out groups of directions in turn. It
      assumes nothing about the noise; NaN where it was not requested
    - `degrees_of_freedom` `[time]`: how many parameters the data, not the priors, determine
    - `result` says how each solve ended; `undetermined` `[time]` states in words what the data do not determine
    """

    sky: Sky
    solver: AbstractSolver
    free: tuple[str, ...]
    values: np.ndarray
    sigma: np.ndarray
    covariance: np.ndarray
    model_sigma: np.ndarray
    jackknife_sigma: np.ndarray
    at_bound: np.ndarray
    determined: np.ndarray
    model: np.ndarray
    used: np.ndarray
    rmse: np.ndarray
    reduced_chi_square: np.ndarray
    scale: np.ndarray
    common: np.ndarray
    error_share: np.ndarray
    widening: np.ndarray
    residual_correlation: np.ndarray
    beam_residual: np.ndarray
    degrees_of_freedom: np.ndarray
    weight: np.ndarray
    gain: np.ndarray
    calibration: np.ndarray
    calibration_sigma: np.ndarray
    fitted_nm: np.ndarray
    steps: np.ndarray
    cost: np.ndarray
    result: tuple[str, ...]
    undetermined: tuple[tuple[str, ...], ...]
    start: SkyModel
    fwhm_nm: float
    measurement: NoiseModel
    shared: tuple[str, ...] = ()
    priors: dict[str, tuple[float, float]] = field(default_factory=dict)
    smooth: dict[str, float] = field(default_factory=dict)
    response: Response | None = None
    notes: tuple[str, ...] = ()

    @property
    def model_error(self) -> float:
        """The relative size of the model's stated errors that `sigma` allows for."""
        given = self.measurement.model_error
        return self.solver.model_error if given is None else given

    @property
    def fixed(self) -> dict[str, float]:
        """The values that were not fitted, by name, in their stated units."""
        return fixed_values(self.start, self.free)

    @property
    def residual(self) -> np.ndarray:
        """Model minus measurement, W m^-2 sr^-1 nm^-1, `[time, direction, wavelength]`."""
        return self.model - self.sky.radiance

    @property
    def fitted(self) -> Fitted:
        """The fitted skies, for `predict`."""
        models = tuple(with_values(self.start, self.free, row) for row in self.values)
        return Fitted(self.sky.time, models, self.solver, self.fwhm_nm, self.fitted_nm, self.calibration, self.response)

    def effective_asymmetry(self, t: int) -> "Together | None":
        """The mean cosine of two lobes at 550 nm and time `t`, if the data determine it but not each of the lobes."""
        return effective_asymmetry(self.free, self.values[t], self.covariance[t], self.determined[t])

    @property
    def rejected(self) -> np.ndarray:
        """Directions whose mean weight over wavelengths is below one half, `[time, direction]`."""
        return rejected(self.weight)

    @property
    def correlation(self) -> np.ndarray:
        """The correlation matrix of each time, `[time, parameter, parameter]`."""
        scale = np.sqrt(np.einsum("tpp->tp", self.covariance))
        safe = np.where((scale > 0.0) & np.isfinite(scale), scale, np.nan)
        return self.covariance / (safe[:, :, None] * safe[:, None, :])

    @property
    def total_rmse(self) -> float:
        """The root mean square over the usable samples of all times, W m^-2 sr^-1 nm^-1."""
        error = self.residual[self.used]
        return float(np.sqrt(np.mean(error**2))) if error.size else float("nan")

    def __str__(self) -> str:
        lines = []
        factor, unit = (1e3, "mW m-2 sr-1 nm-1") if self.response is None else (1.0, "in the unit of the channels")
        for t, name in enumerate(time_names(self.sky)):
            lines.append(
                f"{name}  sun zenith {np.degrees(self.sky.sun_at(t)[0]):.1f} deg  {self.result[t]} in "
                f"{self.steps[t]} steps  rmse {factor * self.rmse[t]:.2f} {unit}  "
                f"reduced chi-square {self.reduced_chi_square[t]:.2f}"
            )
            lobes = self.effective_asymmetry(t)
            for p, parameter in enumerate(self.free):
                if lobes is not None and parameter in lobes.names:
                    continue
                flags = "  at bound" if self.at_bound[t, p] else ""
                flags += "" if self.determined[t, p] else "  not determined"
                lines.append(
                    f"  {parameter:32s}{self.values[t, p]:12.5g} +- {self.sigma[t, p]:<10.3g}"
                    f"{PARAMETERS[parameter].unit}{flags}"
                )
            lines.extend(f"  {sentence}" for sentence in self.undetermined[t])
        lines.extend(f"note: {note}" for note in self.notes)
        return "\n".join(lines)


# largest share of directions that count as outliers: if more are rejected, the model does not explain the sky
FEW = 0.2


def rejected(weight: np.ndarray) -> np.ndarray:
    """Directions whose mean weight over wavelengths is below one half, `[..., direction]`; NaN: not used."""
    held = np.isfinite(weight)
    mean = np.sum(np.where(held, weight, 0.0), axis=-1) / np.maximum(held.sum(axis=-1), 1)
    return held.any(axis=-1) & (mean < 0.5)


def outliers(weight: np.ndarray) -> np.ndarray:
    """The rejected directions of each time, `[..., direction]`, if they are a fifth of its directions or less."""
    out, held = rejected(weight), np.isfinite(weight).any(axis=-1)
    return out & (out.sum(axis=-1) <= FEW * held.sum(axis=-1))[..., None]


class Together(NamedTuple):
    """A combination that is determined although its parameters are not: value, sigma, and the parameters' names."""

    value: float
    sigma: float
    names: tuple[str, ...]


# parameters of the mean cosine of two lobes, which is that of each lobe, weighted with the lobe's share
LOBES = ("asymmetry", "asymmetry_second", "forward_fraction")


def effective_asymmetry(free: tuple[str, ...], values, covariance, determined) -> Together | None:
    r"""The mean cosine $g = f g_1 + (1 - f) g_2$ of two free lobes; None if each is determined, or if g is not.

    **Arguments:** those of one time, in the order of `free`. **Returns:** g with its sigma, and the lobes' parameters.
    """
    if not set(LOBES) <= set(free):
        return None
    places = [free.index(name) for name in LOBES]
    names = tuple(name for name in (*LOBES, "forward_fraction_slope") if name in free)
    first, second, share = values[places]
    gradient = np.array([share, 1.0 - share, first - second])
    variance = gradient @ covariance[np.ix_(places, places)] @ gradient
    sigma = float(np.sqrt(variance)) if variance >= 0.0 else np.inf
    known = is_determined(("asymmetry",), np.array([first]), np.array([sigma]))[0]
    if all(determined[free.index(name)] for name in names) or not known:
        return None
    return Together(float(share * first + (1.0 - share) * second), sigma, names)


# a parameter counts as determined if its sigma is below this share of its allowed range, or e-fold
_DETERMINED_SHARE = 0.25
# share of a prior's sigma above which a parameter's sigma counts as that of the prior
_FROM_PRIOR = 0.7
# size of a component of a unit vector above which its parameter is part of a combination
_PART = 0.35


def is_determined(free: tuple[str, ...], values: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Whether the data determine each parameter: its sigma is well below its allowed range, or e-fold."""
    limit = np.array([_DETERMINED_SHARE * PARAMETERS[n].spread(v) for n, v in zip(free, values, strict=True)])
    return np.isfinite(sigma) & (sigma < limit)


def in_words(free: tuple[str, ...], found: dict, triangle: np.ndarray, priors: dict) -> tuple[str, ...]:
    """Sentences on what the data do not determine.

    **Arguments:** `found`, with sigma, at_bound and determined, `[parameter]`; `triangle`, rows whose normal matrix is
    the inverse covariance of the parameters in units of their `spread`: its small singular values are the weak
    directions.
    """
    sigma, at_bound, determined = found["sigma"], found["at_bound"], found["determined"]
    lobes = effective_asymmetry(free, found["values"], found["covariance"], determined)
    together = () if lobes is None else lobes.names
    sentences = [
        f"{name} is not determined by these data"
        for name, yes in zip(free, determined, strict=True)
        if not yes and name not in together and name not in SIZE_BINS
    ]
    loose = [PARAMETERS[name].index for name in SIZE_BINS if name in free and not determined[free.index(name)]]
    if loose:
        radii = ", ".join(f"{BIN_RADII[index]:.2g}" for index in loose)
        sentences.append(f"these data know the size bins of {radii} um no better than by a quarter")
    if lobes is not None:
        sentences.append(
            f"only a combination is determined of {', '.join(together)}: "
            f"effective asymmetry {lobes.value:.4g} +- {lobes.sigma:.2g}"
        )
    sentences += [
        f"{name} stands at its bound: the data would take it further, its sigma is only local"
        for name, yes in zip(free, at_bound, strict=True)
        if yes
    ]
    for i, name in enumerate(free):
        if name in priors and determined[i] and sigma[i] > _FROM_PRIOR * priors[name][1]:
            sentences.append(f"{name} is known from its prior more than from these data")
    if np.all(np.isfinite(triangle)):
        _, singular, rows = np.linalg.svd(triangle)
        for value, row in zip(singular, rows, strict=False):
            mixed = [free[i] for i in np.flatnonzero(np.abs(row) > _PART)]
            if value < 1.0 / _DETERMINED_SHARE and len(mixed) > 1 and not set(mixed) <= {*together, *SIZE_BINS}:
                sentences.append(f"only a combination is determined of {', '.join(mixed)}")
    return tuple(sentences)
