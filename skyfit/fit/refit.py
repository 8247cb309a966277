"""Preetham's coefficients refitted against simulated skies."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..atmosphere import Atmosphere, Tabulated
from ..light import xyz, xyz_from_xyY
from ..scene import angle_between, as_float, Directions, hemisphere, Scene
from ..sky import Perez, Preetham
from ..transport import AbstractSolver, OrdersOfScattering
from .solve import least_squares, LOGISTIC_LIMIT, result_name


# twelve suns and five turbidities, as in Preetham 1999, sec. 3.2; he does not say which suns
SUN_ZENITH_DEG = tuple(np.linspace(0.0, 82.5, 12).tolist())
TURBIDITY = (2.0, 3.0, 4.0, 5.0, 6.0)
WAVELENGTH_NM = tuple(np.arange(380.0, 781.0, 10.0).tolist())
# the fit sees directions to here, the error is stated to 80 degrees
_FITTED_ZENITH = np.radians(85.0)
_STATED_ZENITH = np.radians(80.0)
# residuals are relative errors in these units: 5 % of luminance, 1 % of chromaticity
_UNIT = (0.05, 0.01, 0.01)
# bounds of A, B, C, D, E for luminance and for chromaticity: without them a circumsolar term that is wide and
# huge stands for a constant, and extrapolates wildly
_LOWER = ((-1.5, -6.0, 0.0, -12.0, -1.0), (-0.9, -6.0, -1.0, -6.0, -0.5), (-0.9, -6.0, -1.0, -6.0, -0.5))
_UPPER = ((5.0, -0.01, 60.0, -0.5, 5.0), (1.0, -0.01, 2.0, -0.2, 0.5), (1.0, -0.01, 2.0, -0.2, 0.5))
# where a fit of one sky starts, darker and brighter horizon (Preetham 1999, A.2 near T = 3 and T = 6)
_FIRST = (
    ((-1.0, -0.6, 5.0, -2.2, 0.2), (-0.3, -0.2, 0.2, -1.1, 0.03), (-0.3, -0.25, 0.2, -1.8, 0.02)),
    ((-0.4, -1.7, 5.2, -1.9, 0.2), (0.1, -0.4, 0.2, -1.3, 0.03), (0.1, -0.5, 0.2, -1.9, 0.02)),
)


@dataclass(frozen=True, eq=False)
class Refit:
    """Refitted coefficients beside the published ones, and what each is worth; host-side arrays.

    `simulated` is XYZ in cd m^-2 `[sky, direction, 3]` on `view`, whose last direction is the zenith.
    `luminance_error` holds for "published", "refitted" and "best five" the median relative error of each sky
    over directions to view zenith 80 degrees `[sky]`, `chromaticity_error` that of (x, y) as a distance;
    `overall` the medians over all skies and directions. "best five" is the Perez formula fitted to one sky.
    """

    refitted: Preetham
    published: Preetham
    sun_zenith: np.ndarray
    turbidity: np.ndarray
    view: Directions
    simulated: np.ndarray
    luminance_error: dict[str, np.ndarray]
    chromaticity_error: dict[str, np.ndarray]
    overall: dict[str, tuple[float, float]]
    result: dict[str, str]


def preetham_atmosphere(turbidity) -> Atmosphere:
    """Haze with Bullrich's phase function, as the paper simulated, in skyfit's default air and ozone."""
    return Atmosphere.from_turbidity(turbidity, phase=Tabulated.bullrich())


def refit(
    solver: AbstractSolver | None = None,
    atmosphere: Callable = preetham_atmosphere,
    sun_zenith_deg=SUN_ZENITH_DEG,
    turbidity=TURBIDITY,
    directions: int = 343,
    progress: Callable[[int, int], None] | None = None,
) -> Refit:
    """Coefficients of Preetham's model for skies simulated here, beside the published ones.

    **Arguments:** `solver`, default `OrdersOfScattering.normal()`; `atmosphere(turbidity)`, traced; the suns
    (degrees) and turbidities, all combinations; `directions` over the sky; `progress(done, of)` by stages.
    **Returns:** `Refit`. **Valid:** sun zenith to 85 degrees.
    **Errors:** `ValueError` for fewer than four suns above the horizon or fewer than three turbidities >= 1.
    **Source:** Preetham 1999, sec. 3.2 and A.2; the relative error is what is minimised.
    """
    suns, hazes = np.asarray(sun_zenith_deg, float), np.asarray(turbidity, float)
    if np.unique(suns).size < 4 or not np.all((suns >= 0.0) & (suns < 90.0)):
        raise ValueError(f"`sun_zenith_deg` must hold at least four different angles in [0, 90), got {suns.tolist()}")
    if np.unique(hazes).size < 3 or not np.all(hazes >= 1.0):
        raise ValueError(f"`turbidity` must hold at least three different values >= 1, got {hazes.tolist()}")
    solver = OrdersOfScattering.normal() if solver is None else solver
    report = progress or (lambda done, of: None)
    sun, haze = (grid.ravel() for grid in np.meshgrid(np.radians(suns), hazes, indexing="ij"))
    dome = hemisphere(directions)
    view = Directions(np.append(dome.zenith, 0.0), np.append(dome.azimuth, 0.0))
    stages = 3 + len(_UNIT)
    simulated = _simulate(solver, atmosphere, view, as_float(sun), as_float(haze))
    report(1, stages)
    target = jnp.stack([*_luminance_chromaticity(simulated)])
    gamma = angle_between(view.zenith[None], as_float(sun)[:, None], view.azimuth[None])
    weight = as_float((np.asarray(view.zenith) <= _FITTED_ZENITH).astype(float))
    published = Preetham.published()
    forms = [_Form.of(quantity) for quantity in range(3)]
    starts = as_float(_FIRST)
    best = jnp.stack(
        [
            _fit_each(form, starts[:, q], target[q], gamma, view.zenith, as_float(sun), weight)
            for q, form in enumerate(forms)
        ]
    )
    report(2, stages)
    refitted, results = published, {}
    for q, (name, form) in enumerate(zip("Yxy", forms, strict=True)):
        zenith = published.zenith_luminance if q == 0 else published.zenith_chromaticity[q - 1]
        start = _start(form, np.asarray(best[q]), haze, zenith)
        arguments = (
            jnp.asarray(q), published, target[q], gamma, view.zenith, as_float(sun), as_float(haze), weight,
        )  # fmt: skip
        solution = _fit_joint(form, start, arguments)
        refitted = _with_quantity(refitted, q, solution.value)
        results[name] = result_name(solution.result)
        report(3 + q, stages)
    models = {
        "published": _evaluate(published, view.zenith, gamma, as_float(sun), as_float(haze)),
        "refitted": _evaluate(refitted, view.zenith, gamma, as_float(sun), as_float(haze)),
        "best five": _evaluate_each(best, target, view.zenith, gamma, as_float(sun)),
    }
    stated = np.asarray(view.zenith) <= _STATED_ZENITH
    errors = {n: _errors(np.asarray(m), np.asarray(target)) for n, m in models.items()}
    report(stages, stages)
    return Refit(
        refitted=refitted, published=published, sun_zenith=sun, turbidity=haze, view=view,
        simulated=np.asarray(simulated), result=results,
        luminance_error={n: np.median(e[0][:, stated], axis=1) for n, e in errors.items()},
        chromaticity_error={n: np.median(e[1][:, stated], axis=1) for n, e in errors.items()},
        overall={
            n: (float(np.median(e[0][:, stated])), float(np.median(e[1][:, stated]))) for n, e in errors.items()
        },
    )  # fmt: skip


def model_xyz(model: Preetham, refitted: Refit) -> np.ndarray:
    """XYZ (cd m^-2) of an analytic model in the skies and directions of a refit, `[sky, direction, 3]`."""
    view, sun = refitted.view, as_float(refitted.sun_zenith)
    gamma = angle_between(view.zenith[None], sun[:, None], view.azimuth[None])
    luminance, x, y = _evaluate(model, view.zenith, gamma, sun, as_float(refitted.turbidity))
    return np.asarray(xyz_from_xyY(jnp.stack([x, y, luminance], axis=-1)))


@eqx.filter_jit
def _simulate(solver, atmosphere, view, sun, turbidity):
    """XYZ of each sky, one after another, all wavelengths of a sky at once, `[sky, direction, 3]`."""

    def sky(case):
        sun_zenith, haze = case
        scene = Scene.from_degrees(0.0, view, np.array(WAVELENGTH_NM))
        scene = eqx.tree_at(lambda s: s.sun_zenith, scene, sun_zenith)
        return xyz(solver.radiance(atmosphere(haze), scene), np.array(WAVELENGTH_NM))

    return jax.lax.map(sky, (sun, turbidity))


def _luminance_chromaticity(tristimulus):
    total = jnp.sum(tristimulus, axis=-1)
    return tristimulus[..., 1], tristimulus[..., 0] / total, tristimulus[..., 1] / total


class _Form(NamedTuple):
    """What distinguishes the fits of Y, x and y: the bounds of A-E and the unit of the residual."""

    lower: Float[Array, " parameter"]
    upper: Float[Array, " parameter"]
    unit: Float[Array, ""]

    @classmethod
    def of(cls, quantity: int) -> "_Form":
        return cls(as_float(_LOWER[quantity]), as_float(_UPPER[quantity]), as_float(_UNIT[quantity]))

    def bound(self, free):
        return self.lower + (self.upper - self.lower) * jax.nn.sigmoid(free)

    def unbound(self, value):
        share = jnp.clip((as_float(value) - self.lower) / (self.upper - self.lower), 0.01, 0.99)
        return jnp.log(share / (1.0 - share))


@eqx.filter_jit
def _fit_each(form: _Form, starts, target, gamma, zenith, sun, weight):
    """Five Perez parameters of one quantity for each sky, `[sky, 5]`, the best of several starts."""

    def one(case):
        values, angle, theta_sun, first = case

        def residual(coefficients, _):
            ratio = Perez.from_coefficients(coefficients).ratio(zenith, angle, theta_sun)
            return weight * (values[-1] * ratio / values - 1.0) / form.unit

        limit = jnp.full_like(first, LOGISTIC_LIMIT)
        solution = least_squares(residual, form.bound, first, None, limit, 200)
        return solution.value, jnp.sum(solution.residual**2)

    skies, count = sun.shape[0], starts.shape[0]
    cases = (
        jnp.tile(target, (count, 1)),
        jnp.tile(gamma, (count, 1)),
        jnp.tile(sun, count),
        jnp.repeat(jax.vmap(form.unbound)(starts), skies, axis=0),
    )
    value, cost = jax.lax.map(one, cases)
    value, cost = value.reshape(count, skies, 5), cost.reshape(count, skies)
    chosen = jnp.argmin(jnp.where(jnp.isfinite(cost), cost, jnp.inf), axis=0)
    return jnp.take_along_axis(value, chosen[None, :, None], axis=0)[0]


def _start(form: _Form, best, turbidity, zenith):
    """The start of the joint fit: a line in turbidity through each parameter, published zenith values."""
    # the median over suns at each turbidity, so that a few wild skies do not tilt the line
    levels = np.unique(turbidity)
    middle = np.stack([np.median(best[turbidity == t], axis=0) for t in levels])
    lines = np.polyfit(levels, middle, 1)
    ends = [form.unbound(np.polyval(lines, t)) for t in (levels[0], levels[-1])]
    return jnp.concatenate([*ends, jnp.ravel(zenith)])


def _linear_coefficients(form: _Form, free, ends):
    """Slope and constant of each Perez parameter, bounded at both ends of the turbidities, then the zenith."""
    low, high = form.bound(free[:5]), form.bound(free[5:10])
    slope = (high - low) / (ends[1] - ends[0])
    distribution = jnp.stack([slope, low - slope * ends[0]], axis=1)
    return jnp.concatenate([distribution.ravel(), free[10:]])


def _with_quantity(model: Preetham, quantity, coefficients) -> Preetham:
    """The model with the ten distribution and all zenith coefficients of Y (0), x (1) or y (2) replaced."""
    distribution = model.distribution.at[quantity].set(coefficients[:10].reshape(5, 2))
    model = eqx.tree_at(lambda m: m.distribution, model, distribution)
    zenith = coefficients[10:]
    if zenith.size == model.zenith_luminance.size:
        return eqx.tree_at(lambda m: m.zenith_luminance, model, zenith.reshape(3, 2))
    chromaticity = model.zenith_chromaticity.at[quantity - 1].set(zenith.reshape(3, 4))
    return eqx.tree_at(lambda m: m.zenith_chromaticity, model, chromaticity)


@eqx.filter_jit
def _fit_joint(form: _Form, start, arguments):
    """All coefficients of one quantity against all skies at once."""

    def residual(coefficients, arguments):
        quantity, model, target, gamma, zenith, sun, turbidity, weight = arguments
        model = _with_quantity(model, quantity, coefficients)
        value = _evaluate(model, zenith, gamma, sun, turbidity)[quantity]
        return (weight[None] * (value / target - 1.0) / form.unit).ravel()

    turbidity = arguments[6]
    ends = jnp.min(turbidity), jnp.max(turbidity)
    limit = jnp.where(jnp.arange(start.size) < 10, LOGISTIC_LIMIT, jnp.inf).astype(start.dtype)
    return least_squares(residual, lambda free: _linear_coefficients(form, free, ends), start, arguments, limit, 200)


@eqx.filter_jit
def _evaluate(model: Preetham, zenith, gamma, sun, turbidity):
    """Luminance, x and y of an analytic model in every sky, `[quantity, sky, direction]`."""
    one = jax.vmap(lambda t, s, g: jnp.stack(model.luminance_chromaticity(t, s, zenith, g)))
    return jnp.moveaxis(one(turbidity, sun, gamma), 1, 0)


@eqx.filter_jit
def _evaluate_each(best, target, zenith, gamma, sun):
    def one(coefficients, at_zenith, angle, theta_sun):
        return at_zenith * Perez.from_coefficients(coefficients).ratio(zenith, angle, theta_sun)

    return jax.vmap(lambda b, t: jax.vmap(one)(b, t[:, -1], gamma, sun))(best, target)


def _errors(model, target):
    """Relative luminance error and distance in chromaticity, `[sky, direction]` each."""
    return np.abs(model[0] / target[0] - 1.0), np.hypot(model[1] - target[1], model[2] - target[2])
