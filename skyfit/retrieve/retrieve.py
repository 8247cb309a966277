"""The pure core: from samples to parameters with covariance, for `jit`, `vmap` and `grad`."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from ..measured.noise import Loss
from ..numerics.chain import minimise, Point
from ..transport import AbstractSolver
from .components import Components, Expected, KINDS
from .forward import Problem
from .implicit import Given, settled
from .model import SkyModel
from .parameters import PARAMETERS, partition
from .residuals import (
    box,
    calibration_of,
    Choices,
    nothing_known,
    Numbers,
    objective,
    Priors,
    values_at,
    Weighing,
)
from .uncertainty import components_at, described, End, Estimate, weighing_at


# tolerances of the last search and of those before it, as shares of the sigma by independent noise
_NEAR, _FIRST_NEAR = 0.02, 0.5
# those before it may end further away where samples are many: chi-square is then at most 0.4 % above its least
_FIRST_SHARE = 0.06
# largest tolerance of the last search, however large the errors are that samples share
_MOST_NEAR = 0.3
# where the whole step to the minimum is shorter than this share of the sigma, slopes are not renewed: the ends of eight
# measured scans moved by less than 0.05 of their sigma
_CLOSE = 0.5
# first damping of these searches: the last one begins near the end
_DAMPED, _FIRST_DAMPED = 1e-3, 0.1


def retrieve(
    problem: Problem,
    model: SkyModel,
    free: Sequence[str],
    *,
    solver: AbstractSolver,
    slopes: AbstractSolver | None = None,
    shared: Sequence[str] = (),
    priors: Priors | None = None,
    start: Point | None = None,
    loss: Loss = "huber",
    threshold=3.0,
    model_error=0.0,
    max_steps=100,
    expected: Expected | None = None,
    level=0.0,
) -> Estimate:
    """Fit the parameters of some times of a sky and their covariance: pure, for `jit`, `vmap` and `grad`.

    **Arguments:** `problem`, the samples; `model`, whose other values are not fitted; `free`, names among `PARAMETERS`;
    `solver` of the radiance; `slopes`, solver of its derivatives in all searches but the last (default: the same one,
    so that a single copy of it is compiled; with a coarser one a fit is two to three times as fast); `shared`, the free
    names that all times have in common; `priors` in the order (each time's own, shared); `start`, unconstrained numbers
    in that order, `own` `[start, time, parameter]` and `shared` `[start, shared]` (default: the model's values). The
    search runs from each start, and once more from the best end with the noise that its residuals show. The last search
    and sigma have the slopes of `solver`, which are not renewed within half a sigma of the end. `loss` beyond
    `threshold` standard deviations; `model_error`, relative; `max_steps` of each search; `expected` sizes of the shared
    errors (default: there are none), which widen the covariance; `level`, the relative size of an error that a whole
    time shares. Numbers may be traced, names and solvers are static.
    **Returns:** an `Estimate`, parameters in the order of `free`. No error is raised: see `result` and `finite`.
    **Valid:** the cost of the search is linear in the number of times, that of the covariance quadratic. `values` and
    `calibration` have derivatives by all numerical inputs (`implicit.settled`), exact at the least cost with the
    weights of the samples held. The derivatives of all other outputs are 0. The derivatives take the memory and the
    time of one radiance and its derivatives for each parameter, and a matrix of all unknowns of all times. `gain` is
    that of Gauss-Newton.
    """
    free = tuple(free)
    choices = Choices(
        tuple(n for n in free if n not in shared), tuple(n for n in free if n in shared), loss,
        priors is not None and priors.calibration is not None,
    )  # fmt: skip
    dtype = problem.measured.dtype
    times = problem.measured.shape[0]
    if priors is None:
        nothing = jnp.zeros(len(free), dtype)
        none = jnp.zeros((0, len(free)), dtype)
        priors = Priors(nothing, nothing, None, jnp.zeros((times - 1, len(choices.own)), dtype), none)
    if start is None:
        point = jnp.stack([PARAMETERS[n].free_of(model) for n in choices.names]).astype(dtype)
        own, common = point[: len(choices.own)], point[len(choices.own) :]
        start = Point(jnp.broadcast_to(own, (1, times, own.size)), common[None])
    if expected is None:
        none = jnp.zeros(len(KINDS), dtype)
        expected = Expected(none, none + jnp.inf, jnp.ones((), dtype))
    numbers = Numbers(
        jnp.asarray(threshold), jnp.asarray(model_error), jnp.asarray(max_steps), expected, jnp.asarray(level)
    )
    _, fixed = partition(model, free)
    slopes = None if slopes == solver else slopes
    # the end of the search is differentiated, the search is not
    still = jax.lax.stop_gradient((numbers, fixed, problem, priors, start))
    end = search(choices, still[0], (solver, slopes), *still[1:])
    found = described(choices, still[0], *still[2:4], end)
    point = settled(choices, solver, end.point, Given(fixed, problem, priors, end.weighing, numbers.threshold))
    found = found._replace(
        values=values_at(choices, point), calibration=calibration_of(choices, point, problem.measured.shape[2])
    )
    order = np.array([choices.names.index(n) for n in free])
    return found._replace(
        values=found.values[:, order],
        noise=found.noise[:, order][:, :, order],
        model=found.model[:, order][:, :, order],
        triangle=found.triangle[..., order],
        gain=found.gain[:, order],
    )


def shape_of(problem: Problem, *_, **__) -> Estimate:
    """A tree with the structure of the result of `retrieve` for some samples, whatever its other arguments are."""
    places = Estimate(*range(len(Estimate._fields)))  # pyright: ignore[reportArgumentType]
    return places._replace(beside=None if problem.beside is None else places.beside, result=optx.RESULTS.successful)


def search(
    choices: Choices,
    numbers: Numbers,
    solvers: tuple[AbstractSolver, AbstractSolver | None],
    fixed: SkyModel,
    problem: Problem,
    priors: Priors,
    starts: Point,
) -> End:
    """Search from all starts, then from the best end with noise as large as the residuals show.

    Shared errors do not weight the samples against each other; they weight all samples together against the priors.
    Without its level a direction would determine colours alone, but the residuals of a real sky are smooth over
    neighbouring directions, not a direction's own. The searches run one after the other through the same loop, so that
    the compiler sees the solvers once.
    """
    channels = problem.measured.shape[2]
    none = channels if choices.calibrated else 0
    dtype = problem.measured.dtype
    rows = objective(choices, *solvers)

    def left(end: End):
        return weighing_at(choices, numbers, problem, priors, end)

    def one(best: End, item):
        begin, last = item
        begin = jax.tree.map(lambda a, b: jnp.where(last, a, b), best.point, begin)
        weighing = jax.lax.cond(last, left, lambda _: stated, best)
        arguments = fixed, problem, priors, weighing, numbers.threshold, last
        # tolerance as a share of the sigma that a search assumes; the last search continues from the best end
        near = jnp.where(last, jnp.minimum(_NEAR * weighing.of_all(), _MOST_NEAR), first_near)
        damping = jnp.where(last, _DAMPED, _FIRST_DAMPED)
        # where all searches failed, nothing is known
        holds = last & jnp.isfinite(best.cost)
        close = _CLOSE * weighing.of_all()
        point, known, total, steps, result = minimise(
            rows, begin, arguments, best.known, holds, limit, none, numbers.max_steps, near, damping, close
        )
        total = jnp.where(jnp.isfinite(total), total, jnp.inf)
        better = last | (total < best.cost)
        sizes = jax.lax.cond(
            better, lambda: components_at(choices, numbers, problem, priors, point, known), lambda: best.sizes
        )
        end = End(point, known, weighing, sizes, total, best.steps + steps, result)
        chosen = jax.tree.map(lambda a, b: jnp.where(better, a, b), end, best)
        return chosen._replace(steps=end.steps), None

    begins = Point(starts.own, jnp.concatenate([starts.shared, jnp.zeros((starts.own.shape[0], none), dtype)], axis=1))
    first = jax.tree.map(lambda v: v[0], begins)
    limit = box(choices, first)
    times = problem.measured.shape[0]
    nothing = nothing_known(problem, len(choices.names))
    fewest = jnp.min(jnp.sum(problem.weight > 0.0, axis=(1, 2)))
    first_near = jnp.maximum(_FIRST_NEAR, _FIRST_SHARE * jnp.sqrt(fewest))
    stated = Weighing(jnp.ones(times, dtype), jnp.ones(times, dtype))
    sizes = Components(jnp.ones(times, dtype), jnp.zeros((times, len(KINDS)), dtype))
    best = End(first, nothing, stated, sizes, jnp.array(jnp.inf, dtype), jnp.array(0), optx.RESULTS.successful)
    items = jax.tree.map(lambda v: jnp.concatenate([v, v[:1]]), begins)
    last = jnp.arange(starts.own.shape[0] + 1) == starts.own.shape[0]
    return jax.lax.scan(one, best, (items, last))[0]
