"""Least squares by Levenberg-Marquardt and the covariance of the solution."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float, Int, PyTree

from .factor import singular, solve_upper, triangle


# Logistic transforms of bounded parameters are flat beyond this: 3e-4 of the range is left to the bound.
LOGISTIC_LIMIT = 8.0


class _MarquardtState(eqx.Module):
    point: Float[Array, " parameter"]
    triangle: Float[Array, "parameter parameter"]
    projected: Float[Array, " parameter"]


class MarquardtDescent(optx.AbstractDescent):
    r"""The step that solves $(J^T J + \lambda\, \mathrm{diag}(J^T J))\, \delta = -J^T r$ within a box.

    Damping in proportion to each column of the Jacobian makes the path independent of the parameters' units;
    optimistix' own damping is $\lambda I$. Parameters that stand at the edge of the box |u| <= `limit` and would
    leave it are held there while the others move. The QR of J is made once per accepted point.
    **Source:** Marquardt 1963, J. SIAM 11, 431; More 1978, eq. 3.3.
    """

    limit: Float[Array, " parameter"]
    first_damping: float = 0.01

    def init(self, y, f_info_struct):
        return _MarquardtState(y, jnp.zeros((y.size, y.size), y.dtype), jnp.zeros_like(y))

    def query(self, y, f_info, state):
        # R and the first numbers of Q^T r. With fewer samples than parameters, rows are missing.
        whole = triangle(jnp.concatenate([f_info.jac.as_matrix(), f_info.residual[:, None]], axis=1))[: y.size]
        whole = jnp.pad(whole, ((0, y.size - whole.shape[0]), (0, 0)))
        return _MarquardtState(y, whole[:, :-1], whole[:, -1])

    def step(self, step_size, state):
        damping = jnp.sqrt(self.first_damping / step_size)

        def damped(held):
            free = jnp.where(held[None], 0.0, state.triangle)
            column = jnp.linalg.norm(free, axis=0)
            # A parameter without any influence stays where it is.
            column = jnp.where(column > 0.0, damping * column, 1.0)
            right = jnp.concatenate([state.projected, jnp.zeros_like(column)])
            rows = jnp.concatenate([free, jnp.diag(column)])
            whole = triangle(jnp.concatenate([rows, right[:, None]], axis=1))[: column.size]
            return -solve_upper(whole[:, :-1], whole[:, -1])

        # Parameters are held at the edge where the cost falls outward, then where the step would still lead outward.
        at_edge = jnp.abs(state.point) >= self.limit
        side = jnp.sign(state.point)
        held = at_edge & (side * (state.triangle.T @ state.projected) <= 0.0)
        held = held | (at_edge & (jnp.sign(damped(held)) == side))
        moved = jnp.clip(state.point + damped(held), -self.limit, self.limit)
        return moved - state.point, optx.RESULTS.successful


class LevenbergMarquardt(optx.AbstractGaussNewton):
    """Optimistix' Gauss-Newton loop with Marquardt's scaled damping and a trust region that opens early."""

    rtol: float
    atol: float
    descent: MarquardtDescent
    norm: Callable = optx.max_norm
    search: optx.ClassicalTrustRegion = optx.ClassicalTrustRegion(high_cutoff=0.75, low_cutoff=0.01)
    verbose: Callable = lambda **_: None


class Solution(NamedTuple):
    """Result of a least-squares solve; arrays only, so that it passes through jit and vmap.

    `residual` and `jacobian` (by the bounded `value`) are those at `value`.
    """

    value: Float[Array, " parameter"]
    residual: Float[Array, " sample"]
    jacobian: Float[Array, "sample parameter"]
    steps: Int[Array, ""]
    result: Any


def least_squares(
    residual: Callable,
    bound: Callable,
    start: Float[Array, " parameter"],
    arguments: PyTree,
    limit: Float[Array, " parameter"],
    max_steps: int = 100,
    tolerance: float = 1e-3,
) -> Solution:
    r"""Minimise $\frac12 \sum r_i^2$ within bounds by Levenberg-Marquardt on optimistix' loop.

    **Arguments:** `residual(value, arguments)`, one array, whitened (divided by sigma); `bound(free)` maps
    unconstrained numbers to values; `start`, unconstrained; `limit`, the largest distance of each from 0
    (`LOGISTIC_LIMIT` or inf); `tolerance`, relative and absolute, on the unconstrained numbers and the residual.
    **Returns:** `Solution`; nothing is raised, `result` says how it ended (`result_name`).
    **Valid:** the derivative of the solution by `arguments` (implicit adjoint) is that of Gauss-Newton: exact where
    the residuals vanish, otherwise off in proportion to them.
    **Source:** `LevenbergMarquardt`, Jacobian in forward mode.
    """

    def linearised(free, arguments):
        # The dense Jacobian replaces the derivative, so that the compiler sees the model only once.
        value = bound(free)
        fixed = jax.lax.stop_gradient(value)
        jacobian, result = jax.jacfwd(lambda v: (residual(v, arguments),) * 2, has_aux=True)(fixed)
        change = jax.lax.stop_gradient(jacobian) @ (value - fixed)
        return result + change, (result, jacobian)

    solver = LevenbergMarquardt(rtol=tolerance, atol=tolerance, descent=MarquardtDescent(limit=limit))
    solution = optx.least_squares(linearised, solver, start, arguments, has_aux=True, max_steps=max_steps, throw=False)
    last_residual, last_jacobian = solution.state.aux
    return Solution(bound(solution.value), last_residual, last_jacobian, solution.stats["num_steps"], solution.result)


def result_name(result) -> str:
    """A word for how a solve ended: "successful", "max_steps_reached" or "failed"."""
    if result == optx.RESULTS.successful:
        return "successful"
    if result == optx.RESULTS.nonlinear_max_steps_reached:
        return "max_steps_reached"
    return "failed"


def covariance(
    jacobian: Float[Array, "sample parameter"], scale: Float[Array, " parameter"]
) -> tuple[Float[Array, "parameter parameter"], Float[Array, "parameter parameter"]]:
    r"""Covariance $(J^T J)^{-1}$ of whitened least squares from a QR of the Jacobian.

    **Arguments:** `jacobian` of the whitened residuals; `scale`, a typical size of each parameter, which
    conditions the triangle and defines what "not determined" means.
    **Returns:** the covariance, and the triangle R of the scaled Jacobian, whose small singular values are the
    combinations that the data do not determine.
    **Valid:** always. A parameter that is part of a combination without influence has infinite variance and no
    stated covariance (0). The covariance of the others is that with such combinations held fixed.
    **Source:** Golub & Van Loan, Matrix Computations, sec. 5.3 and 5.5.
    """
    factor = triangle(jacobian * scale[None])
    column = jnp.linalg.norm(factor, axis=0)
    unit = jnp.where(column > 0.0, column, 1.0)
    sizes, rows = singular(factor / unit[None])
    rounding = jnp.finfo(jacobian.dtype).eps
    known = sizes > sizes.size * rounding * sizes[0]
    inverse = jnp.where(known, 1.0 / jnp.where(known, sizes, 1.0), 0.0)
    within = (rows.T * inverse[None] ** 2) @ rows
    unknown = jnp.any(~known[:, None] & (jnp.abs(rows) > jnp.sqrt(rounding)), axis=0)
    size = scale / unit
    within = within * size[:, None] * size[None]
    involved = unknown[:, None] | unknown[None]
    infinite = jnp.where(jnp.eye(size.size, dtype=bool), jnp.inf, 0.0)
    return jnp.where(involved, infinite, within), factor
