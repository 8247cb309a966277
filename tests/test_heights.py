"""All orders of scattering seen from any height of flat air: Monte Carlo, discrete ordinates, limits, slopes."""

import importlib
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from skies import (
    COLOURS,
    forward_of,
    haze_over_air,
    hazy,
    ONE,
    reverse_of,
    slow,
    SMALL,
    SOLVERS,
    unit_scene,
    views,
    weights_of,
)

import skyfit
from skyfit.atmosphere import Exponential, Ground, HenyeyGreenstein, Layered, Prescribed, RayleighPhase
from skyfit.transport import Observers, OrdersOfScattering


FEW = replace(SMALL["flat"], polarised=True)
# degrees: up, along the horizon's two sides, down
ZENITH, AZIMUTH = (v.ravel() for v in np.meshgrid([0.0, 40.0, 75.0, 85.0, 95.0, 110.0, 150.0, 180.0], [20.0, 140.0]))
UP = ZENITH < 90.0
TOP = 100e3


PROGRAMS = {}


def light(solver, atmosphere, height, sun_deg=50.0, zenith_deg=ZENITH, azimuth_deg=AZIMUTH):
    """I, Q, U `[component, direction, wavelength]` per unit irradiance, azimuths from the sun's; one program for all.

    At one wavelength where the ground is given by wavelength, at four else.
    """

    def seen(atmosphere, height, sun, zenith, azimuth):
        wavelength = jnp.asarray(COLOURS if atmosphere.ground.albedo.ndim == 0 else ONE, float)
        view, bright = skyfit.Directions(zenith, azimuth + 0.3), jnp.ones_like(wavelength)
        scene = skyfit.Scene(sun, 0.3, view, wavelength, bright, height)
        if not solver.polarised:
            return solver.radiance(atmosphere, scene)[None]
        found = solver.stokes(atmosphere, scene)
        return jnp.stack([found.radiance, found.q, found.u])

    program = PROGRAMS.setdefault((solver, jnp.result_type(float)), jax.jit(seen))
    sun, zenith, azimuth = (jnp.asarray(np.radians(v), float) for v in (sun_deg, zenith_deg, azimuth_deg))
    height = None if height is None else jnp.asarray(height, float)
    atmosphere = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), atmosphere)
    return np.asarray(program(atmosphere, height, sun, zenith, azimuth))


def one_colour(atmosphere, albedo):
    """With a ground that is given by wavelength, so that `light` takes the one of a prescribed constituent."""
    return atmosphere.replace(ground=Ground(np.array([albedo])))


# --- against other solvers


@pytest.mark.parametrize("case", [slow("a1"), "a2", slow("a3"), slow("b1"), "b2"])
def test_polarised_light_is_that_of_mystic_at_every_height(x64, shared, case):
    """Every eleventh point of each observer; all of them in experiments/validation/iprt.py."""
    iprt = importlib.import_module("experiments.validation.iprt")
    folder = shared / "oracles" / "iprt"
    if not folder.is_dir():
        pytest.skip("../shared/oracles/iprt is absent: it holds the results of MYSTIC, which are not shipped")
    solver, heights = OrdersOfScattering.fine("flat", polarised=True), set()
    for group in iprt.groups(folder / f"{case}.npz"):
        few = group._replace(
            zenith=group.zenith[::11], azimuth=group.azimuth[::11],
            stokes=group.stokes[:, ::11], sigma=group.sigma[:, ::11],
        )  # fmt: skip
        air = iprt.atmosphere(case, folder, group.depolarisation)
        record = iprt.compared(iprt.simulated(solver, air, iprt.WAVELENGTH_NM[case], few), few)
        for name in "IQU":
            # of some sixty to a hundred points
            assert record[name]["z rms"] < 1.35 and record[name]["within"] == 1.0, (group[:5], name, record)
        heights.add((group.height, group.up))
    assert len(heights) == (2 if case.startswith("a") else 4)


@pytest.mark.parametrize("albedo", [0.0, 0.6])
def test_light_within_a_layer_is_that_of_discrete_ordinates(x64, albedo):
    """PythonicDISORT at its own nodes, at four depths, over a black and a bright ground."""
    pydisort = pytest.importorskip("PythonicDISORT.pydisort", reason="PythonicDISORT is absent").pydisort
    depth, single, asymmetry, sun = 0.8, 0.9, 0.4, 0.6
    levels = np.array([1e-6, 0.1, 0.45, 0.8])
    azimuth = np.radians([0.0, 70.0, 180.0])
    cosine, *_, field = pydisort(
        depth, single, 32, asymmetry ** np.arange(33.0)[None], sun, 1.0, 0.0, BDRF_Fourier_modes=[albedo]
    )
    kept = np.abs(cosine) > 0.1
    # theirs are cosines of the light's way up
    zenith = np.degrees(np.arccos(-cosine[kept]))
    places = np.meshgrid(zenith, np.degrees(azimuth), indexing="ij")
    haze = Prescribed(np.array([depth]), Exponential(8000.0), HenyeyGreenstein(asymmetry, 0.0), single)
    atmosphere, solver = skyfit.Atmosphere(None, haze, None), OrdersOfScattering.fine("flat")
    for level in levels:
        height = max(-8000.0 * np.log(level / depth), 0.0)
        found = light(
            solver, one_colour(atmosphere, albedo), height, np.degrees(np.arccos(sun)), *(p.ravel() for p in places)
        )
        expected = np.stack([field(np.array([level]), turn)[kept].reshape(-1) for turn in azimuth], axis=1)
        # views up from the top see nothing
        np.testing.assert_allclose(found[0, :, 0].reshape(expected.shape), expected, rtol=5e-4, atol=1e-6)


# --- limits


@pytest.mark.parametrize("albedo", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("sun_deg", [20.0, 70.0])
def test_what_leaves_the_top_of_air_is_what_the_ground_does_not_keep(x64, albedo, sun_deg):
    """Nothing is absorbed above: the upward radiance over the hemisphere is the flux that is known, and all that is."""
    x, weight = np.polynomial.legendre.leggauss(16)
    mu = 0.5 * (x + 1.0)
    turns = np.arange(0.0, 360.0, 30.0)
    zenith, azimuth = (v.ravel() for v in np.meshgrid(180.0 - np.degrees(np.arccos(mu)), turns, indexing="ij"))
    atmosphere, solver = haze_over_air(0.4, 0.3, 0.5, 1.0, albedo), OrdersOfScattering(8, 8, 40, 10, 32, 0, "flat")
    fluxes = solver.fluxes(atmosphere, unit_scene(sun_deg, views([0.0], [0.0])))
    found = light(solver, one_colour(atmosphere, albedo), TOP, sun_deg, zenith, azimuth)
    upward = np.pi * (weight * mu) @ found[0, :, 0].reshape(16, -1).mean(axis=1)
    kept = (1.0 - albedo) * float(fluxes.direct[0] + fluxes.diffuse_down[0])
    assert upward == pytest.approx(float(fluxes.up_at_top[0]), rel=1e-3)
    assert upward == pytest.approx(np.cos(np.radians(sun_deg)) - kept, rel=1e-3)


@pytest.mark.parametrize("height", [0.0, 3e3, TOP])
def test_without_air_there_is_the_ground_alone(x64, height):
    """Clear, with thin air, and behind gas that scatters nothing."""
    expected = np.where(UP, 0.0, 0.4 * np.cos(np.radians(50.0)) / np.pi)
    clear = light(FEW, skyfit.Atmosphere(None, None, None, Ground(0.4)), height)
    np.testing.assert_allclose(
        clear, np.stack([expected, 0 * expected, 0 * expected])[..., None] + np.zeros(4), rtol=1e-9
    )
    thin = light(FEW, one_colour(haze_over_air(1e-7, 1e-7), 0.4), height)
    np.testing.assert_allclose(thin[0, :, 0], expected, atol=1e-6)
    gas = Prescribed(np.array([0.5]), Exponential(5e3))
    filtered = light(FEW, one_colour(skyfit.Atmosphere(None, None, gas), 0.4), height)
    ways = 1.0 / np.cos(np.radians(50.0)) + (1.0 - np.exp(-height / 5e3)) / np.abs(np.cos(np.radians(ZENITH)))
    np.testing.assert_allclose(filtered[0, :, 0], expected * np.exp(-0.5 * ways), rtol=1e-9)
    # as the limit of air that hardly scatters
    nearly = light(FEW, one_colour(skyfit.Atmosphere(None, None, gas, air=thin_air()), 0.4), height)
    np.testing.assert_allclose(nearly[0, :, 0], filtered[0, :, 0], atol=1e-6)


def thin_air():
    return Prescribed(np.array([1e-7]), Exponential(5e3), RayleighPhase(0.0))


@pytest.mark.parametrize(
    "wide, solver",
    [
        (True, FEW), (False, FEW), slow(True, SMALL["flat"]), slow(False, SMALL["flat"]),
        slow(True, OrdersOfScattering.draft("flat", polarised=True)),
    ],
)  # fmt: skip
def test_the_observer_at_the_bottom_is_the_observer_on_the_ground(wide, solver):
    with jax.enable_x64(wide):
        for sun in (0.0, 70.0):
            ground, bottom = (light(solver, hazy(), height, sun) for height in (None, 0.0))
            np.testing.assert_allclose(bottom[:, UP], ground[:, UP], rtol=1e-10 if wide else 2e-5, atol=1e-7)
            np.testing.assert_array_equal(ground[:, ~UP], 0.0)
            # what lies under the eye is the ground, of one brightness
            np.testing.assert_allclose(bottom[0, ~UP] / bottom[0, -1:], 1.0, rtol=1e-9 if wide else 1e-5)


def test_the_ground_under_the_eye_has_the_upward_flux(x64):
    scene = unit_scene(50.0, views([180.0], [0.0]), COLOURS)
    every = replace(SMALL["flat"], spectral_nodes=0)
    fluxes, bottom = every.fluxes(hazy(), scene), light(every, hazy(), 0.0)
    np.testing.assert_allclose(np.pi * bottom[0, -1], fluxes.up, rtol=1e-9)


STACK = Layered([0.0, 1000.0, 2500.0, 9000.0], [0.6, 0.1, 0.3])


@pytest.mark.parametrize("profile", [STACK, Exponential(3000.0)], ids=["layers", "exponential"])
def test_light_is_continuous_in_height(x64, profile):
    """Across the edges of layers, of the solver's own too: a centimetre changes what a centimetre can, no more."""
    haze = Prescribed(np.array([0.5]), profile, HenyeyGreenstein(0.6), 0.9)
    atmosphere = one_colour(skyfit.Atmosphere(None, haze, None), 0.3)
    edges = np.asarray(STACK.edges)[1:] if profile is STACK else -3000.0 * np.log(np.arange(1, 8) / 8.0)
    for edge in edges:
        below, at, above = (light(FEW, atmosphere, edge + step) for step in (-0.01, 0.0, 0.01))
        # half an optical depth in 3 km, seen through twelve of them
        assert np.max(np.abs(above - below)) < 1e-4 * np.max(below[0])
        assert np.all(np.abs(at - 0.5 * (above + below)) < 1e-4 * np.max(below[0]))


def test_light_is_never_negative_and_always_finite(x64):
    for atmosphere in (one_colour(haze_over_air(0.3, 1.0, 0.8), 0.0), one_colour(haze_over_air(0.1, 50.0), 0.5)):
        for height in (0.0, 10.0, 1e3, 1e4, 5e4, TOP, 4e5):
            for sun in (0.0, 80.0):
                found = light(FEW, atmosphere, height, sun)
                assert np.all(np.isfinite(found)) and np.all(found[0] >= -1e-9 * np.max(found[0]))
                assert np.all(np.hypot(found[1], found[2]) <= found[0] * (1.0 + 1e-6) + 1e-9)


def test_views_up_from_space_are_black_and_down_they_do_not_change(x64):
    low, high = (light(FEW, hazy(), height) for height in (2e5, 1e8))
    assert np.all(high[:, UP] == 0.0) and np.max(np.abs(low[:, UP])) < 1e-10
    np.testing.assert_allclose(high[:, ~UP], low[:, ~UP], rtol=1e-8, atol=1e-10)


@pytest.mark.slow
def test_few_wavelengths_do_aloft(x64):
    """Also of views up from on high, which have a millionth of the light."""
    wavelength = np.linspace(380.0, 780.0, 41)
    solver = OrdersOfScattering(6, 6, 40, 5, 16, geometry="flat")
    view = skyfit.Directions.from_degrees(ZENITH, AZIMUTH)
    atmosphere = skyfit.Atmosphere.from_turbidity(3.0)
    for height in (0.0, 1e4, 6e4):
        scene = replace(unit_scene(60.0, view, wavelength), height=jnp.asarray(height))
        few, every = (np.asarray(replace(solver, spectral_nodes=n).radiance(atmosphere, scene)) for n in (None, 0))
        np.testing.assert_allclose(few, every, rtol=2e-3)


# --- layers and matrices that are given


def test_layers_given_one_by_one_are_those_of_each_wavelength_alone(x64):
    edges, depth = [0.0, 1e3, 3e3, 12e3], np.array([[0.2, 0.05], [0.1, 0.1], [0.02, 0.15]])
    parts = Prescribed.by_layer(edges, depth, RayleighPhase(0.03))
    together = skyfit.Atmosphere(None, None, None, Ground(0.2), **{f"air_{i}": part for i, part in enumerate(parts)})
    view = skyfit.Directions.from_degrees([30.0, 120.0], [0.0, 0.0])
    scene = replace(unit_scene(40.0, view, np.array([400.0, 500.0])), height=jnp.asarray(2e3))
    found = np.asarray(SMALL["flat"].radiance(together, scene))
    for i, nm in enumerate((400.0, 500.0)):
        (alone,) = Prescribed.by_layer(edges, depth[:, i : i + 1], RayleighPhase(0.03))
        np.testing.assert_allclose(
            alone.profile.column_above(jnp.asarray([1e3])), depth[1:, i].sum() / depth[:, i].sum()
        )
        one = replace(unit_scene(40.0, view, np.array([nm])), height=jnp.asarray(2e3))
        expected = SMALL["flat"].radiance(skyfit.Atmosphere(alone, None, None, Ground(0.2)), one)
        # their solver's levels lie elsewhere
        np.testing.assert_allclose(found[:, i], expected[:, 0], rtol=5e-3)


def test_layers_of_another_shape_are_refused_and_empty_columns_are_none():
    with pytest.raises(ValueError, match=r"`optical_depth` must be of \[layer, wavelength\] .* got \(3,\) and \(4,\)"):
        Prescribed.by_layer([0.0, 1.0, 2.0, 3.0], [0.1, 0.1, 0.1])
    with pytest.raises(ValueError, match="`edges` have one entry more than layers"):
        Prescribed.by_layer([0.0, 1.0], np.ones((2, 1)))
    (empty,) = Prescribed.by_layer([0.0, 1e3, 2e3], np.zeros((2, 1)))
    assert float(empty.optical_depth[0]) == 0.0 and np.all(
        np.isfinite(empty.profile.column_above(jnp.asarray([500.0])))
    )


# --- transforms, slopes, dtypes


def test_a_batch_of_heights_is_a_loop_and_compiles_once(x64):
    heights = jnp.array([0.0, 700.0, 5e3, 3e4])
    sky = jax.jit(lambda h: light_of(hazy(), h))
    loop = np.stack([sky(h) for h in heights])
    assert sky._cache_size() == 1
    batch = jax.jit(jax.vmap(lambda h: light_of(hazy(), h)))
    np.testing.assert_allclose(batch(heights), loop, rtol=1e-9, atol=1e-13)


@pytest.mark.slow
def test_without_jit_the_light_is_the_same(x64):
    with jax.disable_jit():
        eager = light_of(hazy(), jnp.asarray(700.0))
    np.testing.assert_allclose(eager, jax.jit(light_of)(hazy(), jnp.asarray(700.0)), rtol=1e-9, atol=1e-13)


def light_of(atmosphere, height, sun=0.9, solver=FEW):
    view = skyfit.Directions(np.radians(ZENITH), np.radians(AZIMUTH))
    scene = skyfit.Scene(sun, 0.3, view, COLOURS[:2], jnp.ones(2), height)
    if not solver.polarised:
        return solver.radiance(atmosphere, scene)[None]
    found = solver.stokes(atmosphere, scene)
    return jnp.stack([found.radiance, found.q, found.u])


@pytest.mark.parametrize("solver, height", [(SMALL["flat"], 800.0), slow(FEW, 0.0), slow(FEW, 800.0), slow(FEW, 2e4)])
def test_slopes_are_central_differences(x64, solver, height):
    """By height, sun and every leaf of the atmosphere, forward and reverse."""
    start = hazy(), jnp.asarray(height), jnp.asarray(0.9)
    leaves, tree = jax.tree.flatten(start)
    flat = jnp.stack(leaves)
    # the height in kilometres
    scale = jnp.maximum(jnp.abs(flat), 0.05).at[len(leaves) - 2].set(1e3)

    def field(relative):
        return light_of(*jax.tree.unflatten(tree, list(flat + relative * scale)), solver)

    # an observer does not stand in the ground
    moved = np.delete(np.arange(len(leaves)), [] if height > 0.0 else [len(leaves) - 2])
    around, forward = forward_of(field, len(leaves), moved=moved)
    central, largest = (around[0] - around[1]) / 2e-5, float(np.max(np.abs(around)))
    assert np.all(np.isfinite(forward))
    np.testing.assert_allclose(forward[moved], central, atol=1e-5 * largest)
    weight = weights_of(central[0])
    backward = reverse_of(field, len(leaves), weight)
    np.testing.assert_allclose(backward, np.tensordot(forward, weight, weight.ndim), atol=1e-8 * largest * weight.size)


def test_slopes_by_the_view_are_finite_everywhere():
    zenith = jnp.asarray(np.radians([0.0, 50.0, 89.9, 90.0, 90.1, 130.0, 180.0]), float)

    def total(zenith, height):
        scene = skyfit.Scene(zenith[1], 0.3, skyfit.Directions(zenith, jnp.full(7, 0.3)), ONE, jnp.ones(1), height)
        found = FEW.stokes(haze_over_air(0.1, 0.2), scene)
        return jnp.sum(found.radiance) + jnp.sum(found.q) + jnp.sum(found.u)

    slope = jax.jit(jax.grad(total, argnums=(0, 1)))
    for height in (0.0, 1e3, 4e5):
        assert all(np.all(np.isfinite(v)) for v in slope(zenith, jnp.asarray(height)))


def test_float32_aloft_is_near_float64():
    for height in (0.0, 2e3, TOP):
        single = light(FEW, hazy(), height)
        assert single.dtype == np.float32
        with jax.enable_x64(True):
            double = light(FEW, hazy(), height)
        assert np.max(np.abs(single - double) / np.max(double[0])) < 3e-5


# --- what solvers say of observers


def test_solvers_say_which_observers_they_know_and_refuse_others_in_a_line():
    scene = replace(unit_scene(40.0, views([10.0], [0.0])), height=jnp.asarray(1e3))
    for name, solver in SOLVERS.items():
        anywhere = name in ("orders flat", "single flat", "single spherical", "sphere spherical")
        assert solver.observers == Observers(np.inf if anywhere else 0.0), name
        if anywhere:
            assert np.all(np.isfinite(solver.radiance(haze_over_air(0.1, 0.1), scene)))
            continue
        kind = type(solver).__name__
        expected = f"^`height` of the scene must be None for {kind} in {solver.geometry} geometry: [^\n]* ground only$"
        for call in (solver.radiance, solver.fluxes):
            with pytest.raises(ValueError, match=expected):
                call(haze_over_air(0.1, 0.1), scene)


def test_fluxes_are_those_on_the_ground_from_everywhere():
    view = views([10.0], [0.0])
    here, aloft = (
        SMALL["flat"].fluxes(hazy(), replace(unit_scene(40.0, view, COLOURS), height=h))
        for h in (None, jnp.asarray(5e3))
    )
    for one, other in zip(here, aloft, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6)
