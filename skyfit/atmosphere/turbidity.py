"""Turbidity: its relation to the optical depth of haze and to the meteorological range."""

import math
from typing import Literal

import jax.numpy as jnp
import numpy as np

from ..numerics import check_range
from ..tables import read_table
from .phase import REFERENCE_WAVELENGTH
from .profile import HAZE_SCALE_HEIGHT
from .rayleigh import AIR_OPTICAL_LENGTH, bodhaine_optical_depth


Relation = Literal["definition", "sunlight", "scattering"]

# Preetham 1999, A.1: beta = 0.04608 T - 0.04586 at 1 um
_BETA_SLOPE, _BETA_OFFSET = 0.04608, -0.04586
# Preetham 1999, A.1, after Angstrom
ANGSTROM_EXPONENT = 1.3
# Preetham 1999, A.3: c = (0.6544 T - 0.6510) 1e-18 with wavelengths in m; the paper prints 1e-16
_CONCENTRATION_SLOPE, _CONCENTRATION_OFFSET = 0.6544e-18, -0.6510e-18
# Preetham 1999, sec. 2.1: the eye's contrast threshold is 0.02, so an optical depth of 3.912 hides a black target
_RANGE_DEPTH = -math.log(0.02)
# Smallest range, m; shorter ranges are raised to it
_SHORTEST_RANGE = 1.0
# Largest turbidity; such air is opaque
_MOST_TURBIDITY = 1e4


def angstrom_coefficient(turbidity):
    r"""Angstrom's turbidity coefficient at 1 um, $\beta = 0.04608\,T - 0.04586$.

    **Arguments:** `turbidity`. **Returns:** dimensionless; the haze's optical depth is $\beta \lambda^{-\alpha}$,
    $\lambda$ in um.
    **Valid:** T from 0.9952, else `ValueError`; traced values below give 0.
    **Source:** Preetham 1999, A.1.
    """
    check_turbidity(turbidity, -_BETA_OFFSET / _BETA_SLOPE)
    return jnp.maximum(_BETA_SLOPE * turbidity + _BETA_OFFSET, 0.0)


def check_turbidity(turbidity, low: float = 1.0) -> None:
    """Raise `ValueError` if a concrete turbidity is below `low`, that of air without haze, or above 1e4."""
    check_range("turbidity", turbidity, low, _MOST_TURBIDITY)


def _line(relation: Relation) -> tuple[float, float]:
    """Slope and offset of the haze's optical depth at 550 nm as a linear function of turbidity."""
    if relation == "definition":
        air = float(bodhaine_optical_depth(REFERENCE_WAVELENGTH))
        return air, -air
    if relation == "sunlight":
        at_550 = (1e-3 * REFERENCE_WAVELENGTH) ** -ANGSTROM_EXPONENT
        return _BETA_SLOPE * at_550, _BETA_OFFSET * at_550
    if relation == "scattering":
        table = read_table("preetham_table2_spectra.csv")
        efficiency = float(np.interp(REFERENCE_WAVELENGTH, table["wavelength_nm"], table["haze_scattering"]))
        # A.3 with v = 4, times the scale height of A.4
        per_concentration = 0.434 * math.pi * (2.0 * math.pi / (REFERENCE_WAVELENGTH * 1e-9)) ** 2 * efficiency
        column = per_concentration * HAZE_SCALE_HEIGHT
        return column * _CONCENTRATION_SLOPE, column * _CONCENTRATION_OFFSET
    raise ValueError(f'`relation` must be "definition", "sunlight" or "scattering", got {relation!r}')


def turbidity_to_optical_depth(turbidity, relation: Relation = "definition"):
    r"""Aerosol optical depth at 550 nm from turbidity.

    "definition": $(T - 1)\,\tau_R(550)$ with the sea-level Rayleigh depth. "sunlight": $\beta\, 0.55^{-1.3}$ with
    `angstrom_coefficient`. "scattering": $0.434\, c\, \pi (2\pi/\lambda)^2 K \cdot 1200$ m, with
    $c = (0.6544\,T - 0.6510)\cdot 10^{-18}$ and $\lambda$ in m.

    **Arguments:** `turbidity` >= 1; `relation`, one of the paper's three statements.
    **Returns:** dimensionless: 0.0971, 0.1007 and 0.0952 at T = 2.
    **Valid:** T from 1 ("sunlight": 0.9952, "scattering": 0.9948), where the optical depth is 0, else `ValueError`;
    traced values below continue along the line, to a negative optical depth.
    **Source:** Preetham 1999, sec. 2.1, T = (t_m + t_h) / t_m at 550 nm; A.1; A.3 and the scale height of A.4. A.3
    prints $10^{-16}$: the haze of T = 2 would then have an optical depth of 9.5 and T by sec. 2.1 be 80.8.

    **Example:**

        >>> round(float(skyfit.turbidity_to_optical_depth(3.0)), 3)
        0.194
    """
    slope, offset = _line(relation)
    check_turbidity(turbidity, -offset / slope)
    if relation == "definition":
        # This form is exactly 0 at T = 1
        return (turbidity - 1.0) * slope
    return turbidity * slope + offset


def optical_depth_to_turbidity(optical_depth, relation: Relation = "definition"):
    """The inverse of `turbidity_to_optical_depth`; a concrete `optical_depth` below 0 is a `ValueError`.

    **Example:**

        >>> round(float(skyfit.optical_depth_to_turbidity(0.194)), 1)
        3.0
    """
    check_range("optical_depth", optical_depth, 0.0, 1e3)
    slope, offset = _line(relation)
    return (optical_depth - offset) / slope


def hosek_turbidity(optical_depth: float) -> float:
    """The turbidity at which the sky model of Hosek & Wilkie 2012 has the pattern of a sky with the given haze.

    Skies of that model were inverted as pictures of unknown brightness, so that only their pattern determined the haze.
    Their contrast toward the sun is lower than in a simulation with the haze their turbidity stands for. The turbidity
    returned here is therefore larger than skyfit's.

    **Arguments:** `optical_depth` of the haze at 550 nm. **Returns:** linear between the turbidities 2 to 8 that were
    measured, with sun zenith angles of 30 to 75 degrees; NaN beyond them.
    **Source:** experiments/validation/panorama.py, by mitsuba's `sunsky`.
    """
    table = read_table("hosek_turbidity.csv")
    depths = table["aerosol_optical_depth"]
    return float(np.interp(optical_depth, depths, table["hosek_turbidity"], left=np.nan, right=np.nan))


def _extinctions(haze_scale_height, air_optical_length):
    """Extinction coefficients at the ground, m^-1: of air, and of haze per unit of turbidity above one."""
    check_range("haze_scale_height", haze_scale_height, 10.0, 1e6, "m")
    check_range("air_optical_length", air_optical_length, 10.0, 1e6, "m")
    depth = float(bodhaine_optical_depth(REFERENCE_WAVELENGTH))
    return depth / air_optical_length, depth / haze_scale_height


def meteorological_range(turbidity, haze_scale_height=HAZE_SCALE_HEIGHT, air_optical_length=AIR_OPTICAL_LENGTH):
    r"""The distance at which a black target vanishes before the horizon sky, $3.912 / \beta_{550}$ at the ground.

    $\beta = \tau_R(550) (1/H_{air} + (T - 1)/H_{haze})$; $3.912 = -\ln 0.02$.

    **Arguments:** `turbidity` >= 1; `haze_scale_height` and `air_optical_length`, vertical column over density at
    the ground, m.
    **Returns:** m: 339 km for pure air, 42 km at T = 2, 15 km at 4, 5.3 km at 10.
    **Valid:** T from 1, else `ValueError`; traced values below give the range of pure air. The scale height of thick
    haze is below 1200 m: the paper's Fig. 3, as SLIB's author read it ($\log_2 R = 9 / 1.55^{\log_2 T} - 0.5$, km),
    gives 362, 40, 9.5 and 3.0 km for these turbidities.
    **Source:** Preetham 1999, sec. 2.1 (Koschmieder's law, contrast 0.02).

    **Example:**

        >>> round(float(skyfit.meteorological_range(3.0)) / 1e3)
        23
    """
    check_turbidity(turbidity)
    air, haze = _extinctions(haze_scale_height, air_optical_length)
    return _RANGE_DEPTH / (air + jnp.maximum(turbidity - 1.0, 0.0) * haze)


def turbidity_from_range(distance, haze_scale_height=HAZE_SCALE_HEIGHT, air_optical_length=AIR_OPTICAL_LENGTH):
    """Turbidity from the meteorological range, the inverse of `meteorological_range`.

    **Arguments:** `distance`, the range in m; the others as in `meteorological_range`. **Returns:** dimensionless.
    **Valid:** ranges from 1 m, else `ValueError` (shorter traced ranges are raised to 1 m). Ranges beyond that of pure
    air give 1.

    **Example:**

        >>> round(float(skyfit.turbidity_from_range(skyfit.meteorological_range(3.0))), 3)
        3.0
    """
    check_range("distance", distance, _SHORTEST_RANGE, np.inf, "m")
    air, haze = _extinctions(haze_scale_height, air_optical_length)
    extinction = _RANGE_DEPTH / jnp.maximum(distance, _SHORTEST_RANGE)
    return 1.0 + jnp.maximum(extinction - air, 0.0) / haze
