"""The tables of Bruneton & Neyret 2008: their coordinates, each order against other solvers, their limits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from skies import haze_over_air, hazy, ONE, unit_scene, views

import skyfit
from skyfit.transport import Bruneton, DoubleScattering, SingleScattering
from skyfit.transport.bruneton.lookup import optical_depth
from skyfit.transport.bruneton.parameterisation import (
    height_of,
    HORIZON_TO_TOP,
    meets_ground,
    sun_of,
    unit_height,
    unit_sun,
    unit_view,
    view_nodes,
    view_of,
    view_position,
)
from skyfit.transport.columns import EARTH_RADIUS, slant_columns, TOP_OF_AIR


TINY = {
    "transmittance": (16, 32), "irradiance": (4, 12), "scattering": (6, 16, 12, 4), "nodes": 4, "directions": (6, 4),
}  # fmt: skip
SMALL = {
    "transmittance": (32, 128), "irradiance": (6, 32), "scattering": (16, 48, 32, 8), "nodes": 8,
    "directions": (12, 10), "rescaled": True,
}  # fmt: skip
VIEW = views([0.0, 40.0, 70.0, 85.0], [0.0, 90.0, 180.0])
TWO = np.array([450.0, 650.0])


@pytest.fixture(scope="module")
def field():
    """Everything that an atmosphere may have, in tables that are too small for their error to matter."""
    return Bruneton(**TINY, orders=3).prepare(hazy(), TWO)


@pytest.fixture(scope="module")
def once():
    """Light scattered once, alone: air 0.25, haze 0.1."""
    return Bruneton(**SMALL, orders=1).prepare(haze_over_air(0.25, 0.1), ONE)


def rays():
    height = np.array([10.0, 1e3, 3e4, 99e3])[:, None]
    cosine = np.concatenate([np.linspace(-1.0, 1.0, 41), -np.sqrt(1.0 - (6371.0 / 6400.0) ** 2) + [-1e-3, 1e-3]])[None]
    return (jnp.asarray(v) for v in np.broadcast_arrays(height, cosine))


def test_the_coordinates_are_the_papers(x64):
    """Sec. 4 as printed, in float64."""
    height, cosine = (np.asarray(v) for v in rays())
    radius, top = EARTH_RADIUS + height, EARTH_RADIUS + TOP_OF_AIR
    rho, big = np.sqrt(radius**2 - EARTH_RADIUS**2), np.sqrt(top**2 - EARTH_RADIUS**2)
    delta = (radius * cosine) ** 2 - rho**2
    ground = (cosine < 0.0) & (delta > 0.0)
    down = 0.5 + (radius * cosine + np.sqrt(np.maximum(delta, 0.0))) / (2.0 * rho)
    up = 0.5 - (radius * cosine - np.sqrt(np.maximum(delta + big**2, 0.0))) / (2.0 * rho + 2.0 * big)
    np.testing.assert_array_equal(meets_ground(jnp.asarray(height), jnp.asarray(cosine)), ground)
    found = unit_view(jnp.asarray(height), jnp.asarray(cosine), jnp.asarray(ground), False)
    np.testing.assert_allclose(found, np.where(ground, down, up), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(unit_height(jnp.asarray(height)), rho / big, rtol=1e-12)
    suns = np.linspace(-0.2, 1.0, 9)
    printed = (1.0 - np.exp(-3.0 * suns - 0.6)) / (1.0 - np.exp(-3.6))
    np.testing.assert_allclose(unit_sun(jnp.asarray(suns), -0.2), printed, rtol=1e-12, atol=1e-15)
    assert pytest.approx(big) == HORIZON_TO_TOP


@pytest.mark.parametrize("rescaled", [False, True])
def test_the_coordinates_there_and_back(x64, rescaled):
    height, cosine = rays()
    ground = meets_ground(height, cosine)
    unit = unit_view(height, cosine, ground, rescaled)
    # nearly straight up and down a length says little of the angle
    there = np.arccos(np.clip(view_of(unit, height, ground, rescaled), -1.0, 1.0))
    np.testing.assert_allclose(there, np.arccos(cosine), atol=2e-5)
    np.testing.assert_allclose(height_of(unit_height(height)), height, rtol=1e-10)
    suns = jnp.linspace(-0.3, 1.0, 14)
    np.testing.assert_allclose(sun_of(unit_sun(suns, -0.3), -0.3), suns, atol=1e-12)
    # no cell of the table lies across the horizon
    place = view_position(unit, ground, 12)
    assert np.all(np.where(ground, place <= 5.0, place >= 6.0))
    units, looks = view_nodes(12)
    np.testing.assert_allclose(view_position(jnp.asarray(units), jnp.asarray(looks), 12), np.arange(12.0))


def test_the_transmittance_is_that_of_the_columns(once):
    """Within 2 % of the optical depth between nodes, to space from 0.6 degrees up and straight down to the ground."""
    profiles = [c.profile for c in once.atmosphere.constituents]
    depth = jnp.array([0.25, 0.1])
    height = jnp.repeat(jnp.array([0.0, 500.0, 3e3, 2e4]), 5)
    cosine = jnp.tile(jnp.array([0.01, 0.1, 0.3, 0.7, 1.0]), 4)
    sky = jnp.zeros(20, bool)
    found = optical_depth(once.tables.optical_depth, height, cosine, sky, once.sizes)[:, 0]
    np.testing.assert_allclose(found, depth @ slant_columns(profiles, height, cosine, "spherical"), rtol=0.02)
    down = optical_depth(once.tables.optical_depth, height[5:], -jnp.ones(15), ~sky[5:], once.sizes)[:, 0]
    below = jnp.stack([1.0 - profile.column_above(height[5:]) for profile in profiles])
    np.testing.assert_allclose(down, depth @ below, rtol=0.02)


def test_light_scattered_once_is_that_of_single_scattering(once):
    """Suns to 80 degrees: 0.3 % in the median, 1.2 % at most from the ground; aloft sixteen heights are few, to 5 %."""
    for height, error, most in ((None, 0.003, 0.012), (2e3, 0.015, 0.03), (3e4, 0.05, 0.055)):
        for sun in (20.0, 60.0, 80.0):
            scene = skyfit.Scene.from_degrees(sun, VIEW, ONE, irradiance="unit", height=height)
            right = SingleScattering.normal().radiance(once.atmosphere, scene)
            ratio = np.asarray(once.radiance(scene) / right)
            off = np.abs(ratio - 1.0)
            assert np.median(off) < error and off.max() < most, (height, sun, np.median(off), off.max())
    assert once.tables.irradiance.max() == 0.0


@pytest.mark.parametrize("rescaled, low, high", [(False, 1.03, 1.06), (True, 0.9999, 1.0001)])
def test_the_papers_spacing_of_views_errs_at_the_zenith(rescaled, low, high):
    """Nodes shorter than the way straight up stand for the zenith once more: the airmass between them is too large."""
    ground, straight = jnp.zeros(1), jnp.ones(1)
    place = float(view_position(unit_view(ground, straight, ground > 0.0, rescaled), ground > 0.0, 128)[0])
    units = jnp.asarray(view_nodes(128)[0])[int(place) : int(place) + 2]
    cosine = view_of(units, jnp.zeros(2), jnp.zeros(2, bool), rescaled)
    assert low < float(jnp.interp(place % 1.0, jnp.array([0.0, 1.0]), 1.0 / cosine)) < high


def test_the_second_order_is_that_of_double_scattering():
    """Of the order itself 4 % in the median and 11 % at most, toward a low sun; of the sky's irradiance 1 %."""
    atmosphere = haze_over_air(0.25, 0.1)
    made = Bruneton(**SMALL, orders=2).prepare(atmosphere, ONE)
    for sun in (45.0, 70.0):
        scene = unit_scene(sun, VIEW)
        once = SingleScattering.normal().radiance(atmosphere, scene)
        right = DoubleScattering.normal().radiance(atmosphere, scene) - once
        off = np.abs((made.radiance(scene) - once) / right - 1.0)
        assert np.median(off) < 0.04 and off.max() < 0.11, (sun, off)
        # E holds one order less than S
        flux = made.fluxes(scene).diffuse_down / SingleScattering.normal().fluxes(atmosphere, scene).diffuse_down
        assert float(flux[0]) == pytest.approx(1.0, abs=0.01)


def test_the_oracle(shared):
    """Haze over a lit ground, suns to 80 degrees from the ground to space: 3 % in the median, 13 % at the worst."""
    data = np.load(shared / "oracles" / "oracle_space.npz")
    air, haze, albedo, asymmetry, ground, _ = data["cases"][1]
    atmosphere = haze_over_air(air, haze, asymmetry, albedo, ground)
    made = Bruneton(**SMALL, orders=6).prepare(atmosphere, ONE)
    chosen = (data["case"] == 1) & (data["sza"] <= 80.0) & (np.abs(data["vza"] - 90.0) > 3.0)
    off = []
    for height, sun in sorted({(h, s) for h, s in zip(data["height_m"][chosen], data["sza"][chosen], strict=True)}):
        lines = np.flatnonzero(chosen & (data["height_m"] == height) & (data["sza"] == sun))
        lines = np.pad(lines, (0, 16 - len(lines)), "edge")
        view = skyfit.Directions.from_degrees(data["vza"][lines], data["raz"][lines])
        scene = skyfit.Scene.from_degrees(sun, view, ONE, irradiance="unit", height=height or None)
        off += (np.abs(made.radiance(scene)[:, 0] / data["radiance"][lines] - 1.0)[made.known(scene)]).tolist()
    assert np.median(off) < 0.03 and max(off) < 0.13, (np.median(off), max(off))


def test_what_is_seen_of_the_ground_through_clear_air():
    r"""$\alpha \mu_s / \pi$ straight down."""
    made = Bruneton(**SMALL, orders=1).prepare(haze_over_air(1e-6, 0.0, ground=0.5), ONE)
    scene = skyfit.Scene.from_degrees(30.0, views([180.0], [0.0]), ONE, irradiance="unit", height=400e3)
    assert float(made.radiance(scene)[0, 0]) == pytest.approx(0.5 * np.cos(np.radians(30.0)) / np.pi, rel=1e-4)


def test_paths_and_shadows(field):
    """Eq. 16 to 18: the air before what is far is the sky's, shadows of no length change nothing, long ones all."""
    view = views([20.0, 80.0, 100.0, 160.0], [30.0])
    scene = skyfit.Scene(0.6, 0.0, view, TWO, jnp.ones(2), 2e3)
    path, light = field.path(scene, jnp.full(4, np.inf)), field.radiance(scene)
    np.testing.assert_allclose(path.inscatter[:2], light[:2], rtol=1e-4)
    assert np.all(path.inscatter[2:] < light[2:])
    near = field.path(scene, jnp.array([0.0, 0.0, 10.0, 0.0]))
    np.testing.assert_allclose(near.transmittance, 1.0, atol=2e-3)
    assert np.all(near.inscatter <= 0.01 * light)
    np.testing.assert_allclose(field.radiance(scene, jnp.zeros(4)), light, rtol=1e-4)
    some, whole = field.radiance(scene, jnp.full(4, 1e3)), field.radiance(scene, jnp.full(4, np.inf))
    assert np.all(some < light) and np.all(whole <= some)
    np.testing.assert_allclose(whole[:2], 0.0, atol=1e-5)
    # the ground's own light stays: whether it is lit is the caller's to say
    np.testing.assert_allclose(whole[2:], (light - path.inscatter)[2:], rtol=1e-4)
    assert float(field.ambient(jnp.zeros(1), jnp.ones(1), jnp.zeros(1))[0, 0]) > 0.0


def test_finite_and_never_negative(field):
    """Float32, from the ground to space, suns to where the tables end, every view."""
    sky = views(np.linspace(0.0, 180.0, 37), [0.0, 10.0, 90.0, 180.0])
    for height in (None, 0.0, 1.0, 5e3, 99.9e3, 100e3, 400e3, 1e8):
        for sun in (0.0, 45.0, 89.9, 90.0, 101.0):
            scene = skyfit.Scene.from_degrees(sun, sky, TWO, irradiance="unit", height=height)
            light = field.radiance(scene)
            assert light.dtype == jnp.float32 and np.all(np.isfinite(light)) and np.all(light >= 0.0)
    below = skyfit.Scene.from_degrees(30.0, views([95.0, 180.0], [0.0]), TWO, irradiance="unit")
    np.testing.assert_array_equal(field.radiance(below), 0.0)
    assert field.known(skyfit.Scene.from_degrees(100.0, views([0.0], [0.0]), TWO, height=10.0))[0]
    limb = skyfit.Scene.from_degrees(100.0, views([109.0], [180.0]), TWO, height=400e3)
    assert not field.known(limb)[0]


def mean_light(haze):
    made = Bruneton(**TINY, orders=2).prepare(haze_over_air(0.2, haze, ground=0.2), ONE)
    return jnp.mean(made.radiance(unit_scene(50.0, VIEW)))


def test_the_slope_is_that_of_differences():
    both = jax.jit(lambda haze: jax.jvp(mean_light, (haze,), (1.0,)))
    less, more = both(0.19)[0], both(0.21)[0]
    assert float(both(0.2)[1]) == pytest.approx(float(more - less) / 0.02, rel=0.01)


@pytest.mark.slow
def test_the_gradient_is_finite():
    solver, scene = Bruneton(**TINY, orders=3), unit_scene(50.0, VIEW, TWO)

    @jax.jit
    @jax.grad
    def slopes(both):
        atmosphere, sun = both
        return jnp.mean(solver.radiance(atmosphere, skyfit.Scene(sun, 0.0, VIEW, TWO, jnp.ones(2), scene.height)))

    for sun in (0.0, 0.8, 0.5 * np.pi, 1.7):
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(slopes((hazy(), jnp.asarray(sun)))))


def test_many_wavelengths_are_few_at_a_time_the_same(field):
    """Thirteen go in two rounds of seven; another program, whose rounding shows in views that graze the ground."""
    made = Bruneton(**TINY, orders=3).prepare(hazy(), np.linspace(400.0, 700.0, 13))
    for whole, part in zip(made.tables, field.tables, strict=True):
        np.testing.assert_allclose(whole[..., [2, 10]], part, rtol=0.01, atol=5e-3 * float(part.max(initial=0.0)))


def test_one_component_of_the_haze(field):
    """Exact in red, where it is stored, and for blue within a quarter of the haze's own light by day."""
    made = Bruneton(**TINY, orders=3, one_component=True).prepare(hazy(), TWO)
    assert made.tables.apart.shape[-1] == 1 and made.nbytes < field.nbytes
    scene = unit_scene(40.0, VIEW, TWO)
    ratio = np.asarray(made.radiance(scene) / field.radiance(scene))
    np.testing.assert_allclose(ratio[:, 1], 1.0, rtol=1e-4)
    assert np.all(np.abs(ratio[:, 0] - 1.0) < 0.25) and np.abs(ratio[:, 0] - 1.0).max() > 1e-3


def test_without_anything_that_scatters_the_sky_is_black():
    for atmosphere in (skyfit.Atmosphere(None, None, None), skyfit.Atmosphere(None, None)):
        light = Bruneton(**TINY).prepare(atmosphere, TWO).radiance(unit_scene(30.0, VIEW, TWO))
        np.testing.assert_array_equal(light, 0.0)


@pytest.mark.slow
def test_one_call_is_the_two(field):
    solver, scene = Bruneton(**TINY, orders=3), unit_scene(60.0, VIEW, TWO)
    np.testing.assert_allclose(solver.radiance(hazy(), scene), field.radiance(scene), rtol=1e-5)


def test_bad_input_is_refused_in_a_line(field):
    solver = Bruneton(**TINY)
    low = unit_scene(102.0, VIEW, TWO)
    for call in (lambda: solver.radiance(hazy(), low), lambda: field.radiance(low)):
        with pytest.raises(ValueError, match="`sun_zenith` must be .* suns to 101.537 degrees"):
            call()
    with pytest.raises(ValueError, match="`wavelength_nm` of the scene must be those of the tables, .*450.*, got"):
        field.radiance(unit_scene(30.0, VIEW, np.array([500.0, 650.0])))
    with pytest.raises(ValueError, match="`wavelength_nm` must be between 200 and 5000 nm, got 0.55 .*micrometres"):
        solver.prepare(hazy(), np.array([0.55]))
    with pytest.raises(ValueError, match="`wavelength_nm` must be 1-d"):
        solver.prepare(hazy(), 550.0)
    with pytest.raises(ValueError, match="`distance` must be at least 0 m, got -1"):
        field.path(unit_scene(30.0, VIEW, TWO), jnp.full(12, -1.0))
    with pytest.raises(ValueError, match='`geometry` must be "spherical"'):
        Bruneton(geometry="flat")
    with pytest.raises(ValueError, match="`scattering` must be 4 numbers of at least 2"):
        Bruneton(scattering=(8, 32, 8, 1))
    with pytest.raises(ValueError, match="`scattering` must have an even number at place 1"):
        Bruneton(scattering=(8, 33, 8, 8))
    haze_alone = skyfit.Atmosphere(None, skyfit.Aerosol(0.1, phase=skyfit.HenyeyGreenstein(0.7)))
    with pytest.raises(ValueError, match="`atmosphere` must have air, .* for `one_component`"):
        Bruneton(one_component=True).prepare(haze_alone, TWO)
