"""Losses that grow less than the square of a residual, so that outliers count less."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from ..measured.noise import Loss


# standard deviation of normal deviates over their median size
_MEDIAN_SIZE = 1.4826


class Robust(NamedTuple):
    """A whitened residual after the loss: `value`, whose square is the loss, its `slope`, and the sample's `weight`."""

    value: Array
    slope: Array
    weight: Array


def robust(residual: Array, loss: Loss, threshold: Float[ArrayLike, ""]) -> Robust:
    r"""Transform residuals so that they grow less than linearly beyond a threshold $k$.

    Huber: $f^2 = 2 k |z| - k^2$ beyond k; Cauchy: $f^2 = k^2 \ln(1 + z^2 / k^2)$. With $w = f f' / z$ the weight of
    iteratively reweighted least squares, the gradient of $\frac12 f^2$ is that of the reweighted residuals.

    **Arguments:** `residual`, divided by sigma; `threshold` k in standard deviations.
    **Source:** Huber 1964, Ann. Math. Stat. 35, 73; Holland & Welsch 1977, Commun. Stat. A6, 813.
    """
    one = jnp.ones_like(residual)
    if loss == "squares":
        return Robust(residual, one, one)
    size = jnp.abs(residual)
    if loss == "huber":
        far = size > threshold
        beyond = jnp.where(far, size, threshold)
        root = jnp.sqrt(2.0 * threshold * beyond - threshold**2)
        value = jnp.where(far, jnp.sign(residual) * root, residual)
        return Robust(value, jnp.where(far, threshold / root, 1.0), jnp.where(far, threshold / beyond, 1.0))
    square = (residual / threshold) ** 2
    # ln(1 + s) / s is 1 at 0
    safe = jnp.where(square > 1e-6, square, 1.0)
    share = jnp.where(square > 1e-6, jnp.sqrt(jnp.log1p(safe) / safe), 1.0 - 0.25 * square)
    weight = 1.0 / (1.0 + square)
    return Robust(residual * share, weight / share, weight)


def typical_size(residual: Float[Array, "*time sample"], held: Bool[Array, "*time sample"]) -> Float[Array, "*time"]:
    """The standard deviation of normal residuals with a few outliers, from their median size; NaN if none is held."""
    held = held & ~jnp.isnan(residual)
    ordered = jnp.sort(jnp.where(held, jnp.abs(residual), jnp.inf), axis=-1)
    count = jnp.sum(held, axis=-1, keepdims=True)
    middle = jnp.concatenate([jnp.maximum(count - 1, 0) // 2, count // 2], axis=-1)
    median = jnp.mean(jnp.take_along_axis(ordered, middle, axis=-1), axis=-1)
    return jnp.where(count[..., 0] > 0, _MEDIAN_SIZE * median, jnp.nan)
