"""Skies that other solvers made, with 1 % noise, give the haze back that went into them."""

import numpy as np
import pytest
from foreign_skies import oracle_skies, random_truths, sasktran2_radiance, sasktran2_sky, Truth, with_noise

import skyfit
from skyfit.fit import DEFAULT_FREE


FREE = ("aerosol_optical_depth", "angstrom_exponent", "single_scattering_albedo", "asymmetry", "ground_albedo")
SOLVER = skyfit.OrdersOfScattering.normal("flat")
# of errors and of sigmas; the albedo where the haze is no thinner than HAZY
LIMITS = {"aerosol_optical_depth": 0.005, "angstrom_exponent": 0.05, "single_scattering_albedo": 0.02}
HAZY = 0.2


@pytest.fixture
def sasktran2():
    return pytest.importorskip("sasktran2", reason="sasktran2 is absent")


def asked(truths, free=FREE):
    """Which values have a limit, `[sky, parameter]`, and the limits `[parameter]`."""
    limits = np.array([LIMITS.get(name, np.inf) for name in free])
    hazy = np.array([truth.aerosol_optical_depth >= HAZY for truth in truths])
    albedo = np.array([name == "single_scattering_albedo" for name in free])
    return np.isfinite(limits)[None] & (hazy[:, None] | ~albedo[None]), limits


def test_haze_of_sasktran2s_skies_is_recovered_within_the_limits_and_the_error_bars(x64, sasktran2):
    truths = random_truths(8, seed=11)
    errors, sigmas, bias = [], [], []
    for seed, truth in enumerate(truths):
        clean = sasktran2_sky(truth)
        fit, exact = skyfit.invert(with_noise(clean, seed), FREE, SOLVER), skyfit.invert(clean, FREE, SOLVER)
        assert fit.result == exact.result == ("successful",)
        assert fit.reduced_chi_square[0] == pytest.approx(1.0, abs=0.35)
        # what noise leaves untouched is the difference of the two solvers
        np.testing.assert_allclose(exact.model, clean.radiance, rtol=2e-3)
        errors.append(fit.values[0] - truth.values(FREE))
        bias.append((exact.values[0] - truth.values(FREE)) / exact.sigma[0])
        sigmas.append(fit.sigma[0])
    errors, sigmas = np.array(errors), np.array(sigmas)
    kept, limits = asked(truths)
    assert kept.sum(axis=0).tolist()[:2] == [8, 8] and kept[:, 2].sum() >= 4
    assert np.all((np.abs(errors) <= limits) | ~kept), errors
    assert np.all((sigmas <= limits) | ~kept), sigmas
    assert np.mean(np.abs(errors) <= 2.0 * sigmas) >= 0.9
    assert np.max(np.abs(bias)) < 0.6, bias


@pytest.mark.slow
def test_haze_of_the_shared_oracles_skies_is_recovered(x64, shared):
    """136 samples of two colours on two meridians: the error bar of the depth comes near its limit."""
    truths, errors, sigmas = [], [], []
    for place, (truth, sky, start) in enumerate(oracle_skies(shared / "oracles" / "oracle_pp_aerosol.npz")):
        exact = skyfit.invert(sky, FREE, SOLVER, start)
        assert np.all(np.abs(exact.values[0] - truth.values(FREE)) < 0.1 * exact.sigma[0])
        for seed in range(2):
            fit = skyfit.invert(with_noise(sky, 1000 * place + seed), FREE, SOLVER, start)
            assert fit.result == ("successful",)
            truths.append(truth)
            errors.append(fit.values[0] - truth.values(FREE))
            sigmas.append(fit.sigma[0])
    assert len(truths) == 48
    errors, sigmas = np.abs(errors), np.array(sigmas)
    kept, limits = asked(truths)
    assert np.all((sigmas <= limits) | ~kept), sigmas.max(axis=0)
    within_limits, within_bars = np.mean((errors <= limits)[kept]), np.mean(errors <= 2.0 * sigmas)
    assert within_limits >= 0.9 and within_bars >= 0.9, (within_limits, within_bars)


@pytest.mark.slow
def test_haze_of_two_lobes_is_recovered_with_the_default_parameters(x64, sasktran2):
    off = []
    for seed, truth in enumerate(random_truths(6, seed=2, two_lobes=True)):
        fit = skyfit.invert(with_noise(sasktran2_sky(truth), seed), solver=SOLVER)
        assert fit.result == ("successful",) and fit.free == DEFAULT_FREE
        at = [DEFAULT_FREE.index(name) for name in (*LIMITS, "ground_albedo", "pointing_zenith", "pointing_azimuth")]
        off.append(((fit.values[0] - truth.values(DEFAULT_FREE)) / fit.sigma[0])[at])
    assert np.mean(np.abs(off) <= 2.0) >= 0.9, off


@pytest.mark.slow
@pytest.mark.parametrize("truth", [Truth(70.0, 0.6, 2.0, 0.8, 0.8, 0.05), Truth(50.0, 0.6, 0.3, 0.98, 0.8, 0.6)])
def test_sasktran2_has_enough_streams_and_layers(sasktran2, truth):
    fine = sasktran2_radiance(truth, streams=32, layers=240)
    np.testing.assert_allclose(sasktran2_radiance(truth), fine, rtol=4e-4)
