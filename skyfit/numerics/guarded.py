"""Functions whose textbook form cancels or divides by zero; inputs are guarded, so gradients stay finite."""

import jax.numpy as jnp
from jaxtyping import Array, Float


_SERIES_LIMIT = 0.5


def phi_functions(x: Float[Array, "..."]) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    r"""$\varphi_1(x) = (1 - e^{-x}) / x$ and $\varphi_2(x) = (x - 1 + e^{-x}) / x^2$, all digits kept.

    The means of $e^{-xt}$ and of $(1 - t) e^{-xt}$ over $t \in [0, 1]$.

    **Arguments:** `x`, dimensionless, any shape.
    **Returns:** two arrays of that shape; 1 and 1/2 at x = 0.
    **Valid:** x > -80 in float32; a series takes over near 0, so values and gradients keep all digits.
    **Source:** Hochbruck & Ostermann 2010, Exponential integrators, eq. 2.10.
    """
    small = jnp.abs(x) < _SERIES_LIMIT
    near, far = jnp.where(small, x, 0.0), jnp.where(small, 1.0, x)
    series = jnp.ones_like(x)
    for k in range(7 if x.dtype == jnp.float32 else 13, 0, -1):
        series = 1.0 - near / (k + 2) * series
    near_second = 0.5 * series
    far_first = -jnp.expm1(-far) / far
    first = jnp.where(small, 1.0 - near * near_second, far_first)
    return first, jnp.where(small, near_second, (1.0 - far_first) / far)


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
    # chosen by one comparison, so that the gradient at x = y is that of one branch
    low, high = jnp.where(x < y, x, y), jnp.where(x < y, y, x)
    return jnp.exp(-low) * phi1(high - low)


def safe_sqrt(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """The square root with value 0 and gradient 0 where x <= 0.

    **Arguments:** `x`, any shape. **Returns:** the same shape. **Valid:** everywhere.
    """
    positive = x > 0.0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)
