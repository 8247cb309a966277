"""The relative optical length of a path through the air."""

import jax.numpy as jnp
import numpy as np

from ..numerics import check_radians


def relative_airmass(zenith):
    r"""Optical length of a path to space relative to the vertical path.

    $1 / (\cos\theta + 0.15\,(93.885 - \theta)^{-1.253})$, $\theta$ in degrees in the second term.

    **Arguments:** `zenith`, radians, any shape. **Returns:** dimensionless, the same shape.
    **Valid:** 0 to pi, else `ValueError`. The formula holds to the horizon, where it gives 36.5; below, that value is
    held with gradient zero. As printed the formula decreases again beyond 91 degrees and is NaN past 93.885.
    **Source:** Kasten 1965; Preetham 1999, A.1; Hoffman & Preetham 2002, eq. 5.
    """
    check_radians("zenith", zenith, 0.0, np.pi)
    above = jnp.minimum(zenith, 0.5 * np.pi)
    return 1.0 / (jnp.maximum(jnp.cos(above), 0.0) + 0.15 * (93.885 - jnp.rad2deg(above)) ** -1.253)
