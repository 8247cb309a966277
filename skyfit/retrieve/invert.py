"""From a measured sky to the parameters of its atmosphere."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import numpy as np

from ..light.solar import SPECTRUM_NM
from ..measured import Measurement, Response, Sky, station_pressure, STATION_RANGES
from ..measured.quality.oddities import examine
from ..measured.quality.plausibility import doubts, poor_fit
from ..numerics import as_float
from ..numerics.chain import Point
from ..numerics.least_squares import result_name
from ..transport import AbstractSolver, OrdersOfScattering
from .estimate import Estimate, estimate
from .guess import first_guess
from .model import SkyModel
from .parameters import check_free, PARAMETERS, partition, start_model, values_of, with_values
from .residuals import Priors, Setup
from .result import Fit, Fitted, in_words, is_determined
from .sampling import Sampling


# what a sky scan determines, and the pointing that it needs
DEFAULT_FREE = (
    "aerosol_optical_depth", "angstrom_exponent", "single_scattering_albedo", "asymmetry",
    "asymmetry_second", "forward_fraction", "forward_fraction_slope", "ground_albedo", "pointing_zenith",
    "pointing_azimuth",
)  # fmt: skip
# the same with particles: haze of spheres in two modes of size
PARTICLE_FREE = (
    "aerosol_optical_depth", "fine_fraction", "fine_radius", "coarse_radius", "refractive_index", "absorption_index",
    "ground_albedo", "ground_red_edge", "pointing_zenith", "pointing_azimuth",
)  # fmt: skip
# what stays the same over a day: the kind of particle and the air; the amount of haze, the pointing and, under a moving
# sun, what the ground reflects do not
SLOW = (
    "single_scattering_albedo", "single_scattering_albedo_slope", "asymmetry", "asymmetry_second", "forward_fraction",
    "forward_fraction_slope", "haze_polarisation", "fine_fraction", "fine_radius", "coarse_radius", "fine_width",
    "coarse_width", "refractive_index", "absorption_index", "aerosol_scale_height", "ozone", "ground_albedo_slope",
    "pressure",
)  # fmt: skip
# spread of the logistic numbers of random starts: most of each range, not its ends
_START_SPREAD = 1.5


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
    measurement: Measurement | None = None,
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
      polarised for spectral radiance, scalar for the channels of a `response`
    - `start`: the values that are not fitted, and those of the free ones where the search begins; with `guess` the
      haze's begin where single scattering explains the sky best; `starts` - 1 random ones besides
    - `fwhm_nm`: line shape (default: the file's, or estimated from the solar lines); `response`: channels of a camera
    - `shared`: free names that all times have in common (`SLOW` names those that do not change within a day); none:
      each time is fitted by itself
    - `measurement`: noise, calibration, field of view, outliers (`Measurement`)
    - `priors`: name -> (value, sigma) in the parameter's unit; of a positive parameter sigma / value is that of its
      logarithm. `smooth`: name -> sigma of its change within an hour, on the same scale, for names that are not shared
    - `draft`: solver of the first steps and of the slopes of the last ones (default: for `OrdersOfScattering` its scout
      and its draft; else `solver` itself)
    - `max_steps` of Levenberg-Marquardt each; `progress(done, of)` is called after each time that is fitted by itself

    **Returns:** a `Fit`. Sigma is that of noise (widened where the residuals exceed it), priors included, and of the
    model's stated error.
    **Valid:** sun above the horizon; samples in bands of oxygen and water vapour are left out and counted.
    **Errors:** `ValueError` for unknown or contradicting names, or a sky with too few usable samples.
    """
    plan = Plan(sky, free, solver, start, fwhm_nm, max_steps, shared, measurement, response, priors, smooth, draft)
    plan.check()
    times = len(sky.time)
    groups = [np.arange(times)] if plan.setup.shared or plan.linked else [np.array([t]) for t in range(times)]
    parts = []
    for number, group in enumerate(groups):
        parts.append(plan.solve(group, plan.first_points(group, guess, starts)))
        if progress is not None:
            progress(number + 1, len(groups))
    return plan.fit(groups, parts)


class Plan:
    """All that a fit of a sky is asked for, checked, and the arrays that it works on."""

    def __init__(
        self, sky: Sky, free, solver=None, start=None, fwhm_nm=None, max_steps=100, shared=(), measurement=None,
        response=None, priors=None, smooth=None, draft=None,
    ):  # fmt: skip
        self.sky, self.free, shared = sky, tuple(free), tuple(shared)
        self.measurement = Measurement() if measurement is None else measurement
        # colours of a camera are told less by polarisation than by what its channels really are
        self.solver = OrdersOfScattering.normal(polarised=response is None) if solver is None else solver
        # of the first steps, of the last ones' slopes and of their radiance
        self.solvers = *(self.solver.coarser() if draft is None else (draft, draft)), self.solver
        given = self.measurement.model_error
        self.model_error = self.solver.model_error if given is None else given
        pressure, assumed = station_pressure(sky)
        self.start = start_model(self.free, pressure) if start is None else start
        check_free(self.free, self.start)
        self.priors = _checked_priors(dict(priors or {}), self.free)
        self.smooth = dict(smooth or {})
        _check_shared(shared, self.smooth, self.free)
        low, high, unit = STATION_RANGES["fwhm_nm"]
        if fwhm_nm is not None and np.isfinite(fwhm_nm) and not low <= fwhm_nm <= high:
            raise ValueError(f"`fwhm_nm` must be {low:g} to {high:g} {unit}, got {fwhm_nm:g}")
        self.sampling = Sampling(sky, fwhm_nm, response, self.measurement.field_of_view)
        if assumed:
            self.sampling.notes.append(assumed)
        self.chosen = self.sampling.chosen()
        if self.chosen.size == 0:
            raise ValueError(f"`sky` has no usable sample at {SPECTRUM_NM[0]:g}-{SPECTRUM_NM[1]:g} nm")
        # in an order of their own: the same names in another one are the same program
        own = tuple(n for n in PARAMETERS if n in self.free and n not in shared)
        shared = tuple(n for n in PARAMETERS if n in shared)
        calibration = self.measurement.calibration_prior(sky)
        self.setup = Setup(
            own, shared, self.measurement.loss, self.measurement.threshold, self.model_error,
            calibration > 0.0, max_steps,
        )  # fmt: skip
        # a single time has no neighbour, and nothing to share
        self.linked = bool(self.smooth) and len(sky.time) > 1
        self.problem, self.places = self.sampling.problem(self.chosen, self.measurement)
        _, self.fixed = partition(self.start, self.free)
        self.prior_rows = self._prior_rows(calibration)

    def flaws(self) -> list[str]:
        """Why each time cannot be fitted: "no_samples", "too_few_samples", "sun_below_horizon", or "" if it can."""
        counts = self.sampling.used[:, :, self.chosen].sum(axis=(1, 2))
        up = self.sky.sun_zenith.reshape(len(counts), -1).max(axis=1) < 0.5 * np.pi
        return [
            "sun_below_horizon" if not up[t]
            else "no_samples" if not counts[t]
            else "too_few_samples" if counts[t] < len(self.free)
            else ""
            for t in range(len(counts))
        ]  # fmt: skip

    def check(self) -> None:
        """A `ValueError` if any time cannot be fitted, or if all are no sky; what is odd goes into the notes."""
        for t, flaw in enumerate(self.flaws()):
            if flaw == "sun_below_horizon":
                raise ValueError(f"`sky` has the sun at or below the horizon at time {t}: it cannot be inverted")
            if flaw:
                count = int(self.sampling.used[t][:, self.chosen].sum())
                raise ValueError(
                    f"`sky` has {count} usable samples at time {t}, fewer than the {len(self.free)} free parameters"
                )
        if self.sampling.response is None:
            self.sampling.notes += examine(self.sky, self.sampling.used)

    def _prior_rows(self, calibration: float) -> Priors:
        centre, weight = [], []
        for name in self.setup.names:
            value, sigma = self.priors.get(name, (None, np.inf))
            if value is None:
                centre.append(0.0)
                weight.append(0.0)
                continue
            parameter = PARAMETERS[name]
            centre.append(parameter.to_scale(value))
            weight.append((value if parameter.log else 1.0) / sigma)
        steps = np.zeros((len(self.sky.time) - 1, len(self.setup.own)))
        if self.linked:
            hours = np.diff(self.sky.time) / np.timedelta64(1, "h")
            if not np.all(hours > 0.0):
                raise ValueError("`smooth` needs the times of the sky, increasing")
            for name, sigma in self.smooth.items():
                steps[:, self.setup.own.index(name)] = 1.0 / (sigma * np.sqrt(hours))
        scale = 1.0 / calibration if calibration > 0.0 else 0.0
        return Priors(as_float(centre), as_float(weight), as_float(scale), as_float(steps))

    def first_points(self, times: np.ndarray, guess: bool = True, starts: int = 1, seed: int = 0) -> Point:
        """Where the search begins, `[start, ...]`: the start or the guess from the data, then random ones."""
        names, own = self.setup.names, len(self.setup.own)
        problem = self.problem.at(times)
        if guess:
            values = first_guess(self.solver.geometry, self.start, names, problem)
        else:
            values = np.tile(list(values_of(self.start, names).values()), (len(times), 1))
        free = np.array([[PARAMETERS[n].unbound(v) for n, v in zip(names, row, strict=True)] for row in values])
        random = np.random.default_rng(seed)
        points = np.stack([free, *(_START_SPREAD * random.standard_normal(free.shape) for _ in range(starts - 1))])
        # shared numbers begin in the middle of what the times say
        return Point(as_float(points[:, :, :own]), as_float(np.median(points[:, :, own:], axis=1)))

    def solve(self, times: np.ndarray, points: Point) -> Estimate:
        """The estimate of some times together."""
        priors = self.prior_rows
        if len(times) < len(self.sky.time):
            priors = priors._replace(step=priors.step[:0])
        return _estimate(self.setup, self.solvers, self.fixed, self.problem.at(times), priors, points)

    def fit(self, groups: Sequence[np.ndarray], parts: Sequence[Estimate]) -> Fit:
        """The estimates of all groups of times as one `Fit`."""
        sky, names = self.sky, self.setup.names
        # back to the order in which the user named them
        order = np.array([names.index(n) for n in self.free])
        rows: list[dict] = [{} for _ in sky.time]
        for group, part in zip(groups, parts, strict=True):
            for index, t in enumerate(group):
                rows[t] = self._row(int(t), index, part, order)
        stack: dict[str, Any] = {key: np.stack([row[key] for row in rows]) for key in rows[0] if key not in _WORDS}
        words: dict[str, Any] = {key: tuple(row[key] for row in rows) for key in _WORDS}
        judged = sky, stack["model"], self.sampling.used
        notes = (*self.sampling.notes, *doubts(*judged, stack["reduced_chi_square"]))
        pairs = zip(words["result"], poor_fit(*judged), strict=True)
        words["result"] = tuple("poor_fit" if poor and name == "successful" else name for name, poor in pairs)
        return Fit(
            sky=sky, solver=self.solver, free=self.free, shared=self.setup.shared, used=self.sampling.used,
            start=self.start, fwhm_nm=self.sampling.fwhm_nm, measurement=self.measurement, priors=self.priors,
            smooth=self.smooth, response=self.sampling.response, fitted_nm=sky.wavelength_nm[self.chosen],
            notes=notes, **stack, **words,
        )  # fmt: skip

    def _row(self, t: int, index: int, part: Estimate, order: np.ndarray) -> dict:
        found, change = described(
            self.free, self.setup.shared, order, part.values[index], part.noise[index], part.model[index]
        )
        values = found["values"]
        result = result_name(part.result) if bool(part.finite) else "failed"
        calibration = np.asarray(part.calibration, float)
        fitted = with_values(self.fixed, self.free, as_float(values))
        reading = self.sampling.readings(self.solver, fitted, t)
        scale = np.interp(self.sky.wavelength_nm, self.sky.wavelength_nm[self.chosen], calibration)
        reading = reading * scale[None]
        used = self.sampling.used[t]
        error = (reading - self.sky.radiance[t])[used]
        weight = np.ones((self.sky.radiance.shape[1], self.chosen.size))
        held = np.asarray(self.problem.weight[t]).any(axis=1)
        weight[self.places[t][held]] = np.asarray(part.weight[index], float)[held]
        gain = np.zeros((len(order), *weight.shape))
        gain[:, self.places[t][held]] = np.einsum(
            "pq,qdw->pdw", change, np.asarray(part.gain[index], float)[order][:, held]
        )
        weight = np.where(used[:, self.chosen], weight, np.nan)
        sentences = in_words(
            self.free,
            found,
            np.asarray(part.triangle[index], float)[:, order] @ np.abs(change).T,
            self.priors,
        )
        return found | {
            "model": reading,
            "rmse": float(np.sqrt(np.mean(error**2))),
            "reduced_chi_square": float(part.chi_square[index]),
            "scale": float(part.scale[index]),
            "degrees_of_freedom": float(part.freedom[index]),
            "weight": weight,
            "gain": gain,
            "calibration": calibration,
            "calibration_sigma": np.asarray(part.calibration_sigma, float),
            "steps": int(part.steps),
            "cost": float(part.cost),
            "result": result,
            "undetermined": sentences,
        }


def described(
    free: tuple[str, ...], shared: tuple[str, ...], order: np.ndarray, values, noise, model
) -> tuple[dict, np.ndarray]:
    """What an estimate says of the parameters of one time, in the order in which the user named them.

    **Arguments:** `order`, the place of each free name in the arrays; `values`, covariances `noise` and `model`.
    **Returns:** values, sigma, covariance, model_sigma, at_bound, determined; the change that orders the lobes.
    """
    values, change = _ordered_lobes(free, shared, np.asarray(values, float)[order])
    noise, model = (_turned(change, np.asarray(v, float)[np.ix_(order, order)]) for v in (noise, model))
    covariance = noise + np.where(np.isfinite(noise), model, 0.0)
    sigma = np.sqrt(np.diag(covariance))
    found = {
        "values": values,
        "sigma": sigma,
        "covariance": covariance,
        "model_sigma": np.sqrt(np.diag(model)),
        "at_bound": np.array([PARAMETERS[n].at_bound(v) for n, v in zip(free, values, strict=True)]),
        "determined": is_determined(free, values, sigma),
    }
    return found, change


_WORDS = ("result", "undetermined")
_LOBES = ("asymmetry", "asymmetry_second", "forward_fraction")


def _ordered_lobes(free: tuple[str, ...], shared: tuple[str, ...], values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The values with the narrower lobe first, which is the same phase function, and the matrix of that change."""
    change = np.eye(len(free))
    phase = set(free) & {*_LOBES, "forward_fraction_slope"}
    # lobes of which only one is shared cannot change places at some of the times
    if not set(_LOBES) <= phase or phase & set(shared) not in (set(), phase):
        return values, change
    first, second, share = (free.index(name) for name in _LOBES)
    if not values[first] < values[second]:
        return values, change
    change[[first, second]] = change[[second, first]]
    change[share] *= -1.0
    if "forward_fraction_slope" in free:
        change[free.index("forward_fraction_slope")] *= -1.0
    ordered = change @ values
    ordered[share] += 1.0
    return ordered, change


def _turned(change: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """The covariance after a signed permutation; infinite variances stay so, and what is not a number."""
    known = ~np.isinf(covariance)
    turned = change @ np.where(known, covariance, 0.0) @ change.T
    return np.where(np.abs(change) @ (~known).astype(float) @ np.abs(change).T > 0.0, np.inf, turned)


@eqx.filter_jit
def _estimate(setup, solvers, fixed, problem, priors, points):
    return estimate(setup, solvers, fixed, problem, priors, points)


def _checked_priors(priors: dict, free: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    for name, entry in priors.items():
        if name not in free:
            raise ValueError(f"`priors` must name free parameters ({', '.join(free)}), got {name!r}")
        value, sigma = (float(v) for v in entry)
        parameter = PARAMETERS[name]
        if not (parameter.lower <= value <= parameter.upper and sigma > 0.0 and np.isfinite(sigma)):
            raise ValueError(
                f"`priors` of {name} must be a value in [{parameter.lower:g}, {parameter.upper:g}] {parameter.unit} "
                f"and a positive sigma, got {entry}"
            )
        priors[name] = value, sigma
    return priors


def _check_shared(shared: tuple[str, ...], smooth: dict, free: tuple[str, ...]) -> None:
    for name in shared:
        if name not in free:
            raise ValueError(f"`shared` must name free parameters ({', '.join(free)}), got {name!r}")
    for name, sigma in smooth.items():
        if name not in free or name in shared:
            raise ValueError(f"`smooth` must name free parameters that are not shared, got {name!r}")
        if not 0.0 < sigma < np.inf:
            raise ValueError(f"`smooth` of {name} must be a positive sigma per hour, got {sigma!r}")


def predict(fitted: Fitted, sky: Sky) -> np.ndarray:
    """The fitted skies at the times, directions and wavelengths of another sky, as the instrument would read them.

    **Arguments:** `fitted` (`Fit.fitted`, or what `skyfit.load` gives); `sky`, whose radiance is not used.
    **Returns:** radiance `[time, direction, wavelength]`, W m^-2 sr^-1 nm^-1, NaN beyond 300-1100 nm; the fitted
    pointing offsets and, interpolated, the fitted calibration are in it.
    **Errors:** `ValueError` for a time of `sky` that was not fitted; one sky without a time matches one fit.
    """
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
