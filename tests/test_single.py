"""Single scattering against integrals written down again; limits and symmetries of both solvers."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from skies import (
    EARTH_RADIUS,
    haze_over_air,
    ONE,
    phase_functions,
    SINGLE,
    slow,
    SMALL,
    SOLVERS,
    unit_scene,
    unit_vector,
    views,
)

import skyfit
from skyfit.atmosphere import Exponential, Ground, HenyeyGreenstein, Layered, Prescribed, Rayleigh, RayleighPhase
from skyfit.transport import SingleScattering


# --- single scattering against integrals written down again


def flat_integral(sun, view, azimuth, depths, heights, albedos):
    mu, mu_sun = np.cos(np.radians([view, sun]))
    phases = phase_functions(unit_vector(sun, 0.0) @ unit_vector(view, azimuth))

    def integrand(height):
        share = [np.exp(-height / h) for h in heights]
        above = sum(t * s for t, s in zip(depths, share, strict=True))
        attenuation = np.exp(-(sum(depths) - above) / mu - above / mu_sun)
        emitted = sum(p * a * t * s / h for p, a, t, s, h in zip(phases, albedos, depths, share, heights, strict=True))
        return emitted * attenuation / mu

    return quad(integrand, 0.0, 3e5, points=[100.0, 1e3, 5e3, 2e4, 6e4], epsabs=0.0, epsrel=1e-10, limit=400)[0]


def test_flat_single_scattering_is_the_integral(x64):
    depths, heights, albedos = (0.25, 0.3), (8000.0, 1200.0), (1.0, 0.9)
    zenith, azimuth = [0.0, 40.0, 75.0, 85.0], [0.0, 90.0, 180.0]
    for sun in (0.0, 50.0, 80.0, 88.0):
        expected = [[flat_integral(sun, v, a, depths, heights, albedos) for a in azimuth] for v in zenith]
        # traced, so that the integral answers for a sun that the solver refuses
        seen = eqx.filter_jit(SingleScattering.fine("flat").radiance)
        found = seen(haze_over_air(*depths), unit_scene(sun, views(zenith, azimuth)))
        np.testing.assert_allclose(found[:, 0], np.ravel(expected), rtol=1e-5)


def panels(start, edges, nodes=24):
    """Composite Gauss-Legendre: distances and weights."""
    x, weight = np.polynomial.legendre.leggauss(nodes)
    edges = start + np.concatenate([[0.0], edges])
    half = 0.5 * np.diff(edges)[:, None]
    return (half * (x + 1.0) + edges[:-1, None]).ravel(), (half * weight).ravel()


def spherical_integral(sun, view, azimuth, depths, heights, albedos):
    """Cartesian: points along the view, from each a straight line to the sun; a cylinder of shadow behind the Earth."""
    sunward, viewward = unit_vector(sun, 0.0), unit_vector(view, azimuth)
    eye = np.array([0.0, 0.0, EARTH_RADIUS])

    def density(points):
        height = np.linalg.norm(points, axis=-1) - EARTH_RADIUS
        return np.stack([t / h * np.exp(-height / h) for t, h in zip(depths, heights, strict=True)], axis=-1)

    def shaded(distance):
        point = eye + distance * viewward
        along = point @ sunward
        return along < 0.0 and np.linalg.norm(point - along * sunward) < EARTH_RADIUS

    start, lit = 0.0, 5e6
    if sun > 90.0:
        for _ in range(60):
            middle = 0.5 * (start + lit)
            start, lit = (middle, lit) if shaded(middle) else (start, middle)
    # the air ends at 100 km, 4e-6 of its column from the top
    climb = EARTH_RADIUS * viewward[2]
    end = np.sqrt(climb**2 + 100e3 * (2.0 * EARTH_RADIUS + 100e3)) - climb
    if end <= start:
        return 0.0
    distance, weight = panels(start, (end - start) * np.geomspace(1e-3, 1.0, 14), 12)
    points = eye + distance[:, None] * viewward
    before, before_weight = panels(0.0, np.linspace(0.0, 1.0, 9)[1:])
    to_eye = np.array([d * before_weight @ density(eye + d * before[:, None] * viewward).sum(-1) for d in distance])
    # toward the sun, from the point of the line that lies nearest to the Earth's centre
    along = points @ sunward
    outward, outward_weight = panels(0.0, np.geomspace(200.0, 3e6, 14))

    def to_space(point, direction):
        return outward_weight @ density(point + outward[:, None] * direction).sum(-1)

    def to_sun(point, behind):
        if behind >= 0.0:
            return to_space(point, sunward)
        nearest = point - behind * sunward
        back = behind * before
        return to_space(nearest, sunward) - behind * before_weight @ density(nearest + back[:, None] * sunward).sum(-1)

    to_the_sun = np.array([to_sun(p, b) for p, b in zip(points, along, strict=True)])
    phases = np.array(phase_functions(sunward @ viewward))
    emitted = density(points) @ (phases * albedos)
    return weight @ (emitted * np.exp(-to_eye - to_the_sun))


def test_the_independent_integral_is_good_to_a_part_in_a_million():
    """In its flat limit, far from the horizon: curvature is of the order of 1e-3 there, and is seen."""
    arguments = (30.0, 40.0, 60.0, (0.25, 0.3), (8000.0, 1200.0), (1.0, 0.9))
    assert spherical_integral(*arguments) == pytest.approx(flat_integral(*arguments), rel=2e-3)


@pytest.mark.parametrize("sun", [30.0, 60.0, 80.0, 86.0, 89.0, 90.0, 91.0, 92.0, 94.0, 96.0])
def test_spherical_single_scattering_is_the_integral(x64, sun):
    depths, heights, albedos = (0.25, 0.3), (8000.0, 1200.0), (1.0, 0.9)
    zenith, azimuth = [0.0, 45.0, 80.0], [10.0, 90.0, 170.0]
    expected = np.ravel([[spherical_integral(sun, v, a, depths, heights, albedos) for a in azimuth] for v in zenith])
    scene = unit_scene(sun, views(zenith, azimuth))
    fine = SingleScattering.fine("spherical").radiance(haze_over_air(*depths), scene)[:, 0]
    np.testing.assert_allclose(fine, expected, rtol=2e-6)
    normal = SingleScattering.normal("spherical").radiance(haze_over_air(*depths), scene)[:, 0]
    np.testing.assert_allclose(normal, expected, rtol=1e-5)


def test_flat_quadrature_converges_fast_in_nodes(x64):
    scene, atmosphere = unit_scene(65.0, views([0.0, 60.0, 80.0], [20.0, 100.0])), haze_over_air(0.25, 0.3)
    best = SingleScattering(96, "flat").radiance(atmosphere, scene)
    errors = [
        float(jnp.max(jnp.abs(SingleScattering(n, "flat").radiance(atmosphere, scene) / best - 1.0)))
        for n in (6, 12, 24, 48)
    ]
    for few, many in zip(errors, errors[1:], strict=False):
        # better than fourth order
        assert many < few / 16.0 or many < 1e-7
    assert errors[2] < 1e-4


@pytest.mark.parametrize("sun", [65.0, slow(89.0), 92.0, 95.0])
def test_spherical_quadrature_converges_fast_in_nodes(x64, sun):
    """Day and twilight alike: the parts of a view end where its light does, so the nodes see a smooth integrand."""
    scene, atmosphere = unit_scene(sun, views([0.0, 60.0, 80.0, 89.0], [20.0, 100.0, 175.0])), haze_over_air(0.25, 0.3)
    best = SingleScattering(64, "spherical").radiance(atmosphere, scene)
    lit = best > 0.0
    errors = [
        float(jnp.max(jnp.where(lit, jnp.abs(found / jnp.where(lit, best, 1.0) - 1.0), 0.0)))
        for found in (SingleScattering(n, "spherical").radiance(atmosphere, scene) for n in (6, 12, 24))
    ]
    # better than fourth order, then sixth
    assert errors[1] < errors[0] / 16.0 and errors[2] < errors[1] / 64.0 and errors[2] < 2e-5


# --- limits and symmetries


@pytest.mark.parametrize("name", SOLVERS)
def test_a_thin_sky_is_its_optical_depth_over_the_cosine(x64, name):
    """L -> E0 sum p omega tau / mu; the second order is tau times smaller. Uniform air has Kasten's airmass."""
    thin, sun, zenith, azimuth = 1e-7, 40.0, [0.0, 30.0, 60.0], [0.0, 120.0]
    found = SOLVERS[name].radiance(haze_over_air(thin, 2.0 * thin), unit_scene(sun, views(zenith, azimuth)))[:, 0]
    expected = []
    for view in zenith:
        for turn in azimuth:
            air, haze = phase_functions(unit_vector(sun, 0.0) @ unit_vector(view, turn))
            cosine = np.cos(np.radians(view))
            slant = 1.0 / (cosine + 0.15 * (93.885 - view) ** -1.253) if name.startswith("uniform") else 1.0 / cosine
            expected.append(thin * (air + 2.0 * 0.9 * haze) * slant)
    # the airmass of a sphere is smaller: -H tan^2 / R, 0.4 % at 60 degrees
    np.testing.assert_allclose(found, expected, rtol=1e-5 if name.endswith("flat") else 5e-3)


@pytest.mark.parametrize("name", SOLVERS)
def test_thin_air_is_blue_by_the_fourth_power(x64, name):
    wavelength = np.array([400.0, 500.0, 700.0])
    # thinner than any air there is
    thin = eqx.tree_at(lambda air: air.pressure, Rayleigh(formula="paper"), jnp.asarray(0.1))
    atmosphere = skyfit.Atmosphere(thin, None, None, Ground(0.0))
    found = SOLVERS[name].radiance(atmosphere, unit_scene(50.0, views([10.0, 60.0], [0.0, 90.0]), wavelength))
    scaled = np.asarray(found) * wavelength**4
    np.testing.assert_allclose(scaled, scaled[:, :1] * np.ones(3), rtol=2e-5)


@pytest.mark.parametrize("name", SOLVERS)
def test_the_sky_is_symmetric_about_the_suns_meridian_and_turns_with_it(x64, name):
    atmosphere, zenith, azimuth = (
        haze_over_air(0.2, 0.2, ground=0.2),
        np.array([20.0, 60.0, 80.0]),
        np.array([15.0, 80.0, 165.0]),
    )

    def sky(turn, sign):
        view = views(zenith, turn + sign * azimuth)
        return SOLVERS[name].radiance(atmosphere, skyfit.Scene.from_degrees(55.0, view, ONE, turn, irradiance="unit"))

    first = sky(0.0, 1.0)
    np.testing.assert_allclose(sky(0.0, -1.0), first, rtol=1e-10)
    np.testing.assert_allclose(sky(217.0, 1.0), first, rtol=1e-10)


@pytest.mark.parametrize("name", SOLVERS)
def test_radiance_is_linear_in_the_suns_irradiance(name):
    view, wavelength = views([30.0], [50.0]), np.array([450.0, 650.0])
    one = unit_scene(40.0, view, wavelength)
    two = skyfit.Scene.from_degrees(40.0, view, wavelength, irradiance=np.array([3.0, 0.5]))
    atmosphere = skyfit.Atmosphere.from_turbidity(3.0)
    ratio = SOLVERS[name].radiance(atmosphere, two) / SOLVERS[name].radiance(atmosphere, one)
    np.testing.assert_allclose(ratio[0], [3.0, 0.5], rtol=1e-6)


def test_orders_exceed_single_scattering_and_brighten_with_the_ground():
    scene = unit_scene(50.0, views([0.0, 60.0], [0.0, 90.0]))
    single = SINGLE["flat"].radiance(haze_over_air(0.3, 0.2), scene)
    dark, bright = (SMALL["flat"].radiance(haze_over_air(0.3, 0.2, ground=a), scene) for a in (0.0, 0.8))
    assert np.all(dark > single) and np.all(bright > 1.1 * dark)


@pytest.mark.parametrize("geometry", ["flat", "spherical"])
def test_layers_that_scatter_are_summed_layer_by_layer(x64, geometry):
    """Views are cut at the edges: few nodes find a thin layer, which 24 over the whole path would miss by a third."""
    edges, share = np.array([0.0, 2000.0, 2300.0, 5000.0]), np.array([0.1, 0.7, 0.2])
    depth, sun, zenith, azimuth = 0.3, 50.0, [0.0, 60.0, 80.0], [0.0, 120.0]
    haze = Prescribed(np.array([depth]), Layered(edges, share), HenyeyGreenstein(0.7), 0.9)
    scene = unit_scene(sun, views(zenith, azimuth))
    found = SingleScattering(12, geometry).radiance(skyfit.Atmosphere(haze, None, None, Ground(0.0)), scene)
    # all of one kind: attenuation integrates in closed form on a flat Earth, whatever the layers
    mu, mu_sun = np.cos(np.radians(zenith))[:, None], np.cos(np.radians(sun))
    lobe = [[phase_functions(unit_vector(sun, 0.0) @ unit_vector(v, a))[1] for a in azimuth] for v in zenith]
    slant = 1.0 / mu - 1.0 / mu_sun
    expected = 0.9 * np.array(lobe) / mu * np.exp(-depth / mu_sun) * -np.expm1(-depth * slant) / slant
    np.testing.assert_allclose(found[:, 0], expected.ravel(), rtol=1e-9 if geometry == "flat" else 1e-2)
    best = SingleScattering(96, geometry).radiance(skyfit.Atmosphere(haze, None, None, Ground(0.0)), scene)
    np.testing.assert_allclose(found, best, rtol=2e-6)


def test_layers_aloft_are_summed_too(x64):
    layers = Layered(np.array([0.0, 1e3, 2e3, 3e4]), np.array([0.2, 0.5, 0.3]))
    atmosphere = skyfit.Atmosphere(Prescribed(np.array([0.3]), layers, RayleighPhase()), None, None)
    view = views([0.0, 80.0, 91.0, 100.0, 150.0], [30.0])
    for height in (500.0, 1500.0, 2e4, 4e5):
        for geometry in ("flat", "spherical"):
            scene = skyfit.Scene.from_degrees(60.0, view, ONE, irradiance="unit", height=height)
            few, many = (SingleScattering(n, geometry).radiance(atmosphere, scene) for n in (24, 96))
            np.testing.assert_allclose(few, many, rtol=1e-5)
            assert np.count_nonzero(few) >= (3 if height < 1e5 else 1)


@pytest.mark.parametrize("geometry", ["flat", "spherical"])
def test_layers_have_the_slopes_of_differences(x64, geometry):
    """By the heights of the edges and by the shares, on the ground and aloft."""

    def sky(edges, share, height):
        haze = Prescribed(np.array([0.3]), Layered(edges, share), HenyeyGreenstein(0.7))
        air = Prescribed(np.array([0.2]), Exponential(8e3), RayleighPhase())
        view = views([10.0, 80.0, 95.0], [40.0])
        scene = skyfit.Scene.from_degrees(70.0, view, ONE, irradiance="unit", height=height)
        return SingleScattering(8, geometry).radiance(skyfit.Atmosphere(air, haze, None), scene)[:, 0]

    edges, share = jnp.array([0.0, 800.0, 2500.0, 6e3]), jnp.array([0.5, 0.3, 0.2])
    for height in (None, 1.5e3):
        run = jax.jit(lambda e, s, height=height: sky(e, s, height))
        slopes = jax.jit(jax.jacfwd(run, (0, 1)))(edges, share)
        for which, (values, step) in enumerate(((edges, 0.1), (share, 1e-5))):
            for i in range(which == 0, values.size):
                off = step * jnp.zeros_like(values).at[i].set(1.0)
                both = (edges, share)
                more, less = (run(*(v + t * off if k == which else v for k, v in enumerate(both))) for t in (1.0, -1.0))
                central = (more - less) / (2.0 * step)
                largest = float(jnp.max(jnp.abs(slopes[which])))
                np.testing.assert_allclose(slopes[which][:, i], central, atol=1e-5 * largest)
                assert np.any(np.abs(central) > 1e-3 * largest)
