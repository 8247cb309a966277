"""All orders on a sphere, from the ground to space and into the night."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from skies import COLOURS, forward_of, haze_over_air, hazy, ONE, reverse_of, unit_scene

import skyfit
from skyfit.atmosphere import Exponential, Ground, OzoneLayer, Prescribed, RayleighPhase
from skyfit.transport import OrdersOfScattering, SingleScattering, Spherical
from skyfit.transport.columns import EARTH_RADIUS, slant_column, TOP_OF_AIR


# few of everything: what these tests claim does not depend on resolution
SMALL = Spherical(
    levels=10, moments=4, up=4, flat=2, down=3, orders=4, sun_step=1.5,
    path_nodes=5, first_nodes=6, view_nodes=6, nodes=8,
)  # fmt: skip
VIEW = skyfit.Directions.from_degrees([0.0, 40.0, 75.0, 89.0, 91.0, 130.0], [0.0, 90.0, 180.0, 30.0, 30.0, 10.0])
# zenith angle of the sun (degrees), largest relative error beyond three standard errors of the Monte Carlo
CLASSES = ((-1.0, 89.0, 0.007), (89.0, 96.0, 0.015), (96.0, 108.0, 0.04))


class GaussianLayer(OzoneLayer):
    """The oracle's ozone: a Gaussian around `height`, its standard deviation the `thickness`."""

    def _above(self, height):
        return 0.5 * jax.scipy.special.erfc((height - self.height) / self.thickness / np.sqrt(2.0))

    def column_above(self, height):
        return self._above(height) / self._above(0.0)

    def density(self, height):
        bell = jnp.exp(-0.5 * ((height - self.height) / self.thickness) ** 2) / self.thickness / np.sqrt(2.0 * np.pi)
        return bell / self._above(0.0)


@cache
def solved(case: tuple[float, ...]):
    """The field of a case of the oracle, all suns and heights."""
    air, haze, albedo, asymmetry, ground, ozone = case
    atmosphere = haze_over_air(air, haze, asymmetry, albedo, ground)
    if haze == 0.0:
        atmosphere = atmosphere.replace(aerosol=None)
    if ozone:
        atmosphere = atmosphere.replace(ozone=Prescribed(np.array([ozone]), GaussianLayer(22e3, 5e3)))
    return Spherical.normal().prepare(atmosphere, ONE)


@pytest.mark.parametrize("case", (0, pytest.param(1, marks=pytest.mark.slow), 2))
def test_light_meets_the_monte_carlo_from_the_ground_to_space_and_from_noon_to_night(shared, case):
    table = np.load(shared / "oracles" / "oracle_space.npz")
    field = solved(tuple(table["cases"][case].tolist()))
    mine = (table["case"] == case) & (table["radiance"] > 1e-9)
    # a view that grazes the air far from the observer is judged by the sun over its lowest point
    below = table["vza"] > 90.0
    along = np.where(below & (table["tangent_height_m"] > 0.0), -np.cos(np.radians(table["vza"])), 0.0)
    sun, view, turn = np.radians(table["sza"]), np.radians(table["vza"]), np.radians(table["raz"])
    toward = np.cos(sun) * np.cos(view) + np.sin(sun) * np.sin(view) * np.cos(turn)
    radius = EARTH_RADIUS + table["height_m"]
    lowest = radius * along
    there = np.sqrt(radius**2 + lowest**2 + 2.0 * radius * lowest * np.cos(view))
    judged = np.degrees(np.arccos((radius * np.cos(sun) + lowest * toward) / there))
    judged = np.maximum(judged, table["sza"])
    errors = np.full(mine.shape, np.nan)
    for height in np.unique(table["height_m"][mine]):
        for zenith in np.unique(table["sza"][mine & (table["height_m"] == height)]):
            rows = np.flatnonzero(mine & (table["sza"] == zenith) & (table["height_m"] == height))
            # one shape for all: rows stand more than once
            padded = np.resize(rows, 16)
            views = skyfit.Directions(view[padded], turn[padded])
            scene = skyfit.Scene.from_degrees(zenith, views, ONE, irradiance="unit", height=height or None)
            light = np.asarray(field.radiance(scene))[: rows.size, 0]
            errors[rows] = light / table["radiance"][rows] - 1.0
    for low, high, most in CLASSES:
        chosen = mine & (judged > low) & (judged <= high)
        sigma = table["sigma"][chosen] / table["radiance"][chosen]
        assert np.all(np.abs(errors[chosen]) <= most + 3.0 * sigma + 1e-3)
        assert np.median(np.abs(errors[chosen])) <= {0.007: 0.002, 0.015: 0.005, 0.04: 0.018}[most]


def test_light_order_by_order():
    """The first two orders over a black ground are those of another solver; all together they are the light."""
    air = haze_over_air(0.2, 0.0, 0.0, 1.0, 0.0).replace(aerosol=None)
    scene = unit_scene(50.0, skyfit.Directions.from_degrees([0.0, 40.0, 75.0], [0.0, 90.0, 180.0]))
    field = Spherical.normal().prepare(air, ONE, sun_zenith=scene.sun_zenith)
    orders = field.by_order(scene)
    np.testing.assert_allclose(orders[0], SingleScattering.normal().radiance(air, scene), rtol=1e-4)
    double = skyfit.DoubleScattering.fine("spherical").radiance(air, scene)
    np.testing.assert_allclose(orders[1], double - orders[0], rtol=0.02)
    np.testing.assert_allclose(jnp.sum(orders, axis=0), field.radiance(scene), rtol=1e-6)
    assert np.all(orders[:-1] > 0.0) and np.all(orders[1:-1] < 0.5 * orders[:-2])


def test_fine_orders_agree_by_day():
    atmosphere = haze_over_air(0.2, 0.15, 0.65, 0.95, 0.2)
    view = skyfit.hemisphere(40, np.radians(85.0))
    for sun in (35.0, 70.0):
        scene = unit_scene(sun, view)
        theirs = OrdersOfScattering.fine().radiance(atmosphere, scene)
        ours = Spherical.normal().radiance(atmosphere, scene)
        assert np.median(np.abs(ours / theirs - 1.0)) < 2e-3


@pytest.mark.parametrize(
    "depth, haze, albedo, solver, within",
    [
        (0.3, 0.0, 0.5, Spherical.normal(), 1.5e-3),
        (0.3, 0.2, 0.5, Spherical.normal(), 1.5e-3),
        # with more of the nodes that thick air asks for
        (10.0, 0.0, 1.0, Spherical(path_nodes=16), 1e-3),
    ],
)
def test_no_light_is_lost_over_the_globe(x64, depth, haze, albedo, solver, within):
    """What leaves the air and what the ground takes are what the air takes of the beam."""
    profile = Exponential(8000.0)
    atmosphere = haze_over_air(depth, haze, 0.6, 1.0, albedo, haze_height=8000.0)
    if haze == 0.0:
        atmosphere = atmosphere.replace(aerosol=None)
    field = solver.prepare(atmosphere, ONE)
    nodes, weights = np.polynomial.legendre.leggauss(60)
    zenith, weights = np.radians(60.0) * (nodes + 1.0), np.radians(60.0) * weights
    here = skyfit.Directions(np.zeros(1), np.zeros(1))

    def flux(sun):
        light = field.fluxes(skyfit.Scene(sun, 0.0, here, ONE, np.ones(1)))
        return jnp.stack([light.up_at_top[0], light.direct[0] + light.diffuse_down[0] - light.up[0]])

    out, taken = np.asarray(jax.lax.map(flux, jnp.asarray(zenith[zenith < np.radians(108.0)]))).T
    weights = (weights * np.sin(zenith))[zenith < np.radians(108.0)]
    top = EARTH_RADIUS + TOP_OF_AIR
    height = np.linspace(0.0, TOP_OF_AIR, 4001)
    limb = 2.0 * (depth + haze) * slant_column(profile, jnp.asarray(height), jnp.zeros(height.size), "spherical")
    beam = EARTH_RADIUS**2 + 2.0 * np.trapezoid((EARTH_RADIUS + height) * -np.expm1(-np.asarray(limb)), height)
    found = 2.0 * (top**2 * weights @ out + EARTH_RADIUS**2 * weights @ taken)
    assert found == pytest.approx(beam, rel=within)


def test_thick_air_has_more_orders_and_what_they_leave_over_is_said(x64, monkeypatch):
    thin, thick = haze_over_air(0.3, 0.1), haze_over_air(9.0, 0.0, ground=0.9).replace(aerosol=None)
    one = jnp.asarray(ONE)
    assert SMALL.suited(thin, one) == SMALL and SMALL.suited(thick, one).orders == 32
    assert Spherical(orders=40).suited(thick, one).orders == 40
    view = skyfit.Directions.from_degrees([0.0, 40.0, 75.0], [0.0, 90.0, 180.0])
    assert SMALL.doubt(thin) is None and "orders of Spherical are few" in SMALL.doubt(thick)
    assert SMALL.suited(thick, one).doubt(thick) is None
    field = SMALL.prepare(thick, ONE, sun_zenith=0.5)
    settled = replace(SMALL, orders=40).prepare(thick, ONE, sun_zenith=0.5)
    here = unit_scene(np.degrees(0.5), view)
    np.testing.assert_allclose(field.radiance(here), settled.radiance(here), rtol=2e-3)
    assert float(field.left_over[0]) < 0.01

    # and in the precision of most
    with jax.enable_x64(False):
        air = haze_over_air(9.0, 0.0, ground=0.9).replace(aerosol=None)
        low = skyfit.Directions.from_degrees([0.0, 40.0, 75.0], [0.0, 90.0, 180.0])
        single = SMALL.radiance(air, unit_scene(np.degrees(0.5), low))
    np.testing.assert_allclose(single, settled.radiance(here), rtol=5e-3)

    # what is traced knows no number of orders, but what they leave over
    @jax.jit
    def by_few(optical_depth):
        air = haze_over_air(optical_depth, 0.0, ground=0.9).replace(aerosol=None)
        found = SMALL.prepare(air, ONE, sun_zenith=0.5)
        return found.left_over, found.radiance(here)

    left_over, light = by_few(9.0)
    assert left_over[0] > 0.5 and np.all(np.isfinite(light))
    monkeypatch.setattr(Spherical, "suited", lambda solver, *_: solver)
    with pytest.warns(skyfit.ThickAirWarning, match="4 orders of scattering leave over may be"):
        SMALL.prepare(thick, ONE, sun_zenith=0.5)


@pytest.mark.parametrize("depth", (0.0, 1e-6))
def test_derivatives_are_finite_where_hardly_anything_scatters(depth):
    scene = unit_scene(40.0, skyfit.Directions.from_degrees([20.0], [0.0]))

    def light(depth):
        air = haze_over_air(depth, 0.0, ground=0.0).replace(aerosol=None)
        return jnp.sum(SMALL.prepare(air, ONE, sun_zenith=0.7).radiance(scene))

    value, slope = jax.jit(jax.value_and_grad(light))(depth)
    assert np.isfinite(value) and slope > 0.0


@pytest.mark.parametrize("sun", (50.0, 93.0))
def test_derivatives_by_every_parameter_are_those_of_differences_forward_and_reverse(sun):
    names = ("pressure", "haze", "albedo", "asymmetry", "ozone", "ground")

    def mean(relative):
        values = (1.0 + relative) * jnp.array([9e4, 0.2, 0.9, 0.6, 300.0, 0.2])
        return jnp.log(jnp.mean(SMALL.radiance(hazy(**dict(zip(names, values, strict=True))), scene)))

    with jax.enable_x64(True):
        scene = skyfit.Scene.from_degrees(sun, VIEW, COLOURS[:2], irradiance="unit", height=2000.0)
        around, forward = forward_of(mean, len(names), 1e-4)
        backward = reverse_of(mean, len(names), 1.0)
    np.testing.assert_allclose(forward, (around[0] - around[1]) / 2e-4, rtol=1e-4)
    np.testing.assert_allclose(backward, forward, rtol=1e-8)


def test_a_window_of_suns_answers_as_all_suns_do():
    atmosphere = hazy()
    whole = SMALL.prepare(atmosphere, COLOURS)
    for sun, height in ((30.0, None), (88.0, None), (97.0, 10e3), (70.0, 400e3)):
        scene = unit_scene(sun, VIEW, COLOURS) if height is None else None
        scene = scene or skyfit.Scene.from_degrees(sun, VIEW, COLOURS, irradiance="unit", height=height)
        np.testing.assert_allclose(SMALL.radiance(atmosphere, scene), whole.radiance(scene), rtol=0.02)


def test_a_traced_sun_and_a_batch_of_suns_answer_as_one():
    atmosphere, suns = hazy(), np.radians([40.0, 91.0])

    def sky(sun):
        return SMALL.radiance(atmosphere, skyfit.Scene(sun, 0.0, VIEW, COLOURS, np.ones(4)))

    batch = jax.jit(jax.vmap(sky))(jnp.asarray(suns))
    alone = np.stack([sky(sun) for sun in suns])
    # another window of suns
    np.testing.assert_allclose(batch, alone, rtol=0.02, atol=1e-7)


def test_the_air_before_the_sky_is_the_sky():
    atmosphere, far = hazy(), jnp.full(VIEW.zenith.shape, jnp.inf)
    scene = skyfit.Scene.from_degrees(60.0, VIEW, COLOURS, irradiance="unit", height=1000.0)
    path = SMALL.path(atmosphere, scene, far)
    light = SMALL.radiance(atmosphere, scene)
    # the one at 91 degrees just misses the ground
    up = np.asarray(VIEW.zenith) < np.radians(91.5)
    np.testing.assert_allclose(path.inscatter[up], light[up], rtol=1e-4)
    # the ground's light comes through the air
    assert np.all(light[~up] > path.inscatter[~up])
    near = SMALL.path(atmosphere, scene, jnp.full(VIEW.zenith.shape, 2e3))
    assert np.all(near.inscatter <= path.inscatter * (1.0 + 1e-5))
    np.testing.assert_allclose(
        near.transmittance, SingleScattering.normal().path(atmosphere, scene, jnp.full(6, 2e3)).transmittance, rtol=1e-5
    )


def test_shade_takes_sunlight_from_the_shaded_parts_of_a_view_alone():
    atmosphere, far = hazy(), jnp.full(VIEW.zenith.shape, 80e3)
    scene = skyfit.Scene.from_degrees(80.0, VIEW, COLOURS, irradiance="unit", height=1000.0)
    field = SMALL.prepare(atmosphere, COLOURS, sun_zenith=scene.sun_zenith, height=1e3)
    at = [jnp.full(far.shape, d) for d in (0.0, 1e3, 5e3, 80e3)]
    whole, dark = field.path(scene, far), field.path(scene, far, lit=[])
    parts = [field.path(scene, far, lit=[(a, b)]).inscatter for a, b in zip(at[:-1], at[1:], strict=True)]
    several = field.path(scene, far, lit=[(at[2], at[3]), (at[0], at[1])]).inscatter
    once = sum(part - dark.inscatter for part in parts)
    np.testing.assert_allclose(dark.inscatter + once, whole.inscatter, rtol=0.01)
    np.testing.assert_allclose(
        several - dark.inscatter, parts[0] + parts[2] - 2.0 * dark.inscatter, rtol=1e-3, atol=1e-6
    )
    # what comes by other ways is there in the shade
    assert np.all(dark.inscatter > 0.0)
    # two programs, which round as they like
    np.testing.assert_allclose(dark.transmittance, whole.transmittance, rtol=1e-6)


def test_twilight_falls_without_steps_and_light_is_never_negative():
    field = SMALL.prepare(hazy(), ONE, sun_zenith=np.radians([80.0, 108.0]), height=0.0)
    up = skyfit.Directions(np.zeros(1), np.zeros(1))

    def light(sun):
        return field.radiance(skyfit.Scene(sun, 0.0, up, ONE, np.ones(1)))[0, 0]

    suns = np.radians(np.arange(80.0, 108.0, 0.05))
    sky = np.asarray(jax.lax.map(light, jnp.asarray(suns), batch_size=64), np.float64)
    assert np.all(np.isfinite(sky)) and np.all(sky > 0.0)
    second = np.abs(np.diff(sky, 2)) / sky[1:-1]
    assert second.max() < 0.01
    horizon = skyfit.Directions(np.radians([89.9, 89.99, 90.01, 90.1]), np.zeros(4))
    from_above = skyfit.Scene.from_degrees(85.0, horizon, ONE, irradiance="unit", height=30e3)
    edge = np.asarray(SMALL.radiance(hazy(), from_above))[:, 0]
    # the sky changes by 5 % in a fifth of a degree there, and by no step where views begin to fall
    assert abs(edge[2] / edge[1] - 1.0) < 0.01


def test_black_air_and_an_empty_sky_have_no_light():
    bare = skyfit.Atmosphere(rayleigh=None, ozone=None, ground=Ground(0.5))
    scene = skyfit.Scene.from_degrees(60.0, VIEW, ONE, irradiance="unit", height=1000.0)
    light = np.asarray(SMALL.radiance(bare, scene))[:, 0]
    assert np.all(light[:4] == 0.0)
    np.testing.assert_allclose(light[5], 0.5 * np.cos(np.radians(60.0)) / np.pi, rtol=1e-3)
    thin = skyfit.Atmosphere(Prescribed(np.zeros(1), Exponential(8000.0), RayleighPhase(0.0)), None, None, Ground(0.0))
    assert np.all(SMALL.radiance(thin, scene) == 0.0)


@pytest.mark.parametrize(
    ("words", "call"),
    (
        ("`sun_zenith` must be between 0 and", lambda f: SMALL.radiance(hazy(), unit_scene(109.0, VIEW, COLOURS))),
        ("solved for suns from 50 to 60", lambda f: f.radiance(unit_scene(70.0, VIEW, COLOURS))),
        ("those that the field was solved for", lambda f: f.radiance(unit_scene(55.0, VIEW, ONE))),
        (
            "observers to 1000 m",
            lambda f: f.radiance(skyfit.Scene.from_degrees(55.0, VIEW, COLOURS, irradiance="unit", height=5e3)),
        ),
        ("`moments` must be even", lambda f: Spherical(moments=7)),
        ('`geometry` must be "spherical"', lambda f: Spherical.normal("flat")),
        ("`height` must be", lambda f: SMALL.prepare(hazy(), COLOURS, height=-1.0)),
    ),
)
def test_what_it_was_not_solved_for_is_refused_in_one_line(words, call):
    field = SMALL.prepare(hazy(), COLOURS, sun_zenith=np.radians([50.0, 60.0]), height=1e3)
    with pytest.raises(ValueError, match=words) as refused:
        call(field)
    assert "\n" not in str(refused.value)
