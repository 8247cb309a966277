"""The extended form: its series and its maps, positive to twilight, and near skies that it was not fitted to."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import skyfit
from skyfit.analytic import ExtendedPreetham
from skyfit.numerics import as_float
from skyfit.scene import angle_between


@pytest.fixture(params=[False, True], ids=["float32", "float64"])
def double(request):
    with jax.enable_x64(request.param):
        yield request.param


def series(turbidity, sun):
    """The six numbers of each quantity by numpy's Chebyshev series."""
    coefficients = np.asarray(ExtendedPreetham.shipped().coefficients, float)
    t, s = 2.0 * math.log10(turbidity) - 1.0, 2.0 * (sun / math.radians(92.0)) ** 2 - 1.0
    return np.array([[np.polynomial.chebyshev.chebval2d(t, s, table) for table in of] for of in coefficients])


def by_hand(turbidity, sun, theta, gamma):
    """Luminance, x and y by the formulas of the docstring, in plain numpy."""
    result = []
    for u in series(turbidity, sun):
        steepness, width = np.exp(u[1]), np.exp(u[3])
        c, e = (-0.45 + 0.5 * (v + np.sqrt(v * v + 0.01)) for v in (u[2], u[4]))

        def horizon(angle, u=u, steepness=steepness):
            return 1.0 + (np.exp(u[0]) - 1.0) * np.exp(-steepness * (1.0 / np.cos(angle) - 1.0))

        def around(angle, c=c, e=e, width=width):
            return 1.0 + c * np.exp(-width * angle) + e * np.cos(angle) ** 2

        result.append(np.exp(u[5]) * horizon(theta) * around(gamma) / (horizon(0.0) * around(sun)))
    return np.array(result)


@pytest.mark.parametrize(("turbidity", "sun_deg"), [(1.0, 0.0), (1.3, 45.0), (3.0, 60.0), (6.0, 80.0), (10.0, 92.0)])
def test_the_formula(double, turbidity, sun_deg):
    sun, theta, gamma = math.radians(sun_deg), np.linspace(0.0, 1.5, 8), np.linspace(0.02, 2.6, 8)
    got = ExtendedPreetham.shipped().luminance_chromaticity(turbidity, sun, jnp.asarray(theta), jnp.asarray(gamma))
    np.testing.assert_allclose(np.stack(got), by_hand(turbidity, sun, theta, gamma), rtol=1e-9 if double else 2e-4)


def test_positive_finite_and_a_colour_everywhere(double):
    sky, view = ExtendedPreetham.shipped(), skyfit.hemisphere(150)
    # the horizon itself and the zenith
    zenith = jnp.concatenate([view.zenith, as_float([0.5 * np.pi, 0.0])])
    azimuth = jnp.concatenate([view.azimuth, as_float([0.3, 0.0])])
    turbidity, sun = (
        as_float(g.ravel()) for g in np.meshgrid(np.linspace(1.0, 10.0, 37), np.radians(np.linspace(0.0, 92.0, 47)))
    )

    @jax.jit
    def one(t, s):
        return jnp.stack(sky.luminance_chromaticity(t, s, zenith, angle_between(zenith, s, azimuth)))

    luminance, x, y = np.moveaxis(np.asarray(jax.lax.map(lambda c: one(*c), (turbidity, sun))), 1, 0)
    assert np.all(np.isfinite(luminance)) and luminance.min() > 1.0 and luminance.max() < 1e6
    assert x.min() > 0.1 and y.min() > 0.1
    assert (x + y)[:, np.asarray(zenith) < np.radians(89.0)].max() < 0.97


def test_near_skies_it_was_not_fitted_to():
    """The target of the issue, on fresh skies: to view zenith 80 and sun 85."""
    random = np.random.default_rng(7)
    turbidity, sun = as_float(random.uniform(1.0, 10.0, 24)), as_float(np.radians(random.uniform(0.0, 85.0, 24)))
    view, wavelength = skyfit.hemisphere(200), np.arange(380.0, 781.0, 10.0)
    model, solver = ExtendedPreetham.shipped(), skyfit.OrdersOfScattering.normal()
    irradiance = skyfit.Scene.from_degrees(0.0, view, wavelength).solar_irradiance

    @jax.jit
    def one(case):
        haze, angle = case
        scene = skyfit.Scene(angle, 0.0, view, wavelength, irradiance)
        simulated = skyfit.xyY(solver.radiance(skyfit.Atmosphere.from_turbidity(haze), scene), wavelength)
        gamma = angle_between(view.zenith, angle, view.azimuth)
        return simulated, jnp.stack(model.luminance_chromaticity(haze, angle, view.zenith, gamma), axis=-1)

    high = np.asarray(view.zenith) <= np.radians(80.0)
    simulated, got = (np.asarray(v)[:, high] for v in jax.lax.map(one, (turbidity, sun)))
    error = np.abs(got[..., 0] / simulated[..., 2] - 1.0)
    assert np.median(error) <= 0.04 and np.percentile(error, 95.0) <= 0.12
    distance = np.hypot(got[..., 1] - simulated[..., 0], got[..., 2] - simulated[..., 1])
    assert np.median(distance) <= 0.005


def test_gradients_are_finite_and_those_of_differences():
    with jax.enable_x64(True):
        sky, theta, gamma = ExtendedPreetham.shipped(), jnp.array([0.0, 0.8, 1.57]), jnp.array([0.0, 0.7, 2.4])

        @jax.jit
        def values(p):
            return jnp.stack(sky.luminance_chromaticity(p[0], p[1], theta, gamma))

        slopes = jax.jit(jax.jacfwd(values))
        for at in ([1.5, 0.3], [4.0, 1.1], [8.0, 1.55]):
            at = jnp.array(at)
            slope, step = np.asarray(slopes(at)), 1e-6
            for k in range(2):
                difference = np.asarray(values(at.at[k].add(step)) - values(at.at[k].add(-step))) / (2.0 * step)
                scale = np.abs(difference).max(axis=1, keepdims=True)
                np.testing.assert_allclose(slope[..., k] / scale, difference / scale, atol=1e-6)
        # the edges, the overhead sun, beyond
        for at in ([1.0, 0.0], [10.0, 1.6], [0.5, 2.0], [20.0, 1.0]):
            assert np.all(np.isfinite(slopes(jnp.array(at))))


def test_the_steepest_fit_is_finite_in_either_precision(double):
    """A fit to very thin air had B = -700: A overflowed, and every pixel was NaN."""
    shipped = ExtendedPreetham.shipped()
    steep = ExtendedPreetham(shipped.coefficients.at[:, [1, 3], 0, 0].add(7.0))
    assert float(steep.numbers(1.0, 0.5)[:, [1, 3]].max()) > 6.0
    scene = skyfit.Scene.from_degrees(30.0, skyfit.hemisphere(50), np.array([450.0, 550.0]))
    for values in (steep.xyz(1.0, scene), steep.rgb(1.0, skyfit.unit_vectors(0.5, 0.0), skyfit.fisheye(16))):
        assert np.all(np.isfinite(values))
    assert np.all(np.asarray(steep.xyz(1.0, scene))[:, 1] > 0.0)
    slope = jax.jacfwd(lambda t, s: steep.rgb(t, skyfit.unit_vectors(s, 0.0), skyfit.fisheye(8)), (0, 1))(1.5, 0.5)
    assert all(np.all(np.isfinite(part)) for part in slope)


def test_beyond_its_range_the_edge_holds_and_is_flagged(double):
    sky = ExtendedPreetham.shipped()
    for outside, edge in (((0.4, 0.5), (1.0, 0.5)), ((30.0, 0.5), (10.0, 0.5)), ((3.0, 2.5), (3.0, np.radians(92.0)))):
        np.testing.assert_allclose(sky.numbers(*outside), sky.numbers(*edge), rtol=1e-5, atol=1e-5)
        assert not bool(sky.valid(*outside)) and bool(sky.valid(*edge))
    assert not bool(sky.valid(np.nan, 0.5)) and not bool(sky.valid(3.0, -0.1))


@pytest.mark.parametrize(
    ("turbidity", "sun", "part"),
    [(0.9, 0.5, "`turbidity`"), (10.5, 0.5, "`turbidity`"), (np.nan, 0.5, "`turbidity`"), (3.0, 1.7, "`sun_zenith`"),
     (3.0, -0.1, "`sun_zenith`"), ([2.0, 11.0], 0.5, "got 11")],
)  # fmt: skip
def test_check_range_says_why(turbidity, sun, part):
    with pytest.raises(ValueError, match=part) as caught:
        ExtendedPreetham.shipped().check_range(turbidity, sun)
    assert "\n" not in str(caught.value)


def test_it_answers_what_every_analytic_sky_answers():
    sky, view = ExtendedPreetham.shipped(), skyfit.hemisphere(20)
    scene = skyfit.Scene.from_degrees(91.0, view, np.arange(380.0, 781.0, 5.0), 30.0)
    radiance, tristimulus = sky.radiance(1.2, scene), np.asarray(sky.xyz(1.2, scene))
    np.testing.assert_allclose(skyfit.xyz(radiance, scene.wavelength_nm)[:, 1], tristimulus[:, 1], rtol=1e-3)
    with pytest.raises(ValueError, match="`turbidity`"):
        sky.radiance(0.5, scene)
