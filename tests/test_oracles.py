"""The solvers against reference radiances of other solvers; energy."""

import argparse
import importlib

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from skies import (
    haze_over_air,
    ONE,
    unit_scene,
    views,
)

import skyfit
from skyfit.atmosphere import Exponential, Ground, HenyeyGreenstein, Prescribed
from skyfit.transport import OrdersOfScattering, SingleScattering


# what is held here is each integral itself, not how far its sky may be off under a low sun
pytestmark = pytest.mark.filterwarnings("ignore::skyfit.LowSunWarning")

# --- reference radiances of independent solvers


@pytest.fixture(scope="module")
def oracle_check():
    return importlib.import_module("experiments.validation.oracle_check")


def against_oracle(module, shared, file, solver, preset, geometry, max_sun, max_view=85.0):
    settings = argparse.Namespace(
        solver=solver, preset=preset, geometry=geometry, max_sun_zenith=max_sun, max_view_zenith=max_view
    )
    row = module.compare(shared / "oracles" / file, settings)
    assert row["non_finite"] == 0 and row["points"] > 100
    return row


@pytest.mark.parametrize("file", ["oracle_pp_rayleigh.npz", "oracle_pp_aerosol.npz"])
def test_flat_single_scattering_meets_the_oracle(shared, oracle_check, file):
    """The oracle's haze is layered: 0.05 % remain, at view zenith 85; of air alone 3e-6."""
    row = against_oracle(oracle_check, shared, file, "single", "normal", "flat", 85.0)
    limit = 6e-4 if "aerosol" in file else 1e-5
    assert row["max_relative_error"] < limit and row["median_relative_error"] < 1e-5, row
    row = against_oracle(oracle_check, shared, file, "single", "normal", "flat", 85.0, 80.0)
    assert row["max_relative_error"] < 3e-4, row


@pytest.mark.parametrize("file", ["oracle_sph_rayleigh.npz", "oracle_sph_aerosol.npz"])
def test_spherical_single_scattering_meets_the_oracle_into_twilight(shared, oracle_check, file):
    """What remains, 2.5e-4 at 89, 89 degrees, is the oracle's: adaptive integrals differ from it as much."""
    row = against_oracle(oracle_check, shared, file, "single", "normal", "spherical", 95.0, 89.0)
    assert row["max_relative_error"] < 3e-4 and row["median_relative_error"] < 1e-5, row


@pytest.mark.parametrize("file", ["oracle_pp_rayleigh.npz", "oracle_pp_aerosol.npz"])
def test_flat_orders_meet_the_oracle(shared, oracle_check, file):
    row = against_oracle(oracle_check, shared, file, "orders", "normal", "flat", 85.0)
    assert row["max_relative_error"] < 5e-3 and row["median_relative_error"] < 1e-3, row


@pytest.mark.parametrize("file", ["oracle_sph_rayleigh.npz", "oracle_sph_aerosol.npz"])
def test_spherical_orders_meet_the_oracle_to_sun_zenith_75(shared, oracle_check, file):
    """Layers are flat for the multiple part: a bright ground under thin air is 1-2 % off toward the horizon."""
    row = against_oracle(oracle_check, shared, file, "orders", "normal", "spherical", 75.0)
    assert row["max_error_beyond_3_sigma"] < 0.02 and row["median_relative_error"] < 0.01, row


@pytest.mark.slow
@pytest.mark.parametrize("file", ["oracle_pp_rayleigh.npz", "oracle_pp_aerosol.npz"])
def test_fine_flat_orders_meet_the_oracle_to_a_thousandth(shared, oracle_check, file):
    row = against_oracle(oracle_check, shared, file, "orders", "fine", "flat", 85.0)
    assert row["max_relative_error"] <= 1e-3, row


# --- energy

DEEP = OrdersOfScattering(8, 1, 30, 40, 8, 0, "flat")


@eqx.filter_jit
def total_down(solver, atmosphere, suns, wavelength):
    """Direct, diffuse and up, per unit irradiance on the horizontal top of the atmosphere, `[sun, wavelength]` each."""

    def one(sun):
        view = skyfit.Directions(np.zeros(1), np.zeros(1))
        scene = skyfit.Scene(sun, 0.0, view, wavelength, jnp.ones_like(wavelength))
        return solver.fluxes(atmosphere, scene)

    return jax.vmap(one)(suns)


@pytest.mark.parametrize("preset", ["draft", "normal"])
@pytest.mark.parametrize(
    "air, haze, asymmetry", [(0.3, 0.0, 0.0), (0.2, 0.5, 0.7), (0.05, 1.5, 0.8), (1e-12, 0.0, 0.0), (0.1, 50.0, 0.85)]
)
def test_no_light_is_lost_without_absorption(x64, preset, air, haze, asymmetry):
    """What leaves the top and what the ground absorbs is what came in, whatever the resolution."""
    solver, suns = getattr(OrdersOfScattering, preset)("flat"), jnp.deg2rad(jnp.array([0.0, 45.0, 80.0, 89.0]))
    for albedo in (0.0, 0.3, 1.0):
        flux = total_down(solver, haze_over_air(air, haze, asymmetry, 1.0, albedo), suns, jnp.asarray(ONE))
        down = flux.direct + flux.diffuse_down
        np.testing.assert_allclose(flux.up, albedo * down, rtol=1e-12)
        absorbed = down - flux.up
        np.testing.assert_allclose((flux.up_at_top + absorbed)[:, 0], jnp.cos(suns), rtol=1e-10)


def test_the_ground_brightens_the_sky_as_a_geometric_series(x64):
    r"""Over a Lambertian ground $G(A) = G(0) / (1 - s A)$; without absorption $1 - s = 2\int G_0 d\mu$."""
    x, weight = np.polynomial.legendre.leggauss(12)
    mu, weight = 0.5 * (x + 1.0), 0.5 * weight
    ground = []
    for albedo in (0.0, 0.5, 1.0):
        flux = total_down(DEEP, haze_over_air(0.2, 0.5, 0.7, 1.0, albedo), jnp.arccos(mu), jnp.asarray(ONE))
        ground.append(np.asarray(flux.direct + flux.diffuse_down)[:, 0])
    # 1 / G is a straight line in the albedo, with one slope s for every sun
    spherical_albedo = 1.0 - ground[0] / ground[2]
    np.testing.assert_allclose(spherical_albedo, spherical_albedo[0], atol=1e-5)
    np.testing.assert_allclose(ground[1], ground[0] / (1.0 - 0.5 * spherical_albedo), rtol=1e-5)
    assert 2.0 * weight @ ground[0] + spherical_albedo.mean() == pytest.approx(1.0, abs=2e-4)


def test_absorption_takes_light_away(x64):
    suns, wavelength = jnp.deg2rad(jnp.array([20.0, 60.0])), jnp.asarray(ONE)
    clear, sooty = (
        total_down(DEEP, haze_over_air(0.1, 0.5, 0.7, w, 0.3), suns, wavelength).diffuse_down for w in (1.0, 0.6)
    )
    assert np.all(sooty < clear)


@pytest.mark.parametrize(
    "depth, single_albedo, asymmetry, ground, sun",
    [
        (0.25, 1.0, 0.0, 0.0, 60.0),
        (0.5, 0.9, 0.7, 0.3, 30.0),
        (1.0, 0.999, 0.7, 0.8, 75.0),
        (2.0, 0.95, 0.6, 0.1, 50.0),
    ],
)
def test_fluxes_are_those_of_pythonic_disort(x64, depth, single_albedo, asymmetry, ground, sun):
    pydisort = pytest.importorskip("PythonicDISORT.pydisort", reason="PythonicDISORT is absent").pydisort
    mu = np.cos(np.radians(sun))
    moments = asymmetry ** np.arange(65.0)
    _, _, down, *_ = pydisort(
        depth,
        min(single_albedo, 1.0 - 1e-6),
        32,
        moments[None],
        mu,
        1.0,
        0.0,
        NLeg=32,
        only_flux=True,
        f_arr=moments[32],
        BDRF_Fourier_modes=[ground] if ground else [],
    )
    diffuse, direct = (float(np.squeeze(v)) for v in down(np.array([depth])))
    haze = Prescribed(np.array([depth]), Exponential(8000.0), HenyeyGreenstein(asymmetry), single_albedo)
    atmosphere = skyfit.Atmosphere(haze, None, None, Ground(ground))
    found = total_down(DEEP, atmosphere, jnp.deg2rad(jnp.array([sun])), jnp.asarray(ONE))
    assert direct == pytest.approx(mu * np.exp(-depth / mu), rel=1e-9)
    assert float(found.direct[0, 0]) == pytest.approx(direct, rel=1e-9)
    assert float(found.diffuse_down[0, 0]) == pytest.approx(diffuse, rel=1e-3)


@pytest.mark.parametrize(
    "preset, depth, asymmetry, largest, near_sun",
    [
        ("draft", 3.0, 0.8, 0.015, 0.005),
        ("normal", 2.0, 0.75, 0.001, 0.001),
        ("normal", 3.0, 0.8, 0.005, 0.002),
        ("normal", 3.0, 0.85, 0.02, 0.004),
        pytest.param("fine", 1.0, 0.88, 0.003, 0.002, marks=pytest.mark.slow),
    ],
)
def test_dust_has_the_radiance_of_pythonic_disort(x64, preset, depth, asymmetry, largest, near_sun):
    """Thick haze with a forward peak: orders by tens, and the aureole, which the oracle corrects likewise."""
    pydisort = pytest.importorskip("PythonicDISORT.pydisort", reason="PythonicDISORT is absent").pydisort
    moments, mu, azimuth = asymmetry ** np.arange(600.0), 0.5, np.radians([0.0, 1.0, 2.0, 4.0, 7.0, 12.0, 40.0, 180.0])
    nodes, *_, light = pydisort(
        depth,
        0.93,
        48,
        moments[None],
        mu,
        1.0,
        0.0,
        NLeg=48,
        NFourier=48,
        f_arr=moments[48],
        NT_cor=True,
        BDRF_Fourier_modes=[0.3],
    )
    seen = nodes < -0.08
    zenith, turn = (v.ravel() for v in np.meshgrid(np.arccos(-nodes[seen]), azimuth, indexing="ij"))
    expected = np.asarray(light(depth, azimuth))[seen].ravel()
    haze = Prescribed(np.array([depth]), Exponential(8000.0), HenyeyGreenstein(asymmetry), 0.93)
    scene = skyfit.Scene(np.arccos(mu), 0.0, skyfit.Directions(zenith, turn), np.array([550.0]), np.ones(1))
    atmosphere = skyfit.Atmosphere(haze, None, None, Ground(0.3))
    off = np.abs(
        np.asarray(getattr(OrdersOfScattering, preset)("flat").radiance(atmosphere, scene))[:, 0] / expected - 1
    )
    angle = np.arccos(np.cos(zenith) * mu + np.sin(zenith) * np.sqrt(1.0 - mu**2) * np.cos(turn))
    assert off.max() < largest
    assert off[angle < np.radians(6.0)].max() < near_sun


@pytest.mark.parametrize(
    "preset, depth, single_albedo, tolerance",
    [
        ("draft", 3.0, 1.0, 0.01),
        ("normal", 3.0, 1.0, 1e-3),
        ("normal", 10.0, 1.0, 5e-3),
        ("normal", 50.0, 1.0, 0.05),
        ("normal", 50.0, 0.99, 0.2),
        pytest.param("fine", 50.0, 1.0, 0.01, marks=pytest.mark.slow),
    ],
)
def test_thick_haze_has_the_light_of_pythonic_disort(x64, preset, depth, single_albedo, tolerance):
    """Light arrives after far more orders of scattering than are followed one by one."""
    pydisort = pytest.importorskip("PythonicDISORT.pydisort", reason="PythonicDISORT is absent").pydisort
    moments, mu = 0.7 ** np.arange(65.0), 0.5
    _, _, down, *_ = pydisort(
        depth,
        min(single_albedo, 1.0 - 1e-6),
        32,
        moments[None],
        mu,
        1.0,
        0.0,
        NLeg=32,
        only_flux=True,
        f_arr=moments[32],
    )
    haze = Prescribed(np.array([depth]), Exponential(8000.0), HenyeyGreenstein(0.7), single_albedo)
    atmosphere = skyfit.Atmosphere(haze, None, None, Ground(0.0))
    solver = getattr(OrdersOfScattering, preset)("flat")
    found = total_down(solver, atmosphere, jnp.arccos(jnp.array([mu])), jnp.asarray(ONE))
    expected = float(np.squeeze(down(np.array([depth]))[0]))
    assert float(found.diffuse_down[0, 0]) == pytest.approx(expected, rel=tolerance)


@pytest.mark.parametrize(
    "solver, tolerance",
    [
        (SingleScattering(32, "flat"), 2e-3),
        (SingleScattering(32, "spherical"), 2e-3),
        (OrdersOfScattering(8, 6, 30, 10, 24, 0, "flat"), 3e-3),
    ],
    ids=["single flat", "single spherical", "orders flat"],
)
def test_the_diffuse_flux_is_the_radiance_over_the_hemisphere(x64, solver, tolerance):
    x, weight = np.polynomial.legendre.leggauss(24)
    mu, turns = 0.5 * (x + 1.0), 48
    view = views(np.degrees(np.arccos(mu)), 360.0 * (np.arange(turns) + 0.5) / turns)
    atmosphere, scene = haze_over_air(0.2, 0.2, 0.5, ground=0.2), unit_scene(50.0, view)
    radiance = np.asarray(solver.radiance(atmosphere, scene))[:, 0].reshape(24, turns)
    expected = (0.5 * weight * mu) @ radiance.mean(axis=1) * 2.0 * np.pi
    flux = solver.fluxes(atmosphere, scene)
    assert float(flux.diffuse_down[0]) == pytest.approx(expected, rel=tolerance)
    np.testing.assert_allclose(flux.up, 0.2 * (flux.direct + flux.diffuse_down), rtol=1e-10)
