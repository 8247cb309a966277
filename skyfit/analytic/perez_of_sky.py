"""Perez' five parameters fitted to measured skies, one fit for each time, with covariance."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..light import observer_weights
from ..measured import Sky
from ..measured.quality.placed_sun import angle_from_sun
from .perez import LARGEST_EXPONENT, LOWEST_COSINE
from .perez_fits import CLEAR_SKY


COEFFICIENTS = (
    "horizon_darkening", "horizon_gradient", "circumsolar_intensity", "circumsolar_width", "backscatter",
)  # fmt: skip
# Initial A-E of the searches: a clear sky, a dark horizon, and a bright horizon with a narrow and with a wide
# circumsolar region. The search with the lowest cost is kept
_STARTS = (CLEAR_SKY, (4.0, -0.7, 0.5, -1.5, 0.1), (-1.0, -0.3, 10.0, -3.0, 0.45), (-0.9, -0.5, 2.0, -0.8, 0.1))
# Bounds of ln(-B) and ln(-D); beyond them many coefficients give the same sky (as in `fit_perez`)
_LOWEST, _STEEPEST = np.array([-5.0, -5.0]), np.array([3.0, 5.0])
_EDGE = 1e-3
# Relative size below which eigenvalues of the curvature are rounding errors
_ROUNDING = 1e-13
# Wavelengths needed for luminance, nm; the eye sees little beyond
_VISIBLE = (400.0, 700.0)


@dataclass(frozen=True, eq=False)
class SkyPerez:
    """Perez' distributions fitted to a sky, for each time and each kind of light.

    **Arguments**

    - `sky`: the fitted sky; `light`: names of the kinds of light, "luminance", wavelengths or channels
    - `coefficients`: A to E in the order of `COEFFICIENTS`, `[time, light, 5]`; `covariance` `[time, light, 5, 5]`,
      inf on the diagonal where they are not determined
    - `zenith`, `zenith_sigma`: the fitted light at the zenith, in cd m^-2 for luminance, else in the unit of the sky
    - `rmse`: root mean square of the relative residuals; `directions`: the number of fitted directions
    - `settled`: whether the search ended at a minimum inside its bounds with enough directions. With too few directions
      the fitted values are NaN
    """

    sky: Sky
    light: tuple[str, ...]
    coefficients: Float[np.ndarray, "time light parameter"]
    covariance: Float[np.ndarray, "time light parameter parameter"]
    zenith: Float[np.ndarray, "time light"]
    zenith_sigma: Float[np.ndarray, "time light"]
    rmse: Float[np.ndarray, "time light"]
    directions: Int[np.ndarray, "time light"]
    settled: Bool[np.ndarray, "time light"]

    @property
    def sigma(self) -> Float[np.ndarray, "time light parameter"]:
        """Standard deviations of `coefficients`."""
        return np.sqrt(np.diagonal(self.covariance, axis1=2, axis2=3))


def perez_of_sky(sky: Sky, each: bool = False) -> SkyPerez:
    r"""Fit A to E and the level k for each time, minimising $\sum_d (k F(\theta_d, \gamma_d) / L_d - 1)^2$.

    The zenith need not be measured, unlike in `fit_perez`, which treats its light as exact. The covariance is
    $s^2 (J^T J)^{-1}$ with the residuals' variance $s^2$ on n - 6 degrees of freedom.

    **Arguments:** `sky`, measured or simulated; `each`: fit every wavelength or channel separately even if luminance is
    available.
    **Returns:** `SkyPerez`, for luminance if the sky has it: a channel that is luminance, or spectral radiance over
    400-700 nm, in directions where no wavelength is missing. Otherwise for every wavelength or channel.
    **Valid:** at least seven directions above the horizon. Directions count as independent. Where Perez' form does not
    fit, residuals are correlated over large parts of the sky and sigma is too small. If there are several minima, the
    best of four searches is used.
    **Source:** Perez et al. 1993 eq. 1.

    **Example:**

        >>> sky = skyfit.read("data/skies/sample.nc")
        >>> found = skyfit.perez_of_sky(sky)
        >>> found.light, found.coefficients.shape
        (('luminance',), (1, 1, 5))
        >>> bool(found.settled[0, 0])
        True
    """
    names, light, usable = _light(sky, each)
    shape = len(sky.time), len(names)
    zenith_light, zenith_sigma, rmse = np.full((3, *shape), np.nan)
    found = SkyPerez(
        sky, names, np.full((*shape, 5), np.nan), np.full((*shape, 5, 5), np.nan), zenith_light, zenith_sigma, rmse,
        np.zeros(shape, int), np.zeros(shape, bool),
    )  # fmt: skip
    zenith, azimuth = (view if view.ndim == 3 else view[..., None] for view in sky.views)
    suns = [angle if angle.ndim == 2 else angle[:, None] for angle in (sky.sun_zenith, sky.sun_azimuth)]
    for t, k in np.ndindex(*shape):
        down, around = (view[t, :, k if view.shape[2] > 1 else 0] for view in (zenith, azimuth))
        sun = [float(angle[t, k if angle.shape[1] > 1 else 0]) for angle in suns]
        seen = usable[t, :, k] & (down < 0.5 * np.pi)
        found.directions[t, k] = count = int(seen.sum())
        if count <= 6:
            continue
        gamma = angle_from_sun(down[seen], around[seen], *sun)
        secant = 1.0 / np.maximum(np.cos(down[seen]), LOWEST_COSINE)
        point, settled = _search(light[t, seen, k], secant, gamma)
        columns, residual = _linearised(point, light[t, seen, k], secant, gamma)
        spread = _covariance(columns, residual)
        value, slope = _at_zenith(point, sun[0])
        found.coefficients[t, k], found.covariance[t, k] = point[1:], spread[1:, 1:]
        found.zenith[t, k] = value
        lost = np.isinf(spread).any()
        found.zenith_sigma[t, k] = np.inf if lost else np.sqrt(max(slope @ spread @ slope, 0.0))
        found.rmse[t, k], found.settled[t, k] = np.sqrt(np.mean(residual**2)), settled
    return found


def _light(sky: Sky, each: bool) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Names of the kinds of light, their values and a mask of the usable ones, `[time, direction, light]`."""
    own, positive = sky.wavelength_nm, sky.usable & (np.nan_to_num(sky.radiance) > 0.0)
    if sky.response is not None:
        names = ("luminance",) if sky.response.by_unit and len(own) == 1 else sky.response.names
        return names, sky.radiance, positive
    covers = own[0] <= _VISIBLE[0] and own[-1] >= _VISIBLE[1] and sky.view_zenith_by_wavelength is None
    if each or not covers:
        return tuple(f"{one:g} nm" for one in own), sky.radiance, positive
    weight = np.asarray(observer_weights(own), float)[:, 1]
    known = np.all(sky.usable | (weight == 0.0), axis=2)
    luminance = np.where(known, np.where(sky.usable, sky.radiance, 0.0) @ weight, np.nan)
    return ("luminance",), luminance[..., None], (known & (luminance > 0.0))[..., None]


def _search(light, secant, gamma) -> tuple[Float[np.ndarray, " parameter"], bool]:
    """ln k and A to E of the best search, and whether it succeeded inside the bounds."""
    from scipy.optimize import least_squares

    low, high = np.full(6, -np.inf), np.full(6, np.inf)
    low[[2, 4]], high[[2, 4]] = _LOWEST, _STEEPEST

    def logarithmic(point):
        unknown = point.copy()
        unknown[[2, 4]] = np.log(-point[[2, 4]])
        return unknown

    def plain(unknown):
        point = unknown.copy()
        point[[2, 4]] = -np.exp(unknown[[2, 4]])
        return point

    def residual(unknown):
        return _linearised(plain(unknown), light, secant, gamma)[1]

    def slopes(unknown):
        columns = _linearised(plain(unknown), light, secant, gamma)[0]
        columns[:, [2, 4]] *= plain(unknown)[[2, 4]]
        return columns

    ends = []
    for start in _STARTS:
        form = 1.0 + _linearised(np.array([0.0, *start]), np.ones_like(light), secant, gamma)[1]
        level = np.log(max(float(np.median(light) / np.median(form)), 1e-30))
        first = logarithmic(np.array([level, *start]))
        ends.append(
            least_squares(
                residual, first, jac=slopes, bounds=(low, high), x_scale="jac", max_nfev=200,  # pyright: ignore
                ftol=1e-12, xtol=1e-12, gtol=1e-12,
            )
        )  # fmt: skip
    best = min(ends, key=lambda end: end.cost)
    inside = np.all(best.x > low + _EDGE) and np.all(best.x < high - _EDGE)
    return plain(best.x), bool(best.success and inside)


def _linearised(point, light, secant, gamma):
    """The Jacobian of the relative residuals by ln k and A to E, `[direction, 6]`, and the residuals themselves."""
    level, a, b, c, d, e = point
    horizon = np.exp(np.minimum(b * secant, LARGEST_EXPONENT))
    glow = np.exp(np.minimum(d * gamma, LARGEST_EXPONENT))
    first, second = 1.0 + a * horizon, 1.0 + c * glow + e * np.cos(gamma) ** 2
    scale = np.exp(level) / light
    columns = [first * second, horizon * second, a * secant * horizon * second]
    columns += [first * glow, first * c * gamma * glow, first * np.cos(gamma) ** 2]
    return np.stack(columns, axis=1) * scale[:, None], scale * first * second - 1.0


def _at_zenith(point, sun: float):
    """The light at the zenith and its derivatives by ln k and A to E."""
    columns, residual = _linearised(point, np.ones(1), np.ones(1), np.full(1, sun))
    return float(residual[0]) + 1.0, columns[0]


def _covariance(columns, residual):
    """Covariance of ln k and A to E, with inf on the diagonal of all parameters in an undetermined combination."""
    curvature = columns.T @ columns
    unit = 1.0 / np.sqrt(np.maximum(np.diagonal(curvature), 1e-300))
    values, vectors = np.linalg.eigh(curvature * unit[:, None] * unit)
    known = values > _ROUNDING * values[-1]
    inverse = (vectors[:, known] / values[known]) @ vectors[:, known].T * unit[:, None] * unit
    lost = np.any(np.abs(vectors[:, ~known]) > np.sqrt(_ROUNDING), axis=1)
    return np.where(np.diag(lost), np.inf, inverse * (residual @ residual) / (residual.size - 6))
