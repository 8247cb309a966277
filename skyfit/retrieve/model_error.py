"""Smooth errors of the model itself, which sigma includes."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..scene import haversine
from .forward import Problem


def error_shapes(airmass: Array, cosine: Array, wavelength_nm: Array) -> Float[Array, "shape direction wavelength"]:
    """Smooth relative errors of a radiative transfer model, each of size 1 or less.

    The shapes are a constant, a growth toward the horizon, four Legendre polynomials of the angle from the sun, and a
    slope in the logarithm of wavelength. **Arguments:** `airmass` and `cosine` of the angle from the sun,
    `[direction]`.
    """
    colour = jnp.log(wavelength_nm) - jnp.mean(jnp.log(wavelength_nm))
    colour = colour / jnp.maximum(jnp.max(jnp.abs(colour)), 0.1)
    flat = jnp.ones_like(wavelength_nm)
    by_angle = [
        jnp.ones_like(cosine), 1.0 - 2.0 / airmass, cosine, 1.5 * cosine**2 - 0.5, 2.5 * cosine**3 - 1.5 * cosine,
        4.375 * cosine**4 - 3.75 * cosine**2 + 0.375,
    ]  # fmt: skip
    shapes = [a[:, None] * flat[None] for a in by_angle] + [by_angle[0][:, None] * colour[None]]
    return jnp.stack(shapes)


def model_errors(
    problem: Problem, radiance: Float[Array, "time direction channel"]
) -> Float[Array, "time sample shape"]:
    """Smooth errors of the model's radiance, in its unit; 0 for measurements besides the radiance."""

    def at(item):
        one, radiance = item
        sun_zenith, sun_azimuth = one.mean_sun()
        view_zenith, view_azimuth = one.mean_view()
        half = haversine(view_zenith, sun_zenith, view_azimuth - sun_azimuth)
        airmass = 1.0 / jnp.maximum(jnp.cos(view_zenith), 0.05)
        place = one.wavelength_nm
        if one.response is not None:
            size = jnp.abs(one.response)
            place = size @ place / jnp.sum(size, axis=1)
        shapes = error_shapes(airmass, 1.0 - 2.0 * half, place)
        errors = (shapes * radiance[None]).reshape(shapes.shape[0], -1).T
        if one.beside is None:
            return errors
        return jnp.concatenate([errors, jnp.zeros((one.beside.shape[0], errors.shape[1]), errors.dtype)])

    return jax.vmap(at)((problem, radiance))
