"""From a measured sky to the parameters of its atmosphere."""

from collections.abc import Callable, Mapping, Sequence

import equinox as eqx
import numpy as np

from ..measured import NoiseModel, Response, Sky
from ..numerics.chain import Point
from ..transport import AbstractSolver
from .model import SkyModel
from .parameters import DEFAULT_FREE
from .prepared import check, first_points, fittable, Prepared, prepared
from .report import fit_of
from .result import Fit
from .retrieve import retrieve
from .uncertainty import Estimate


def invert(
    sky: Sky,
    free: Sequence[str] = DEFAULT_FREE,
    solver: AbstractSolver | None = None,
    start: SkyModel | None = None,
    fwhm_nm: float | None = None,
    max_steps: int = 100,
    progress: Callable[[int, int], None] | None = None,
    *,
    shared: Sequence[str] = (),
    measurement: NoiseModel | None = None,
    response: Response | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    smooth: Mapping[str, float] | None = None,
    draft: AbstractSolver | None = None,
    guess: bool = True,
    starts: int = 1,
) -> Fit:
    """The parameters of the atmosphere over a measured sky, with uncertainties.

    **Arguments**

    - `sky` (`skyfit.read`); `free`, names among `PARAMETERS`; `solver`, default `OrdersOfScattering.normal()`,
      spherical, polarised for spectral radiance, scalar for the channels of a `response`. The precision is that of the
      process, float32 unless `jax_enable_x64` is set; `skyfit invert` has the same defaults and computes in float64
    - `start`: the values that are not fitted, and those of the free ones where the search begins; with `guess` the
      haze's begin where single scattering explains the sky best; `starts` - 1 random ones besides
    - `fwhm_nm`: line shape (default: the file's, or estimated from the solar lines); `response`:
      channels of a camera or photometer, if the sky has none (`Sky.with_response`)
    - `shared`: free names that all times have in common (`SLOW` names those that do not change within a day); none:
      each time is fitted by itself
    - `measurement`: noise, calibration, field of view, outliers (`NoiseModel`)
    - `priors`: name -> (value, sigma) in the parameter's unit; of a positive parameter sigma / value is that of its
      logarithm. `smooth`: name -> sigma of its change within an hour, on the same scale, for names that are not shared
    - `draft`: solver of the slopes (default: `solver` itself, which compiles once; a coarser one runs faster)
    - `max_steps` of each Levenberg-Marquardt search; `progress(done, of)` is called after each time that is fitted by
      itself

    **Returns:** a `Fit`. Sigma is that of noise (widened where the residuals exceed it), priors included, and of the
    model's stated error.
    **Valid:** times with the sun above the horizon and more samples than parameters; the others are left out of the
    `Fit`, whose notes name them, and an error if they are all. Samples in bands of oxygen and
    water vapour are left out and counted.
    **Errors:** `ValueError` for unknown or contradicting names, or a sky with too few usable samples.
    """
    settings = fwhm_nm, max_steps, shared, measurement, response, priors, smooth, draft
    asked = prepared(sky, free, solver, start, *settings)
    rest = fittable(asked)
    if rest is not None:
        asked = prepared(rest, free, solver, start, *settings)
    check(asked)
    times = len(asked.sky.time)
    groups = [np.arange(times)] if asked.shared or asked.linked else [np.array([t]) for t in range(times)]
    parts = []
    for number, group in enumerate(groups):
        parts.append(solve(asked, group, first_points(asked, group, guess, starts)))
        if progress is not None:
            progress(number + 1, len(groups))
    return fit_of(asked, groups, parts)


def solve(asked: Prepared, times: np.ndarray, starts: Point) -> Estimate:
    """The estimate of some times together; another sky of the same shape, or other numbers, compile nothing."""
    rows = asked.rows if len(times) == len(asked.sky.time) else asked.rows._replace(step=asked.rows.step[:0])
    return _retrieve(asked.problem.at(times), asked.start, asked.names, priors=rows, start=starts, **asked.options())


_retrieve = eqx.filter_jit(retrieve)
