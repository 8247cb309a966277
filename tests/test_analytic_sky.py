"""What every analytic sky answers with its luminance and chromaticity: tristimulus values, spectra and pixels."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

from skyfit.analytic import ExtendedPreetham, pixels, Preetham
from skyfit.draw.dome import place
from skyfit.light import SRGB_FROM_XYZ, xyY
from skyfit.scene import Directions, fisheye, hemisphere, Scene, unit_vectors
from skyfit.tables import read_table


NODES = read_table("cie_daylight_basis.csv")["wavelength_nm"]


@pytest.fixture(params=[False, True], ids=["float32", "float64"])
def double(request):
    with jax.enable_x64(request.param):
        yield request.param


def scene(sun_deg=60.0, view=None, wavelength_nm=NODES, sun_azimuth=40.0):
    view = hemisphere(60) if view is None else view
    return Scene.from_degrees(sun_deg, view, wavelength_nm, sun_azimuth, irradiance="unit")


def vectors(at: Scene):
    return unit_vectors(at.sun_zenith, at.sun_azimuth), unit_vectors(at.view.zenith, at.view.azimuth)


def by_hand(t, s, theta, gamma):
    """Y, x, y of Preetham 1999 eq. 3, 4 and A.2, written out from the paper's page."""

    def f(a, b, c, d, e, theta, gamma):
        return (1 + a * math.exp(b / math.cos(theta))) * (1 + c * math.exp(d * gamma) + e * math.cos(gamma) ** 2)

    luminance = (4.0453 * t - 4.9710) * math.tan((4 / 9 - t / 120) * (math.pi - 2 * s)) - 0.2155 * t + 2.4192
    x = t * t * (0.0017 * s**3 - 0.0037 * s**2 + 0.0021 * s)
    x += t * (-0.0290 * s**3 + 0.0638 * s**2 - 0.0320 * s + 0.0039)
    x += 0.1169 * s**3 - 0.2120 * s**2 + 0.0605 * s + 0.2589
    y = t * t * (0.0028 * s**3 - 0.0061 * s**2 + 0.0032 * s)
    y += t * (-0.0421 * s**3 + 0.0897 * s**2 - 0.0415 * s + 0.0052)
    y += 0.1535 * s**3 - 0.2676 * s**2 + 0.0667 * s + 0.2669
    shapes = (
        (0.1787 * t - 1.4630, -0.3554 * t + 0.4275, -0.0227 * t + 5.3251, 0.1206 * t - 2.5771, -0.0670 * t + 0.3703),
        (-0.0193 * t - 0.2592, -0.0665 * t + 0.0008, -0.0004 * t + 0.2125, -0.0641 * t - 0.8989, -0.0033 * t + 0.0452),
        (-0.0167 * t - 0.2608, -0.0950 * t + 0.0092, -0.0079 * t + 0.2102, -0.0441 * t - 1.6537, -0.0109 * t + 0.0529),
    )
    zenith = (1000.0 * luminance, x, y)
    return [value * f(*row, theta, gamma) / f(*row, 0.0, s) for value, row in zip(zenith, shapes, strict=True)]


# turbidity, sun zenith, view zenith and azimuth from the sun, degrees
CASES = [(2.5, 40.0, 70.0, 25.0), (4.0, 75.0, 30.0, 160.0), (6.0, 20.0, 85.0, 90.0)]


@pytest.mark.parametrize(("turbidity", "sun", "zenith", "azimuth"), CASES)
def test_values_are_the_papers_worked_by_hand(turbidity, sun, zenith, azimuth, double):
    at = scene(sun, Directions.from_degrees([zenith], [azimuth + 40.0]))
    s, theta, phi = (math.radians(a) for a in (sun, zenith, azimuth))
    gamma = math.acos(math.cos(s) * math.cos(theta) + math.sin(s) * math.sin(theta) * math.cos(phi))
    luminance, x, y = by_hand(turbidity, s, theta, gamma)
    expected = np.array([x * luminance / y, luminance, (1 - x - y) * luminance / y])
    model, tolerance = Preetham.published(), 1e-10 if double else 2e-5
    np.testing.assert_allclose(model.xyz(turbidity, at)[0], expected, rtol=tolerance)
    sun_vector, view = vectors(at)
    # the fast path replaces the arc cosine by a polynomial, right to 3e-8 rad
    linear = np.array(SRGB_FROM_XYZ) @ expected
    np.testing.assert_allclose(model.rgb(turbidity, sun_vector, view)[:, 0], linear, rtol=1e-7 if double else 5e-5)
    # the paper's Table 2 at 450 and 650 nm, and its M1 and M2
    below = 0.0241 + 0.2562 * x - 0.7341 * y
    first, second = (-1.3515 - 1.7703 * x + 5.9114 * y) / below, (0.0300 - 31.4424 * x + 30.0717 * y) / below
    blue, red = 125.6 + first * 35.9 - second * 2.9, 81.9 - first * 10.7 + second * 7.3
    got = model.radiance(turbidity, at)[0]
    ratio = got[np.flatnonzero(NODES == 450.0)[0]] / got[np.flatnonzero(NODES == 650.0)[0]]
    assert float(ratio) == pytest.approx(blue / red, rel=1e-9 if double else 5e-5)


@pytest.mark.parametrize(("turbidity", "sun"), [(2.0, 0.0), (2.0, 60.0), (4.0, 80.0), (8.0, 30.0)])
def test_radiance_has_the_luminance_and_the_chromaticity_of_the_model(turbidity, sun, double):
    model, at = Preetham.published(), scene(sun)
    radiance, tristimulus = model.radiance(turbidity, at), model.xyz(turbidity, at)
    assert radiance.shape == (60, NODES.size)
    got, total = xyY(radiance, NODES), jnp.sum(tristimulus, axis=-1)
    # where the printed spectrum is negative, beside a low sun, the luminance is larger
    np.testing.assert_allclose(got[:, 2], tristimulus[:, 1], rtol=2e-4 if sun > 75.0 else 5e-6)
    for k in range(2):
        np.testing.assert_allclose(got[:, k], tristimulus[:, k] / total, atol=3e-3 if sun > 75.0 else 2e-4)


def test_neither_the_wavelengths_nor_the_suns_light_change_the_scale(double):
    model = Preetham.published()
    few = np.array([400.0, 555.0, 712.0])
    whole = model.radiance(3.0, scene())[:, np.isin(NODES, few)]
    at = scene(wavelength_nm=few)
    bright = eqx.tree_at(lambda s: s.solar_irradiance, at, 7.0 * at.solar_irradiance)
    got = model.radiance(3.0, bright)
    np.testing.assert_allclose(got[:, :2], whole, rtol=1e-12 if double else 5e-6)


def test_below_the_horizon_it_is_dark_and_on_it_bright(double):
    view = Directions(jnp.array([math.pi / 2, 1.60, math.pi]), jnp.zeros(3))
    model, at = Preetham.published(), scene(view=view)
    values = model.xyz(3.0, at), model.radiance(3.0, at), model.rgb(3.0, *vectors(at)).T
    for value in values:
        assert float(value[0].max()) > 0.0
        np.testing.assert_array_equal(value[1:], 0.0)


def test_what_the_model_has_no_answer_for_is_refused_where_it_can_be_seen(double):
    model, at = Preetham.published(), scene()
    sun, view = vectors(at)
    calls = {
        "radiance": lambda t, s: model.radiance(t, s),
        "xyz": lambda t, s: model.xyz(t, s),
        "rgb": lambda t, s: model.rgb(t, unit_vectors(s.sun_zenith, s.sun_azimuth), view),
    }
    night = scene(95.0)
    for call in calls.values():
        for turbidity in (1.5, 1.643, jnp.asarray(1.69)):
            with pytest.raises(ValueError, match="`turbidity` must be at least 1.7.*1.643"):
                call(turbidity, at)
        with pytest.raises(ValueError, match="`sun_zenith` must be between 0 and pi/2"):
            call(3.0, night)
        # the scene is traced, the turbidity is not
        with pytest.raises(ValueError, match="`turbidity`"):
            eqx.filter_jit(lambda s, call=call: call(1.5, s))(at)
        # traced values: finite, never negative radiance, and `valid` says that they are worth nothing
        for turbidity, s in ((1.5, at), (3.0, night), (14.0, scene(89.9))):
            result = eqx.filter_jit(call)(jnp.asarray(turbidity), s)
            assert np.all(np.isfinite(result))
            assert not bool(model.valid(turbidity, s.sun_zenith))
            if call is calls["radiance"]:
                assert np.all(np.asarray(result) >= 0.0)
    assert model.rgb(1.7, sun, view).shape == (3, 60)


def test_shapes_that_would_be_taken_for_others_are_refused(double, monkeypatch):
    # the tests' own check of annotations would be first
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    model, at = Preetham.published(), scene()
    sun, view = vectors(at)
    for call in (lambda t: model.xyz(t, at), lambda t: model.radiance(t, at), lambda t: model.rgb(t, sun, view)):
        with pytest.raises(ValueError, match=r"`turbidity` must be one number .* got shape \(5,\)"):
            call(np.linspace(2.0, 6.0, 5))
    for wrong in ((sun, view.T), (sun[:2], view), (jnp.asarray(1.0), view)):
        with pytest.raises(ValueError, match="`sun` and `view` must have east, north, up as their first axis"):
            model.rgb(3.0, *wrong)


def test_a_batch_is_flagged_and_raises_nothing(double):
    model, turbidity = Preetham.published(), jnp.array([1.2, 2.0, 9.0, 12.0])
    at = scene(wavelength_nm=np.array([450.0, 550.0]))
    got = jax.jit(jax.vmap(lambda t: (model.radiance(t, at), model.valid(t, at.sun_zenith))))(turbidity)
    assert got[1].tolist() == [False, True, True, False]
    assert np.all(np.isfinite(got[0]))


@pytest.mark.parametrize("turbidity", [2.0, 8.0])
@pytest.mark.parametrize("sun", [0.0, 45.0, 90.0])
def test_pixels_are_the_matrix_times_the_tristimulus_values(turbidity, sun, double):
    model, at = Preetham.published(), scene(sun, hemisphere(500))
    with jax.enable_x64(True):
        exact = np.asarray(Preetham.published().xyz(turbidity, scene(sun, hemisphere(500)))) @ SRGB_FROM_XYZ.T
    got = np.asarray(model.rgb(turbidity, *vectors(at))).T
    np.testing.assert_allclose(got, exact, atol=(1e-7 if double else 1e-5) * np.abs(exact).max())


def test_colours_outside_the_screens_range_are_kept_paled_or_flagged(double):
    """At the horizon of thin haze under a low sun; of a batch, what is out of range is NaN too."""
    model, at = ExtendedPreetham.shipped(), scene(88.0, hemisphere(600))
    kept, pale, none = (np.asarray(model.rgb(1.7, *vectors(at), outside=name)) for name in ("kept", "pale", "nan"))
    low = kept.min(axis=0) < 0.0
    assert 0 < low.sum() < 20 and kept.min() < -1000.0 and pale.min() > -1e-6 * kept.max()
    assert np.isnan(none[:, low]).all()
    np.testing.assert_array_equal(none[:, ~low], kept[:, ~low])
    np.testing.assert_allclose(pale[:, ~low], kept[:, ~low], rtol=1e-6)
    weight = np.array([0.2126, 0.7152, 0.0722])
    np.testing.assert_allclose(weight @ pale, weight @ kept, rtol=1e-4)
    batch = jax.vmap(lambda t: model.rgb(t, *vectors(at), outside="nan"))(jnp.asarray([0.2, 3.0, 30.0]))
    assert np.isnan(batch[0]).all() and np.isfinite(batch[1]).any() and np.isnan(batch[2]).all()
    with pytest.raises(ValueError, match="`outside` must be one of kept, pale, nan"):
        model.rgb(3.0, *vectors(at), outside="clip")


def test_pixels_of_an_image_are_those_of_its_directions(double):
    model, image = Preetham.published(), fisheye(9)
    sun = unit_vectors(0.8, 2.0)
    got = model.rgb(3.0, sun, image)
    assert got.shape == (3, 9, 9) and got.dtype == image.dtype
    np.testing.assert_array_equal(got.reshape(3, -1), model.rgb(3.0, sun, image.reshape(3, -1)))
    # the corners are outside the dome
    np.testing.assert_array_equal(got[:, 0, 0], 0.0)
    assert np.all(np.asarray(got[:, 4, :]) > 0.0)


def test_fisheye_is_where_a_drawn_dome_puts_a_direction(double):
    image = np.asarray(fisheye(8), dtype=float)
    zenith, azimuth = np.arccos(image[2]), np.arctan2(image[0], image[1])
    x, y = place(zenith, azimuth)
    edge = (np.arange(8) + 0.5) / 4.0 - 1.0
    # the arc cosine of a float32 near the zenith has half its digits
    tolerance = 1e-12 if double else 2e-4
    np.testing.assert_allclose(x, np.broadcast_to(edge, (8, 8)), atol=tolerance)
    np.testing.assert_allclose(y, np.broadcast_to(edge[::-1, None], (8, 8)), atol=tolerance)
    np.testing.assert_allclose(np.linalg.norm(image, axis=0), 1.0, rtol=1e-12 if double else 2e-7)
    # odd: the middle pixel is the zenith itself
    np.testing.assert_allclose(fisheye(3)[:, 1, 1], [0.0, 0.0, 1.0], atol=1e-7)
    with pytest.raises(ValueError, match="`size` must be >= 1, got 0"):
        fisheye(0)


def test_the_angle_from_the_sun_keeps_its_digits(double):
    away = np.concatenate([[0.0], np.geomspace(1e-6, 1.0, 40), np.linspace(1.0, math.pi, 40)])
    with jax.enable_x64(True):
        view = np.asarray(unit_vectors(away, np.full_like(away, 0.7)))
    view, sun = jnp.asarray(view), jnp.asarray([0.0, 0.0, 1.0])
    angle, slant = pixels.geometry(sun, view)
    if double:
        np.testing.assert_allclose(angle, away, atol=3e-8)
    else:
        np.testing.assert_allclose(angle, away, rtol=1e-6, atol=1e-6)
    lit = np.cos(away) > 0.01
    np.testing.assert_allclose(slant[lit], 1.0 / np.cos(away[lit]), rtol=1e-12 if double else 1e-5)
    np.testing.assert_array_equal(slant[np.cos(away) < -1e-3], -1.0)


def test_gradients_are_finite_at_the_sun_opposite_to_it_at_the_zenith_and_below_the_horizon(double):
    model = Preetham.published()
    zenith, azimuth = jnp.array([1.0, math.pi / 2, 0.0, 2.0]), jnp.array([0.5, 0.5 + math.pi, 0.0, 0.0])
    view = Directions(zenith, azimuth)

    def spectra(t, sun):
        return model.radiance(t, eqx.tree_at(lambda s: s.sun_zenith, scene(view=view, sun_azimuth=28.64789), sun))

    def image(t, sun):
        return model.rgb(t, unit_vectors(sun, 0.5), unit_vectors(zenith, azimuth))

    for call in (spectra, image):
        both = jax.jit(lambda t, s, call=call: (call(t, s), jax.jacfwd(call, (0, 1))(t, s)))
        for turbidity in (1.643, 3.0):
            for sun in (0.0, 1.0, math.pi / 2):
                for leaf in jax.tree.leaves(both(jnp.asarray(turbidity), jnp.asarray(sun))):
                    assert np.all(np.isfinite(leaf))


def test_gradients_are_the_central_differences():
    with jax.enable_x64(True):
        model, at = Preetham.published(), scene(view=hemisphere(12), wavelength_nm=np.array([420.0, 550.0, 680.0]))
        view = unit_vectors(at.view.zenith, at.view.azimuth)

        def spectra(p):
            return model.radiance(p[0], eqx.tree_at(lambda s: s.sun_zenith, at, p[1]))

        def image(p):
            return model.rgb(p[0], unit_vectors(p[1], 0.6), view)

        point, step = jnp.array([3.0, 0.7]), 1e-6
        for call in (spectra, image):
            values = jax.jit(call)
            slope, back = (np.asarray(jax.jit(way(call))(point)) for way in (jax.jacfwd, jax.jacrev))
            np.testing.assert_allclose(back, slope, rtol=1e-9, atol=1e-12 * np.abs(slope).max())
            for k in range(2):
                difference = np.asarray(values(point.at[k].add(step)) - values(point.at[k].add(-step))) / (2.0 * step)
                np.testing.assert_allclose(slope[..., k], difference, atol=1e-7 * np.abs(difference).max())


def test_jit_is_eager_vmap_is_the_loop_and_float32_is_near_float64():
    turbidity, results = np.array([2.0, 4.0, 8.0]), []
    for wide in (False, True):
        with jax.enable_x64(wide):
            model, at = Preetham.published(), scene(view=hemisphere(40), wavelength_nm=np.array([400.0, 550.0, 700.0]))
            sun, view = vectors(at)
            for call in (lambda t, m=model, a=at: m.radiance(t, a), lambda t, m=model, s=sun, v=view: m.rgb(t, s, v)):
                compiled = jax.jit(call)
                loop = jnp.stack([compiled(t) for t in jnp.asarray(turbidity)])
                tolerance = (1e-12 if wide else 1e-5) * float(loop.max())
                np.testing.assert_allclose(call(turbidity[1]), loop[1], atol=tolerance)
                batch = jax.jit(jax.vmap(call))(jnp.asarray(turbidity))
                np.testing.assert_allclose(batch, loop, atol=tolerance)
                results.append(np.asarray(loop))
    for narrow, wide in zip(results[:2], results[2:], strict=True):
        assert narrow.dtype == np.float32 and wide.dtype == np.float64
        np.testing.assert_allclose(narrow, wide, atol=1e-5 * wide.max())
