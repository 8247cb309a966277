"""Fit the parameters of the atmosphere to a measured sky."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from threading import Thread

import equinox as eqx
import jax
import numpy as np

from .. import programs
from ..measured import NoiseModel, Response, Sky
from ..numerics import as_float
from ..numerics.chain import Point
from ..transport import AbstractSolver
from .model import SkyModel
from .parameters import PARAMETERS
from .prepared import check, first_points, fittable, Prepared, prepared
from .report import fit_of
from .result import Fit
from .retrieve import retrieve, shape_of
from .uncertainty import Estimate


# largest number of groups of directions that a jackknife leaves out in turn
_MOST_GROUPS = 100
# kinds of sky and solver that this process has read
_READ: set[str] = set()


def invert(
    sky: Sky,
    free: Sequence[str] | None = None,
    solver: AbstractSolver | None = None,
    start: SkyModel | None = None,
    fwhm_nm: float | None = None,
    max_steps: int = 100,
    progress: Callable[[int, int], None] | None = None,
    *,
    shared: Sequence[str] = (),
    measurement: NoiseModel | None = None,
    response: Response | None = None,
    priors: Mapping[str, tuple[float, float] | None] | None = None,
    smooth: Mapping[str, float] | None = None,
    draft: AbstractSolver | None = None,
    guess: bool = True,
    starts: int = 1,
    jackknife: int = 0,
) -> Fit:
    """Fit the parameters of the atmosphere to a measured sky, with uncertainties.

    **Arguments**

    - `sky` (`skyfit.read`); `free`, names among `PARAMETERS` (default: `skyfit.retrieve.usual_free`, spheres in two
      modes for spectra); `solver`, default `OrdersOfScattering.normal()`, spherical, polarised for spectral radiance,
      scalar for the channels of a `response`. The precision is that of the process, float32 unless `jax_enable_x64` is
      set; `skyfit invert` has the same defaults and computes in float64
    - `start`: the values of the parameters that are not fitted, and the first values of the free ones. With `guess` the
      haze starts where single scattering explains the sky best. `starts` - 1 random starts are added
    - `fwhm_nm`: line shape (default: the file's, or estimated from the solar lines); `response`:
      channels of a camera or photometer, if the sky has none (`Sky.with_response`)
    - `shared`: free names that all times have in common (`SLOW` names those that do not change within a day). If there
      are none, each time is fitted by itself, unless `smooth` links the times
    - `measurement`: noise, calibration, field of view, outliers (`NoiseModel`)
    - `priors`: name -> (value, sigma) in the parameter's unit; for a parameter fitted as its logarithm, sigma / value
      is the sigma of the logarithm; None leaves out the `climatology` of a parameter. `smooth`: name -> sigma
      of its change within an hour, on the same scale, for names that are not shared
    - `draft`: solver of the slopes in all searches but the last (default: `solver.coarser()`; with degrees of
      polarisation `solver` itself). The last search and sigma have the slopes of `solver`
    - `jackknife`: number of groups of directions, in the order of the sky, that are left out in turn to find
      `Fit.jackknife_sigma`; 0: none
    - `max_steps` of each Levenberg-Marquardt search; `progress(done, of)` is called after each fit, of one time or of
      all times together

    **Returns:** a `Fit`. Sigma includes noise (widened where the residuals exceed it), priors and the model's stated
    error.
    **Valid:** times with a sun that the solver knows (`Spherical` knows it below the horizon too) and at least as many
    samples as parameters. Other times are left out of the `Fit`, and its notes name them; if no time is left, that is
    an error. Samples in bands of oxygen and water vapour are left out and counted.
    **Errors:** `ValueError` for unknown or contradicting names, or a sky with too few usable samples.
    """
    settings = fwhm_nm, max_steps, shared, measurement, response, priors, smooth, draft
    asked = prepared(sky, free, solver, start, *settings)
    rest = fittable(asked)
    if rest is not None:
        asked = prepared(rest, free, solver, start, *settings)
    check(asked)
    if jackknife != 0 and not 2 <= jackknife <= _MOST_GROUPS:
        raise ValueError(f"`jackknife` must be 0 or 2 to {_MOST_GROUPS} groups, got {jackknife}")
    times = len(asked.sky.time)
    groups = [np.arange(times)] if asked.shared or asked.linked else [np.array([t]) for t in range(times)]
    parts, spreads = [], []
    with _reading_ahead(asked):
        for number, group in enumerate(groups):
            parts.append(solve(asked, group, first_points(asked, group, guess, starts)))
            if jackknife:
                spreads.append(_jackknifed(asked, group, parts[-1], jackknife))
            if progress is not None:
                progress(number + 1, len(groups))
    return fit_of(asked, groups, parts, spreads)


@contextmanager
def _reading_ahead(asked: Prepared) -> Iterator[None]:
    """Compile the program of the fitted sky's reading while the search does, by a reading of the start model.

    A sky of a kind that this process has read before needs none. An error of this reading is that of the fitted one.
    """
    settings = jax.config.jax_enable_x64, jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]
    kind = repr((asked.solver, asked.sky.radiance.shape, asked.sampling.field_of_view, *settings))
    if kind in _READ:
        yield
        return

    def read():
        with suppress(Exception), jax.enable_x64(settings[0]), jax.default_device(settings[1]):
            asked.sampling.readings(asked.solver, asked.start, 0)

    ahead = Thread(target=read)
    # a process that is ending starts no thread
    with suppress(RuntimeError):
        ahead.start()
    yield
    if ahead.ident is not None:
        ahead.join()
    _READ.add(kind)


def solve(asked: Prepared, times: np.ndarray, starts: Point, kept: np.ndarray | None = None) -> Estimate:
    """Estimate some times together; another sky of the same shape, or other numbers, need no new compilation.

    **Arguments:** `kept` `[time, direction]`: the directions of these times' problem that count, default all.
    """
    rows = asked.rows if len(times) == len(asked.sky.time) else asked.rows._replace(step=asked.rows.step[:0])
    problem = asked.problem.at(times)
    if kept is not None:
        problem = eqx.tree_at(lambda p: p.weight, problem, problem.weight * as_float(kept)[..., None])
    return _retrieve(problem, asked.start, asked.names, priors=rows, start=starts, **asked.options())


def _jackknifed(asked: Prepared, times: np.ndarray, found: Estimate, groups: int) -> np.ndarray:
    r"""The jackknife sigma of the parameters, `[time, parameter]`, from fits that each leave out a group of directions.

    $\sigma^2 = \frac{G - 1}{G} \sum_g (x_g - \bar x)^2$. Each fit starts from the end of the whole fit. Groups are
    neighbours in the sky's order, so that directions with a common error are left out together.
    **Source:** Efron 1982, The Jackknife, the Bootstrap and Other Resampling Plans, ch. 3.
    """
    held = (np.asarray(asked.problem.weight[times]) > 0.0).any(axis=2)
    place = np.cumsum(held, axis=1) - 1
    group = place * groups // np.maximum(held.sum(axis=1, keepdims=True), 1)
    values = np.asarray(found.values, float)
    free = np.array([[PARAMETERS[n].unbound(v) for n, v in zip(asked.names, row, strict=True)] for row in values])
    own = len(asked.own)
    start = Point(as_float(free[None, :, :own]), as_float(free[:1, own:]))
    left = [np.asarray(solve(asked, times, start, group != g).values, float) for g in range(groups)]
    return np.sqrt((groups - 1) * np.var(np.stack(left), axis=0))


_retrieve = programs.kept(retrieve, shape_of)
