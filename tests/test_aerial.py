"""Aerial perspective against adaptive quadrature of Preetham's eq. 9, closed forms and solvers of the same physics."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from skies import COLOURS, unit_scene, views

import skyfit
from skyfit.atmosphere import (
    Aerosol,
    bodhaine_optical_depth,
    Exponential,
    Ground,
    HenyeyGreenstein,
    Ozone,
    Prescribed,
    Rayleigh,
)
from skyfit.scene import haversine
from skyfit.transport import AerialPerspective, constant_ambient, OrdersOfScattering, scattered_light, SingleScattering


# m, of air and haze
SCALE = np.array([8000.0, 1200.0])
# nm, the ends and the middle of the visible
BANDS = np.array([400.0, 550.0, 700.0])


def coefficients(turbidity):
    """Of air and haze at the ground, m^-1: Preetham's definition of turbidity."""
    air = bodhaine_optical_depth(BANDS)
    return np.stack([air, (turbidity - 1.0) * air[1] * (BANDS / 550.0) ** -1.3]) / SCALE[:, None]


def air_and_haze(beta):
    parts = [
        Prescribed(b * h, Exponential(h), HenyeyGreenstein(g)) for b, h, g in zip(beta, SCALE, (0.0, 0.7), strict=True)
    ]
    return skyfit.Atmosphere(*parts, None)


def drawn(count, seed):
    """Rays of every kind: turbidity, height of the eye, cosine and zenith angle of the view, distance to the object."""
    random = np.random.default_rng(seed)
    rays = []
    while len(rays) < count:
        turbidity = random.choice([1.0, 1.01, 2.0, 6.0, 10.0, random.uniform(1.0, 10.0)])
        height = random.choice([0.0, 100.0, 8000.0, random.uniform(0.0, 8000.0)])
        steep, grazing = random.uniform(-1.0, 1.0), random.choice([-1.0, 1.0]) * 10.0 ** random.uniform(-5.0, -1.0)
        cosine = random.choice([0.0, 1e-12, -1e-12, 1e-3, -1e-3, 1.0, -1.0, steep, steep, grazing, grazing])
        distance = random.choice([1.5e5, 10.0 ** random.uniform(1.0, np.log10(1.5e5))])
        if cosine < -1e-7:
            distance = min(distance, height / -cosine)
        if distance > 1.0:
            rays.append((turbidity, height, cosine, np.pi / 2.0 - np.arcsin(cosine), distance))
    return np.array(rays).T


def by_quadrature(turbidity, height, cosine, distance):
    """Transmittance `[wavelength]` and eq. 9 `[constituent, wavelength]`, scipy's adaptive rule."""
    beta, found = coefficients(turbidity), np.zeros((2, 3))

    def column(x):
        slope = x * cosine / SCALE
        mean = np.where(np.abs(slope) < 1e-9, 1.0, -np.expm1(-slope) / np.where(slope == 0.0, 1.0, slope))
        return np.exp(-height / SCALE) * x * mean

    for i in range(2):
        for w in range(3):

            def integrand(x, i=i, w=w):
                return np.exp(-(height + x * cosine) / SCALE[i] - column(x) @ beta[:, w])

            breaks = distance * np.array([0.0, 1e-3, 1e-2, 0.05, 0.2, 0.5, 1.0])
            found[i, w] = sum(
                quad(integrand, a, b, epsabs=1e-300, epsrel=1e-9, limit=200)[0]
                for a, b in zip(breaks, breaks[1:], strict=False)
            )
    return np.exp(-(column(distance) @ beta)), found


@cache
def references():
    rays = drawn(150, 0)
    pairs = [by_quadrature(t, h, c, s) for t, h, c, _, s in rays.T]
    return rays, np.stack([p[0] for p in pairs]), np.stack([p[1] for p in pairs])


def integrals(solver, rays):
    """Transmittances and the integrals of each constituent, of `[ray]`."""

    def one(turbidity, height, zenith, distance):
        air = jnp.asarray(coefficients(2.0) * np.array([[1.0], [0.0]]), float)
        haze = jnp.asarray(coefficients(2.0) * np.array([[0.0], [1.0]]), float)
        beta = air + haze * (turbidity - 1.0)
        view = skyfit.Directions(zenith[None], jnp.zeros(1))
        scene = skyfit.Scene(1.0, 0.0, view, BANDS, np.ones(3), height)
        # a source of 1 / beta: what comes out is the paper's I
        rate = jnp.where(beta > 0.0, beta, 1.0)
        paths = [
            solver.path(air_and_haze(beta), scene, distance[None], jnp.eye(2)[i][:, None, None] / rate[:, None])
            for i in range(2)
        ]
        return paths[0].transmittance[0], jnp.stack([p.inscatter[0] for p in paths])

    turbidity, height, _, zenith, distance = (jnp.asarray(v, float) for v in rays)
    return jax.jit(jax.vmap(one))(turbidity, height, zenith, distance)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_every_ray_is_the_integral_of_equation_nine(dtype):
    """Horizontal, grazing, up to 150 km and down to the ground; each constituent alone. The issue asks for 5e-3."""
    rays, transmittance, expected = references()
    hazy = rays[0] > 1.0
    for preset, tolerance in (("draft", 6e-3), ("normal", 1e-3), ("fine", 1e-4)):
        with jax.enable_x64(dtype == "float64"):
            through, found = (np.asarray(v, float) for v in integrals(getattr(AerialPerspective, preset)(), rays))
        np.testing.assert_allclose(found[:, 0], expected[:, 0], rtol=tolerance)
        np.testing.assert_allclose(found[hazy, 1], expected[hazy, 1], rtol=tolerance)
        # optical depths to 170 lose some digits of what is left, grazing views some of their angle
        np.testing.assert_allclose(through, transmittance, rtol=3e-4 if dtype == "float32" else 1e-7, atol=1e-30)


def test_no_light_is_lost_however_few_the_pieces(x64):
    """A source of one everywhere: what the air takes from the object it gives back."""
    beta = coefficients(6.0)
    scene = unit_scene(30.0, views([0.0, 60.0, 89.0, 90.0, 91.0, 150.0], [0.0]), BANDS)
    scene = skyfit.Scene(scene.sun_zenith, 0.0, scene.view, BANDS, np.ones(3), 3000.0)
    path = AerialPerspective(2).path(air_and_haze(beta), scene, jnp.full(6, 8e4), jnp.ones((2, 6, 3)))
    np.testing.assert_allclose(path.inscatter, 1.0 - path.transmittance, rtol=1e-8)


def test_one_constituent_and_level_views_need_no_pieces(x64):
    height, zenith, distance = 500.0, np.array([20.0, 89.0, 93.0]), np.array([4e4, 9e4, 5e3])
    beta, cosine = coefficients(1.0)[0], np.cos(np.radians(zenith))
    column = (np.exp(-height / 8e3) - np.exp(-(height + distance * cosine) / 8e3)) * 8e3 / cosine
    alone = skyfit.Atmosphere(Prescribed(beta * 8e3, Exponential(8e3), HenyeyGreenstein(0.0)), None, None)
    scene = skyfit.Scene(1.0, 0.0, views(zenith, [0.0]), BANDS, np.ones(3), height)
    path = AerialPerspective(2).path(alone, scene, jnp.asarray(distance), jnp.full((1, 3, 3), 0.7))
    np.testing.assert_allclose(path.transmittance, np.exp(-column[:, None] * beta), rtol=1e-10)
    np.testing.assert_allclose(path.inscatter, -0.7 * np.expm1(-column[:, None] * beta), rtol=1e-10)
    # level: e^{-beta x} at the density of the eye's height
    dense = coefficients(4.0) * np.exp(-height / SCALE)[:, None]
    level = skyfit.Scene(1.0, 0.0, views([90.0], [0.0]), BANDS, np.ones(3), height)
    one_by_one = jnp.eye(2)[:, :1, None] + jnp.zeros((2, 1, 3))
    path = AerialPerspective(2).path(air_and_haze(coefficients(4.0)), level, jnp.array([7e4]), one_by_one)
    total = dense.sum(axis=0)
    np.testing.assert_allclose(path.inscatter[0], dense[0] / total * -np.expm1(-total * 7e4), rtol=1e-9)


def test_a_view_down_ends_at_the_ground_and_the_level_one_does_not():
    beta = coefficients(3.0)
    scene = skyfit.Scene(1.0, 0.0, views([95.0, 90.0], [0.0]), BANDS, np.ones(3), 0.0)
    source = jnp.ones((2, 2, 3))
    ground = AerialPerspective().path(air_and_haze(beta), scene, jnp.full(2, jnp.inf), source)
    np.testing.assert_array_equal(ground.transmittance, [[1.0] * 3, [0.0] * 3])
    np.testing.assert_allclose(ground.inscatter, [[0.0] * 3, [1.0] * 3], atol=1e-6)
    aloft = skyfit.Scene(1.0, 0.0, scene.view, BANDS, np.ones(3), 1000.0)
    below, beyond = (
        AerialPerspective().path(air_and_haze(beta), aloft, jnp.full(2, d), source)
        for d in (1000.0 / np.cos(np.radians(85.0)), 1e6)
    )
    np.testing.assert_allclose(below.inscatter[0], beyond.inscatter[0], rtol=1e-5)


def test_a_view_down_from_no_height_is_refused():
    """Its path would have no length: transmittance 1, whatever the fog."""
    scene = skyfit.Scene(1.0, 0.0, views([95.0, 90.0], [0.0]), BANDS, np.ones(3))
    air, far = air_and_haze(coefficients(3.0)), jnp.full(2, 50.0)
    for call in (
        lambda: AerialPerspective().path(air, scene, far, jnp.ones((2, 2, 3))),
        lambda: skyfit.Shells(geometry="flat").path(air, scene, far),
        lambda: skyfit.SingleScattering().path(air, scene, far),
        lambda: skyfit.Spherical.draft().path(air, scene, far),
        lambda: skyfit.Bruneton.draft().path(air, scene, far),
    ):
        with pytest.raises(ValueError, match="`height` of the scene must be given for a path below the horizon"):
            call()
    # in air that is as dense everywhere it has one
    assert np.all(skyfit.Uniform().path(air, scene, far).transmittance < 1.0)


def test_what_absorbs_only_dims_and_needs_no_source(x64):
    air = Prescribed(coefficients(1.0)[0] * 8e3, Exponential(8e3), HenyeyGreenstein(0.0))
    soot = Prescribed(np.full(3, 0.1), Exponential(1200.0))
    scene = skyfit.Scene(1.0, 0.0, views([90.0], [0.0]), BANDS, np.ones(3))
    source, distance = jnp.ones((1, 1, 3)), jnp.array([2e4])
    clear = AerialPerspective().path(skyfit.Atmosphere(air, None, Ozone()), scene, distance, source)
    sooty = AerialPerspective().path(skyfit.Atmosphere(air, soot, None), scene, distance, source)
    rate, dark = coefficients(1.0)[0], 0.1 / 1200.0
    np.testing.assert_allclose(clear.transmittance[0], np.exp(-rate * 2e4), rtol=1e-10)
    np.testing.assert_allclose(sooty.transmittance[0], np.exp(-(rate + dark) * 2e4), rtol=1e-10)
    np.testing.assert_allclose(sooty.inscatter[0], rate / (rate + dark) * -np.expm1(-(rate + dark) * 2e4), rtol=1e-9)
    empty = AerialPerspective().path(skyfit.Atmosphere(None, None, None), scene, distance, jnp.zeros((0, 1, 3)))
    np.testing.assert_array_equal(empty.transmittance, 1.0)
    np.testing.assert_array_equal(empty.inscatter, 0.0)


# --- the light around a point


def even_sky(scene):
    """A radiance of one."""
    return jnp.ones((scene.view.zenith.shape[0], scene.wavelength_nm.shape[0]))


def black_sky(scene):
    return 0.0 * even_sky(scene)


def sky_like(scene):
    """An aureole and a bright horizon."""
    half = haversine(scene.view.zenith, scene.sun_zenith, scene.view.azimuth - scene.sun_azimuth)
    bright = 1.0 - jnp.exp(-0.3 / jnp.maximum(jnp.cos(scene.view.zenith), 1e-3))
    aureole = HenyeyGreenstein(0.7).at_haversine(half, scene.wavelength_nm)
    return bright[:, None] * (0.05 + aureole) * even_sky(scene)


def test_light_that_comes_from_everywhere_alike_is_scattered_as_it_is(x64):
    """A white ground under a sky of one: the phase function does not matter, nor the number of rings."""
    atmosphere = skyfit.Atmosphere(Rayleigh(), Aerosol(0.2, phase=HenyeyGreenstein(0.75)), None, Ground(1.0))
    scene = unit_scene(40.0, views([0.0, 50.0, 90.0, 130.0], [0.0, 100.0]), COLOURS)
    light = scattered_light(atmosphere, scene, even_sky, jnp.zeros(4))
    np.testing.assert_allclose(light, np.ones((2, 8, 4)), rtol=1e-5)


def test_the_sun_alone_is_its_phase_function(x64):
    atmosphere = skyfit.Atmosphere(Rayleigh(), Aerosol(0.2), None, Ground(0.0))
    scene = unit_scene(40.0, views([40.0, 90.0], [0.0, 180.0]), COLOURS)
    light = scattered_light(atmosphere, scene, black_sky, jnp.full(4, 2.0))
    gamma = np.radians([0.0, 80.0, 50.0, 130.0])
    lobe = (1.0 - 0.49) / (4.0 * np.pi * (1.49 - 1.4 * np.cos(gamma)) ** 1.5)
    np.testing.assert_allclose(light[1], np.broadcast_to(2.0 * lobe[:, None], (4, 4)), rtol=1e-9)


def test_a_long_level_path_is_the_sky_at_the_horizon(x64):
    """Flat air without end: discrete ordinates reach the same limit on another way, the ground's light in it."""
    atmosphere = skyfit.Atmosphere(Rayleigh(), Aerosol(0.1, phase=HenyeyGreenstein(0.3)), None, Ground(0.3))
    scene = skyfit.Scene.from_degrees(60.0, views([90.0], [0.0, 60.0, 120.0, 180.0]), COLOURS)
    solver = OrdersOfScattering(4, 6, 60, 6, 64, 0, "flat")

    def both(atmosphere):
        sun = solver.fluxes(atmosphere, scene).direct / jnp.cos(scene.sun_zenith)
        light = scattered_light(atmosphere, scene, lambda sky: solver.radiance(atmosphere, sky), sun, rings=12)
        path = AerialPerspective().path(atmosphere, scene, jnp.full(4, jnp.inf), light)
        return path, solver.radiance(atmosphere, scene)

    path, expected = jax.jit(both)(atmosphere)
    np.testing.assert_allclose(path.inscatter, expected, rtol=1e-2)
    np.testing.assert_array_equal(path.transmittance, 0.0)


def test_near_the_ground_the_sun_alone_is_single_scattering(x64):
    """The same integral where the sun's light does not vary: level exactly, over 300 m of rise nearly."""
    atmosphere = skyfit.Atmosphere(Rayleigh(), Aerosol(0.15), None, Ground(0.0))
    scene = skyfit.Scene.from_degrees(50.0, views([90.0, 85.0], [0.0, 140.0]), COLOURS)
    solver, distance = SingleScattering.fine("flat"), jnp.array([2e4, 2e4, 3e3, 3e3])
    sun = solver.fluxes(atmosphere, scene).direct / jnp.cos(scene.sun_zenith)
    light = scattered_light(atmosphere, scene, black_sky, sun)
    found = AerialPerspective().path(atmosphere, scene, distance, light)
    expected = solver.path(atmosphere, scene, distance)
    # the solver takes a level view to climb at a cosine of 1e-4
    np.testing.assert_allclose(found.transmittance, expected.transmittance, rtol=5e-3)
    np.testing.assert_allclose(found.inscatter[:2], expected.inscatter[:2], rtol=1e-3)
    np.testing.assert_allclose(found.inscatter[2:], expected.inscatter[2:], rtol=4e-2)


def test_a_table_of_directions_stands_for_the_quadrature(x64):
    """To the sun, around it, across the horizon, poles; any azimuth of the sun."""
    atmosphere = skyfit.Atmosphere.from_turbidity(4.0)
    view = views([0.0, 40.0, 72.0, 78.0, 90.0, 93.0, 180.0], [0.0, 95.0, 120.0, 123.0, 300.0])
    scene = skyfit.Scene.from_degrees(78.0, view, COLOURS, sun_azimuth=120.0)
    exact, coarse, dense = (
        scattered_light(atmosphere, scene, sky_like, jnp.ones(4), grid=g) for g in (None, (16, 17), (24, 25))
    )
    np.testing.assert_allclose(coarse, exact, rtol=5e-3)
    np.testing.assert_allclose(dense, exact, rtol=5e-4)


def test_rings_converge_in_the_aureole(x64):
    atmosphere = skyfit.Atmosphere.from_turbidity(4.0)
    scene = skyfit.Scene.from_degrees(78.0, views([70.0, 78.0, 86.0, 92.0], [0.0, 10.0, 180.0]), COLOURS)
    few, many = (scattered_light(atmosphere, scene, sky_like, jnp.ones(4), rings=r) for r in (24, 80))
    np.testing.assert_allclose(few, many, rtol=1e-5)


# --- rivals, refusals, derivatives


def test_ward_larsons_air_has_one_colour(x64):
    """Attenuation of one kilometre, exponential beyond, and the ambient light to match."""
    atmosphere, ambient = air_and_haze(coefficients(2.0)), jnp.array([0.1, 0.2, 0.3])
    scene = skyfit.Scene(1.0, 0.0, views([90.0, 70.0, 110.0], [0.0]), BANDS, np.ones(3), 800.0)
    path = constant_ambient(atmosphere, scene, jnp.array([1e3, 5e3, 1e2]), ambient)
    kilometre = np.exp(-1e3 * (coefficients(2.0) * np.exp(-800.0 / SCALE)[:, None]).sum(axis=0))
    expected = kilometre[None] ** np.array([[1.0], [5.0], [0.1]])
    np.testing.assert_allclose(path.transmittance, expected, rtol=1e-10)
    np.testing.assert_allclose(path.inscatter, ambient[None] * (1.0 - expected), rtol=1e-10)


def test_what_does_not_fit_is_refused():
    scene = skyfit.Scene(1.0, 0.0, views([90.0], [0.0]), BANDS, np.ones(3))
    foggy = skyfit.Atmosphere(aerosol=skyfit.Droplets.fog())
    with pytest.raises(ValueError, match=r"`atmosphere` must have .* got Droplets with Layered"):
        AerialPerspective().path(foggy, scene, jnp.ones(1), jnp.ones((2, 1, 3)))
    with pytest.raises(ValueError, match=r"`source` must have a row for each of 2 scatterers"):
        AerialPerspective().path(air_and_haze(coefficients(2.0)), scene, jnp.ones(1), jnp.ones((1, 1, 3)))
    with pytest.raises(ValueError, match="`pieces` must be at least 2, got 1"):
        AerialPerspective(1)
    for grid in ((1, 5), (8, 8)):
        with pytest.raises(ValueError, match="`grid` must have"):
            scattered_light(skyfit.Atmosphere(), scene, even_sky, jnp.ones(3), grid=grid)


def whole(p):
    """Everything that can vary: haze, air, view, eye, distance, light."""
    haze = Aerosol(p[0], p[1], 0.9, phase=HenyeyGreenstein(p[2]), profile=Exponential(p[3] * 1e3))
    zenith = jnp.array([0.3, 1.5, 0.5 * np.pi, 1.6, 2.5]) + p[5]
    view = skyfit.Directions(zenith, jnp.linspace(0.0, 4.0, 5))
    scene = skyfit.Scene(p[6], 0.3, view, COLOURS, jnp.ones(4), p[7] * 1e3)
    atmosphere = skyfit.Atmosphere(Rayleigh(p[4] * 1e5), haze, None)
    distance = p[8] * jnp.array([2e4, 3e4, 5e4, 6e4, 1e3])
    light = scattered_light(atmosphere, scene, sky_like, jnp.ones(4), rings=8)
    return jnp.stack(AerialPerspective().path(atmosphere, scene, distance, light))


START = (0.3, 1.2, 0.65, 1.2, 1.0, 0.0, 1.1, 2.0, 1.0)


def test_gradients_are_those_of_differences(x64):
    start = jnp.array(START)
    slopes = jax.jit(jax.jacfwd(whole))(start)
    value = jax.jit(whole)
    for i in range(start.size):
        step = 1e-6 * jnp.eye(start.size)[i]
        central = (value(start + step) - value(start - step)) / 2e-6
        assert float(jnp.max(jnp.abs(central))) > 1e-4
        np.testing.assert_allclose(slopes[..., i], central, atol=2e-6 * float(jnp.max(jnp.abs(central))))


@cache
def slopes_of_the_sum():
    """One program for every edge."""

    def total(p, distance):
        zenith = jnp.array([0.0, 1.0, 0.5 * np.pi - 1e-3, 0.5 * np.pi, 0.5 * np.pi + 1e-3, 2.0, np.pi]) + p[3]
        scene = skyfit.Scene(1.0, 0.0, skyfit.Directions(zenith, jnp.zeros(7)), COLOURS, jnp.ones(4), p[1] * 1e3)
        atmosphere = skyfit.Atmosphere(aerosol=Aerosol(p[0], profile=Exponential(p[2] * 1e3)))
        light = scattered_light(atmosphere, scene, sky_like, jnp.ones(4), rings=4)
        path = AerialPerspective(4).path(atmosphere, scene, distance, light)
        return jnp.sum(path.inscatter) + jnp.sum(path.transmittance)

    return jax.jit(jax.value_and_grad(total, argnums=(0, 1)))


@pytest.mark.parametrize("haze, height, scale", [(0.0, 0.0, 1.2), (2.0, 8.0, 1.2), (0.3, 0.0, 8.0), (50.0, 1.0, 0.2)])
def test_gradients_are_finite_at_every_edge(haze, height, scale):
    """No haze, much of it, one scale height for all, the eye on the ground; in single precision."""
    for distance in (0.0, 10.0, 1.5e5, 1e12, np.inf):
        value, slopes = slopes_of_the_sum()(jnp.array([haze, height, scale, 0.0]), jnp.full(7, distance))
        assert np.isfinite(value)
        assert all(np.all(np.isfinite(s)) for s in slopes)


def test_single_precision_jit_batch_and_eager_agree():
    with jax.enable_x64(True):
        expected = np.asarray(whole(jnp.array(START)), float)
    start = jnp.array(START)
    for found in (whole(start), jax.jit(whole)(start), jax.vmap(whole)(jnp.stack([start, 1.1 * start]))[0]):
        np.testing.assert_allclose(found, expected, rtol=2e-4)
