"""Perez' five parameters fitted to many skies at once."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


# A-E where a fit starts if nothing else is said: Preetham 1999, A.2 near T = 3
CLEAR_SKY = (-1.0, -0.4, 8.0, -2.3, 0.4)
# skies that are iterated together; the next sky takes the place of one that has ended
_LANES = 128
_FIRST_DAMPING, _MORE, _LESS = 0.03, 4.0, 0.1
_MOST_DAMPING = 1e7
# per step, of the logarithms of the horizon's ratio, B and D
_LONGEST_STEP = 0.5
_SMALLEST_COSINE = 0.01  # as in `perez_distribution`
# a matrix element of a parameter without influence, so that it stays where it is
_NO_INFLUENCE = 1e-12


class PerezFits(NamedTuple):
    """Fits of many skies: `coefficients` A, B, C, D, E; `cost`, the sum of squared residuals; `steps`, evaluations.

    `converged` is False where the steps ran out or the light or the angles of a sky were not usable.
    """

    coefficients: Float[Array, "sky parameter"]
    cost: Float[Array, " sky"]
    steps: Int[Array, " sky"]
    converged: Bool[Array, " sky"]


class _Skies(NamedTuple):
    """What the residual of each sky needs; the direction's own part is shared."""

    ratio: Float[Array, "sky direction"]
    gamma: Float[Array, "sky direction"]
    square: Float[Array, "sky direction"]
    sun: Float[Array, " sky"]


class _Lanes(NamedTuple):
    sky: Int[Array, " lane"]
    point: Float[Array, "lane parameter"]
    step: Float[Array, "lane parameter"]
    damping: Float[Array, " lane"]
    cost: Float[Array, " lane"]
    curvature: Float[Array, "lane parameter parameter"]
    slope: Float[Array, "lane parameter"]
    count: Int[Array, " lane"]
    following: Int[Array, ""]
    found: Float[Array, "sky parameter"]
    found_cost: Float[Array, " sky"]
    found_count: Int[Array, " sky"]
    converged: Bool[Array, " sky"]


@eqx.filter_jit
def fit_perez(
    light: Float[Array, "sky direction"],
    zenith_light: Float[Array, " sky"],
    theta: Float[Array, " direction"],
    gamma: Float[Array, "sky direction"],
    theta_sun: Float[Array, " sky"],
    weight: Float[Array, " direction"],
    start: tuple[float, float, float, float, float] = CLEAR_SKY,
    max_steps: int = 100,
    tolerance: float = 3e-5,
) -> PerezFits:
    r"""A, B, C, D, E of each sky that minimise $\sum_d w_d^2 (L_z F(\theta_d, \gamma_d) / (F(0, \theta_s) L_d) - 1)^2$.

    Levenberg-Marquardt with Marquardt's damping on 128 skies side by side, each place taken by the next sky when one
    has ended, so that no sky waits for the slowest. The unknowns are such that the zenith's value cancels:
    $L / L_z = (1 + a (e^{B (1/\cos\theta - 1)} - 1)) (1 + c (e^{D\gamma} - e^{D\theta_s}) +
    e (\cos^2\gamma - \cos^2\theta_s))$ with $a = 1 - e^{-u_0}$, $B = -e^{u_1}$, $D = -e^{u_3}$. Steps are taken in
    single precision; a last Gauss-Newton step in that of the arguments carries the derivatives (implicit
    adjoint: exact where the residuals vanish).

    **Arguments:** `light` and `zenith_light`, one unit, positive; `theta` view zenith angle, `gamma` angle from the
    sun, `theta_sun` the sun's zenith angle, radians; `weight` of each direction; `start` A-E with B, D < 0;
    `max_steps`, evaluations of a sky; `tolerance`, the relative decrease of the cost at which a sky ends.
    **Returns:** `PerezFits`. **Valid:** a sky with light that is not positive or finite comes back as the start with
    `converged` False and the others are unaffected. Where $F(0, \theta_s)$ of the best form is near zero (sun near the
    zenith) the coefficients are huge; their `Perez.ratio` still is the fit.
    **Source:** Perez et al. 1993 eq. 1; Marquardt 1963, J. SIAM 11, 431.
    """
    usable = jnp.all(jnp.isfinite(light) & (light > 0.0), axis=1) & jnp.isfinite(zenith_light) & (zenith_light > 0.0)
    usable = usable & jnp.all(jnp.isfinite(gamma), axis=1) & jnp.isfinite(theta_sun)
    ratio = jnp.where(usable[:, None], zenith_light[:, None] / jnp.where(usable[:, None], light, 1.0), 1.0)
    gamma = jnp.where(usable[:, None], gamma, 0.0)
    skies = _Skies(ratio, gamma, jnp.square(jnp.cos(gamma)), jnp.where(usable, theta_sun, 0.0))
    slant = 1.0 / jnp.maximum(jnp.cos(theta), _SMALLEST_COSINE) - 1.0
    first = _unbounded(jnp.asarray(start, ratio.dtype), skies.sun)
    single = jax.tree.map(lambda v: jax.lax.stop_gradient(v).astype(jnp.float32), (skies, slant, weight, first))
    ended = _iterate(single[0], single[1], single[2], single[3], max_steps, tolerance)
    point = ended.found.astype(ratio.dtype)
    # one step more, in the precision of the arguments: its derivative is that of the minimum
    normal = _normal_equations(point, skies, slant, weight, moving=True)
    step = -_solve(jax.lax.stop_gradient(normal[:, :5, :5]) + _NO_INFLUENCE * jnp.eye(5)[None], normal[:, :5, 5])
    # where the valley is flat a whole step may lead far out: the value stays, the derivative is kept
    short = jnp.max(jnp.abs(step), axis=1, keepdims=True) < _LONGEST_STEP
    step = jnp.where(jnp.isfinite(step), step, 0.0)
    moved = jnp.where(short, point + step, point + step - jax.lax.stop_gradient(step))
    cost = _cost(moved, skies, slant, weight)
    better = cost <= normal[:, 5, 5]
    final = jnp.where(better[:, None], moved, point + step - jax.lax.stop_gradient(step))
    cost = jnp.where(better, cost, normal[:, 5, 5])
    return PerezFits(_bounded(final, skies.sun), cost, ended.found_count, ended.converged & usable)


def _unbounded(coefficients, sun):
    """The unknowns of A-E for each sun, `[sky, 5]`."""
    a, b, c, d, e = coefficients
    at_zenith = 1.0 + c * jnp.exp(d * sun) + e * jnp.square(jnp.cos(sun))
    same = jnp.ones_like(sun)
    return jnp.stack(
        [
            jnp.log1p(a * jnp.exp(b)) * same,
            jnp.log(-b) * same,
            c / at_zenith,
            jnp.log(-d) * same,
            e / at_zenith,
        ],
        axis=1,
    )


def _bounded(point, sun):
    """A-E of the unknowns, `[sky, 5]`."""
    steepness, width = jnp.exp(point[:, 1]), jnp.exp(point[:, 3])
    rest = 1.0 - point[:, 2] * jnp.exp(-width * sun) - point[:, 4] * jnp.square(jnp.cos(sun))
    at_zenith = 1.0 / jnp.where(jnp.abs(rest) < 1e-6, 1e-6, rest)
    return jnp.stack(
        [
            jnp.expm1(point[:, 0]) * jnp.exp(jnp.minimum(steepness, 20.0)),
            -steepness,
            point[:, 2] * at_zenith,
            -width,
            point[:, 4] * at_zenith,
        ],
        axis=1,
    )


def _factors(point, skies: _Skies, slant):
    """Horizon's and sun's factor and what their derivatives need."""
    u, steepness, c, width, e = (point[:, k, None] for k in range(5))
    b, d = -jnp.exp(steepness), -jnp.exp(width)
    sun = skies.sun[:, None]
    # far below the smallest float nothing is left to lose
    horizon = jnp.exp(jnp.maximum(b * slant[None], -80.0)) - 1.0
    here, there = jnp.exp(d * skies.gamma), jnp.exp(d * sun)
    square = skies.square - jnp.square(jnp.cos(sun))
    left = jnp.exp(-u)
    first = 1.0 + (1.0 - left) * horizon
    second = 1.0 + c * (here - there) + e * square
    return first, second, horizon, here, there, square, left, b, c, d


def _cost(point, skies: _Skies, slant, weight):
    first, second, *_ = _factors(point, skies, slant)
    return jnp.sum(jnp.square(weight[None] * (skies.ratio * first * second - 1.0)), axis=1)


def _normal_equations(point, skies: _Skies, slant, weight, moving: bool = False):
    """Products of the five columns of the Jacobian and the residual, `[sky, 6, 6]`.

    `moving`: the derivative of the products with the residual is by the data at a fixed Jacobian.
    """
    first, second, horizon, here, there, square, left, b, c, d = _factors(point, skies, slant)
    scale = weight[None] * skies.ratio
    by_first, by_second = scale * second, scale * first
    jacobian = jnp.stack(
        [
            by_first * horizon * left,
            by_first * (1.0 - left) * (horizon + 1.0) * slant[None] * b,
            by_second * (here - there),
            by_second * c * d * (here * skies.gamma - there * skies.sun[:, None]),
            by_second * square,
        ],
        axis=1,
    )
    if moving:
        jacobian = jax.lax.stop_gradient(jacobian)
    columns = jnp.concatenate([jacobian, (by_first * first - weight[None])[:, None]], axis=1)
    return jax.lax.dot_general(columns, columns, (((2,), (2,)), ((0,), (0,))), precision="highest")


def _solve(matrix, right):
    """Solutions of small symmetric systems by their LDL factors, written out for all skies at once, `[sky, n]`."""
    n = matrix.shape[-1]
    lower: list[list] = [[None] * n for _ in range(n)]
    pivot, result = [], []
    for j in range(n):
        left = sum((lower[j][k] ** 2 * pivot[k] for k in range(j)), 0.0)
        pivot.append(jnp.maximum(matrix[:, j, j] - left, 1e-30))
        for i in range(j + 1, n):
            left = sum((lower[i][k] * lower[j][k] * pivot[k] for k in range(j)), 0.0)
            lower[i][j] = (matrix[:, i, j] - left) / pivot[j]
        result.append(right[:, j] - sum((lower[j][k] * result[k] for k in range(j)), 0.0))
    result = [r / p for r, p in zip(result, pivot, strict=True)]
    for j in reversed(range(n)):
        result[j] = result[j] - sum((lower[i][j] * result[i] for i in range(j + 1, n)), 0.0)
    return jnp.stack(result, axis=1)


def _iterate(skies: _Skies, slant, weight, first, max_steps: int, tolerance: float) -> _Lanes:
    count = first.shape[0]
    # a last sky that nobody asked for stands where none is left
    skies, first = jax.tree.map(lambda v: jnp.concatenate([v, v[:1]]), (skies, first))
    lanes = min(_LANES, count)

    def turn(lane: _Lanes) -> _Lanes:
        trial = lane.point + lane.step
        normal = _normal_equations(trial, jax.tree.map(lambda v: v[lane.sky], skies), slant, weight)
        cost = normal[:, 5, 5]
        begins = jnp.isinf(lane.cost)
        better = jnp.isfinite(cost) & (cost < lane.cost)
        fall = (lane.cost - cost) / jnp.maximum(cost, 1e-30)
        curvature = jnp.where(better[:, None, None], normal[:, :5, :5], lane.curvature)
        slope = jnp.where(better[:, None], normal[:, :5, 5], lane.slope)
        point = jnp.where(better[:, None], trial, lane.point)
        cost = jnp.where(better, cost, lane.cost)
        damping = jnp.maximum(lane.damping * jnp.where(better, _LESS, _MORE), 1e-6)
        scaled = jnp.diagonal(curvature, axis1=1, axis2=2) * damping[:, None] + _NO_INFLUENCE
        step = -_solve(curvature + scaled[:, :, None] * jnp.eye(5, dtype=scaled.dtype)[None], slope)
        longest = jnp.max(jnp.abs(step[:, jnp.array([0, 1, 3])]), axis=1)
        step = step * jnp.minimum(1.0, _LONGEST_STEP / jnp.maximum(longest, 1e-9))[:, None]
        foreseen = -jnp.sum(step * slope, axis=1) / jnp.maximum(cost, 1e-30)
        flat = better & ~begins & (fall < tolerance) & (foreseen < tolerance) & (damping < 0.1)
        converged = flat | (~begins & (damping > _MOST_DAMPING))
        done = converged | (lane.count + 1 >= max_steps)
        following = jnp.where(done, jnp.minimum(lane.following + jnp.cumsum(done) - 1, count), lane.sky)
        return _Lanes(
            sky=following,
            point=jnp.where(done[:, None], first[following], point),
            step=jnp.where(done[:, None], 0.0, step),
            damping=jnp.where(done, _FIRST_DAMPING, damping),
            cost=jnp.where(done, jnp.inf, cost),
            curvature=curvature,
            slope=slope,
            count=jnp.where(done, 0, lane.count + 1),
            following=lane.following + jnp.sum(done),
            found=lane.found.at[lane.sky].set(point),
            found_cost=lane.found_cost.at[lane.sky].set(cost),
            found_count=lane.found_count.at[lane.sky].set(lane.count + 1),
            converged=lane.converged.at[lane.sky].set(converged),
        )

    dtype = first.dtype
    begin = _Lanes(
        sky=jnp.arange(lanes), point=first[:lanes], step=jnp.zeros((lanes, 5), dtype),
        damping=jnp.full(lanes, _FIRST_DAMPING, dtype), cost=jnp.full(lanes, jnp.inf, dtype),
        curvature=jnp.zeros((lanes, 5, 5), dtype), slope=jnp.zeros((lanes, 5), dtype),
        count=jnp.zeros(lanes, int), following=jnp.asarray(lanes), found=first,
        found_cost=jnp.zeros(count + 1, dtype), found_count=jnp.zeros(count + 1, int),
        converged=jnp.zeros(count + 1, bool),
    )  # fmt: skip
    ended = jax.lax.while_loop(lambda lane: jnp.any(lane.sky < count), turn, begin)
    return jax.tree.map(lambda v: v[:count] if v.shape[:1] == (count + 1,) else v, ended)
