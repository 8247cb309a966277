r"""Writes data/mie_kernels.npz: light scattered by spheres of narrow size classes, by refractive index.

A class holds unit volume of spheres, lognormal in the volume distribution about the size parameter $x_j$ with width
`CLASS_WIDTH`. A lognormal mode is a sum of classes with Gaussian weights, since a Gaussian of a Gaussian is one:
radius, width and wavelength then cost no table axis and no interpolation error.

Provenance: Mie's series summed here (log derivatives and psi_n downwards, chi_n upwards, Wiscombe's number of
terms: Bohren & Huffman 1983, ch. 4 and appendix A; Wiscombe 1980, Appl. Opt. 19, 1505); `main` holds single spheres
against miepython (MIT licence) before it writes. No measured data enter. Licence: that of this project.
Some two minutes and a half on one core.
"""

import time
from pathlib import Path

import miepython
import numpy as np
from scipy.interpolate import CubicSpline

from skyfit.numerics import chebyshev_nodes


DATA = Path(__file__).resolve().parents[2] / "data"
# ln of the classes' median size parameter; their spacing must be under that of the narrowest mode, 0.3, by some
CLASS_WIDTH, CLASS_STEP = 0.2, 0.25
LOG_SIZE = np.log(0.03) + CLASS_STEP * np.arange(40)
# Chebyshev nodes: of the real index, and of k / (k + c / x_j) of the imaginary one k, from 0 to its value at the top
INDEX_RANGE, INDEX_NODES = (1.33, 1.60), 11
ABSORPTION_TOP, ABSORPTION_SCALE, ABSORPTION_NODES = 0.1, 0.8, 8
# imaginary indices that Mie's series is summed for, the nodes of every class by a spline between; resonances without
# any absorption are too narrow for the sizes' steps
SUMMED = np.concatenate([[1e-6], 3e-4 * np.expm1(np.linspace(0.0, np.log1p(ABSORPTION_TOP / 3e-4), 20))[1:]])
# nodes of angle, uniform in u = a ln(1 + h / h0) + b h - c ln(1 - h / (1 + h1)), h the haversine
ANGLE_NODES = 116
ANGLE_MAP = np.array([4.0, 1.7e-6, 24.0, 5.0, 4e-4])


def haversines():
    """Haversines of the angular nodes, from 0 to 1, by bisection of the map."""
    a, h0, b, c, h1 = ANGLE_MAP

    def mapped(h):
        return a * np.log1p(h / h0) + b * h - c * np.log1p(-h / (1.0 + h1))

    wanted = mapped(1.0) * np.arange(ANGLE_NODES) / (ANGLE_NODES - 1)
    lower, upper = np.zeros(ANGLE_NODES), np.ones(ANGLE_NODES)
    for _ in range(80):
        middle = 0.5 * (lower + upper)
        above = mapped(middle) > wanted
        lower, upper = np.where(above, lower, middle), np.where(above, middle, upper)
    nodes = 0.5 * (lower + upper)
    nodes[0], nodes[-1] = 0.0, 1.0
    return nodes


def sizes():
    """Size parameters and their weights in ln x: resonances want steps of 0.05 in x, where they are not yet many."""
    begin, end = LOG_SIZE[0] - 4.0 * CLASS_WIDTH, LOG_SIZE[-1] + 4.0 * CLASS_WIDTH
    small = np.arange(begin, np.log(2.5), 0.02)
    middle = np.log(np.arange(2.5, 200.0, 0.05))
    large = np.arange(np.log(200.0), end, 0.00025)
    log_size = np.concatenate([small, middle, large])
    return np.exp(log_size), np.gradient(log_size)


def terms(size):
    return (size + 4.05 * np.cbrt(size) + 2.0).astype(int)


def coefficients(size, index):
    """Mie's a_n and b_n, `[index, order, size]`, of spheres of nearly one size; n + i k, k >= 0."""
    last = int(terms(size).max())
    inner = index[:, None] * size[None]
    reach = max(last, np.abs(inner).max())
    start = int(reach + 6.0 * np.cbrt(reach)) + 16
    derivative = np.zeros((last, *inner.shape), complex)
    current = np.zeros_like(inner)
    inverse = 1.0 / inner
    for n in range(start, 1, -1):
        if n <= last:
            derivative[n - 1] = current
        ratio = n * inverse
        current = ratio - 1.0 / (current + ratio)
    derivative[0] = current
    # psi is the decaying solution: from far above down, scaled by the larger of its two first
    above = last + 25 + int(1.5 * np.sqrt(size.max()))
    psi, chi = np.zeros((above + 2, len(size))), np.zeros((last + 1, len(size)))
    psi[above] = 1e-280
    for n in range(above, 0, -1):
        psi[n - 1] = (2 * n + 1) / size * psi[n] - psi[n + 1]
    first = np.sin(size), np.sin(size) / size - np.cos(size)
    larger = np.abs(first[0]) > np.abs(first[1])
    psi = psi[: last + 1] * np.where(larger, first[0] / psi[0], first[1] / psi[1])
    chi[0], chi[1] = np.cos(size), np.cos(size) / size + np.sin(size)
    for n in range(1, last):
        chi[n + 1] = (2 * n + 1) / size * chi[n] - chi[n - 1]
    xi = psi - 1j * chi
    order = np.arange(1, last + 1)[:, None]
    found = []
    for factor in (1.0 / index, index):
        with np.errstate(all="ignore"):
            temp = derivative * factor[:, None] + (order / size[None])[:, None]
            top = temp * psi[1:, None] - psi[:-1, None]
            bottom = temp * xi[1:, None] - xi[:-1, None]
            found.append(np.where((order <= terms(size)[None])[:, None], top / bottom, 0.0))
    return [np.moveaxis(v, 1, 0) for v in found]


def angular(cosine, last):
    """The functions pi_n and tau_n times (2 n + 1) / (n (n + 1)), `[order, angle]`."""
    pi, tau = np.zeros((last, len(cosine))), np.zeros((last, len(cosine)))
    before, now = np.zeros_like(cosine), np.ones_like(cosine)
    for n in range(1, last + 1):
        scale = (2 * n + 1) / (n * (n + 1))
        pi[n - 1] = scale * now
        tau[n - 1] = scale * (n * cosine * now - (n + 1) * before)
        before, now = now, ((2 * n + 1) * cosine * now - (n + 1) * before) / n
    return pi.astype(np.float32), tau.astype(np.float32)


def spheres(size, index, cosine, block=96):
    """Efficiencies of extinction and scattering `[index, size]`, and F11, F12, F33 `[index, 3, size, angle]`."""
    pi, tau = angular(cosine, int(terms(size).max()))
    efficiency = np.zeros((2, len(index), len(size)))
    elements = np.zeros((len(index), 3, len(size), len(cosine)))
    for begin in range(0, len(size), block):
        some = slice(begin, begin + block)
        a, b = coefficients(size[some], index)
        last = a.shape[1]
        weight = (2 * np.arange(1, last + 1) + 1)[None, :, None]
        efficiency[0][:, some] = 2.0 * np.sum(weight * (a + b).real, axis=1) / size[some] ** 2
        efficiency[1][:, some] = 2.0 * np.sum(weight * (np.abs(a) ** 2 + np.abs(b) ** 2), axis=1) / size[some] ** 2
        for i in range(len(index)):
            parts = np.concatenate([a[i].real, a[i].imag, b[i].real, b[i].imag], axis=1).T.astype(np.float32)
            on_pi, on_tau = parts @ pi[:last], parts @ tau[:last]
            count = a.shape[2]
            pieces = [np.split(v, [count, 2 * count, 3 * count]) for v in (on_pi, on_tau)]
            (ar_pi, ai_pi, br_pi, bi_pi), (ar_tau, ai_tau, br_tau, bi_tau) = pieces
            first = ar_pi + br_tau + 1j * (ai_pi + bi_tau)
            second = ar_tau + br_pi + 1j * (ai_tau + bi_pi)
            squares = np.abs(first) ** 2, np.abs(second) ** 2
            elements[i, 0, some] = 0.5 * (squares[1] + squares[0])
            elements[i, 1, some] = 0.5 * (squares[1] - squares[0])
            elements[i, 2, some] = (first * second.conj()).real
    return efficiency[0], efficiency[1], elements


def kernels(index, cosine):
    """Extinction and scattering times wavelength, per volume, `[index, class]`; F `[index, 3, class, angle]`.

    The elements are per steradian: the integral of F11 over solid angle is the scattering.
    """
    size, step = sizes()
    offset = (np.log(size)[None] - LOG_SIZE[:, None]) / CLASS_WIDTH
    weight = np.exp(-0.5 * offset**2) * step[None]
    weight /= weight.sum(axis=1, keepdims=True)
    extinction, scattering, elements = spheres(size, index, cosine)
    return (
        (1.5 * np.pi * extinction / size) @ weight.T,
        (1.5 * np.pi * scattering / size) @ weight.T,
        (weight * 1.5 / size**3) @ elements,
    )


def check():
    """Single spheres as miepython has them."""
    size, cosine = np.array([0.02, 0.3, 4.0, 37.0, 600.0]), np.cos(np.radians([0.0, 0.5, 20.0, 95.0, 178.0, 180.0]))
    for index in (1.33 + 0j, 1.47 + 0.004j, 1.6 + 0.1j):
        for x in size:
            extinction, scattering, elements = spheres(np.array([x]), np.array([index]), cosine)
            q_ext, q_sca, _, _ = miepython.efficiencies_mx(index.conjugate(), x)
            # their norm "qsca" integrates |S|^2 to Q_sca: |S|^2 over pi x^2
            s1, s2 = miepython.S1_S2(index.conjugate(), x, cosine, norm="qsca")
            scale = np.pi * x**2
            theirs = np.stack(
                [
                    0.5 * (abs(s2) ** 2 + abs(s1) ** 2),
                    0.5 * (abs(s2) ** 2 - abs(s1) ** 2),
                    np.real(s1 * np.conj(s2)),
                ]
            )
            ours = np.array([extinction[0, 0], scattering[0, 0]])
            np.testing.assert_allclose(ours, np.array([q_ext, q_sca]), rtol=1e-7)
            np.testing.assert_allclose(elements[0, :, 0] / scale, theirs, rtol=1e-3, atol=1e-6 * theirs[0].max())


def absorption_nodes():
    """Imaginary indices of the nodes, `[class, node]`."""
    scale = ABSORPTION_SCALE * np.exp(-LOG_SIZE)[:, None]
    share = 0.5 * (1.0 + chebyshev_nodes(ABSORPTION_NODES)) * ABSORPTION_TOP / (ABSORPTION_TOP + scale)
    return scale * share / (1.0 - share)


def at_nodes(values):
    """From `[summed, class, ...]` to the nodes of absorption, `[class, node, ...]`."""
    abscissa, wanted = np.log1p(SUMMED / 3e-4), np.log1p(absorption_nodes() / 3e-4)
    return np.stack([CubicSpline(abscissa, values[:, j])(wanted[j]) for j in range(len(LOG_SIZE))])


def rounded(logarithm):
    """To 1 / 16384, so that the file packs well."""
    return (np.round(logarithm * 16384.0) / 16384.0).astype(np.float32)


def main():
    check()
    begin = time.perf_counter()
    lower, upper = INDEX_RANGE
    half = haversines()
    rows = []
    for n in lower + (upper - lower) * 0.5 * (1.0 + chebyshev_nodes(INDEX_NODES)):
        extinction, scattering, elements = kernels(n + 1j * SUMMED, 1.0 - 2.0 * half)
        absorption = (extinction - scattering) / SUMMED[:, None]
        found = np.log(scattering), np.log(absorption), np.log(elements[:, 0])
        rows.append([at_nodes(v) for v in (*found, *(elements[:, i] / elements[:, 0] for i in (1, 2)))])
        print(f"n = {n:.4f}: {time.perf_counter() - begin:.0f} s", flush=True)
    # [class, index, absorption, ...]
    scattering, absorption, value, second, third = (np.stack(v, axis=1) for v in zip(*rows, strict=True))
    np.savez_compressed(
        DATA / "mie_kernels.npz",
        about=np.array(
            "source: Mie theory for homogeneous spheres, made by experiments/tables/make_mie_tables.py and held "
            "against "
            f"miepython {miepython.__version__}; licence: that of this project. Axes: class (log_size, ln of the "
            "median size parameter of unit volume of spheres, lognormal of class_width), Chebyshev nodes of the real "
            "index over index_range, Chebyshev nodes of k / (k + absorption_scale / x) from 0 to its value at "
            "absorption_top, angle (haversine, uniform in a ln(1 + h / h0) + b h - c ln(1 - h / (1 + h1)), angle_map "
            "= a, h0, b, c, h1). log_scattering and log_absorption: of scattering, and of absorption over k, times "
            "wavelength per volume; log_value: of F11 per steradian, whose integral is the scattering; ratio_12, "
            "ratio_33: F12 and F33 over F11."
        ),
        log_size=LOG_SIZE,
        class_width=CLASS_WIDTH,
        index_range=np.array(INDEX_RANGE),
        absorption_top=ABSORPTION_TOP,
        absorption_scale=ABSORPTION_SCALE,
        angle_map=ANGLE_MAP,
        haversine=half,
        log_scattering=rounded(scattering),
        log_absorption=rounded(absorption),
        log_value=rounded(value),
        ratio_12=second.astype(np.float16),
        ratio_33=third.astype(np.float16),
    )


if __name__ == "__main__":
    main()
