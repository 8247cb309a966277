"""Klassen's layers against integrals written down again, his equations' misprints, fog in closed form."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from skies import EARTH_RADIUS, haze_over_air, ONE, phase_functions, unit_scene, unit_vector, views

import skyfit
from skyfit.atmosphere import Exponential, HenyeyGreenstein, Layered, Ozone, Prescribed, Rayleigh, RayleighPhase
from skyfit.transport import Shells


# what is held here is each integral itself, not how far its sky may be off under a low sun
pytestmark = pytest.mark.filterwarnings("ignore::skyfit.LowSunWarning")

TOPS, DEPTHS, ALBEDOS = (8000.0, 1200.0), (0.25, 0.3), (1.0, 0.9)


# --- the spherical sky


def spherical_sky(sun, view, azimuth, tops=TOPS, depths=DEPTHS):
    """In Cartesian coordinates: from each point of the view straight to the sun, chords of spheres by the quadratic."""
    sunward, viewward = unit_vector(sun, 0.0), unit_vector(view, azimuth)
    eye = np.array([0.0, 0.0, EARTH_RADIUS])

    def inside(point, direction, top, end=np.inf):
        """Length of a ray within the sphere of a layer's top."""
        along = point @ direction
        root = along**2 - point @ point + (EARTH_RADIUS + top) ** 2
        if root <= 0.0:
            return 0.0
        first, last = -along - np.sqrt(root), -along + np.sqrt(root)
        return max(min(last, end) - max(first, 0.0), 0.0)

    def integrand(distance, top):
        point = eye + distance * viewward
        if np.linalg.norm(point) > EARTH_RADIUS + top:
            return 0.0
        lengths = [inside(eye, viewward, t, distance) + inside(point, sunward, t) for t in tops]
        return np.exp(-sum(d / t * length for d, t, length in zip(depths, tops, lengths, strict=True)))

    ends = [inside(eye, viewward, t) for t in tops]
    total = 0.0
    for phase, albedo, depth, top, end in zip(
        phase_functions(sunward @ viewward), ALBEDOS, depths, tops, ends, strict=True
    ):
        pieces = sorted({0.0, *(e for e in ends if e <= end)})
        for low, high in zip(pieces, pieces[1:], strict=False):
            total += phase * albedo * depth / top * quad(integrand, low, high, (top,), epsabs=0.0, epsrel=1e-10)[0]
    return total


@pytest.mark.parametrize(
    "sun_elevation, draft, normal, fine",
    [(0.5, 5e-2, 5e-3, 1e-5), (2.0, 1e-3, 3e-6, 1e-9), (10.0, 1e-8, 1e-9, 1e-9), (45.0, 1e-8, 1e-9, 1e-9)]
    + [(90.0, 1e-8, 1e-9, 1e-9)],
)
def test_the_spherical_sky_is_the_integral(x64, sun_elevation, draft, normal, fine):
    """Worst away from a sun half a degree high, whose rays graze the top of the haze."""
    zenith, azimuth = 90.0 - np.array([2.0, 10.0, 45.0, 90.0]), [0.0, 70.0, 180.0]
    scene = unit_scene(90.0 - sun_elevation, views(zenith, azimuth))
    expected = np.ravel([[spherical_sky(90.0 - sun_elevation, v, a) for a in azimuth] for v in zenith])
    for solver, tolerance in ((Shells.draft(), draft), (Shells.normal(), normal), (Shells.fine(), fine)):
        found = solver.radiance(haze_over_air(*DEPTHS), scene)[:, 0]
        np.testing.assert_allclose(found, expected, rtol=tolerance)


def test_the_suns_rays_may_dip_into_the_haze_from_above(x64):
    """A view just over the horizon, away from a setting sun, through a thin sky: points over the haze count too."""
    depths = (0.01, 0.003)
    scene = unit_scene(89.95, views([89.7], [180.0]))
    expected = spherical_sky(89.95, 89.7, 180.0, TOPS, depths)
    found = float(Shells(64).radiance(haze_over_air(*depths), scene)[0, 0])
    # the chord begins as a square root: slow in nodes
    assert found == pytest.approx(expected, rel=2e-4)


def test_layers_of_one_height_are_one_layer(x64):
    """Equal tops: no piece between them, and no constituent is lost."""
    scene = unit_scene(60.0, views([0.0, 85.0], [20.0, 170.0]))
    near, equal = (haze_over_air(*DEPTHS, haze_height=h) for h in (8000.0 - 1e-4, 8000.0))
    found = Shells().radiance(equal, scene)
    np.testing.assert_allclose(found, Shells().radiance(near, scene), rtol=1e-6)
    np.testing.assert_allclose(found[1, 0], spherical_sky(60.0, 0.0, 170.0, (8000.0, 8000.0)), rtol=1e-6)


def test_three_scatterers_are_two_with_one_split(x64):
    scene = unit_scene(70.0, views([0.0, 80.0], [20.0, 170.0]))
    air = haze_over_air(0.25, 0.3)
    half = eqx_halved(air.aerosol)
    three = skyfit.Atmosphere(air.rayleigh, half, half, air.ground)
    for solver in (Shells(), Shells(geometry="flat")):
        np.testing.assert_allclose(solver.radiance(three, scene), solver.radiance(air, scene), rtol=1e-12)


def eqx_halved(constituent):
    return Prescribed(
        0.5 * constituent.optical_depth, constituent.profile, constituent.phase, constituent.single_scattering_albedo
    )


def chord(outer, inner, elevation):
    """Klassen's eq. 19."""
    return np.sqrt(outer**2 - (inner * np.cos(elevation)) ** 2) - inner * np.sin(elevation)


@pytest.mark.parametrize("sun, printed_error", [(2.0, -0.8), (10.0, -13.2), (90.0, -15.9)])
def test_the_path_integral_takes_r_from_l_and_not_l_linear_in_r(x64, sun, printed_error):
    """ERRATA 12: a view at 2 degrees through 10 km of haze of 0.02 /km, across the sun's azimuth."""
    inner, outer, coefficient = EARTH_RADIUS, EARTH_RADIUS + 10e3, 2e-5
    view, elevation = np.radians([2.0, sun])

    def linear_in_r(r):
        return np.exp(-coefficient * (chord(outer, r, elevation) + chord(r, inner, view)))

    length = chord(outer, inner, view)
    printed = length / 10e3 * quad(linear_in_r, inner, outer, epsrel=1e-11)[0]
    haze = Prescribed(np.array([10e3 * coefficient]), Exponential(10e3), HenyeyGreenstein(0.0))
    scene = unit_scene(90.0 - sun, views([88.0], [90.0]))
    found = Shells.fine().radiance(skyfit.Atmosphere(None, haze, None), scene)[0, 0]
    ours = float(found) / (coefficient / (4.0 * np.pi))
    assert 100.0 * (printed / ours - 1.0) == pytest.approx(printed_error, abs=0.05)


@pytest.mark.parametrize("elevation, factor", [(2.0, 1.51), (5.0, 1.16)])
def test_the_suns_colour_has_the_local_elevation_and_extinction(x64, elevation, factor):
    """ERRATA 11 and 18: shells of 10 and 20 km; d1 as printed is too long, and exp(+ beta d) no transmittance."""
    angle, low, high = np.radians(elevation), EARTH_RADIUS + 10e3, EARTH_RADIUS + 20e3
    air = Prescribed(np.array([1.0]), Exponential(20e3), RayleighPhase(0.0))
    haze = Prescribed(np.array([0.0]), Exponential(10e3), HenyeyGreenstein(0.0))
    scene = unit_scene(90.0 - elevation, views([0.0], [0.0]))
    direct = Shells().fluxes(skyfit.Atmosphere(air, haze, None), scene).direct[0]
    path = -np.log(float(direct) / np.sin(angle)) * 20e3
    assert path == pytest.approx(chord(high, EARTH_RADIUS, angle), rel=1e-9)
    first = path - chord(low, EARTH_RADIUS, angle)
    assert chord(high, low, angle) / first == pytest.approx(factor, abs=0.005)


def test_ozone_filters_the_suns_beam_only(x64):
    scene = skyfit.Scene.from_degrees(60.0, views([0.0, 80.0], [90.0]), np.array([450.0, 600.0]), irradiance="unit")
    with_ozone, without = (skyfit.Atmosphere(Rayleigh(), None, o) for o in (Ozone(300.0), None))
    solver = Shells()
    ratio = solver.radiance(with_ozone, scene) / solver.radiance(without, scene)
    beam = solver.fluxes(with_ozone, scene).direct / solver.fluxes(without, scene).direct
    np.testing.assert_allclose(ratio, beam[None] * np.ones((2, 1)), rtol=1e-12)
    assert 0.9 < float(beam[1]) < 0.96


@pytest.mark.parametrize("solver, deepest", [(Shells.draft(), 40.0), (Shells.normal(), 150.0), (Shells.fine(), 300.0)])
def test_presets_hold_to_their_slant_depths_within_a_per_cent(x64, solver, deepest):
    """Haze alone at 5 degrees of elevation; many nodes are the reference, the integral's test is theirs."""
    scene = unit_scene(20.0, views([85.0], [40.0]))
    for depth in (deepest, 0.3 * deepest):
        haze = haze_over_air(0.0, depth * np.cos(np.radians(85.0)))
        best = float(Shells(400).radiance(haze, scene)[0, 0])
        assert float(solver.radiance(haze, scene)[0, 0]) == pytest.approx(best, rel=0.01)


# --- his constant blue


def test_the_constant_blue_is_seen_through_the_haze(x64):
    """Without haze one colour all over the sky, as bright as the sun stands high; thick haze hides it."""
    solver, wavelength = Shells(blue_sky="constant"), np.array([450.0, 650.0])
    clear = skyfit.Atmosphere(Rayleigh(), skyfit.Aerosol(0.0), None)
    at = {s: skyfit.Scene.from_degrees(s, views([0.0, 60.0, 88.0], [0.0, 90.0]), wavelength) for s in (0.0, 60.0)}
    sky = np.asarray(solver.radiance(clear, at[0.0]))
    depth = np.asarray(Rayleigh().optical_depth_at(jnp.asarray(wavelength)))
    expected = np.asarray(at[0.0].solar_irradiance) * (1.0 - np.exp(-depth)) / (4.0 * np.pi)
    np.testing.assert_allclose(sky, expected * np.ones((6, 1)), rtol=1e-12)
    np.testing.assert_allclose(solver.radiance(clear, at[60.0]), 0.5 * sky, rtol=1e-12)
    # black haze: opacity alone, eq. 31 with eq. 30
    black = skyfit.Atmosphere(Rayleigh(), skyfit.Aerosol(0.2, 0.0, 0.0, profile=Exponential(1200.0)), None)
    length = chord(EARTH_RADIUS + 1200.0, EARTH_RADIUS, np.radians([90.0, 30.0, 2.0]))
    veiled = np.repeat(np.exp(-0.2 / 1200.0 * length), 2)[:, None] * sky
    np.testing.assert_allclose(solver.radiance(black, at[0.0]), veiled, rtol=1e-10)


def test_only_haze_scatters_before_the_constant_blue(x64):
    """Eq. 29: the whole sky without the light of the air is the haze's part."""
    air, haze = haze_over_air(*DEPTHS).rayleigh, haze_over_air(*DEPTHS).aerosol
    scene = unit_scene(50.0, views([30.0, 85.0], [0.0, 120.0]))
    both = Shells().radiance(skyfit.Atmosphere(air, haze, None), scene)
    absorbing = Prescribed(air.optical_depth, air.profile, air.phase, 0.0)
    haze_only = Shells().radiance(skyfit.Atmosphere(absorbing, haze, None), scene)
    hidden = Prescribed(haze.optical_depth, haze.profile, haze.phase, 0.0)
    blue = Shells(blue_sky="constant").radiance(skyfit.Atmosphere(air, hidden, None), scene)
    found = Shells(blue_sky="constant").radiance(skyfit.Atmosphere(air, haze, None), scene)
    np.testing.assert_allclose(found, haze_only + blue, rtol=1e-12)
    assert np.all(haze_only < both)


# --- fog


FOG_TOP, FOG = 60.0, 0.02


def foggy(coefficient=FOG, top=FOG_TOP, air=0.25, albedo=0.97):
    fog = Prescribed(np.array([coefficient * top]), Layered([0.0, top], [1.0]), HenyeyGreenstein(0.85), albedo)
    return skyfit.Atmosphere(Prescribed(np.array([air]), Exponential(8000.0), RayleighPhase(0.0)), fog, None)


def flat_path(sun, view, azimuth, eye, distance, coefficient=FOG, air=0.25, albedo=0.97):
    """Transmittance and in-scatter by marching the view with quad between the heights where a layer ends."""
    mu, mu_sun = np.cos(np.radians([view, sun]))
    coefficients, tops = (air / 8000.0, coefficient), (8000.0, FOG_TOP)
    crossings = [(t - eye) / mu for t in tops] if abs(mu) > 1e-12 else []
    if mu < -1e-12:
        distance = min(distance, -eye / mu)
    cuts = [0.0, *sorted(c for c in crossings if 0.0 < c < distance), distance]

    def local(s):
        return [k if eye + mu * s < t else 0.0 for k, t in zip(coefficients, tops, strict=True)]

    def depth(s):
        ends = [c for c in cuts if c < s] + [s]
        return sum(sum(local(0.5 * (a + b))) * (b - a) for a, b in zip(ends, ends[1:], strict=False))

    phases = phase_functions(unit_vector(sun, 0.0) @ unit_vector(view, azimuth), 0.85)

    def integrand(s):
        height = eye + mu * s
        to_sun = sum(k * max(t - height, 0.0) for k, t in zip(coefficients, tops, strict=True)) / mu_sun
        emitted = sum(p * a * k for p, a, k in zip(phases, (1.0, albedo), local(s), strict=True))
        return emitted * np.exp(-depth(s) - to_sun)

    total = sum(
        quad(integrand, a, b, epsabs=0.0, epsrel=1e-11, limit=200)[0] for a, b in zip(cuts, cuts[1:], strict=False)
    )
    return np.exp(-depth(distance)), total


@pytest.mark.parametrize("eye", [0.0, 2.0, 60.0, 75.0, 400.0])
def test_fog_in_closed_form_is_the_integral(x64, eye):
    """The eye on the ground, in the fog, on top of it and above; views up, level, down; objects near and far."""
    zenith = np.repeat([10.0, 80.0, 90.0, 95.0, 150.0], 2)
    azimuth, distance = np.tile([0.0, 140.0], 5), np.tile([150.0, 3000.0], 5)
    if eye == 0.0:
        zenith, azimuth, distance = zenith[:6], azimuth[:6], distance[:6]
    view = skyfit.Directions.from_degrees(zenith, azimuth)
    for sun in (20.0, 75.0):
        scene = skyfit.Scene.from_degrees(sun, view, ONE, irradiance="unit", height=eye)
        found = Shells(geometry="flat").path(foggy(), scene, jnp.asarray(distance))
        expected = [flat_path(sun, *v, eye, d) for *v, d in zip(zenith, azimuth, distance, strict=True)]
        np.testing.assert_allclose(found.transmittance[:, 0], [e[0] for e in expected], rtol=1e-9)
        np.testing.assert_allclose(found.inscatter[:, 0], [e[1] for e in expected], rtol=1e-7)


def klassen_fog(sun, view, azimuth, distance, coefficient):
    """Eq. 44 and 45 for fog without air: d2 = const, the depth of the whole fog toward the sun."""
    phase = phase_functions(unit_vector(sun, 0.0) @ unit_vector(view, azimuth), 0.85)[1]
    strength = np.exp(-coefficient * FOG_TOP / np.cos(np.radians(sun))) * 0.97 * coefficient * phase
    return strength * (1.0 - np.exp(-coefficient * distance)) / coefficient


def test_his_constant_distance_to_the_sun_is_the_limit_of_an_eye_near_the_ground(x64):
    """Eq. 45 is right to first order in the height that the view reaches over the fog's thickness."""
    sun, distance, errors = 30.0, 100.0, []
    for zenith in (89.0, 89.9, 89.99):
        scene = unit_scene(sun, views([zenith], [50.0]))
        path = Shells(geometry="flat").path(foggy(air=0.0), scene, jnp.array([distance]))
        errors.append(abs(float(path.inscatter[0, 0]) / klassen_fog(sun, zenith, 50.0, distance, FOG) - 1.0))
    assert errors[0] > 1e-3
    for more, less in zip(errors, errors[1:], strict=False):
        assert less == pytest.approx(0.1 * more, rel=0.05)


def test_the_fogs_scattering_angle_is_the_one_between_the_directions(x64):
    """ERRATA 17: the sum of the two elevations (eq. 41) knows no azimuth and is right under the sun only."""
    scene = unit_scene(40.0, views([90.0], [0.0, 90.0, 180.0]))
    path = Shells(geometry="flat").path(foggy(air=0.0), scene, jnp.full(3, 80.0))
    toward, across, away = (float(v) for v in path.inscatter[:, 0])
    assert toward > 3.0 * across > 6.0 * away
    expected = [phase_functions(np.sin(np.radians(40.0)) * c, 0.85)[1] for c in (1.0, 0.0, -1.0)]
    np.testing.assert_allclose([toward, across, away] / np.float64(toward), expected / expected[0], rtol=1e-9)


def test_opacity_has_its_limits(x64):
    """Eq. 5, 6: no fog or no distance hides nothing; an object far in thick fog is gone, and only fog is seen."""
    view = skyfit.Directions.from_degrees([60.0, 90.0, 90.0], [0.0, 100.0, 180.0])
    scene = skyfit.Scene.from_degrees(50.0, view, ONE, irradiance="unit", height=2.0)
    solver, image = Shells(geometry="flat"), jnp.array([[1.0], [2.0], [3.0]])
    for atmosphere, distance in ((foggy(0.0, air=0.0), 1e4), (foggy(), 0.0)):
        np.testing.assert_array_equal(solver.path(atmosphere, scene, jnp.full(3, distance)).over(image), image)
    far = solver.path(foggy(0.04), scene, jnp.full(3, jnp.inf))
    np.testing.assert_array_equal(far.transmittance[1:], 0.0)
    assert np.all(np.isfinite(far.inscatter)) and np.all(far.inscatter > 0.0)
    np.testing.assert_array_equal(far.over(image)[1:], far.inscatter[1:])
    # an inch of it: opacity = beta s, in-scatter along
    thin = solver.path(foggy(), scene, jnp.full(3, 0.01))
    np.testing.assert_allclose(1.0 - thin.transmittance[:, 0], 0.01 * (FOG + 0.25 / 8000.0), rtol=2e-4)


def test_the_air_before_a_distant_fog_bank_veils_it(x64):
    """From 400 m up, 10 km off: what the fog and the ground send is reduced by the air, which adds its own light."""
    distance, zenith = 10e3, np.degrees(np.arccos(-0.04))
    scene = skyfit.Scene.from_degrees(40.0, views([zenith], [120.0]), ONE, irradiance="unit", height=400.0)
    solver = Shells(geometry="flat")
    alone, veiled = (solver.path(foggy(air=a), scene, jnp.array([distance])) for a in (0.0, 0.25))
    through = float(veiled.transmittance[0, 0] / alone.transmittance[0, 0])
    assert through == pytest.approx(np.exp(-0.25 / 8000.0 * distance), rel=1e-9)
    transmittance, inscatter = flat_path(40.0, zenith, 120.0, 400.0, distance)
    assert float(veiled.inscatter[0, 0]) == pytest.approx(inscatter, rel=1e-7)
    assert transmittance == pytest.approx(float(veiled.transmittance[0, 0]), rel=1e-9)


def test_the_flat_sky_is_the_path_to_beyond_all_layers(x64):
    scene = unit_scene(50.0, views([0.0, 60.0, 88.0, 91.0], [0.0, 120.0]))
    sky = Shells(geometry="flat").radiance(foggy(), scene)
    above = unit_scene(50.0, views([0.0, 60.0, 88.0], [0.0, 120.0]))
    path = Shells(geometry="flat").path(foggy(), above, jnp.full(6, jnp.inf))
    np.testing.assert_allclose(sky[:6], path.inscatter, rtol=1e-12)
    np.testing.assert_array_equal(sky[6:], 0.0)
    expected = [flat_path(50.0, z, a, 0.0, 1e6)[1] for z in (0.0, 60.0, 88.0) for a in (0.0, 120.0)]
    np.testing.assert_allclose(sky[:6, 0], expected, rtol=1e-7)


def test_a_low_suns_fog_has_one_colour_and_the_light_goes_as_its_opacity(x64):
    """No direct light within: E / 4 pi of the sunlight above the fog, whatever the view."""
    wavelength = np.array([450.0, 650.0])
    air = Prescribed(np.array([0.22, 0.05]), Exponential(8000.0), RayleighPhase(0.0))
    fog = Prescribed(np.array([1.2, 1.2]), Layered([0.0, FOG_TOP], [1.0]), HenyeyGreenstein(0.85))
    view = skyfit.Directions.from_degrees([90.0, 90.0, 80.0], [0.0, 170.0, 30.0])
    scene = skyfit.Scene.from_degrees(88.0, view, wavelength, irradiance="unit", height=1.5)
    path = Shells(geometry="flat", low_sun=True).path(skyfit.Atmosphere(air, fog, None), scene, jnp.full(3, 50.0))
    angle = np.radians(2.0)
    above = chord(EARTH_RADIUS + 8000.0, EARTH_RADIUS, angle) - chord(EARTH_RADIUS + FOG_TOP, EARTH_RADIUS, angle)
    colour = np.exp(-np.array([0.22, 0.05]) / 8000.0 * above) / (4.0 * np.pi)
    # the air's share of the opacity does not glow, and a beam through the fog leaves it nothing to scatter
    share = (1.2 / FOG_TOP) / (1.2 / FOG_TOP + np.array([0.22, 0.05]) / 8000.0)
    np.testing.assert_allclose(path.inscatter / (1.0 - path.transmittance), np.ones((3, 1)) * colour * share, rtol=1e-9)
    assert colour[1] > 2.0 * colour[0]


def test_a_low_sun_lights_fog_only_from_all_sides(x64):
    """Without fog the air scatters the beam as ever, and black fog does not shine."""
    scene = skyfit.Scene.from_degrees(80.0, views([60.0, 90.0], [20.0]), ONE, irradiance="unit", height=1.5)
    low, beam = Shells(geometry="flat", low_sun=True), Shells(geometry="flat")
    air = Prescribed(np.array([0.1]), Exponential(8000.0), RayleighPhase(0.0))
    thin, black = (
        skyfit.Atmosphere(
            air, Prescribed(np.array([depth]), Layered([0.0, FOG_TOP], [1.0]), HenyeyGreenstein(0.85), albedo), None
        )
        for depth, albedo in ((0.0, 1.0), (2.0, 0.0))
    )
    for distance in (2e4, np.inf):
        far = jnp.full(2, distance)
        bare = beam.path(thin, scene, far).inscatter
        assert np.all(bare > 0.0)
        for clear in (thin, skyfit.Atmosphere(air, None, None)):
            np.testing.assert_allclose(low.path(clear, scene, far).inscatter, bare, rtol=1e-12)
        np.testing.assert_allclose(
            low.path(black, scene, far).inscatter, beam.path(black, scene, far).inscatter, rtol=1e-12
        )


@pytest.mark.parametrize("low_sun", [False, True])
def test_a_sun_on_the_horizon_shines_in_either_precision(low_sun):
    """90 degrees: float32 rounds pi / 2 to below the horizon."""
    solver = Shells(geometry="flat", low_sun=True) if low_sun else Shells()
    lights = []
    for double in (False, True):
        with jax.enable_x64(double):
            scene = unit_scene(90.0, views([88.0], [20.0]))
            if low_sun:
                lights.append(float(solver.path(foggy(), scene, jnp.array([50.0])).inscatter[0, 0]))
            else:
                lights.append(float(solver.radiance(haze_over_air(*DEPTHS), scene)[0, 0]))
            below = unit_scene(91.0, views([88.0], [20.0]))
            # refused where it is seen, black where it is traced
            with pytest.raises(ValueError, match="`sun_zenith` must be"):
                solver.fluxes(foggy(), below)
            assert float(eqx.filter_jit(solver.fluxes)(foggy(), below).diffuse_down[0]) == 0.0
    assert lights[1] > 0.0
    assert lights[0] == pytest.approx(lights[1], rel=3e-3)


# --- gradients, batches, errors


def test_gradients_of_a_path_are_central_differences(x64):
    view = skyfit.Directions.from_degrees([85.0, 92.0, 60.0], [0.0, 100.0, 30.0])

    def field(v):
        fog = Prescribed(
            v[:1] * v[1], Layered(jnp.stack([0.0 * v[1], v[1]]), jnp.ones(1)), HenyeyGreenstein(v[2]), v[3]
        )
        air = Prescribed(v[4:5], Exponential(v[5]), RayleighPhase(0.0))
        scene = skyfit.Scene(v[6], 0.3, view, ONE, jnp.ones(1), v[7])
        path = Shells(geometry="flat").path(skyfit.Atmosphere(air, fog, None), scene, jnp.array([30.0, 900.0, 90.0]))
        return jnp.concatenate([path.transmittance, path.inscatter])[:, 0]

    at = jnp.array([0.01, 60.0, 0.8, 0.95, 0.3, 8000.0, 0.9, 20.0])
    step = 1e-5 * jnp.diag(at)
    around = jax.vmap(field)(jnp.concatenate([at[None] + step, at[None] - step]))
    central = (around[:8] - around[8:]) / (2e-5 * at[:, None])
    forward = jax.jacfwd(field)(at).T
    for i in range(8):
        assert float(jnp.max(jnp.abs(central[i]))) > 0.0
        np.testing.assert_allclose(forward[i], central[i], atol=1e-5 * float(jnp.max(jnp.abs(central[i]))) + 1e-12)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_paths_at_the_ends_of_the_range_have_finite_values_and_gradients(dtype):
    with jax.enable_x64(dtype == "float64"):
        view = skyfit.Directions(np.array([0.0, 0.9, 0.5 * np.pi, 1.5708, 1.6, np.pi]), np.zeros(6))

        @jax.jit
        def both(v, distance, low):
            def total(v):
                fog = Prescribed(v[:1], Layered(jnp.stack([0.0 * v[1], v[1]]), jnp.ones(1)), HenyeyGreenstein(v[2]))
                scene = skyfit.Scene(v[3], 0.0, view, ONE, jnp.ones(1), v[4])
                path = Shells(geometry="flat").path(skyfit.Atmosphere(Rayleigh(), fog), scene, distance)
                dim = Shells(geometry="flat", low_sun=True).path(skyfit.Atmosphere(Rayleigh(), fog), scene, distance)
                return jnp.sum(path.transmittance + path.inscatter + dim.inscatter)

            return jax.value_and_grad(total)(v)

        for depth in (0.0, 1e-12, 1.0, 50.0):
            for sun in (0.0, 0.7, 0.5 * np.pi, 1.6, np.pi):
                for eye in (0.0, 60.0, 200.0):
                    for distance in (0.0, 100.0, np.inf):
                        v = jnp.array([depth, 60.0, 0.85, sun, eye], float)
                        value, slope = both(v, jnp.full(6, distance), False)
                        assert np.isfinite(value) and np.all(np.isfinite(slope)), (depth, sun, eye, distance)


@pytest.mark.parametrize("low_sun", [False, True])
def test_a_path_of_float32_is_near_float64(low_sun):
    def path():
        view = skyfit.Directions.from_degrees([30.0, 89.9, 90.0, 90.1, 150.0], [0.0, 30.0, 90.0, 150.0, 0.0])
        solver, both = Shells(geometry="flat", low_sun=low_sun), []
        for eye in (2.0, 400.0):
            scene = skyfit.Scene.from_degrees(60.0, view, ONE, irradiance="unit", height=eye)
            both.append(solver.path(foggy(), scene, jnp.full(5, 120.0 if eye < FOG_TOP else 5000.0)))
        return np.concatenate([np.concatenate([p.transmittance, p.inscatter]) for p in both])

    single = path()
    assert single.dtype == np.float32
    with jax.enable_x64(True):
        np.testing.assert_allclose(single, path(), rtol=3e-4)


def test_what_a_solver_cannot_do_it_says():
    scene = unit_scene(30.0, views([90.0], [0.0]))
    with pytest.raises(ValueError, match='`geometry` must be "flat"'):
        Shells().path(foggy(), scene, jnp.ones(1))
    raised = skyfit.Scene.from_degrees(30.0, views([60.0], [0.0]), ONE, irradiance="unit", height=10.0)
    for geometry in ("flat", "spherical"):
        for call in (Shells(geometry=geometry).radiance, Shells(geometry=geometry).fluxes):
            with pytest.raises(ValueError, match="`height`"):
                call(foggy(), raised)
    for wrong, name in (
        ({"nodes": 0}, "nodes"),
        ({"blue_sky": "green"}, "blue_sky"),
        ({"blue_sky": "constant", "geometry": "flat"}, "blue_sky"),
        ({"low_sun": True}, "low_sun"),
    ):
        with pytest.raises((ValueError, TypeError), match=name):
            Shells(**wrong)


# --- colour


def test_the_three_colours_of_coefficients_do_not_commute_with_the_integral(x64):
    """Sec. 8: turned into red, green and blue before the integral, coefficients give unphysical colours.

    He says of air that one coefficient turns negative. In sRGB air's three are positive; ozone's blue one is
    negative, and lets more light out than comes in. Of air, the low sun's disc comes out wrong, and its sky.
    """
    wavelength = np.arange(400.0, 721.0, 10.0)
    even = linear_rgb(np.ones(33), wavelength)

    def three_of(spectrum):
        return linear_rgb(spectrum, wavelength) / even

    ozone = np.asarray(Ozone(300.0).optical_depth_at(jnp.asarray(wavelength)))
    assert three_of(ozone)[2] < 0.0 < three_of(ozone)[0]
    assert np.exp(-30.0 * three_of(ozone)[2]) > 1.05
    through = skyfit.xyz(jnp.asarray(np.exp(-30.0 * ozone)), wavelength) / skyfit.xyz(jnp.ones(33), wavelength)
    assert np.all(through < 1.0)
    air = np.asarray(Rayleigh().optical_depth_at(jnp.asarray(wavelength)))
    assert np.all(three_of(air) > 0.0)

    def lights(coefficients, colours, sun):
        """The sun's disc and two places of the sky."""
        atmosphere = skyfit.Atmosphere(Prescribed(coefficients, Exponential(8000.0), RayleighPhase()), None, None)
        scene = skyfit.Scene.from_degrees(sun, views([30.0, 85.0], [0.0]), colours, irradiance="unit")
        disc = Shells().fluxes(atmosphere, scene).direct / np.cos(np.radians(sun))
        return np.concatenate([disc[None], Shells().radiance(atmosphere, scene)])

    errors = []
    for sun in (20.0, 88.0):
        whole = np.stack([three_of(row) for row in lights(air, wavelength, sun)])
        errors.append(np.abs(lights(three_of(air), np.array([650.0, 550.0, 450.0]), sun) / whole - 1.0))
    assert errors[0].max() < 0.03
    # the sun's green and blue, the sky's
    assert errors[1][0, 1] > 0.1 and errors[1][0, 2] > 1.0 and errors[1][1:].max() > 0.05


def linear_rgb(spectrum, wavelength):
    """Linear sRGB: the encoded value is 12.92 times the linear one where that is small."""
    return np.asarray(skyfit.srgb(jnp.asarray(spectrum), wavelength, 1e-9)) / 12.92e-9


@pytest.mark.parametrize("sun", [30.0, 85.0])
def test_33_wavelengths_have_the_colour_of_161(x64, sun):
    view, colours = views([10.0, 70.0, 88.0], [0.0, 120.0]), []
    for step in (10.0, 2.0):
        wavelength = np.arange(400.0, 721.0, step)
        # the sun's own lines are left out: smooth to 20 nm
        scene = skyfit.Scene.from_degrees(sun, view, wavelength, fwhm_nm=20.0)
        colours.append(
            np.asarray(skyfit.xyY(Shells().radiance(skyfit.Atmosphere.from_turbidity(3.0), scene), wavelength))
        )
    assert colours[1].shape == (6, 3)
    np.testing.assert_allclose(colours[0][:, :2], colours[1][:, :2], atol=1e-3)
    np.testing.assert_allclose(colours[0][:, 2], colours[1][:, 2], rtol=5e-3)


def test_layers_of_one_top_have_the_gradient_of_differences(x64):
    """Two tops are equal; the sky is differentiable there in each of them."""
    scene = unit_scene(50.0, views([0.0, 60.0, 85.0], [30.0]))

    def sky(tops):
        haze = Prescribed(jnp.array([1.0]), Exponential(tops[1]), HenyeyGreenstein(0.7), 0.9)
        air = Prescribed(jnp.array([0.25]), Exponential(tops[0]), RayleighPhase(0.0))
        return Shells().radiance(skyfit.Atmosphere(air, haze, None), scene)

    start = jnp.array([2000.0, 2000.0])
    slopes = jax.jacfwd(sky)(start)
    for i in range(2):
        step = 0.01 * jnp.eye(2)[i]
        central = (sky(start + step) - sky(start - step)) / 0.02
        np.testing.assert_allclose(slopes[..., i], central, atol=1e-5 * float(jnp.max(jnp.abs(central))))
