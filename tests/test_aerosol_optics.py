"""What follows from a fitted haze: optical depths, exponents, albedos and radii, with their uncertainty."""

import json
from dataclasses import replace

import jax
import numpy as np
import pandas
import pytest
import xarray
from made_skies import as_sky, by_hand, EXACT, FREE, PLAIN, SOLVER

import skyfit
from skyfit.atmosphere import Atmosphere, Ground, Ozone, Rayleigh
from skyfit.light import extraterrestrial_irradiance
from skyfit.programs import keep_in
from skyfit.retrieve import SkyModel


SPHERES = ("aerosol_optical_depth", "fine_fraction", "fine_radius")
TRUTH = {"aerosol_optical_depth": 0.25, "fine_fraction": 0.8, "fine_radius": 0.18}


def spheres(values=TRUTH) -> skyfit.TwoModeAerosol:
    return skyfit.TwoModeAerosol(
        values["aerosol_optical_depth"], values["fine_fraction"], values["fine_radius"], absorption_index=0.006
    )


def sky_of_spheres(seed=None) -> skyfit.Sky:
    sun = np.asarray(extraterrestrial_irradiance(PLAIN, 6.0), float)
    scene = skyfit.Scene(0.9, 1.0, skyfit.hemisphere(40), PLAIN, sun)
    atmosphere = Atmosphere(Rayleigh(), spheres(), Ozone(), Ground())
    return as_sky(np.asarray(SOLVER.radiance(atmosphere, scene), float), seed=seed)


@pytest.fixture(scope="module")
def start():
    return SkyModel(Atmosphere(Rayleigh(), spheres({n: 1.05 * v for n, v in TRUTH.items()}), Ozone(), Ground()))


def fitted(sky, start):
    return skyfit.invert(sky, SPHERES, SOLVER, start, measurement=EXACT, guess=False)


@pytest.fixture(scope="module")
def fit(start):
    with jax.enable_x64(True):
        return fitted(sky_of_spheres(0), start)


def test_products_are_the_optics_at_the_fitted_wavelengths(x64, fit):
    products, optics = skyfit.aerosol_products(fit), skyfit.aerosol_optics(fit)
    np.testing.assert_array_equal(products.wavelength, fit.fitted_nm)
    there = skyfit.aerosol_products(fit, np.array([440.0, 675.0, 870.0]))
    for name in ("aerosol_optical_depth", "single_scattering_albedo", "asymmetry"):
        known = [optics[f"{name}_{nm}"] for nm in (440, 675, 870)]
        np.testing.assert_allclose(there[name][0], [float(k.value[0]) for k in known], rtol=1e-9)
        np.testing.assert_allclose(there[f"{name}_sigma"][0], [float(k.sigma[0]) for k in known], rtol=1e-6)
    depth, albedo = products.aerosol_optical_depth, products.single_scattering_albedo
    np.testing.assert_allclose(products.absorption_optical_depth, depth * (1.0 - albedo), rtol=1e-9)
    # the index is held fixed, the depth is not
    np.testing.assert_allclose(products.refractive_index, 1.40, rtol=1e-6)
    assert np.all(products.refractive_index_sigma == 0.0)
    # 550 nm, where the optical depth is the parameter
    at = skyfit.aerosol_products(fit, np.array([550.0]))
    place = fit.free.index("aerosol_optical_depth")
    assert at.aerosol_optical_depth.item() == pytest.approx(fit.values[0, place], rel=1e-6)
    assert at.aerosol_optical_depth_sigma.item() == pytest.approx(fit.sigma[0, place], rel=1e-4)


def test_the_size_distribution_holds_the_volumes_and_its_sigma_is_that_of_the_parameters(x64, fit):
    radius = np.geomspace(0.005, 100.0, 2001)
    products = skyfit.aerosol_products(fit, radius_um=radius)
    density = products.volume_size_distribution[0].values
    for name, part in (("fine_volume", radius < 0.75), ("coarse_volume", radius > 0.75)):
        found = np.trapezoid(density[part], np.log(radius[part]))
        assert found == pytest.approx(products[name].item(), rel=0.05), name
    whole = products.fine_volume.item() + products.coarse_volume.item()
    assert np.trapezoid(density, np.log(radius)) == pytest.approx(whole, rel=1e-4)
    surface = 3.0 * np.trapezoid(density / radius, np.log(radius))
    assert 3.0 * whole / surface == pytest.approx(products.effective_radius.item(), rel=1e-3)
    # the fine radius alone moved by its sigma, the others with it as they are correlated
    row, place = fit.values[0].copy(), fit.free.index("fine_radius")
    row = row + fit.covariance[0, place] / fit.sigma[0, place]
    moved = replace(fit, values=row[None])
    change = skyfit.aerosol_products(moved, radius_um=radius).volume_size_distribution[0] - density
    assert np.all(np.abs(change) <= 1.1 * products.volume_size_distribution_sigma[0] + 1e-6)


def test_kept_programs_give_the_same(x64, fit, tmp_path):
    plain = skyfit.aerosol_optics(fit), skyfit.aerosol_products(fit)
    keep_in(tmp_path)
    try:
        kept = skyfit.aerosol_optics(fit), skyfit.aerosol_products(fit)
    finally:
        keep_in(None)
    assert len(list(tmp_path.glob("derived-*.exported"))) == 2
    assert list(kept[0]) == list(plain[0]) and list(kept[1]) == list(plain[1])
    for name, one in plain[0].items():
        np.testing.assert_allclose([kept[0][name].value, kept[0][name].sigma], [one.value, one.sigma], rtol=1e-9)
    xarray.testing.assert_allclose(kept[1], plain[1], rtol=1e-9)


@pytest.mark.parametrize("name", ["aerosol.nc", "aerosol.csv"])
def test_products_are_read_back(x64, fit, name, tmp_path):
    products = skyfit.aerosol_products(fit)
    skyfit.write_products(products, tmp_path / name)
    if name.endswith("nc"):
        with xarray.open_dataset(tmp_path / name) as back:
            xarray.testing.assert_allclose(back.load(), products)
        return
    table = pandas.read_csv(tmp_path / name)
    assert set(table.quantity) == {n for n in products if not n.endswith("_sigma")}
    depth = table[table.quantity == "aerosol_optical_depth"]
    np.testing.assert_allclose(depth.wavelength_nm, fit.fitted_nm, rtol=1e-6)
    np.testing.assert_allclose(depth.value, products.aerosol_optical_depth[0], rtol=1e-6)
    np.testing.assert_allclose(depth.sigma, products.aerosol_optical_depth_sigma[0], rtol=1e-3)
    sizes = table[table.quantity == "volume_size_distribution"]
    assert len(sizes) == 22 and set(sizes.unit) == {"um3/um2"} and sizes.wavelength_nm.isna().all()


def test_products_say_what_they_cannot(x64, fit, tmp_path):
    with pytest.raises(ValueError, match="wavelength"):
        skyfit.aerosol_products(fit, np.array([200.0]))
    with pytest.raises(ValueError, match="`radius_um` must be"):
        skyfit.aerosol_products(fit, radius_um=np.zeros(1))
    with pytest.raises(ValueError, match="expected a suffix of .nc or .csv, found '.txt'"):
        skyfit.write_products(skyfit.aerosol_products(fit), tmp_path / "aerosol.txt")


def test_an_angstrom_haze_has_the_optics_that_its_laws_say(x64):
    fit = skyfit.invert(as_sky(by_hand()), FREE, SOLVER, measurement=EXACT)
    depth, exponent, asymmetry = fit.values[0]
    found = skyfit.aerosol_optics(fit)
    for nm in (440, 675, 870):
        expected = depth * (nm / 550.0) ** -exponent
        assert found[f"aerosol_optical_depth_{nm}"].value[0] == pytest.approx(expected, rel=1e-9)
        assert found[f"asymmetry_{nm}"].value[0] == pytest.approx(asymmetry, rel=1e-9)
        # nothing that is free moves it
        assert found[f"single_scattering_albedo_{nm}"].value[0] == pytest.approx(0.95, rel=1e-9)
        assert found[f"single_scattering_albedo_{nm}"].sigma[0] == 0.0
    assert found["angstrom_exponent_440_870"].value[0] == pytest.approx(exponent, rel=1e-9)
    assert found["angstrom_exponent_440_870"].sigma[0] == pytest.approx(fit.sigma[0, 1], rel=1e-9)
    assert "effective_radius" not in found


def test_sigma_of_the_optics_is_the_spread_over_noise(x64, start):
    fit = fitted(sky_of_spheres(0), start)
    found = skyfit.aerosol_optics(fit)
    draws = np.random.default_rng(1).multivariate_normal(fit.values[0], fit.covariance[0], 4000)
    aerosols = [spheres(dict(zip(SPHERES, row, strict=True))) for row in draws[:300]]
    radii = np.array([float(one.effective_radius) for one in aerosols])
    depths = np.array([np.asarray(one.optical_depth_at(np.array([440.0, 870.0]))) for one in aerosols])
    exponents = np.log(depths[:, 0] / depths[:, 1]) / np.log(870.0 / 440.0)
    for name, sample, unit in (
        ("effective_radius", radii, "um"),
        ("angstrom_exponent_440_870", exponents, "1"),
        ("aerosol_optical_depth_440", depths[:, 0], "1"),
    ):
        value, sigma, in_unit = found[name]
        assert in_unit == unit
        # of 300 draws a standard deviation is known within 4 %
        assert sigma[0] == pytest.approx(np.std(sample), rel=0.15) and sigma[0] > 0.0
        assert value[0] == pytest.approx(np.mean(sample), abs=0.2 * sigma[0])


def test_particles_come_back_from_single_scattering(x64, start):
    for seed in range(3):
        fit = fitted(sky_of_spheres(seed), start)
        assert fit.result == ("successful",)
        np.testing.assert_array_less(np.abs(fit.values[0] - list(TRUTH.values())), 3.0 * fit.sigma[0])


def test_the_record_holds_the_optics_and_the_spheres(start, tmp_path):
    fit = fitted(sky_of_spheres(0), start)
    skyfit.save(fit, tmp_path / "fit.json")
    record = json.loads((tmp_path / "fit.json").read_text())
    assert record["atmosphere"]["constituents"]["aerosol"]["kind"] == "TwoModeAerosol"
    haze = record["times"][0]["haze"]
    assert haze["effective_radius"]["unit"] == "um" and 0.1 < haze["effective_radius"]["value"] < 0.5
    assert record["fixed"]["absorption_index"]["value"] == pytest.approx(0.006)
    again = skyfit.load(tmp_path / "fit.json")
    np.testing.assert_allclose(skyfit.predict(again, fit.sky), fit.model, rtol=1e-5)


def test_haze_given_per_wavelength_and_no_haze_have_none():
    air = SkyModel(Atmosphere(Rayleigh(), None, Ozone(), Ground()))
    fit = skyfit.invert(as_sky(by_hand(aerosol_optical_depth=0.0)), ("ground_albedo", "ozone"), SOLVER, air)
    assert skyfit.aerosol_optics(fit) == {}
