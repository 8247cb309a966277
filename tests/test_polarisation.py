"""Polarised multiple scattering against tables, another solver and light scattered once; limits, symmetries, slopes."""

from dataclasses import replace
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from foreign_skies import directions, sasktran2_stokes, Truth, WAVELENGTH_NM
from skies import (
    forward_of,
    haze_over_air,
    hazy,
    names_of,
    ONE,
    phase_functions,
    reverse_of,
    slow,
    SMALL,
    unit_scene,
    views,
    weights_of,
)
from vector_skies import (
    air_once,
    ALBEDOS,
    frame,
    natraj,
    natraj_air,
    natraj_views,
    polarised_by_air,
    scattered_once,
    SUN_COSINES,
)

import skyfit
from skyfit.atmosphere import Exponential, Ground, HenyeyGreenstein, Ozone, Prescribed, RayleighPhase
from skyfit.transport import Stokes


# flat air against tables and solvers of flat air, under low suns too
pytestmark = pytest.mark.filterwarnings("ignore::skyfit.LowSunWarning")
# degrees, of the sun: only differences of azimuth may count
SUN_AZIMUTH = 25.0
# stand for Natraj's seven depths
SEVEN = np.linspace(400.0, 700.0, 7)
FEW = {geometry: replace(solver, polarised=True) for geometry, solver in SMALL.items()}
GEOMETRIES = ("flat", "spherical")
TWO = np.array([450.0, 650.0])


def solver_of(preset, geometry="flat"):
    return replace(getattr(skyfit.OrdersOfScattering, preset)(geometry), polarised=True)


def stokes_of(solver, atmosphere, sun_deg, zenith_deg, azimuth_deg, wavelength_nm) -> np.ndarray:
    """I, Q, U `[component, direction, wavelength]` per unit irradiance; azimuths from the sun's."""
    view = skyfit.Directions(np.radians(zenith_deg), np.radians(np.asarray(azimuth_deg) + SUN_AZIMUTH))
    scene = skyfit.Scene.from_degrees(sun_deg, view, wavelength_nm, SUN_AZIMUTH, irradiance="unit")
    found = solver.stokes(atmosphere, scene)
    return np.stack([np.asarray(found.radiance), np.asarray(found.q), np.asarray(found.u)])


PROGRAMS = {}


def few_stokes(geometry, atmosphere, sun_deg, zenith_deg, azimuth_deg, wavelength_nm=ONE) -> Stokes:
    """The Stokes vectors by `FEW`, at most 24 directions: one program for many tests."""
    key = geometry, jnp.result_type(float)
    if key not in PROGRAMS:

        def sky(atmosphere, sun, zenith, azimuth, wavelength):
            view = skyfit.Directions(zenith, azimuth + jnp.deg2rad(SUN_AZIMUTH))
            scene = skyfit.Scene(sun, jnp.deg2rad(SUN_AZIMUTH), view, wavelength, jnp.ones_like(wavelength))
            return FEW[geometry].stokes(atmosphere, scene)

        PROGRAMS[key] = jax.jit(sky)
    zenith, azimuth = (np.ravel(v) for v in np.broadcast_arrays(zenith_deg, azimuth_deg))
    padded = (jnp.asarray(np.radians(np.pad(v, (0, 24 - len(v)), "edge")), float) for v in (zenith, azimuth))
    atmosphere = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), atmosphere)
    found = PROGRAMS[key](atmosphere, jnp.deg2rad(float(sun_deg)), *padded, jnp.asarray(wavelength_nm, float))
    return jax.tree.map(lambda part: np.asarray(part)[: len(zenith)], found)


def off(found, expected) -> np.ndarray:
    """Largest difference of I, Q and U, each over I."""
    return np.max(np.abs(found - expected) / expected[:1], axis=(1, 2))


# --- the oracles agree with one another


def test_the_tables_have_the_signs_that_are_stated(shared):
    """The rest of the difference is light scattered twice."""
    zenith, azimuth, kept = natraj_views(0.2)
    for place, sun in enumerate(SUN_COSINES):
        if sun < 0.4:
            continue
        table = natraj(shared / "oracles" / "natraj2009")[:, 0, place, kept, :, 0].reshape(3, -1)
        once = scattered_once(np.degrees(np.arccos(sun)), zenith, azimuth, 0.02, air_once, polarised_by_air)
        assert np.all(off(once[..., None], table[..., None]) < [0.07, 0.04, 0.04]), sun


@pytest.mark.parametrize("sun, albedo", [(0.6, 0.25), slow(0.1, 0.0), slow(0.92, 0.8)])
def test_sasktran2_has_the_tables(x64, shared, sun, albedo):
    """Default: at fewer streams, and where it is coarsest."""
    pytest.importorskip("sasktran2", reason="sasktran2 is absent")
    coarse = sun == 0.6
    zenith, azimuth, kept = natraj_views()
    settings = {"streams": 12, "layers": 60} if coarse else {"streams": 24, "layers": 240}
    sun_deg = np.degrees(np.arccos(sun))
    found = sasktran2_stokes(natraj_air(albedo, 1000.0), sun_deg, zenith, azimuth, SEVEN, polarised=True, **settings)
    table = natraj(shared / "oracles" / "natraj2009")[:, ALBEDOS.index(albedo), SUN_COSINES.index(sun), kept]
    assert np.all(off(found, table.reshape(3, -1, 7)) < (6e-3 if coarse else 1e-3))


@pytest.mark.parametrize("polarisation", [0.6, 0.0])
def test_sasktran2_has_the_haze_that_is_scattered_once(x64, polarisation):
    """Its coefficients are those of skyfit's haze, with their signs, its frame is ours, in the zenith too."""
    pytest.importorskip("sasktran2", reason="sasktran2 is absent")
    haze = Prescribed(np.array([1e-5]), Exponential(1000.0), HenyeyGreenstein(0.7, polarisation))
    zenith, azimuth = np.array([0.0, 0.0, 20.0, 50.0, 70.0, 80.0]), np.array([0.0, 30.0, 40.0, 120.0, -70.0, 10.0])
    atmosphere = skyfit.Atmosphere(None, haze, None, Ground(0.0))
    found = sasktran2_stokes(atmosphere, 50.0, zenith, azimuth, SEVEN[:1], polarised=True, streams=8, layers=60)
    assert np.all(off(found, hazy_once(1e-5, 50.0, zenith, azimuth, polarisation)[..., None]) < 3e-4)


def hazy_once(depth, sun_deg, zenith, azimuth, polarisation):
    """Henyey-Greenstein's haze, g = 0.7, polarised as air but to another degree."""

    def lobe(cosine):
        return phase_functions(cosine)[1]

    return scattered_once(sun_deg, zenith, azimuth, depth, lobe, lambda cosine: polarisation * polarised_by_air(cosine))


# --- the solver against them


@pytest.mark.parametrize("preset, limit", [("normal", 5e-3), slow("fine", 2e-3)])
def test_air_has_the_tables(x64, shared, preset, limit):
    """Radiance; Q and U within 0.5 % of it: depths 0.02 to 1, all albedos, azimuths and suns, cosines from 0.1."""
    solver = solver_of(preset)
    zenith, azimuth, kept = natraj_views()
    table = natraj(shared / "oracles" / "natraj2009")
    for (a, albedo), (s, sun) in product(enumerate(ALBEDOS), enumerate(SUN_COSINES)):
        found = stokes_of(solver, natraj_air(albedo), np.degrees(np.arccos(sun)), zenith, azimuth, SEVEN)
        errors = off(found, table[:, a, s, kept].reshape(3, -1, 7))
        assert np.all(errors < [limit, 5e-3, 5e-3]), (albedo, sun, errors)


LIMITS = {"normal": (3e-3, 5e-3, 5e-3), "fine": (1e-3, 1e-3, 1e-3)}


@pytest.mark.parametrize(
    "truth, presets",
    [
        (Truth(), ["normal"]),
        slow(Truth(), ["fine"]),
        slow(Truth(70.0, 0.6, 2.0, 0.8, 0.75, 0.05), LIMITS),
        slow(Truth(30.0, 0.1, 0.5, 0.98, 0.6, 0.5, polarisation=0.0), LIMITS),
        slow(
            Truth(60.0, 0.4, 1.0, 0.9, 0.7, 0.3, asymmetry_second=-0.1, forward_fraction=0.85, polarisation=0.8), LIMITS
        ),
    ],
)
def test_haze_has_the_stokes_vectors_of_sasktran2(x64, truth, presets):
    """Q and U of `normal` within the half per cent of the radiance that it has against the tables of air."""
    pytest.importorskip("sasktran2", reason="sasktran2 is absent")
    zenith, azimuth = directions(truth.sun_zenith_deg)
    # the default haze needs few streams
    streams = 16 if truth == Truth() else 24
    sky = truth.atmosphere(), truth.sun_zenith_deg, zenith, azimuth, WAVELENGTH_NM[::3]
    # within 2e-4 of 32 streams and 240 layers
    expected = sasktran2_stokes(*sky, polarised=True, streams=streams)
    for preset in presets:
        assert np.all(off(stokes_of(solver_of(preset), *sky), expected) < LIMITS[preset]), preset


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_thin_air_and_haze_scatter_once(x64, geometry):
    """Exactly; on a sphere as far as the air is flat."""
    zenith, azimuth = np.array([0.0, 10.0, 30.0, 50.0, 60.0, 75.0]), np.array([40.0, 5.0, -60.0, 0.0, 110.0, 180.0])
    found = np.stack(few_stokes(geometry, haze_over_air(1e-7, 0.0), 50.0, zenith, azimuth))
    air = scattered_once(50.0, zenith, azimuth, 1e-7, air_once, polarised_by_air)
    # the haze of `haze_over_air` has the default share and absorbs a tenth
    haze = 0.9 * hazy_once(1e-7, 50.0, zenith, azimuth, float(HenyeyGreenstein(0.7).polarisation))
    limit = 1e-5 if geometry == "flat" else 0.02
    assert np.all(off(found, air[..., None]) < limit)
    found = np.stack(few_stokes(geometry, haze_over_air(0.0, 1e-7), 50.0, zenith, azimuth))
    assert np.all(off(found, haze[..., None]) < limit)


def test_thin_air_vibrates_across_the_plane_of_the_sun(x64):
    """`angle` is from the vertical toward e_phi; `degree` is the F12 of air."""
    zenith, azimuth = np.array([0.0, 20.0, 45.0, 70.0, 80.0]), np.array([70.0, 10.0, -100.0, 160.0, 90.0])
    found = few_stokes("flat", haze_over_air(1e-7, 0.0), 60.0, zenith, azimuth)
    sunlight, *_ = frame(60.0, 0.0)
    light, e_theta, e_phi = frame(zenith, azimuth)
    angle = found.angle
    vibration = np.cos(angle) * e_theta + np.sin(angle) * e_phi
    across = np.cross(sunlight, light)
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    np.testing.assert_allclose(np.abs(np.sum(vibration * across, axis=-1)), 1.0, rtol=1e-6)
    np.testing.assert_allclose(found.degree[:, 0], -polarised_by_air(light @ sunlight), rtol=1e-5)


# --- limits and symmetries


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_the_sun_s_meridian_is_a_mirror(x64, geometry):
    zenith, azimuth = (v.ravel() for v in np.meshgrid([0.0, 30.0, 60.0, 80.0], [0.0, 35.0, 120.0, 180.0]))
    left, right = (few_stokes(geometry, hazy(), 60.0, zenith, side * azimuth, TWO) for side in (-1, 1))
    scale = right[0]
    np.testing.assert_allclose(left[0], right[0], rtol=1e-9)
    np.testing.assert_allclose(left[1] / scale, right[1] / scale, atol=1e-9)
    np.testing.assert_allclose(left[2] / scale, -right[2] / scale, atol=1e-9)
    on_it = (azimuth % 180.0) == 0.0
    np.testing.assert_allclose(right[2][on_it] / scale[on_it], 0.0, atol=1e-9)
    # and nowhere else
    assert np.all(np.abs(right[2] / scale)[~on_it & (zenith > 0.0)] > 1e-3)


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_in_the_zenith_only_the_frame_turns(x64, geometry):
    azimuth = np.array([0.0, 30.0, 90.0, 200.0])
    radiance, q, u = (part[:, 0] for part in few_stokes(geometry, hazy(), 60.0, 0.0, azimuth, TWO))
    np.testing.assert_allclose(radiance, radiance[0], rtol=1e-9)
    turn = np.radians(2.0 * azimuth)
    np.testing.assert_allclose(q, q[0] * np.cos(turn), atol=1e-9 * radiance[0])
    np.testing.assert_allclose(u, -q[0] * np.sin(turn), atol=1e-9 * radiance[0])
    # across the meridian, and much of it
    assert q[0] < -0.1 * radiance[0]


@pytest.mark.parametrize("geometry", GEOMETRIES)
@pytest.mark.parametrize(
    "air, haze, asymmetry, ground",
    [(0.02, 0.0, 0.7, 0.0), (0.3, 1.0, 0.8, 0.0), (1.0, 0.1, 0.6, 1.0), (0.1, 50.0, 0.7, 0.5)],
)
def test_no_light_is_more_than_polarised(geometry, air, haze, asymmetry, ground):
    zenith, azimuth = np.meshgrid([0.0, 25.0, 50.0, 75.0, 85.0, 90.0], [0.0, 60.0, 120.0, 180.0])
    for sun in (0.0, 40.0, 80.0):
        found = few_stokes(geometry, haze_over_air(air, haze, asymmetry, ground=ground), sun, zenith, azimuth)
        assert np.all(np.isfinite(found.radiance)) and np.all(found.radiance >= 0.0)
        assert np.all(np.isfinite(found.angle))
        assert np.all((found.degree >= 0.0) & (found.degree <= 1.0 + 1e-6))


@pytest.mark.parametrize("phase, values", [(RayleighPhase, (1.0,)), (HenyeyGreenstein, (0.7, 0.0))])
def test_what_does_not_polarise_leaves_a_scalar_sky(x64, phase, values):
    """Air of depolarisation 1 scatters evenly all round; haze without polarisation turns none into any."""
    haze = Prescribed(np.array([0.7]), Exponential(2000.0), phase(*values), 0.95)
    atmosphere, view = (
        skyfit.Atmosphere(None, haze, None, Ground(0.4)),
        views([0.0, 30.0, 55.0, 80.0], [0.0, 40.0, 130.0]),
    )
    found = few_stokes("flat", atmosphere, 55.0, *np.degrees([view.zenith, view.azimuth]))
    scalar = SMALL["flat"].radiance(atmosphere, unit_scene(55.0, view))
    np.testing.assert_allclose(found.radiance, scalar, rtol=1e-9)
    for part in (found.q, found.u):
        assert np.max(np.abs(part / found.radiance)) < 1e-9


def test_air_alone_is_not_a_scalar_sky(x64):
    """Some per cent in the radiance, of either sign: what polarisation is taken along for."""
    atmosphere, view = haze_over_air(0.3, 0.0), views([0.0, 40.0, 70.0], np.arange(0.0, 181.0, 45.0))
    scalar = SMALL["flat"].radiance(atmosphere, unit_scene(60.0, view))
    ratio = few_stokes("flat", atmosphere, 60.0, *np.degrees([view.zenith, view.azimuth])).radiance / scalar - 1.0
    assert np.max(ratio) > 0.01 and np.min(ratio) < -0.01 and np.max(np.abs(ratio)) < 0.1


@pytest.mark.parametrize(
    "atmosphere",
    [
        skyfit.Atmosphere(None, None, Ozone(300.0), Ground(0.3)),
        haze_over_air(0.0, 0.5, albedo_single=0.0),
        haze_over_air(0.0, 0.0, ground=0.5),
    ],
    ids=["ozone alone", "black haze", "nothing"],
)
def test_where_nothing_scatters_the_sky_is_black_and_no_number_is_lost(atmosphere):
    found = few_stokes("flat", atmosphere, 40.0, np.array([0.0, 40.0, 80.0]), 90.0)
    for part in (found.radiance, found.q, found.u, found.degree):
        np.testing.assert_array_equal(part, 0.0)
    assert np.all(np.isfinite(found.angle))


def test_the_radiance_is_the_first_of_the_stokes_vector_and_carries_the_irradiance():
    view, irradiance = views([10.0, 70.0], [20.0, 150.0]), np.array([1.5, 0.7])
    scene = skyfit.Scene(0.8, 0.2, view, np.array([450.0, 600.0]), irradiance)
    unit = skyfit.Scene(0.8, 0.2, view, np.array([450.0, 600.0]), np.ones(2))
    found, per_unit = (FEW["flat"].stokes(hazy(), s) for s in (scene, unit))
    # Q and U ask for more moments, which the radiance hardly feels
    np.testing.assert_allclose(FEW["flat"].radiance(hazy(), scene), found.radiance, rtol=2e-4)
    for part, expected in ((found.radiance, per_unit.radiance), (found.q, per_unit.q), (found.u, per_unit.u)):
        np.testing.assert_allclose(part, expected * irradiance[None], rtol=1e-6)
    np.testing.assert_allclose(found.degree, np.hypot(found.q, found.u) / found.radiance, rtol=1e-5)
    np.testing.assert_allclose(np.tan(2.0 * found.angle), found.u / found.q, rtol=1e-3)


@pytest.mark.slow
def test_few_spectral_nodes_give_the_whole_spectrum_of_q_and_u(x64):
    """Q and U change sign over the spectrum: what is interpolated must not be their logarithm."""
    zenith, azimuth = (v.ravel() for v in np.meshgrid([0.0, 40.0, 70.0, 85.0], [5.0, 90.0, 175.0]))
    spectrum, atmosphere = np.linspace(380.0, 780.0, 21), skyfit.Atmosphere.from_optical_depth(0.1)
    few, whole = (
        stokes_of(replace(FEW["flat"], spectral_nodes=n), atmosphere, 70.0, zenith, azimuth, spectrum) for n in (8, 0)
    )
    assert np.all(off(few, whole) < 2e-3)


# --- slopes, transforms, dtypes


def stokes_field(solver, view, wavelength):
    """A function of the atmosphere and the sun's zenith angle in radians, `[component, direction, wavelength]`."""

    def field(atmosphere, sun):
        scene = skyfit.Scene(sun, 0.3, view, wavelength, jnp.ones(len(wavelength)))
        found = solver.stokes(atmosphere, scene)
        return jnp.stack([found.radiance, found.q, found.u])

    return field


@pytest.mark.slow
def test_gradients_are_central_differences(x64):
    """On a sphere; every leaf of the atmosphere and the sun's zenith angle, forward and reverse."""
    view = skyfit.Directions(np.radians([5.0, 50.0, 80.0]), np.array([0.5, 1.5, 3.0]))
    field_of = stokes_field(FEW["spherical"], view, TWO)
    start = hazy(), jnp.asarray(1.0)
    leaves, tree = jax.tree.flatten(start)
    flat = jnp.stack(leaves)
    scale = jnp.maximum(jnp.abs(flat), 0.05)

    def field(relative):
        return field_of(*jax.tree.unflatten(tree, list(flat + relative * scale)))

    around, forward = forward_of(field, len(leaves))
    weight = weights_of(forward[0])
    backward = reverse_of(field, len(leaves), weight)
    central = (around[0] - around[1]) / 2e-5
    largest = float(np.max(np.abs(around)))
    for i, leaf in enumerate(names_of(start)):
        np.testing.assert_allclose(forward[i], central[i], atol=1e-5 * largest, err_msg=leaf)
        expected = float(np.sum(weight * forward[i]))
        assert float(backward[i]) == pytest.approx(expected, abs=1e-9 * largest * forward[i].size), leaf
    moved = {leaf for leaf, slope in zip(names_of(start), forward, strict=True) if np.any(np.abs(slope[1:]) > 1e-7)}
    assert any("polarisation" in leaf for leaf in moved) and any("depolarization" in leaf for leaf in moved)


@pytest.mark.parametrize("geometry", ["flat", slow("spherical")])
def test_gradients_are_finite_at_the_zenith_and_the_sun_and_where_it_is_dark(geometry):
    """By the view's angles, the sun's and the atmosphere; degree and angle too, where there is no polarisation."""

    def total(atmosphere, sun, zenith, azimuth):
        scene = skyfit.Scene(sun, 0.3, skyfit.Directions(zenith, azimuth), TWO, jnp.ones(2))
        found = FEW[geometry].stokes(atmosphere, scene)
        return sum(jnp.sum(v) for v in (found.radiance, found.q, found.u, found.degree, found.angle))

    slope = jax.jit(jax.grad(total, argnums=(0, 1, 2, 3)))
    dark = hazy(haze=0.0, pressure=0.0)
    # zenith, the sun, straight above and below it, the horizon
    zenith, azimuth = jnp.array([0.0, 0.7, 0.2, 1.3, np.pi / 2]), jnp.array([0.0, 0.3, 0.3, 0.3 + np.pi, 1.0])
    for atmosphere, sun in ((hazy(), 0.7), (hazy(), 0.0), (dark, 0.7)):
        found = slope(
            jax.tree.map(lambda leaf: jnp.asarray(leaf, float), atmosphere), jnp.asarray(sun), zenith, azimuth
        )
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(found)), sun


@pytest.mark.slow
def test_jit_eager_vmap_and_a_loop_agree():
    field = stokes_field(
        replace(FEW["flat"], streams=2, modes=2, levels=2, orders=2, nodes=3), views([20.0, 70.0], [10.0]), TWO
    )
    atmospheres, suns = [hazy(haze=0.1), hazy(haze=0.4, ground=0.5)], jnp.array([0.5, 1.2])
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *atmospheres)
    compiled = jax.jit(field)
    loop = np.stack([compiled(a, s) for a, s in zip(atmospheres, suns, strict=True)])
    scale = np.max(loop)
    np.testing.assert_allclose(jax.jit(jax.vmap(field))(stacked, suns), loop, atol=3e-5 * scale)
    assert compiled._cache_size() == 1
    with jax.disable_jit():
        np.testing.assert_allclose(field(atmospheres[0], suns[0]), loop[0], atol=3e-5 * scale)


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_float32_is_near_float64(geometry):
    def sky():
        zenith, azimuth = np.meshgrid([0.0, 45.0, 85.0], [20.0, 90.0, 170.0])
        return np.stack(few_stokes(geometry, hazy(), 63.0, zenith, azimuth, TWO))

    single = sky()
    assert single.dtype == np.float32
    with jax.enable_x64(True):
        assert np.all(off(single, sky()) < 3e-4)
