"""Quadrature rules; nodes are host-side constants, fixed at trace time."""

import functools

import numpy as np


@functools.lru_cache(maxsize=32)
def gauss_legendre(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights on (0, 1), exact for polynomials of degree 2 count - 1.

    **Arguments:** `count`, the number of nodes (>= 1).
    **Returns:** nodes and weights, each `[count]`; weights sum to 1.
    **Source:** numpy.polynomial.legendre.leggauss.
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 * (nodes + 1.0), 0.5 * weights
