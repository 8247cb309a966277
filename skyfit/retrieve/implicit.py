r"""Derivatives of the end of a search by all its inputs, from the implicit function theorem.

At the least cost $\partial C / \partial x = 0$, so that $dx = -H^{-1}\, (\partial^2 C / \partial x\, \partial y)\, dy$
with the full Hessian H. It includes the curvature of the residuals, which Gauss-Newton leaves out.
**Source:** Nocedal & Wright 2006, Numerical Optimization, ch. 10 and 12; Blondel et al. 2022, NeurIPS 35, 5230.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ..numerics.chain import Point
from ..transport import AbstractSolver
from .forward import observe, Problem
from .model import SkyModel
from .parameters import with_values
from .residuals import bound, box, calibration_of, Choices, cost, Known, Priors, trusted, Weighing


class Given(NamedTuple):
    """All numbers that the cost of a point depends on."""

    fixed: SkyModel
    problem: Problem
    priors: Priors
    weighing: Weighing
    threshold: Float[Array, ""]


def settled(choices: Choices, solver: AbstractSolver, point: Point, given: Given) -> Point:
    """The end of a search, with its derivatives by all of `given`; unknowns at the edge of their box stay there."""
    flat, back = ravel_pytree(point)
    slope = jax.grad(lambda flat, given: _misfit(choices, solver, back(flat), given))

    @jax.custom_jvp
    def end(flat, given):
        return flat

    @end.defjvp
    def _(primals, tangents):
        flat, given = primals
        held = jnp.abs(flat) >= ravel_pytree(box(choices, back(flat)))[0]
        hessian = jax.jacfwd(lambda flat: slope(flat, given))(flat)
        hessian = jnp.where(held[:, None] | held[None], jnp.diag(held.astype(flat.dtype)), hessian)
        push = jax.jvp(lambda given: slope(flat, given), (given,), (tangents[1],))[1]
        return flat, -jnp.linalg.solve(hessian, jnp.where(held, 0.0, push))

    return back(end(flat, given))


def _misfit(choices: Choices, solver: AbstractSolver, point: Point, given: Given) -> Float[Array, ""]:
    """The cost that the search has minimised, as a function that can be differentiated twice."""
    names, count = choices.names, len(choices.shared)
    calibration = calibration_of(choices, point, given.problem.measured.shape[2])

    @jax.checkpoint
    def at(item):
        own, one, weighing = item
        values = bound(names, jnp.concatenate([own, point.shared[:count]]))
        found = observe(solver, with_values(given.fixed, names, values), one)
        none = jnp.zeros(0, own.dtype)
        known = Known(found.radiance, found.beside, none, none)
        return trusted(choices, given.threshold, one, known, calibration, weighing).value

    residual = jax.lax.map(at, (point.own, given.problem, given.weighing))
    return cost(choices, given.priors, point, residual, given.weighing)
