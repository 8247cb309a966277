"""Views that follow the sun from one wavelength to the next, and the beam as an optical depth."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from made_skies import EXACT

import skyfit
from skyfit.light import extraterrestrial_irradiance
from skyfit.measured import mask_sun, read, write_sky
from skyfit.records import write_prediction


SOLVER = skyfit.SingleScattering.draft("flat")
FREE = ("aerosol_optical_depth", "angstrom_exponent", "asymmetry")
TRUTH = np.array([0.2, 1.1, 0.65])
WAVELENGTH = np.array([440.0, 675.0, 870.0])
AWAY = np.radians([-150.0, -90.0, -40.0, -20.0, -10.0, -5.0, -3.0, 3.0, 5.0, 10.0, 20.0, 40.0, 90.0, 150.0])
# the sun falls by a degree a wavelength, which turns the aureole by as much
SUN_ZENITH, SUN_AZIMUTH = np.radians([[50.0, 51.0, 52.0]]), np.radians([[200.0, 201.0, 202.0]])
IRRADIANCE = np.asarray(extraterrestrial_irradiance(WAVELENGTH, 10.0), float)


def air():
    haze = skyfit.Aerosol(*TRUTH[:2], 0.95, 0.0, skyfit.HenyeyGreenstein(TRUTH[2]))
    return skyfit.Atmosphere(skyfit.Rayleigh(101325.0), haze, skyfit.Ozone(300.0), skyfit.Ground(0.1))


def almucantar(**about):
    """One scan of an almucantar whose three filters each look under a sun of their own."""
    zenith = np.broadcast_to(SUN_ZENITH[:, None], (1, AWAY.size, 3)).copy()
    azimuth = SUN_AZIMUTH[:, None] + AWAY[None, :, None]
    light = np.empty(zenith.shape)
    for w in range(3):
        view = skyfit.Directions(zenith[0, :, w], azimuth[0, :, w])
        scene = skyfit.Scene(SUN_ZENITH[0, w], SUN_AZIMUTH[0, w], view, WAVELENGTH[w : w + 1], IRRADIANCE[w : w + 1])
        light[0, :, w] = np.asarray(SOLVER.radiance(air(), scene), float)[:, 0]
    return skyfit.Sky(
        radiance=light, sigma=0.01 * light, usable=np.ones(light.shape, bool), view_zenith=zenith.mean(axis=2),
        view_azimuth=azimuth.mean(axis=2), view_zenith_by_wavelength=zenith, view_azimuth_by_wavelength=azimuth,
        wavelength_nm=WAVELENGTH, sun_zenith=SUN_ZENITH, sun_azimuth=SUN_AZIMUTH, pressure_pa=101325.0, fwhm_nm=10.0,
        time=np.array(["NaT"], "datetime64[ns]"), instrument="a photometer", source="made", **about,
    )  # fmt: skip


def test_each_wavelength_is_seen_where_it_looks(x64):
    fit = skyfit.invert(almucantar(), FREE, SOLVER, measurement=EXACT)
    assert fit.values[0] == pytest.approx(TRUTH, rel=1e-3) and fit.reduced_chi_square[0] < 1e-3
    np.testing.assert_allclose(fit.model, almucantar().radiance, rtol=2e-3)
    # as their means the views explain the sky no longer
    blurred = replace(almucantar(), view_zenith_by_wavelength=None, view_azimuth_by_wavelength=None)
    assert skyfit.invert(blurred, FREE, SOLVER, measurement=EXACT).reduced_chi_square[0] > 1.0


def test_a_sun_that_stands_still_goes_with_views_that_move(x64):
    """Filters that look elsewhere, one after the other, under one sun."""
    sky = almucantar()
    mean = {"sun_zenith": SUN_ZENITH.mean(axis=1), "sun_azimuth": SUN_AZIMUTH.mean(axis=1)}
    fit = skyfit.invert(replace(sky, **mean), FREE, SOLVER, measurement=EXACT, max_steps=1)
    assert fit.model.shape == sky.radiance.shape and np.isfinite(fit.model).all()


def test_what_a_sky_does_with_its_moving_views(tmp_path):
    sky = almucantar()
    write_sky(sky, tmp_path / "sky.nc")
    again = read(tmp_path / "sky.nc")
    for name in ("view_zenith_by_wavelength", "view_azimuth_by_wavelength", "sun_zenith", "radiance", "view_zenith"):
        np.testing.assert_allclose(getattr(again, name), getattr(sky, name), atol=1e-9)
    assert again.instrument == "a photometer" and again.notes == () and again.fwhm_nm == 10.0
    half = sky.select(np.array([557.5, 870.0]))
    assert half.view_zenith_by_wavelength is not None
    np.testing.assert_allclose(np.degrees(half.view_zenith_by_wavelength[0, 0]), [50.5, 52.0])
    # three degrees of azimuth are 2.3 or more from the sun here, at each wavelength alike
    near = mask_sun(sky, np.radians(2.5))
    np.testing.assert_array_equal(near.usable[0, :, 0], np.abs(AWAY) > np.radians(4.0))
    np.testing.assert_array_equal(near.usable[0, :, 0], near.usable[0, :, 2])
    with pytest.raises(ValueError, match=r"sky\.csv: a CSV has no place for views that move between wavelengths"):
        write_sky(sky, tmp_path / "sky.csv")
    assert not (tmp_path / "sky.csv").exists()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"view_azimuth_by_wavelength": None}, "must be given together"),
        (
            {"view_zenith_by_wavelength": np.zeros((1, 2, 3))},
            r"`view_zenith_by_wavelength` must have shape \(1, 14, 3\)",
        ),
        ({"view_zenith_by_wavelength": np.full((1, 14, 3), 4.0)}, r"must be in \[0, 3.14159\] rad, got 4 to 4"),
        ({"view_azimuth_by_wavelength": np.full((1, 14, 3), 90.0)}, r"must be in \[-21.9911, 21.9911\] rad, got 90"),
        ({"view_zenith_by_wavelength": np.full((1, 14, 3), 1.7)}, "must be False where .* below the horizon"),
        ({"aerosol_optical_depth": np.zeros(3)}, r"`aerosol_optical_depth` must have shape \(1, 3\)"),
    ],
)
def test_views_that_no_instrument_has(changes, said):
    with pytest.raises(ValueError, match=said):
        replace(almucantar(), **changes)


def depths(sigma=0.003):
    """Of the made haze at each wavelength."""
    values = np.asarray(air().aerosol.optical_depth_at(jax.numpy.asarray(WAVELENGTH)), float)[None]
    return {"aerosol_optical_depth": values, "aerosol_optical_depth_sigma": np.full((1, 3), sigma)}


def test_the_beam_as_an_optical_depth_is_fitted(x64, tmp_path):
    """Where the sky's scale is lost, the optical depths alone tell the amount of haze."""
    lost = replace(almucantar(**depths()), sigma=None, radiance=1.1 * almucantar().radiance)
    settings = {"measurement": skyfit.NoiseModel(relative=0.01, calibration=0.5, model_error=0.0)}
    fit = skyfit.invert(lost, FREE, SOLVER, **settings)
    assert fit.values[0] == pytest.approx(TRUTH, rel=5e-3)
    assert fit.calibration[0] == pytest.approx(1.1, rel=5e-3) and fit.sigma[0, 0] < 0.004
    write_sky(lost, tmp_path / "sky.nc")
    again = read(tmp_path / "sky.nc")
    np.testing.assert_allclose(again.aerosol_optical_depth, lost.aerosol_optical_depth, rtol=1e-12)
    np.testing.assert_allclose(again.aerosol_optical_depth_sigma, 0.003)
    with pytest.raises(ValueError, match=r"sky\.csv: a CSV has no place for aerosol optical depths"):
        write_sky(lost, tmp_path / "sky.csv")


def test_a_fit_to_moving_views_is_kept_predicted_and_one_of_many(tmp_path):
    sky = almucantar(**depths(), direct_irradiance=np.full((1, 3), 0.5))
    fit = skyfit.invert(sky, FREE, SOLVER, measurement=EXACT)
    assert "direct irradiance not used beside the optical depths of the same beam" in fit.notes
    many = skyfit.fit_many(sky, FREE, solver=SOLVER, measurement=EXACT, draft=SOLVER)
    np.testing.assert_allclose(many.values, fit.values, rtol=2e-3)
    assert set(many.sky_notes) <= set(fit.notes)
    for end in ("json", "nc", "png"):
        (skyfit.plot if end == "png" else skyfit.save)(fit, tmp_path / f"fit.{end}")
    again = skyfit.predict(skyfit.load(tmp_path / "fit.json"), sky)
    np.testing.assert_allclose(again, fit.model, rtol=1e-4)
    write_prediction(sky, again, tmp_path / "predicted.nc")
    predicted = read(tmp_path / "predicted.nc")
    assert predicted.aerosol_optical_depth is None and predicted.usable.all()
    np.testing.assert_allclose(predicted.view_zenith_by_wavelength, sky.view_zenith_by_wavelength, atol=1e-9)


def test_an_optical_depth_of_no_wavelength_is_none_of_the_beam(tmp_path):
    import xarray

    write_sky(almucantar(), tmp_path / "sky.nc")
    data = xarray.load_dataset(tmp_path / "sky.nc", engine="h5netcdf").assign(aerosol_optical_depth=("time", [0.2]))
    data.to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    other = read(tmp_path / "other.nc")
    assert other.aerosol_optical_depth is None and other.notes == ("variables not used: aerosol_optical_depth",)
