"""A fit on disk: what `save` writes, that `load` gives the same prediction, and what `load` refuses."""

import json
from copy import deepcopy
from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest
import xarray
from hypothesis import given, HealthCheck, settings, strategies as st
from skies import fit_of_made_sky, MADE_FREE as FREE, MADE_SHARED as SHARED

import skyfit.records.fit.write as fit_record
from skyfit import Aerosol, Atmosphere
from skyfit.atmosphere import CornetteShanks, Droplets, HenyeyGreenstein, Layered, Levels, Rayleigh
from skyfit.measured import NoiseModel, read, Response
from skyfit.records import load, save, write_prediction
from skyfit.retrieve import Fit, predict, SkyModel, start_model
from skyfit.transport import OrdersOfScattering


OWN = tuple(name for name in FREE if name not in SHARED)


@pytest.fixture(scope="session")
def fit() -> Fit:
    """A fit to a sky of the solver's own, with noise."""
    return fit_of_made_sky()


@pytest.fixture(scope="session")
def record(fit, tmp_path_factory) -> dict:
    path = tmp_path_factory.mktemp("record") / "fit.json"
    save(fit, path)
    return json.loads(path.read_text(encoding="utf-8"))


def write(record, path):
    path.write_text(json.dumps(record), encoding="utf-8")
    return path


def keys_of(value) -> set[str]:
    return set(value)


def test_the_record_has_the_documented_keys(record, fit):
    assert keys_of(record) == {
        "schema", "version", "skyfit_version", "source", "solver", "geometry", "instrument", "station",
        "atmosphere", "measurement", "priors", "smooth", "free", "shared", "fixed", "calibration", "times",
        "total_rmse", "notes",
    }  # fmt: skip
    assert (record["schema"], record["version"]) == ("skyfit.fit", 5)
    assert record["source"] == "made.nc"
    assert record["solver"] == {"name": "SingleScattering", "nodes": 8, "geometry": "flat"}
    assert record["geometry"] == "flat"
    assert record["instrument"] == {"fwhm_nm": 6.0, "response": None}
    assert record["station"] == {
        "latitude_deg": None, "longitude_deg": None, "altitude_m": 300.0, "pressure_pa": None,
        "ozone_du": None, "sun_distance_au": None,
    }  # fmt: skip
    assert list(record["atmosphere"]["constituents"]) == ["rayleigh", "aerosol", "ozone"]
    assert record["atmosphere"]["constituents"]["aerosol"]["phase"]["kind"] == "HenyeyGreenstein"
    assert record["atmosphere"]["constituents"]["rayleigh"]["formula"] == "bodhaine"
    assert record["free"] == list(FREE)
    assert record["measurement"] == {
        "relative": None, "floor": None, "calibration": None, "calibration_prior": 0.01,
        "model_error": 0.007, "field_of_view_deg": 0.0, "loss": "huber", "threshold": 3.0,
        "level": None, "colour": None, "pointing_deg": None, "broad_level": None, "broad_colour": None,
        "time_level": 0.0,
    }  # fmt: skip
    assert record["priors"] == record["smooth"] == {}
    assert keys_of(record["shared"]["parameters"]) == set(SHARED)
    assert record["shared"]["parameters"]["asymmetry"]["value"] == fit.values[0, 2] == fit.values[1, 2]
    assert record["shared"]["correlation"] == [[pytest.approx(1.0)]]
    assert record["calibration"]["wavelength_nm"] == [440.0, 500.0, 600.0]
    # all times share the instrument's scale
    assert np.shape(record["calibration"]["scale"]) == np.shape(record["calibration"]["sigma"]) == (1, 3)
    assert 0.0 < np.min(record["calibration"]["sigma"]) <= np.max(record["calibration"]["sigma"]) < 0.0101
    assert record["fixed"]["ozone"] == {"value": 300.0, "unit": "DU"}
    # turbidity is fitted, so its other name is not fixed
    assert not keys_of(record["fixed"]) & {"turbidity", "aerosol_optical_depth", *FREE}
    assert record["notes"] == list(fit.notes)
    assert record["total_rmse"] == fit.total_rmse
    assert len(record["times"]) == 2
    for t, entry in enumerate(record["times"]):
        assert keys_of(entry) == {
            "time", "sun_zenith_deg", "sun_azimuth_deg", "parameters", "correlation", "result", "steps",
            "rmse", "rmse_unit", "samples", "masked", "reduced_chi_square", "noise", "beam", "degrees_of_freedom",
            "rejected", "undetermined", "haze",
        }  # fmt: skip
        noise = entry["noise"]
        assert (noise["sample"], noise["level"], noise["colour"]) == (fit.scale[t], *fit.common[t, :2])
        assert noise["pointing_deg"] == pytest.approx(np.degrees(fit.common[t, 2])) and noise["widening"] >= 1.0
        assert [noise["broad_level"], noise["broad_colour"]] == list(fit.common[t, 3:])
        assert sum(noise["share"].values()) == pytest.approx(1.0, abs=1e-5) and entry["beam"] == []
        assert keys_of(entry["parameters"]) == set(OWN)
        for name in OWN:
            p, shown = FREE.index(name), entry["parameters"][name]
            known = {"value", "unit", "sigma", "model_sigma", "jackknife_sigma", "at_bound", "determined"}
            assert keys_of(shown) == known and shown["jackknife_sigma"] is None
            assert shown["value"] == fit.values[t, p]
            assert shown["sigma"] == fit.sigma[t, p]
            assert 0.0 < shown["model_sigma"] == fit.model_sigma[t, p] < shown["sigma"]
        assert np.diag(entry["correlation"]) == pytest.approx(np.ones(4))
        # 760 nm is in the oxygen band, which the model leaves out
        assert entry["samples"] + sum(entry["masked"].values()) == 40
        assert entry["masked"]["not modelled"] == (9, 10)[t]
    assert [entry["time"] for entry in record["times"]] == ["2024-06-01T10:00:00Z", None]
    assert record["times"][0]["sun_zenith_deg"] == 40.0


def test_what_is_not_finite_is_null(fit, tmp_path):
    sigma = fit.sigma.copy()
    sigma[0, 1], sigma[1, 3] = np.nan, np.inf
    covariance = fit.covariance.copy()
    covariance[0, 1] = np.nan
    path = tmp_path / "fit.json"
    bad = replace(fit, sigma=sigma, covariance=covariance, fwhm_nm=float("nan"))
    save(replace(bad, rmse=np.array([np.nan, np.inf])), path)

    def refuse(word):
        raise AssertionError(word)

    record = json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    first, second = record["times"]
    assert first["parameters"]["angstrom_exponent"]["sigma"] is None
    assert second["parameters"]["pointing_azimuth"]["sigma"] is None
    assert first["correlation"][1][1] is None
    assert first["rmse"] is None and second["rmse"] is None
    assert record["instrument"]["fwhm_nm"] is None
    assert np.isnan(load(path).fwhm_nm)


def test_a_failed_fit_is_written_and_not_loaded(fit, tmp_path):
    values = fit.values.copy()
    values[1, 0] = np.nan
    save(replace(fit, values=values), tmp_path / "fit.json")
    with pytest.raises(ValueError, match=r"fit\.json: .*times\[1\]\.parameters\.turbidity\.value.*null"):
        load(tmp_path / "fit.json")


def test_a_loaded_fit_predicts_the_fitted_sky(fit, tmp_path):
    save(fit, tmp_path / "fit.json")
    loaded = load(tmp_path / "fit.json")
    assert loaded.solver == fit.solver
    np.testing.assert_array_equal(loaded.time, fit.sky.time)
    np.testing.assert_array_equal(loaded.fitted_nm, fit.fitted_nm)
    np.testing.assert_array_equal(loaded.calibration, fit.calibration)
    one = replace(loaded, time=loaded.time[:1], models=loaded.models[:1])
    np.testing.assert_allclose(predict(one, fit.sky.at(0))[0], fit.model[0], rtol=1e-6)
    same = replace(fit.fitted, time=loaded.time[1:], models=fit.fitted.models[1:], calibration=fit.calibration[1:])
    other = replace(loaded, time=loaded.time[1:], models=loaded.models[1:], calibration=loaded.calibration[1:])
    np.testing.assert_allclose(predict(other, fit.sky.at(1))[0], fit.model[1], rtol=1e-6)
    np.testing.assert_array_equal(predict(other, fit.sky.at(1)), predict(same, fit.sky.at(1)))


def other_start(fit, **haze) -> Fit:
    """The fit as if it had started from another atmosphere."""
    haze = {"phase": HenyeyGreenstein(0.7)} | haze
    air = haze.pop("air", Rayleigh(9e4))
    ozone, more = haze.pop("ozone", fit.start.atmosphere.ozone), haze.pop("more", {})
    return replace(fit, start=SkyModel(Atmosphere(air, Aerosol(0.3, **haze), ozone, **more)))


@pytest.mark.parametrize(
    "change",
    [
        {"phase": CornetteShanks(0.6)},
        {"air": Rayleigh(9e4, formula="paper")},
        {"ozone": None},
        {"single_scattering_albedo": 0.8},
        {"profile": Layered([0.0, 1e3, 1e4], [0.8, 0.2])},
        {"more": {"stratosphere": Aerosol(0.02, profile=Levels.elterman_1968()), "fog": Droplets.fog()}},
    ],
    ids=lambda change: next(iter(change)),
)
def test_other_atmospheres_come_back(fit, tmp_path, change):
    changed = other_start(fit, **change)
    changed = replace(
        changed,
        start=eqx.tree_at(
            lambda m: m.atmosphere.rayleigh.profile.scale_height, changed.start, replace_fn=lambda x: 0.9 * x
        ),
    )
    save(changed, tmp_path / "fit.json")
    for back, was in zip(load(tmp_path / "fit.json").models, changed.fitted.models, strict=True):
        assert eqx.tree_equal(back, was, rtol=1e-6)


def test_nothing_is_lost_where_the_haze_is_fixed(fit, tmp_path):
    free = ("ground_albedo",)
    start = start_model(free, 9e4)
    changed = replace(
        fit, free=free, start=start, values=fit.values[:, 2:3], sigma=fit.sigma[:, 2:3],
        covariance=fit.covariance[:, 2:3, 2:3], at_bound=fit.at_bound[:, 2:3], model_sigma=fit.model_sigma[:, 2:3],
        determined=fit.determined[:, 2:3], solver=OrdersOfScattering.draft(), shared=(),
    )  # fmt: skip
    save(changed, tmp_path / "fit.json")
    loaded = load(tmp_path / "fit.json")
    assert loaded.solver == OrdersOfScattering.draft()
    assert eqx.tree_equal(loaded.models[0], changed.fitted.models[0], rtol=1e-7)


def test_what_cannot_be_rebuilt_is_refused_with_the_reason(fit, tmp_path):
    class Own(Layered):
        """A profile of the user's."""

    save(other_start(fit, profile=Own([0.0, 1e3], [1.0])), tmp_path / "fit.json")
    place = r"atmosphere\.constituents\.aerosol\.profile\.kind"
    with pytest.raises(ValueError, match=rf"fit\.json: .*{place}.*Exponential.*Own.*only the program that made it"):
        load(tmp_path / "fit.json")


def put(record, path, value):
    """A copy of the record with the value at a path of keys; deleted where the value is `...`."""
    record = deepcopy(record)
    place = record
    for key in path[:-1]:
        place = place[key]
    if value is ...:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return record


HAZE = ("atmosphere", "constituents", "aerosol")
REFUSED = {
    "schema": (("schema",), "other", "schema"),
    "no schema": (("schema",), ..., "schema"),
    "version": (("version",), 6, "version"),
    "version of an older skyfit": (("version",), 4, "version`: expected 5, found 4, of an older skyfit: fit"),
    "no solver": (("solver",), ..., "solver"),
    "solver name": (("solver", "name"), "Magic", r"solver\.name"),
    "solver setting": (("solver", "nodes"), "8", r"solver\.nodes"),
    "solver without": (("solver", "nodes"), ..., r"solver\.nodes"),
    "solver with more": (("solver", "streams"), 4, r"solver\.streams"),
    "solver geometry": (("solver", "geometry"), "round", "geometry"),
    "geometry": (("geometry",), "spherical", "geometry"),
    "fwhm": (("instrument", "fwhm_nm"), "wide", r"instrument\.fwhm_nm"),
    "no station": (("station", "altitude_m"), ..., r"station\.altitude_m"),
    "phase": ((*HAZE, "phase", "kind"), "Mie", r"atmosphere\.constituents\.aerosol\.phase\.kind"),
    "no kind": ((*HAZE, "kind"), ..., r"atmosphere\.constituents\.aerosol\.kind"),
    "number": ((*HAZE, "profile", "scale_height"), None, r"constituents\.aerosol\.profile\.scale_height"),
    "number more": ((*HAZE, "magic"), 1.0, r"constituents\.aerosol\.magic"),
    "constituents": (("atmosphere", "constituents"), ..., r"atmosphere\.constituents"),
    "ground": (("atmosphere", "ground", "albedo"), "green", r"atmosphere\.ground\.albedo"),
    "free": (("free",), ["turbidity", "magic"], "free"),
    "free twice": (("free",), [*FREE, "aerosol_optical_depth"], "free"),
    "fixed without": (("fixed", "pressure"), ..., r"fixed\.pressure"),
    "fixed and free": (("fixed", "turbidity"), {"value": 3.0, "unit": "1"}, r"fixed\.turbidity"),
    "fixed otherwise": (("fixed", "pressure", "value"), 5e4, r"fixed\.pressure\.value`: expected that of `atmosphere"),
    "fixed unit": (("fixed", "pressure", "unit"), "hPa", r"fixed\.pressure\.unit"),
    "no times": (("times",), [], "times"),
    "times": (("times",), {}, "times"),
    "time": (("times", 0, "time"), "noon", r"times\[0\]\.time"),
    "parameter": (("times", 1, "parameters", "turbidity"), ..., r"times\[1\]\.parameters\.turbidity"),
    "shared too": (("shared", "parameters", "asymmetry"), ..., r"parameters\.asymmetry"),
    "value": (("times", 1, "parameters", "pointing_azimuth", "value"), 30.0, r"azimuth\.value"),
    "shared value": (("shared", "parameters", "asymmetry", "value"), 3.0, r"shared\.parameters\.asymmetry\.value"),
    "true": (("times", 1, "parameters", "pointing_azimuth", "value"), True, r"azimuth\.value"),
    "flag": (("times", 1, "parameters", "pointing_azimuth", "at_bound"), 0, r"azimuth\.at_bound"),
    "correlation": (("times", 0, "correlation"), [[1.0, "x"]], r"times\[0\]\.correlation\[0\]\[1\]"),
    "response": (("instrument", "response"), "xyz", r"instrument\.response"),
    "prior": (("priors",), {"ozone": {"value": 300.0}}, r"priors\.ozone\.sigma"),
    "loss": (("measurement", "loss"), ..., r"measurement\.loss"),
    "calibration": (("calibration", "scale", 0, 1), None, r"calibration\.scale\[0\]\[1\]"),
    "calibration rows": (("calibration", "scale"), [[1.0] * 3] * 3, r"calibration\.scale"),
    "calibration row": (("calibration", "scale"), [[1.0] * 2], r"calibration\.scale"),
    "calibration falls": (("calibration", "wavelength_nm", 0), 700.0, r"calibration\.wavelength_nm"),
    "noise": (("times", 0, "noise", "share", "level"), ..., r"times\[0\]\.noise\.share\.level"),
    "beam": (("times", 0, "beam"), [{"wavelength_nm": 500.0}], r"times\[0\]\.beam\[0\]\.residual"),
    "rejected": (("times", 0, "rejected"), [{"view_zenith_deg": 3.0}], r"times\[0\]\.rejected\[0\]\.view_azimuth_deg"),
    "steps": (("times", 0, "steps"), -1, r"times\[0\]\.steps"),
    "notes": (("notes",), ["fine", 3], r"notes\[1\]"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_another_record_is_refused_in_one_line(record, tmp_path, case):
    path, value, told = REFUSED[case]
    file = write(put(record, path, value), tmp_path / "odd.json")
    with pytest.raises(ValueError, match=rf"^odd\.json: key `[^`]*{told}") as caught:
        load(file)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"schema": NaN}', "[" * 100000, "\udcff"])
def test_other_files_are_refused_in_one_line(tmp_path, text):
    file = tmp_path / "odd.json"
    file.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(ValueError, match=r"^odd\.json: ") as caught:
        load(file)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"none\.json: cannot be read"):
        load(tmp_path / "none.json")


def places(value, path=()):
    yield path
    for key in value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ():
        yield from places(value[key], (*path, key))


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_record_never_gives_another_error(record, tmp_path, data):
    path = data.draw(st.sampled_from(sorted(filter(None, places(record)), key=str)))
    value = data.draw(st.sampled_from([..., None, True, -1, 10**400, 1.5, "text", [], {}, [[]]]))
    try:
        load(write(put(record, path, value), tmp_path / "odd.json"))
    except ValueError as error:
        assert str(error).startswith("odd.json: ") and "\n" not in str(error)


def test_parameters_of_all_times_are_read(record, tmp_path):
    changed = put(record, ("shared", "parameters", "asymmetry", "value"), 0.61)
    for model in load(write(changed, tmp_path / "fit.json")).models:
        assert float(model.atmosphere.aerosol.phase.asymmetry) == pytest.approx(0.61)


def test_times_that_share_nothing_have_all_parameters_and_scales_of_their_own(fit, tmp_path):
    calibration = fit.calibration * np.array([[1.0], [1.01]])
    save(replace(fit, shared=(), calibration=calibration), tmp_path / "fit.json")
    record = json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))
    assert record["shared"] == {"parameters": {}, "correlation": []}
    assert all(list(entry["parameters"]) == list(FREE) for entry in record["times"])
    np.testing.assert_array_equal(record["calibration"]["scale"], calibration)
    np.testing.assert_array_equal(load(tmp_path / "fit.json").calibration, calibration)


def test_what_was_asked_for_is_told(fit, tmp_path):
    asked = NoiseModel(
        0.01, 0.02, 0.03, 0.004, np.radians(5.0), "cauchy", 2.0, 0.02, 0.01, np.radians(0.2), 0.005, 0.03, 0.04
    )
    weight = fit.weight.copy()
    weight[1, 4] = [0.2, 0.4, np.nan]
    changed = replace(
        fit, measurement=asked, priors={"angstrom_exponent": (1.2, 0.3)}, response=Response.xyz(), weight=weight,
        smooth={"turbidity": 0.2, "pointing_azimuth": 0.5},
    )  # fmt: skip
    save(changed, tmp_path / "fit.json")
    record = json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))
    assert record["measurement"] == {
        "relative": 0.01, "floor": 0.02, "calibration": 0.03, "calibration_prior": 0.03, "model_error": 0.004,
        "field_of_view_deg": 5.0, "loss": "cauchy", "threshold": 2.0,
        "level": 0.02, "colour": 0.01, "pointing_deg": pytest.approx(0.2), "broad_level": 0.03, "broad_colour": 0.04,
        "time_level": 0.005,
    }  # fmt: skip
    assert record["priors"] == {"angstrom_exponent": {"value": 1.2, "sigma": 0.3, "unit": "1"}}
    assert record["smooth"] == {
        "turbidity": {"sigma_per_hour": 0.2, "unit": "1"},
        "pointing_azimuth": {"sigma_per_hour": 0.5, "unit": "degree"},
    }
    assert np.shape(record["instrument"]["response"]["weight"]) == (3, 41)
    assert record["times"][0]["rejected"] == []
    (direction,) = record["times"][1]["rejected"]
    assert direction == {"view_zenith_deg": 55.0, "view_azimuth_deg": 60.0, "weight": pytest.approx(0.3)}
    load(tmp_path / "fit.json")


def test_the_field_is_written(fit, tmp_path):
    path = tmp_path / "fit.nc"
    save(fit, path)
    with xarray.open_dataset(path, engine="h5netcdf") as data:
        for name in ("model", "residual", "radiance"):
            assert data[name].dims == ("time", "direction", "wavelength")
            assert data[name].attrs["units"] == "W m-2 sr-1 nm-1"
            assert set(data[name].coords) == {"time", "wavelength", "view_zenith", "view_azimuth"}
        np.testing.assert_array_equal(data["fitted_wavelength"], [440.0, 500.0, 600.0])
        assert data["weight"].dims == ("time", "direction", "fitted_wavelength")
        np.testing.assert_array_equal(data["weight"], fit.weight)
        np.testing.assert_array_equal(np.isnan(data["weight"]), ~fit.used[..., :3])
        assert data["gain"].dims == ("time", "parameter", "direction", "fitted_wavelength")
        assert data["parameter"].values.tolist() == list(FREE)
        np.testing.assert_allclose(data["gain"], fit.gain, rtol=1e-6)
        np.testing.assert_array_equal(data["model"], fit.model)
        np.testing.assert_array_equal(np.isnan(data["residual"]), ~fit.used)
        np.testing.assert_array_equal(data["residual"].values[fit.used], fit.residual[fit.used])
        assert np.sqrt(np.nanmean(data["residual"] ** 2)) == pytest.approx(fit.total_rmse)
    back = read(path)
    np.testing.assert_array_equal(back.radiance, fit.sky.radiance)
    np.testing.assert_array_equal(back.usable, fit.sky.usable)


def test_a_gain_too_large_for_a_file_is_left_out(fit, tmp_path, monkeypatch):
    monkeypatch.setattr(fit_record, "_MOST_GAIN", fit.gain.size - 1)
    save(fit, tmp_path / "fit.nc")
    with xarray.open_dataset(tmp_path / "fit.nc", engine="h5netcdf") as data:
        assert "gain" not in data.variables and "weight" in data


def test_a_prediction_reads_back(fit, tmp_path):
    path = tmp_path / "prediction.nc"
    radiance = fit.model.copy()
    radiance[0, 0, 3] = np.nan
    write_prediction(fit.sky, radiance, path)
    back = read(path)
    np.testing.assert_array_equal(back.radiance, radiance)
    assert back.masked == {"missing": 1}
    np.testing.assert_allclose(back.view_azimuth, fit.sky.view_azimuth, atol=1e-11)
    np.testing.assert_array_equal(back.time, fit.sky.time)
    assert "predicted" in back.notes[0]
    with pytest.raises(ValueError, match="`radiance` must have the shape"):
        write_prediction(fit.sky, radiance[:1], path)


def test_nothing_is_left_half_written(fit, tmp_path, monkeypatch):
    for name in ("fit.txt", "fit"):
        with pytest.raises(ValueError, match=r"expected a suffix of \.json, \.nc"):
            save(fit, tmp_path / name)
    with pytest.raises(ValueError, match="existing folder"):
        save(fit, tmp_path / "none" / "fit.json")
    (tmp_path / "fit.json").write_text("old")
    (tmp_path / "fit.nc").write_text("old")

    def fail(*_, **__):
        raise RuntimeError("the disk is full")

    monkeypatch.setattr(fit_record.json, "dumps", fail)
    monkeypatch.setattr(xarray.Dataset, "to_netcdf", fail)
    for name in ("fit.json", "fit.nc"):
        with pytest.raises(RuntimeError, match="full"):
            save(fit, tmp_path / name)
        assert (tmp_path / name).read_text() == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fit.json", "fit.nc"]
