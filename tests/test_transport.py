"""The solver floor against closed forms, independent integrals and the reference radiances of other solvers."""

import argparse
import importlib.util

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import skyfit
from skyfit.atmosphere import (
    Aerosol,
    Exponential,
    Ground,
    HenyeyGreenstein,
    Ozone,
    Prescribed,
    Rayleigh,
    RayleighPhase,
)
from skyfit.transport import OrdersOfScattering, SingleScattering


EARTH_RADIUS = 6371e3
ONE = np.array([550.0])
# few of everything: what these tests claim does not depend on resolution
SMALL = {geometry: OrdersOfScattering(3, 3, 8, 4, 8, 3, geometry) for geometry in ("flat", "spherical")}
SINGLE = {geometry: SingleScattering(12, geometry) for geometry in ("flat", "spherical")}
SOLVERS = {f"{name} {g}": s[g] for name, s in (("single", SINGLE), ("orders", SMALL)) for g in s}
# compilation is most of the time of these tests: programs that run once are not worth optimising
HASTE = {"xla_backend_optimization_level": 0}


def slow(*values):
    return pytest.param(*values, marks=pytest.mark.slow)


def views(zenith, azimuth):
    return skyfit.Directions.from_degrees(np.asarray(zenith, float)[:, None], np.asarray(azimuth, float)[None])


def haze_over_air(air, haze, asymmetry=0.7, albedo_single=0.9, ground=0.0, haze_height=1200.0):
    """The oracles' atmosphere, at one wavelength."""
    return skyfit.Atmosphere(
        Prescribed(jnp.reshape(jnp.asarray(air, float), (1,)), Exponential(8000.0), RayleighPhase(0.0)),
        Prescribed(
            jnp.reshape(jnp.asarray(haze, float), (1,)),
            Exponential(haze_height),
            HenyeyGreenstein(asymmetry),
            albedo_single,
        ),
        None,
        Ground(ground),
    )


def unit_scene(sun_deg, view, wavelength=ONE):
    return skyfit.Scene.from_degrees(sun_deg, view, wavelength, irradiance="unit")


def phase_functions(cosine, asymmetry=0.7):
    """Of air and haze, sr^-1."""
    lobe = (1.0 - asymmetry**2) / (4.0 * np.pi * (1.0 + asymmetry**2 - 2.0 * asymmetry * cosine) ** 1.5)
    return 3.0 / (16.0 * np.pi) * (1.0 + cosine**2), lobe


def unit_vector(zenith_deg, azimuth_deg):
    z, a = np.radians([zenith_deg, azimuth_deg])
    return np.array([np.sin(z) * np.cos(a), np.sin(z) * np.sin(a), np.cos(z)])


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
        found = SingleScattering.fine("flat").radiance(haze_over_air(*depths), unit_scene(sun, views(zenith, azimuth)))
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
    distance, weight = panels(start, np.geomspace(200.0, 2e6, 14), 12)
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


@pytest.mark.parametrize("sun", [30.0, 60.0, 80.0, 86.0, 89.0, 90.0, 91.0, 92.0])
def test_spherical_single_scattering_is_the_integral(x64, sun):
    depths, heights, albedos = (0.25, 0.3), (8000.0, 1200.0), (1.0, 0.9)
    zenith, azimuth = [0.0, 45.0, 80.0], [10.0, 90.0, 170.0]
    expected = np.ravel([[spherical_integral(sun, v, a, depths, heights, albedos) for a in azimuth] for v in zenith])
    scene = unit_scene(sun, views(zenith, azimuth))
    fine = SingleScattering.fine("spherical").radiance(haze_over_air(*depths), scene)[:, 0]
    np.testing.assert_allclose(fine, expected, rtol=1e-3)
    normal = SingleScattering.normal("spherical").radiance(haze_over_air(*depths), scene)[:, 0]
    np.testing.assert_allclose(normal, expected, rtol=3e-3 if sun <= 90.0 else 1.5e-2)


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


def test_spherical_quadrature_converges_in_nodes(x64):
    scene, atmosphere = unit_scene(65.0, views([0.0, 60.0, 80.0], [20.0, 100.0])), haze_over_air(0.25, 0.3)
    best = SingleScattering(96, "spherical").radiance(atmosphere, scene)
    errors = [
        float(jnp.max(jnp.abs(SingleScattering(n, "spherical").radiance(atmosphere, scene) / best - 1.0)))
        for n in (6, 12, 24)
    ]
    # the 16 nodes of the columns are always the same: 2e-4 of noise on the nodes along the view
    assert errors[1] < errors[0] / 3.0 and errors[2] < 3e-4


# --- limits and symmetries


@pytest.mark.parametrize("name", SOLVERS)
def test_a_thin_sky_is_its_optical_depth_over_the_cosine(x64, name):
    """L -> E0 sum p omega tau / mu; the second order is tau times smaller."""
    thin, sun, zenith, azimuth = 1e-7, 40.0, [0.0, 30.0, 60.0], [0.0, 120.0]
    found = SOLVERS[name].radiance(haze_over_air(thin, 2.0 * thin), unit_scene(sun, views(zenith, azimuth)))[:, 0]
    expected = []
    for view in zenith:
        for turn in azimuth:
            air, haze = phase_functions(unit_vector(sun, 0.0) @ unit_vector(view, turn))
            expected.append(thin * (air + 2.0 * 0.9 * haze) / np.cos(np.radians(view)))
    # the airmass of a sphere is smaller: -H tan^2 / R, 0.4 % at 60 degrees
    np.testing.assert_allclose(found, expected, rtol=1e-5 if name.endswith("flat") else 5e-3)


@pytest.mark.parametrize("name", SOLVERS)
def test_thin_air_is_blue_by_the_fourth_power(x64, name):
    wavelength = np.array([400.0, 500.0, 700.0])
    atmosphere = skyfit.Atmosphere(Rayleigh(pressure=0.1, formula="paper"), None, None, Ground(0.0))
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


# --- reference radiances of independent solvers


@pytest.fixture(scope="module")
def oracle_check(checkout):
    spec = importlib.util.spec_from_file_location("oracle_check", checkout / "experiments" / "oracle_check.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def against_oracle(module, shared, file, solver, preset, geometry, max_sun, max_view=85.0):
    settings = argparse.Namespace(
        solver=solver, preset=preset, geometry=geometry, max_sun_zenith=max_sun, max_view_zenith=max_view
    )
    row = module.compare(shared / "oracles" / file, settings)
    assert row["non_finite"] == 0 and row["points"] > 100
    return row


@pytest.mark.parametrize("file", ["oracle_pp_rayleigh.npz", "oracle_pp_aerosol.npz"])
def test_flat_single_scattering_meets_the_oracle(shared, oracle_check, file):
    """The oracle's haze is layered: 0.05 % remain, at view zenith 85."""
    row = against_oracle(oracle_check, shared, file, "single", "normal", "flat", 85.0)
    assert row["max_relative_error"] < 1e-3 and row["median_relative_error"] < 2e-5, row


@pytest.mark.parametrize("file", ["oracle_sph_rayleigh.npz", "oracle_sph_aerosol.npz"])
def test_spherical_single_scattering_meets_the_oracle(shared, oracle_check, file):
    row = against_oracle(oracle_check, shared, file, "single", "fine", "spherical", 90.0, 89.0)
    assert row["max_relative_error"] < 2e-3 and row["median_relative_error"] < 1e-4, row


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


@pytest.mark.parametrize("air, haze, asymmetry", [(0.3, 0.0, 0.0), (0.2, 0.5, 0.7), (0.05, 1.5, 0.8)])
def test_no_light_is_lost_without_absorption(x64, air, haze, asymmetry):
    r"""Over a Lambertian ground $G(A) = G(0) / (1 - s A)$; without absorption $1 - s = 2\int G_0 d\mu$."""
    x, weight = np.polynomial.legendre.leggauss(12)
    mu, weight = 0.5 * (x + 1.0), 0.5 * weight
    wavelength, ground = jnp.asarray(ONE), []
    for albedo in (0.0, 0.5, 1.0):
        flux = total_down(DEEP, haze_over_air(air, haze, asymmetry, 1.0, albedo), jnp.arccos(mu), wavelength)
        down = np.asarray(flux.direct + flux.diffuse_down)[:, 0]
        np.testing.assert_allclose(np.asarray(flux.up)[:, 0], albedo * down, rtol=1e-6, atol=1e-12)
        ground.append(down)
    # 1 / G is a straight line in the albedo, with one slope s for every sun
    spherical_albedo = 1.0 - ground[0] / ground[2]
    np.testing.assert_allclose(spherical_albedo, spherical_albedo[0], atol=1e-3)
    np.testing.assert_allclose(ground[1], ground[0] / (1.0 - 0.5 * spherical_albedo), rtol=1e-3)
    diffuse_transmission = 2.0 * weight @ ground[0]
    assert diffuse_transmission + spherical_albedo.mean() == pytest.approx(1.0, abs=2e-3)


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
    assert float(found.diffuse_down[0, 0]) == pytest.approx(diffuse, rel=4e-3)


@pytest.mark.parametrize(
    "preset, depth, single_albedo, tolerance",
    [
        ("normal", 3.0, 1.0, 0.02),
        ("normal", 5.0, 1.0, 0.02),
        pytest.param("fine", 10.0, 1.0, 0.03, marks=pytest.mark.slow),
    ],
)
def test_thick_haze_has_the_light_of_pythonic_disort(x64, preset, depth, single_albedo, tolerance):
    """To the optical depths that the solver claims, light arrives after more orders than are followed one by one."""
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

COLOURS = np.array([420.0, 480.0, 550.0, 680.0])


def hazy(**changes):
    """Every kind of leaf: air, haze, ozone, ground."""
    values = {
        "pressure": 9e4,
        "haze": 0.2,
        "albedo": 0.9,
        "asymmetry": 0.65,
        "ozone": 300.0,
        "ground": 0.2,
    } | changes
    atmosphere = skyfit.Atmosphere(
        Rayleigh(values["pressure"]),
        Aerosol(
            values["haze"],
            1.2,
            values["albedo"],
            0.02,
            HenyeyGreenstein(values["asymmetry"]),
            Exponential(1500.0),
        ),
        Ozone(values["ozone"]),
        Ground(values["ground"], 0.05),
    )
    return atmosphere


def sky_of(solver, view, wavelength=COLOURS):
    """A function of the atmosphere and the sun's zenith angle in radians."""

    def sky(atmosphere, sun):
        return solver.radiance(atmosphere, skyfit.Scene(sun, 0.3, view, wavelength, jnp.ones(len(wavelength))))

    return sky


SKIES = {}


def compiled_sky(name, atmosphere, sun, zenith, azimuth):
    """At most nine directions; one program for each solver and dtype serves many tests."""
    key = name, jnp.result_type(float)
    if key not in SKIES:

        def sky(atmosphere, sun, zenith, azimuth):
            return sky_of(SOLVERS[name], skyfit.Directions(zenith, azimuth))(atmosphere, sun)

        SKIES[key] = jax.jit(sky, compiler_options=HASTE)
    zenith, azimuth = (np.ravel(v) for v in np.broadcast_arrays(zenith, azimuth))
    padded = (jnp.asarray(np.pad(v, (0, 9 - len(zenith)), "edge"), float) for v in (zenith, azimuth))
    atmosphere = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), atmosphere)
    return np.asarray(SKIES[key](atmosphere, jnp.asarray(sun, float), *padded))[: len(zenith)]


def names_of(tree):
    return [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(tree)]


@pytest.mark.parametrize(
    "name, reverse",
    [
        ("single flat", True),
        ("single spherical", True),
        ("orders spherical", True),
        slow("orders flat", True),
    ],
)
def test_gradients_are_central_differences_for_every_parameter(x64, name, reverse):
    """Away from the horizon: both modes, every leaf of the atmosphere and the sun's zenith angle."""
    sky = sky_of(SOLVERS[name], skyfit.Directions(np.radians([5.0, 50.0, 80.0]), np.array([0.5, 1.5, 3.0])))
    start = hazy(), jnp.asarray(1.0)
    leaves, tree = jax.tree.flatten(start)
    flat = jnp.stack(leaves)
    scale = jnp.maximum(jnp.abs(flat), 0.05)

    def field(relative):
        return sky(*jax.tree.unflatten(tree, list(flat + relative * scale)))

    step = 1e-5 * jnp.eye(len(leaves))
    around = jax.jit(lambda s: jax.lax.map(field, s), compiler_options=HASTE)(jnp.concatenate([step, -step]))
    central = (around[: len(leaves)] - around[len(leaves) :]) / 2e-5
    zero = jnp.zeros(len(leaves))
    forward = jnp.moveaxis(jax.jit(jax.jacfwd(field), compiler_options=HASTE)(zero), -1, 0)
    largest = float(jnp.max(jnp.abs(around)))
    weight = jnp.cos(jnp.arange(central[0].size)).reshape(central[0].shape)
    if reverse:
        backward = jax.jit(jax.grad(lambda r: jnp.sum(weight * field(r))), compiler_options=HASTE)(zero)
    for i, leaf in enumerate(names_of(start)):
        np.testing.assert_allclose(forward[i], central[i], atol=1e-5 * largest, err_msg=leaf)
        if reverse:
            expected = float(jnp.sum(weight * forward[i]))
            assert float(backward[i]) == pytest.approx(expected, abs=1e-9 * largest * weight.size), leaf
    # no parameter is lost on the way, but for the ground in single scattering
    without = [leaf for i, leaf in enumerate(names_of(start)) if float(jnp.max(jnp.abs(forward[i]))) < 1e-7 * largest]
    assert all("ground" in leaf for leaf in without) and (not without or name.startswith("single")), without


@pytest.mark.parametrize("name", ["single flat", "single spherical", slow("orders flat"), slow("orders spherical")])
def test_jit_eager_vmap_and_a_loop_agree(name):
    solver = SOLVERS[name]
    tiny = (
        SingleScattering(3, solver.geometry)
        if name.startswith("single")
        else OrdersOfScattering(2, 2, 2, 2, 3, 2, solver.geometry)
    )
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
    batch = jax.jit(jax.vmap(sky_of(SOLVERS[name], skyfit.Directions(zenith, azimuth))), compiler_options=HASTE)(
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
    """How many exp and dot operations the traced program holds, loops and branches included."""
    view = views([30.0], [0.0, 90.0])
    traced = jax.make_jaxpr(lambda a: solver.radiance(a, unit_scene(40.0, view, wavelength)))(atmosphere)

    def inner(value):
        if isinstance(value, jax.extend.core.ClosedJaxpr):
            return [value.jaxpr]
        if isinstance(value, jax.extend.core.Jaxpr):
            return [value]
        return [j for v in value for j in inner(v)] if isinstance(value, tuple | list) else []

    def count(jaxpr):
        total = 0
        for equation in jaxpr.eqns:
            total += equation.primitive.name in ("exp", "exp2", "logistic", "dot_general")
            total += sum(count(j) for value in equation.params.values() for j in inner(value))
        return total

    return count(traced.jaxpr), len(str(traced))


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
        assert less[0] < more[0] and less[1] < more[1]


@pytest.mark.parametrize("name", SOLVERS)
def test_a_change_of_value_compiles_nothing(name):
    compiled_sky(name, hazy(), 0.7, 0.5, 0.0)
    before = SKIES[name, jnp.result_type(float)]._cache_size()
    compiled_sky(name, hazy(haze=0.9, ozone=100.0), 1.2, np.array([0.1, 1.0]), 2.0)
    assert SKIES[name, jnp.result_type(float)]._cache_size() == before == 1


def test_a_solver_says_which_geometries_there_are():
    for make in (SingleScattering, OrdersOfScattering):
        with pytest.raises((ValueError, TypeError), match="geometry"):
            make(geometry="round")


# --- hard cases

# six in the sky, one of them into the sun of "plain"; at the horizon, under it, at the nadir
VIEW = skyfit.Directions(
    np.array([0.0, 0.52359878, 0.52359878, 1.0, 1.5, 1.56, 0.5 * np.pi, 1.6, 2.5, np.pi]),
    np.array([0.0, 0.3, 2.0, 1.0, 3.0, 0.3, 0.3, 2.0, 0.0, 0.0]),
)
STEP = float(np.spacing(np.float32(90.0)))
NOTHING = {"pressure": 0.0, "haze": 0.0, "ozone": 0.0}
HARD = {
    "plain": (30.0, {}),
    "sun at the zenith": (0.0, {}),
    "sun a step off the zenith": (1e-6, {}),
    "sun a step above the horizon": (90.0 - STEP, {}),
    "sun at the horizon": (90.0, {}),
    "sun a step below the horizon": (90.0 + STEP, {}),
    "sun at 85": (85.0, {}),
    "sun at 92": (92.0, {}),
    "sun at 96": (96.0, {}),
    "sun at the nadir": (180.0, {}),
    "optical depth 0": (30.0, NOTHING),
    "optical depth 0, sun at the horizon": (90.0, NOTHING),
    "optical depth 1e-12": (30.0, {"pressure": 1e-6, "haze": 1e-12, "ozone": 1e-9}),
    "optical depth 50": (30.0, {"haze": 50.0}),
    "optical depth 50, low sun": (89.0, {"haze": 50.0}),
    "optical depth 50, conservative": (30.0, {"haze": 50.0, "albedo": 1.0, "ground": 1.0}),
    "air of depth 50": (60.0, {"pressure": 5e7}),
    "no air": (30.0, {"pressure": 0.0}),
    "no haze": (30.0, {"haze": 0.0}),
    "no ozone": (30.0, {"ozone": 0.0}),
    "g 0": (30.0, {"asymmetry": 0.0}),
    "g 0.999": (30.0, {"asymmetry": 0.999}),
    "g 0.999 in thick haze": (30.0, {"asymmetry": 0.999, "haze": 2.0}),
    "g -0.9": (30.0, {"asymmetry": -0.9}),
    "ground black": (30.0, {"ground": 0.0}),
    "ground white": (30.0, {"ground": 1.0}),
    "haze black": (30.0, {"albedo": 0.0}),
    "haze white": (30.0, {"albedo": 1.0}),
    "haze black and no air": (30.0, {"albedo": 0.0, "pressure": 0.0}),
    "all white": (30.0, {"albedo": 1.0, "ground": 1.0, "ozone": 0.0}),
}


def hard_program(solver, quantity, reverse):
    """Values and derivatives by the atmosphere and the sun's zenith angle: one program for all cases."""

    def field(parameters):
        atmosphere, sun = parameters
        scene = skyfit.Scene(sun, 0.3, VIEW, COLOURS, jnp.ones(len(COLOURS)))
        if quantity == "radiance":
            return solver.radiance(atmosphere, scene)
        return jnp.stack(solver.fluxes(atmosphere, scene))

    def forward(parameters):
        return field(parameters), jax.jacfwd(field)(parameters)

    def backward(parameters):
        return jax.value_and_grad(lambda p: jnp.sum(field(p)))(parameters)

    return jax.jit(backward if reverse else forward, compiler_options=HASTE)


def problems_of_hard_cases(solver, quantity, dtype, reverse=False):
    """One line for each case that fails: which rows (directions, or direct, diffuse, up) and which leaves."""
    with jax.enable_x64(dtype == "float64"):
        program, problems = hard_program(solver, quantity, reverse), []
        for case, (sun, changes) in HARD.items():
            parameters = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), (hazy(**changes), np.radians(sun)))
            values, slopes = program(parameters)
            values = np.asarray(values)
            if not np.all(np.isfinite(values)):
                problems.append(f"{case}: values not finite, first at {np.argwhere(~np.isfinite(values))[0]}")
            elif not reverse and values.min() < -1e-6 * values.max():
                problems.append(f"{case}: minimum {values.min():.3g}, maximum {values.max():.3g}")
            leaves = list(zip(names_of(slopes), map(np.asarray, jax.tree.leaves(slopes)), strict=True))
            bad = [leaf for leaf, slope in leaves if not np.all(np.isfinite(slope))]
            if bad:
                rows = set() if reverse else {int(i[0]) for _, v in leaves for i in np.argwhere(~np.isfinite(v))}
                problems.append(f"{case}: gradient not finite in {len(bad)} leaves ({bad[0]}), rows {sorted(rows)}")
        return problems


@pytest.mark.parametrize(
    "name, dtype",
    [
        ("single flat", "float32"),
        ("single spherical", "float32"),
        ("orders flat", "float32"),
        ("orders spherical", "float32"),
        ("orders spherical", "float64"),
        slow("single flat", "float64"),
        slow("single spherical", "float64"),
        slow("orders flat", "float64"),
    ],
)
def test_hard_cases_have_finite_values_and_gradients(name, dtype):
    problems = problems_of_hard_cases(SOLVERS[name], "radiance", dtype)
    assert not problems, "\n".join(problems)


@pytest.mark.parametrize(
    "name, dtype",
    [
        ("orders spherical", "float32"),
        *(
            slow(name, dtype)
            for name in SOLVERS
            for dtype in ("float32", "float64")
            if (name, dtype) != ("orders spherical", "float32")
        ),
    ],
)
def test_hard_cases_have_finite_reverse_gradients(name, dtype):
    problems = problems_of_hard_cases(SOLVERS[name], "radiance", dtype, reverse=True)
    assert not problems, "\n".join(problems)


@pytest.mark.parametrize(
    "name, dtype",
    [
        ("orders spherical", "float32"),
        slow("single flat", "float32"),
        slow("single spherical", "float32"),
        slow("orders flat", "float32"),
        *(slow(name, "float64") for name in SOLVERS),
    ],
)
def test_fluxes_of_hard_cases_have_finite_values_and_gradients(name, dtype):
    problems = problems_of_hard_cases(SOLVERS[name], "fluxes", dtype)
    assert not problems, "\n".join(problems)


@pytest.mark.parametrize("name", SOLVERS)
def test_views_below_the_horizon_are_black_and_the_horizon_is_not(x64, name):
    sky = compiled_sky(name, hazy(), 0.8, np.radians([89.9, 90.001, 120.0]), 0.0)
    assert np.all(sky[0] > 0.0)
    np.testing.assert_array_equal(sky[1:], 0.0)


@pytest.mark.parametrize("name", SOLVERS)
def test_twilight_falls_smoothly_through_the_horizon(x64, name):
    """The sky of a sphere does not jump where the sun sets; a flat one is black behind it."""
    above, below, later = (
        compiled_sky(name, hazy(), np.radians(sun), np.array([[0.0], [1.05]]), np.array([0.3, 1.9]))
        for sun in (90.0 - 1e-5, 90.0 + 1e-5, 93.0)
    )
    if name.endswith("flat"):
        np.testing.assert_array_equal(below, 0.0)
    else:
        np.testing.assert_allclose(below, above, rtol=1e-3)
        assert np.all(later > 0.0) and np.all(later < below)


@pytest.mark.parametrize("name", SOLVERS)
def test_an_absent_scatterer_leaves_a_black_sky(name):
    """No constituents, or only one that absorbs: radiance 0, the beam alone on the ground."""
    scene = unit_scene(60.0, views([0.0, 60.0], [0.0]))
    for atmosphere in (skyfit.Atmosphere(None, None, Ozone()), skyfit.Atmosphere(None, None, None)):
        np.testing.assert_array_equal(SOLVERS[name].radiance(atmosphere, scene), 0.0)
        flux = SOLVERS[name].fluxes(atmosphere, scene)
        np.testing.assert_array_equal(flux.diffuse_down, 0.0)
        depth = 0.0 if atmosphere.ozone is None else float(Ozone().extinction(jnp.asarray(ONE, float))[0])
        expected = np.exp(-depth / np.cos(np.radians(60.0))) * np.cos(np.radians(60.0))
        # ozone lies high: curvature shortens its path by about 1 %
        np.testing.assert_allclose(flux.direct, expected, rtol=2e-3)


@pytest.mark.parametrize("name", ["single spherical", "orders spherical", slow("single flat"), slow("orders flat")])
@pytest.mark.parametrize(
    "atmosphere",
    [
        slow(skyfit.Atmosphere(None, Aerosol(0.2), None)),
        slow(skyfit.Atmosphere(Rayleigh(), None, None)),
        skyfit.Atmosphere(None, Aerosol(0.2), Ozone()),
    ],
    ids=["haze", "air", "haze and ozone"],
)
def test_an_absent_constituent_is_one_of_depth_zero(name, atmosphere):
    alone = SOLVERS[name]
    zenith, azimuth = np.radians([10.0, 70.0, 10.0, 70.0]), np.array([0.3, 0.3, 1.9, 1.9])
    found = sky_of(alone, skyfit.Directions(zenith, azimuth))(atmosphere, jnp.asarray(0.9))
    whole = skyfit.Atmosphere(
        atmosphere.rayleigh or Rayleigh(0.0),
        atmosphere.aerosol or Aerosol(0.0),
        atmosphere.ozone or Ozone(0.0),
    )
    assert np.all(found > 0.0) and np.all(np.isfinite(found))
    # the nodes move with the scatterers present
    np.testing.assert_allclose(found, compiled_sky(name, whole, 0.9, zenith, azimuth), rtol=0.05)


@pytest.mark.parametrize("name", SOLVERS)
def test_angles_below_a_microradian_do_not_matter(name):
    """Views at the zenith and into the sun: no special direction in the radiance."""
    offset = np.array([0.0, 1e-6, 1e-4])
    sky = compiled_sky(name, hazy(), 0.6, 0.6 + offset, 0.3)
    np.testing.assert_allclose(sky, sky[:1] * np.ones((3, 1), np.float32), rtol=2e-3)
    sky = compiled_sky(name, hazy(), 0.6, offset[:2], np.array([0.0, 2.0]))
    np.testing.assert_allclose(sky[0], sky[1], rtol=1e-4)
