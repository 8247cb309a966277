"""Tables of density: the standard atmosphere, Elterman's haze, and every solver on them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from skies import COLOURS, hazy, ONE, slow, SOLVERS, unit_scene, views

import skyfit
from skyfit.atmosphere import Aerosol, Exponential, Levels, Prescribed, Rayleigh
from skyfit.tables import read_table
from skyfit.transport import SingleScattering
from skyfit.transport.columns import EARTH_RADIUS, slant_column


TABLES = {"air": Levels.us_standard_1976, "haze": Levels.elterman_1968}


# US Standard Atmosphere 1976, part 4, table I: geometric height, temperature, density ratio
@pytest.mark.parametrize(
    "height, kelvin, ratio",
    [
        (1000.0, 281.651, 9.0748e-1),
        (5000.0, 255.676, 6.0117e-1),
        (10000.0, 223.252, 3.3756e-1),
        (20000.0, 216.650, 7.2579e-2),
        (30000.0, 226.509, 1.5029e-2),
        (50000.0, 270.650, 8.3827e-4),
    ],
)
def test_the_table_has_the_printed_values(height, kelvin, ratio):
    table = read_table("us_standard_atmosphere_1976.csv")
    row = np.flatnonzero(table["height_m"] == height)[0]
    assert table["temperature_k"][row] == pytest.approx(kelvin, abs=6e-3)
    assert table["density_kg_m3"][row] / 1.2250 == pytest.approx(ratio, rel=2e-4)


def barometric(height):
    """Density over that at the ground by hydrostatics in the standard's seven layers of linear temperature."""
    base = np.array([0.0, 11.0, 20.0, 32.0, 47.0, 51.0, 71.0, 84.852])
    lapse = np.array([-6.5, 0.0, 1.0, 2.8, 0.0, -2.8, -2.0])
    # the molecular temperature at the geopotential height, km; 34.163195 K/km is g M / R
    place = 6356.766 * height / (6356.766 + height)
    temperature, pressure = 288.15, 1.0
    for low, high, rate in zip(base[:-1], base[1:], lapse, strict=True):
        step = min(place, high) - low
        if step <= 0.0:
            break
        warmer = temperature + rate * step
        cools = rate != 0.0
        pressure *= (temperature / warmer) ** (34.163195 / rate) if cools else np.exp(-34.163195 * step / temperature)
        temperature = warmer
    return pressure * 288.15 / temperature


def test_air_between_the_levels_is_the_standard_atmospheres(x64):
    air = Levels.us_standard_1976()
    height = np.linspace(0.0, 34e3, 200)
    expected = np.array([barometric(1e-3 * h) for h in height])
    found = np.asarray(air.density(jnp.asarray(height)) / air.density(jnp.asarray(0.0)))
    np.testing.assert_allclose(found, expected, rtol=2e-3)
    above = np.asarray([float(air.column_above(jnp.asarray(h))) for h in (5e3, 11e3, 20e3)])
    fine = np.linspace(0.0, 84.0, 1681)
    dense = np.array([barometric(h) for h in fine])
    whole, *parts = (np.trapezoid(dense[start:], fine[start:]) for start in (0, 100, 220, 400))
    shares = np.array(parts) / whole
    np.testing.assert_allclose(above, shares, rtol=1e-3)
    # column over density at the ground, km
    assert 1e-3 / float(air.density(jnp.asarray(0.0))) == pytest.approx(whole, rel=5e-4)


@pytest.mark.parametrize("name", TABLES)
def test_columns_on_a_sphere_are_the_integral(x64, name):
    profile = TABLES[name]()
    levels, log = np.asarray(profile.height), np.asarray(profile.log_density())
    column = jax.jit(lambda h, c: slant_column(profile, h, c, "spherical"))
    for height in (0.0, 700.0, 15e3):
        radius = EARTH_RADIUS + height
        for cosine in (1.0, 0.3, 0.02, 0.0):

            def density(s, radius=radius, cosine=cosine):
                gained = np.sqrt(radius**2 + 2.0 * radius * s * cosine + s**2) - EARTH_RADIUS
                return np.exp(np.interp(gained, levels, log))

            ends = [0.0]
            for level in levels[levels > height]:
                root = np.sqrt((radius * cosine) ** 2 + (EARTH_RADIUS + level) ** 2 - radius**2)
                ends.append(root - radius * cosine)
            expected = sum(quad(density, a, b, epsrel=1e-10)[0] for a, b in zip(ends[:-1], ends[1:], strict=True))
            assert float(column(jnp.asarray(height), jnp.asarray(cosine))) == pytest.approx(expected, rel=2e-6)


def as_levels(profile: Exponential) -> Levels:
    height = np.arange(0.0, 100e3 + 1.0, 4e3)
    return Levels(height, np.exp(-height / float(profile.scale_height)))


@pytest.mark.parametrize(
    "name",
    [
        "single flat",
        "single spherical",
        "shells flat",
        "shells spherical",
        "uniform flat",
        slow("orders spherical"),
        slow("double spherical"),
        slow("orders flat"),
    ],
)
def test_every_solver_sees_an_exponential_in_its_table(x64, name):
    """Density is exponential between levels: the sky is the same."""
    zenith = np.radians([0.0, 50.0, 85.0])[:, None]
    exponential = hazy()
    scale = Exponential(6000.0)
    air, haze = exponential.rayleigh, exponential.aerosol
    common = Aerosol(haze.optical_depth, haze.angstrom_exponent, 0.9, 0.02, haze.phase, scale)
    tabled = Aerosol(haze.optical_depth, haze.angstrom_exponent, 0.9, 0.02, haze.phase, as_levels(scale))

    def sky(aerosol, profile):
        made = skyfit.Atmosphere(Rayleigh(9e4, profile=profile), aerosol, exponential.ozone, exponential.ground)
        scene = unit_scene(65.0, views(np.degrees(zenith[:, 0]), [0.0, 100.0]), COLOURS)
        run = jax.jit(lambda a: SOLVERS[name].radiance(a, scene))
        return np.asarray(run(made))

    np.testing.assert_allclose(sky(tabled, as_levels(air.profile)), sky(common, air.profile), rtol=2e-4)


def test_single_scattering_in_eltermans_haze_is_the_integral(x64):
    """Its layer at 20 km included: by quadrature in height, flat."""
    haze = Prescribed(np.array([0.3]), Levels.elterman_1968(), skyfit.HenyeyGreenstein(0.6), np.array([0.95]))
    sun, view = np.radians(50.0), np.radians(70.0)
    levels, log = np.asarray(haze.profile.height), np.asarray(haze.profile.log_density())
    mu, mu_sun = np.cos(view), np.cos(sun)

    share_above = jax.jit(lambda h: haze.profile.column_above(h))

    def integrand(h):
        share = float(np.exp(np.interp(h, levels, log)))
        above = float(share_above(h))
        return share * np.exp(-0.3 * (above / mu_sun + (1.0 - above) / mu))

    whole = sum(quad(integrand, a, b, epsrel=1e-7)[0] for a, b in zip(levels[:-1], levels[1:], strict=True))
    cosine = mu * mu_sun + np.sin(view) * np.sin(sun) * np.cos(np.radians(40.0))
    phase = (1.0 - 0.36) / (4.0 * np.pi * (1.36 - 1.2 * cosine) ** 1.5)
    found = SingleScattering(64, "flat").radiance(
        skyfit.Atmosphere(None, haze, None), unit_scene(50.0, views([70.0], [40.0]), ONE)
    )
    assert float(found[0, 0]) == pytest.approx(0.3 * 0.95 * phase * whole / mu, rel=2e-3)


def test_gradients_of_a_table_are_central_differences(x64):
    height = jnp.array([0.0, 800.0, 1500.0, 9000.0, 4e4, 6e4])
    start = jnp.array([0.0, 1500.0, 4000.0, 12000.0, 50000.0]), jnp.array([1.0, 0.5, 0.7, 0.1, 1e-3])

    @jax.jit
    def values(scale):
        profile = Levels(start[0].at[1:].multiply(scale[:4]), start[1] * scale[4:])
        cosine = jnp.full_like(height, 0.1)
        spherical = 1e-4 * slant_column(profile, height, cosine, "spherical")
        return jnp.concatenate([profile.column_above(height), spherical, profile.reach()[None] * 1e-4])

    one = jnp.ones(9)
    slope = jax.jit(jax.jacfwd(values))(one)
    for i in range(9):
        step = 1e-6 * jnp.eye(9)[i]
        # at a level's own height the two sides differ
        central = (values(one + step) - values(one - step)) / 2e-6
        keep = np.r_[0, 1, 3:6, 6, 7, 9:13]
        np.testing.assert_allclose(slope[keep, i], central[keep], atol=1e-7)
    assert np.all(np.isfinite(slope))


def test_float32_is_near_float64_and_vmap_is_the_loop():
    height = np.array([0.0, 500.0, 7000.0, 31e3, 85.9e3, 1e5])

    @jax.jit
    def both(height):
        air = Levels.us_standard_1976()
        column = slant_column(air, height, jnp.full_like(height, 0.05), "spherical")
        return jnp.stack([air.column_above(height), air.density(height) * 1e4, column])

    narrow = both(jnp.asarray(height))
    assert narrow.dtype == jnp.float32
    loop = jnp.stack([both(h) for h in jnp.asarray(height)], axis=1)
    np.testing.assert_allclose(jax.vmap(both, out_axes=1)(jnp.asarray(height)), loop, rtol=2e-5)
    with jax.enable_x64(True):
        np.testing.assert_allclose(narrow, both(jnp.asarray(height)), rtol=3e-4, atol=1e-7)


def test_steep_tables_do_not_run_away():
    """A thin fog bank under a hundred kilometres of nothing, and a density that vanishes."""
    bank = Levels(np.array([0.0, 50.0, 60.0, 1e5]), np.array([1e-20, 1.0, 1e-20, 1e-25]))
    height = jnp.array([0.0, 55.0, 1e3, 9e4])
    for cosine in (1.0, 0.0):
        for geometry in ("flat", "spherical"):
            rays = jnp.full_like(height, cosine)
            both = jax.value_and_grad(lambda p, r=rays, g=geometry: jnp.sum(slant_column(p, height, r, g)))
            values, slope = jax.jit(both)(bank)
            assert np.isfinite(values) and all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(slope))


@pytest.mark.parametrize(
    "height, density, message",
    [
        ([0.0, 1.0], [1.0, 1.0, 1.0], "`height` and `density_at` must be 1-d"),
        ([0.0], [1.0], "two levels at least"),
        ([1.0, 2.0], [1.0, 1.0], "`height` must begin at 0"),
        ([0.0, 2.0, 1.0], [1.0, 1.0, 1.0], "`height` must increase"),
        ([0.0, 1.0], [1.0, 0.0], "`density_at` must be positive"),
    ],
)
def test_a_table_says_what_is_wrong_with_it(height, density, message):
    with pytest.raises(ValueError, match=message):
        Levels(np.array(height), np.array(density))


def test_batches_of_tables_may_be_made_and_mapped():
    made = jax.vmap(lambda d: Levels(jnp.array([0.0, 1e3, 5e3]), d))(jnp.array([[1.0, 0.5, 0.1], [1.0, 0.9, 0.2]]))
    assert made.density_at.shape == (2, 3)
    shares = jax.vmap(lambda p: p.column_above(jnp.asarray(1e3)))(made)
    assert 0.0 < float(shares[0]) < float(shares[1]) < 1.0
