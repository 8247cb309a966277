import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

from skyfit.analytic import Perez
from skyfit.numerics.least_squares import covariance, least_squares, LOGISTIC_LIMIT, result_name


TRUTH = (-1.1, -0.28, 5.3, -2.3, 0.24)
START = (-0.8, -0.5, 3.0, -1.5, 0.1)
LOWER, UPPER = np.array([-1.5, -6.0, 0.0, -12.0, -1.0]), np.array([5.0, -0.01, 60.0, -0.5, 5.0])


@pytest.fixture(params=[False, True], ids=["float32", "float64"])
def dtype(request):
    with jax.enable_x64(request.param):
        yield np.float64 if request.param else np.float32


def same(free):
    return free


# one compilation instead of one per operation
solve = eqx.filter_jit(least_squares)


def unbounded(residual, start, arguments=None, max_steps=100, tolerance=1e-3):
    start = jnp.asarray(start)
    return solve(residual, same, start, arguments, jnp.full_like(start, np.inf), max_steps, tolerance)


def perez_data(noise: float):
    """Samples of a clear sky with noise, as (zenith, angle from the sun, radiance, 1 / sigma), float64."""
    rng = np.random.default_rng(7)
    theta, gamma = np.arccos(rng.uniform(0.1, 1.0, 200)), rng.uniform(0.0, 2.0, 200)
    a, b, c, d, e = TRUTH
    clean = (1 + a * np.exp(b / np.cos(theta))) * (1 + c * np.exp(d * gamma) + e * np.cos(gamma) ** 2)
    return theta, gamma, clean * (1.0 + noise * rng.standard_normal(200)), 1.0 / (0.02 * clean)


def perez_residual(values, arguments):
    theta, gamma, measured, weight = arguments
    return (Perez.from_coefficients(values).relative(theta, gamma) - measured) * weight


def perez_numpy(values, arguments):
    theta, gamma, measured, weight = arguments
    a, b, c, d, e = values
    sky = (1 + a * np.exp(b / np.cos(theta))) * (1 + c * np.exp(d * gamma) + e * np.cos(gamma) ** 2)
    return (sky - measured) * weight


def in_dtype(arrays, dtype):
    return tuple(jnp.asarray(a, dtype) for a in arrays)


def cost(solution) -> float:
    return 0.5 * float(np.sum(np.square(np.asarray(solution.residual, np.float64))))


TIGHT = {"xtol": 1e-12, "ftol": 1e-12, "gtol": 1e-12}


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.2])
def test_a_perez_sky_ends_at_scipys_minimum(dtype, noise):
    arguments = perez_data(noise)
    expected = optimize.least_squares(perez_numpy, START, args=(arguments,), **TIGHT)
    got = unbounded(perez_residual, np.array(START, dtype), in_dtype(arguments, dtype))
    assert result_name(got.result) == "successful"
    assert got.value.dtype == got.residual.dtype == got.jacobian.dtype == dtype
    # cost within a hundredth of what one sigma of one parameter would add
    assert cost(got) == pytest.approx(expected.cost, rel=1e-6, abs=5e-3)
    sigma = np.sqrt(np.diag(np.linalg.inv(expected.jac.T @ expected.jac)))
    assert np.max(np.abs(np.asarray(got.value) - expected.x) / sigma) < 0.01
    assert 2 <= int(got.steps) <= 30


def rosenbrock(values, _):
    return jnp.stack([10.0 * (values[1] - values[0] ** 2), 1.0 - values[0]])


def rosenbrock_that_cannot_be_met(values, _):
    x, y = values
    return jnp.stack([10.0 * (y - x**2), 1.0 - x, 0.5 * (x + y - 3.0), x * y - 2.0])


def helical_valley(values, _):
    """Fletcher & Powell 1963; the minimum is 0 at (1, 0, 0)."""
    x, y, z = values
    return jnp.stack([10.0 * (z - 10.0 * jnp.arctan2(y, x) / (2.0 * np.pi)), 10.0 * (jnp.hypot(x, y) - 1.0), z])


@pytest.mark.parametrize(
    ("residual", "start"),
    [
        (rosenbrock, (-1.2, 1.0)),
        (rosenbrock, (3.0, -4.0)),
        (rosenbrock_that_cannot_be_met, (-1.2, 1.0)),
        (helical_valley, (-1.0, 0.1, 0.0)),
    ],
)
def test_curved_valleys_end_at_scipys_minimum(dtype, residual, start):
    with jax.enable_x64(True):
        numbers = jax.jit(lambda v: residual(v, None))
        expected = optimize.least_squares(lambda v: np.asarray(numbers(v)), start, **TIGHT)
    got = unbounded(residual, np.array(start, dtype), max_steps=200)
    assert result_name(got.result) == "successful"
    assert cost(got) == pytest.approx(expected.cost, rel=1e-4, abs=1e-6)
    np.testing.assert_allclose(got.value, expected.x, atol=2e-3)


def test_the_path_does_not_depend_on_the_units_of_the_parameters(x64):
    arguments = in_dtype(perez_data(0.02), np.float64)
    unit = jnp.asarray([1e3, 1.0, 1e-4, 7.0, 1e2])
    plain = unbounded(perez_residual, START, arguments, 4, 1e-12)
    scaled = unbounded(lambda u, a: perez_residual(u * unit, a), np.array(START) / unit, arguments, 4, 1e-12)
    assert int(plain.steps) == int(scaled.steps) == 4
    np.testing.assert_allclose(scaled.value * unit, plain.value, rtol=1e-6)


def between(lower, upper, dtype):
    lower, width = jnp.asarray(lower, dtype), jnp.asarray(np.subtract(upper, lower), dtype)
    return lambda free: lower + width * jax.nn.sigmoid(free)


@pytest.mark.parametrize(
    ("place", "name", "end"),
    [(2, "upper", 4.0), (0, "lower", -1.0), (4, "lower", 0.3), (3, "upper", -2.6)],
)
def test_a_bound_holds_and_the_others_are_scipys(dtype, place, name, end):
    arguments = perez_data(0.02)
    lower, upper = LOWER.copy(), UPPER.copy()
    (upper if name == "upper" else lower)[place] = end
    start = np.clip(START, lower + 0.02 * (upper - lower), upper - 0.02 * (upper - lower))
    bounded = {"bounds": (lower, upper), **TIGHT}
    expected = optimize.least_squares(perez_numpy, start, args=(arguments,), **bounded)
    share = (start - lower) / (upper - lower)
    got = solve(
        perez_residual, between(lower, upper, dtype), jnp.asarray(np.log(share / (1.0 - share)), dtype),
        in_dtype(arguments, dtype), jnp.full(5, LOGISTIC_LIMIT, dtype), 200,
    )  # fmt: skip
    assert result_name(got.result) == "successful"
    value = np.asarray(got.value, float)
    slack = 1e-6 * (upper - lower)
    assert np.all(value >= lower - slack) and np.all(value <= upper + slack)
    # the logistic curve leaves 3e-4 of the range to the bound
    np.testing.assert_allclose((value - expected.x) / (upper - lower), 0.0, atol=1e-3)
    edge = (upper - lower)[place] / (1.0 + np.exp(LOGISTIC_LIMIT))
    assert abs(value[place] - end) == pytest.approx(edge, rel=1e-2)


def test_a_parameter_leaves_its_bound_when_the_data_want_it_back(x64):
    """Convex problems in a box: what is not at scipy's minimum has stopped at a wrong bound."""

    @jax.jit
    def in_box(matrix, right):
        solution = least_squares(
            lambda v, a: a[0] @ v - a[1], jax.nn.sigmoid, jnp.zeros(4), (matrix, right),
            jnp.full(4, LOGISTIC_LIMIT), 200,
        )  # fmt: skip
        return solution.value, solution.result

    edge, wrong = 1.0 / (1.0 + np.exp(LOGISTIC_LIMIT)), {}
    for seed in range(60):
        rng = np.random.default_rng(seed)
        for correlated in (0.0, 0.5, 0.9):
            common, own = rng.standard_normal((20, 1)), rng.standard_normal((20, 4))
            matrix = 50.0 * (correlated * common + (1.0 - correlated) * own)
            right = matrix @ rng.uniform(-0.5, 1.5, 4) + 0.3 * rng.standard_normal(20)
            best = optimize.lsq_linear(matrix, right, (edge, 1.0 - edge), tol=1e-13)
            value, result = in_box(matrix, right)
            assert result_name(result) == "successful"
            got = 0.5 * np.sum((matrix @ np.asarray(value) - right) ** 2)
            if got > 1.01 * best.cost + 0.1:
                wrong[seed, correlated] = f"cost {got:.4g}, scipy's {best.cost:.4g}"
    assert not wrong


@pytest.mark.parametrize("scale", [1.0, 1e4])
def test_covariance_is_the_inverse_of_the_normal_matrix(dtype, scale):
    rng = np.random.default_rng(3)
    jacobian = rng.standard_normal((50, 4)) * np.array([1.0, 10.0, 0.1, 3.0])
    got, triangle = covariance(jnp.asarray(jacobian, dtype), jnp.full(4, scale, dtype))
    expected = np.linalg.inv(jacobian.T @ jacobian)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(got / size, expected / size, atol=1e-11 if dtype == np.float64 else 1e-5)
    assert got.dtype == dtype
    singular = np.linalg.svd(jacobian * scale, compute_uv=False)
    np.testing.assert_allclose(np.linalg.svd(triangle, compute_uv=False), singular, rtol=1e-5)


def test_covariance_of_units_that_differ_widely_holds_in_float32():
    rng = np.random.default_rng(4)
    units = np.array([1.0, 1e-5, 1e4])
    jacobian = rng.standard_normal((40, 3)) / units
    got, _ = covariance(jnp.asarray(jacobian, np.float32), jnp.asarray(units, np.float32))
    expected = np.linalg.inv((jacobian * units).T @ (jacobian * units))
    np.testing.assert_allclose(np.asarray(got) / np.outer(units, units), expected, atol=1e-6)


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_parameter_without_influence_stays_and_spoils_no_other(dtype, place):
    names = [i for i in range(3) if i != place]

    def residual(values, _):
        x, y = values[names[0]], values[names[1]]
        return jnp.stack([x - 1.0, x * y - 2.0, x + y - 3.5])

    start = np.array([3.0, 3.0, 3.0], dtype)
    start[place] = 7.0
    got = unbounded(residual, start)
    assert result_name(got.result) == "successful"
    assert float(got.value[place]) == 7.0
    expected = optimize.least_squares(lambda v: [v[0] - 1, v[0] * v[1] - 2, v[0] + v[1] - 3.5], [3, 3], **TIGHT)
    np.testing.assert_allclose(np.asarray(got.value)[names], expected.x, atol=2e-3)
    spread, _ = covariance(got.jacobian, jnp.ones(3, dtype))
    sigma = np.sqrt(np.diag(spread))
    assert sigma[place] > 1e6
    inverse = np.linalg.inv(expected.jac.T @ expected.jac)
    np.testing.assert_allclose(sigma[names], np.sqrt(np.diag(inverse)), rtol=1e-2)


def test_parameters_that_act_as_one_have_huge_sigmas_and_the_third_has_its_own(x64):
    got = unbounded(lambda v, _: jnp.stack([v[0] + v[1] - 1.0, v[2] - 2.0, v[2] + v[0] + v[1]]), [3.0, 7.0, 1.0])
    assert result_name(got.result) == "successful"
    np.testing.assert_allclose([got.value[0] + got.value[1], got.value[2]], [0.0, 1.0], atol=1e-4)
    spread, triangle = covariance(got.jacobian, jnp.ones(3))
    sigma = np.sqrt(np.diag(spread))
    assert np.all(~(sigma[:2] < 1e6))
    # sqrt(2 / 3) with the sum of the two as one parameter, 1 where rounding makes a third one of them
    assert 0.816 < sigma[2] < 1.001
    assert np.linalg.svd(triangle, compute_uv=False)[-1] < 1e-12


def test_a_start_that_is_nan_fails_without_an_exception(dtype):
    arguments = in_dtype(perez_data(0.02), dtype)
    got = unbounded(perez_residual, np.array([np.nan, *START[1:]], dtype), arguments)
    assert result_name(got.result) == "failed"


@pytest.mark.parametrize("poison", [np.nan, np.inf])
def test_data_that_are_not_finite_never_end_as_a_success(dtype, poison):
    theta, gamma, measured, weight = perez_data(0.02)
    measured[3] = poison
    got = unbounded(perez_residual, np.array(START, dtype), in_dtype((theta, gamma, measured, weight), dtype))
    assert result_name(got.result) != "successful"


def test_a_step_into_undefined_values_is_taken_back(dtype):
    got = unbounded(lambda v, _: jnp.stack([jnp.log(v[0]) + 3.0, v[1] - 1.0]), np.array([3.0, 7.0], dtype))
    assert result_name(got.result) == "successful"
    np.testing.assert_allclose(got.value, [np.exp(-3.0), 1.0], rtol=1e-3)


def test_the_number_of_steps_is_a_limit_that_is_told(dtype):
    arguments = in_dtype(perez_data(0.02), dtype)
    got = unbounded(perez_residual, np.array(START, dtype), arguments, max_steps=2)
    assert result_name(got.result) == "max_steps_reached"
    assert int(got.steps) == 2
    start = 0.5 * np.sum(perez_numpy(START, perez_data(0.02)) ** 2)
    assert cost(got) < start


def test_residual_and_jacobian_are_those_at_the_solution(x64):
    arguments = in_dtype(perez_data(0.2), np.float64)
    got = unbounded(perez_residual, START, arguments)
    np.testing.assert_allclose(got.residual, perez_residual(got.value, arguments), rtol=1e-9, atol=1e-9)
    expected = jax.jacfwd(perez_residual)(got.value, arguments)
    np.testing.assert_allclose(got.jacobian, expected, rtol=1e-9, atol=1e-9)


def test_jit_and_vmap_are_the_plain_solve(x64):
    theta, gamma, measured, weight = in_dtype(perez_data(0.02), np.float64)

    def value(data):
        solution = unbounded(perez_residual, START, (theta, gamma, data, weight))
        return solution.value, solution.steps

    skies = jnp.stack([measured, 1.1 * measured, measured**0.9])
    batched, steps = jax.jit(jax.vmap(value))(skies)
    for i, data in enumerate(skies):
        alone, count = value(data)
        np.testing.assert_allclose(batched[i], alone, rtol=1e-10)
        assert int(steps[i]) == int(count)


def _derivative_against_refitting(noise: float, place: int):
    """d value / d arguments[place] in a fixed direction: by the adjoint, and by fitting twice again."""
    arguments = list(in_dtype(perez_data(noise), np.float64))
    direction = arguments[place] * np.random.default_rng(5).standard_normal(200)

    @jax.jit
    def value(x):
        changed = tuple(x if i == place else a for i, a in enumerate(arguments))
        return unbounded(perez_residual, START, changed, 200, 1e-10).value

    got = jax.jit(jax.jacrev(value))(arguments[place]) @ direction
    step = 1e-4 * direction
    return got, (value(arguments[place] + step) - value(arguments[place] - step)) / 2e-4


def test_the_adjoint_of_a_fit_that_meets_the_data_is_the_change_of_a_new_fit(x64):
    got, expected = _derivative_against_refitting(0.0, 2)
    np.testing.assert_allclose(got / np.max(np.abs(expected)), expected / np.max(np.abs(expected)), atol=1e-5)


def test_the_adjoint_in_noisy_data_is_that_of_gauss_and_newton(x64):
    """The model's second derivatives are left out: off by about the size of the residual."""
    got, expected = _derivative_against_refitting(0.02, 2)
    np.testing.assert_allclose(got / np.max(np.abs(expected)), expected / np.max(np.abs(expected)), atol=0.01)
