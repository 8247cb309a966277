"""Directions, the angles between them, and scenes."""

import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skyfit.scene import angle_between, Directions, haversine, hemisphere, Scene


ZENITH = st.floats(0.0, np.pi)
AZIMUTH = st.floats(-2.0 * np.pi, 2.0 * np.pi)


def vector(zenith, azimuth):
    return np.array([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])


def angle_of_vectors(zenith_1, zenith_2, difference):
    """Kahan's formula, which keeps its digits at 0 and at pi."""
    one, two = vector(zenith_1, 0.0), vector(zenith_2, difference)
    return 2.0 * np.arctan2(np.linalg.norm(one - two), np.linalg.norm(one + two))


@pytest.mark.parametrize("count", [1, 10, 343, 2000])
def test_hemisphere_weights_sum_to_its_solid_angle(count):
    sky = hemisphere(count)
    assert sky.zenith.shape == (count,)
    assert float(jnp.sum(sky.weight)) == pytest.approx(2.0 * np.pi, rel=1e-5)
    assert np.all((sky.zenith > 0.0) & (sky.zenith < 0.5 * np.pi))


def test_hemisphere_is_nearly_uniform():
    sky = hemisphere(343)
    assert float(sky.weight @ jnp.cos(sky.zenith)) == pytest.approx(np.pi, rel=1e-5)
    # no azimuth is favoured, and no pair of directions is closer than half the mean spacing
    for k in (1, 2, 3):
        assert abs(np.mean(np.exp(1j * k * np.asarray(sky.azimuth)))) < 0.02
    points = np.stack(vector(np.asarray(sky.zenith, float), np.asarray(sky.azimuth, float)), axis=-1)
    cosine = points @ points.T - 2.0 * np.eye(343)
    nearest = np.arccos(np.clip(cosine.max(axis=1), -1.0, 1.0))
    assert nearest.min() > 0.5 * np.sqrt(2.0 * np.pi / 343)


def test_a_cap_of_the_sky_has_its_own_solid_angle():
    cap = hemisphere(100, np.pi / 3)
    assert float(jnp.sum(cap.weight)) == pytest.approx(np.pi, rel=1e-5)
    assert float(jnp.max(cap.zenith)) < np.pi / 3


@pytest.mark.parametrize("count, max_zenith", [(0, 1.0), (-3, 1.0), (10, 0.0), (10, 1.7)])
def test_hemisphere_says_what_it_takes(count, max_zenith):
    with pytest.raises(ValueError, match="`count` must be >= 1 and `max_zenith`"):
        hemisphere(count, max_zenith)


@hypothesis.given(ZENITH, ZENITH, AZIMUTH)
@hypothesis.settings(max_examples=100)
def test_angle_between_is_the_angle_of_the_vectors(zenith_1, zenith_2, difference):
    expected = angle_of_vectors(zenith_1, zenith_2, difference)
    with jax.enable_x64(True):
        arguments = [jnp.asarray(v) for v in (zenith_1, zenith_2, difference)]
        found, swapped = angle_between(*arguments), angle_between(arguments[1], arguments[0], -arguments[2])
        half = haversine(*arguments)
    assert float(found) == pytest.approx(expected, abs=3e-8)
    # away from the antipode, where the haversine rounds to 1, all digits are there
    if expected < 3.0:
        assert float(found) == pytest.approx(expected, abs=1e-14, rel=1e-12)
    assert float(swapped) == pytest.approx(float(found), abs=1e-14)
    assert float(half) == pytest.approx(np.sin(0.5 * expected) ** 2, abs=1e-14)


def test_small_angles_keep_their_digits_in_float32():
    found = angle_between(jnp.asarray(0.5), jnp.asarray(0.5), jnp.asarray(1e-6))
    assert float(found) == pytest.approx(1e-6 * np.sin(0.5), rel=1e-5)


@hypothesis.given(ZENITH, st.floats(0.0, 2.0 * np.pi))
@hypothesis.settings(max_examples=40)
def test_angle_gradients_are_finite_where_directions_coincide_or_oppose(zenith, azimuth):
    value_and_gradient = jax.value_and_grad(angle_between, (0, 1, 2))
    with jax.enable_x64(True):
        for other, turn in ((zenith, 0.0), (np.pi - zenith, np.pi), (0.0, azimuth), (np.pi, azimuth)):
            value, gradient = value_and_gradient(*(jnp.asarray(v) for v in (zenith, other, turn)))
            assert np.isfinite(value) and np.all(np.isfinite(gradient))


@hypothesis.given(st.floats(0.05, 3.0), st.floats(0.05, 3.0), st.floats(0.1, 3.0))
@hypothesis.settings(max_examples=40)
def test_angle_gradients_are_central_differences(zenith_1, zenith_2, difference):
    hypothesis.assume(0.05 < angle_of_vectors(zenith_1, zenith_2, difference) < 3.0)
    start = np.array([zenith_1, zenith_2, difference])
    with jax.enable_x64(True):
        gradient = np.array(jax.grad(angle_between, (0, 1, 2))(*(jnp.asarray(v) for v in start)))
    step = 1e-6 * np.eye(3)
    central = [(angle_of_vectors(*(start + s)) - angle_of_vectors(*(start - s))) / 2e-6 for s in step]
    np.testing.assert_allclose(gradient, central, atol=1e-7)


def test_directions_broadcast_degrees_and_refuse_other_shapes():
    view = Directions.from_degrees(np.array([0.0, 60.0])[:, None], np.array([0.0, 90.0, 180.0])[None])
    assert view.zenith.shape == (6,)
    np.testing.assert_allclose(view.azimuth[:3], [0.0, np.pi / 2, np.pi], rtol=1e-6)
    with pytest.raises(ValueError, match="`zenith` and `azimuth` must be 1-d and of one length"):
        Directions(np.zeros(3), np.zeros(2))


def test_a_scene_looks_its_spectrum_up():
    view = hemisphere(3)
    wavelength = np.array([450.0, 550.0])
    near = Scene.from_degrees(30.0, view, wavelength, day_of_year=3)
    far = Scene.from_degrees(30.0, view, wavelength, day_of_year=185)
    # perihelion against aphelion: ((1 + e) / (1 - e))^2, e = 0.0167
    np.testing.assert_allclose(near.solar_irradiance / far.solar_irradiance, (1.0167 / 0.9833) ** 2, rtol=2e-3)
    unit = Scene.from_degrees(30.0, view, wavelength, irradiance="unit")
    np.testing.assert_array_equal(unit.solar_irradiance, [1.0, 1.0])
    given = Scene.from_degrees(30.0, view, wavelength, irradiance=np.array([2.0, 3.0]))
    np.testing.assert_array_equal(given.solar_irradiance, [2.0, 3.0])
    assert float(unit.sun_zenith) == pytest.approx(np.pi / 6, rel=1e-6)
    with pytest.raises(ValueError, match="`wavelength_nm` must be 1-d"):
        Scene.from_degrees(30.0, view, wavelength, irradiance=np.ones(3))


@pytest.mark.parametrize("height", [-1.0, float("nan")])
def test_an_observer_does_not_stand_in_the_ground(height):
    with pytest.raises(ValueError, match="`height` must be between 0 and "):
        Scene.from_degrees(30.0, hemisphere(3), np.array([500.0]), height=height)
