"""Spheres in bins of radius: their optics by another Mie code, their fit, and the prior of smoothness."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import miepython
import numpy as np
import pytest
from made_skies import as_sky, OWN_NOISE, PLAIN, SOLVER

import skyfit
from skyfit.atmosphere import BIN_RADII, describe, from_description, Ground, Ozone, Rayleigh
from skyfit.light import extraterrestrial_irradiance
from skyfit.retrieve import BINS_FREE, SkyModel, start_model, values_of, with_values
from skyfit.retrieve.parameters import SIZE_BINS


WAVELENGTH = np.array([440.0, 675.0, 1020.0])


def haze(depth=0.3, **index) -> skyfit.BinnedAerosol:
    modes = skyfit.TwoModeAerosol(depth, 0.6, 0.17, 2.1, 0.45, 0.65, 1.46, 0.01)  # pyright: ignore[reportCallIssue]
    return replace(skyfit.BinnedAerosol.like(modes), **index)


@eqx.filter_jit
def optics(made):
    """Optical depth, albedo, moments, phase function and scattering matrix at `WAVELENGTH`."""
    nm, half = jnp.asarray(WAVELENGTH), jnp.asarray([0.0, 1e-4, 0.1, 0.5, 1.0])
    depth, albedo = made.optical_depth_at(nm), made.single_scattering_albedo_at(nm)
    return depth, albedo, made.phase.moments(3, nm), made.phase.at_haversine(half, nm), made.phase.matrix(half, nm)


def by_miepython(radius, density, indices):
    """Optical depth, albedo and asymmetry at `WAVELENGTH` of dV/dlnr at radii in um, by trapezoids."""
    found = []
    for nm, index in zip(WAVELENGTH, indices, strict=True):
        extinction, scattering, _, cosine = miepython.efficiencies(index, 2.0 * radius, 1e-3 * nm)
        # cross-section over volume
        share = 0.75 * density / radius
        sums = [np.trapezoid(share * q, np.log(radius)) for q in (extinction, scattering, scattering * cosine)]
        found.append((sums[0], sums[1] / sums[0], sums[2] / sums[1]))
    return np.array(found).T


def test_optics_are_those_of_another_mie_code_with_an_index_of_each_wavelength(x64):
    made = haze(
        refractive_index_slope=-0.04, absorption_index_exponent=1.5, absorption_index_curvature=0.5,
    )  # fmt: skip
    x = np.log(WAVELENGTH / 550.0)
    n, k = 1.46 - 0.04 * x, 0.01 * np.exp(-1.5 * x + 0.5 * x**2)
    np.testing.assert_allclose(made.index_at(jnp.asarray(WAVELENGTH)), [n, k], rtol=1e-12)
    radius = np.geomspace(0.02, 30.0, 700)
    density = np.asarray(made.volume_size_distribution(jnp.asarray(radius)))
    depth, albedo, mean = by_miepython(radius, density, n - 1j * k)
    np.testing.assert_allclose(optics(made)[0], depth, rtol=2e-3)
    np.testing.assert_allclose(optics(made)[1], albedo, atol=5e-4)
    np.testing.assert_allclose(optics(made)[2][1], mean, atol=1e-3)


def test_a_stated_size_distribution_has_the_optics_of_its_straight_lines(x64):
    """Narrow modes, whose bins as they stand would be wider; more radii than bins, and fewer."""
    fine = np.geomspace(0.05, 15.0, 21 * 25 + 1)
    few = np.array([0.08, 0.2, 0.5, 1.5, 4.0, 10.0])
    for radii, limit in ((BIN_RADII, 3e-3), (np.geomspace(0.06, 9.0, 40), 6e-3), (few, 1e-2)):
        x = np.log(radii)
        volume = 0.03 * np.exp(-0.5 * ((x - np.log(0.16)) / 0.4) ** 2) + 0.02 * np.exp(-0.5 * ((x - 1.0) / 0.45) ** 2)
        lines = np.interp(np.log(fine), x, volume, left=0.0, right=0.0)
        settings = {"refractive_index": 1.47, "absorption_index": 0.008}
        made = skyfit.BinnedAerosol.from_size_distribution(radii, volume, **settings)
        depth, albedo, mean = by_miepython(fine, lines, np.full(3, 1.47 - 0.008j))
        np.testing.assert_allclose(optics(made)[0], depth, rtol=limit)
        np.testing.assert_allclose(optics(made)[1], albedo, atol=1e-3)
        np.testing.assert_allclose(optics(made)[2][1], mean, atol=0.4 * limit)
        assert float(made.volumes.sum()) == pytest.approx(np.trapezoid(lines, np.log(fine)), rel=2.0 * limit)


@pytest.mark.parametrize(
    "radii, volume, words",
    [
        ([0.1, 0.2], [0.1], "of one length"),
        ([0.1], [0.1], "2 at least"),
        ([0.2, 0.1], [0.1, 0.1], "must increase"),
        ([0.1, 0.2], [0.1, -0.1], "`volume`"),
        ([0.0, 0.2], [0.1, 0.1], "`radius_um`"),
    ],
)
def test_a_size_distribution_that_is_none_is_refused(radii, volume, words):
    with pytest.raises(ValueError, match=words):
        skyfit.BinnedAerosol.from_size_distribution(radii, volume)


def test_an_index_that_does_not_change_is_that_of_the_two_modes(x64):
    modes = skyfit.TwoModeAerosol(0.3, 0.6, 0.17, 2.1, 0.45, 0.65, 1.46, 0.01)  # pyright: ignore[reportCallIssue]
    bins = haze()
    (depth, _, _, value, matrix), expected = optics(bins), optics(modes)
    np.testing.assert_allclose(depth, expected[0], rtol=2e-3)
    np.testing.assert_allclose(value, expected[3], rtol=6e-3)
    np.testing.assert_allclose(matrix, expected[4], atol=2e-3)
    back = from_description(describe(skyfit.Atmosphere(aerosol=bins)))
    assert eqx.tree_equal(back.aerosol, bins, rtol=1e-12) and back.aerosol.phase is not None
    empty = replace(bins, bins=np.zeros(BIN_RADII.size))
    assert np.all(optics(empty)[0] == 0.0) and all(np.all(np.isfinite(part)) for part in optics(empty))
    with pytest.raises(ValueError, match="`bins` must hold 22 numbers, got"):
        replace(bins, bins=np.ones(3))


def test_volumes_and_effective_radii_are_those_of_the_distribution(x64):
    made, radius = haze(), np.geomspace(1e-3, 1e3, 200001)
    density = np.asarray(made.volume_size_distribution(jnp.asarray(radius)))
    inside = (BIN_RADII > 0.43) & (BIN_RADII < 1.0)
    at = np.interp(np.log(BIN_RADII[inside]), np.log(radius), density)
    parting = BIN_RADII[inside][np.argmin(at)]
    found = zip(made.volumes, (made.fine_effective_radius, made.coarse_effective_radius), strict=True)
    for part, (volume, effective) in zip((radius < parting, radius >= parting), found, strict=True):
        whole = np.trapezoid(density[part], np.log(radius[part]))
        surface = np.trapezoid(density[part] / radius[part], np.log(radius[part]))
        assert float(volume) == pytest.approx(whole, rel=1e-3)
        assert float(effective) == pytest.approx(whole / surface, rel=1e-3)
    surface = np.trapezoid(density / radius, np.log(radius))
    assert float(made.effective_radius) == pytest.approx(np.trapezoid(density, np.log(radius)) / surface, rel=1e-6)


def test_slopes_by_every_bin_are_finite_and_those_of_differences(x64):
    nm = jnp.asarray(WAVELENGTH)

    def optics(bins):
        made = replace(haze(), bins=bins)
        return jnp.concatenate([made.optical_depth_at(nm), made.phase.at_haversine(jnp.array([0.3]), nm)[0]])

    bins = haze().bins
    slope = jax.jit(jax.jacfwd(optics))(bins)
    step = 1e-4 * bins[9]
    moved = [jax.jit(optics)(bins.at[9].add(sign * step)) for sign in (1.0, -1.0)]
    np.testing.assert_allclose(slope[:, 9], (moved[0] - moved[1]) / (2.0 * step), rtol=1e-5, atol=1e-8)
    assert np.all(np.isfinite(slope))


def test_one_bin_is_set_among_the_others():
    model = start_model(BINS_FREE, 101325.0)
    before = values_of(model, SIZE_BINS)
    after = values_of(with_values(model, ("size_bin_3", "ozone"), [0.5, 310.0]), SIZE_BINS)
    assert after.pop("size_bin_3") == pytest.approx(0.5) and before.pop("size_bin_3") != pytest.approx(0.5)
    assert after == before


def sky_and_start(seed: int) -> tuple[skyfit.Sky, SkyModel]:
    """A sky of light scattered once under modes that no bells make, and a start off it."""
    truth = skyfit.TwoModeAerosol(0.3, 0.6, 0.16, 2.3, 0.5, 0.7, 1.45, 0.01)  # pyright: ignore[reportCallIssue]
    air = skyfit.Atmosphere(Rayleigh(), truth, Ozone(), Ground())
    view = skyfit.hemisphere(40)
    sun = np.asarray(extraterrestrial_irradiance(PLAIN, 6.0), float)
    radiance = np.asarray(SOLVER.radiance(air, skyfit.Scene(0.9, 1.0, view, PLAIN, sun)), float)
    return as_sky(radiance, seed=seed), SkyModel(air.replace(aerosol=haze(0.2)))


@pytest.mark.slow
def test_bins_come_back_and_sigma_is_that_of_data_and_prior(x64):
    """Of light scattered once: the covariance by normal equations in NumPy, slopes by forward differentiation."""
    sky, start = sky_and_start(0)
    free = (*SIZE_BINS, "refractive_index", "absorption_index")
    measurement = replace(OWN_NOISE, loss="squares")
    fit = skyfit.invert(sky, free, SOLVER, start, measurement=measurement, guess=False)
    assert fit.result == ("successful",)
    truth = skyfit.TwoModeAerosol(0.3, 0.6, 0.16, 2.3, 0.5, 0.7, 1.45, 0.01)  # pyright: ignore[reportCallIssue]
    products = skyfit.aerosol_products(fit)
    off = products.volume_size_distribution[0] - truth.volume_size_distribution(jnp.asarray(BIN_RADII))
    within = np.abs(off.values) < 2.0 * products.volume_size_distribution_sigma[0].values
    counted = (BIN_RADII > 0.1) & (BIN_RADII < 5.0)
    assert within[counted].mean() >= 0.9
    assert products.fine_effective_radius.item() == pytest.approx(float(truth.fine_effective_radius), rel=0.15)

    def radiance(scaled):
        model = with_values(start, free, [*jnp.exp(scaled[:22]), scaled[22], jnp.exp(scaled[23])])
        sun = jnp.asarray(extraterrestrial_irradiance(PLAIN, 6.0))
        return SOLVER.radiance(model.atmosphere, skyfit.Scene(0.9, 1.0, skyfit.hemisphere(40), PLAIN, sun)).ravel()

    scaled = np.log(fit.values[0])
    scaled[22] = fit.values[0, 22]
    rows = np.asarray(jax.jit(jax.jacfwd(radiance))(jnp.asarray(scaled))) / sky.sigma.reshape(-1, 1)
    bends = (np.eye(22)[:-2] - 2.0 * np.eye(22)[1:-1] + np.eye(22)[2:]) @ np.eye(22, 24)
    ends = np.eye(24)[[0, 21, 22, 23]] / np.array([2.0, 2.0, 0.06, 0.008 / 0.006])[:, None]
    every = np.concatenate([rows / fit.scale[0], bends, ends])
    unit = np.append(fit.values[0, :22], [1.0, fit.values[0, 23]])
    expected = np.sqrt(np.diag(np.linalg.inv(every.T @ every))) * unit
    np.testing.assert_allclose(fit.sigma[0], expected, rtol=0.02)
