"""The float type of a process, which is the same for all arrays and set by the application."""

import jax.numpy as jnp
import numpy as np


def as_float(value):
    """An array of the process's default float type."""
    dtype = jnp.result_type(float)
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        # converted here, where JAX would compile a program for each shape
        with np.errstate(all="ignore"):
            value = value.astype(dtype, copy=False)
    return jnp.asarray(value, dtype)
