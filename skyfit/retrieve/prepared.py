"""The checked request for a retrieval, and the arrays that it works on."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from ..atmosphere import from_description
from ..light.solar import SPECTRUM_NM
from ..measured import NoiseModel, Response, Sky, station_pressure, STATION_RANGES, sun_factor, time_names
from ..measured.quality.oddities import examine
from ..numerics import as_float
from ..numerics.chain import Point
from ..transport import AbstractSolver, low_sun, OrdersOfScattering
from .components import Expected
from .forward import Problem
from .guess import first_guess
from .model import SkyModel
from .parameters import (
    check_free,
    fixed_values,
    LOBES_FREE,
    PARAMETERS,
    PARTICLE_FREE,
    POINTING,
    SIZE_BINS,
    start_model,
    values_of,
)
from .residuals import Priors
from .sampling import Sampling


# spread of the unconstrained numbers of random starts: covers most of each range, not its ends
_START_SPREAD = 1.5
# least ratio of the samples' own noise to the stated noise. With less, the smooth residuals of a real sky pass for
# pointing errors of degrees, and for broad errors twice as large as those that halves of the directions show
_LEAST = 1.0
# sigma of the second difference of the logarithms of neighbouring size bins. In a lognormal mode the second difference
# is minus the square of the bins' distance, 0.27, over the square of the width: -0.6 for the narrowest width that
# networks state, 0.35. Between two modes it is up to 1
_BEND = 1.0
# least number of wavelengths that determine the sizes of particles, and least ratio of the longest to the shortest
_MANY_WAVELENGTHS, _WIDE = 3, 1.5


@dataclass(frozen=True)
class Prepared:
    """A checked request for a fit of a sky.

    `own` and `shared` are in the order of `PARAMETERS`, so that the same names in another order use the same compiled
    program. `slopes`: solver of the slopes in all searches but the last. `places` `[time, direction]`: the directions
    that `problem` holds. `rows`: the priors on the parameters' scales. `linked`: whether neighbours in time are tied.
    """

    sky: Sky
    free: tuple[str, ...]
    own: tuple[str, ...]
    shared: tuple[str, ...]
    solver: AbstractSolver
    slopes: AbstractSolver
    start: SkyModel
    measurement: NoiseModel
    priors: dict[str, tuple[float, float]]
    smooth: dict[str, float]
    max_steps: int
    sampling: Sampling
    chosen: np.ndarray
    problem: Problem
    places: np.ndarray
    rows: Priors
    linked: bool

    @property
    def names(self) -> tuple[str, ...]:
        return self.own + self.shared

    @property
    def order(self) -> np.ndarray:
        """The index among `names` of each free name, in the user's order."""
        return np.array([self.names.index(n) for n in self.free])

    def options(self) -> dict:
        """The arguments of `retrieve` besides the samples, the model, the free names, the priors and the start."""
        given = self.measurement.model_error
        sizes, strength = self.measurement.shared_errors()
        return {
            "solver": self.solver,
            "slopes": self.slopes,
            "shared": self.shared,
            "loss": self.measurement.loss,
            "threshold": as_float(self.measurement.threshold),
            "model_error": as_float(self.solver.model_error if given is None else given),
            "max_steps": jnp.asarray(self.max_steps),
            "expected": Expected(as_float(sizes), as_float(strength), as_float(_LEAST)),
            "level": as_float(self.measurement.time_level),
        }


def usual_free(sky: Sky) -> tuple[str, ...]:
    """The default free names: the parameters that a sky of this kind determines.

    They are those of spheres in two size modes where spectral radiance of three wavelengths or more determines these.
    Spheres explain held-out directions better than two lobes, whose shape does not change with wavelength
    (experiments/validation/error_bars.py). Otherwise, and for a simulated sky whose haze has lobes, they are those of
    two lobes. The pointing is free too, except for an instrument that follows the sun, which knows where it looks.
    """
    seen = sky.wavelength_nm[sky.usable.any(axis=(0, 1))]
    many = sky.response is None and seen.size >= _MANY_WAVELENGTHS and seen.max() > _WIDE * seen.min()
    if many and "atmosphere" in sky.made_by:
        many = "fine_fraction" in values_of(_maker(sky), PARTICLE_FREE)
    names = PARTICLE_FREE if many else LOBES_FREE
    return tuple(n for n in names if n not in POINTING) if sky.follows_sun else names


def _maker(sky: Sky) -> SkyModel:
    """The model with which a simulated sky was made, as it states."""
    return SkyModel(from_description(sky.made_by["atmosphere"], "made_by.atmosphere"))


def prepared(
    sky: Sky,
    free: Sequence[str] | None = None,
    solver: AbstractSolver | None = None,
    start: SkyModel | None = None,
    fwhm_nm: float | None = None,
    max_steps: int = 100,
    shared: Sequence[str] = (),
    measurement: NoiseModel | None = None,
    response: Response | None = None,
    priors: Mapping[str, tuple[float, float] | None] | None = None,
    smooth: Mapping[str, float] | None = None,
    draft: AbstractSolver | None = None,
) -> Prepared:
    """Check the arguments, which are those of `invert`, and prepare the request.

    **Errors:** `ValueError` for unknown or contradicting names, settings out of range, a sky without a usable sample.
    """
    sky, shared = sky.with_response(response), tuple(shared)
    said = free is None
    free = usual_free(sky) if free is None else tuple(free)
    measurement = NoiseModel() if measurement is None else measurement
    # polarisation matters less for a camera's colours than the true shape of its channels
    polarised = sky.response is None or sky.degree_of_polarisation is not None
    solver = OrdersOfScattering.normal(polarised=polarised) if solver is None else solver
    start = start_at(sky, free) if start is None else start
    check_free(free, start)
    if max_steps < 1:
        raise ValueError(f"`max_steps` must be 1 or more, got {max_steps}")
    known, ties = _checked_priors(priors or {}, free), dict(smooth or {})
    _check_shared(shared, ties, free)
    low, high, unit = STATION_RANGES["fwhm_nm"]
    if fwhm_nm is not None and np.isfinite(fwhm_nm) and not low <= fwhm_nm <= high:
        raise ValueError(f"`fwhm_nm` must be {low:g} to {high:g} {unit}, got {fwhm_nm:g}")
    sampling = Sampling(sky, fwhm_nm, measurement.field_of_view)
    distance = sun_factor(sky)[1]
    sampling.notes += [distance] if distance else []
    if said and set(free) & set(PARTICLE_FREE) - set(LOBES_FREE):
        sampling.notes.append("haze of spheres in two modes of size, as a measured spectrum tells: `free` names others")
    if said and sky.follows_sun:
        sampling.notes.append("pointing held: the instrument follows the sun; `free` names it where it does not")
    sampling.notes += [*_assumed(sky, start, free), *_unlike_its_maker(sky, start, free)]
    if sky.degree_of_polarisation is not None:
        draft = solver if draft is None else draft
        _check_polarised((solver, draft), measurement)
    draft = solver.coarser() if draft is None else draft
    chosen = sampling.chosen()
    if chosen.size == 0:
        raise ValueError(f"`sky` has no usable sample at {SPECTRUM_NM[0]:g}-{SPECTRUM_NM[1]:g} nm")
    own = tuple(n for n in PARAMETERS if n in free and n not in shared)
    common = tuple(n for n in PARAMETERS if n in shared)
    # a single time has no neighbour, and nothing to share
    linked = bool(ties) and len(sky.time) > 1
    problem, places = sampling.problem(chosen, measurement)
    rows = _prior_rows(sky, own, common, known, ties if linked else {}, measurement.calibration_prior(sky))
    return Prepared(
        sky, free, own, common, solver, draft, start, measurement, known, ties,
        max_steps, sampling, chosen, problem, places, rows, linked,
    )  # fmt: skip


def _check_polarised(solvers: tuple[AbstractSolver, ...], measurement: NoiseModel) -> None:
    if not all(solver.knows_polarisation for solver in solvers):
        raise ValueError(
            "`solver` must be polarised for degrees of polarisation: OrdersOfScattering.normal(polarised=True)"
        )
    if measurement.field_of_view > 0.0:
        raise ValueError(
            f"`field_of_view` must be 0 with degrees of polarisation, got {measurement.field_of_view:g}: "
            "of a cone's rays each has a frame of its own"
        )


def start_at(sky: Sky, free: Sequence[str]) -> SkyModel:
    """The start model of a fit of a sky, with the pressure and the ozone of its station (`start_model`)."""
    ozone = {} if np.isnan(sky.ozone_du) else {"ozone": sky.ozone_du}
    if "ozone" in free and ozone:
        ozone["ozone"] = float(np.clip(sky.ozone_du, PARAMETERS["ozone"].lower + 1.0, PARAMETERS["ozone"].upper - 1.0))
    return start_model(tuple(free), station_pressure(sky)[0], **ozone)


def _assumed(sky: Sky, start: SkyModel, free: tuple[str, ...]) -> Iterator[str]:
    """Yield a note on the station's pressure if it is assumed: neither the file nor the user states it."""
    pressure, sentence = station_pressure(sky)
    held = fixed_values(start, free).get("pressure")
    if sentence and held is not None and np.isclose(held, pressure, rtol=1e-5):
        yield sentence


def _unlike_its_maker(sky: Sky, start: SkyModel, free: tuple[str, ...]) -> Iterator[str]:
    """Yield a note on parameters held fixed at other values than those that a simulated sky was made with."""
    if "atmosphere" not in sky.made_by:
        return
    true, held = fixed_values(_maker(sky), free), fixed_values(start, free)
    other = [n for n in held if n in true and not np.isclose(held[n], true[n], rtol=1e-3, atol=1e-6)]
    if other:
        told = ", ".join(f"{n} {held[n]:.4g} for {true[n]:.4g}" for n in other)
        yield f"held fixed unlike what made this sky: {told}"


def flaws(asked: Prepared) -> list[str]:
    """Why each time cannot be fitted.

    The reason is "no_samples", "too_few_samples", "sun_below_horizon" or "sun_too_low" (for the solver); "" if the time
    can be fitted.
    """
    counts = asked.sampling.used[:, :, asked.chosen].sum(axis=(1, 2))
    sun = asked.sky.sun_zenith.reshape(len(counts), -1).max(axis=1)
    lowest = np.radians(asked.solver.suns.largest_deg)
    return [
        "sun_below_horizon" if not (sun[t] < 0.5 * np.pi or asked.solver.after_sunset and sun[t] <= lowest)
        else "sun_too_low" if sun[t] > lowest
        else "no_samples" if not counts[t]
        else "too_few_samples" if counts[t] < len(asked.free)
        else ""
        for t in range(len(counts))
    ]  # fmt: skip


_WHY = {
    "sun_below_horizon": "the sun is at or below the horizon",
    "no_samples": "no usable sample",
    "too_few_samples": "fewer usable samples than free parameters",
}


def fittable(asked: Prepared) -> Sky | None:
    """The sky without the times that cannot be fitted, which its notes name; None if all or none can be fitted."""
    why = flaws(asked)
    kept = [t for t, flaw in enumerate(why) if not flaw]
    if not kept or len(kept) == len(why):
        return None
    names = time_names(asked.sky)
    told = [f"{names[t]} not fitted: {_WHY[flaw]}" for t, flaw in enumerate(why) if flaw]
    return replace(asked.sky.at_times(kept), notes=(*asked.sky.notes, *told))


def check(asked: Prepared) -> None:
    """Raise a `ValueError` if a time cannot be fitted or if no time can be a sky; add oddities to the notes."""
    for t, flaw in enumerate(flaws(asked)):
        if flaw == "sun_below_horizon":
            raise ValueError(f"`sky` has the sun at or below the horizon at time {t}: it cannot be inverted")
        if flaw == "sun_too_low":
            sun = np.degrees(asked.sky.sun_zenith[t].max())
            raise ValueError(
                f"`sky` has the sun {sun:.4g} degrees from the zenith at time {t}, which {type(asked.solver).__name__} "
                f"in {asked.solver.geometry} geometry knows to {asked.solver.suns.largest_deg:g} degrees"
            )
        if flaw:
            count = int(asked.sampling.used[t][:, asked.chosen].sum())
            raise ValueError(
                f"`sky` has {count} usable samples at time {t}, fewer than the {len(asked.free)} free parameters"
            )
    said = low_sun(asked.solver, asked.sky.sun_zenith)
    if said is not None:
        asked.sampling.notes.append(said)
    if asked.sampling.response is None:
        asked.sampling.notes += examine(asked.sky, asked.sampling.used)


def first_points(asked: Prepared, times: np.ndarray, guess: bool = True, starts: int = 1, seed: int = 0) -> Point:
    """Starting points of the search, `[start, ...]`: the start model or the guess from the data, then random points."""
    names, own = asked.names, len(asked.own)
    if guess:
        values = first_guess(asked.solver.geometry, asked.start, names, asked.problem.at(times))
    else:
        values = np.tile(list(values_of(asked.start, names).values()), (len(times), 1))
    free = np.array([[PARAMETERS[n].unbound(v) for n, v in zip(names, row, strict=True)] for row in values])
    random = np.random.default_rng(seed)
    points = np.stack([free, *(_START_SPREAD * random.standard_normal(free.shape) for _ in range(starts - 1))])
    # shared numbers begin at their median over the times
    return Point(as_float(points[:, :, :own]), as_float(np.median(points[:, :, own:], axis=1)))


def _prior_rows(sky: Sky, own, shared, priors: dict, smooth: dict, calibration: float) -> Priors:
    centre, inverse_sigma = [], []
    for name in own + shared:
        value, sigma = priors.get(name, (None, np.inf))
        parameter = PARAMETERS[name]
        centre.append(0.0 if value is None else parameter.to_scale(value))
        inverse_sigma.append(0.0 if value is None else (value if parameter.log else 1.0) / sigma)
    steps = np.zeros((len(sky.time) - 1, len(own)))
    if smooth:
        hours = np.diff(sky.time) / np.timedelta64(1, "h")
        if not np.all(hours > 0.0):
            raise ValueError("`smooth` needs the times of the sky, increasing")
        for name, sigma in smooth.items():
            steps[:, own.index(name)] = 1.0 / (sigma * np.sqrt(hours))
    scale = as_float(1.0 / calibration) if calibration > 0.0 else None
    return Priors(as_float(centre), as_float(inverse_sigma), scale, as_float(steps), _bends(own, shared))


def _bends(own: tuple[str, ...], shared: tuple[str, ...]):
    """Second differences of the logarithms of neighbouring size bins over their sigma, `[row, parameter]`."""
    names, rows = own + shared, []
    for three in zip(SIZE_BINS, SIZE_BINS[1:], SIZE_BINS[2:], strict=False):
        if set(three) <= set(own) or set(three) <= set(shared):
            rows.append(np.zeros(len(names)))
            rows[-1][[names.index(name) for name in three]] = np.array([1.0, -2.0, 1.0]) / _BEND
    return as_float(np.reshape(rows, (-1, len(names))))


def _checked_priors(given: Mapping, free: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    """The given priors, and the climatology of parameters that are given none; None: no prior."""
    usual = {name: PARAMETERS[name].climatology for name in free}
    priors = {}
    for name, entry in {**usual, **given}.items():
        if name not in free:
            raise ValueError(f"`priors` must name free parameters ({', '.join(free)}), got {name!r}")
        if entry is None:
            continue
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
