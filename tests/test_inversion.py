"""One time of a sky and its parameters: values, error bars, what is not determined, how a fit ends."""

import json
import logging
from dataclasses import replace

import jax
import numpy as np
import pytest
from made_skies import as_sky, by_hand, EXACT, FREE, HAZE, OWN_NOISE, SOLVER

import skyfit
from skyfit.retrieve import PARAMETERS, start_model, values_of, with_values
from skyfit.retrieve.sampling import GAS_BANDS_NM


DEMO = (
    "aerosol_optical_depth", "angstrom_exponent", "single_scattering_albedo", "asymmetry", "ground_albedo",
    "ozone",
)  # fmt: skip


# the shipped sample, made by another solver


@pytest.fixture(scope="session")
def sample_fit(checkout):
    with jax.enable_x64(True):
        return skyfit.invert(skyfit.read(checkout / "data" / "skies" / "sample.nc"), DEMO, measurement=EXACT)


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
    with jax.enable_x64(True):
        fit = skyfit.invert(sample_fit.sky, sample_fit.free, measurement=OWN_NOISE)
        assert np.all(fit.common == 0.0) and np.all(fit.sigma < sample_fit.sigma)
        columns = []
        for p, name in enumerate(fit.free):
            step = 1e-3 * PARAMETERS[name].spread(fit.values[0, p])
            moved = []
            for sign in (1.0, -1.0):
                values = fit.values[0].copy()
                values[p] += sign * step
                model = with_values(fit.start, fit.free, values)
                moved.append(skyfit.predict(replace(fit.fitted, models=(model,)), fit.sky))
            columns.append(((moved[0] - moved[1]) / (2.0 * step) / fit.sky.sigma)[fit.used])
    jacobian = np.stack(columns, axis=1)
    expected = np.linalg.inv(jacobian.T @ jacobian) * max(fit.reduced_chi_square[0], 1.0)
    # the slopes are those of half a sigma before the end
    np.testing.assert_allclose(fit.sigma[0], np.sqrt(np.diag(expected)), rtol=0.03)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(fit.covariance[0] / scale, expected / scale, atol=0.05)


# small skies, made and fitted by single scattering


def test_turbidity_is_the_same_fit_as_its_optical_depth(x64):
    sky = as_sky(by_hand(), seed=1)
    others = ("angstrom_exponent", "asymmetry")
    depth = skyfit.invert(sky, ("aerosol_optical_depth", *others), SOLVER, measurement=EXACT)
    turbidity = skyfit.invert(sky, ("turbidity", *others), SOLVER, measurement=EXACT)
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


def test_two_lobes_are_not_determined_by_six_directions():
    sky = as_sky(by_hand(directions=6), seed=4)
    free = ("aerosol_optical_depth", "asymmetry", "asymmetry_second", "forward_fraction")
    fit = skyfit.invert(sky, free, SOLVER, measurement=EXACT)
    assert not fit.determined[0].all()
    assert any("not determined" in text or "only a combination" in text for text in fit.undetermined[0])
    lobes = {"asymmetry", "asymmetry_second", "forward_fraction"}
    assert any(lobe in text for text in fit.undetermined[0] for lobe in lobes)
    # their mean is, and stands in their place
    assert "effective asymmetry" in str(fit) and "  asymmetry_second  " not in str(fit)
    found = fit.effective_asymmetry(0)
    assert lobes <= set(found.names) and abs(found.value - 0.65) < 4.0 * found.sigma < 0.2


def test_ozone_is_not_determined_in_the_blue_but_the_haze_is():
    blue = np.arange(400.0, 441.0, 4.0)
    radiance = by_hand(wavelength_nm=blue, angstrom_exponent=1.3, asymmetry=0.7)
    sky = as_sky(radiance, noise=0.1, seed=5, wavelength_nm=blue)
    fit = skyfit.invert(sky, ("aerosol_optical_depth", "ozone"), SOLVER, measurement=EXACT)
    assert fit.determined[0].tolist() == [True, False]
    assert "ozone is not determined by these data" in fit.undetermined[0]
    assert not fit.sigma[0, 1] < 100.0
    assert abs(fit.values[0, 0] - 0.2) < 4.0 * fit.sigma[0, 0] < 0.1


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_parameter_that_the_solver_ignores_spoils_no_other(place):
    """Single scattering sees no ground."""
    sky = as_sky(by_hand(), seed=6)
    plain = skyfit.invert(sky, ("aerosol_optical_depth", "asymmetry"), SOLVER, measurement=EXACT)
    free = ["aerosol_optical_depth", "asymmetry"]
    free.insert(place, "ground_albedo")
    fit = skyfit.invert(sky, free, SOLVER, measurement=EXACT)
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
    fit = skyfit.invert(as_sky(radiance), free, SOLVER, start, measurement=EXACT)
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
    fit = skyfit.invert(
        as_sky(radiance, 0.01, wavelength_nm=red), ("ground_albedo", "asymmetry"), solver, measurement=EXACT
    )
    assert fit.result == ("successful",)
    assert fit.at_bound[0].tolist() == [True, False]
    assert 0.0 <= fit.values[0, 0] < 1e-3
    assert any("ground_albedo stands at its bound" in text for text in fit.undetermined[0])


def test_pointing_offsets_are_recovered(x64):
    """The views were other than stated; the sun, whose beam goes through the air, stands."""
    view = skyfit.hemisphere(40)
    moved = skyfit.Directions(view.zenith - np.radians(1.5), view.azimuth + np.radians(4.0))
    fit = skyfit.invert(
        as_sky(by_hand(view=moved)), (*FREE, "pointing_zenith", "pointing_azimuth"), SOLVER, measurement=EXACT
    )
    np.testing.assert_allclose(fit.values[0], [*HAZE.values(), 1.5, -4.0], rtol=2e-3)
    assert PARAMETERS["pointing_zenith"].unit == PARAMETERS["pointing_azimuth"].unit == "degree"
    assert not fit.at_bound.any() and fit.determined.all()


def test_parameters_that_are_held_keep_the_value_of_the_start():
    start = with_values(start_model(FREE, 101325.0), ("single_scattering_albedo", "ozone"), [0.8, 350.0])
    sky = as_sky(by_hand(single_scattering_albedo=0.8, ozone=350.0))
    fit = skyfit.invert(sky, FREE, SOLVER, start, measurement=EXACT)
    np.testing.assert_allclose(fit.values[0], list(HAZE.values()), rtol=1e-3)
    assert fit.fixed["ozone"] == 350.0 and fit.fixed["single_scattering_albedo"] == pytest.approx(0.8)
    kept = values_of(fit.fitted.models[0], ("ozone", "single_scattering_albedo"))
    assert kept == pytest.approx({"ozone": 350.0, "single_scattering_albedo": 0.8})


def test_each_time_is_fitted_by_itself_and_reported():
    hazes = (0.1, 0.3)
    radiance = np.stack(
        [by_hand(aerosol_optical_depth=h, sun_zenith=s) for h, s in zip(hazes, (0.9, 0.4), strict=True)]
    )
    sky = as_sky(radiance, seed=8, sun_zenith=(0.9, 0.4))
    calls = []
    fit = skyfit.invert(sky, list(FREE), SOLVER, measurement=EXACT, progress=lambda done, of: calls.append((done, of)))
    assert calls == [(1, 2), (2, 2)] and fit.result == ("successful", "successful")
    np.testing.assert_allclose(fit.values[:, 0], hazes, atol=4.0 * fit.sigma[:, 0].max())
    for t in range(2):
        alone = skyfit.invert(sky.at(t), FREE, SOLVER, measurement=EXACT)
        np.testing.assert_array_equal(alone.values[0], fit.values[t])
        np.testing.assert_array_equal(alone.covariance[0], fit.covariance[t])


def test_the_limit_of_steps_is_told():
    fit = skyfit.invert(
        as_sky(by_hand(aerosol_optical_depth=1.5, asymmetry=0.2)), FREE, SOLVER, max_steps=1, measurement=EXACT
    )
    assert fit.result == ("max_steps_reached",)
    # one of the first and one of the last solver
    assert fit.steps[0] == 2
    assert "max_steps_reached" in str(fit)


def test_a_model_that_is_not_finite_fails_in_words_and_not_in_an_exception():
    start = with_values(start_model(FREE, 101325.0), ("ozone",), [np.nan])
    fit = skyfit.invert(as_sky(by_hand()), FREE, SOLVER, start, measurement=EXACT)
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
            skyfit.invert(measured, free, SOLVER, max_steps=99, measurement=EXACT)
        counts.append(sum("compil" in record.getMessage().lower() for record in caplog.records))
    assert counts[0] > 0 and counts[1:] == [0, 0]


def test_error_bars_hold_the_truth_as_often_as_they_say(x64):
    truth = np.array(list(HAZE.values()))
    clean, off = by_hand(), []
    for seed in range(60):
        fit = skyfit.invert(as_sky(clean, 0.02, seed), FREE, SOLVER, measurement=EXACT)
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
        fit = skyfit.invert(replace(sky, sigma=0.5 * sky.sigma), FREE, SOLVER, measurement=EXACT)
        assert fit.reduced_chi_square[0] == pytest.approx(4.0, rel=0.3)
        off.append((fit.values[0] - truth) / fit.sigma[0])
    inside = np.mean(np.abs(off) < 1.0, axis=0)
    assert np.all((inside >= 0.55) & (inside <= 0.80)), inside


@pytest.mark.parametrize(("asymmetry", "said"), ((0.7, False), (0.88, True)))
def test_haze_that_scatters_farther_forward_than_the_streams_resolve_is_noted(asymmetry, said):
    haze = skyfit.Atmosphere.from_optical_depth(0.5, phase=skyfit.HenyeyGreenstein(asymmetry))
    doubt = skyfit.OrdersOfScattering.normal().doubt(haze)
    assert (doubt is not None) == said
    assert skyfit.OrdersOfScattering.fine().doubt(haze) is None
