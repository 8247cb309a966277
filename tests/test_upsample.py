"""Upsampling against the solver itself in every direction, and its estimate of its own error."""

import importlib
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from skies import hazy, slow, unit_scene, views

import skyfit
from skyfit import OrdersOfScattering, SingleScattering, upsample
from skyfit.atmosphere import Exponential, HenyeyGreenstein, Prescribed
from skyfit.transport import AbstractSolver, Observers, Suns


# what is held here is each integral itself, not how far its sky may be off under a low sun
pytestmark = pytest.mark.filterwarnings("ignore::skyfit.LowSunWarning")

# the package has the function under the same name
upsampling = importlib.import_module("skyfit.transport.upsample")
WAVELENGTHS = np.array([400.0, 550.0, 800.0])
SOLVERS = {
    "single": SingleScattering.draft(),
    "single flat": SingleScattering.draft("flat"),
    "orders": OrdersOfScattering.draft(),
    "orders flat": OrdersOfScattering.draft("flat"),
}
SUNS, HAZES = (20.0, 60.0, 80.0, 85.0), (0.05, 0.4)


def dome(count, seed=0, edge=90.0):
    """Directions over the sky, a third of them low."""
    random = np.random.default_rng(seed)
    zenith = np.arccos(random.uniform(np.cos(np.radians(edge)), 1.0, count))
    zenith[: count // 3] = np.radians(np.linspace(75.0, edge, count // 3))
    return skyfit.Directions(zenith, random.uniform(0.0, 2.0 * np.pi, count))


def scene_of(sun, view):
    return skyfit.Scene.from_degrees(sun, view, WAVELENGTHS, sun_azimuth=30.0)


PROGRAMS = {}


def skies_of(name, atmosphere, sun, view, **grid):
    """The upsampled sky and the solver's own; at most 400 directions, one program for each solver and grid."""
    key = name, jnp.result_type(float), *grid.values()
    if key not in PROGRAMS:

        def both(atmosphere, scene):
            return upsample(SOLVERS[name], atmosphere, scene, **grid), SOLVERS[name].radiance(atmosphere, scene)

        PROGRAMS[key] = jax.jit(both)
    count = view.zenith.shape[0]
    padded = (np.pad(np.asarray(v), (0, 400 - count), "edge") for v in (view.zenith, view.azimuth))
    atmosphere = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), atmosphere)
    sky, direct = PROGRAMS[key](atmosphere, scene_of(sun, skyfit.Directions(*padded)))
    return tuple(np.asarray(v)[:count] for v in (sky.radiance, sky.error, direct))


def compare(name, sun, haze, view, **grid):
    """Relative error and its estimate."""
    radiance, estimate, direct = skies_of(name, skyfit.Atmosphere.from_optical_depth(haze), sun, view, **grid)
    return np.abs(radiance / direct - 1.0), estimate


@pytest.mark.parametrize("name", ["single", "single flat", slow("orders"), slow("orders flat")])
def test_skies_are_met_and_the_estimate_bounds_the_error(name, x64):
    view = dome(400, edge=88.0 if "flat" in name else 90.0)
    low = np.degrees(view.zenith) <= 85.0
    for sun in SUNS:
        for haze in HAZES:
            error, estimate = compare(name, sun, haze, view)
            assert error[low].max() < 0.01, (sun, haze)
            assert np.median(error) < 2e-4, (sun, haze)
            assert np.mean(error <= estimate) >= 0.95, (sun, haze)
            # a bound that says nothing would be no estimate
            assert np.median(estimate) < 2e-3, (sun, haze)


def test_a_grid_too_coarse_says_so(x64):
    """Few nodes under a low sun: errors of some per cent, and an estimate of that size, though not a bound."""
    error, estimate = compare("single flat", 80.0, 0.4, dome(400, edge=88.0), zeniths=6, azimuths=6)
    assert error.max() > 0.02
    assert np.mean(error <= 2.0 * estimate) >= 0.95
    assert estimate.max() < 1.0


class Harmonics(AbstractSolver):
    """A made-up sky whose log is a sum of low harmonics, which counts the directions that it is asked for."""

    geometry: str = "spherical"
    asked: ClassVar[list] = []

    def radiance(self, atmosphere, scene):
        zenith, azimuth = scene.view.zenith, scene.view.azimuth - scene.sun_azimuth
        self.asked.append(zenith.shape[0])
        log = jnp.cos(zenith) + 0.7 * jnp.sin(zenith) * jnp.cos(azimuth) + jnp.sin(zenith) ** 3 * jnp.cos(3.0 * azimuth)
        return jnp.exp(log)[:, None] * scene.solar_irradiance[None]

    def fluxes(self, atmosphere, scene):
        raise NotImplementedError

    @property
    def suns(self):
        return Suns(180.0)

    @property
    def observers(self):
        return Observers(0.0)

    @property
    def model_error(self):
        return 0.0

    def coarser(self):
        return self


def test_a_smooth_sky_is_interpolated_to_rounding_from_half_its_grid(x64):
    isotropic = Prescribed(jnp.ones(3), Exponential(8000.0), HenyeyGreenstein(0.0))
    scene = scene_of(50.0, dome(500))
    atmosphere = skyfit.Atmosphere(isotropic, None, None)
    few = upsample(Harmonics(), atmosphere, scene, zeniths=10, azimuths=6)
    many = upsample(Harmonics(), atmosphere, scene, zeniths=22, azimuths=6)
    assert Harmonics.asked == [60, 132]
    truth = np.asarray(Harmonics().radiance(atmosphere, scene))
    assert np.abs(np.asarray(few.radiance) / truth - 1.0).max() < 1e-4
    assert np.abs(np.asarray(many.radiance) / truth - 1.0).max() < 1e-9
    assert np.asarray(many.error).max() < 1e-5


@pytest.mark.parametrize("name", ["single", "single flat"])
def test_black_skies_and_the_ground_are_black_without_error(name, x64):
    view = views([0.0, 60.0, 87.0, 91.0, 180.0], [0.0, 90.0])
    below = np.degrees(view.zenith) > 90.0
    for sun in (60.0, 95.0):
        radiance, error, direct = skies_of(name, hazy(), sun, view)
        black = (direct == 0.0).all(axis=1)
        assert (black == (below | (sun > 90.0 and "flat" in name))).all()
        assert (radiance[black] == 0.0).all() and (error[black] == 0.0).all()
        assert (radiance[~black] > 0.0).all() and (error[~black] > 0.0).all()


def test_an_air_that_scatters_nothing_is_black():
    for atmosphere in (skyfit.Atmosphere(None), skyfit.Atmosphere(None, None, None)):
        sky = upsample(SOLVERS["single"], atmosphere, scene_of(40.0, dome(5)))
        assert (np.asarray(sky.radiance) == 0.0).all() and (np.asarray(sky.error) == 0.0).all()


def test_sun_and_views_at_the_zenith_agree_with_the_solver(x64):
    """The zenith is one direction, whatever its azimuth, and left is as right."""
    view = views([0.0, 1e-7, 40.0], [30.0, 75.0, 345.0])
    for sun in (0.0, 1e-7, 50.0):
        error, estimate = compare("single", sun, 0.1, view)
        assert error.max() < 1e-4 and np.isfinite(estimate).all()
        sky = skies_of("single", hazy(), sun, view)[0].reshape(3, 3, -1)
        np.testing.assert_allclose(sky[0], np.broadcast_to(sky[0, :1], sky[0].shape), rtol=1e-6)
        np.testing.assert_allclose(sky[:, 1], sky[:, 2], rtol=1e-9)


def test_beyond_the_edge_of_a_flat_grid_nothing_is_claimed(x64):
    radiance, error, _ = skies_of("single flat", hazy(), 40.0, views([87.9, 88.5, 90.0], [0.0]))
    assert error[0].max() < 0.01 and (error[1:] == 1.0).all()
    assert np.isfinite(radiance).all()


def brightness(sky, leaves):
    """A function of the atmosphere's and the scene's numbers, and weights that no symmetry cancels."""
    weight = np.random.default_rng(1).uniform(0.5, 1.5, leaves)
    return lambda *numbers: jnp.sum(sky(*numbers) * weight)


@pytest.mark.parametrize("name", ["single flat", slow("single"), slow("orders")])
def test_gradients_are_the_solvers(name, x64):
    """To the error of interpolation, over the atmosphere, the sun and the views.

    By the views' own angles orders ripple with their last modes, near the sun by 1.6 % of the largest slope.
    """
    view = dome(30, edge=88.0 if "flat" in name else 90.0)

    def direct(atmosphere, sun, zenith, azimuth):
        scene = skyfit.Scene(sun, 0.3, skyfit.Directions(zenith, azimuth), WAVELENGTHS, jnp.ones(3))
        return SOLVERS[name].radiance(atmosphere, scene)

    def few(atmosphere, sun, zenith, azimuth):
        scene = skyfit.Scene(sun, 0.3, skyfit.Directions(zenith, azimuth), WAVELENGTHS, jnp.ones(3))
        return upsample(SOLVERS[name], atmosphere, scene).radiance

    numbers = hazy(), jnp.asarray(np.radians(55.0)), view.zenith, view.azimuth

    def gradient(sky):
        slope = jax.grad(brightness(sky, (30, 3)), argnums=(0, 1, 2, 3))
        return jax.jit(slope)(*numbers)

    got, wanted = gradient(few), gradient(direct)
    for mine, theirs in zip(jax.tree.leaves(got), jax.tree.leaves(wanted), strict=True):
        mine, theirs = np.asarray(mine), np.asarray(theirs)
        tolerance = 2e-2 if name == "orders" and theirs.ndim else 2e-3
        np.testing.assert_allclose(mine, theirs, atol=tolerance * np.abs(theirs).max() + 1e-12)


HARD = {
    "plain": hazy(),
    "no depth": hazy(pressure=0.0, haze=0.0, ozone=0.0),
    "almost no depth": hazy(pressure=0.0, haze=1e-12),
    "thick": hazy(haze=50.0),
    "forward": hazy(asymmetry=0.999),
    "backward": hazy(asymmetry=-0.9),
    "black haze": hazy(albedo=0.0),
    "white ground": hazy(albedo=1.0, ground=1.0),
}


@pytest.mark.parametrize("precision", ["float32", slow("float64")])
@pytest.mark.parametrize("name", ["single flat", slow("single")])
def test_values_and_gradients_are_finite_everywhere(name, precision):
    with jax.enable_x64(precision == "float64"):
        view = views([0.0, 55.0, 89.999, 90.0, 90.001, 120.0], [0.0, 180.0])

        def total(atmosphere, sun, zenith, azimuth):
            scene = skyfit.Scene(sun, 0.0, skyfit.Directions(zenith, azimuth), WAVELENGTHS, jnp.ones(3))
            sky = upsample(SOLVERS[name], atmosphere, scene, zeniths=6, azimuths=6)
            return jnp.sum(sky.radiance) + jnp.sum(sky.error)

        both = jax.jit(jax.value_and_grad(total, argnums=(0, 1, 2, 3)))
        for key, atmosphere in HARD.items():
            atmosphere = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), atmosphere)
            for sun in (0.0, 55.0, 89.999, 90.0, 90.001, 93.0, 100.0):
                leaves = jax.tree.leaves(both(atmosphere, jnp.deg2rad(sun), view.zenith, view.azimuth))
                assert all(np.isfinite(leaf).all() for leaf in leaves), (key, sun)


def test_batches_and_precisions_agree():
    def sky(sun):
        scene = unit_scene(jnp.rad2deg(sun), dome(20, edge=88.0), WAVELENGTHS)
        return upsample(SOLVERS["single flat"], hazy(), scene, zeniths=8, azimuths=6)

    suns = jnp.asarray([0.3, 1.2])
    together, single = (jax.jit(f) for f in (jax.vmap(sky), sky))
    together = together(suns)
    for i in range(2):
        alone = single(suns[i])
        for mine, theirs in zip(alone, together, strict=True):
            np.testing.assert_allclose(mine, theirs[i], rtol=1e-4, atol=1e-5)
    with jax.enable_x64(True):
        exact = jax.jit(sky)(jnp.asarray(suns[0], float))
        np.testing.assert_allclose(together.radiance[0], exact.radiance, rtol=5e-5)


def test_many_directions_are_served_in_pieces(monkeypatch):
    """As one piece would; a million of them, and their gradient, within a gigabyte."""
    view = dome(70, edge=87.9)

    def total(haze, zenith):
        scene = unit_scene(50.0, skyfit.Directions(zenith, view.azimuth), WAVELENGTHS)
        sky = upsample(SOLVERS["single flat"], hazy(haze=haze), scene, zeniths=6, azimuths=4)
        return jnp.sum(sky.radiance * jnp.arange(1.0, 71.0)[:, None]), sky

    def both():
        program = jax.jit(jax.value_and_grad(total, argnums=(0, 1), has_aux=True))
        return program(jnp.asarray(0.2), view.zenith)

    whole = both()
    monkeypatch.setattr(upsampling, "_CHUNK", 32)
    jax.clear_caches()
    pieces = both()
    # the estimate has kinks
    np.testing.assert_allclose(pieces[0][1].error, whole[0][1].error, rtol=1e-2)
    exact = [jax.tree.leaves((total, sky.radiance, slopes)) for (total, sky), slopes in (pieces, whole)]
    for mine, theirs in zip(*exact, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-4, atol=1e-5 * np.abs(theirs).max())
    monkeypatch.undo()

    def many(zenith):
        scene = unit_scene(50.0, skyfit.Directions(zenith, jnp.zeros_like(zenith)), np.linspace(400.0, 700.0, 16))
        return jnp.sum(upsample(SOLVERS["single flat"], hazy(), scene).radiance)

    million = jax.ShapeDtypeStruct((1_000_000,), jnp.float32)
    for function in (many, jax.grad(many)):
        program = jax.jit(function).lower(million).compile()
        assert program.memory_analysis().temp_size_in_bytes < 1e9


def test_what_cannot_be_upsampled_is_refused():
    with pytest.raises(ValueError, match="`zeniths`"):
        upsample(SOLVERS["single"], hazy(), scene_of(40.0, dome(5)), zeniths=3)
    scene = skyfit.Scene.from_degrees(40.0, dome(5), WAVELENGTHS, height=100.0)
    with pytest.raises(ValueError, match="`height`"):
        upsample(SOLVERS["single"], hazy(), scene)
