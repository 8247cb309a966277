"""Solar irradiance at the top of the atmosphere."""

import math
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Real

from ..numerics import check_range, check_wavelength
from ..tables import read_table


# pi (R / r0)^2: nominal solar radius of IAU 2015 B3, astronomical unit of IAU 2012 B2
SUN_SOLID_ANGLE = math.pi * (6.957e8 / 1.495978707e11) ** 2  # sr

# Solar solid angle behind Preetham 1999 Table 2: with a radius of 6.96e8 m at 1.5e11 m all 38 radiances become
# irradiances in whole mW m^-2 nm^-1, as NASA tabulates them (1.725 W at 550 nm); with SUN_SOLID_ANGLE they do not
_PREETHAM_SOLID_ANGLE = math.pi * (6.96e8 / 1.5e11) ** 2  # sr

_FWHM_PER_SIGMA = 2.0 * math.sqrt(2.0 * math.log(2.0))
_MARGIN_IN_SIGMA = 4.0  # this omits 6e-5 of the line, which the normalisation compensates
_REACH_IN_SIGMA = 9.0  # beyond this a double holds nothing of the line


def extraterrestrial_irradiance(
    wavelength_nm: Real[Array | np.ndarray, " wavelength"],
    fwhm_nm: float | None = None,
    source: Literal["astm_g173", "preetham"] = "astm_g173",
) -> Float[Array, " wavelength"]:
    r"""Solar irradiance outside the atmosphere, averaged over a Gaussian line shape of the given width.

    $E(\lambda) = \int E_0(\lambda') G(\lambda' - \lambda) d\lambda' / \int G d\lambda'$, with the
    table $E_0$ linear between its rows and each piece integrated in closed form.

    **Arguments:** `wavelength_nm` nm, `[wavelength]`, concrete; `fwhm_nm`, full width at half
    maximum of the line in nm, or None for the table itself; `source`, "astm_g173" (0.5-1 nm) or
    "preetham" (10 nm means of an older standard, 2 % darker from 380 to 750 nm).
    **Returns:** W m^-2 nm^-1 on a plane normal to the sun at 1 au, `[wavelength]`.
    **Valid:** 300-1100 nm ("preetham": 380-750 nm), and the line's flanks (1.7 `fwhm_nm`) within
    the table, which begins at 280 and ends at 1130 nm ("preetham": 380, 750); else `ValueError`.
    **Source:** ASTM G173-03; Preetham 1999 Table 2, whose sun ends at 750 nm: no zero beyond.
    """
    table_nm, table, low, high = _solar_table(source)
    centre = np.asarray(wavelength_nm, dtype=np.float64)
    check_wavelength(centre, low, high, f"source {source!r}")
    if fwhm_nm is None:
        return jnp.asarray(np.interp(centre, table_nm, table))
    if not (math.isfinite(fwhm_nm) and fwhm_nm > 0.0):
        raise ValueError(f"`fwhm_nm` must be positive and finite, or None, got {fwhm_nm}")
    sigma = fwhm_nm / _FWHM_PER_SIGMA
    margin = _MARGIN_IN_SIGMA * sigma
    cut = (centre - margin < table_nm[0]) | (centre + margin > table_nm[-1])
    if cut.any():
        raise ValueError(
            f"`fwhm_nm` = {fwhm_nm:g} must leave {margin:.3g} nm on both sides of each wavelength "
            f"within the table, {table_nm[0]:g}-{table_nm[-1]:g} nm for source {source!r}, "
            f"got {centre[cut][0]:g} nm"
        )
    return jnp.asarray(_gaussian_mean(table_nm, table, centre, sigma))


def _solar_table(source: str):
    if source == "astm_g173":
        table = read_table("astm_g173_extraterrestrial.csv")
        return table["wavelength_nm"], table["irradiance"], 300.0, 1100.0
    if source == "preetham":
        table = read_table("preetham_table2_spectra.csv")
        known = ~np.isnan(table["sun_radiance"])
        irradiance = table["sun_radiance"][known] * _PREETHAM_SOLID_ANGLE
        return table["wavelength_nm"][known], irradiance, 380.0, 750.0
    raise ValueError(f'`source` must be "astm_g173" or "preetham", got {source!r}')


def _gaussian_mean(node, value, centre, sigma):
    """Mean of the piecewise linear table weighted by Gaussians, exact on every piece."""
    from scipy.special import erf

    reach = _REACH_IN_SIGMA * sigma
    first, last = np.searchsorted(node, [centre.min(initial=node[-1]) - reach, centre.max(initial=node[0]) + reach])
    near = slice(max(first - 1, 0), last + 1)
    node, value = node[near], value[near]
    t = (node[None, :] - centre[:, None]) / sigma
    mass = np.diff(0.5 * erf(t / math.sqrt(2.0)), axis=1)
    moment = -sigma * np.diff(np.exp(-0.5 * t * t) / math.sqrt(2.0 * math.pi), axis=1)
    slope = np.diff(value) / np.diff(node)
    at_centre = value[:-1] + slope * (centre[:, None] - node[None, :-1])
    return np.sum(at_centre * mass + slope * moment, axis=1) / np.sum(mass, axis=1)


def earth_sun_factor(day_of_year: Real[ArrayLike, "*time"]) -> Float[Array, "*time"]:
    r"""Ratio of the solar irradiance on a day to that at 1 au, from the Earth-Sun distance.

    $(r_0/r)^2 = 1.000110 + 0.034221 \cos\Gamma + 0.001280 \sin\Gamma + 0.000719 \cos 2\Gamma
    + 0.000077 \sin 2\Gamma$, $\Gamma = 2\pi (J - 1) / 365$.

    **Arguments:** `day_of_year` J, 1 to 366.
    **Returns:** dimensionless, same shape: 1.035 in early January, 0.967 in early July.
    **Valid:** J from 1 to 366, else `ValueError`; error below 1e-4.
    **Source:** Spencer 1971, as in Iqbal 1983 eq. 1.2.1.
    """
    check_range("day_of_year", day_of_year, 1.0, 366.0)
    return _spencer(day_of_year)


@jax.jit
def _spencer(day_of_year):
    """The factor, as one program in place of one for each operation."""
    day = 2.0 * jnp.pi * (jnp.asarray(day_of_year) - 1) / 365.0
    return (
        1.000110
        + 0.034221 * jnp.cos(day)
        + 0.001280 * jnp.sin(day)
        + 0.000719 * jnp.cos(2.0 * day)
        + 0.000077 * jnp.sin(2.0 * day)
    )


SPECTRUM_NM = (300.0, 1100.0)
