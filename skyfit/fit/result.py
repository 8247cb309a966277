"""What a fit of a sky ends with."""

from dataclasses import dataclass, field

import numpy as np

from ..scene import Sky
from ..transport import AbstractSolver
from .parameters import PARAMETERS, SkyModel, with_values


@dataclass(frozen=True, eq=False)
class Fitted:
    """The fitted skies alone, all that a prediction needs: one model per time, solver and line shape.

    `time` `[time]`, UTC, NaT where unknown; `models`, one a time; `fwhm_nm` NaN for no line shape.
    """

    time: np.ndarray
    models: tuple[SkyModel, ...]
    solver: AbstractSolver
    fwhm_nm: float


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters of a sky with their uncertainty, and the sky that they give; host-side arrays.

    `values`, `sigma`, `at_bound`, `determined` are `[time, parameter]` in the order of `free`, units as in
    `PARAMETERS`; `covariance` `[time, parameter, parameter]`. `model` is the fitted radiance on the input's
    times, directions and wavelengths; `rmse` `[time]` is over usable samples, W m^-2 sr^-1 nm^-1.
    `reduced_chi_square` `[time]` has scaled the covariance where it exceeds 1. `result` says how each solve
    ended. `undetermined` `[time]` names in words what the data leave open.
    """

    sky: Sky
    solver: AbstractSolver
    free: tuple[str, ...]
    values: np.ndarray
    sigma: np.ndarray
    covariance: np.ndarray
    at_bound: np.ndarray
    determined: np.ndarray
    model: np.ndarray
    used: np.ndarray
    rmse: np.ndarray
    reduced_chi_square: np.ndarray
    steps: np.ndarray
    result: tuple[str, ...]
    undetermined: tuple[tuple[str, ...], ...]
    start: SkyModel
    fwhm_nm: float
    notes: tuple[str, ...] = ()
    fixed: dict[str, float] = field(default_factory=dict)

    @property
    def residual(self) -> np.ndarray:
        """Model minus measurement, W m^-2 sr^-1 nm^-1, `[time, direction, wavelength]`."""
        return self.model - self.sky.radiance

    @property
    def fitted(self) -> Fitted:
        """The fitted skies, for `predict`."""
        models = tuple(with_values(self.start, self.free, row) for row in self.values)
        return Fitted(self.sky.time, models, self.solver, self.fwhm_nm)

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
        for t, name in enumerate(time_names(self.sky)):
            lines.append(
                f"{name}  sun zenith {np.degrees(self.sky.sun_zenith[t]):.1f} deg  {self.result[t]} in "
                f"{self.steps[t]} steps  rmse {1e3 * self.rmse[t]:.2f} mW m-2 sr-1 nm-1  "
                f"reduced chi-square {self.reduced_chi_square[t]:.2f}"
            )
            for p, parameter in enumerate(self.free):
                flags = "  at bound" if self.at_bound[t, p] else ""
                flags += "" if self.determined[t, p] else "  not determined"
                lines.append(
                    f"  {parameter:32s}{self.values[t, p]:12.5g} +- {self.sigma[t, p]:<10.3g}"
                    f"{PARAMETERS[parameter].unit}{flags}"
                )
            lines.extend(f"  {sentence}" for sentence in self.undetermined[t])
        lines.extend(f"note: {note}" for note in self.notes)
        return "\n".join(lines)


def time_names(sky: Sky) -> tuple[str, ...]:
    """Each time of a sky as text, ISO in UTC, or its index where the file gives none."""
    return tuple(f"time {i}" if np.isnat(t) else str(t.astype("datetime64[s]")) + "Z" for i, t in enumerate(sky.time))
