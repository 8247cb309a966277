"""The aureole: light near the sun that delta-M and exact single scattering count too much."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...atmosphere import AbstractConstituent
from ...numerics import legendre_series, of_angle, phi_functions, safe_sqrt
from ...scene import above_horizon, haversine, Scene
from ..columns import slant_columns
from ..contract import Geometry
from ..optics import Optics
from .layering import peaked, Scaled


# Number of moments, which are squared: at asymmetry 0.95 the squares have fallen to a thousandth.
_SQUARED = 64
# A peak smaller than this has no effect. Its square, by which derivatives divide, may be 0.
_NO_PEAK = 1e-12


def aureole_excess(
    constituents: tuple[AbstractConstituent, ...], scene: Scene, scaled: Scaled, geometry: Geometry
) -> Float[Array, "direction wavelength"]:
    r"""Excess of second-order light in the forward peak, per unit solar irradiance, sr^-1.

    $\hat u = \frac{1}{4\pi} \frac{(\omega f)^2}{1 - \omega f} P''\, \chi$ with
    $P'' = \sum_l (2l+1)(2\rho_l - \rho_l^2) P_l$, where $\rho_l$ is 1 for the moments that the streams carry and the
    phase function's moment over f beyond, and
    $\chi = \tau_v \tau_s \int_0^1 t\, e^{-\tau_v (1-t) - \tau_s t} dt$. The optical depth along the view is $\tau_v$;
    $\tau_s$ is the one toward the sun times $1 - \omega f$. Single scattering albedo and phase function are means over
    the column above the observer. The excess is 0 for views below the horizon.

    **Valid:** within ten degrees of the sun, where it is up to some per cent of the light; it vanishes beyond.
    **Source:** Nakajima & Tanaka 1988, JQSRT 40, 51, eq. 63 to 66.
    """
    wavelength, depth, count = scene.wavelength_nm, scaled.unscaled, scaled.moments.shape[0]
    profiles, mixed, level = [c.profile for c in constituents], depth, jnp.zeros_like(scene.sun_zenith)
    if scene.height is not None:
        level = scene.height
        left = jnp.stack([profile.column_above(level) for profile in profiles])[:, None]
        # Only the ratios matter. Scaled to order one, because the squares of tiny columns aloft would underflow.
        most = jax.lax.stop_gradient(jnp.max(left))
        left = left / jnp.where(most > 0.0, most, 1.0)
        mixed = Optics(left * depth.extinction, left * depth.scattering)
    whole = jnp.sum(mixed.extinction, axis=0)
    share = mixed.scattering / jnp.where(whole > 0.0, whole, 1.0)[None]
    half = haversine(scene.view.zenith, scene.sun_zenith, scene.view.azimuth - scene.sun_azimuth)
    phases = peaked(constituents)
    value = sum(share[i][None] * phase.at_haversine(half, wavelength) for i, phase in phases)
    moments = jnp.sum(jnp.stack([share[i][None] * phase.moments(_SQUARED, wavelength) for i, phase in phases]), axis=0)
    degree = np.arange(_SQUARED)
    peak = moments[count][None]
    # No correction for a peak that is too narrow for these moments to resolve.
    told = 1.0 - (moments[-1][None] / jnp.where(peak > _NO_PEAK, peak, 1.0)) ** 2
    weight = jnp.asarray(2.0 * degree + 1.0, wavelength.dtype)[:, None]
    carried = jnp.asarray(degree < count)[:, None]
    angle = 2.0 * jnp.arctan2(safe_sqrt(half), safe_sqrt(1.0 - half))
    series = jnp.where(carried, peak**2 - 2.0 * peak * moments, -(moments**2)) * weight
    forward = of_angle(legendre_series(1, _SQUARED)[:, 0], angle).T @ series + 8.0 * np.pi * peak * value
    cosine = jnp.concatenate([jnp.cos(scene.sun_zenith)[None], jnp.maximum(jnp.cos(scene.view.zenith), 0.0)])
    slant = slant_columns(profiles, level + jnp.zeros_like(cosine), cosine, geometry).T @ depth.extinction
    sun, view = slant[:1] * (1.0 - peak), slant[1:]
    between = jnp.abs(view - sun)
    first, second = phi_functions(between)
    reached = jnp.exp(-jnp.minimum(view, sun)) * jnp.where(view > sun, second, first - second)
    excess = told * 0.25 / np.pi / (1.0 - peak) * forward * view * sun * reached
    lit = above_horizon(scene.view.zenith)
    if geometry == "flat":
        lit = lit & (scene.sun_zenith < 0.5 * np.pi)
    return jnp.where(lit[:, None], excess, 0.0)
