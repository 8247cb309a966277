"""Functions whose textbook form cancels or divides by zero; inputs are guarded, so gradients stay finite."""

import functools
import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


_SERIES_LIMIT = 0.5


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def polynomial(coefficients: tuple[float, ...], x: Float[Array, "..."]) -> Float[Array, "..."]:
    """A polynomial by Horner's rule, constant coefficient first; its derivative is another such polynomial.

    If the rule were differentiated step by step, each step would have two uses, and the compiler would make a kernel of
    each.
    """
    value = jnp.full_like(x, coefficients[-1])
    for c in coefficients[-2::-1]:
        value = value * x + c
    return value


@polynomial.defjvp
def _polynomial_tangent(coefficients, primals, tangents):
    slope = tuple(k * c for k, c in enumerate(coefficients))[1:] or (0.0,)
    return polynomial(coefficients, *primals), polynomial(slope, *primals) * tangents[0]


def phi_functions(x: Float[Array, "..."], count: int = 2) -> tuple[Float[Array, "..."], ...]:
    r"""$\varphi_1(x) = (1 - e^{-x}) / x$ and $\varphi_{k+1}(x) = (1/k! - \varphi_k(x)) / x$.

    They are the means of $e^{-xt}$ times $(1 - t)^{k-1} / (k-1)!$ over $t \in [0, 1]$, with all digits.

    **Arguments:** `x`, dimensionless, any shape; `count`, how many of them, 2 or 3.
    **Returns:** `count` arrays of that shape; 1, 1/2 and 1/6 at x = 0.
    **Valid:** x > -80 in float32; a series takes over near 0, so values and gradients keep all digits.
    **Source:** Hochbruck & Ostermann 2010, Exponential integrators, eq. 2.10.
    """
    small = jnp.abs(x) < _SERIES_LIMIT
    near, far = jnp.where(small, x, 0.0), jnp.where(small, 1.0, x)
    # The series is that of the last function; those before it follow without cancellation.
    terms = 8 if x.dtype == jnp.float32 else 14
    values = [polynomial(tuple((-1.0) ** k / math.factorial(k + count) for k in range(terms)), near)]
    for k in range(count - 1, 0, -1):
        values.insert(0, 1.0 / math.factorial(k) - near * values[0])
    beyond = [-jnp.expm1(-far) / far]
    for k in range(1, count):
        beyond.append((1.0 / math.factorial(k) - beyond[-1]) / far)
    return tuple(jnp.where(small, n, f) for n, f in zip(values, beyond, strict=True))


def phi1(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """The first of `phi_functions`."""
    return phi_functions(x)[0]


def exp_mean(x: Float[Array, "..."], y: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""The mean of $e^{-xt - y(1-t)}$ over $t \in [0, 1]$, $(e^{-x} - e^{-y}) / (y - x)$ without cancellation.

    **Arguments:** `x`, `y`, non-negative, dimensionless, broadcastable shapes of one rank.
    **Returns:** the broadcast shape; $e^{-x}$ where x = y.
    **Valid:** x, y >= 0.
    **Source:** divided difference of the exponential.
    """
    # One comparison chooses both, so that the gradient at x = y is that of one branch.
    low, high = jnp.where(x < y, x, y), jnp.where(x < y, y, x)
    return jnp.exp(-low) * phi1(high - low)


def safe_sqrt(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """The square root with value 0 and gradient 0 where x <= 0.

    **Arguments:** `x`, any shape. **Returns:** the same shape. **Valid:** everywhere.
    """
    positive = x > 0.0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)
