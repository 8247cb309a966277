"""Few wavelengths for the multiple part; gradients, transforms and dtypes of the solvers."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from skies import (
    COLOURS,
    compiled_sky,
    forward_of,
    hazy,
    names_of,
    reverse_of,
    SKIES,
    sky_of,
    slow,
    SOLVERS,
    unit_scene,
    views,
    weights_of,
)

import skyfit
from skyfit.atmosphere import Aerosol, Ozone, Rayleigh
from skyfit.transport import DoubleScattering, OrdersOfScattering, Shells, SingleScattering, Uniform


# --- the multiple part at few wavelengths

SPECTRUM = np.linspace(380.0, 780.0, 21)


@eqx.filter_jit
def few_and_all(atmosphere, sun_deg):
    """The same sky with 8 spectral nodes and with all 21 wavelengths; five streams do for the comparison."""
    view = views([0.0, 40.0, 70.0, 85.0], [5.0, 90.0, 180.0])
    solvers = (OrdersOfScattering(4, 4, 20, 6, 24, n, "spherical") for n in (8, 0))
    return tuple(s.radiance(atmosphere, skyfit.Scene.from_degrees(sun_deg, view, SPECTRUM)) for s in solvers)


@pytest.mark.parametrize("haze, sun", [(0.05, 30.0), (0.1, 60.0), (0.1, 75.0), (0.4, 75.0)])
def test_few_spectral_nodes_give_the_whole_spectrum(haze, sun):
    few, whole = few_and_all(skyfit.Atmosphere.from_optical_depth(jnp.asarray(haze)), jnp.asarray(sun))
    np.testing.assert_allclose(few, whole, rtol=2e-3)


@pytest.mark.parametrize("haze", [0.1, 1.0, 3.0, 10.0, 50.0])
@pytest.mark.parametrize("sun", [30.0, 75.0, 85.0, 90.0])
def test_few_spectral_nodes_never_run_away(haze, sun):
    """Single scattering may vanish where multiple does not: interpolating their ratio must not blow up."""
    few, whole = few_and_all(skyfit.Atmosphere.from_optical_depth(jnp.asarray(haze)), jnp.asarray(sun))
    assert np.all(few >= 0.0)
    assert float(jnp.max(jnp.abs(few - whole))) < 0.05 * float(jnp.max(whole))


# --- gradients, transforms, dtypes


@pytest.mark.parametrize(
    "name",
    [
        "single flat",
        "single spherical",
        "shells flat",
        "shells spherical",
        # polarised: `test_polarisation.py`, with Q and U
        "orders spherical",
        "uniform flat",
        slow("double spherical"),
    ],
)
def test_gradients_are_central_differences_for_every_parameter(x64, name):
    """Away from the horizon: both modes, every leaf of the atmosphere and the sun's zenith angle.

    Only tiers without the ground's light may lose the ground; where ozone lies does not matter where it filters
    the sun at the ground.
    """
    sky = sky_of(SOLVERS[name], skyfit.Directions(np.radians([5.0, 50.0, 80.0]), np.array([0.5, 1.5, 3.0])))
    start = hazy(), jnp.asarray(1.0)
    leaves, tree = jax.tree.flatten(start)
    flat = jnp.stack(leaves)
    scale = jnp.maximum(jnp.abs(flat), 0.05)

    def field(relative):
        return sky(*jax.tree.unflatten(tree, list(flat + relative * scale)))

    around, forward = forward_of(field, len(leaves))
    weight = weights_of(forward[0])
    backward = reverse_of(field, len(leaves), weight)
    central = (around[0] - around[1]) / 2e-5
    largest = float(np.max(np.abs(around)))
    for i, leaf in enumerate(names_of(start)):
        np.testing.assert_allclose(forward[i], central[i], atol=1e-5 * largest, err_msg=leaf)
        expected = float(np.sum(weight * forward[i]))
        assert float(backward[i]) == pytest.approx(expected, abs=1e-9 * largest * forward[i].size), leaf
    without = [leaf for i, leaf in enumerate(names_of(start)) if np.max(np.abs(forward[i])) < 1e-7 * largest]
    filtered = ["ground", f"constituents[{start[0].names.index('ozone')}].profile"]
    blind = {"single": ["ground"], "double": ["ground"], "shells": filtered, "uniform": filtered}
    ignored = blind.get(name.split()[0], []) + ["phase.polarisation"]
    assert all(any(part in leaf for part in ignored) for leaf in without), without


@pytest.mark.parametrize(
    "name",
    [
        "single flat",
        "single spherical",
        "uniform flat",
        slow("double spherical"),
        "shells flat",
        "shells spherical",
        # polarised: `test_polarisation.py`, with Q and U
        slow("orders spherical"),
    ],
)
def test_jit_eager_vmap_and_a_loop_agree(name):
    solver = SOLVERS[name]
    tiny = {
        "single": SingleScattering(3, solver.geometry),
        "double": DoubleScattering(2, 2, 2, 3, 2, solver.geometry),
        "orders": OrdersOfScattering(2, 2, 2, 2, 3, 2, solver.geometry),
        "uniform": Uniform(),
        "shells": Shells(3, solver.geometry),
    }[name.split()[0]]
    sky = sky_of(tiny, views([20.0, 70.0], [10.0, 150.0]), np.array([450.0, 550.0, 650.0]))
    atmospheres = [hazy(haze=0.1), hazy(haze=0.4, ground=0.5)]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *atmospheres)
    suns = jnp.array([0.5, 1.2])
    compiled = jax.jit(sky)
    loop = jnp.stack([compiled(a, s) for a, s in zip(atmospheres, suns, strict=True)])
    np.testing.assert_allclose(jax.jit(jax.vmap(sky))(stacked, suns), loop, rtol=3e-5)
    with jax.disable_jit():
        np.testing.assert_allclose(sky(atmospheres[0], suns[0]), loop[0], rtol=3e-5)


@pytest.mark.parametrize("name", ["orders spherical", slow("orders flat")])
def test_a_batch_of_skies_is_the_loop_over_them(name):
    zenith, azimuth = np.linspace(0.1, 1.5, 9), np.linspace(0.0, 3.0, 9)
    atmospheres, suns = [hazy(haze=0.1), hazy(haze=0.4, ground=0.5)], [0.5, 1.2]
    loop = np.stack([compiled_sky(name, a, s, zenith, azimuth) for a, s in zip(atmospheres, suns, strict=True)])
    batch = jax.jit(jax.vmap(sky_of(SOLVERS[name], skyfit.Directions(zenith, azimuth))))(
        jax.tree.map(lambda *leaves: jnp.stack(leaves), *atmospheres), jnp.array(suns)
    )
    np.testing.assert_allclose(batch, loop, rtol=3e-5)


@pytest.mark.parametrize("name", SOLVERS)
def test_float32_is_near_float64(name):
    def sky():
        zenith = np.radians([0.0, 45.0, 85.0])[:, None]
        return compiled_sky(name, hazy(), 1.1, zenith, 0.3 + np.array([0.0, 1.5, 3.0]))

    single = sky()
    assert single.dtype == np.float32
    with jax.enable_x64(True):
        np.testing.assert_allclose(single, sky(), rtol=3e-4)


def operations(solver, atmosphere, wavelength):
    """How many exponentials and products the lowered program holds, and its length."""
    scene = unit_scene(40.0, views([30.0], [0.0, 90.0]), wavelength)
    text = jax.jit(lambda a: solver.radiance(a, scene)).lower(atmosphere).as_text()
    return sum(text.count(f"stablehlo.{name}") for name in ("exponential", "logistic", "dot_general")), len(text)


@pytest.mark.parametrize("name", SOLVERS)
def test_what_is_absent_costs_nothing(name):
    air, haze, ozone = Rayleigh(), Aerosol(0.1), Ozone()
    atmospheres = [
        skyfit.Atmosphere(air, None, None),
        skyfit.Atmosphere(air, None, ozone),
        skyfit.Atmosphere(air, haze, None),
        skyfit.Atmosphere(air, haze, ozone),
    ]
    alone, with_ozone, with_haze, all_three = (operations(SOLVERS[name], a, COLOURS) for a in atmospheres)
    for less, more in (
        (alone, with_ozone),
        (alone, with_haze),
        (with_ozone, all_three),
        (with_haze, all_three),
    ):
        # Uniform adds ozone to the exponent of the sun: no exponential more, but some arithmetic
        assert less[1] < more[1] and (less[0] < more[0] or (name == "uniform flat" and less[0] == more[0]))


@pytest.mark.parametrize("name", ["orders", slow("double")])
def test_air_alone_takes_three_modes_and_loses_nothing(x64, name):
    """What a phase function does not have is not carried: the same sky, fewer numbers in the lowered program."""
    scene = unit_scene(50.0, views([0.0, 60.0, 80.0], [20.0, 150.0]), COLOURS)
    air = skyfit.Atmosphere(Rayleigh(), None, None)
    # haze of depth 0 with the profile of air: the same layers
    as_if = skyfit.Atmosphere(Rayleigh(), Aerosol(0.0, profile=Rayleigh().profile), None)
    solver = DoubleScattering.draft() if name.startswith("double") else OrdersOfScattering.draft()
    np.testing.assert_allclose(solver.radiance(air, scene), solver.radiance(as_if, scene), rtol=2e-5)
    texts = [jax.jit(lambda a: solver.radiance(a, scene)).lower(a).as_text() for a in (air, as_if)]
    assert "x12x" in texts[1] and "x12x" not in texts[0]


@pytest.mark.parametrize("name", SOLVERS)
def test_a_change_of_value_compiles_nothing(name):
    compiled_sky(name, hazy(), 0.7, 0.5, 0.0)
    before = SKIES[name, jnp.result_type(float)]._cache_size()
    compiled_sky(name, hazy(haze=0.9, ozone=100.0), 1.2, np.array([0.1, 1.0]), 2.0)
    assert SKIES[name, jnp.result_type(float)]._cache_size() == before == 1


def test_a_solver_says_which_geometries_there_are():
    for make in (SingleScattering, DoubleScattering, OrdersOfScattering, Shells, Uniform):
        with pytest.raises((ValueError, TypeError), match="geometry"):
            make(geometry="round")
