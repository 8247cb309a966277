"""The air before a depth image: against closed forms, another solver, and the sky behind it; fog that stands in it."""

from contextlib import nullcontext
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from foreign_skies import sasktran2_stokes
from skies import ONE, SPHERE

import skyfit
from skyfit.atmosphere import Layered, Prescribed, RayleighPhase
from skyfit.image.render import SPECTRUM, sunlight
from skyfit.light import SRGB_FROM_XYZ, xyz
from skyfit.transport import OrdersOfScattering, SingleScattering, Spherical, ThickAirWarning


CAMERA = skyfit.Camera("perspective", 6, 4, azimuth=np.pi, elevation=0.2)
SKY = np.full((4, 6), np.inf)
HAZY = skyfit.Atmosphere.from_turbidity(3.0)
SMALL = replace(SPHERE["spherical"], orders=6)


def views(camera):
    east, north, up = camera.views().reshape(3, -1).astype(float)
    return skyfit.Directions(np.arctan2(np.hypot(east, north), up), np.arctan2(east, north))


@pytest.mark.parametrize(
    "sun", (85.0, pytest.param(30.0, marks=pytest.mark.slow), pytest.param(95.0, marks=pytest.mark.slow))
)
def test_no_seam_lies_between_the_air_before_far_objects_and_the_sky(sun):
    """Where there is only sky the in-scatter is the sky's colour; 2000 km away there is no more air."""
    solver, sun = SMALL, np.radians(sun)
    path = skyfit.air_to(SKY, CAMERA, HAZY, solver, sun_zenith=sun)
    scene = skyfit.Scene(sun, np.pi, views(CAMERA), SPECTRUM, sunlight(), 2.0)
    behind = np.asarray(xyz(solver.radiance(HAZY, scene), SPECTRUM)) @ SRGB_FROM_XYZ.T
    above = np.asarray(scene.view.zenith) < np.radians(89.9)
    found = np.asarray(path.inscatter).reshape(-1, 3)
    np.testing.assert_allclose(found[above], behind[above], rtol=1e-4, atol=1e-4 * behind.max())
    far = skyfit.air_to(np.full(SKY.shape, 2e6), CAMERA, HAZY, solver, sun_zenith=sun)
    np.testing.assert_allclose(far.inscatter.reshape(-1, 3)[above], found[above], rtol=1e-5)
    assert np.all(path.transmittance >= 0.0) and np.all(path.transmittance <= 1.0)


def test_air_of_one_density_is_the_closed_form(x64):
    """Hoffman & Preetham's eq. 4 under a sun in the zenith, E p (1 - exp(-b s)), dimmed by the air above."""
    thick, depth, eye = 8e3, 0.4, 2000.0
    air = skyfit.Atmosphere(Prescribed(np.array([depth]), Layered([0.0, thick], [1.0]), RayleighPhase(0.0)), None, None)
    level = skyfit.Camera("perspective", 5, 1, elevation=0.0, field_of_view=0.5)
    distance = np.array([[1.0, 300.0, 2e3, 8e3, 2e4]])
    path = skyfit.air_to(distance, level, air, SingleScattering(), sun_zenith=0.0, height=eye, wavelength_nm=ONE)
    per_metre = depth / thick
    light = float(skyfit.light.extraterrestrial_irradiance(ONE)[0]) * 3.0 / (16.0 * np.pi)
    wanted = light * np.exp(-per_metre * (thick - eye)) * -np.expm1(-per_metre * distance)
    # the Earth is round: 30 m at the end
    np.testing.assert_allclose(path.inscatter[..., 0], wanted, rtol=2e-3)
    np.testing.assert_allclose(path.transmittance[..., 0], np.exp(-per_metre * distance), rtol=1e-6)


@pytest.mark.slow
def test_two_observers_of_another_solver_see_the_air_between_them():
    """What the nearer one does not see of the farther one's sky, on a sphere by sasktran2: all orders."""
    sun, bands = np.radians(60.0), np.array([450.0, 550.0, 650.0])
    zenith, turn = np.radians([30.0, 60.0, 80.0]), np.radians(40.0)
    away, haze = np.array([2e3, 4e3, 1e4]), HAZY.replace(ozone=None)
    up = skyfit.Directions(zenith, np.full(3, turn))
    scene = skyfit.Scene(sun, 0.0, up, bands, np.ones(3), 0.0)
    path = Spherical.normal().path(haze, scene, jnp.asarray(away, float))
    asked = {"geometry": "spherical", "sun_positions": 5}
    near = sasktran2_stokes(haze, 60.0, np.degrees(zenith), np.degrees([turn] * 3), bands, **asked)[0]
    toward = np.array([np.sin(sun), 0.0, np.cos(sun)])
    for k in range(3):
        view = np.array([np.sin(zenith[k]) * np.cos(turn), np.sin(zenith[k]) * np.sin(turn), np.cos(zenith[k])])
        place = np.array([0.0, 0.0, 6371e3]) + away[k] * view
        vertical = place / np.linalg.norm(place)
        rise, height = np.arccos(vertical @ view), float(np.linalg.norm(place) - 6371e3)
        flat = [v - (v @ vertical) * vertical for v in (view, toward)]
        between = np.arccos(flat[0] @ flat[1] / np.linalg.norm(flat[0]) / np.linalg.norm(flat[1]))
        seen = sasktran2_stokes(
            haze, float(np.degrees(np.arccos(vertical @ toward))), [np.degrees(rise)], [np.degrees(between)], bands,
            height_m=height, **asked,
        )[0, 0]  # fmt: skip
        between = near[k] - np.asarray(path.transmittance[k]) * seen
        # what Spherical states of a radiance, here of the nearer one's
        assert np.all(np.abs(path.inscatter[k] - between) < 7e-3 * near[k])


def test_slopes_by_haze_and_distance_are_those_of_differences(x64):
    distance = np.geomspace(500.0, 5e4, 24).reshape(4, 6)

    def image(depth, stretch):
        air = skyfit.Atmosphere.from_optical_depth(depth)
        path = skyfit.air_to(jnp.asarray(distance) * stretch, CAMERA, air, SingleScattering.draft(), sun_zenith=1.0)
        return path.over(jnp.full((4, 6, 3), 500.0))

    at, step = (0.1, 1.0), 1e-4
    for k in range(2):
        tangent = tuple(float(i == k) for i in range(2))
        _, slope = jax.jvp(image, at, tangent)
        high, low = (image(*(a + sign * step * t for a, t in zip(at, tangent, strict=True))) for sign in (1.0, -1.0))
        np.testing.assert_allclose(slope, (high - low) / (2.0 * step), atol=1e-4 * np.abs(slope).max())


def test_shade_takes_light_from_the_air():
    """Lit to where it is seen: as without shade; nowhere lit: what comes by other ways alone."""
    distance, none = np.full(SKY.shape, 3e4), np.zeros(SKY.shape)
    asked = {"solver": SMALL, "sun_zenith": np.radians(80.0), "wavelength_nm": ONE}
    open_ = skyfit.air_to(distance, CAMERA, HAZY, **asked, lit=[(none, distance)])
    dark = skyfit.air_to(distance, CAMERA, HAZY, **asked, lit=[(none, none)])
    assert np.all(dark.inscatter > 0.0) and np.all(dark.inscatter < 0.9 * open_.inscatter)


@pytest.mark.slow
@pytest.mark.parametrize("thickness", (100.0, 40.0))
def test_fog_on_top_of_the_atmosphere_there_is_has_all_orders(x64, thickness):
    """Of optical depth 2, beside discrete ordinates in flat layers, but for the aureole."""
    fog = skyfit.Droplets.fog(2.0 / thickness, thickness, phase=skyfit.HenyeyGreenstein(0.85))
    air = HAZY.replace(fog=fog)
    assert air.names == ("rayleigh", "aerosol", "ozone", "fog")
    up = skyfit.Directions.from_degrees([0.0, 45.0, 75.0, 85.0, 45.0, 75.0, 85.0], [45.0] * 4 + [150.0] * 3)
    scene = skyfit.Scene.from_degrees(50.0, up, ONE)
    found = Spherical.normal().radiance(air, scene)
    np.testing.assert_allclose(found, OrdersOfScattering.fine("flat").radiance(air, scene), rtol=0.03)


def test_fog_whose_height_is_traced_is_warned_of():
    """Shapes alone: nothing is solved."""
    fog = HAZY.replace(fog=skyfit.Droplets.fog(0.02, 100.0))
    scene = skyfit.Scene.from_degrees(50.0, skyfit.Directions.from_degrees([45.0], [150.0]), ONE)
    for air, solver, warned in ((fog, SMALL, True), (HAZY, SMALL, False), (fog, replace(SMALL, near=30.0), False)):
        with pytest.warns(ThickAirWarning, match="if they are fog") if warned else nullcontext():
            jax.eval_shape(solver.radiance, air, scene)


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ({"distance": np.ones((3, 3))}, "`distance` must have the camera's 4 rows and 6 columns"),
        ({"distance": -SKY}, "`distance` must be at least 0 m"),
        ({"solver": OrdersOfScattering.normal()}, "`solver` must be Spherical or SingleScattering"),
        ({"solver": SingleScattering.normal("flat")}, "`solver` must be Spherical or SingleScattering"),
        ({"solver": SingleScattering.normal(), "lit": [(SKY, SKY)]}, "`lit` must come with Spherical"),
        ({"sun_zenith": np.radians(120.0)}, "`sun_zenith` must be between"),
    ],
)
def test_what_no_air_is_known_for_is_refused(told, said):
    asked = {"distance": SKY, "camera": CAMERA, "atmosphere": HAZY, "solver": SMALL, "sun_zenith": 1.0}
    with pytest.raises(ValueError, match=said):
        skyfit.air_to(**asked | told)
