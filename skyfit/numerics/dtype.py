"""The float type of a process, which is the same for all arrays and set by the application."""

import jax.numpy as jnp


def as_float(value):
    """An array of the process's default float type."""
    return jnp.asarray(value, jnp.result_type(float))
