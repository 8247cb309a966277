"""Associated Legendre functions, and those of spin two, normalised so that the addition theorem has weight one.

All are short Fourier series of the zenith angle with constant coefficients. For a traced angle only the cosines and
sines of its multiples and one product of matrices are computed.
"""

import functools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


def associated_legendre(
    zenith: Float[Array | np.ndarray, " *shape"], modes: int, degrees: int
) -> Float[Array | np.ndarray, "degree mode *shape"]:
    r"""$\Lambda_l^m = \sqrt{(l-m)!/(l+m)!}\, P_l^m(\cos\theta)$ for l < degrees, m < modes (without the phase (-1)^m).

    **Arguments:** `zenith` angle; sizes `modes` and `degrees`.
    **Returns:** `[degree, mode, *shape]`, zero where l < m; numpy arrays give numpy arrays. $P_l(\cos\gamma) = \sum_m
    (2-\delta_{m0}) \Lambda_l^m(\theta) \Lambda_l^m(\theta') \cos m\Delta\phi$.
    **Valid:** every angle in [0, pi], with finite gradients.
    """
    return of_angle(legendre_series(modes, degrees), zenith)


def spin_legendre(
    zenith: Float[Array | np.ndarray, " *shape"], modes: int, degrees: int
) -> Float[Array | np.ndarray, "function degree mode *shape"]:
    r"""The functions $R_l^m$ and $T_l^m$ of the Stokes parameters Q and U, with the sign and scale of $\Lambda_l^m$.

    Wigner's $R = (-1)^m (d^l_{m2} + d^l_{m,-2}) / 2$ and $T = (-1)^m (d^l_{m,-2} - d^l_{m2}) / 2$.

    **Arguments:** as `associated_legendre`. **Returns:** R and T, `[degree, mode, *shape]`, zero where l < m or l < 2.
    **Valid:** every angle in [0, pi], with finite gradients.
    """
    return of_angle(spin_series(modes, degrees), zenith)


def of_angle(
    series: Float[np.ndarray, "*function term"], zenith: Float[Array | np.ndarray, " *shape"]
) -> Float[Array | np.ndarray, "..."]:
    """Fourier series at zenith angles; `series` has the terms of cos(0), cos(angle), .., then those of the sines."""
    xp = np if isinstance(zenith, np.ndarray) else jnp
    multiple = np.arange(series.shape[-1] // 2).astype(zenith.dtype).reshape(-1, *[1] * zenith.ndim) * zenith[None]
    return xp.tensordot(xp.asarray(series, zenith.dtype), xp.concatenate([xp.cos(multiple), xp.sin(multiple)]), 1)


@functools.lru_cache(maxsize=32)
def legendre_series(modes: int, degrees: int) -> np.ndarray:
    r"""Fourier series of `associated_legendre`, `[degree, mode, term]`, for `of_angle`.

    $\sqrt{l^2-m^2}\,\Lambda_l^m = (2l-1)\mu\,\Lambda_{l-1}^m - \sqrt{(l-1)^2-m^2}\,\Lambda_{l-2}^m$.

    **Source:** recurrence 14.10.3 of the NIST Digital Library of Mathematical Functions, rescaled.
    """
    zenith = _angles(degrees)
    cosine, sine = np.cos(zenith), np.sin(zenith)
    values = np.zeros((degrees, modes, degrees))
    values[0, 0] = 1.0
    corner = np.ones(degrees)
    for degree in range(1, degrees):
        corner = corner * np.sqrt((2 * degree - 1) / (2 * degree)) * sine
        mode = np.arange(min(degree, modes))[:, None]
        last = np.sqrt(np.maximum((degree - 1) ** 2 - mode**2, 0)) * values[degree - 2, : len(mode)]
        following = (2 * degree - 1) * cosine * values[degree - 1, : len(mode)] - last
        values[degree, : len(mode)] = following / np.sqrt(degree**2 - mode**2)
        if degree < modes:
            values[degree, degree] = corner
    return _fourier(values)


@functools.lru_cache(maxsize=32)
def spin_series(modes: int, degrees: int) -> np.ndarray:
    r"""Fourier series of `spin_legendre`, `[function, degree, mode, term]`, for `of_angle`.

    $F_{l+1} = a\mu F_l + b G_l - c F_{l-1}$ with F, G = R, T and T, R.

    **Source:** Siewert 1982, Astron. Astrophys. 109, 195; de Rooij & van der Stap 1984, ibid. 131, 237. Their T has the
    other sign: with this one the coupling of the cosines of I and Q to the sines of U is symmetric.
    """
    zenith = _angles(degrees)
    cosine, sine = np.cos(zenith), np.sin(zenith)
    values = np.zeros((2, degrees, modes, degrees))
    # From m = 2 on, k_m sin^(m - 2) with k_m = sqrt((2 m)! / ((m - 2)! (m + 2)!)) / 2^m, by its ratio to the last one.
    corner = 0.25 * np.ones(degrees)
    for m in range(modes):
        if m > 2:
            corner = corner * sine * np.sqrt(m * (2 * m - 1) / (2.0 * (m - 2) * (m + 2)))
        first = max(m, 2)
        if first >= degrees:
            break
        values[:, first, m] = (
            [np.sqrt(0.375) * sine**2, 0.0 * sine],
            [-0.5 * sine * cosine, 0.5 * sine],
            [corner * (1.0 + cosine**2), -2.0 * corner * cosine],
        )[min(m, 2)]
        for degree in range(first, degrees - 1):
            above = degree + 1
            scale = degree * np.sqrt((above**2 - m**2) * (above**2 - 4.0))
            a, b = (2 * degree + 1) * degree * above / scale, 2.0 * (2 * degree + 1) * m / scale
            c = above * np.sqrt((degree**2 - m**2) * (degree**2 - 4.0)) / scale
            now, last = values[:, degree, m], values[:, degree - 1, m]
            values[:, above, m] = a * cosine * now + b * now[::-1] - c * last
    return _fourier(values)


def _angles(count: int) -> np.ndarray:
    return np.pi * (np.arange(count) + 0.5) / count


def _fourier(values: np.ndarray) -> np.ndarray:
    """Fourier series of functions at `_angles`, `[..., mode, angle]`: cosines for even modes, sines for odd ones."""
    count = values.shape[-1]
    multiple = np.arange(count)[:, None] * _angles(count)[None]
    basis = np.stack([np.cos(multiple), np.sin(multiple)]) * np.where(np.arange(count) > 0, 2.0, 1.0)[:, None] / count
    odd = np.arange(values.shape[-2]) % 2
    series = np.einsum("...ma,pta->...mpt", values, basis)
    kept = np.arange(2) == odd[:, None]
    return (series * kept[..., None]).reshape(*values.shape[:-1], 2 * count)
