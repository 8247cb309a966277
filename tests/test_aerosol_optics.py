"""What follows from a fitted haze: optical depths, exponents, albedos and radii, with their uncertainty."""

import json

import numpy as np
import pytest
from made_skies import as_sky, by_hand, EXACT, FREE, PLAIN, SOLVER

import skyfit
from skyfit.atmosphere import Atmosphere, Ground, Ozone, Rayleigh
from skyfit.light import extraterrestrial_irradiance
from skyfit.retrieve import SkyModel


pytestmark = pytest.mark.usefixtures("haste")
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
