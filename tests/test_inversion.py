import json
import logging
from dataclasses import replace

import jax
import numpy as np
import pvlib
import pytest
from hypothesis import given, strategies as st

import skyfit
from skyfit.fit import Fitted, PARAMETERS, start_model, station_pressure, time_names, values_of, with_values
from skyfit.fit.problem import day_of_year, GAS_BANDS_NM
from skyfit.fit.line_shape import estimate_fwhm
from skyfit.fit.parameters import check_free, partition
from skyfit.light import extraterrestrial_irradiance


SOLVER = skyfit.SingleScattering(8, "flat")
HAZE = {"aerosol_optical_depth": 0.2, "angstrom_exponent": 1.1, "asymmetry": 0.65}
FREE = tuple(HAZE)
DEMO = (
    "aerosol_optical_depth", "angstrom_exponent", "single_scattering_albedo", "asymmetry", "ground_albedo",
    "ozone",
)  # fmt: skip
PLAIN = np.arange(400.0, 681.0, 20.0)


def by_hand(
    solver=SOLVER, wavelength_nm=PLAIN, directions=40, sun_zenith=0.9, sun_azimuth=1.0, factor=1.0,
    aerosol_optical_depth=0.2, angstrom_exponent=1.1, asymmetry=0.65, single_scattering_albedo=0.95,
    ozone=300.0, ground_albedo=0.1, pressure=101325.0, fwhm_nm=6.0, phase=None,
):  # fmt: skip
    """Radiance [direction, wavelength] by the solver alone, on `hemisphere(directions)`."""
    phase = skyfit.HenyeyGreenstein(asymmetry) if phase is None else phase
    atmosphere = skyfit.Atmosphere(
        rayleigh=skyfit.Rayleigh(pressure=pressure),
        aerosol=skyfit.Aerosol(aerosol_optical_depth, angstrom_exponent, single_scattering_albedo, 0.0, phase),
        ozone=skyfit.Ozone(ozone),
        ground=skyfit.Ground(ground_albedo),
    )
    sun = np.asarray(extraterrestrial_irradiance(wavelength_nm, fwhm_nm), float) * factor
    scene = skyfit.Scene(sun_zenith, sun_azimuth, skyfit.hemisphere(directions), wavelength_nm, sun)
    return np.asarray(solver.radiance(atmosphere, scene), float)


def as_sky(radiance, noise=0.02, seed=None, wavelength_nm=PLAIN, sun_zenith=0.9, sun_azimuth=1.0, **about):
    """A measured sky of one or more times; noise is added where a seed is given."""
    radiance = np.atleast_3d(radiance) if np.ndim(radiance) == 3 else np.asarray(radiance)[None]
    sigma = None if noise is None else noise * radiance
    if seed is not None:
        radiance = radiance + sigma * np.random.default_rng(seed).standard_normal(radiance.shape)
    times = len(radiance)
    view = skyfit.hemisphere(radiance.shape[1])
    settings = {
        "time": np.datetime64("2025-10-05T12:00:00") + np.arange(times) * np.timedelta64(30, "m"),
        "pressure_pa": 101325.0,
        "fwhm_nm": 6.0,
        "source": "made",
    } | about
    return skyfit.Sky(
        radiance=radiance, sigma=sigma, usable=np.ones(radiance.shape, bool),
        view_zenith=np.asarray(view.zenith, float), view_azimuth=np.asarray(view.azimuth, float),
        wavelength_nm=wavelength_nm, sun_zenith=np.broadcast_to(sun_zenith, times),
        sun_azimuth=np.broadcast_to(sun_azimuth, times), **settings,
    )  # fmt: skip


# parameters by name


@pytest.mark.parametrize("name", PARAMETERS)
@given(share=st.floats(0.0, 1.0), free=st.floats(-200.0, 200.0))
def test_bound_and_unbound_are_inverse(name, share, free):
    parameter = PARAMETERS[name]
    low, high = parameter.lower, parameter.upper
    ends = (np.log(low), np.log(high)) if parameter.log else (low, high)
    with jax.enable_x64(True):
        nudged = ends[0] + min(max(share, 0.01), 0.99) * (ends[1] - ends[0])
        value = ends[0] + share * (ends[1] - ends[0])
        value, nudged = (np.exp(v) if parameter.log else v for v in (value, nudged))
        back = float(parameter.bound(parameter.unbound(value)))
        assert back == pytest.approx(nudged, rel=1e-9, abs=1e-9 * (high - low))
        bounded = float(parameter.bound(free))
        slack = 1e-12 * (high - low)
        assert low - slack <= bounded <= high + slack


@pytest.mark.parametrize("name", PARAMETERS)
def test_a_value_near_its_end_is_at_the_bound(name):
    parameter = PARAMETERS[name]
    # where the search ends, 3e-4 of the range from the bound, in the default float type
    assert parameter.at_bound(float(parameter.bound(np.float32(8.0))))
    assert parameter.at_bound(float(parameter.bound(np.float32(-8.0))))
    assert not parameter.at_bound(float(parameter.bound(np.float32(-5.0))))
    assert not parameter.at_bound(float(parameter.bound(np.float32(0.0))))


@pytest.mark.parametrize("name", PARAMETERS)
@given(share=st.floats(0.0, 1.0))
def test_a_value_that_is_set_is_read_back_and_moves_no_other(name, share):
    parameter = PARAMETERS[name]
    value = parameter.lower + share * (parameter.upper - parameter.lower)
    with jax.enable_x64(True):
        model = start_model(("forward_fraction",), 9.0e4)
        changed = values_of(with_values(model, (name,), [value]), PARAMETERS)
        assert changed.pop(name) == pytest.approx(value, rel=1e-12, abs=1e-12)
        before = values_of(model, PARAMETERS)
    one = {"turbidity", "aerosol_optical_depth"}
    for other in set(changed) - (one if name in one else set()):
        assert changed[other] == before[other]


def test_the_free_leaves_are_those_that_are_named():
    model = start_model(FREE, 101325.0)
    chosen, rest = partition(model, FREE)
    assert len(jax.tree.leaves(chosen)) == 3
    assert len(jax.tree.leaves(rest)) == len(jax.tree.leaves(model)) - 3
    assert values_of(with_values(rest, FREE, [0.3, 1.0, 0.5]), FREE) == pytest.approx(
        {"aerosol_optical_depth": 0.3, "angstrom_exponent": 1.0, "asymmetry": 0.5}, rel=1e-6
    )


@pytest.mark.parametrize(
    ("free", "parts"),
    [
        ((), ["`free`", "at least one"]),
        (("haze",), ["`free`", "'haze'", "turbidity, aerosol_optical_depth"]),
        (("ozone", "asymmetry", "ozone"), ["`free`", "once", "ozone, asymmetry, ozone"]),
        (("turbidity", "aerosol_optical_depth"), ["`free`", "both turbidity and aerosol_optical_depth"]),
        (("asymmetry_second",), ["`free`", "'asymmetry_second'", "does not have"]),
    ],
)
def test_names_that_cannot_be_free(free, parts):
    one_lobe = start_model((), 101325.0)
    calls = (
        lambda: check_free(free, one_lobe),
        lambda: skyfit.invert(as_sky(np.ones((40, 15))), free, SOLVER, one_lobe),
    )
    for call in calls:
        with pytest.raises(ValueError) as caught:
            call()
        assert "\n" not in str(caught.value)
        assert all(part in str(caught.value) for part in parts), caught.value


@pytest.mark.parametrize("place", ["aerosol", "ozone", "rayleigh"])
def test_an_atmosphere_without_a_constituent_has_none_of_its_parameters(place):
    model = start_model((), 101325.0)
    atmosphere = replace_leaf(model.atmosphere, place, None)
    name = {"aerosol": "aerosol_optical_depth", "ozone": "ozone", "rayleigh": "pressure"}[place]
    with pytest.raises(ValueError, match=f"{name}.*does not have"):
        check_free((name,), type(model)(atmosphere))
    assert name not in values_of(type(model)(atmosphere), PARAMETERS)


def replace_leaf(atmosphere, name, value):
    parts = {n: getattr(atmosphere, n) for n in ("rayleigh", "aerosol", "ozone", "ground")}
    return skyfit.Atmosphere(**(parts | {name: value}))


# the shipped sample, made by another solver


@pytest.fixture(scope="session")
def sample_fit(checkout):
    with jax.enable_x64(True):
        return skyfit.invert(skyfit.read(checkout / "data" / "skies" / "sample.nc"), DEMO)


@pytest.fixture(scope="session")
def sample_truth(checkout):
    truth = json.loads((checkout / "data" / "skies" / "sample_truth.json").read_text())["parameters"]
    names = {
        "aerosol_optical_depth": "aod550", "single_scattering_albedo": "aerosol_albedo", "ozone": "ozone_du"
    }  # fmt: skip
    return {name: truth[names.get(name, name)]["value"] for name in DEMO}


def test_the_sample_gives_back_what_another_solver_put_in(sample_fit, sample_truth):
    fit = sample_fit
    value = dict(zip(fit.free, fit.values[0], strict=True))
    sigma = dict(zip(fit.free, fit.sigma[0], strict=True))
    off = {name: value[name] - sample_truth[name] for name in DEMO}
    assert fit.result == ("successful",)
    assert abs(off["aerosol_optical_depth"]) < 0.01 and sigma["aerosol_optical_depth"] < 0.01
    assert abs(off["angstrom_exponent"]) < 0.1
    for name in ("aerosol_optical_depth", "angstrom_exponent"):
        assert abs(off[name]) < 3.0 * sigma[name]
    # the solvers differ by some 0.5 % in multiple scattering, which is more than the noise leaves of these
    assert abs(off["single_scattering_albedo"]) < 0.01 and abs(off["asymmetry"]) < 0.002
    assert abs(off["ground_albedo"]) < 0.02 and abs(off["ozone"]) < 15.0
    assert not fit.at_bound.any() and fit.determined.all() and fit.undetermined == ((),)
    # noise of 1 % is all that is left
    assert 0.9 < fit.reduced_chi_square[0] < 1.1


def test_the_numbers_of_a_fit_agree_with_each_other(sample_fit):
    fit = sample_fit
    assert fit.model.shape == fit.residual.shape == fit.used.shape == fit.sky.radiance.shape
    error = (fit.model - fit.sky.radiance)[fit.used]
    assert fit.rmse[0] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)
    assert fit.total_rmse == pytest.approx(fit.rmse[0], rel=1e-12)
    chi = np.sum((error / fit.sky.sigma[fit.used]) ** 2) / (error.size - len(fit.free))
    # the fit and the model on all wavelengths interpolate in wavelength between other nodes
    assert fit.reduced_chi_square[0] == pytest.approx(chi, rel=2e-3)
    np.testing.assert_allclose(fit.sigma[0] ** 2, np.diag(fit.covariance[0]), rtol=1e-12)
    np.testing.assert_allclose(np.diag(fit.correlation[0]), 1.0, rtol=1e-12)
    assert np.all(np.abs(fit.correlation) <= 1.0 + 1e-12)
    text = str(fit)
    assert all(name in text for name in DEMO) and "2025-10-05T12:00:00Z" in text and "successful" in text
    wavelength = fit.sky.wavelength_nm
    bands = sum(int(np.sum((low <= wavelength) & (wavelength <= high))) for low, high in GAS_BANDS_NM)
    assert f"{bands * fit.sky.radiance.shape[1]} samples in gas bands left out" in fit.notes
    assert set(fit.fixed).isdisjoint({*DEMO, "turbidity"}) and fit.fixed["pressure"] == 101325.0


def test_sigma_is_that_of_a_jacobian_by_differences(sample_fit):
    fit = sample_fit
    with jax.enable_x64(True):
        columns = []
        for p, name in enumerate(fit.free):
            step = 1e-3 * PARAMETERS[name].spread(fit.values[0, p])
            moved = []
            for sign in (1.0, -1.0):
                values = fit.values[0].copy()
                values[p] += sign * step
                model = with_values(fit.start, fit.free, values)
                moved.append(skyfit.predict(Fitted(fit.sky.time, (model,), fit.solver, fit.fwhm_nm), fit.sky))
            columns.append(((moved[0] - moved[1]) / (2.0 * step) / fit.sky.sigma)[fit.used])
    jacobian = np.stack(columns, axis=1)
    expected = np.linalg.inv(jacobian.T @ jacobian) * max(fit.reduced_chi_square[0], 1.0)
    np.testing.assert_allclose(fit.sigma[0], np.sqrt(np.diag(expected)), rtol=5e-3)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(fit.covariance[0] / scale, expected / scale, atol=5e-3)


# small skies, made and fitted by single scattering


def test_turbidity_is_the_same_fit_as_its_optical_depth(x64):
    sky = as_sky(by_hand(), seed=1)
    others = ("angstrom_exponent", "asymmetry")
    depth = skyfit.invert(sky, ("aerosol_optical_depth", *others), SOLVER)
    turbidity = skyfit.invert(sky, ("turbidity", *others), SOLVER)
    model = turbidity.fitted.models[0]
    got = values_of(model, ("aerosol_optical_depth", "turbidity"))
    # far inside the error bar, which the tolerance of the search leaves
    assert abs(got["aerosol_optical_depth"] - depth.values[0, 0]) < 0.02 * depth.sigma[0, 0]
    assert got["turbidity"] == pytest.approx(turbidity.values[0, 0], rel=1e-12)
    # of d depth = tau_R d turbidity
    per_unit = skyfit.Atmosphere.from_turbidity(2.0).aerosol.optical_depth
    assert turbidity.sigma[0, 0] * float(per_unit) == pytest.approx(depth.sigma[0, 0], rel=1e-3)
    np.testing.assert_allclose(turbidity.sigma[0, 1:], depth.sigma[0, 1:], rtol=1e-3)
    assert "aerosol_optical_depth" not in turbidity.fixed and "turbidity" not in depth.fixed


@pytest.mark.parametrize("with_sigma", [True, False], ids=["sigma", "no sigma"])
def test_masked_samples_have_no_influence(with_sigma):
    clean = as_sky(by_hand(), seed=2)
    usable = np.random.default_rng(3).uniform(size=clean.radiance.shape) > 0.3
    usable[:, 5], usable[:, :, 4] = False, False
    sky = replace(clean, usable=usable, sigma=clean.sigma if with_sigma else None)
    expected = skyfit.invert(sky, FREE, SOLVER)
    assert expected.result == ("successful",)
    assert expected.used.sum() == usable.sum()
    for poison in (np.nan, np.inf, -np.inf, 1e9, -1e9, 0.0):
        sigma = np.where(usable, clean.sigma, poison) if with_sigma else None
        got = skyfit.invert(replace(sky, radiance=np.where(usable, clean.radiance, poison), sigma=sigma), FREE, SOLVER)
        for name in ("values", "sigma", "covariance", "model", "rmse", "reduced_chi_square", "steps"):
            np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
        assert got.total_rmse == expected.total_rmse


def test_two_lobes_are_not_determined_by_six_directions():
    sky = as_sky(by_hand(directions=6), seed=4)
    free = ("aerosol_optical_depth", "asymmetry", "asymmetry_second", "forward_fraction")
    fit = skyfit.invert(sky, free, SOLVER)
    assert not fit.determined[0].all()
    assert any("not determined" in text or "only a combination" in text for text in fit.undetermined[0])
    lobes = {"asymmetry", "asymmetry_second", "forward_fraction"}
    assert any(lobe in text for text in fit.undetermined[0] for lobe in lobes)
    assert "not determined" in str(fit)


def test_ozone_is_not_determined_in_the_blue_but_the_haze_is():
    blue = np.arange(400.0, 441.0, 4.0)
    radiance = by_hand(wavelength_nm=blue, angstrom_exponent=1.3, asymmetry=0.7)
    sky = as_sky(radiance, noise=0.1, seed=5, wavelength_nm=blue)
    fit = skyfit.invert(sky, ("aerosol_optical_depth", "ozone"), SOLVER)
    assert fit.determined[0].tolist() == [True, False]
    assert "ozone is not determined by these data" in fit.undetermined[0]
    assert not fit.sigma[0, 1] < 100.0
    assert abs(fit.values[0, 0] - 0.2) < 4.0 * fit.sigma[0, 0] < 0.1


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_parameter_that_the_solver_ignores_spoils_no_other(place):
    """Single scattering sees no ground."""
    sky = as_sky(by_hand(), seed=6)
    plain = skyfit.invert(sky, ("aerosol_optical_depth", "asymmetry"), SOLVER)
    free = ["aerosol_optical_depth", "asymmetry"]
    free.insert(place, "ground_albedo")
    fit = skyfit.invert(sky, free, SOLVER)
    others = [i for i in range(3) if i != place]
    assert fit.values[0, place] == pytest.approx(0.1, rel=1e-5)
    assert not fit.determined[0, place] and not fit.sigma[0, place] < 1.0
    assert "ground_albedo is not determined by these data" in fit.undetermined[0]
    np.testing.assert_allclose(fit.values[0, others], plain.values[0], rtol=1e-4)
    assert fit.determined[0, others].all()
    np.testing.assert_allclose(fit.sigma[0, others], plain.sigma[0], rtol=1e-2)


def test_a_haze_that_absorbs_less_than_nothing_stands_at_its_bound():
    radiance = 1.02 * by_hand(single_scattering_albedo=1.0, asymmetry=0.7)
    free = ("single_scattering_albedo", "angstrom_exponent")
    start = with_values(start_model((), 101325.0), ("aerosol_optical_depth",), [0.2])
    fit = skyfit.invert(as_sky(radiance), free, SOLVER, start)
    assert fit.result == ("successful",)
    assert fit.at_bound[0].tolist() == [True, False]
    assert 0.999 < fit.values[0, 0] <= 1.0
    assert any("single_scattering_albedo stands at its bound" in text for text in fit.undetermined[0])
    assert "at bound" in str(fit)


@pytest.mark.slow
def test_a_black_ground_stands_at_its_bound():
    solver = skyfit.OrdersOfScattering(3, 3, 8, 4, 8, 3, "flat")
    red = np.arange(450.0, 681.0, 46.0)
    haze = {"aerosol_optical_depth": 0.15, "angstrom_exponent": 1.3, "asymmetry": 0.7}
    # a little darker than black, lest noise decide on which side of 0 the minimum is
    radiance = 0.99 * by_hand(solver, red, ground_albedo=0.0, **haze)
    fit = skyfit.invert(as_sky(radiance, 0.01, wavelength_nm=red), ("ground_albedo", "asymmetry"), solver)
    assert fit.result == ("successful",)
    assert fit.at_bound[0].tolist() == [True, False]
    assert 0.0 <= fit.values[0, 0] < 1e-3
    assert any("ground_albedo stands at its bound" in text for text in fit.undetermined[0])


@pytest.mark.parametrize("when", ["2025-01-03T12:00:00", "2025-07-04T12:00:00"])
@pytest.mark.parametrize("station", [{"pressure_pa": 8.0e4}, {"pressure_pa": np.nan, "altitude_m": 2000.0}])
def test_the_distance_of_the_sun_and_the_air_above_the_station_are_applied(x64, when, station):
    day = np.datetime64(when).astype("datetime64[D]").item().timetuple().tm_yday
    factor = pvlib.irradiance.get_extra_radiation(day, solar_constant=1.0, method="spencer")
    assert abs(factor - 1.0) > 0.03
    pressure = 8.0e4 if "altitude_m" not in station else pvlib.atmosphere.alt2pres(2000.0)
    sky = as_sky(by_hand(factor=factor, pressure=pressure), time=np.array([when], "datetime64[ns]"), **station)
    fit = skyfit.invert(sky, FREE, SOLVER)
    np.testing.assert_allclose(fit.values[0], list(HAZE.values()), rtol=2e-4)
    # Spencer's series to four digits, and the standard atmosphere's exponent likewise
    np.testing.assert_allclose(fit.model, sky.radiance, rtol=2e-4)
    assert fit.fixed["pressure"] == pytest.approx(pressure, rel=1e-4)


def test_without_a_time_the_sun_is_at_its_mean_distance(x64):
    sky = as_sky(by_hand(), time=np.array(["NaT"], "datetime64[ns]"))
    fit = skyfit.invert(sky, FREE, SOLVER)
    np.testing.assert_allclose(fit.values[0], list(HAZE.values()), rtol=1e-4)
    assert time_names(sky) == ("time 0",)


def test_a_pressure_that_nobody_told_is_assumed_and_said():
    sky = as_sky(by_hand(), pressure_pa=np.nan)
    assert station_pressure(sky)[0] == 101325.0
    assert any("sea level" in note for note in skyfit.invert(sky, FREE, SOLVER).notes)
    assert station_pressure(replace(sky, pressure_pa=7e4, altitude_m=0.0)) == (7e4, "")


@pytest.mark.parametrize(
    ("when", "day"), [("2024-01-01T00:00:00", 1), ("2024-12-31T23:59:59", 366), ("2023-03-01", 60)]
)
def test_the_day_of_the_year(when, day):
    assert day_of_year(np.datetime64(when, "ns")) == day


def test_pointing_offsets_are_recovered(x64):
    radiance = by_hand(sun_zenith=0.9 + np.radians(1.5), sun_azimuth=1.0 - np.radians(4.0))
    fit = skyfit.invert(as_sky(radiance), (*FREE, "pointing_zenith", "pointing_azimuth"), SOLVER)
    np.testing.assert_allclose(fit.values[0], [*HAZE.values(), 1.5, -4.0], rtol=2e-3)
    assert PARAMETERS["pointing_zenith"].unit == PARAMETERS["pointing_azimuth"].unit == "degree"
    assert not fit.at_bound.any() and fit.determined.all()


def test_parameters_that_are_held_keep_the_value_of_the_start():
    start = with_values(start_model(FREE, 101325.0), ("single_scattering_albedo", "ozone"), [0.8, 350.0])
    sky = as_sky(by_hand(single_scattering_albedo=0.8, ozone=350.0))
    fit = skyfit.invert(sky, FREE, SOLVER, start)
    np.testing.assert_allclose(fit.values[0], list(HAZE.values()), rtol=1e-3)
    assert fit.fixed["ozone"] == 350.0 and fit.fixed["single_scattering_albedo"] == pytest.approx(0.8)
    kept = values_of(fit.fitted.models[0], ("ozone", "single_scattering_albedo"))
    assert kept == pytest.approx({"ozone": 350.0, "single_scattering_albedo": 0.8})


def test_the_line_shape_of_the_file_or_of_the_call_is_used(x64):
    radiance = by_hand(fwhm_nm=11.0)
    told = skyfit.invert(as_sky(radiance, fwhm_nm=11.0), FREE, SOLVER)
    given = skyfit.invert(as_sky(radiance, fwhm_nm=np.nan), FREE, SOLVER, fwhm_nm=11.0)
    for fit in (told, given):
        assert fit.fwhm_nm == 11.0
        np.testing.assert_allclose(fit.model, fit.sky.radiance, rtol=1e-4)
    unknown = skyfit.invert(as_sky(radiance, fwhm_nm=np.nan), FREE, SOLVER)
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
    assert estimate_fwhm(sky) == pytest.approx(width, abs=0.5)


def test_an_unknown_width_is_estimated_and_said(x64):
    fine = np.arange(470.0, 520.0, 1.0)
    sky = as_sky(by_hand(wavelength_nm=fine, fwhm_nm=7.0), wavelength_nm=fine, fwhm_nm=np.nan)
    fit = skyfit.invert(sky, FREE, SOLVER)
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


def test_each_time_is_fitted_by_itself_and_reported():
    hazes = (0.1, 0.3)
    radiance = np.stack(
        [by_hand(aerosol_optical_depth=h, sun_zenith=s) for h, s in zip(hazes, (0.9, 0.4), strict=True)]
    )
    sky = as_sky(radiance, seed=8, sun_zenith=(0.9, 0.4))
    calls = []
    fit = skyfit.invert(sky, iter(FREE), SOLVER, progress=lambda done, of: calls.append((done, of)))
    assert calls == [(1, 2), (2, 2)] and fit.result == ("successful", "successful")
    np.testing.assert_allclose(fit.values[:, 0], hazes, atol=4.0 * fit.sigma[:, 0].max())
    for t in range(2):
        alone = skyfit.invert(sky.at(t), FREE, SOLVER)
        np.testing.assert_array_equal(alone.values[0], fit.values[t])
        np.testing.assert_array_equal(alone.covariance[0], fit.covariance[t])


def test_wavelengths_beyond_the_sun_and_in_gas_bands_are_left_out_and_counted():
    wide = np.array([290.0, 420.0, 500.0, 600.0, 690.0, 760.0, 870.0, 1050.0, 1150.0])
    radiance = np.full((40, 9), 7.0)
    radiance[:, 1:8] = by_hand(wavelength_nm=wide[1:8])
    fit = skyfit.invert(as_sky(radiance, wavelength_nm=wide), FREE, SOLVER)
    np.testing.assert_allclose(fit.values[0], list(HAZE.values()), rtol=2e-3)
    assert np.isnan(fit.model[..., [0, 8]]).all() and np.isfinite(fit.model[..., 1:8]).all()
    assert not fit.used[..., [0, 4, 5, 8]].any() and fit.used[..., [1, 2, 3, 6, 7]].all()
    notes = " ".join(fit.notes)
    assert "80 samples beyond 300-1100 nm" in notes and "80 samples in gas bands" in notes


def test_the_prediction_at_the_samples_is_the_fitted_model():
    radiance = np.stack([by_hand(aerosol_optical_depth=haze) for haze in (0.1, 0.3)])
    sky = as_sky(radiance, seed=10)
    fit = skyfit.invert(sky, FREE, SOLVER)
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


@pytest.mark.parametrize("later", [np.timedelta64(5, "s"), np.timedelta64(365, "D")])
def test_a_time_that_was_not_fitted_is_refused(later):
    sky = as_sky(by_hand())
    fitted = Fitted(sky.time, (start_model(FREE, 101325.0),), SOLVER, 6.0)
    with pytest.raises(ValueError, match="was not fitted.*2025-10-05T12:00:00") as caught:
        skyfit.predict(fitted, replace(sky, time=sky.time + later))
    assert "\n" not in str(caught.value)


def test_one_sky_without_a_time_matches_one_fit_and_several_do_not():
    two = as_sky(np.stack([by_hand()] * 2))
    model = start_model(FREE, 101325.0)
    unknown = replace(two.at(0), time=np.array(["NaT"], "datetime64[ns]"))
    one_fit, two_fits = (Fitted(two.time[:n], (model,) * n, SOLVER, 6.0) for n in (1, 2))
    assert skyfit.predict(one_fit, unknown).shape == (1, 40, 15)
    for fitted, sky in ((two_fits, unknown), (one_fit, replace(two, time=np.array(["NaT"] * 2, "datetime64[ns]")))):
        with pytest.raises(ValueError, match="NaT.*was not fitted"):
            skyfit.predict(fitted, sky)


@pytest.mark.parametrize("zenith_deg", [90.0, 90.1, 120.0])
def test_a_sun_below_the_horizon_is_refused(zenith_deg):
    sky = as_sky(np.stack([by_hand()] * 2), sun_zenith=np.radians([40.0, zenith_deg]))
    with pytest.raises(ValueError, match="`sky` has the sun at or below the horizon at time 1"):
        skyfit.invert(sky, FREE, SOLVER)


def test_too_few_samples_are_refused():
    sky = as_sky(by_hand())
    few = np.zeros(sky.usable.shape, bool)
    few[0, :2, 0] = True
    with pytest.raises(ValueError, match="2 usable samples at time 0, fewer than the 3 free"):
        skyfit.invert(replace(sky, usable=few), FREE, SOLVER)
    none = replace(sky, usable=np.zeros(sky.usable.shape, bool))
    with pytest.raises(ValueError, match="no usable sample"):
        skyfit.invert(none, FREE, SOLVER)
    with pytest.raises(ValueError, match="no usable sample"):
        skyfit.invert(replace(none, sigma=None), FREE, SOLVER)
    bands = as_sky(by_hand(wavelength_nm=np.array([690.0, 720.0])), wavelength_nm=np.array([690.0, 720.0]))
    with pytest.raises(ValueError, match="no usable sample"):
        skyfit.invert(bands, FREE, SOLVER)


def test_the_limit_of_steps_is_told():
    fit = skyfit.invert(as_sky(by_hand(aerosol_optical_depth=1.5, asymmetry=0.2)), FREE, SOLVER, max_steps=1)
    assert fit.result == ("max_steps_reached",) and fit.steps[0] == 1
    assert "max_steps_reached" in str(fit)


def test_a_model_that_is_not_finite_fails_in_words_and_not_in_an_exception():
    start = with_values(start_model(FREE, 101325.0), ("ozone",), [np.nan])
    fit = skyfit.invert(as_sky(by_hand()), FREE, SOLVER, start)
    assert fit.result == ("failed",) and not fit.determined.any()
    assert "failed" in str(fit)


def test_a_second_sky_of_the_same_shape_compiles_nothing(caplog):
    free = ("aerosol_optical_depth", "angstrom_exponent", "single_scattering_albedo")

    def sky(seed, **changes):
        return as_sky(by_hand(**changes), seed=seed, sun_zenith=changes.get("sun_zenith", 0.9))

    skies = sky(20), sky(21, aerosol_optical_depth=0.4, sun_zenith=0.7, pressure=9e4)
    usable = skies[1].usable.copy()
    usable[:, 3:5] = False
    other = replace(skies[1], usable=usable, time=skies[1].time + np.timedelta64(40, "D"), pressure_pa=9e4)
    counts = []
    for measured in (skies[0], other, other):
        caplog.clear()
        with caplog.at_level(logging.WARNING), jax.log_compiles():
            skyfit.invert(measured, free, SOLVER, max_steps=99)
        counts.append(sum("compil" in record.getMessage().lower() for record in caplog.records))
    assert counts[0] > 0 and counts[1:] == [0, 0]


def test_error_bars_hold_the_truth_as_often_as_they_say(x64):
    truth = np.array(list(HAZE.values()))
    clean, off = by_hand(), []
    for seed in range(60):
        fit = skyfit.invert(as_sky(clean, 0.02, seed), FREE, SOLVER)
        assert fit.result == ("successful",)
        off.append((fit.values[0] - truth) / fit.sigma[0])
    inside = np.mean(np.abs(off) < 1.0, axis=0)
    assert np.all((inside >= 0.55) & (inside <= 0.80)), inside
    assert np.all(np.abs(np.mean(off, axis=0)) < 0.5)


def test_error_bars_grow_with_noise_that_the_file_understates(x64):
    """The residual is twice the file's sigma: chi-square scales the bars."""
    truth, clean, off = np.array(list(HAZE.values())), by_hand(), []
    for seed in range(60):
        sky = as_sky(clean, 0.04, seed)
        fit = skyfit.invert(replace(sky, sigma=0.5 * sky.sigma), FREE, SOLVER)
        assert fit.reduced_chi_square[0] == pytest.approx(4.0, rel=0.3)
        off.append((fit.values[0] - truth) / fit.sigma[0])
    inside = np.mean(np.abs(off) < 1.0, axis=0)
    assert np.all((inside >= 0.55) & (inside <= 0.80)), inside


@pytest.mark.slow
def test_the_measured_scans_of_a_morning_are_fitted(shared, x64):
    sky = skyfit.read(shared / "measured" / "kider2014" / "2013-05-27.nc")
    fit = skyfit.invert(sky)
    assert len(fit.result) == 8 and set(fit.result) == {"successful"}
    # W m-2 sr-1 nm-1; the peers have 11e-3 to 89e-3
    assert fit.total_rmse < 8e-3 and fit.rmse.max() < 8e-3
    depth = fit.values[:, fit.free.index("aerosol_optical_depth")]
    assert np.all((depth > 0.05) & (depth < 0.3))
