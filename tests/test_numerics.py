"""The ground floor's guarded functions, quadrature, Legendre functions and interpolation."""

import math

import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skyfit.numerics import (
    associated_legendre,
    chebyshev_nodes,
    chebyshev_weights,
    exp_mean,
    gauss_legendre,
    hat_weights,
    phi1,
    phi_functions,
    safe_sqrt,
)


# tiny, either side of the switch at 0.5, large, and moderately negative
ARGUMENTS = np.array(
    [
        0.0,
        1e-30,
        1e-12,
        1e-6,
        1e-3,
        0.1,
        0.4999,
        0.5,
        0.5001,
        1.0,
        5.0,
        30.0,
        100.0,
        1e4,
        -1e-6,
        -0.4999,
        -0.5001,
        -3.0,
    ]
)


def phi2(x):
    return phi_functions(x)[1]


def moments_of_exponential(x):
    """The means over t in [0, 1] of e^{-xt} times 1, 1 - t, -t and -t (1 - t), by composite Gauss in longdouble."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    edges = np.concatenate([[0.0], np.geomspace(1e-6, 1.0, 60)])
    t = (0.5 * np.diff(edges)[:, None] * (nodes + 1.0) + edges[:-1, None]).ravel().astype(np.longdouble)
    weight = (0.5 * np.diff(edges)[:, None] * weights).ravel().astype(np.longdouble)
    decay = np.exp(-np.asarray(x, np.longdouble)[:, None] * t) * weight
    return [np.asarray(decay @ f, float) for f in (np.ones_like(t), 1 - t, -t, -t * (1 - t))]


@pytest.mark.parametrize("dtype, tolerance", [("float32", 6e-7), ("float64", 2e-14)])
def test_phi_functions_and_their_derivatives_keep_their_digits(dtype, tolerance):
    with jax.enable_x64(dtype == "float64"):
        x = jnp.asarray(ARGUMENTS, dtype)
        found = phi1(x), phi2(x), jax.vmap(jax.grad(phi1))(x), jax.vmap(jax.grad(phi2))(x)
        for i, (result, expected) in enumerate(zip(found, moments_of_exponential(np.asarray(x)), strict=True)):
            # a derivative divides once more by x: some digits more are lost at the switch
            np.testing.assert_allclose(result, expected, rtol=tolerance * (1 if i < 2 else 30), err_msg=str(i))
            assert result.dtype == dtype


@pytest.mark.parametrize("dtype, tolerance", [("float32", 4e-6), ("float64", 1e-14)])
def test_the_third_phi_function_keeps_its_digits(dtype, tolerance):
    """From the recurrence in longdouble where it does not cancel, from the series elsewhere."""
    with jax.enable_x64(dtype == "float64"):
        x = np.asarray(ARGUMENTS, np.longdouble)
        series = sum((-x) ** k / math.factorial(k + 3) for k in range(25))
        far = np.where(np.abs(x) > 2.0, x, 1.0)
        exact = np.where(np.abs(x) > 2.0, (0.5 - (1.0 + np.expm1(-far) / far) / far) / far, series)
        three = phi_functions(jnp.asarray(ARGUMENTS, dtype), 3)
        np.testing.assert_allclose(three[2], np.asarray(exact, float), rtol=tolerance)
        for one, other in zip(three, phi_functions(jnp.asarray(ARGUMENTS, dtype)), strict=False):
            np.testing.assert_allclose(one, other, rtol=10 * tolerance)


def test_phi_functions_keep_the_rank_and_survive_jit():
    x = jnp.linspace(0.0, 2.0, 6).reshape(2, 3)
    np.testing.assert_allclose(jax.jit(phi1)(x), phi1(x), rtol=1e-6)
    assert phi2(x).shape == (2, 3)
    assert phi1(jnp.asarray(0.0)) == 1.0 and phi2(jnp.asarray(0.0)) == 0.5


@pytest.mark.parametrize(
    "x, y",
    [
        (0.0, 0.0),
        (1.0, 1.0),
        (1.0, 1.0 + 1e-13),
        (0.3, 0.31),
        (2.0, 0.1),
        (0.1, 2.0),
        (50.0, 50.0),
        (1e-9, 80.0),
        (700.0, 1.0),
    ],
)
def test_exp_mean_is_the_divided_difference_of_the_exponential(x64, x, y):
    nodes, weights = np.polynomial.legendre.leggauss(200)
    t = 0.5 * (nodes + 1.0)
    edges = np.concatenate([[0.0], np.geomspace(1e-4, 0.5, 8)])
    pieces = np.concatenate([edges, 1.0 - edges[-2::-1]])
    at = pieces[:-1, None] + np.diff(pieces)[:, None] * t
    decay = np.exp(-x * at - y * (1.0 - at)) * np.diff(pieces)[:, None] * 0.5 * weights
    arguments = jnp.asarray(x), jnp.asarray(y)
    assert float(exp_mean(*arguments)) == pytest.approx(decay.sum(), rel=1e-12)
    by_x, by_y = jax.grad(exp_mean, (0, 1))(*arguments)
    assert float(exp_mean(*arguments[::-1])) == float(exp_mean(*arguments))
    if x != y:
        # the kink of |x - y| hides the derivative where x = y exactly
        assert float(by_x) == pytest.approx(-(decay * at).sum(), rel=1e-9)
        assert float(by_y) == pytest.approx(-(decay * (1.0 - at)).sum(), rel=1e-9)
    else:
        assert float(by_x + by_y) == pytest.approx(-np.exp(-x), rel=1e-12)


def test_exp_mean_has_the_right_derivatives_where_its_arguments_are_equal(x64):
    """By symmetry each is half of that along the diagonal: -e^{-x} / 2."""
    by_x, by_y = jax.grad(exp_mean, (0, 1))(jnp.asarray(0.7), jnp.asarray(0.7))
    expected = -0.5 * np.exp(-0.7)
    np.testing.assert_allclose([by_x, by_y], [expected, expected], rtol=1e-12)


def test_safe_sqrt_is_the_root_with_gradient_zero_at_zero():
    x = jnp.array([-1.0, 0.0, 1e-20, 4.0])
    np.testing.assert_allclose(safe_sqrt(x), [0.0, 0.0, 1e-10, 2.0], rtol=1e-6)
    gradient = jax.vmap(jax.grad(safe_sqrt))(x)
    np.testing.assert_allclose(gradient, [0.0, 0.0, 5e9, 0.25], rtol=1e-5)


@pytest.mark.parametrize("count", [1, 2, 7, 24])
def test_gauss_legendre_is_exact_to_its_degree(count):
    nodes, weights = gauss_legendre(count)
    assert np.all((nodes > 0.0) & (nodes < 1.0))
    degree = np.arange(2 * count)
    np.testing.assert_allclose(weights @ nodes[:, None] ** degree, 1.0 / (degree + 1), rtol=1e-12)
    assert abs(weights @ nodes ** (2 * count) * (2 * count + 1) - 1.0) > 1e-14 or count > 8


@pytest.mark.parametrize("dtype, tolerance", [("float32", 2e-5), ("float64", 1e-12)])
def test_associated_legendre_is_scipys_without_the_phase(dtype, tolerance):
    from scipy.special import gammaln, lpmv

    modes, degrees = 7, 24
    zenith = np.array([0.0, 1e-3, 0.4, 1.0, np.pi / 2, 2.2, np.pi])
    with jax.enable_x64(dtype == "float64"):
        found = associated_legendre(jnp.asarray(zenith, dtype), modes, degrees)
        assert found.dtype == dtype and found.shape == (degrees, modes, len(zenith))
        found = np.asarray(found, float)
    degree, mode = np.arange(degrees)[:, None, None], np.arange(modes)[None, :, None]
    # scipy's recurrences need |x| <= 1 and carry the phase (-1)^m
    values = (-1.0) ** mode * lpmv(mode, degree, np.cos(zenith))
    norm = np.exp(0.5 * (gammaln(np.maximum(degree - mode, 0) + 1) - gammaln(degree + mode + 1)))
    np.testing.assert_allclose(found, np.where(degree < mode, 0.0, norm * values), atol=tolerance)


def test_the_addition_theorem_holds(x64):
    first, second, turn = 0.7, 1.9, 2.3
    degrees = 12
    one, two = (associated_legendre(jnp.asarray(z), degrees, degrees) for z in (first, second))
    mode = np.arange(degrees)
    expected = np.cos(first) * np.cos(second) + np.sin(first) * np.sin(second) * np.cos(turn)
    total = np.sum(np.where(mode == 0, 1.0, 2.0) * np.asarray(one * two) * np.cos(mode * turn), axis=1)
    for degree in range(degrees):
        series = np.polynomial.legendre.legval(expected, np.eye(degrees)[degree])
        assert total[degree] == pytest.approx(series, abs=1e-13)


def test_legendre_gradients_are_finite_at_the_zenith_and_the_horizon(x64):
    def everything(zenith):
        return associated_legendre(zenith, 5, 8)

    for zenith in (0.0, 0.5 * np.pi, np.pi, 0.8):
        forward = jax.jacfwd(everything)(jnp.asarray(zenith))
        step = 1e-6
        central = (everything(jnp.asarray(zenith + step)) - everything(jnp.asarray(zenith - step))) / (2.0 * step)
        np.testing.assert_allclose(forward, central, atol=1e-8 * float(jnp.max(jnp.abs(forward))))


@hypothesis.given(
    st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=5),
    st.lists(st.integers(1, 100), min_size=2, max_size=6),
)
@hypothesis.settings(max_examples=40)
def test_hat_weights_interpolate_as_numpy_does(x, steps):
    nodes = -2.0 + np.cumsum(steps) * 0.01
    values = np.sin(3.0 * nodes) + 2.0
    with jax.enable_x64(True):
        weights = np.asarray(hat_weights(jnp.asarray(x), jnp.asarray(nodes)))
    np.testing.assert_allclose(weights @ values, np.interp(x, nodes, values), atol=1e-12)
    np.testing.assert_allclose(weights.sum(-1), 1.0, atol=1e-12)
    assert weights.min() >= -1e-12


def test_hat_weights_take_any_shape_and_differentiate():
    nodes = jnp.array([0.0, 1.0, 3.0])
    assert hat_weights(jnp.ones((2, 4)), nodes).shape == (2, 4, 3)
    slope = jax.grad(lambda x: hat_weights(x, nodes) @ jnp.array([1.0, 3.0, 2.0]))
    np.testing.assert_allclose([slope(jnp.asarray(v)) for v in (0.5, 2.0, 4.0)], [2.0, -0.5, 0.0], atol=1e-6)


def test_chebyshev_interpolation_converges_spectrally(x64):
    x = jnp.linspace(-1.0, 1.0, 101)
    expected = 1.0 / (1.0 + 0.5 * x) + jnp.exp(x)
    errors = []
    for count in (2, 4, 8, 16, 24):
        nodes = chebyshev_nodes(count)
        assert np.all(np.diff(nodes) > 0.0)
        values = jnp.asarray(1.0 / (1.0 + 0.5 * nodes) + np.exp(nodes))
        errors.append(float(jnp.max(jnp.abs(chebyshev_weights(x, count) @ values - expected))))
    # the pole at -2 gives (2 + sqrt 3)^-n
    assert errors[-1] < 1e-12
    for few, many, factor in zip(errors, errors[1:4], (2, 4, 8), strict=False):
        assert many < 3.0 * few * (2.0 + np.sqrt(3.0)) ** -factor


@pytest.mark.parametrize("count", [1, 2, 5])
def test_chebyshev_weights_reproduce_the_values_at_the_nodes(x64, count):
    weights = chebyshev_weights(jnp.asarray(chebyshev_nodes(count)), count)
    np.testing.assert_allclose(weights, np.eye(count), atol=1e-13)
