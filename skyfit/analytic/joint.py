"""The joint fit of all coefficients of an analytic sky to many skies, for any form of the coefficients."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..numerics import as_float, triangle
from ..numerics.least_squares import least_squares, LOGISTIC_LIMIT, Solution
from .analytic import AbstractAnalyticSky
from .extended import ExtendedPreetham
from .perez import Perez
from .preetham import Preetham


# Units of the residuals, relative errors: 5 % of luminance, 1 % of chromaticity
UNIT = (0.05, 0.01, 0.01)
_MOST_STEPS, _TOLERANCE = 200, 1e-2
# Bounds of A, B, C, D, E in the linear form, for luminance and for chromaticity. Without them the fit may use a wide
# and huge circumsolar term as a constant, which extrapolates badly
_LOWER = ((-1.5, -6.0, 0.0, -12.0, -1.0), (-0.9, -6.0, -1.0, -6.0, -0.5), (-0.9, -6.0, -1.0, -6.0, -0.5))
_UPPER = ((5.0, -0.01, 60.0, -0.5, 5.0), (1.0, -0.01, 2.0, -0.2, 0.5), (1.0, -0.01, 2.0, -0.2, 0.5))
# Number of Chebyshev polynomials in turbidity and in sun of the extended form
_ORDERS = (5, 7)
# Initial numbers u of the extended form: a horizon brighter than the zenith and a wide aureole
_FIRST_NUMBERS = ((-0.9, -1.2, 2.5, 0.8, 0.9), (-0.1, -1.2, 0.55, 0.4, 0.48), (-0.1, -1.2, 0.55, 0.4, 0.48))
# Regularisation that draws undetermined coefficients towards a constant
_STIFFNESS = 0.01


class Linear:
    """Preetham's form: A-E linear in turbidity and the same for every sun, zenith polynomials as published.

    The unknowns of a quantity are A-E at the smallest and the largest turbidity, mapped between bounds by a logistic
    function, and the zenith coefficients themselves.
    """

    def first(self, published: Preetham) -> Preetham:
        return published

    def start(self, quantity: int, target, sun, turbidity):
        """The published coefficients, moved inside the bounds."""
        published = Preetham.published()
        lower, upper = np.array(_LOWER[quantity]), np.array(_UPPER[quantity])
        slope, constant = np.asarray(published.distribution[quantity]).T
        ends = []
        for level in (np.min(turbidity), np.max(turbidity)):
            share = np.clip((slope * level + constant - lower) / (upper - lower), 0.01, 0.99)
            ends.append(np.log(share / (1.0 - share)))
        zenith = published.zenith_luminance if quantity == 0 else published.zenith_chromaticity[quantity - 1]
        return as_float(np.concatenate([*ends, np.ravel(zenith)]))

    def limit(self, start):
        return jnp.where(jnp.arange(start.size) < 10, LOGISTIC_LIMIT, jnp.inf).astype(start.dtype)

    def bound(self, quantity: int, free, turbidity):
        """Slope and constant of each Perez parameter, then the zenith coefficients."""
        lower, upper = as_float(_LOWER[quantity]), as_float(_UPPER[quantity])
        low, high = (lower + (upper - lower) * jax.nn.sigmoid(u) for u in (free[:5], free[5:10]))
        first, last = jnp.min(turbidity), jnp.max(turbidity)
        slope = (high - low) / (last - first)
        distribution = jnp.stack([slope, low - slope * first], axis=1)
        return jnp.concatenate([distribution.ravel(), free[10:]])

    def put(self, model: Preetham, quantity: int, value) -> Preetham:
        """The model with the ten distribution coefficients and all zenith coefficients of a quantity replaced."""
        distribution = model.distribution.at[quantity].set(value[:10].reshape(5, 2))
        model = eqx.tree_at(lambda m: m.distribution, model, distribution)
        if quantity == 0:
            return eqx.tree_at(lambda m: m.zenith_luminance, model, value[10:].reshape(3, 2))
        chromaticity = model.zenith_chromaticity.at[quantity - 1].set(value[10:].reshape(3, 4))
        return eqx.tree_at(lambda m: m.zenith_chromaticity, model, chromaticity)

    def stiffness(self, value):
        return value[:0]


class Extended:
    """`ExtendedPreetham`'s form: the unknowns are its coefficients."""

    def first(self, published: Preetham) -> ExtendedPreetham:
        return ExtendedPreetham(jnp.zeros((3, 6, *_ORDERS)))

    def start(self, quantity: int, target, sun, turbidity):
        """One distribution for all skies, and a fit to the zenith value of each sky."""
        polynomials = jax.vmap(self.first(Preetham.published()).polynomials)
        table = np.asarray(polynomials(as_float(turbidity), as_float(sun))).reshape(len(turbidity), -1)
        coefficients = np.zeros((6, table.shape[1]))
        coefficients[:5, 0] = _FIRST_NUMBERS[quantity]
        coefficients[5] = np.linalg.lstsq(table, np.log(np.asarray(target)[:, -1]), rcond=None)[0]
        return as_float(coefficients.ravel())

    def limit(self, start):
        return jnp.full_like(start, jnp.inf)

    def bound(self, quantity: int, free, turbidity):
        return free

    def put(self, model: ExtendedPreetham, quantity: int, value) -> ExtendedPreetham:
        shape = model.coefficients.shape[1:]
        changed = model.coefficients.at[quantity].set(value.reshape(shape))
        return eqx.tree_at(lambda m: m.coefficients, model, changed)

    def stiffness(self, value):
        # All coefficients except the constants
        return _STIFFNESS * value.reshape(6, -1)[:, 1:].ravel()


CoefficientForm = Linear | Extended
LINEAR, EXTENDED = Linear(), Extended()


class _Skies(NamedTuple):
    target: Float[Array, "sky direction"]
    gamma: Float[Array, "sky direction"]
    zenith: Float[Array, " direction"]
    sun: Float[Array, " sky"]
    turbidity: Float[Array, " sky"]
    weight: Float[Array, " direction"]


@eqx.filter_jit
def fit_joint(form: CoefficientForm, quantity: int, start: Float[Array, " parameter"], skies) -> Solution:
    r"""The coefficients of Y (0), x (1) or y (2) that minimise the relative error over all skies.

    At each step the residual of a sky is linearised in its six numbers, A-E and the zenith value. The QR factorisation
    of its Jacobian reduces it exactly to six numbers and the length of the orthogonal remainder. The joint problem
    therefore has seven rows per sky for any number of directions.

    **Arguments:** `form`; `start`, its initial unknowns; `skies`: light `[sky, direction]`, gamma, view zenith, sun,
    turbidity, weight of each direction. **Returns:** `Solution`, whose `value` is the argument for `form.put`.
    """
    skies = _Skies(*skies)
    model = form.first(Preetham.published())

    def residual(value, skies: _Skies):
        filled = form.put(model, quantity, value)  # pyright: ignore[reportArgumentType]
        numbers = jax.vmap(lambda t, s: _six(filled, quantity, t, s))(skies.turbidity, skies.sun)
        reduced = jax.vmap(
            lambda p, v, g, s: _reduced(p, v, g, s, skies.zenith, skies.weight / UNIT[quantity])
        )(numbers, skies.target, skies.gamma, skies.sun)  # fmt: skip
        return jnp.concatenate([reduced.ravel(), form.stiffness(value)])

    def bound(free):
        return form.bound(quantity, free, skies.turbidity)

    return least_squares(residual, bound, start, skies, form.limit(start), _MOST_STEPS, _TOLERANCE)


def _six(model: AbstractAnalyticSky, quantity: int, turbidity, sun):
    """A-E and the zenith value of one quantity."""
    shape, zenith = model.perez(turbidity, sun)[quantity], model.zenith(turbidity, sun)[quantity]
    return jnp.concatenate([shape.coefficients, zenith[None]])


def _reduced(numbers, values, gamma, sun, zenith, weight):
    """The residual of one sky in seven numbers, with the cost and its gradient by `numbers` of all directions."""

    def residual(six):
        ratio = Perez.from_coefficients(six[:5]).ratio(zenith, gamma, sun)
        return weight * (six[5] * ratio / values - 1.0)

    fixed = jax.lax.stop_gradient(numbers)
    jacobian, whole = jax.jacfwd(lambda six: (residual(six),) * 2, has_aux=True)(fixed)
    factor = triangle(jnp.concatenate([jacobian, whole[:, None]], axis=1))
    count = numbers.size
    # Q^T b, R, and the length of the part of b orthogonal to Q
    constant = jax.lax.stop_gradient((factor[:count, -1], factor[:count, :-1], jnp.abs(factor[count, -1])))
    return jnp.concatenate([constant[0] + constant[1] @ (numbers - fixed), constant[2][None]])
