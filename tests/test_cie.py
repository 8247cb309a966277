"""The CIE's skies: closed forms of their integrals, the printed equations, and the way from clear to overcast."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import dblquad, quad

import skyfit
from skyfit.analytic import CIEClear, Intermediate, overcast_luminance, overcast_zenith_luminance, Preetham
from skyfit.light import srgb_from_xyz, WHITE, xyz_from_xyY
from skyfit.scene import angle_between


WAVELENGTH = np.arange(380.0, 781.0, 10.0)


def printed_clear(theta, gamma, sun):
    """Eq. 1 over the zenith luminance."""
    above = (0.91 + 10.0 * np.exp(-3.0 * gamma) + 0.45 * np.cos(gamma) ** 2) * (1.0 - np.exp(-0.32 / np.cos(theta)))
    below = (0.91 + 10.0 * np.exp(-3.0 * sun) + 0.45 * np.cos(sun) ** 2) * (1.0 - np.exp(-0.32))
    return above / below


# --- clear


@pytest.mark.parametrize("sun", [0.0, 0.6, 1.4])
def test_the_clear_sky_is_equation_one(x64, sun):
    theta, gamma = np.linspace(0.0, 1.5, 11), np.linspace(0.0, 2.8, 11)
    found, x, y = CIEClear().luminance_chromaticity(3.0, sun, theta, gamma)
    np.testing.assert_allclose(found / CIEClear().zenith(3.0, sun)[0], printed_clear(theta, gamma, sun), rtol=1e-12)
    np.testing.assert_allclose(jnp.stack([x, y], axis=-1), np.tile(WHITE, (11, 1)), rtol=1e-12)


@pytest.mark.parametrize("sky", [CIEClear(), Intermediate(Preetham.published())], ids=["clear", "overcast"])
def test_a_grey_sky_is_grey_on_a_screen(x64, sky):
    """Not pink, as equal energy is."""
    theta, gamma = jnp.array([0.0, 0.8, 1.4]), jnp.array([0.9, 0.2, 2.0])
    luminance, x, y = sky.luminance_chromaticity(12.0, 0.9, theta, gamma)
    rgb = srgb_from_xyz(xyz_from_xyY(jnp.stack([x, y, luminance], axis=-1)), 1e-5)
    assert float(jnp.max(jnp.ptp(rgb, axis=-1))) < 5e-4 and float(jnp.min(rgb)) > 0.0


def test_the_clear_zenith_and_its_range(x64):
    # 45 degrees: (1.376 T - 1.81) + 0.38 kcd m^-2
    assert float(CIEClear().zenith(2.5, np.pi / 4)[0]) == pytest.approx(2010.0, rel=1e-9)
    assert float(CIEClear().zenith(2.5, 0.0)[0]) == float(CIEClear().zenith(2.5, np.radians(3.0))[0])
    assert float(CIEClear().zenith(2.5, 3.0)[0]) == pytest.approx(380.0)
    sky = CIEClear()
    assert sky.check_range(1.32, 0.2) is None and sky.check_range(np.array([2.0, 9.0]), np.pi / 2) is None
    with pytest.raises(ValueError, match="`turbidity` must leave the zenith a positive luminance.*got 1"):
        sky.check_range(1.0, 0.3)
    with pytest.raises(ValueError, match="`turbidity`"):
        sky.check_range(float("nan"), 0.3)
    with pytest.raises(ValueError, match="`sun_zenith` must be between 0 and pi/2.*got 1.7"):
        sky.check_range(3.0, 1.7)
    flags = jax.vmap(sky.valid)(jnp.array([2.0, 2.0, 2.0, 1.0, jnp.nan]), jnp.array([0.5, 0.01, 1.6, 0.3, 0.5]))
    assert flags.tolist() == [True, False, False, False, False]


# --- overcast


def test_the_overcast_sky_is_a_third_as_bright_at_the_horizon(x64):
    values = overcast_luminance(1.0, jnp.array([0.0, np.pi / 3, np.pi / 2, 2.0, np.pi]))
    zenith = float(overcast_zenith_luminance(1.0))
    np.testing.assert_allclose(values / zenith, [1.0, 2.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0], rtol=1e-12)


def test_its_illuminance_is_seven_ninths_of_pi_times_the_zenith(x64):
    """By quadrature; and the illuminance 300 + 21000 sin h of Krochmann & Seidl and DIN 5034-2 to 0.2 %."""
    for sun in (0.0, 1.0, np.pi / 2):
        zenith = float(overcast_zenith_luminance(sun))

        def ring(theta, sun=sun):
            luminance = float(overcast_luminance(sun, jnp.asarray(theta)))
            return 2.0 * np.pi * luminance * np.cos(theta) * np.sin(theta)

        illuminance = quad(ring, 0.0, np.pi / 2, epsrel=1e-8)[0]
        assert illuminance == pytest.approx(7.0 * np.pi / 9.0 * zenith, rel=1e-7)
        assert illuminance == pytest.approx(300.0 + 21000.0 * np.cos(sun), rel=2e-3)
    # the sun below the horizon: as on it
    assert float(overcast_zenith_luminance(2.5)) == pytest.approx(123.0)


# --- between


def test_up_to_six_it_is_preetham_and_from_ten_the_overcast_sky(x64):
    clear = Preetham.published()
    sky = Intermediate(clear)
    theta, gamma = jnp.array([0.0, 0.8, 1.4]), jnp.array([0.9, 0.2, 2.0])
    for turbidity in (2.0, 6.0):
        found = sky.luminance_chromaticity(turbidity, 0.9, theta, gamma)
        np.testing.assert_allclose(found, clear.luminance_chromaticity(turbidity, 0.9, theta, gamma), rtol=1e-12)
    for turbidity in (10.0, 15.0, 60.0):
        luminance, x, y = sky.luminance_chromaticity(turbidity, 0.9, theta, gamma)
        np.testing.assert_allclose(luminance, overcast_luminance(0.9, theta), rtol=1e-12)
        np.testing.assert_allclose(jnp.stack([x, y], axis=-1), np.tile(WHITE, (3, 1)), rtol=1e-12)


def test_halfway_it_is_half_of_both_lights(x64):
    clear = Preetham.published()
    sky = Intermediate(clear)
    theta, gamma = jnp.array([0.3, 1.2]), jnp.array([0.5, 1.9])
    luminance, x, y = sky.luminance_chromaticity(8.0, 0.7, theta, gamma)
    clear_luminance, clear_x, clear_y = clear.luminance_chromaticity(8.0, 0.7, theta, gamma)
    grey = overcast_luminance(0.7, theta)
    np.testing.assert_allclose(luminance, 0.5 * (clear_luminance + grey), rtol=1e-12)
    # centre of gravity of the two chromaticities with weights Y / y
    left, right = clear_luminance / clear_y, grey / WHITE[1]
    np.testing.assert_allclose(x, (left * clear_x + right * WHITE[0]) / (left + right), rtol=1e-12)
    np.testing.assert_allclose(y, (left * clear_y + right * WHITE[1]) / (left + right), rtol=1e-12)


def test_spectra_are_mixed_as_their_luminances_are(x64):
    view = skyfit.hemisphere(7)
    scene = skyfit.Scene.from_degrees(50.0, view, WAVELENGTH)
    clear = jnp.linspace(0.02, 0.08, 7)[:, None] * jnp.linspace(2.0, 1.0, WAVELENGTH.size)[None]
    sky = Intermediate(CIEClear())
    for turbidity, share in ((3.0, 0.0), (8.0, 0.5), (12.0, 1.0)):
        assert float(sky.overcast_share(turbidity)) == share
        found = skyfit.xyz(sky.radiance(turbidity, scene, clear), WAVELENGTH)[:, 1]
        grey = overcast_luminance(scene.sun_zenith, view.zenith)
        expected = (1.0 - share) * skyfit.xyz(clear, WAVELENGTH)[:, 1] + share * grey
        np.testing.assert_allclose(found, expected, rtol=1e-7)


def test_below_the_horizon_the_mixed_sky_is_dark():
    scene = skyfit.Scene.from_degrees(50.0, skyfit.Directions(np.array([1.0, 2.0]), np.zeros(2)), WAVELENGTH)
    sky = Intermediate(CIEClear())
    found = np.asarray(sky.radiance(12.0, scene, jnp.zeros((2, WAVELENGTH.size))))
    assert np.all(found[0] > 0.0) and np.all(found[1] == 0.0)


def test_the_share_is_smooth_and_its_slope_is_the_central_difference(x64):
    sky = Intermediate(Preetham.published())
    turbidity = jnp.linspace(2.0, 14.0, 49)
    share = jax.vmap(sky.overcast_share)(turbidity)
    assert np.all(np.diff(share) >= 0.0)
    slope = jax.vmap(jax.grad(sky.overcast_share))
    assert np.all(np.isfinite(slope(turbidity)))
    np.testing.assert_allclose(slope(jnp.array([6.0 + 1e-6, 10.0 - 1e-6])), 0.0, atol=1e-5)

    @jax.jit
    def values(p):
        theta, gamma = jnp.array([0.0, 1.1]), jnp.array([0.8, 0.4])
        return jnp.stack(Intermediate(sky.clear, p[2], p[3]).luminance_chromaticity(p[0], p[1], theta, gamma))

    at = jnp.array([7.3, 0.8, 5.0, 11.0])
    found = jax.jit(jax.jacfwd(values))(at)
    for i in range(4):
        step = 1e-6 * jnp.eye(4)[i]
        central = np.asarray(values(at + step) - values(at - step)) / 2e-6
        np.testing.assert_allclose(found[..., i], central, rtol=1e-5, atol=1e-6)


def test_the_two_turbidities_must_be_in_order():
    with pytest.raises(ValueError, match="`clear_turbidity` must be below `overcast_turbidity`, got 9"):
        Intermediate(CIEClear(), 9.0, 8.0)


def test_everything_is_finite_everywhere():
    theta = jnp.array([0.0, 1.2, np.pi / 2, 2.0, np.pi])
    gamma = jnp.array([0.0, 0.5, 1.0, 2.0, np.pi])
    sky = Intermediate(Preetham.published())

    def one(sky, turbidity, sun, theta, gamma):
        return jnp.stack([*sky.luminance_chromaticity(turbidity, sun, theta, gamma), overcast_luminance(sun, theta)])

    slopes = eqx.filter_jit(lambda *p: (one(*p), jax.jacfwd(one, argnums=(0, 1, 2, 3, 4))(*p)))
    for kind in (sky, Intermediate(CIEClear())):
        for turbidity in (1.0, 6.0, 8.0, 10.0, 100.0):
            for sun in (0.0, 0.7, np.pi / 2, np.pi):
                both = slopes(kind, jnp.asarray(turbidity), jnp.asarray(sun), theta, gamma)
                assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(both))


def test_vmap_is_the_loop_and_float32_near_float64():
    turbidity, sun = np.array([3.0, 7.0, 9.0]), np.array([0.3, 0.9, 1.4])
    theta = np.linspace(0.0, 1.5, 6)
    results = []
    for wide in (False, True):
        with jax.enable_x64(wide):
            sky = Intermediate(Preetham.published())
            view = jnp.asarray(theta)

            @jax.jit
            def one(t, s, sky=sky, view=view):
                gamma = angle_between(view, s, jnp.asarray(0.8))
                return jnp.stack(sky.luminance_chromaticity(t, s, view, gamma))

            batch = jax.jit(jax.vmap(one))(jnp.asarray(turbidity), jnp.asarray(sun))
            loop = jnp.stack([one(*pair) for pair in zip(jnp.asarray(turbidity), jnp.asarray(sun), strict=True)])
            np.testing.assert_allclose(batch, loop, rtol=1e-11 if wide else 2e-5)
            results.append(np.asarray(batch))
    assert results[0].dtype == np.float32
    np.testing.assert_allclose(*results, rtol=2e-4)


def test_the_clear_sky_lights_the_ground_as_its_quadrature_says(x64):
    """By a sum over the spiral of directions and by scipy of the printed equation."""
    sun = 0.9
    view = skyfit.hemisphere(4000)
    gamma = angle_between(view.zenith, sun, view.azimuth)
    found, _, _ = CIEClear().luminance_chromaticity(3.0, sun, view.zenith, gamma)
    spiral = float(jnp.sum(found * view.weight * jnp.cos(view.zenith)))

    def integrand(theta, azimuth):
        cosine = np.cos(theta) * np.cos(sun) + np.sin(theta) * np.sin(sun) * np.cos(azimuth)
        shape = printed_clear(theta, np.arccos(np.clip(cosine, -1.0, 1.0)), sun)
        return shape * np.cos(theta) * np.sin(theta)

    whole = 2.0 * dblquad(integrand, 0.0, np.pi, 0.0, 0.5 * np.pi - 1e-9, epsrel=1e-4)[0]
    assert spiral == pytest.approx(whole * float(CIEClear().zenith(3.0, sun)[0]), rel=2e-3)
