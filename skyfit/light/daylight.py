"""The spectrum of daylight of a given colour: the CIE's mean and first two characteristic vectors."""

from functools import lru_cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Real

from ..numerics import check_wavelength, hat_weights
from ..tables import read_table
from .colour import observer_weights


# Preetham 1999 A.5: the denominator of M1 and M2, then their numerators, each times (1, x, y)
_WEIGHTS_OF_CHROMATICITY = np.array(
    [
        [0.0241, 0.2562, -0.7341],
        [-1.3515, -1.7703, 5.9114],
        [0.0300, -31.4424, 30.0717],
    ]
)
_LOWEST_Y = 0.01  # no visible light has a smaller chromaticity y


def daylight(
    x: Float[ArrayLike, "*direction"],
    y: Float[ArrayLike, "*direction"],
    wavelength_nm: Real[Array | np.ndarray, " wavelength"],
) -> Float[Array, "*direction wavelength"]:
    r"""Spectral radiance of daylight of chromaticity x, y, per unit of its luminance.

    $L = S_D / (683 \int S_D \bar y d\lambda)$, $S_D = S_0 + M_1 S_1 + M_2 S_2$,
    $M_1 = \frac{-1.3515 - 1.7703 x + 5.9114 y}{0.0241 + 0.2562 x - 0.7341 y}$,
    $M_2 = \frac{0.0300 - 31.4424 x + 30.0717 y}{0.0241 + 0.2562 x - 0.7341 y}$.
    Numerator and denominator of L are multiplied by the denominator of M, whose zeros are not singularities of L. The
    remaining denominator is y times a constant.

    **Arguments:** `x`, `y`, CIE 1931 chromaticity, `[direction]`; `wavelength_nm` nm.
    **Returns:** W m^-2 sr^-1 nm^-1 per cd m^-2, `[direction, wavelength]`. S is linear between its rows of 5 nm. The
    normalisation uses the whole S and does not depend on `wavelength_nm`.
    **Valid:** 300-830 nm; concrete wavelengths outside are a `ValueError`, traced ones get the value at the end.
    Where S_D is nowhere negative, the luminance is 1 and the chromaticity is x, y within 0.001. This holds at
    correlated colour temperatures of 4000 to 25000 K, for which the basis was made. Elsewhere negative S_D is replaced
    by 0, which raises the luminance: in Preetham's sky near a low sun, below 450 nm, by up to 0.14 % at turbidity 10.
    The divisor y is at least 0.01. Values and gradients are finite everywhere.
    **Source:** Preetham 1999 A.5 after Wyszecki & Stiles 1982; S of CIE 015:2018, whose 380-780 nm are his Table 2.

    **Example:**

        >>> wavelength = np.arange(380.0, 781.0, 5.0)
        >>> spectrum = skyfit.daylight(0.3127, 0.3290, wavelength)
        >>> round(float(skyfit.xyz(spectrum, wavelength)[1]), 3)
        1.0
    """
    table_nm = _basis_of_colour()[0]
    check_wavelength(wavelength_nm, table_nm[0], table_nm[-1], "of the spectrum of daylight")
    node, basis, share = (jnp.asarray(part, jnp.result_type(float)) for part in _basis_of_colour())
    colour = jnp.stack(jnp.broadcast_arrays(jnp.ones_like(x, node.dtype), x, y), axis=-1)
    at_wavelengths = jnp.matmul(hat_weights(jnp.asarray(wavelength_nm, node.dtype), node), basis, precision="highest")
    spectrum = jnp.matmul(colour, at_wavelengths.T, precision="highest")
    luminance = jnp.matmul(colour, share, precision="highest")
    return jnp.maximum(spectrum / jnp.maximum(luminance, _LOWEST_Y)[..., None], 0.0)


@lru_cache(maxsize=1)
def _basis_of_colour() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes in nm; the coefficients of 1, x and y in the numerator there, `[node, 3]`, and in its luminance, `[3]`."""
    table = read_table("cie_daylight_basis.csv")
    basis = np.stack([table["s0"], table["s1"], table["s2"]], axis=-1) @ _WEIGHTS_OF_CHROMATICITY
    luminance = observer_weights(table["wavelength_nm"])[:, 1] @ basis
    # With this scaling the luminance equals y within 0.003
    return table["wavelength_nm"], basis / luminance[2], luminance / luminance[2]
