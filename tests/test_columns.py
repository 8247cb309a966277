"""Columns along straight rays through a sphere against quadrature and published functions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import k1e
from skies import EARTH_RADIUS

from skyfit.atmosphere import Exponential, Layered, OzoneLayer
from skyfit.transport.columns import chapman_column, outward_column, slant_column


COSINES = (0.0, 1e-4, 0.01, 0.03, 0.1, 0.3, 0.7, 1.0)
LAYERS = Layered(np.array([0.0, 500.0, 5e3, 15e3, 30e3, 60e3]), np.array([0.4, 0.2, 0.2, 0.15, 0.05]))


def column(density, height, cosine, edges):
    """Composite Gauss-Legendre along the ray between the heights `edges`, in metres of the Cartesian line."""
    x, weight = np.polynomial.legendre.leggauss(40)
    across, along = (EARTH_RADIUS + height) * np.sqrt(1.0 - cosine**2), (EARTH_RADIUS + height) * cosine
    levels = np.concatenate([[height], edges[edges > height]])
    to = np.sqrt(np.maximum((EARTH_RADIUS + levels) ** 2 - across**2, along**2)) - along
    half = 0.5 * np.diff(to)[:, None]
    distance = (half * (x + 1.0) + to[:-1, None]).ravel()
    level = np.hypot(across, along + distance) - EARTH_RADIUS
    return float((half * weight).ravel() @ density(level))


@pytest.mark.parametrize("scale, tolerance", [(500.0, 3e-7), (1200.0, 3e-7), (8e3, 4e-7), (30e3, 1e-5)])
def test_the_chapman_column_is_the_integral(x64, scale, tolerance):
    for height in (0.0, 5e3, 100e3):
        edges = height + scale * np.arange(1, 45)
        # relative to the density at the start, which underflows far up
        expected = [column(lambda h, at=height: np.exp((at - h) / scale) / scale, height, c, edges) for c in COSINES]
        found = [chapman_column(jnp.asarray(scale), jnp.asarray(height), jnp.asarray(c)) for c in COSINES]
        np.testing.assert_allclose(np.asarray(found) * np.exp(height / scale), expected, rtol=tolerance)


def test_the_horizontal_column_is_the_bessel_function(x64):
    """Chapman's integral at 90 degrees is X e^X K_1(X); straight up it is 1."""
    scale = np.array([1.2e3, 8e3, 20e3])
    size = EARTH_RADIUS / scale
    ground = jnp.zeros(3)
    np.testing.assert_allclose(chapman_column(jnp.asarray(scale), ground, ground), size * k1e(size), rtol=2e-6)
    np.testing.assert_allclose(chapman_column(jnp.asarray(scale), ground, ground + 1.0), 1.0, rtol=1e-6)


def test_the_slope_by_scale_height_is_that_of_the_integral(x64):
    def exact(scale, cosine):
        return column(lambda h: np.exp(-h / scale) / scale, 2e3, cosine, 2e3 + 8e3 * np.arange(1, 45))

    for cosine in COSINES:
        found = jax.grad(chapman_column)(jnp.asarray(8e3), jnp.asarray(2e3), jnp.asarray(cosine))
        expected = (exact(8001.0, cosine) - exact(7999.0, cosine)) / 2.0
        # the slope passes through 0: against the column over the scale height
        assert float(found) == pytest.approx(expected, abs=2e-6 * exact(8e3, cosine) / 8e3), cosine


@pytest.mark.parametrize(
    "profile, tolerance",
    [(OzoneLayer(), 2e-4), (OzoneLayer(22e3, 6e3), 2e-4), (OzoneLayer(15e3, 3e3), 8e-4), (LAYERS, 1e-9)],
)
def test_columns_of_ozone_and_of_layers_are_the_integrals(x64, profile, tolerance):
    profile = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), profile)
    edges = np.asarray(profile.edges) if isinstance(profile, Layered) else np.arange(1e3, 2e5, 2e3)

    def density(height):
        return np.asarray(profile.density(jnp.asarray(height)))

    for height in (0.0, 3e3, 10e3, 25e3, 50e3):
        expected = np.array([column(density, height, c, edges) for c in COSINES])
        found = outward_column(profile, jnp.full(len(COSINES), height), jnp.asarray(COSINES), "spherical")
        # where little is left above, little is lost
        np.testing.assert_allclose(found, expected, rtol=tolerance, atol=tolerance / 10.0)


@pytest.mark.parametrize("profile", [Exponential(8e3), LAYERS, OzoneLayer()])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_ray_that_descends_passes_its_lowest_point(profile, dtype):
    """The column down and up is the whole chord less what lies behind; finite slopes at the horizontal."""
    with jax.enable_x64(dtype == "float64"):
        profile = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), profile)
        height, lowest = 12e3, 3e3
        cosine = np.sqrt(1.0 - ((EARTH_RADIUS + lowest) / (EARTH_RADIUS + height)) ** 2)

        def slant(height, cosine):
            return slant_column(profile, height, cosine, "spherical")

        def slope(height, cosine):
            return jax.grad(lambda c: slant(height[None], c[None])[0])(cosine)

        levels, cosines = jnp.array([height, height, lowest]), jnp.array([cosine, -cosine, 0.0])
        up, down, half = map(float, slant(levels, cosines))
        assert up + down == pytest.approx(2.0 * half, rel=1e-5 if dtype == "float32" else 1e-10)
        grid = jnp.meshgrid(jnp.array([0.0, 500.0, 5e3, height]), jnp.array([-0.02, -0.0, 0.0, 1.0]))
        assert np.all(np.isfinite(jax.jit(jax.vmap(slope))(*map(jnp.ravel, grid))))
