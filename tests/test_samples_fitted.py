"""Which samples of a sky are fitted, with which sun and air; predictions elsewhere; skies that are refused."""

from dataclasses import replace

import numpy as np
import pvlib
import pytest
from made_skies import as_sky, by_hand, EXACT, FREE, HAZE, PLAIN, SOLVER

import skyfit
from skyfit.atmosphere import describe
from skyfit.measured import station_pressure, sun_factor, time_names
from skyfit.measured.station import day_of_year
from skyfit.retrieve import Fitted, start_at, start_model
from skyfit.retrieve.prepared import prepared


@pytest.mark.parametrize("with_sigma", [True, False], ids=["sigma", "no sigma"])
def test_masked_samples_have_no_influence(with_sigma):
    clean = as_sky(by_hand(), seed=2)
    usable = np.random.default_rng(3).uniform(size=clean.radiance.shape) > 0.3
    usable[:, 5], usable[:, :, 4] = False, False
    sky = replace(clean, usable=usable, sigma=clean.sigma if with_sigma else None)
    exact = skyfit.NoiseModel(model_error=0.0, calibration=0.0)
    expected = skyfit.invert(sky, FREE, SOLVER, measurement=exact)
    assert expected.result == ("successful",)
    assert expected.used.sum() == usable.sum()
    for poison in (np.nan, np.inf, -np.inf, 1e9, -1e9, 0.0):
        sigma = np.where(usable, clean.sigma, poison) if with_sigma else None
        got = skyfit.invert(
            replace(sky, radiance=np.where(usable, clean.radiance, poison), sigma=sigma),
            FREE,
            SOLVER,
            measurement=exact,
        )
        for name in ("values", "sigma", "covariance", "model", "rmse", "reduced_chi_square", "steps"):
            np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
        assert got.total_rmse == expected.total_rmse


@pytest.mark.parametrize("when", ["2025-01-03T12:00:00", "2025-07-04T12:00:00"])
@pytest.mark.parametrize("station", [{"pressure_pa": 8.0e4}, {"pressure_pa": np.nan, "altitude_m": 2000.0}])
def test_the_distance_of_the_sun_and_the_air_above_the_station_are_applied(x64, when, station):
    day = np.datetime64(when).astype("datetime64[D]").item().timetuple().tm_yday
    factor = pvlib.irradiance.get_extra_radiation(day, solar_constant=1.0, method="spencer")
    assert abs(factor - 1.0) > 0.03
    pressure = 8.0e4 if "altitude_m" not in station else pvlib.atmosphere.alt2pres(2000.0)
    sky = as_sky(by_hand(factor=factor, pressure=pressure), time=np.array([when], "datetime64[ns]"), **station)
    fit = skyfit.invert(sky, FREE, SOLVER, measurement=EXACT)
    np.testing.assert_allclose(fit.values[0], list(HAZE.values()), rtol=2e-4)
    # Spencer's series to four digits, and the standard atmosphere's exponent likewise
    np.testing.assert_allclose(fit.model, sky.radiance, rtol=2e-4)
    assert fit.fixed["pressure"] == pytest.approx(pressure, rel=1e-4)


def test_without_a_time_the_sun_is_at_its_mean_distance(x64):
    sky = as_sky(by_hand(), time=np.array(["NaT"], "datetime64[ns]"))
    fit = skyfit.invert(sky, FREE, SOLVER, measurement=EXACT)
    np.testing.assert_allclose(fit.values[0], list(HAZE.values()), rtol=1e-4)
    assert time_names(sky) == ("time 0",)
    (said,) = [note for note in fit.notes if "date" in note]
    assert "1 au" in said and "3.4 %" in said and "single-scattering albedo" in said


@pytest.mark.parametrize(
    ("about", "factor", "said"),
    [
        ({"time": ["2025-01-03", "2025-07-04"]}, [1.035, 0.9666], ""),
        ({"time": ["2025-01-03", "NaT"]}, [1.035, 1.0], "no date at 1 of 2 times"),
        ({"time": ["NaT", "NaT"]}, [1.0, 1.0], "no date in the file"),
        ({"time": ["2025-01-03", "NaT"], "sun_distance_au": 1.01}, [0.9803, 0.9803], ""),
    ],
)
def test_how_far_the_sun_is_told_to_be(about, factor, said):
    about["time"] = np.array(about["time"], "datetime64[ns]")
    found, note = sun_factor(as_sky(np.ones((2, 5, 15)), **about))
    np.testing.assert_allclose(found, factor, atol=5e-4)
    assert note.startswith(said) and bool(note) == bool(said)


def test_a_pressure_that_nobody_told_is_assumed_and_said():
    sky = as_sky(by_hand(), pressure_pa=np.nan)
    assert station_pressure(sky)[0] == 101325.0
    assert any("sea level" in note for note in skyfit.invert(sky, FREE, SOLVER, measurement=EXACT).notes)
    assert station_pressure(replace(sky, pressure_pa=7e4, altitude_m=0.0)) == (7e4, "")


@pytest.mark.parametrize(
    ("altitude", "said"),
    [
        (np.nan, "no pressure or altitude"),
        (0.0, "altitude 0 m and no pressure"),
        (2000.0, "from the altitude of 2000 m"),
    ],
)
def test_a_pressure_by_altitude_is_said_unless_the_user_tells_it(altitude, said):
    sky = as_sky(by_hand(), pressure_pa=np.nan, altitude_m=altitude)
    pressure, sentence = station_pressure(sky)
    assert said in sentence and "0.001 of optical depth" in sentence
    assert sentence in prepared(sky, FREE, SOLVER).sampling.notes
    told = start_model(FREE, 0.9 * pressure)
    assert sentence not in prepared(sky, FREE, SOLVER, told).sampling.notes
    assert sentence not in prepared(sky, (*FREE, "pressure"), SOLVER).sampling.notes


def test_the_ozone_of_a_station_is_that_of_the_start():
    assert start_at(as_sky(by_hand(), ozone_du=350.0), FREE).atmosphere.ozone.column == 350.0
    assert start_at(as_sky(by_hand()), FREE).atmosphere.ozone.column == 300.0
    # a free one begins within its range
    assert 50.0 < start_at(as_sky(by_hand(), ozone_du=0.0), ("ozone",)).atmosphere.ozone.column < 60.0


def test_what_is_held_unlike_the_maker_of_a_sky_is_said():
    made = {"atmosphere": describe(skyfit.Atmosphere(ground=skyfit.Ground(0.3)))}
    notes = prepared(as_sky(by_hand(), made_by=made), FREE, SOLVER).sampling.notes
    assert "held fixed unlike what made this sky: ground_albedo 0.1 for 0.3" in notes
    wrong = {"atmosphere": {"ground": {"albedo": "white"}}}
    with pytest.raises(ValueError, match=r"`made_by\.atmosphere\.ground\.albedo`: expected a number"):
        prepared(as_sky(by_hand(), made_by=wrong), FREE, SOLVER)


def test_the_faulty_file_of_a_mountain_is_noted(shared):
    path = shared / "faults" / "mk.csv"
    if not path.is_file():
        pytest.skip("the faulty files are absent")
    notes = prepared(skyfit.read(path), FREE, SOLVER).sampling.notes
    assert any("altitude 0 m and no pressure in the file: 1013 hPa of sea level assumed" in note for note in notes)


@pytest.mark.parametrize(
    ("when", "day"), [("2024-01-01T00:00:00", 1), ("2024-12-31T23:59:59", 366), ("2023-03-01", 60)]
)
def test_the_day_of_the_year(when, day):
    assert day_of_year(np.datetime64(when, "ns")) == day


def test_wavelengths_beyond_the_sun_and_in_gas_bands_are_left_out_and_counted():
    wide = np.array([290.0, 420.0, 500.0, 600.0, 690.0, 760.0, 870.0, 1050.0, 1150.0])
    radiance = np.full((40, 9), 7.0)
    radiance[:, 1:8] = by_hand(wavelength_nm=wide[1:8])
    fit = skyfit.invert(as_sky(radiance, wavelength_nm=wide), FREE, SOLVER, measurement=EXACT)
    np.testing.assert_allclose(fit.values[0], list(HAZE.values()), rtol=2e-3)
    assert np.isnan(fit.model[..., [0, 8]]).all() and np.isfinite(fit.model[..., 1:8]).all()
    assert not fit.used[..., [0, 4, 5, 8]].any() and fit.used[..., [1, 2, 3, 6, 7]].all()
    notes = " ".join(fit.notes)
    assert "80 samples beyond 300-1100 nm" in notes and "80 samples in gas bands" in notes


def test_the_prediction_at_the_samples_is_the_fitted_model():
    radiance = np.stack([by_hand(aerosol_optical_depth=haze) for haze in (0.1, 0.3)])
    sky = as_sky(radiance, seed=10)
    fit = skyfit.invert(sky, FREE, SOLVER, measurement=EXACT)
    np.testing.assert_array_equal(skyfit.predict(fit.fitted, sky), fit.model)
    # matched by time, not by order, and within a second
    turned = replace(sky, time=sky.time[::-1] + np.timedelta64(400, "ms"))
    np.testing.assert_allclose(skyfit.predict(fit.fitted, turned), fit.model[::-1], rtol=1e-6)
    np.testing.assert_array_equal(skyfit.predict(fit.fitted, sky.at(1)), fit.model[1:])
    # elsewhere: other directions and wavelengths, no use of the radiance there
    elsewhere = as_sky(np.ones((12, 3)), wavelength_nm=np.array([433.0, 560.0, 671.0]))
    nothing = {"radiance": np.full((1, 12, 3), np.nan), "usable": np.zeros((1, 12, 3), bool), "sigma": None}
    elsewhere = replace(elsewhere, **nothing)
    values = dict(zip(FREE, fit.values[0], strict=True))
    expected = by_hand(wavelength_nm=elsewhere.wavelength_nm, directions=12, **values)
    np.testing.assert_allclose(skyfit.predict(fit.fitted, elsewhere)[0], expected, rtol=1e-4)


def fitted_at(time, model):
    return Fitted(time, (model,) * len(time), SOLVER, 6.0, PLAIN, np.ones((len(time), PLAIN.size)))


@pytest.mark.parametrize("later", [np.timedelta64(5, "s"), np.timedelta64(365, "D")])
def test_a_time_that_was_not_fitted_is_refused(later):
    sky = as_sky(by_hand())
    fitted = fitted_at(sky.time, start_model(FREE, 101325.0))
    with pytest.raises(ValueError, match="was not fitted.*2025-10-05T12:00:00") as caught:
        skyfit.predict(fitted, replace(sky, time=sky.time + later))
    assert "\n" not in str(caught.value)


def test_one_sky_without_a_time_matches_one_fit_and_several_do_not():
    two = as_sky(np.stack([by_hand()] * 2))
    model = start_model(FREE, 101325.0)
    unknown = replace(two.at(0), time=np.array(["NaT"], "datetime64[ns]"))
    one_fit, two_fits = (fitted_at(two.time[:n], model) for n in (1, 2))
    assert skyfit.predict(one_fit, unknown).shape == (1, 40, 15)
    for fitted, sky in ((two_fits, unknown), (one_fit, replace(two, time=np.array(["NaT"] * 2, "datetime64[ns]")))):
        with pytest.raises(ValueError, match="NaT.*was not fitted"):
            skyfit.predict(fitted, sky)


@pytest.mark.parametrize("zenith_deg", [90.0, 90.1, 120.0])
def test_a_sun_below_the_horizon_is_refused(zenith_deg):
    sky = as_sky(np.stack([by_hand()] * 2), sun_zenith=np.radians([zenith_deg, zenith_deg]))
    with pytest.raises(ValueError, match="`sky` has the sun at or below the horizon at time 0"):
        skyfit.invert(sky, FREE, SOLVER, measurement=EXACT)


def test_too_few_samples_are_refused():
    sky = as_sky(by_hand())
    few = np.zeros(sky.usable.shape, bool)
    few[0, :2, 0] = True
    with pytest.raises(ValueError, match="2 usable samples at time 0, fewer than the 3 free"):
        skyfit.invert(replace(sky, usable=few), FREE, SOLVER, measurement=EXACT)
    none = replace(sky, usable=np.zeros(sky.usable.shape, bool))
    with pytest.raises(ValueError, match="no usable sample"):
        skyfit.invert(none, FREE, SOLVER, measurement=EXACT)
    with pytest.raises(ValueError, match="no usable sample"):
        skyfit.invert(replace(none, sigma=None), FREE, SOLVER, measurement=EXACT)
    bands = as_sky(by_hand(wavelength_nm=np.array([690.0, 720.0])), wavelength_nm=np.array([690.0, 720.0]))
    with pytest.raises(ValueError, match="no usable sample"):
        skyfit.invert(bands, FREE, SOLVER, measurement=EXACT)
