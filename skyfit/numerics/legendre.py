"""Associated Legendre functions, normalised so that the addition theorem has weight one."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


def associated_legendre(
    cosine: Float[Array, " *shape"], sine: Float[Array, " *shape"], modes: int, degrees: int
) -> Float[Array, "degree mode *shape"]:
    r"""$\Lambda_l^m = \sqrt{(l-m)!/(l+m)!}\, P_l^m$ for l < degrees, m < modes (without the phase (-1)^m).

    $\sqrt{l^2-m^2}\,\Lambda_l^m = (2l-1)\mu\,\Lambda_{l-1}^m - \sqrt{(l-1)^2-m^2}\,\Lambda_{l-2}^m$.

    **Arguments:** `cosine`, `sine` of the zenith angle; sizes `modes` and `degrees`.
    **Returns:** `[degree, mode, *shape]`, zero where l < m. $P_l(\cos\gamma) = \sum_m (2-\delta_{m0})
    \Lambda_l^m(\mu) \Lambda_l^m(\mu') \cos m\Delta\phi$.
    **Valid:** every angle; the sine enters as given, so gradients at the zenith are finite.
    **Source:** recurrence 14.10.3 of the NIST Digital Library of Mathematical Functions, rescaled.
    """
    m = np.arange(modes)
    degree = np.arange(1, degrees)[:, None]
    inside = degree > m
    root = np.sqrt(np.where(inside, degree**2 - m**2, 1))
    first = np.where(inside, (2 * degree - 1) / root, 0.0)
    second = np.where(inside, np.sqrt(np.maximum((degree - 1) ** 2 - m**2, 0)) / root, 0.0)
    start = (degree == m).astype(float)
    diagonal = np.sqrt((2 * degree[:, 0] - 1) / (2 * degree[:, 0]))
    dtype = cosine.dtype
    expand = (...,) + (None,) * cosine.ndim

    def step(carry, row):
        previous, current, corner = carry
        a, b, begins, ratio = row
        corner = corner * ratio * sine
        following = a[expand] * cosine[None] * current - b[expand] * previous + begins[expand] * corner[None]
        return (current, following, corner), following

    zero = jnp.zeros((modes, *cosine.shape), dtype) + 0.0 * cosine[None]
    at_zero = zero.at[0].set(1.0)
    rows = tuple(jnp.asarray(r, dtype) for r in (first, second, start, diagonal))
    _, rest = jax.lax.scan(step, (zero, at_zero, jnp.ones_like(cosine)), rows)
    return jnp.concatenate([at_zero[None], rest])
