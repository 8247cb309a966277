"""The information of a sky on its parameters: derivatives, Fisher information, the best directions to measure."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float, Int

from ..atmosphere import Atmosphere
from ..numerics import as_float
from ..scene import Scene
from ..transport import AbstractSolver, OrdersOfScattering
from .forward import simulate
from .model import SkyModel
from .parameters import check_free, Parameter, PARAMETERS, with_values


# default relative noise, the same as in `invert`
_RELATIVE_NOISE = 0.02
# share of the information of all directions together that stands in for a missing prior, in the choice only
_WEAK = 1e-6
# distance from a bound, as a share of a parameter's range; more than the rounding of float32
_HAIR = 1e-6
# prior sigma of each parameter
Prior = Float[ArrayLike, " parameter"] | Sequence[float] | None


def sensitivity(
    scene: Scene,
    atmosphere: Atmosphere | SkyModel,
    quantity: str | Sequence[str],
    solver: AbstractSolver | None = None,
) -> Float[Array, "*parameter direction wavelength"]:
    r"""The derivative of the radiance of each direction and wavelength by a parameter, $\partial L / \partial p$.

    **Arguments:** `scene`; `atmosphere`, or a `SkyModel` that also holds the instrument's pointing (default 0);
    `quantity`, a name of `skyfit.PARAMETERS` or several; `solver`, default `OrdersOfScattering.normal()`.
    **Returns:** W m^-2 sr^-1 nm^-1 per the parameter's stated unit, `[direction, wavelength]`; for several names
    `[parameter, direction, wavelength]`.
    **Valid:** wherever the solver is; 0 below the horizon. For a parameter at its bound, an albedo of 1 for instance,
    it is the slope towards the inside. A ground albedo that is given per wavelength moves as a whole.
    **Errors:** `ValueError` for names that are unknown, repeated, contradictory or not in this atmosphere.
    **Source:** forward-mode differentiation of `solver.radiance`.
    """
    model = _model(atmosphere)
    names = _names(quantity, "quantity", model)
    jacobian, _ = _linearised(_solver(solver), names, model, scene)
    return jacobian[..., 0] if isinstance(quantity, str) else jnp.moveaxis(jacobian, -1, 0)


def fisher_information(
    scene: Scene,
    atmosphere: Atmosphere | SkyModel,
    free: Sequence[str],
    relative: float | Float[ArrayLike, ""] = _RELATIVE_NOISE,
    floor: float | Float[ArrayLike, "..."] = 0.0,
    solver: AbstractSolver | None = None,
) -> Float[Array, "direction parameter parameter"]:
    r"""The Fisher information on the free parameters from a measurement of each direction at all its wavelengths.

    $F_d = \sum_\lambda \frac{1}{\sigma^2} \frac{\partial L}{\partial p} \frac{\partial L}{\partial p}^T, \quad
    \sigma^2 = (r L)^2 + s^2$

    The information of a set of directions is the sum over the directions.

    **Arguments:** `scene`, `atmosphere`, `solver` as in `sensitivity`; `free`, the parameters that are fitted;
    `relative` noise r; `floor` s in W m^-2 sr^-1 nm^-1, one number or an array that broadcasts to `[direction,
    wavelength]`. To state sigma itself, use `relative=0, floor=sigma`.
    **Returns:** the inverse of squared units, `[direction, parameter, parameter]`.
    **Valid:** noise independent in each sample. A sample with neither light nor floor has no information. The
    information that the size of the noise holds on the parameters, a share of 2 r^2, is left out.
    **Errors:** `ValueError` for bad names, or noise that is negative or 0 altogether.
    **Source:** Fisher information of Gaussian noise; Rodgers 2000, Inverse Methods for Atmospheric Sounding, sec. 2.4.
    """
    model = _model(atmosphere)
    names = _names(free, "free", model)
    noise = [value for value in (relative, floor) if not isinstance(value, Tracer)]
    if not all(np.all(np.asarray(value) >= 0.0) for value in noise):
        raise ValueError(f"`relative` and `floor` must be >= 0, got {relative} and {floor}")
    if len(noise) == 2 and not any(np.any(np.asarray(value) > 0.0) for value in noise):
        raise ValueError("`relative` and `floor` must not both be 0: without noise nothing is left open")
    return _information(_solver(solver), names, model, scene, as_float(relative), as_float(floor))


def posterior_covariance(
    information: Float[ArrayLike, "parameter parameter"], prior: Prior = None
) -> Float[Array, "parameter parameter"]:
    r"""The covariance after measurements of this information, $(F + \mathrm{diag}(1/s^2))^{-1}$.

    **Arguments:** `information` of a set, the sum over its directions of `fisher_information`; `prior`, the prior sigma
    s of each parameter, inf where there is none; None: no prior for any.
    **Returns:** squared units, `[parameter, parameter]`; differentiable by `information`.
    **Valid:** always. A parameter that is part of an undetermined combination has infinite variance and no stated
    covariance (0). The other parameters are as if such combinations were held.
    **Errors:** `ValueError` for a prior that is not positive or of another length.
    **Source:** Rodgers 2000, Inverse Methods for Atmospheric Sounding, eq. 2.27.
    """
    return _inverse(as_float(information), as_float(_precision(prior, np.shape(information)[-1])))


class NextDirections(NamedTuple):
    """Directions in the order in which to measure them, and the sigmas after each.

    `order`: indices of directions, `[choice]`. `sigma`: that of every free parameter after each choice, in its unit,
    inf where the measurements so far do not determine it, `[choice, parameter]`.
    """

    order: Int[np.ndarray, " choice"]
    sigma: Float[np.ndarray, "choice parameter"]


def next_directions(
    information: Float[ArrayLike, "direction parameter parameter"],
    free: Sequence[str],
    count: int = 1,
    interest: str | Sequence[str] | None = None,
    measured: Int[ArrayLike, " choice"] | Sequence[int] = (),
    prior: Prior = None,
) -> NextDirections:
    r"""Choose the directions to measure next, one by one, each the one that reduces the uncertainty most.

    With `interest`, the uncertainty is the sum of the variances of the named parameters, each over its variance after
    all directions together (A-optimal). Without, it is the determinant of the whole covariance (D-optimal).

    **Arguments:** `information`, of all directions that may be chosen (`fisher_information`); `free`, the names of
    its axes; `count`, how many to choose; `measured`, indices of directions that are measured already; `prior` as in
    `posterior_covariance`.
    **Returns:** a `NextDirections`; no direction is chosen twice.
    **Valid:** greedy: each step is the best, but the set need not be. For the choice, not in `sigma`, a parameter
    without a prior gets one of 1000 times the sigma that all directions would give it if it alone were unknown.
    Runs on the host, in float64.
    **Errors:** `ValueError` for names that are not free, indices out of range, a count above the directions left.
    **Source:** Fedorov 1972, Theory of Optimal Experiments, ch. 2 and 3.
    """
    free, whole = tuple(free), np.asarray(information, np.float64)
    if whole.ndim != 3 or whole.shape[1:] != (len(free),) * 2 or not np.all(np.isfinite(whole)):
        raise ValueError(f"`information` must be finite and [direction, {len(free)}, {len(free)}], got {whole.shape}")
    wanted = (interest,) if isinstance(interest, str) else tuple(interest or ())
    if not set(wanted) <= set(free) or (interest is not None and not wanted):
        raise ValueError(f"`interest` must name free parameters, among {', '.join(free)}; got {interest!r}")
    left = np.ones(len(whole), bool)
    past = np.asarray(measured, int).reshape(-1)
    if not np.all((past >= 0) & (past < len(whole))):
        raise ValueError(f"`measured` must hold indices of the {len(whole)} directions, got {past.tolist()}")
    left[past] = False
    if not 1 <= count <= left.sum():
        raise ValueError(f"`count` must be from 1 to the {left.sum()} directions that are left, got {count}")
    precision = _precision(prior, len(free))

    # scale by the information of all directions together, which also conditions the inverses
    every = np.diagonal(whole.sum(axis=0)) + precision
    unit = 1.0 / np.sqrt(np.where(every > 0.0, every, 1.0))
    candidates = whole * unit[:, None] * unit
    known = precision * unit**2
    known = known + np.where(precision > 0.0, 0.0, np.where(every > 0.0, _WEAK, 1.0))
    columns = [free.index(name) for name in wanted]
    best = np.diagonal(np.linalg.inv(candidates.sum(axis=0) + np.diag(known)))
    current = candidates[past].sum(axis=0) + np.diag(known)
    total = whole[past].sum(axis=0)
    order, sigma = [], []
    for _ in range(count):
        trial = current + candidates
        if columns:
            variance = np.diagonal(np.linalg.inv(trial), axis1=1, axis2=2)
            loss = np.sum((variance / best)[:, columns], axis=1)
        else:
            loss = -np.linalg.slogdet(trial)[1]
        chosen = int(np.argmin(np.where(left, loss, np.inf)))
        left[chosen], current, total = False, trial[chosen], total + whole[chosen]
        order.append(chosen)
        sigma.append(np.sqrt(np.diagonal(_inverse(as_float(total), as_float(precision)))))
    return NextDirections(np.array(order), np.array(sigma, float))


def _model(atmosphere: Atmosphere | SkyModel) -> SkyModel:
    return atmosphere if isinstance(atmosphere, SkyModel) else SkyModel(atmosphere)


def _solver(solver: AbstractSolver | None) -> AbstractSolver:
    return OrdersOfScattering.normal() if solver is None else solver


def _names(names, argument: str, model: SkyModel) -> tuple[str, ...]:
    """The names as a tuple, or a `ValueError` that quotes the argument they came in."""
    several = (names,) if isinstance(names, str) else tuple(names)
    check_free(several, model, argument, per_wavelength=True)
    return several


def _precision(prior, count: int):
    """1 / sigma^2 of a prior, 0 where there is none."""
    if prior is None:
        return np.zeros(count)
    if np.shape(prior) != (count,):
        raise ValueError(f"`prior` must hold one sigma for each of {count} parameters, got shape {np.shape(prior)}")
    if isinstance(prior, Tracer):
        return 1.0 / prior**2
    sigma = np.asarray(prior, np.float64)
    if not np.all(sigma > 0.0):
        raise ValueError(f"`prior` must be > 0, inf where nothing is known, got {sigma}")
    return 1.0 / sigma**2


def _inside(parameter: Parameter, model: SkyModel):
    """The parameter's value, moved a hair inside its bounds: at the edge of a clip half the slope would be lost."""
    value = as_float(parameter.from_leaf(parameter.leaf(model)))
    hair = _HAIR * (parameter.upper - parameter.lower) * (not parameter.log)
    return value + hair * ((value == parameter.lower) * 1.0 - (value == parameter.upper) * 1.0)


@eqx.filter_jit
def _linearised(solver: AbstractSolver, names: tuple[str, ...], model: SkyModel, scene: Scene):
    """The derivatives `[direction, wavelength, parameter]` and the radiance `[direction, wavelength]`."""

    def radiance(shift):
        at = [_inside(PARAMETERS[name], model) + shift[i] for i, name in enumerate(names)]
        moved = with_values(model, names, at)
        return (simulate(solver, moved, scene),) * 2

    return jax.jacfwd(radiance, has_aux=True)(jnp.zeros(len(names), scene.wavelength_nm.dtype))


@eqx.filter_jit
def _information(solver, names, model, scene, relative, floor):
    jacobian, radiance = _linearised(solver, names, model, scene)
    variance = (relative * radiance) ** 2 + jnp.broadcast_to(floor, radiance.shape) ** 2
    # without light the derivative is 0: any variance would do
    variance = jnp.where(variance > jnp.finfo(variance.dtype).tiny, variance, 1.0)
    return jnp.einsum("dwp,dw,dwq->dpq", jacobian, 1.0 / variance, jacobian)


@eqx.filter_jit
def _inverse(information, precision):
    matrix = information + jnp.diag(precision)
    diagonal = jnp.diagonal(matrix)
    unit = jnp.where(diagonal > 0.0, diagonal, 1.0) ** -0.5
    matrix = matrix * unit[:, None] * unit[None]
    values, vectors = jnp.linalg.eigh(jax.lax.stop_gradient(matrix))
    rounding = jnp.finfo(matrix.dtype).eps
    known = values > values.size * rounding * values[-1]
    inverse = (vectors * jnp.where(known, 1.0 / jnp.where(known, values, 1.0), 0.0)[None]) @ vectors.T
    # the same matrix, but with the derivative of an inverse even where eigenvalues coincide
    inverse = 2.0 * inverse - inverse @ matrix @ inverse
    unknown = jnp.any(~known[None] & (jnp.abs(vectors) > jnp.sqrt(rounding)), axis=1)
    involved = unknown[:, None] | unknown[None]
    infinite = jnp.where(jnp.eye(unit.size, dtype=bool), jnp.inf, 0.0)
    return jnp.where(involved, infinite, inverse * unit[:, None] * unit[None])
