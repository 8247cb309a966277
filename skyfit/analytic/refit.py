"""Preetham's coefficients refitted against simulated skies."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..atmosphere import Atmosphere, Tabulated
from ..light import xyY_from_xyz, xyz, xyz_from_xyY
from ..numerics import as_float, check_range
from ..numerics.least_squares import result_name
from ..scene import angle_between, Directions, hemisphere, Scene
from ..transport import AbstractSolver, DoubleScattering, OrdersOfScattering
from ..transport.contract import FLAT_SUNS
from .analytic import AbstractAnalyticSky
from .extended import ExtendedPreetham, SUN_ZENITH_RANGE_DEG, TURBIDITY_RANGE
from .joint import EXTENDED, fit_joint, LINEAR, UNIT
from .perez import Perez
from .perez_fits import CLEAR_SKY, fit_perez
from .preetham import Preetham


Form = Literal["linear", "extended"]
# Twelve suns and five turbidities, as in Preetham 1999, sec. 3.2; the paper does not say which suns
SUN_ZENITH_DEG = tuple(np.linspace(0.0, 82.5, 12).tolist())
TURBIDITY = (2.0, 3.0, 4.0, 5.0, 6.0)
# The grid of the extended form, to twilight and from pure air, denser where the sky changes faster
EXTENDED_SUN_ZENITH_DEG = (
    0.0, 10.0, 20.0, 30.0, 38.0, 46.0, 53.0, 60.0, 65.0, 70.0, 74.0, 77.0, 80.0, 82.0, 84.0, 85.5, 87.0, 88.0, 89.0,
    90.0, 91.0, 92.0,
)  # fmt: skip
EXTENDED_TURBIDITY = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.5, 8.0, 10.0)
WAVELENGTH_NM = tuple(np.arange(380.0, 781.0, 10.0).tolist())
# Largest view zenith angle of the fit; errors are stated for views to 80 degrees and suns to 85 degrees
_FITTED_ZENITH = np.radians(85.0)
_STATED_ZENITH = np.radians(80.0)
_STATED_SUN = np.radians(85.0)
_SMALLEST_SUNS, _SMALLEST_TURBIDITIES = 4, 3
# Initial A-E for the fits of a sky's chromaticities: Preetham 1999, A.2 near T = 3
_COLOUR_OF_SKY = (-0.3, -0.2, 0.2, -1.1, 0.03)


class Errors(NamedTuple):
    """Errors of one model over skies and directions: median and 95th percentile of the relative luminance error, and
    median distance in chromaticity (x, y)."""

    luminance: float
    luminance_95: float
    chromaticity: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """Comparison of analytic models with simulated skies; host-side arrays.

    `simulated` is XYZ in cd m^-2 `[sky, direction, 3]`. The models are "published", "refitted" and "best five" (the
    Perez formula fitted to each sky alone, the best it can do). For each model and sky, over directions to view zenith
    80 degrees, `luminance_error` and `luminance_95` `[sky]` hold the median and 95th percentile of the relative error,
    and `chromaticity_error` the median distance of (x, y); NaN where a model is not valid. `overall` holds the errors
    over all those directions and all skies with the sun to 85 degrees, `rest` those of all other directions and skies.
    """

    sun_zenith: np.ndarray
    turbidity: np.ndarray
    simulated: np.ndarray
    luminance_error: dict[str, np.ndarray]
    luminance_95: dict[str, np.ndarray]
    chromaticity_error: dict[str, np.ndarray]
    overall: dict[str, Errors]
    rest: dict[str, Errors]


@dataclass(frozen=True, eq=False)
class Refit:
    """Refitted and published coefficients, and the errors of both.

    `fitted` compares them on the skies of the fit, `held_out` on random other skies of the same range. `view`, the
    directions of both, ends with the zenith. `result` tells how the joint fits of Y, x and y ended.
    """

    refitted: Preetham | ExtendedPreetham
    published: Preetham
    view: Directions
    fitted: Comparison
    held_out: Comparison
    result: dict[str, str]


def preetham_atmosphere(turbidity) -> Atmosphere:
    """Haze with Bullrich's phase function, as in the paper's simulations, with skyfit's default air and ozone."""
    return Atmosphere.from_turbidity(turbidity, phase=Tabulated.bullrich())


def refit(
    solver: AbstractSolver | None = None,
    atmosphere: Callable | None = None,
    sun_zenith_deg=None,
    turbidity=None,
    directions: int = 343,
    form: Form = "linear",
    flat_below_deg: float | None = None,
    held_out: int = 60,
    progress: Callable[[int, int], None] | None = None,
) -> Refit:
    """Refit Preetham's coefficients to simulated skies and compare them with the published ones.

    It simulates each sky, fits five Perez parameters to it, then fits all coefficients to all skies.

    **Arguments:** `solver`, default `OrdersOfScattering.normal()`; `atmosphere(turbidity)`, traced; the suns
    (degrees) and turbidities, all combinations; `directions` over the sky; `form`: "linear" in turbidity as published
    (`Preetham`), or "extended" (`ExtendedPreetham`); `flat_below_deg`: if given, the solver's flat geometry is used if
    view and sun are both closer to the zenith than this, as the paper did with 70; `held_out`, the number of random
    (seeded) test skies in the range; `progress(done, of)`, called after each stage. By default suns, turbidities and
    atmosphere are those of the paper for "linear" (Bullrich's haze), and for "extended" the range of
    `ExtendedPreetham` in `Atmosphere.from_turbidity`.
    **Returns:** `Refit`. **Valid:** sun zenith below 90 degrees; "extended": to 92.
    **Errors:** `ValueError` if there are too few suns or turbidities, if they are out of range, if the solver cannot
    simulate these suns, or if a simulated sky has no light.
    **Source:** Preetham 1999, sec. 3.2 and A.2; the relative error is what is minimised.

    **Example:**

        >>> found = skyfit.refit(
        ...     skyfit.SingleScattering.draft("flat"),
        ...     sun_zenith_deg=np.array([20.0, 40.0, 60.0, 75.0]),
        ...     turbidity=np.array([2.0, 4.0, 6.0]),
        ...     directions=40,
        ...     held_out=4,
        ... )
        >>> sorted(set(found.result.values()))
        ['successful']
        >>> found.fitted.overall["refitted"].luminance < found.fitted.overall["published"].luminance
        True
    """
    shape = {"linear": LINEAR, "extended": EXTENDED}.get(form)
    if shape is None:
        raise ValueError(f'`form` must be "linear" or "extended", got {form!r}')
    linear = form == "linear"
    suns = _grid(sun_zenith_deg, SUN_ZENITH_DEG if linear else EXTENDED_SUN_ZENITH_DEG)
    hazes = _grid(turbidity, TURBIDITY if linear else EXTENDED_TURBIDITY)
    _check_grids(suns, hazes, linear)
    solver = OrdersOfScattering.normal() if solver is None else solver
    _check_solver(solver, float(suns.max()))
    check_range("flat_below_deg", flat_below_deg, 0.0, FLAT_SUNS.largest_deg, "degrees")
    if held_out < 1:
        raise ValueError(f"`held_out` must be at least 1, got {held_out}")
    atmosphere = atmosphere or (preetham_atmosphere if linear else Atmosphere.from_turbidity)
    flat = None if flat_below_deg is None else dataclasses.replace(solver, geometry="flat")
    limit = as_float(0.0 if flat_below_deg is None else np.radians(flat_below_deg))
    report = progress or (lambda done, of: None)
    stages = 7
    dome = hemisphere(directions)
    view = Directions(np.append(dome.zenith, 0.0), np.append(dome.azimuth, 0.0))
    weight = as_float((np.asarray(view.zenith) <= _FITTED_ZENITH).astype(float))

    def simulated(sun, haze):
        skies = _simulate(solver, flat, atmosphere, view, limit, as_float(sun), as_float(haze))
        _check_lit(np.asarray(skies), solver, sun, haze)
        return _Simulated.of(skies, view, sun, haze, weight)

    sun, haze = (grid.ravel() for grid in np.meshgrid(np.radians(suns), hazes, indexing="ij"))
    skies = simulated(sun, haze)
    report(1, stages)
    best = _best_five(skies)
    report(2, stages)
    published = Preetham.published()
    model, results = shape.first(published), {}
    ends = float(hazes.min()), float(hazes.max())
    highest_sun, lowest_sun = (float(np.radians(angle)) for angle in (suns.min(), suns.max()))
    if linear:
        model = dataclasses.replace(model, lowest_turbidity=ends[0], fitted_turbidity=ends, lowest_sun=lowest_sun)
    else:
        model = dataclasses.replace(model, fitted_turbidity=ends, fitted_sun=(highest_sun, lowest_sun))
    for q, name in enumerate("Yxy"):
        solution = fit_joint(shape, q, shape.start(q, skies.target[q], sun, haze), skies.joint(q))
        model = shape.put(model, q, solution.value)
        results[name] = result_name(solution.result)
        report(3 + q, stages)
    random = np.random.default_rng(0)
    other_sun = np.radians(random.uniform(suns.min(), suns.max(), held_out))
    other_haze = random.uniform(hazes.min(), hazes.max(), held_out)
    others = simulated(other_sun, other_haze)
    report(6, stages)
    models = {"published": published, "refitted": model}
    fitted = _compare(skies, sun, haze, models, best)
    tested = _compare(others, other_sun, other_haze, models, _best_five(others))
    report(stages, stages)
    return Refit(model, published, view, fitted, tested, results)


def model_xyz(model: AbstractAnalyticSky, view: Directions, skies: Comparison) -> np.ndarray:
    """XYZ (cd m^-2) of an analytic model for the skies of a comparison, `[sky, direction, 3]`."""
    sun = as_float(skies.sun_zenith)
    gamma = angle_between(view.zenith[None], sun[:, None], view.azimuth[None])
    luminance, x, y = _evaluate(model, view.zenith, gamma, sun, as_float(skies.turbidity))
    return np.asarray(xyz_from_xyY(jnp.stack([x, y, luminance], axis=-1)))


def _grid(given, usual):
    return np.asarray(usual if given is None else given, float)


def _check_grids(suns, hazes, linear: bool) -> None:
    highest = 90.0 if linear else SUN_ZENITH_RANGE_DEG[1]
    inside = np.all((suns >= 0.0) & (suns < highest if linear else suns <= highest))
    if np.unique(suns).size < _SMALLEST_SUNS or not inside:
        end = ")" if linear else "]"
        raise ValueError(
            f"`sun_zenith_deg` must hold at least four different angles in [0, {highest:g}{end}, got {suns.tolist()}"
        )
    most = np.inf if linear else TURBIDITY_RANGE[1]
    if np.unique(hazes).size < _SMALLEST_TURBIDITIES or not np.all((hazes >= 1.0) & (hazes <= most)):
        above = "" if linear else f" and <= {most:g}"
        raise ValueError(f"`turbidity` must hold at least three different values >= 1{above}, got {hazes.tolist()}")


def _check_solver(solver: AbstractSolver, lowest_deg: float) -> None:
    """Raise `ValueError` unless the solver's range covers all suns of a fit."""
    known = solver.suns.largest_deg
    # Solvers with streams on a sphere work into twilight
    if solver.geometry == "spherical" and isinstance(solver, OrdersOfScattering | DoubleScattering):
        known = max(known, SUN_ZENITH_RANGE_DEG[1])
    if lowest_deg > known:
        raise ValueError(
            f"`solver` must know the suns of the fit, to {lowest_deg:g} degrees from the zenith: "
            f"{type(solver).__name__} in {solver.geometry} geometry knows them to {known:g}"
        )


def _check_lit(skies: np.ndarray, solver: AbstractSolver, sun: np.ndarray, turbidity: np.ndarray) -> None:
    """Raise `ValueError` before the fits if a simulated sky has light that is not positive and finite everywhere."""
    bad = ~np.all(np.isfinite(skies) & (skies > 0.0), axis=(1, 2))
    if bad.any():
        raise ValueError(
            f"`solver` must give light in all directions, got none or no number by {type(solver).__name__} under a sun "
            f"at {np.degrees(sun[bad][0]):.4g} degrees and turbidity {turbidity[bad][0]:g}"
        )


@eqx.filter_jit
def _simulate(solver, flat, atmosphere, view, limit, sun, turbidity):
    """XYZ of each sky, `[sky, direction, 3]`: skies one after another, all wavelengths of a sky at once."""

    def sky(case):
        sun_zenith, haze = case
        scene = Scene.from_degrees(0.0, view, np.array(WAVELENGTH_NM))
        scene = eqx.tree_at(lambda s: s.sun_zenith, scene, sun_zenith)
        air = atmosphere(haze)
        seen = xyz(solver.radiance(air, scene), np.array(WAVELENGTH_NM))
        if flat is None:
            return seen
        steep = (view.zenith < limit) & (sun_zenith < limit)
        return jnp.where(steep[:, None], xyz(flat.radiance(air, scene), np.array(WAVELENGTH_NM)), seen)

    return jax.lax.map(sky, (sun, turbidity))


class _Simulated(NamedTuple):
    """Simulated skies in the form the fits need; `target` is luminance, x and y."""

    xyz: np.ndarray
    target: Float[Array, "quantity sky direction"]
    zenith: Float[Array, " direction"]
    gamma: Float[Array, "sky direction"]
    sun: Float[Array, " sky"]
    turbidity: Float[Array, " sky"]
    weight: Float[Array, " direction"]

    @classmethod
    def of(cls, skies, view: Directions, sun, turbidity, weight) -> "_Simulated":
        sun = as_float(sun)
        x, y, luminance = jnp.moveaxis(xyY_from_xyz(skies), -1, 0)
        target = jnp.stack([luminance, x, y])
        gamma = angle_between(view.zenith[None], sun[:, None], view.azimuth[None])
        return cls(np.asarray(skies), target, view.zenith, gamma, sun, as_float(turbidity), weight)

    def joint(self, q: int):
        return self.target[q], self.gamma, self.zenith, self.sun, self.turbidity, self.weight


def _best_five(skies: _Simulated) -> list:
    """A-E of Y, x and y fitted to each sky alone, `[sky, 5]` each."""
    found = []
    for q, target in enumerate(skies.target):
        start = CLEAR_SKY if q == 0 else _COLOUR_OF_SKY
        fits = fit_perez(
            target, target[:, -1], skies.zenith, skies.gamma, skies.sun, skies.weight / UNIT[q], start=start
        )
        found.append(fits.coefficients)
    return found


@eqx.filter_jit
def _evaluate(model: AbstractAnalyticSky, zenith, gamma, sun, turbidity):
    """Luminance, x and y of an analytic model for every sky, `[quantity, sky, direction]`."""
    one = jax.vmap(lambda t, s, g: jnp.stack(model.luminance_chromaticity(t, s, zenith, g)))
    return jnp.moveaxis(one(turbidity, sun, gamma), 1, 0)


@eqx.filter_jit
def _evaluate_each(best, skies: _Simulated):
    def one(coefficients, at_zenith, angle, theta_sun):
        return at_zenith * Perez.from_coefficients(coefficients).ratio(skies.zenith, angle, theta_sun)

    each = jax.vmap(one)
    return jnp.stack([each(b, t[:, -1], skies.gamma, skies.sun) for b, t in zip(best, skies.target, strict=True)])


def _compare(skies: _Simulated, sun, turbidity, models: dict[str, AbstractAnalyticSky], best) -> Comparison:
    target = np.asarray(skies.target)
    answers = {}
    for name, model in models.items():
        light = np.array(_evaluate(model, skies.zenith, skies.gamma, skies.sun, skies.turbidity))
        light[:, ~np.asarray(jax.vmap(model.valid)(skies.turbidity, skies.sun))] = np.nan
        answers[name] = light
    answers["best five"] = np.asarray(_evaluate_each(best, skies))
    low = np.asarray(skies.zenith) <= _STATED_ZENITH
    stated = low[None] & (sun <= _STATED_SUN)[:, None]
    luminance = {n: np.abs(a[0] / target[0] - 1.0) for n, a in answers.items()}
    chromaticity = {n: np.hypot(a[1] - target[1], a[2] - target[2]) for n, a in answers.items()}

    def pooled(where):
        return {n: _pooled(luminance[n][where], chromaticity[n][where]) for n in answers}

    return Comparison(
        sun, turbidity, skies.xyz,
        {n: np.median(e[:, low], axis=1) for n, e in luminance.items()},
        {n: np.percentile(e[:, low], 95.0, axis=1) for n, e in luminance.items()},
        {n: np.median(e[:, low], axis=1) for n, e in chromaticity.items()},
        pooled(stated), pooled(~stated),
    )  # fmt: skip


def _pooled(luminance, chromaticity) -> Errors:
    known = np.isfinite(luminance)
    if not known.any():
        return Errors(np.nan, np.nan, np.nan)
    values = luminance[known]
    return Errors(float(np.median(values)), float(np.percentile(values, 95.0)), float(np.median(chromaticity[known])))
