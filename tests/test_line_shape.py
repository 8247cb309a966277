"""The width of a spectrometer's lines: told, or found in the measured spectra."""

from dataclasses import replace

import numpy as np
import pytest
from made_skies import as_sky, by_hand, EXACT, FREE, HAZE, PLAIN, SOLVER

import skyfit
from skyfit.light import extraterrestrial_irradiance
from skyfit.measured.quality.line_shape import estimate_fwhm


def test_the_line_shape_of_the_file_or_of_the_call_is_used(x64):
    radiance = by_hand(fwhm_nm=11.0)
    told = skyfit.invert(as_sky(radiance, fwhm_nm=11.0), FREE, SOLVER, measurement=EXACT)
    given = skyfit.invert(as_sky(radiance, fwhm_nm=np.nan), FREE, SOLVER, fwhm_nm=11.0, measurement=EXACT)
    for fit in (told, given):
        assert fit.fwhm_nm == 11.0
        np.testing.assert_allclose(fit.model, fit.sky.radiance, rtol=1e-4)
    unknown = skyfit.invert(as_sky(radiance, fwhm_nm=np.nan), FREE, SOLVER, measurement=EXACT)
    assert np.isnan(unknown.fwhm_nm) and unknown.rmse[0] > 10.0 * told.rmse[0]
    assert any("line shape" in note for note in unknown.notes)


def sunlight(wavelength_nm, width=5.0):
    """A sky whose spectrum is the sun's through a Gaussian line, times what is smooth; 5 directions."""
    spectrum = np.asarray(extraterrestrial_irradiance(wavelength_nm, width), float)
    spectrum = spectrum * (0.1 * (wavelength_nm / 500.0) ** -3.2 + 0.02)
    return np.linspace(1.0, 2.0, 5)[:, None] * spectrum


@pytest.mark.parametrize("width", [2.0, 5.0, 8.5])
def test_the_width_of_the_lines_is_found_in_fine_spectra(width):
    fine = np.arange(370.0, 691.0, 1.0)
    # noise of 0.1 % is what a mean over a scan has left
    sky = as_sky(sunlight(fine, width), 1e-3, seed=7, wavelength_nm=fine)
    assert estimate_fwhm(sky) == pytest.approx(width, abs=0.3)


def test_an_unknown_width_is_estimated_and_said(x64):
    fine = np.arange(470.0, 520.0, 1.0)
    sky = as_sky(by_hand(wavelength_nm=fine, fwhm_nm=7.0), wavelength_nm=fine, fwhm_nm=np.nan)
    fit = skyfit.invert(sky, FREE, SOLVER, measurement=EXACT)
    assert fit.fwhm_nm == pytest.approx(7.0, abs=0.25)
    assert f"line shape estimated from the solar lines: {fit.fwhm_nm:g} nm FWHM" in fit.notes
    # 40 of the 50 wavelengths are fitted, all are modelled
    assert fit.used.all() and np.isfinite(fit.model).all() and fit.result == ("successful",)
    assert np.all(np.abs(fit.values[0] - list(HAZE.values())) < 4.0 * fit.sigma[0])


def test_coarse_short_or_broken_spectra_tell_no_width():
    fine = np.arange(400.0, 480.0, 1.0)
    sky = as_sky(sunlight(fine), wavelength_nm=fine)
    assert np.isfinite(estimate_fwhm(sky))
    assert np.isnan(estimate_fwhm(as_sky(sunlight(PLAIN))))
    coarse = np.arange(380.0, 681.0, 3.0)
    assert np.isnan(estimate_fwhm(as_sky(sunlight(coarse), wavelength_nm=coarse)))
    assert np.isnan(estimate_fwhm(sky.select(fine[:30])))
    holes = sky.usable.copy()
    holes[:, :, 40] = False
    assert np.isnan(estimate_fwhm(replace(sky, usable=holes)))
