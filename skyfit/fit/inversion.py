"""From a measured sky to the parameters of its atmosphere."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..atmosphere import pressure_at_altitude, SEA_LEVEL_PRESSURE
from ..light import earth_sun_factor, extraterrestrial_irradiance
from ..scene import as_float, Directions, Scene, Sky
from ..transport import AbstractSolver, OrdersOfScattering
from .line_shape import estimate_fwhm
from .parameters import check_free, PARAMETERS, partition, SkyModel, start_model, values_of, with_values
from .result import Fit, Fitted
from .solve import covariance, least_squares, LOGISTIC_LIMIT, result_name


# what a sky scan determines, and the pointing that it needs
DEFAULT_FREE = (
    "aerosol_optical_depth", "angstrom_exponent", "single_scattering_albedo", "asymmetry",
    "asymmetry_second", "forward_fraction", "ground_albedo", "pointing_zenith", "pointing_azimuth",
)  # fmt: skip
# nm; absorption by oxygen and water that the model leaves out (Bird & Riordan 1986, table 1)
GAS_BANDS_NM = ((684.0, 700.0), (714.0, 742.0), (756.0, 774.0), (785.0, 850.0), (890.0, 1000.0))
# the noise that is taken where a file gives none: relative, and a share of the median radiance
_RELATIVE_NOISE, _FLOOR_NOISE = 0.02, 0.03
_MOST_WAVELENGTHS = 40
_SPECTRUM_NM = (300.0, 1100.0)
# a parameter counts as determined if its sigma is below this share of its allowed range
_DETERMINED_SHARE = 0.25


def invert(
    sky: Sky,
    free=DEFAULT_FREE,
    solver: AbstractSolver | None = None,
    start: SkyModel | None = None,
    fwhm_nm: float | None = None,
    max_steps: int = 100,
    progress: Callable[[int, int], None] | None = None,
) -> Fit:
    """The parameters of the atmosphere over a measured sky, with uncertainties; each time by itself.

    **Arguments:** `sky` (`skyfit.read`); `free`, names among `PARAMETERS`; `solver`, default
    `OrdersOfScattering.normal()`; `start`, the first guess and the fixed values; `fwhm_nm`, the line shape
    (default: the file's, or estimated from the solar lines); `max_steps` of Levenberg-Marquardt;
    `progress(done, of)` is called after each time.
    **Returns:** a `Fit`. Residuals are divided by the file's sigma, else by 2 % of each sample and 3 % of the
    median; the covariance is scaled by the reduced chi-square where that exceeds 1.
    **Valid:** sun above the horizon; samples in bands of oxygen and water vapour are left out and counted.
    **Errors:** `ValueError` for unknown or contradicting names, or a sky with too few usable samples.
    """
    free = tuple(free)
    solver = OrdersOfScattering.normal() if solver is None else solver
    notes = list(sky.notes)
    pressure, assumed = station_pressure(sky)
    if start is None:
        start = start_model(free, pressure)
    if assumed:
        notes.append(assumed)
    check_free(free, start)
    if fwhm_nm is None:
        fwhm_nm = _line_shape(sky, notes)
    used = _usable(sky, notes)
    chosen = _chosen_wavelengths(used)
    if chosen.size == 0:
        raise ValueError(f"`sky` has no usable sample at {_SPECTRUM_NM[0]:g}-{_SPECTRUM_NM[1]:g} nm")
    model_at = _Forward(sky, solver, fwhm_nm)
    sigma = _sigma(sky, used)
    first = as_float([PARAMETERS[n].unbound(float(PARAMETERS[n].from_leaf(PARAMETERS[n].leaf(start)))) for n in free])
    _, fixed = partition(start, free)
    counts = [int(used[t][:, chosen].sum()) for t in range(len(sky.time))]
    for t, count in enumerate(counts):
        if count < len(free):
            raise ValueError(
                f"`sky` has {count} usable samples at time {t}, fewer than the {len(free)} free parameters"
            )
        if not sky.sun_zenith[t] < 0.5 * np.pi:
            raise ValueError(f"`sky` has the sun at or below the horizon at time {t}: it cannot be inverted")
    columns: dict[str, list] = {name: [] for name in _COLUMNS}
    for t in range(len(sky.time)):
        count = counts[t]
        measured = np.where(used[t], sky.radiance[t], 0.0)[:, chosen]
        weight = np.where(used[t], 1.0 / sigma[t], 0.0)[:, chosen]
        scene = model_at.scene(t, chosen)
        solved = _solve(solver, free, fixed, first, scene, as_float(measured), as_float(weight), max_steps)
        row = _describe(free, solved, count)
        row["model"] = np.asarray(model_at.radiance(t, with_values(fixed, free, as_float(row["values"]))))
        error = (row["model"] - sky.radiance[t])[used[t]]
        row["rmse"] = float(np.sqrt(np.mean(error**2)))
        for name in _COLUMNS:
            columns[name].append(row[name])
        if progress is not None:
            progress(t + 1, len(sky.time))
    lists = ("result", "undetermined")
    arrays: dict[str, Any] = {name: np.array(rows) for name, rows in columns.items() if name not in lists}
    words: dict[str, Any] = {name: tuple(columns[name]) for name in lists}
    everything = values_of(start, PARAMETERS)
    # one quantity under two names: never both
    hidden = {"aerosol_optical_depth"} if "turbidity" in free else {"turbidity"}
    kept = {n: v for n, v in everything.items() if n not in free and n not in hidden}
    return Fit(
        sky=sky, solver=solver, free=free, used=used, start=start, fwhm_nm=float(fwhm_nm), notes=tuple(notes),
        fixed=kept, **arrays, **words,
    )  # fmt: skip


def predict(fitted: Fitted, sky: Sky) -> np.ndarray:
    """The fitted skies at the times, directions and wavelengths of another sky.

    **Arguments:** `fitted` (`Fit.fitted`, or what `skyfit.load` gives); `sky`, whose radiance is not used.
    **Returns:** radiance `[time, direction, wavelength]`, W m^-2 sr^-1 nm^-1, NaN beyond 300-1100 nm.
    **Errors:** `ValueError` for a time of `sky` that was not fitted; one sky without a time matches one fit.
    """
    forward = _Forward(sky, fitted.solver, fitted.fwhm_nm)
    order = [_matching(fitted.time, sky.time, t) for t in range(len(sky.time))]
    return np.stack([forward.radiance(t, fitted.models[i]) for t, i in enumerate(order)])


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


_COLUMNS = (
    "values", "sigma", "covariance", "at_bound", "determined", "model", "rmse", "reduced_chi_square", "steps",
    "result", "undetermined",
)  # fmt: skip


class _Forward:
    """The scenes of a sky and the model's radiance in them."""

    def __init__(self, sky: Sky, solver: AbstractSolver, fwhm_nm: float):
        self.sky, self.solver = sky, solver
        inside = (sky.wavelength_nm >= _SPECTRUM_NM[0]) & (sky.wavelength_nm <= _SPECTRUM_NM[1])
        self.inside = np.flatnonzero(inside)
        width = fwhm_nm if np.isfinite(fwhm_nm) and fwhm_nm > 0.0 else None
        self.irradiance = np.full(sky.wavelength_nm.shape, np.nan)
        self.irradiance[inside] = np.asarray(extraterrestrial_irradiance(sky.wavelength_nm[inside], width))
        self.view = Directions(sky.view_zenith, sky.view_azimuth)

    def scene(self, time: int, chosen: np.ndarray) -> Scene:
        """The scene of one time at the chosen wavelengths (indices)."""
        sky = self.sky
        factor = 1.0 if np.isnat(sky.time[time]) else earth_sun_factor(day_of_year(sky.time[time]))
        return Scene(
            sky.sun_zenith[time], sky.sun_azimuth[time], self.view, sky.wavelength_nm[chosen],
            self.irradiance[chosen] * factor,
        )  # fmt: skip

    def radiance(self, time: int, model: SkyModel) -> np.ndarray:
        """The model at every wavelength of the sky, `[direction, wavelength]`, NaN beyond the solar table."""
        result = np.full(self.sky.radiance.shape[1:], np.nan)
        result[:, self.inside] = simulate(self.solver, model, self.scene(time, self.inside))
        return result


def day_of_year(time: np.datetime64) -> int:
    """The day of the year, 1 for 1 January."""
    return int((time.astype("datetime64[D]") - time.astype("datetime64[Y]")).astype(int)) + 1


@eqx.filter_jit
def simulate(solver: AbstractSolver, model: SkyModel, scene: Scene):
    """The radiance a model gives in a scene, the instrument's pointing included, `[direction, wavelength]`."""
    moved = eqx.tree_at(
        lambda s: (s.sun_zenith, s.sun_azimuth),
        scene,
        (
            scene.sun_zenith + model.instrument.pointing_zenith,
            scene.sun_azimuth + model.instrument.pointing_azimuth,
        ),
    )
    return solver.radiance(model.atmosphere, moved)


@eqx.filter_jit
def _solve(solver, free, fixed, first, scene, measured, weight, max_steps):
    """One sky: the solution, and the covariance and its triangle in the parameters' own units."""

    def bound(unbound):
        return jnp.stack([PARAMETERS[n].bound(unbound[i]) for i, n in enumerate(free)])

    def residual(values, arguments):
        fixed, scene, measured, weight = arguments
        model = with_values(fixed, free, values)
        return ((simulate(solver, model, scene) - measured) * weight).reshape(-1)

    limit = jnp.full_like(first, LOGISTIC_LIMIT)
    solution = least_squares(residual, bound, first, (fixed, scene, measured, weight), limit, max_steps)
    best = solution.value
    scale = jnp.stack(
        [best[i] if PARAMETERS[n].log else as_float(PARAMETERS[n].spread(1.0)) for i, n in enumerate(free)]
    )
    spread, triangle = covariance(solution.jacobian, scale)
    return solution, spread, triangle


def _describe(free, solved, count: int) -> dict:
    """Host-side words and numbers for one solved sky."""
    solution, spread, triangle = solved
    values, spread = np.asarray(solution.value, float), np.asarray(spread, float)
    reduced = float(np.sum(np.square(solution.residual))) / max(count - len(free), 1)
    spread = spread * max(reduced, 1.0)
    sigma = np.sqrt(np.diag(spread))
    limit = np.array([_DETERMINED_SHARE * PARAMETERS[n].spread(v) for n, v in zip(free, values, strict=True)])
    determined = np.isfinite(sigma) & (sigma < limit)
    at_bound = np.array([PARAMETERS[n].at_bound(v) for n, v in zip(free, values, strict=True)])
    finite = bool(np.all(np.isfinite(values)) and np.isfinite(reduced))
    return {
        "values": values,
        "sigma": sigma,
        "covariance": spread,
        "at_bound": at_bound,
        "determined": determined,
        "reduced_chi_square": reduced,
        "steps": int(solution.steps),
        "result": result_name(solution.result) if finite else "failed",
        "undetermined": _in_words(free, np.asarray(triangle, float), max(reduced, 1.0), determined, at_bound),
    }


def _in_words(free, triangle, reduced: float, determined, at_bound) -> tuple[str, ...]:
    """Sentences on what the data leave open, from the weak directions of the scaled Jacobian."""
    sentences = [
        f"{name} is not determined by these data" for name, yes in zip(free, determined, strict=True) if not yes
    ]
    sentences += [
        f"{name} stands at its bound: the data would take it further, its sigma is only local"
        for name, yes in zip(free, at_bound, strict=True)
        if yes
    ]
    if np.all(np.isfinite(triangle)):
        _, singular, rows = np.linalg.svd(triangle)
        for value, row in zip(singular, rows, strict=True):
            mixed = [free[i] for i in np.flatnonzero(np.abs(row) > 0.35)]
            if value < np.sqrt(reduced) / _DETERMINED_SHARE and len(mixed) > 1:
                sentences.append(f"only a combination is determined of {', '.join(mixed)}")
    return tuple(sentences)


def station_pressure(sky: Sky) -> tuple[float, str]:
    """The pressure at the station, Pa, by the file or by its altitude, and a note where it is assumed."""
    if np.isfinite(sky.pressure_pa):
        return sky.pressure_pa, ""
    if np.isfinite(sky.altitude_m):
        return float(pressure_at_altitude(sky.altitude_m)), ""
    return SEA_LEVEL_PRESSURE, "no pressure or altitude in the file: Rayleigh depth of sea level"


def _line_shape(sky: Sky, notes: list) -> float:
    if np.isfinite(sky.fwhm_nm):
        return sky.fwhm_nm
    width = estimate_fwhm(sky)
    if np.isfinite(width):
        notes.append(f"line shape estimated from the solar lines: {width:g} nm FWHM")
    else:
        notes.append("no line shape in the file and too few wavelengths to estimate it: none applied")
    return width


def _usable(sky: Sky, notes: list) -> np.ndarray:
    """The sky's mask without what the model cannot explain, counted in the notes."""
    wavelength = sky.wavelength_nm
    outside = (wavelength < _SPECTRUM_NM[0]) | (wavelength > _SPECTRUM_NM[1])
    bands = np.zeros_like(outside)
    for low, high in GAS_BANDS_NM:
        bands |= (wavelength >= low) & (wavelength <= high)
    for where, reason in ((outside, "beyond 300-1100 nm"), (bands & ~outside, "in gas bands")):
        count = int(sky.usable[..., where].sum())
        if count:
            notes.append(f"{count} samples {reason} left out")
    return sky.usable & ~(outside | bands)


def _chosen_wavelengths(used: np.ndarray) -> np.ndarray:
    """Indices of the wavelengths that are fitted: all that hold samples, or an even choice of many."""
    candidates = np.flatnonzero(used.any(axis=(0, 1)))
    if candidates.size <= _MOST_WAVELENGTHS:
        return candidates
    return candidates[np.linspace(0, candidates.size - 1, _MOST_WAVELENGTHS).round().astype(int)]


def _sigma(sky: Sky, used: np.ndarray) -> np.ndarray:
    if sky.sigma is not None:
        return np.where(used, sky.sigma, 1.0)
    floor = _FLOOR_NOISE * np.median(sky.radiance[used])
    return np.where(used, np.hypot(_RELATIVE_NOISE * sky.radiance, floor), 1.0)
