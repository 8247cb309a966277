import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skyfit.analytic import Preetham


@pytest.fixture(params=[False, True], ids=["float32", "float64"])
def double(request):
    with jax.enable_x64(request.param):
        yield request.param


def sky(count=15):
    """View zenith and azimuth (from the sun) over the hemisphere, flat."""
    zenith, azimuth = np.meshgrid(np.linspace(0.0, math.radians(85.0), count), np.linspace(0.0, math.pi, count))
    return zenith.ravel(), azimuth.ravel()


def angle_from_sun(zenith, azimuth, sun):
    cosine = np.cos(zenith) * np.cos(sun) + np.sin(zenith) * np.sin(sun) * np.cos(azimuth)
    return np.arccos(np.clip(cosine, -1.0, 1.0))


# worked by hand from A.2: sun at the zenith, tan(chi) with chi = (4/9 - T/120) pi; x, y exact sums
@pytest.mark.parametrize(
    ("turbidity", "luminance", "x", "y"),
    [
        (2.0, 3.1196 * math.tan(77.0 * math.pi / 180.0) + 1.9882, 0.2667, 0.2773),
        (6.0, 19.3008 * math.tan(71.0 * math.pi / 180.0) + 1.1262, 0.2823, 0.2981),
    ],
)
def test_zenith_with_the_sun_overhead(double, turbidity, luminance, x, y):
    got = Preetham.published().zenith(turbidity, 0.0)
    # half a unit of the last digit that the paper prints
    assert float(got[0]) == pytest.approx(1000.0 * luminance, rel=2e-5)
    assert float(got[1]) == pytest.approx(x, abs=5e-5)
    assert float(got[2]) == pytest.approx(y, abs=5e-5)


def test_zenith_with_the_sun_at_60_degrees(double):
    t, s = 3.0, math.pi / 3
    luminance = (4.0453 * t - 4.9710) * math.tan((4 / 9 - t / 120) * (math.pi - 2 * s))
    luminance += -0.2155 * t + 2.4192
    x = t * t * (0.0017 * s**3 - 0.0037 * s**2 + 0.0021 * s)
    x += t * (-0.0290 * s**3 + 0.0638 * s**2 - 0.0320 * s + 0.0039)
    x += 0.1169 * s**3 - 0.2120 * s**2 + 0.0605 * s + 0.2589
    y = t * t * (0.0028 * s**3 - 0.0061 * s**2 + 0.0032 * s)
    y += t * (-0.0421 * s**3 + 0.0897 * s**2 - 0.0415 * s + 0.0052)
    y += 0.1535 * s**3 - 0.2676 * s**2 + 0.0667 * s + 0.2669
    got = Preetham.published().zenith(t, s)
    np.testing.assert_allclose(got, [1000.0 * luminance, x, y], rtol=1e-12 if double else 1e-5)
    # kcd m^-2 of a clear sky, in cd m^-2; a bluish zenith
    assert 3e3 < float(got[0]) < 1e4
    assert 0.24 < float(got[1]) < 0.30 and 0.24 < float(got[2]) < 0.31


def test_distribution_coefficients_at_turbidity_two(double):
    luminance, x, y = Preetham.published().perez(2.0, 0.0)
    expected = [-1.1056, -0.2833, 5.2797, -2.3359, 0.2363]
    np.testing.assert_allclose(luminance.coefficients, expected, atol=1e-6)
    np.testing.assert_allclose(x.coefficients, [-0.2978, -0.1322, 0.2117, -1.0271, 0.0386], atol=1e-6)
    np.testing.assert_allclose(y.coefficients, [-0.2942, -0.1808, 0.1944, -1.7419, 0.0311], atol=1e-6)


def test_zenith_direction_has_the_zenith_values(double):
    model = Preetham.published()
    got = model.luminance_chromaticity(3.0, 0.9, jnp.zeros(1), jnp.full(1, 0.9))
    for value, zenith in zip(got, model.zenith(3.0, 0.9), strict=True):
        np.testing.assert_allclose(value[0], zenith, rtol=1e-6)


@pytest.mark.parametrize("turbidity", [1.7, 2.0, 3.0, 6.0, 10.0])
def test_sky_is_bright_and_a_colour_within_the_range(double, turbidity):
    model = Preetham.published()
    for sun in (0.0, 0.6, 1.2, 1.55):
        zenith, azimuth = sky()
        gamma = angle_from_sun(zenith, azimuth, sun)
        luminance, x, y = model.luminance_chromaticity(turbidity, sun, jnp.asarray(zenith), jnp.asarray(gamma))
        assert np.all(np.asarray(luminance) > 0.0)
        assert np.all((np.asarray(x) > 0.15) & (np.asarray(y) > 0.15))
        assert np.all(np.asarray(x + y) < 1.0)
        # the sky is brightest within 20 degrees of the sun or at the horizon
        brightest = int(np.argmax(luminance))
        assert gamma[brightest] < 0.35 or zenith[brightest] > 1.3


def test_opposite_the_low_sun_is_bluer(double):
    model = Preetham.published()
    _, x, _ = model.luminance_chromaticity(2.5, 1.2, jnp.full(2, 0.9), jnp.array([0.3, 2.1]))
    assert float(x[1]) < float(x[0])


def test_published_luminance_is_singular_at_1_643():
    # ERRATA 10, DESIGN: 1 + A exp(B) = 0 at turbidity 1.643
    with jax.enable_x64(True):
        model = Preetham.published()

        def zenith(turbidity):
            return float(model.perez(turbidity, 0.5)[0].relative(jnp.array(0.0), jnp.array(0.5)))

        low, high = 1.5, 1.7
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if zenith(middle) > 0.0 else (middle, high)
        assert low == pytest.approx(1.643, abs=5e-4)
        theta, azimuth = sky()
        gamma = jnp.asarray(angle_from_sun(theta, azimuth, 0.5))

        def luminance(turbidity):
            return np.asarray(model.luminance_chromaticity(turbidity, 0.5, jnp.asarray(theta), gamma)[0])

        assert np.all(np.isfinite(luminance(low)))
        # on the near side of the pole the sky is absurdly bright, beyond it mostly negative
        assert luminance(1.65).max() > 10.0 * luminance(2.0).max()
        assert np.mean(luminance(1.6) < 0.0) > 0.5


@pytest.mark.parametrize(
    ("turbidity", "sun", "message"),
    [
        (1.69, 0.5, "`turbidity` must be at least 1.7, got 1.69.*1.643"),
        (1.643, 0.5, "`turbidity`"),
        (1.0, 0.5, "`turbidity`"),
        (float("nan"), 0.5, "`turbidity`"),
        (np.array([3.0, 1.2]), 0.5, "got 1.2"),
        (3.0, 1.6, "`sun_zenith` must be between 0 and pi/2.*got 1.6"),
        (3.0, -0.1, "`sun_zenith`"),
        (3.0, float("nan"), "`sun_zenith`"),
    ],
)
def test_check_range_says_why(turbidity, sun, message):
    with pytest.raises(ValueError, match=message):
        Preetham.published().check_range(turbidity, sun)


def test_check_range_passes_the_rest(double):
    model = Preetham.published()
    assert model.check_range(1.7, 0.0) is None
    assert model.check_range(12.0, jnp.asarray(math.pi / 2)) is None
    assert model.check_range(jnp.array([2.0, 9.0]), jnp.array([0.0, 1.5])) is None


def test_valid_flags_a_batch(double):
    turbidity = jnp.array([2.0, 10.0, 5.0, 5.0, 1.9, 10.1, 5.0, 5.0, jnp.nan])
    sun = jnp.array([0.0, 1.0, math.pi / 2, 0.3, 0.5, 0.5, 1.6, -0.1, 0.5])
    model = Preetham.published()
    got = jax.jit(jax.vmap(model.valid))(turbidity, sun)
    assert got.tolist() == [True] * 4 + [False] * 5
    # a refit with a negative zenith luminance says so itself
    sign = jnp.array([[-1.0], [-1.0], [1.0]])
    dark = eqx.tree_at(lambda m: m.zenith_luminance, model, sign * model.zenith_luminance)
    assert not bool(dark.valid(5.0, 0.5))


def test_a_refit_is_the_same_class_with_its_own_range(double):
    model = Preetham.published()
    refit = Preetham(
        2.0 * model.distribution,
        model.zenith_luminance,
        model.zenith_chromaticity,
        lowest_turbidity=1.05,
        fitted_turbidity=(1.1, 8.0),
    )
    refit.check_range(1.1, 0.5)
    assert bool(refit.valid(1.2, 0.5)) and not bool(refit.valid(9.0, 0.5))
    assert [leaf.shape for leaf in jax.tree.leaves(refit)] == [(3, 5, 2), (3, 2), (2, 3, 4)]
    np.testing.assert_allclose(
        refit.perez(3.0, 0.5)[0].coefficients, 2.0 * model.perez(3.0, 0.5)[0].coefficients, rtol=1e-6
    )


def test_values_and_gradients_are_finite_outside_and_at_the_edges(double):
    model = Preetham.published()
    half = math.pi / 2
    theta = jnp.asarray([0.0, 0.5, half - 1e-6, half, half + 0.1, math.pi])
    gamma = jnp.asarray([0.5, 0.0, 0.0, 1.0, math.pi, 2.0])

    def one(m, turbidity, sun, t, g):
        return jnp.stack(m.luminance_chromaticity(turbidity, sun, t, g))

    slope = jax.jacfwd(one, argnums=(0, 1, 2, 3, 4))
    both = eqx.filter_jit(lambda *at: (one(*at), slope(*at)))
    for turbidity in (1.0, 1.643, 2.0, 6.0, 30.0):
        for sun in (0.0, 0.5, half, 1.7, math.pi):
            arguments = [jnp.asarray(turbidity), jnp.asarray(sun), theta, gamma]
            for leaf in jax.tree.leaves(both(model, *arguments)):
                assert np.all(np.isfinite(leaf))


def test_the_tangent_of_a_refit_does_not_cross_its_pole(double):
    # chi = 0.6 pi with the sun overhead, taken as 1.5
    model = Preetham.published()
    values = jnp.array([[0.0, 1.0], [0.0, 0.0], [0.0, 0.6]])
    steep = eqx.tree_at(lambda m: m.zenith_luminance, model, values)
    assert float(steep.zenith(3.0, 0.0)[0]) == pytest.approx(1000.0 * math.tan(1.5), rel=1e-5)


def test_gradient_in_turbidity_and_sun_is_the_central_difference():
    with jax.enable_x64(True):
        model = Preetham.published()
        theta, gamma = jnp.array([0.0, 0.8, 1.5]), jnp.array([0.7, 0.1, 2.0])

        @jax.jit
        def values(p):
            return jnp.stack(model.luminance_chromaticity(p[0], p[1], theta, gamma))

        at, step = jnp.array([3.0, 0.7]), 1e-6
        slope = np.asarray(jax.jit(jax.jacfwd(values))(at))
        for k in range(2):
            up, down = values(at.at[k].add(step)), values(at.at[k].add(-step))
            difference = np.asarray(up - down) / (2 * step)
            scale = np.abs(difference).max(axis=1, keepdims=True)
            np.testing.assert_allclose(slope[..., k] / scale, difference / scale, atol=1e-7)


def test_float32_is_near_float64_and_vmap_is_the_loop():
    results = []
    turbidity, sun = np.array([2.0, 4.0, 8.0]), np.array([0.2, 0.9, 1.4])
    theta, gamma = np.linspace(0.0, 1.5, 7), np.linspace(0.0, 2.5, 7)
    for wide in (False, True):
        with jax.enable_x64(wide):
            model = Preetham.published()
            arrays = [jnp.asarray(a) for a in (theta, gamma)]

            @jax.jit
            def one(t, s, model=model, arrays=arrays):
                return jnp.stack(model.luminance_chromaticity(t, s, *arrays))

            batch = jax.vmap(one)(jnp.asarray(turbidity), jnp.asarray(sun))
            loop = jnp.stack([one(t, s) for t, s in zip(turbidity, sun, strict=True)])
            np.testing.assert_allclose(batch, loop, rtol=1e-12 if wide else 1e-5)
            results.append(np.asarray(batch))
    assert results[0].dtype == np.float32 and results[1].dtype == np.float64
    np.testing.assert_allclose(*results, rtol=2e-4)


def test_five_digits_round_to_the_four_that_are_printed_and_tame_the_zenith_of_haze():
    with jax.enable_x64(True):
        four, five = Preetham.published(), Preetham.published(digits=5)
        for printed, finer in zip(jax.tree.leaves(four), jax.tree.leaves(five), strict=True):
            # a five in the last place may round either way
            assert np.abs(np.asarray(printed) - np.asarray(finer)).max() < 0.5001e-4 + 1e-9
        np.testing.assert_array_equal(four.zenith_luminance, five.zenith_luminance)
        (_, x, _), (_, finer_x, _) = (model.zenith(8.0, np.radians(80.0)) for model in (four, five))
        assert 0.04 < abs(float(x) / float(finer_x) - 1.0) < 0.08
