"""Functions whose textbook form cancels or divides by zero; inputs are guarded, so gradients stay finite."""

import jax.numpy as jnp
from jaxtyping import Array, Float


_SERIES_LIMIT = 0.5
_SERIES_TERMS = 12


def _series(x, first_factorial: int):
    """sum_k (-x)^k first! / (k + first)!, by Horner."""
    total = jnp.ones_like(x)
    for k in range(_SERIES_TERMS, 0, -1):
        total = 1.0 - x / (k + first_factorial) * total
    return total


def phi1(x: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""The mean of $e^{-xt}$ over $t \in [0, 1]$, $\varphi_1(x) = (1 - e^{-x}) / x$.

    **Arguments:** `x`, dimensionless, any shape.
    **Returns:** the same shape; 1 at x = 0.
    **Valid:** x > -80 in float32; a series takes over near 0, so value and gradient keep all digits.
    **Source:** Hochbruck & Ostermann 2010, Exponential integrators, eq. 2.10.
    """
    small = jnp.abs(x) < _SERIES_LIMIT
    safe = jnp.where(small, 1.0, x)
    return jnp.where(small, _series(jnp.where(small, x, 0.0), 1), -jnp.expm1(-safe) / safe)


def phi2(x: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""The mean of $(1 - t) e^{-xt}$ over $t \in [0, 1]$, $\varphi_2(x) = (x - 1 + e^{-x}) / x^2$.

    **Arguments:** `x`, dimensionless, any shape.
    **Returns:** the same shape; 1/2 at x = 0.
    **Valid:** as `phi1`.
    **Source:** Hochbruck & Ostermann 2010, eq. 2.10.
    """
    small = jnp.abs(x) < _SERIES_LIMIT
    safe = jnp.where(small, 1.0, x)
    return jnp.where(
        small, 0.5 * _series(jnp.where(small, x, 0.0), 2), (safe + jnp.expm1(-safe)) / (safe * safe)
    )


def exp_mean(x: Float[Array, "..."], y: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""The mean of $e^{-xt - y(1-t)}$ over $t \in [0, 1]$, $(e^{-x} - e^{-y}) / (y - x)$ without cancellation.

    **Arguments:** `x`, `y`, non-negative, dimensionless, broadcastable shapes of one rank.
    **Returns:** the broadcast shape; $e^{-x}$ where x = y.
    **Valid:** x, y >= 0.
    **Source:** divided difference of the exponential.
    """
    return jnp.exp(-jnp.minimum(x, y)) * phi1(jnp.abs(x - y))


def safe_sqrt(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """The square root with value 0 and gradient 0 where x <= 0.

    **Arguments:** `x`, any shape. **Returns:** the same shape. **Valid:** everywhere.
    """
    positive = x > 0.0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)
