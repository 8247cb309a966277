"""Associated Legendre functions and their kin of spin two, normalised so that the addition theorem has weight one."""

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


def spin_legendre(
    cosine: Float[Array, " *shape"], sine: Float[Array, " *shape"], modes: int, degrees: int
) -> tuple[Float[Array, "degree mode *shape"], Float[Array, "degree mode *shape"]]:
    r"""The functions $R_l^m$ and $T_l^m$ of the Stokes parameters Q and U, with the sign and scale of $\Lambda_l^m$.

    Wigner's $R = (-1)^m (d^l_{m2} + d^l_{m,-2}) / 2$ and $T = (-1)^m (d^l_{m,-2} - d^l_{m2}) / 2$, by
    $F_{l+1} = a\mu F_l + b G_l - c F_{l-1}$ with F, G = R, T and T, R.

    **Arguments:** as `associated_legendre`. **Returns:** R and T, `[degree, mode, *shape]`, zero where l < m or l < 2.
    **Valid:** every angle; the sine enters as given, so gradients at the zenith are finite.
    **Source:** Siewert 1982, Astron. Astrophys. 109, 195; de Rooij & van der Stap 1984, ibid. 131, 237. Their T has the
    other sign: with this one the coupling of the cosines of I and Q to the sines of U is symmetric.
    """
    mode = np.arange(modes)
    first = np.maximum(mode, 2)
    lower = np.arange(degrees - 1)[:, None]
    inside = lower >= first
    above, below = lower + 1, np.where(inside, lower, 2)
    scale = below * np.sqrt(np.where(inside, (above**2 - mode**2) * (above**2 - 4.0), 1.0))
    a = np.where(inside, (2 * lower + 1) * lower * above / scale, 0.0)
    b = np.where(inside, 2.0 * (2 * lower + 1) * mode / scale, 0.0)
    c = np.where(inside, above * np.sqrt(np.maximum((below**2 - mode**2) * (below**2 - 4.0), 0.0)) / scale, 0.0)
    begins = (above == first).astype(float)

    # from m = 2 on k_m sin^(m - 2): sqrt((2 m)! / ((m - 2)! (m + 2)!)) / 2^m, by its ratio to the one before
    corner, starts = 0.25 * jnp.ones_like(cosine), []
    for m in range(modes):
        if m == 0:
            starts.append((np.sqrt(0.375) * sine**2, 0.0 * sine))
        elif m == 1:
            starts.append((-0.5 * sine * cosine, 0.5 * sine))
        else:
            if m > 2:
                corner = corner * sine * np.sqrt(m * (2 * m - 1) / (2.0 * (m - 2) * (m + 2)))
            starts.append((corner * (1.0 + cosine**2), -2.0 * corner * cosine))
    start = jnp.stack([jnp.stack([r, t]) for r, t in starts], axis=1)
    expand = (None, ...) + (None,) * cosine.ndim

    def step(carry, row):
        previous, current = carry
        a, b, c, begins = (v[expand] for v in row)
        following = a * cosine[None, None] * current + b * current[::-1] - c * previous + begins * start
        return (current, following), following

    zero = jnp.zeros_like(start)
    rows = tuple(jnp.asarray(r, cosine.dtype) for r in (a, b, c, begins))
    _, rest = jax.lax.scan(step, (zero, zero), rows)
    every = jnp.concatenate([zero[None], rest])
    return every[:, 0], every[:, 1]
