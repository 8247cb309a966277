"""Conversion of spectral radiance to tristimulus values, chromaticity and sRGB."""

import warnings
from functools import lru_cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Real


# SI 2019: luminous efficacy of 540 THz radiation
LUMINOUS_EFFICACY = 683.0  # lm W^-1

# IEC 61966-2-1:1999, linear sRGB from XYZ with Y = 1 for white
# Luminance weights of linear sRGB red, green and blue: IEC 61966-2-1:1999
SRGB_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
SRGB_FROM_XYZ = np.array(
    [
        [3.2406, -1.5372, -0.4986],
        [-0.9689, 1.8758, 0.0415],
        [0.0557, -0.2040, 1.0570],
    ]
)
# D65, the white of sRGB and of grey skies
WHITE = (0.3127, 0.3290)
SMALLEST_Y = 1e-6  # smallest chromaticity y used as a divisor
_SRGB_LINEAR_END = 0.0031308  # IEC 61966-2-1:1999: below this value the transfer function is linear


def xyz(
    radiance: Float[Array, "... wavelength"], wavelength_nm: Real[Array | np.ndarray, " wavelength"]
) -> Float[Array, "... 3"]:
    r"""Tristimulus values of spectral radiance for the CIE 1931 2 degree observer.

    $(X, Y, Z) = 683 \int L(\lambda) (\bar x, \bar y, \bar z) d\lambda$, with $L$ linear between the
    wavelengths: a coarse grid loses detail of $L$ only, not of the observer functions.

    **Arguments:** `radiance` W m^-2 sr^-1 nm^-1, `[..., wavelength]`; `wavelength_nm` nm, concrete.
    **Returns:** `[..., 3]` in cd m^-2; Y is the luminance.
    **Valid:** increasing wavelengths that cover 400-700 nm, else `ValueError`. Beyond its ends the
    radiance is held constant, as in ASTM E308; radiance outside 360-830 nm has no effect.
    **Source:** CIE 015:2018, observer from colour-science (1 nm).

    **Example:**

        >>> wavelength = np.arange(380.0, 781.0, 10.0)
        >>> skyfit.xyz(jnp.full((20, 41), 0.1), wavelength).shape
        (20, 3)
    """
    weights = jnp.asarray(observer_weights(wavelength_nm), dtype=radiance.dtype)
    return jnp.einsum("...w,wc->...c", radiance, weights, precision="highest")


def xyY(
    radiance: Float[Array, "... wavelength"], wavelength_nm: Real[Array | np.ndarray, " wavelength"]
) -> Float[Array, "... 3"]:
    """Chromaticity x, y and luminance Y of spectral radiance.

    x = X / (X + Y + Z), y = Y / (X + Y + Z).

    **Arguments, valid, source:** as for `xyz`.
    **Returns:** as `xyY_from_xyz`.

    **Example:**

        >>> x, y, _ = skyfit.xyY(jnp.ones(41), np.arange(380.0, 781.0, 10.0))
        >>> round(float(x), 2), round(float(y), 2)
        (0.33, 0.33)
    """
    return xyY_from_xyz(xyz(radiance, wavelength_nm))


def xyY_from_xyz(tristimulus: Float[Array, "... 3"]) -> Float[Array, "... 3"]:
    """Chromaticity x, y and luminance Y of tristimulus values.

    **Arguments:** `tristimulus` X, Y, Z, cd m^-2, `[..., 3]`.
    **Returns:** `[..., 3]`: x, y dimensionless, Y in cd m^-2. Black has x = y = 1/3.
    **Valid:** everywhere. **Source:** CIE 015:2018.
    """
    total = jnp.sum(tristimulus, axis=-1)
    lit = total != 0.0
    safe = jnp.where(lit, total, 1.0)
    x = jnp.where(lit, tristimulus[..., 0] / safe, 1.0 / 3.0)
    y = jnp.where(lit, tristimulus[..., 1] / safe, 1.0 / 3.0)
    return jnp.stack([x, y, tristimulus[..., 1]], axis=-1)


def xyz_from_xyY(chromaticity_luminance: Float[Array, "... 3"]) -> Float[Array, "... 3"]:
    """Tristimulus values from chromaticity and luminance, the inverse of `xyY`.

    X = x Y / y, Z = (1 - x - y) Y / y.

    **Arguments:** `[..., 3]`: x, y, Y as `xyY` returns them.
    **Returns:** `[..., 3]`: X, Y, Z in the unit of Y.
    **Valid:** y > 0; y below 1e-6 is raised to 1e-6.
    **Source:** CIE 015:2018.
    """
    x = chromaticity_luminance[..., 0]
    y = jnp.maximum(chromaticity_luminance[..., 1], SMALLEST_Y)
    luminance = chromaticity_luminance[..., 2]
    scale = luminance / y
    return jnp.stack([x * scale, luminance, (1.0 - x - y) * scale], axis=-1)


def srgb(
    radiance: Float[Array, "... wavelength"],
    wavelength_nm: Real[Array | np.ndarray, " wavelength"],
    exposure: Float[ArrayLike, ""],
) -> Float[Array, "... 3"]:
    """Encoded sRGB pixel of spectral radiance, `srgb_from_xyz(xyz(...), exposure)`.

    **Arguments:** as `xyz`; `exposure` in 1 / (cd m^-2): luminance 1 / exposure is white.
    **Returns, valid, source:** as `srgb_from_xyz`.

    **Example:**

        >>> wavelength = np.arange(380.0, 781.0, 5.0)
        >>> white = skyfit.daylight(0.3127, 0.3290, wavelength)
        >>> np.round(skyfit.srgb(1e4 * white, wavelength, 1e-4), 1).tolist()
        [1.0, 1.0, 1.0]
    """
    return srgb_from_xyz(xyz(radiance, wavelength_nm), exposure)


def srgb_from_xyz(tristimulus: Float[Array, "... 3"], exposure: Float[ArrayLike, ""]) -> Float[Array, "... 3"]:
    r"""Encoded sRGB pixel of tristimulus values.

    `srgb_from_linear` of $c = M (X, Y, Z) \cdot$ exposure.

    **Arguments:** `tristimulus` cd m^-2, `[..., 3]`; `exposure` in 1 / (cd m^-2).
    **Returns:** `[..., 3]` red, green, blue; 0 to 1 is displayable. Values are not clipped: colours outside the
    screen's gamut or too bright lie outside 0 to 1 and keep their gradient.
    **Valid:** everywhere; negative components use the linear part of the curve.
    **Source:** IEC 61966-2-1:1999.
    """
    return srgb_from_linear(exposure * linear_from_xyz(tristimulus))


def linear_from_xyz(tristimulus: Float[Array, "... 3"]) -> Float[Array, "... 3"]:
    """Linear sRGB red, green, blue of tristimulus values, same unit, not clipped. **Source:** IEC 61966-2-1:1999."""
    matrix = jnp.asarray(SRGB_FROM_XYZ, dtype=tristimulus.dtype)
    return jnp.einsum("...w,cw->...c", tristimulus, matrix, precision="highest")


def srgb_from_linear(linear: Float[Array | np.ndarray, "..."]) -> Float[Array, "..."]:
    r"""The transfer function of sRGB, $12.92 c$ up to 0.0031308, $1.055 c^{1/2.4} - 0.055$ beyond.

    **Arguments:** `linear` red, green, blue, 1 for white, in any order. **Returns:** the encoded values, same shape.
    **Valid, source:** as `srgb_from_xyz`.

    **Example:**

        >>> round(float(skyfit.srgb_from_linear(jnp.array(0.5))), 3)
        0.735
    """
    bright = linear > _SRGB_LINEAR_END
    power = 1.055 * jnp.where(bright, linear, 1.0) ** (1.0 / 2.4) - 0.055
    return jnp.where(bright, power, 12.92 * linear)


def observer_weights(
    wavelength_nm: Real[Array | np.ndarray, " wavelength"],
) -> Float[np.ndarray, "wavelength 3"]:
    """683 times the integral of each wavelength's hat function times the observer functions.

    Both factors are piecewise linear, so Simpson's rule between the union of their nodes is exact.

    **Arguments, valid, source:** as for `xyz`. **Returns:** float64; `radiance @ weights` gives X, Y, Z in cd m^-2.
    """
    grid = np.asarray(wavelength_nm, dtype=np.float64)
    if grid.size < 2 or not np.all(np.diff(grid) > 0.0):
        raise ValueError(f"`wavelength_nm` must be increasing, two values at least, got {grid}")
    if grid[0] > 400.0 or grid[-1] < 700.0:
        raise ValueError(f"`wavelength_nm` must cover 400-700 nm for a colour, got {grid[0]:g}-{grid[-1]:g}")
    observer_nm, observer = _observer()
    inside = grid[(grid > observer_nm[0]) & (grid < observer_nm[-1])]
    node = np.union1d(observer_nm, inside)
    place = np.sort(np.concatenate([node, 0.5 * (node[1:] + node[:-1])]))
    step = np.diff(node)
    simpson = np.zeros_like(place)
    simpson[0:-1:2] += step / 6.0
    simpson[2::2] += step / 6.0
    simpson[1::2] = step * (2.0 / 3.0)
    functions = np.stack([np.interp(place, observer_nm, column) for column in observer.T])
    hats = np.stack([np.interp(place, grid, row) for row in np.eye(grid.size)])
    return LUMINOUS_EFFICACY * hats @ (simpson * functions).T


@lru_cache(maxsize=1)
def _observer():
    # Without matplotlib the import warns that it cannot plot, which is not needed here
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour

    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    return np.array(observer.wavelengths), np.array(observer.values)
