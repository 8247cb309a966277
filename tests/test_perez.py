import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skyfit.analytic import Perez, perez_distribution


CLEAR = (-1.1, -0.28, 5.3, -2.3, 0.24)


@pytest.fixture(params=[False, True], ids=["float32", "float64"])
def double(request):
    with jax.enable_x64(request.param):
        yield request.param


def test_the_formula(double):
    theta, gamma = np.array([0.0, 0.4, 1.2]), np.array([0.9, 0.0, 2.5])
    a, b, c, d, e = CLEAR
    expected = (1 + a * np.exp(b / np.cos(theta))) * (1 + c * np.exp(d * gamma) + e * np.cos(gamma) ** 2)
    got = Perez(*CLEAR).relative(jnp.asarray(theta), jnp.asarray(gamma))
    np.testing.assert_allclose(got, expected, rtol=1e-13 if double else 3e-6)


def test_names_hold_the_coefficients_in_their_order(double):
    perez = Perez(
        backscatter=5.0,
        circumsolar_width=4.0,
        circumsolar_intensity=3.0,
        horizon_gradient=2.0,
        horizon_darkening=1.0,
    )
    np.testing.assert_array_equal(perez.coefficients, [1.0, 2.0, 3.0, 4.0, 5.0])
    again = Perez.from_coefficients(perez.coefficients)
    assert float(again.circumsolar_width) == 4.0
    assert len(jax.tree.leaves(perez)) == 5


def test_limits(double):
    relative = jax.jit(lambda perez, theta, gamma: perez.relative(theta, gamma))
    uniform = Perez(0.0, -1.0, 0.0, -1.0, 0.0)
    theta = jnp.asarray(np.linspace(0.0, 1.57, 9))
    np.testing.assert_array_equal(uniform.ratio(theta, theta, 0.3), np.ones(9))
    # a negative horizon darkening brightens the horizon, a positive one darkens it
    side = jnp.full(2, 1.5)
    up_and_level = jnp.array([0.0, 1.5])
    bright = relative(Perez(-0.8, -0.3, 0.0, -1.0, 0.0), up_and_level, side)
    dark = relative(Perez(0.8, -0.3, 0.0, -1.0, 0.0), up_and_level, side)
    assert np.all(np.diff(bright) > 0.0) and np.all(np.diff(dark) < 0.0)
    # a width nearer to zero is wider
    sun = Perez(0.0, -1.0, 5.0, -3.0, 0.0), Perez(0.0, -1.0, 5.0, -1.0, 0.0)
    narrow, wide = (relative(s, jnp.array(0.5), jnp.array(1.0)) for s in sun)
    assert float(wide) > float(narrow)


@pytest.mark.parametrize("sun", [0.0, 0.7, 1.5, 1.9])
def test_ratio_is_one_at_the_zenith(double, sun):
    got = Perez(*CLEAR).ratio(jnp.zeros(1), jnp.full(1, sun), sun)
    np.testing.assert_allclose(got, [1.0], rtol=1e-6)


def test_horizon_and_below_have_the_value_of_the_lowest_angle(double):
    theta = jnp.asarray(np.array([np.arccos(0.0099), np.pi / 2, 1.7, np.pi]))
    a, b, c, d, e = -1.1, -0.01, 5.3, -2.3, 0.24
    got = np.asarray(Perez(a, b, c, d, e).relative(theta, jnp.full(4, 0.8)))
    np.testing.assert_allclose(got, np.full(4, got[0]), rtol=1e-6)
    side = 1 + c * np.exp(d * 0.8) + e * np.cos(0.8) ** 2
    np.testing.assert_allclose(got[0], (1 + a * np.exp(b / 0.01)) * side, rtol=1e-5)


EXTREMES = {
    "clear": CLEAR,
    "overcast": (4.0, -0.7, 0.0, -1.0, 0.0),
    "growing": (-1.0, 3.0, 10.0, 8.0, 0.5),
    "huge": (-1e3, -1e3, 1e3, -1e3, 1e3),
}


def test_values_and_gradients_are_finite_everywhere(double):
    half = np.pi / 2
    places = [0.0, 0.3, half - 1e-3, half - 1e-7, half, half + 1e-7, half + 0.2, np.pi]
    theta, gamma = (jnp.asarray(m.ravel()) for m in np.meshgrid(places, places))

    def one(c, t, g, s):
        return perez_distribution(c, t, g), Perez.from_coefficients(c).ratio(t, g, s)

    both = jax.jit(jax.vmap(lambda *at: (one(*at), jax.jacrev(one, argnums=(0, 1, 2, 3))(*at)), (None, 0, 0, None)))
    for name, coefficients in EXTREMES.items():
        for sun in (0.0, 0.5, half, 2.0):
            for leaf in jax.tree.leaves(both(jnp.asarray(coefficients), theta, gamma, sun)):
                assert np.all(np.isfinite(leaf)), (name, sun)


def test_gradients_are_central_differences():
    with jax.enable_x64(True):
        theta, gamma = jnp.array([0.1, 0.8, 1.4]), jnp.array([0.0, 0.9, 2.8])
        array = jnp.asarray(CLEAR)

        @jax.jit
        def values(c):
            return Perez.from_coefficients(c).ratio(theta, gamma, 0.6)

        slope = np.asarray(jax.jacfwd(values)(array))
        step = 1e-6
        for k in range(5):
            up, down = values(array.at[k].add(step)), values(array.at[k].add(-step))
            np.testing.assert_allclose(slope[:, k], (up - down) / (2 * step), atol=1e-8 * np.abs(slope).max())


def test_vanishing_zenith_gives_a_large_finite_ratio(double):
    # 1 + A exp(B) = 0, exactly and nearly
    both = jax.jit(jax.value_and_grad(lambda p: p.ratio(1.2, 0.5, 0.5)))
    exactly, _ = both(Perez(-1.0, 0.0, 0.5, -1.0, 0.0))
    assert float(exactly) == 0.0
    got, slope = both(Perez(-np.exp(0.5), -0.5, 0.0, -1.0, 0.0))
    assert np.isfinite(got) and abs(float(got)) > 1e5
    assert all(np.isfinite(leaf) for leaf in jax.tree.leaves(slope))


def test_float32_is_near_float64():
    angle = np.linspace(0.0, 1.55, 40)
    results = []
    for double in (False, True):
        with jax.enable_x64(double):
            got = Perez(*CLEAR).ratio(jnp.asarray(angle), jnp.asarray(angle), 0.6)
            assert got.dtype == (jnp.float64 if double else jnp.float32)
            results.append(np.asarray(got))
    np.testing.assert_allclose(*results, rtol=2e-5)
