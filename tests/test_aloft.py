"""Single scattering seen from above the ground and on the way to objects, against Cartesian integrals."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from skies import (
    COLOURS,
    EARTH_RADIUS,
    forward_of,
    haze_over_air,
    hazy,
    ONE,
    phase_functions,
    slow,
    unit_vector,
)
from test_single import panels, spherical_integral

import skyfit
from skyfit.transport import SingleScattering


TOP = 100e3
DEPTHS, SCALES, ALBEDOS = (0.25, 0.3), (8000.0, 1200.0), (1.0, 0.9)


def crossings(square, linear, constant):
    """Real positive roots."""
    roots = np.roots([square, linear, constant])
    return [float(r.real) for r in roots if abs(r.imag) < 1e-9 and r.real > 1e-6]


def aloft_integral(height, sun, view, azimuth, distance=np.inf, depths=DEPTHS):
    """Cartesian: the line is cut at both spheres, the shadow's cylinder and its lowest point; panels on lit pieces.

    Returns the radiance and the transmittance of the whole line.
    """
    sunward, viewward = unit_vector(sun, 0.0), unit_vector(view, azimuth)
    eye = np.array([0.0, 0.0, EARTH_RADIUS + height])

    def density(points):
        level = np.linalg.norm(points, axis=-1) - EARTH_RADIUS
        return np.stack([t / h * np.exp(-level / h) for t, h in zip(depths, SCALES, strict=True)], axis=-1)

    along = 2.0 * eye @ viewward
    ground = crossings(1.0, along, height * (2.0 * EARTH_RADIUS + height)) if view > 90.0 else []
    top = crossings(1.0, along, eye @ eye - (EARTH_RADIUS + TOP) ** 2)
    end = min([distance, *ground[-1:], *ground[:1]]) if ground else distance
    across, offset = viewward - viewward @ sunward * sunward, eye - eye @ sunward * sunward
    cylinder = crossings(across @ across, 2.0 * across @ offset, offset @ offset - EARTH_RADIUS**2)
    cuts = [0.0, *top, *cylinder, max(-0.5 * along, 0.0), min(end, 1e7)]
    cuts = np.unique([c for c in cuts if c <= end])
    half = np.concatenate([[0.0], np.geomspace(1e-5, 0.5, 10)])
    fractions = np.concatenate([half, 1.0 - half[-2::-1]])
    inside, inside_weight = panels(0.0, np.linspace(0.0, 1.0, 33)[1:])
    outward, outward_weight = panels(0.0, np.geomspace(200.0, 3e6, 14))
    behind, behind_weight = panels(0.0, np.linspace(0.0, 1.0, 9)[1:])
    phases = np.array(phase_functions(sunward @ viewward))

    def from_eye(to):
        return to * inside_weight @ density(eye + to * inside[:, None] * viewward).sum(-1)

    def to_sun(point):
        depth = point @ sunward
        nearest = point - depth * sunward if depth < 0.0 else point
        column = outward_weight @ density(nearest + outward[:, None] * sunward).sum(-1)
        if depth < 0.0:
            column -= depth * behind_weight @ density(nearest + depth * behind[:, None] * sunward).sum(-1)
        return column

    total = 0.0
    for low, high in zip(cuts, cuts[1:], strict=False):
        middle = eye + 0.5 * (low + high) * viewward
        shaded = middle @ sunward < 0.0 and np.linalg.norm(middle - middle @ sunward * sunward) < EARTH_RADIUS
        if shaded or np.linalg.norm(middle) > EARTH_RADIUS + TOP:
            continue
        place, weight = panels(low, (fractions[1:]) * (high - low), 10)
        points = eye + place[:, None] * viewward
        attenuation = [np.exp(-from_eye(s) - to_sun(p)) for s, p in zip(place, points, strict=True)]
        total += weight @ (density(points) @ (phases * ALBEDOS) * attenuation)
    return total, np.exp(-from_eye(min(end, 3e6)))


@eqx.filter_jit
def seen(solver, height, sun_deg, view_deg, azimuth_deg, distance=None):
    """One view, one wavelength: radiance, or the path to a distance."""
    view = skyfit.Directions(jnp.deg2rad(view_deg)[None], jnp.deg2rad(azimuth_deg)[None])
    scene = skyfit.Scene(jnp.deg2rad(sun_deg), 0.0, view, ONE, jnp.ones(1), height)
    atmosphere = haze_over_air(*DEPTHS)
    if distance is None:
        return solver.radiance(atmosphere, scene)[0, 0]
    path = solver.path(atmosphere, scene, distance[None])
    return jnp.stack([path.inscatter[0, 0], path.transmittance[0, 0]])


def seen_each(solver, height, sun, views_deg, azimuths_deg, distance=None):
    grid = [(v, a) for v in views_deg for a in azimuths_deg]
    values = [seen(solver, *(jnp.asarray(float(x)) for x in (height, sun, v, a)), distance) for v, a in grid]
    return grid, np.asarray(values)


# --- against integrals written down again

VIEWS = {
    1.0: (0.0, 60.0, 89.0, 92.0, 150.0, 180.0),
    2e3: (0.0, 89.0, 90.5, 91.3, 91.5, 92.0, 120.0, 180.0),
    10e3: (0.0, 89.0, 92.0, 93.0, 95.0, 150.0, 180.0),
    100e3: (80.0, 92.0, 98.0, 99.9, 102.0, 140.0, 180.0),
    400e3: (90.0, 107.0, 108.0, 109.5, 110.0, 112.0, 150.0, 180.0),
}
SUNS = (0.0, 60.0, 85.0, 90.0, 95.0, 100.0)
FEW = {(2e3, 60.0), (10e3, 95.0), (400e3, 90.0), (400e3, 100.0)}


def test_the_independent_integral_at_the_ground_is_that_of_the_ground():
    arguments = (60.0, 40.0, 30.0)
    found, through = aloft_integral(0.0, *arguments)
    assert found == pytest.approx(spherical_integral(*arguments, DEPTHS, SCALES, ALBEDOS), rel=2e-6)
    assert through == pytest.approx(np.exp(-sum(DEPTHS) / np.cos(np.radians(40.0))), rel=2e-3)


@pytest.mark.parametrize("height, sun", [(h, s) if (h, s) in FEW else slow(h, s) for h in VIEWS for s in SUNS])
def test_the_observer_aloft_sees_the_integral(x64, height, sun):
    """Up, along the limb, down to the ground and from above the air; night, twilight and day."""
    grid, found = seen_each(SingleScattering.normal(), height, sun, VIEWS[height], (0.0, 100.0, 180.0))
    expected = np.array([aloft_integral(height, sun, v, a)[0] for v, a in grid])
    np.testing.assert_allclose(found, expected, rtol=5e-6, atol=1e-14)
    if sun < 95.0:
        assert np.count_nonzero(expected) > 0.7 * len(grid)


def flat_aloft(height, sun, view, azimuth, distance=np.inf):
    """In height, by scipy's adaptive quadrature."""
    mu, mu_sun = np.cos(np.radians([view, sun]))
    phases = phase_functions(unit_vector(sun, 0.0) @ unit_vector(view, azimuth))
    end = min(max(height + distance * mu, 0.0), max(3e5, 2.0 * height))

    def above(level):
        return sum(t * np.exp(-level / h) for t, h in zip(DEPTHS, SCALES, strict=True))

    def integrand(level):
        terms = zip(phases, ALBEDOS, DEPTHS, SCALES, strict=True)
        emitted = sum(p * a * t * np.exp(-level / h) / h for p, a, t, h in terms)
        return emitted * np.exp((above(level) - above(height)) / mu - above(level) / mu_sun) / mu

    inside = [p for p in (100.0, 1e3, 5e3, 2e4, 6e4) if min(height, end) < p < max(height, end)]
    value = quad(integrand, height, end, points=inside, epsabs=0.0, epsrel=1e-10, limit=400)[0]
    return value, np.exp((above(end) - above(height)) / mu)


@pytest.mark.parametrize("height", [1.0, 2e3, 4e5])
def test_the_flat_observer_aloft_sees_the_integral(x64, height):
    solver = SingleScattering.fine("flat")
    for sun in (20.0, 80.0):
        grid, found = seen_each(solver, height, sun, (0.0, 70.0, 88.0, 92.0, 120.0, 180.0), (0.0, 120.0))
        expected = [flat_aloft(height, sun, v, a)[0] for v, a in grid]
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-20)


# --- limits


@eqx.filter_jit
def compiled(solver, atmosphere, height, sun, zenith, azimuth, distance):
    scene = skyfit.Scene(sun, 0.3, skyfit.Directions(zenith, azimuth), COLOURS, jnp.ones(len(COLOURS)), height)
    return solver.radiance(atmosphere, scene) if distance is None else solver.path(atmosphere, scene, distance)


def sky_from(solver, atmosphere, height, sun, zenith, azimuth, distance=None):
    """One program for every value: numbers would be compiled in."""
    values = (height, sun, zenith, azimuth, distance)
    return compiled(solver, atmosphere, *(None if v is None else jnp.asarray(v, float) for v in values))


DOME = np.radians(np.array([0.0, 40.0, 80.0, 89.0, 90.0, 90.0])), np.array([0.0, 1.0, 3.0, 0.5, 2.0, 5.0])


@pytest.mark.parametrize("geometry", ["flat", "spherical"])
@pytest.mark.parametrize("sun", [0.0, 1.0, 1.55, 0.5 * np.pi, 1.6])
def test_height_0_is_the_ground(x64, geometry, sun):
    solver = SingleScattering(12, geometry)
    ground = sky_from(solver, hazy(), None, sun, *DOME)
    np.testing.assert_allclose(sky_from(solver, hazy(), jnp.asarray(0.0), sun, *DOME), ground, rtol=1e-9)
    close = sky_from(solver, hazy(), jnp.asarray(1e-3), sun, *DOME)
    np.testing.assert_allclose(close, ground, rtol=1e-5 if geometry == "spherical" else 3e-5, atol=1e-12)
    assert geometry == "flat" or np.all(np.asarray(ground)[0] > 0.0)


@pytest.mark.parametrize("geometry", ["flat", "spherical"])
def test_views_down_hold_the_light_above_the_ground(x64, geometry):
    """In proportion to the height where it is small; black from the ground."""
    solver, down = SingleScattering(12, geometry), (np.radians([91.0, 120.0, 180.0]), np.zeros(3))
    low, high = (np.asarray(sky_from(solver, hazy(), jnp.asarray(h), 0.8, *down)) for h in (1e-3, 2e-3))
    assert np.all(low > 0.0)
    np.testing.assert_allclose(high / low, 2.0, rtol=1e-5)
    np.testing.assert_array_equal(sky_from(solver, hazy(), None, 0.8, *down), 0.0)


def test_a_view_that_misses_the_air_is_black_and_space_is_clear():
    views = np.radians([0.0, 60.0, 90.0, 100.0]), np.zeros(4)
    height = jnp.asarray(400e3)
    np.testing.assert_array_equal(sky_from(SingleScattering(8), hazy(), height, 0.5, *views), 0.0)
    path = sky_from(SingleScattering(8), hazy(), height, 0.5, *views, jnp.full(4, np.inf))
    np.testing.assert_allclose(path.transmittance, 1.0, rtol=1e-5)
    np.testing.assert_array_equal(path.inscatter, 0.0)


def test_fluxes_stay_on_the_ground_and_the_ground_pays_nothing_for_height():
    solver, atmosphere = SingleScattering(4), hazy()
    scenes = [skyfit.Scene(0.8, 0.0, skyfit.Directions(*DOME), COLOURS, jnp.ones(len(COLOURS)), h) for h in (None, 5e3)]
    for here, aloft in zip(*(solver.fluxes(atmosphere, s) for s in scenes), strict=True):
        np.testing.assert_array_equal(here, aloft)
    ground, aloft = (str(jax.make_jaxpr(lambda a, s=s: solver.radiance(a, s))(atmosphere)) for s in scenes)
    # four points a view on the ground, three times as many aloft
    assert len(ground) < len(aloft) and "[6,4]" in ground and "[6,12]" not in ground and "[6,12]" in aloft


# --- paths to objects


@pytest.mark.parametrize("height, sun, view, azimuth", [
    (0.0, 40.0, 80.0, 20.0), (2e3, 70.0, 91.2, 100.0), (10e3, 92.0, 93.0, 10.0), (10e3, 30.0, 130.0, 90.0),
    (400e3, 97.0, 109.5, 180.0),
])  # fmt: skip
def test_the_path_to_an_object_is_the_integral_to_it(x64, height, sun, view, azimuth):
    solver = SingleScattering.normal()
    start = 2e6 if height > 1e5 else 0.0
    for distance in (1.0, 300.0, 5e3, 60e3, 500e3):
        expected = aloft_integral(height, sun, view, azimuth, start + distance)
        arguments = (jnp.asarray(float(x)) for x in (height, sun, view, azimuth, start + distance))
        found = seen(solver, *arguments)
        np.testing.assert_allclose(found, expected, rtol=5e-6, atol=1e-15, err_msg=str(distance))


@pytest.mark.parametrize("height", [1.0, 2e3, 2e4])
def test_the_flat_path_is_the_integral(x64, height):
    for view in (10.0, 80.0, 100.0, 170.0):
        for distance in (1.0, 2e3, 8e4):
            arguments = (jnp.asarray(float(x)) for x in (height, 50.0, view, 90.0, distance))
            found = seen(SingleScattering.fine("flat"), *arguments)
            np.testing.assert_allclose(found, flat_aloft(height, 50.0, view, 90.0, distance), rtol=1e-6)


@pytest.mark.parametrize("geometry", ["flat", "spherical"])
@pytest.mark.parametrize("height", [None, 3e3])
def test_the_path_to_infinity_is_the_sky(x64, geometry, height):
    """Down, too: the ground ends it."""
    height = None if height is None else jnp.asarray(height)
    views = np.radians([0.0, 50.0, 89.0, 92.0, 180.0]), np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    solver = SingleScattering(12, geometry)
    path = sky_from(solver, hazy(), height, 0.9, *views, jnp.full(5, np.inf))
    np.testing.assert_allclose(path.inscatter, sky_from(solver, hazy(), height, 0.9, *views), rtol=1e-12)
    assert np.all(path.transmittance > 0.0) and np.all(path.transmittance <= 1.0)
    near = sky_from(solver, hazy(), height, 0.9, *views, jnp.zeros(5))
    np.testing.assert_array_equal(near.inscatter, 0.0)
    np.testing.assert_allclose(near.transmittance, 1.0, rtol=1e-12)


@pytest.mark.parametrize("view, azimuth, sun", [(60.0, 30.0, 50.0), (88.0, 170.0, 92.0), (91.0, 60.0, 80.0)])
def test_paths_add_up(x64, view, azimuth, sun):
    """L(0, d2) = L(0, d1) + T(0, d1) L(d1, d2), the second seen by an observer who has gone to d1; and T both ways."""
    height, first, second = 2500.0, 7e3, 30e3
    solver = SingleScattering.fine()
    turned = np.radians([view, azimuth, sun])
    toward = np.array([np.sin(turned[0]) * np.cos(turned[1]), np.sin(turned[0]) * np.sin(turned[1]), np.cos(turned[0])])
    sunward = np.array([np.sin(turned[2]), 0.0, np.cos(turned[2])])
    there = np.array([0.0, 0.0, EARTH_RADIUS + height]) + first * toward
    up = there / np.linalg.norm(there)

    def angles(direction, reference):
        level, flat = direction - direction @ up * up, reference - reference @ up * up
        cosine = level @ flat / np.linalg.norm(level) / np.linalg.norm(flat)
        return np.degrees(np.arccos(direction @ up)), np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))

    def path(height, sun, view, azimuth, distance):
        return np.asarray(seen(solver, *(jnp.asarray(float(x)) for x in (height, sun, view, azimuth, distance))))

    whole, near = (path(height, sun, view, azimuth, d) for d in (second, first))
    moved = np.linalg.norm(there) - EARTH_RADIUS
    far_sun = np.degrees(np.arccos(sunward @ up))
    far = path(moved, far_sun, *angles(toward, sunward), second - first)
    back = path(moved, far_sun, *angles(-toward, sunward), first)
    assert whole[0] == pytest.approx(near[0] + near[1] * far[0], rel=1e-6)
    assert whole[1] == pytest.approx(near[1] * far[1], rel=1e-8)
    assert back[1] == pytest.approx(near[1], rel=1e-8)


# --- gradients and hard cases

LIMB = float(np.degrees(np.arcsin(EARTH_RADIUS / (EARTH_RADIUS + 400e3))))
DIRECTIONS = np.radians([0.0, 45.0, 89.0, 90.0, 90.5, 105.0, 180.0 - LIMB, 120.0, 180.0]), np.linspace(0.3, 3.4, 9)


def program(reverse):
    """The path to a distance with derivatives by height, sun and atmosphere."""

    def field(parameters, distance):
        height, sun, atmosphere = parameters
        return jnp.stack(sky_from(SingleScattering(6), atmosphere, height, sun, *DIRECTIONS, jnp.full(9, distance)))

    if reverse:
        return jax.jit(jax.grad(lambda p, d: jnp.sum(field(p, d))))
    return jax.jit(lambda p, d: (field(p, d), jax.jacfwd(field)(p, d)))


@pytest.mark.parametrize(
    "dtype, reverse", [("float32", False), slow("float64", False), slow("float32", True), slow("float64", True)]
)
def test_hard_cases_aloft_are_finite(dtype, reverse):
    step = float(np.spacing(np.float32(90.0)))
    with jax.enable_x64(dtype == "float64"):
        run, bad = program(reverse), []
        for height in (0.0, 1e-3, 2e3, 99999.0, 100e3, 100001.0, 400e3):
            for sun in (0.0, 17.188734, 60.0, 90.0 - step, 90.0, 90.0 + step, 95.0, LIMB, 180.0 - LIMB, 180.0):
                for changes in ({}, {"haze": 0.0, "pressure": 0.0}, {"haze": 50.0}):
                    parameters = jnp.asarray(height, float), jnp.asarray(np.radians(sun), float), hazy(**changes)
                    parameters = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), parameters)
                    for distance in (20e3, np.inf):
                        leaves = jax.tree.leaves(run(parameters, jnp.asarray(distance, float)))
                        if not all(np.all(np.isfinite(leaf)) for leaf in leaves):
                            bad.append((height, sun, changes, distance))
                        elif not reverse and np.min(leaves[0]) < 0.0:
                            bad.append(("negative", height, sun, changes, distance))
        assert not bad, bad


@pytest.mark.parametrize(
    "height, sun", [(2e3, 1.6), slow(2e3, 1.0), slow(30e3, 1.63), slow(400e3, 1.7), slow(400e3, 0.7)]
)
def test_gradients_aloft_are_central_differences(x64, height, sun):
    """To objects, to the ground and to space."""
    zenith, azimuth = np.radians([20.0, 88.0, 91.0, 100.0, 109.0, 112.0, 150.0]), np.linspace(0.2, 2.9, 7)
    distance = np.array([np.inf, 3e4, 3e4, 2e4, np.inf, 1.9e6, np.inf])
    leaves, tree = jax.tree.flatten((jnp.asarray(height), jnp.asarray(sun), hazy()))
    scale = jnp.maximum(jnp.abs(jnp.stack(leaves)), 0.05)

    def field(relative):
        height, sun, atmosphere = jax.tree.unflatten(tree, list(jnp.stack(leaves) + relative * scale))
        return jnp.stack(sky_from(SingleScattering(6), atmosphere, height, sun, zenith, azimuth, distance))

    around, slopes = forward_of(field, len(leaves), 1e-6)
    central = (around[0] - around[1]) / 2e-6
    for part, name in enumerate(("transmittance", "inscatter")):
        largest = np.max(np.abs(central[:, part]))
        np.testing.assert_allclose(slopes[:, part], central[:, part], atol=1e-5 * largest, err_msg=name)
        # what does not depend: the transmittance on the sun
        assert np.max(np.abs(slopes[0, part])) > 1e-4 * largest
        assert (np.max(np.abs(slopes[1, part])) > 1e-4 * largest) == (name == "inscatter")


def test_float32_aloft_is_near_float64():
    def seen_from(height, sun):
        return np.asarray(sky_from(SingleScattering(24), hazy(), height, sun, *DIRECTIONS))

    for height in (2e3, 10e3, 400e3):
        for sun in (0.5, 1.5, 1.65):
            single = seen_from(height, sun)
            with jax.enable_x64(True):
                double = seen_from(height, sun)
            assert single.dtype == np.float32
            np.testing.assert_allclose(single, double, rtol=1e-3, atol=1e-6 * double.max())
