import inspect
import json
from dataclasses import replace
from importlib.metadata import version

import numpy as np
import pytest
import xarray
from skies import fit_of_made_sky

import skyfit
from skyfit import programs
from skyfit.cli import app, known
from skyfit.cli.fit_report import print_fit
from skyfit.cli.models import kept_radiance, turbidity_of
from skyfit.retrieve import PARAMETERS, PARTICLE_FREE, SLOW, values_of
from skyfit.retrieve.parameters import SIZE_BINS


# of a haze of spheres, which the skies here have not
SPHERES = (
    "fine_fraction", "fine_radius", "coarse_radius", "fine_width", "coarse_width", "refractive_index",
    "absorption_index", "refractive_index_slope", "absorption_index_exponent", "absorption_index_curvature",
    *SIZE_BINS,
)  # fmt: skip


WAVELENGTHS = "420:680:20"


@pytest.fixture(autouse=True)
def nothing_kept():
    """A command that was called in this process keeps programs from then on."""
    yield
    programs.keep_in(None)


@pytest.fixture(scope="session")
def chain(skyfit_command, tmp_path_factory):
    """A sky simulated and inverted: the folder with sky.nc and fit/, and what the two calls printed."""
    folder = tmp_path_factory.mktemp("chain")
    simulated = skyfit_command(
        "simulate", "--sun-zenith", 60, "--turbidity", 3, "--solver", "single", "--geometry", "flat",
        "--preset", "draft", "--wavelengths", WAVELENGTHS, "--fwhm", 5, "--out", "sky.nc", cwd=folder,
    )  # fmt: skip
    inverted = skyfit_command(
        "invert", "sky.nc", "--free", "turbidity, angstrom_exponent", "--solver", "single", "--geometry", "flat",
        "--preset", "draft", "--products", "--out", "fit", cwd=folder,
    )  # fmt: skip
    return folder, simulated.stdout, inverted.stdout


def narrow(text: str) -> bool:
    return all(len(line) <= 80 for line in text.splitlines())


def test_simulate_writes_a_sky_that_read_takes(chain):
    folder, printed, _ = chain
    sky = skyfit.read(folder / "sky.nc")
    assert sky.radiance.shape == (1, 343, 14) and sky.usable.all()
    assert np.degrees(sky.sun_zenith) == pytest.approx([60.0])
    assert np.degrees(sky.sun_azimuth) == pytest.approx([180.0])
    assert sky.fwhm_nm == 5.0 and np.isnat(sky.time).all()
    # what made it is written with it
    assert (sky.pressure_pa, sky.ozone_du, sky.sun_distance_au) == (101325.0, 300.0, 1.0) and np.isnan(sky.altitude_m)
    assert sky.made_by["solver"] == {"name": "SingleScattering", "nodes": 12, "geometry": "flat"}
    made = skyfit.atmosphere.from_description(sky.made_by["atmosphere"])
    depth = float(skyfit.turbidity_to_optical_depth(3.0))
    assert float(made.aerosol.optical_depth) == pytest.approx(depth, rel=1e-6) and sky.notes == ()
    assert "sky.nc" in printed and "343 directions, 14 wavelengths" in printed and narrow(printed)
    assert "model: SingleScattering, flat, scalar (polarisation left out), float64" in printed


def test_the_simulated_sky_is_the_solvers_own(chain):
    folder, _, _ = chain
    sky = skyfit.read(folder / "sky.nc")
    scene = skyfit.Scene.from_degrees(60.0, skyfit.hemisphere(343), sky.wavelength_nm, 180.0, fwhm_nm=5.0)
    solver = skyfit.SingleScattering.draft("flat")
    expected = solver.radiance(skyfit.Atmosphere.from_turbidity(3.0), scene)
    np.testing.assert_allclose(sky.radiance[0], expected, rtol=1e-4)


def test_invert_gives_the_turbidity_back(chain):
    folder, _, printed = chain
    record = json.loads((folder / "fit" / "fit.json").read_text())
    (time,) = record["times"]
    turbidity = time["parameters"]["turbidity"]
    assert turbidity["value"] == pytest.approx(3.0, abs=2e-3)
    assert time["parameters"]["angstrom_exponent"]["value"] == pytest.approx(1.3, abs=2e-3)
    assert turbidity["unit"] == "1" and 0.0 < turbidity["sigma"] < 0.1
    assert (turbidity["at_bound"], turbidity["determined"]) == (False, True)
    assert "successful" in printed and "turbidity" in printed and "held fixed" in printed
    assert "RMSE over all" in printed and "60.00" in printed and "180.00" in printed
    assert "all of these are determined by the data" in printed
    assert narrow(printed)
    assert "aerosol.csv" in printed
    rows = (folder / "fit" / "aerosol.csv").read_text().splitlines()
    # of four quantities, at each wavelength that was fitted
    assert rows[0].startswith("time,quantity,wavelength_nm") and (len(rows) - 1) % 4 == 0
    assert rows[1].split(",")[1] == "absorption_optical_depth" and (folder / "fit" / "aerosol.nc").exists()


def test_fit_json_has_the_keys_of_its_schema(chain):
    folder, _, _ = chain
    record = json.loads((folder / "fit" / "fit.json").read_text())
    assert set(record) == {
        "schema", "version", "skyfit_version", "source", "solver", "geometry", "instrument", "station",
        "atmosphere", "measurement", "priors", "smooth", "free", "shared", "fixed", "calibration", "times",
        "total_rmse", "notes",
    }  # fmt: skip
    assert (record["schema"], record["version"], record["source"]) == ("skyfit.fit", 5, "sky.nc")
    assert record["solver"] == {"name": "SingleScattering", "nodes": 12, "geometry": "flat"}
    assert record["geometry"] == "flat" and record["instrument"] == {"fwhm_nm": 5.0, "response": None}
    assert record["station"] == {
        "latitude_deg": None, "longitude_deg": None, "altitude_m": None, "pressure_pa": 101325.0, "ozone_du": 300.0,
        "sun_distance_au": 1.0,
    }  # fmt: skip
    assert not any("assumed" in note or "date" in note or "unlike" in note for note in record["notes"])
    assert record["free"] == ["turbidity", "angstrom_exponent"]
    assert record["shared"] == {"parameters": {}, "correlation": []}
    assert all(set(entry) == {"value", "unit"} for entry in record["fixed"].values())
    assert set(record["fixed"]) == set(PARAMETERS) - {
        "turbidity", "aerosol_optical_depth", "angstrom_exponent", "asymmetry_second", "forward_fraction",
        "forward_fraction_slope", *SPHERES,
    }  # fmt: skip
    (time,) = record["times"]
    assert set(time) == {
        "time", "sun_zenith_deg", "sun_azimuth_deg", "parameters", "correlation", "result", "steps", "rmse",
        "rmse_unit", "samples", "masked", "reduced_chi_square", "noise", "beam", "degrees_of_freedom",
        "rejected", "undetermined", "haze",
    }  # fmt: skip
    assert time["time"] is None and time["result"] == "successful" and time["undetermined"] == []
    assert (time["sun_zenith_deg"], time["sun_azimuth_deg"]) == pytest.approx((60.0, 180.0))
    for entry in time["parameters"].values():
        assert set(entry) == {"value", "unit", "sigma", "model_sigma", "jackknife_sigma", "at_bound", "determined"}
    assert np.shape(time["correlation"]) == (2, 2) and time["correlation"][0][0] == pytest.approx(1.0)
    assert time["samples"] == 343 * 14 and time["masked"] == {}
    assert time["rmse"] == record["total_rmse"] < 1e-4 and time["rmse_unit"] == "W m-2 sr-1 nm-1"


def test_fit_nc_and_png_go_with_it(chain):
    folder, _, _ = chain
    written = ["aerosol.csv", "aerosol.nc", "fit.json", "fit.nc", "fit.png"]
    assert sorted(path.name for path in (folder / "fit").iterdir()) == written
    sky = skyfit.read(folder / "sky.nc")
    with xarray.open_dataset(folder / "fit" / "fit.nc") as fields:
        assert fields["model"].dims == fields["residual"].dims == ("time", "direction", "wavelength")
        np.testing.assert_allclose(fields["wavelength"], sky.wavelength_nm)
        np.testing.assert_allclose(fields["model"] - fields["residual"], sky.radiance, rtol=1e-5)
    assert (folder / "fit" / "fit.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ["predicted.nc", "predicted.csv"])
def test_predict_reproduces_the_sky(chain, skyfit_command, name):
    folder, _, _ = chain
    done = skyfit_command("predict", "fit/fit.json", "--at", "sky.nc", "--out", name, cwd=folder)
    sky, predicted = skyfit.read(folder / "sky.nc"), skyfit.read(folder / name)
    assert "1 x 343 x 14" in done.stdout and narrow(done.stdout)
    order = np.lexsort((predicted.view_azimuth[0], predicted.view_zenith[0]))
    same = np.lexsort((sky.view_azimuth[0], sky.view_zenith[0]))
    np.testing.assert_allclose(predicted.view_zenith[0, order], sky.view_zenith[0, same], atol=1e-6)
    np.testing.assert_allclose(predicted.radiance[:, order], sky.radiance[:, same], rtol=1e-3)
    if name.endswith(".nc"):
        with xarray.open_dataset(folder / name) as fields:
            with xarray.open_dataset(folder / "fit" / "fit.nc") as fit:
                np.testing.assert_allclose(fields["radiance"], fit["model"], rtol=1e-6)


def test_directions_of_a_file_simulated_to_csv_and_predicted_there(chain, skyfit_command):
    folder, _, _ = chain
    (folder / "views.csv").write_text("view_zenith,view_azimuth\n0,0\n40,170\n70,20\n")
    settings = ("--solver", "single", "--geometry", "flat", "--preset", "draft")
    done = skyfit_command(
        "simulate", "--sun-zenith", 60, "--turbidity", 3, "--directions", "views.csv", "--wavelengths", "450,550",
        "--fwhm", 5, *settings, "--out", "few.csv", cwd=folder,
    )  # fmt: skip
    assert "3 directions, 2 wavelengths" in done.stdout
    few = skyfit.read(folder / "few.csv")
    np.testing.assert_allclose(np.degrees(few.view_zenith[0]), [0.0, 40.0, 70.0], atol=1e-6)
    np.testing.assert_allclose(np.degrees(few.view_azimuth[0]), [0.0, 170.0, 20.0], atol=1e-6)
    np.testing.assert_array_equal(few.wavelength_nm, [450.0, 550.0])
    skyfit_command("predict", "fit/fit.json", "--at", "few.csv", "--out", "there.nc", cwd=folder)
    np.testing.assert_allclose(skyfit.read(folder / "there.nc").radiance, few.radiance, rtol=2e-3)


def test_a_sky_of_a_mountain_at_a_time_comes_back(skyfit_command, tmp_path):
    """Pressure, ozone and the day's distance of the sun go through the file."""
    settings = ("--solver", "single", "--geometry", "flat", "--preset", "draft")
    skyfit_command(
        "simulate", "--time", "2020-07-04T17:00:00Z", "--at", "40,-105.5", "--aerosol-optical-depth", 0.05,
        "--pressure", 62000, "--ozone", 350, "--wavelengths", "440:680:40", "--out", "mk.csv",
        *settings, cwd=tmp_path,
    )  # fmt: skip
    sky = skyfit.read(tmp_path / "mk.csv")
    assert sky.time == [np.datetime64("2020-07-04T17:00")] and (sky.latitude_deg, sky.longitude_deg) == (40.0, -105.5)
    place = skyfit.measured.solar_position(sky.time, 40.0, -105.5, pressure=62000.0, refracted=0.5)
    np.testing.assert_allclose([sky.sun_zenith, sky.sun_azimuth], place, rtol=1e-9)
    assert np.isnan(sky.sun_distance_au)
    free = ("aerosol_optical_depth", "single_scattering_albedo")
    skyfit_command("invert", "mk.csv", "--free", ",".join(free), *settings, "--out", "fit", cwd=tmp_path)
    record = json.loads((tmp_path / "fit" / "fit.json").read_text())
    found = [record["times"][0]["parameters"][name]["value"] for name in free]
    assert found == pytest.approx([0.05, 0.95], rel=5e-3)
    assert record["fixed"]["pressure"]["value"] == 62000.0 and record["fixed"]["ozone"]["value"] == 350.0
    assert not any("date" in note or "assumed" in note or "unlike" in note for note in record["notes"])
    # from an atmosphere of a file, whose ozone is another and whose pressure is kept too
    air = skyfit.Atmosphere.from_optical_depth(0.3).replace(rayleigh=skyfit.Rayleigh(62000.0), ozone=None)
    (tmp_path / "site.json").write_text(json.dumps(skyfit.atmosphere.describe(air)))
    call = ("invert", "mk.csv", "--free", ",".join(free), "--atmosphere", "site.json", *settings, "--out", "own")
    skyfit_command(*call, cwd=tmp_path)
    own = json.loads((tmp_path / "own" / "fit.json").read_text())
    assert own["times"][0]["parameters"][free[0]]["value"] > 0.051 and "ozone" not in own["fixed"]
    assert own["fixed"]["pressure"]["value"] == 62000.0
    refused = skyfit_command(*call, "--fix", "ozone=300", cwd=tmp_path, check=False)
    assert refused.returncode == 2 and "'ozone', which this atmosphere does not have" in " ".join(
        refused.stderr.split()
    )


def two_skies(path):
    """A sky at two times whose haze grows: 40 directions, 5 wavelengths, 1 % noise; a bird at one."""
    view, wavelength, solver = (
        skyfit.hemisphere(40),
        np.linspace(440.0, 680.0, 5),
        skyfit.SingleScattering.draft("flat"),
    )
    radiance = np.stack([
        solver.radiance(
            skyfit.Atmosphere.from_turbidity(turbidity).replace(ozone=skyfit.Ozone(350.0)),
            skyfit.Scene.from_degrees(zenith, view, wavelength, 180.0),
        )
        for zenith, turbidity in ((50.0, 3.0), (40.0, 3.3))
    ])  # fmt: skip
    radiance = radiance * np.random.default_rng(1).normal(1.0, 0.01, radiance.shape)
    radiance[1, 7] *= 3.0
    sky = skyfit.Sky(
        radiance, None, np.ones(radiance.shape, bool), np.asarray(view.zenith), np.asarray(view.azimuth), wavelength,
        np.radians([50.0, 40.0]), np.radians([180.0, 180.0]),
        np.array(["2025-06-01T10:00", "2025-06-01T11:00"], "datetime64[ns]"), altitude_m=0.0,
    )  # fmt: skip
    skyfit.write_sky(sky, path)
    return np.degrees([sky.view_zenith[0, 7], sky.view_azimuth[0, 7]])


def test_a_file_of_two_times_shares_what_is_slow(skyfit_command, tmp_path):
    bird = two_skies(tmp_path / "two.nc")
    done = skyfit_command(
        "invert", "two.nc", "--free", "turbidity,angstrom_exponent,asymmetry", "--fix", "ozone=350", "--prior",
        "angstrom_exponent=1.2,0.5", "--smooth", "turbidity=0.5", "--relative", 0.01, "--floor", 0.0, "--calibration",
        0.02, "--loss", "cauchy", "--threshold", 2, "--model-error", 0.002, "--solver", "single", "--geometry", "flat",
        "--preset", "draft", "--out", "fit", cwd=tmp_path,
    )  # fmt: skip
    record = json.loads((tmp_path / "fit" / "fit.json").read_text())
    assert list(record["shared"]["parameters"]) == ["asymmetry"]
    assert record["shared"]["parameters"]["asymmetry"]["value"] == pytest.approx(0.7, abs=0.02)
    assert record["fixed"]["ozone"] == {"value": 350.0, "unit": "DU"}
    assert record["priors"] == {"angstrom_exponent": {"value": 1.2, "sigma": 0.5, "unit": "1"}}
    assert record["smooth"] == {"turbidity": {"sigma_per_hour": 0.5, "unit": "1"}}
    told = {
        "relative": 0.01,
        "floor": 0.0,
        "calibration": 0.02,
        "model_error": 0.002,
        "loss": "cauchy",
        "threshold": 2.0,
    }
    assert told.items() <= record["measurement"].items()
    for entry, turbidity in zip(record["times"], (3.0, 3.3), strict=True):
        assert list(entry["parameters"]) == ["turbidity", "angstrom_exponent"]
        found = entry["parameters"]["turbidity"]
        assert found["value"] == pytest.approx(turbidity, abs=4.0 * found["sigma"]) and found["sigma"] < 0.3
    assert record["times"][0]["rejected"] == []
    (rejected,) = record["times"][1]["rejected"]
    assert (rejected["view_zenith_deg"], rejected["view_azimuth_deg"]) == pytest.approx(bird)
    printed = " ".join(done.stdout.split())
    assert narrow(done.stdout) and "2 skies, 2025-06-01" in printed
    # each parameter stands in one table, a row for each time
    assert done.stdout.count("asymmetry") == 1 and done.stdout.count("turbidity") == 2
    assert sum(line.split()[:1] in (["10:00"], ["11:00"]) for line in done.stdout.splitlines()) == 4
    for words in (
        "ozone 350 DU", "prior: angstrom_exponent 1.2 +- 0.5", "smooth: turbidity, change of its logarithm",
        "SingleScattering, flat, scalar", "times the stated one", "a model error of 0.2 %", "calibration: scale",
        "prior 0.02",
        f"rejected, 11:00: 1 direction, zenith azimuth {bird[0]:.0f} {bird[1]:.0f}",
    ):  # fmt: skip
        assert words in printed, printed


def asked(monkeypatch, folder, *words):
    """What `skyfit invert` asks of `skyfit.invert`, by name; the program itself ends there."""
    found, parameters = {}, inspect.signature(skyfit.invert)

    def ask(*values, **named):
        found.update(parameters.bind(*values, **named).arguments)
        raise ValueError("asked")

    monkeypatch.setattr(skyfit.retrieve, "invert", ask)
    monkeypatch.chdir(folder)
    with pytest.raises(ValueError, match="asked"):
        app(["invert", "two.nc", "--out", "new", *words], standalone_mode=False)
    assert not (folder / "new").exists()
    return found


def test_the_options_of_invert_reach_the_fit(monkeypatch, tmp_path):
    two_skies(tmp_path / "two.nc")
    (tmp_path / "camera.csv").write_text("wavelength_nm,blue,green\n450,1,0\n550,0,2\n650,0,1\n")
    usual = asked(monkeypatch, tmp_path)
    # the usual names are the fit's own to say
    assert usual["free"] is None and usual["shared"] == tuple(n for n in PARTICLE_FREE if n in SLOW)
    assert {*values_of(usual["start"], PARTICLE_FREE)} == {*PARTICLE_FREE}
    known = asked(monkeypatch, tmp_path, "--fix", "pointing_zenith=0.5")["free"]
    assert known == tuple(n for n in PARTICLE_FREE if n != "pointing_zenith")
    # the usual slopes are those of `invert` itself
    assert usual["solver"] == skyfit.OrdersOfScattering.normal(polarised=True) and "draft" not in usual
    assert usual["measurement"] == skyfit.NoiseModel() and usual["starts"] == 1
    assert usual["response"] is None and usual["priors"] == usual["smooth"] == {}
    whole = skyfit.read(tmp_path / "two.nc")

    def with_channels(count):
        """The file with so many columns: a response is held to them when it is read."""
        part = replace(
            whole, radiance=whole.radiance[..., :count], usable=whole.usable[..., :count],
            sigma=None if whole.sigma is None else whole.sigma[..., :count], wavelength_nm=whole.wavelength_nm[:count],
        )  # fmt: skip
        skyfit.write_sky(part, tmp_path / "two.nc")

    with_channels(2)
    given = asked(
        monkeypatch, tmp_path, "--preset", "fine", "--field-of-view", "5", "--starts", "4", "--smooth", "asymmetry=0.1",
        "--smooth", "turbidity=0.3", "--free", "turbidity,asymmetry,ozone", "--response", "camera.csv",
    )  # fmt: skip
    assert given["solver"] == skyfit.OrdersOfScattering.fine() and "draft" not in given
    assert given["measurement"] == skyfit.NoiseModel(field_of_view=np.radians(5.0)) and given["starts"] == 4
    # what is smooth in time is not the same at all times
    assert given["smooth"] == {"asymmetry": 0.1, "turbidity": 0.3} and given["shared"] == ("ozone",)
    np.testing.assert_allclose(given["response"].weight, [[50.0, 0.0, 0.0], [0.0, 200.0, 50.0]])
    scalar = asked(monkeypatch, tmp_path, "--scalar", "--free", "particles,ozone")
    assert scalar["solver"] == skyfit.OrdersOfScattering.normal() and scalar["free"] == (*PARTICLE_FREE, "ozone")
    single = asked(monkeypatch, tmp_path, "--solver", "single")
    assert single["solver"] == skyfit.SingleScattering.normal()
    assert asked(monkeypatch, tmp_path, "--independent")["shared"] == ()
    assert asked(monkeypatch, tmp_path, "--shared", "asymmetry, ground_albedo")["shared"] == (
        "asymmetry",
        "ground_albedo",
    )
    with_channels(3)
    for name, kind in (("xyz", skyfit.Response.xyz()), ("srgb", skyfit.Response.linear_srgb())):
        np.testing.assert_array_equal(asked(monkeypatch, tmp_path, "--response", name)["response"].weight, kind.weight)


def test_what_is_printed_of_many_parameters_and_of_poor_ones(capsys):
    fit = fit_of_made_sky()
    print_fit(fit)
    printed = capsys.readouterr().out
    assert "all times" in printed and "each time" in printed and narrow(printed)
    assert "calibration: scale" in printed and "beyond 3 times its prior" not in printed
    assert "not determined" not in printed and "rejected" not in printed
    sigma, at_bound, determined = fit.sigma.copy(), fit.at_bound.copy(), fit.determined.copy()
    sigma[0, 3], at_bound[1, 1], determined[0, 3] = np.inf, True, False
    weight, calibration = fit.weight.copy(), fit.calibration.copy()
    weight[0, :8], calibration[:, 1] = 0.1, 1.05
    poor = replace(
        fit, sigma=sigma, at_bound=at_bound, determined=determined, weight=weight, calibration=calibration,
        undetermined=(("angle open",), ()), response=skyfit.Response.xyz(),
    )  # fmt: skip
    print_fit(poor)
    printed = " ".join(capsys.readouterr().out.split())
    assert "inf?" in printed and "! at its bound, ? not determined" in printed and "angle open" in printed
    assert "rejected, 2024-06-01 10:00: 8 directions" in printed and "and 2 more" in printed
    assert "beyond 3 times its prior at 1 of 3 wavelengths" in printed
    assert "in the unit of the channels" in printed and "mW" not in printed
    # wider than a window: a table for each time
    many = 3 * list(range(4))
    wide = replace(
        fit, free=tuple(fit.free[p] for p in many), shared=(), values=fit.values[:, many], sigma=fit.sigma[:, many],
        model_sigma=fit.model_sigma[:, many], jackknife_sigma=fit.sigma[:, many], at_bound=fit.at_bound[:, many],
        determined=fit.determined[:, many],
    )  # fmt: skip
    print_fit(wide)
    printed = capsys.readouterr().out
    assert printed.count("asymmetry") == 6 and "each time" not in printed and narrow(printed)
    assert printed.count("jackknife") == len(fit.sky.time)


def test_no_table_of_a_fit_breaks_a_word(capsys):
    """The longest names there are, with a sigma of each kind, at their bounds."""
    fit = fit_of_made_sky()
    longest = sorted(PARAMETERS, key=len)[-8:]
    shape = (len(fit.sky.time), len(longest))
    wide = {name: np.full(shape, 0.0012345) for name in ("values", "sigma", "model_sigma", "jackknife_sigma")}
    flags = {"at_bound": np.full(shape, True), "determined": np.full(shape, False)}
    covariance = np.full((*shape, len(longest)), 1e-6)
    print_fit(replace(fit, free=tuple(longest), shared=(), covariance=covariance, **wide, **flags))
    printed = capsys.readouterr().out
    assert {*longest, "0.0012345!?", "jackknife", "successful"} <= {*printed.split()} and narrow(printed)


def test_lobes_that_are_known_together_alone_are_shown_by_their_mean(capsys):
    """Two lobes over haze of one: none of the three numbers is determined, their mean cosine is to 0.001."""
    fit = fit_of_made_sky()
    free = ("asymmetry", "asymmetry_second", "forward_fraction", "aerosol_optical_depth")
    values = np.array([[0.69, 0.67, 0.5, 0.2]] * len(fit.sky.time))
    # the errors of the lobes and of their share cancel in the mean
    wide, direction = np.diag([1e-6, 1e-6, 0.0, 1e-4]), np.array([[1.0, -1.0, 0.0, 0.0], [0.02, 0.0, -0.5, 0.0]])
    covariance = np.stack([wide + 9.0 * direction.T @ direction] * len(values))
    sigma = np.sqrt(np.einsum("tpp->tp", covariance))
    determined = np.array([[False, False, False, True]] * len(values))
    lobed = replace(
        fit, free=free, shared=(), values=values, sigma=sigma, covariance=covariance, model_sigma=sigma,
        at_bound=np.zeros_like(determined), determined=determined, undetermined=((),) * len(values),
    )  # fmt: skip
    found = lobed.effective_asymmetry(0)
    assert found.names == free[:3] and found.value == pytest.approx(0.68)
    assert found.sigma == pytest.approx(np.sqrt(0.5) * 1e-3, rel=1e-6)
    assert "asymmetry_second" not in str(lobed)
    assert replace(lobed, determined=np.ones_like(determined)).effective_asymmetry(0) is None


def test_help_fits_a_narrow_window(skyfit_command, tmp_path):
    done = skyfit_command("--help", cwd=tmp_path, alone=True)
    assert all(
        command in done.stdout
        for command in ("simulate", "refit", "convert", "invert", "perez", "sensitivity", "predict")
    )
    assert narrow(done.stdout)


HELPS = """
import json, pathlib, sys
from skyfit.cli import main
loaded = {}
for command in ("", "simulate", "render", "export", "convert", "invert", "perez", "sensitivity", "refit", "predict"):
    sys.argv[1:] = [*command.split(), "--help"]
    try:
        main()
    except SystemExit as end:
        assert end.code == 0
    loaded[command] = sorted(sys.modules)
pathlib.Path("loaded.json").write_text(json.dumps(loaded))
"""


def test_help_loads_no_more_than_it_says(python, tmp_path):
    done = python(HELPS, cwd=tmp_path)
    assert done.returncode == 0 and done.stderr == "" and narrow(done.stdout)
    for command, modules in json.loads((tmp_path / "loaded.json").read_text()).items():
        roots = {name.split(".")[0] for name in modules}
        assert not roots & {"equinox", "jax", "jaxlib", "jaxtyping", "matplotlib", "numpy", "rich", "scipy"}, command
        own = {name for name in modules if name.split(".")[0] == "skyfit"}
        assert all(name == "skyfit" or name.startswith("skyfit.cli") for name in own) and len(own) < 16, command
    assert done.stdout.count("Example: skyfit ") == 9
    for words in ("OrdersOfScattering.normal", "polarised", "float64", *skyfit.transport.SOLVERS):
        assert words in done.stdout, words


def test_the_version_is_that_of_the_package(skyfit_command, tmp_path):
    assert skyfit_command("--version", cwd=tmp_path, alone=True).stdout.strip() == version("skyfit")


def test_a_kept_program_gives_the_same_sky(tmp_path, monkeypatch):
    solver = skyfit.SingleScattering.draft("flat")

    def sky(turbidity=2.0, count=5, kept=solver):
        scene = skyfit.Scene.from_degrees(40.0, skyfit.hemisphere(count), np.array([450.0, 550.0]))
        atmosphere = skyfit.Atmosphere.from_turbidity(turbidity)
        programs.keep_in(tmp_path / "new")
        found = kept_radiance(kept, atmosphere, scene)
        np.testing.assert_allclose(found, kept.radiance(atmosphere, scene), rtol=1e-5)
        return sorted((tmp_path / "new").iterdir())

    (first,) = sky()
    assert first.name.startswith("radiance-") and sky(3.0) == [first]
    # another shape and another solver are other programs
    assert len(sky(count=6)) == 2 and len(sky(kept=skyfit.SingleScattering.normal("flat"))) == 3
    monkeypatch.setattr(programs.export, "export", None)
    sky(4.0)
    monkeypatch.undo()
    whole = first.read_bytes()
    first.write_bytes(whole[: len(whole) // 2])
    sky()
    assert len(first.read_bytes()) == len(whole)
    # programs of other sources go, and a folder that cannot be written to does no harm
    monkeypatch.setattr(programs, "_sources", lambda: [tmp_path])
    (only,) = sky()
    assert only.name != first.name
    only.unlink()
    monkeypatch.setattr(programs, "atomic", lambda _: (tmp_path / "none" / "none").open())
    assert sky() == []


def test_kept_programs_give_the_same_fit(tmp_path, monkeypatch):
    plain = fit_of_made_sky.__wrapped__()
    programs.keep_in(tmp_path)
    made = fit_of_made_sky.__wrapped__()
    functions = sorted(path.name.split("-")[0] for path in tmp_path.glob("*.exported"))
    assert set(functions) == {"left_over", "reading", "retrieve"}
    # as in another process, which traces nothing
    programs.keep_in(tmp_path)
    monkeypatch.setattr(programs.export, "export", None)
    read = fit_of_made_sky.__wrapped__()
    for fit in (made, read):
        assert fit.result == plain.result and fit.undetermined == plain.undetermined
        np.testing.assert_allclose(fit.values, plain.values, rtol=1e-4)
        np.testing.assert_allclose(fit.sigma, plain.sigma, rtol=1e-3)
        np.testing.assert_allclose(fit.model, plain.model, rtol=1e-4)


def test_what_the_help_knows_is_what_the_floors_beneath_have():
    assert known.SOLVER_NAMES == tuple(skyfit.transport.SOLVERS)
    assert known.PARAMETER_NAMES == tuple(PARAMETERS)
    assert known.THRESHOLD == skyfit.NoiseModel().threshold
    assert known.SEA_LEVEL_PRESSURE == skyfit.atmosphere.SEA_LEVEL_PRESSURE


def files_to_fail_on(made, folder):
    """Good and broken files in a new folder."""
    folder.mkdir()
    (folder / "sky.nc").symlink_to(made / "sky.nc")
    (folder / "fit.json").symlink_to(made / "fit" / "fit.json")
    (folder / "broken.nc").write_bytes((made / "sky.nc").read_bytes()[:2000])
    (folder / "broken.csv").write_text("view_zenith,view_azimuth\n10,abc\n")
    (folder / "broken.json").write_text((made / "fit" / "fit.json").read_text()[:500])
    header = "view_zenith,view_azimuth,wavelength,radiance,sun_zenith,sun_azimuth,time\n"
    (folder / "night.csv").write_text(header + _rows(95))
    (folder / "timed.csv").write_text(header + _rows(50))
    return folder


@pytest.fixture
def folder(chain, tmp_path):
    return files_to_fail_on(chain[0], tmp_path / "work")


def _rows(sun_zenith):
    return "".join(
        f"{zenith},{azimuth},{wavelength},0.1,{sun_zenith},180,2025-06-01T12:00:00Z\n"
        for zenith in (10, 40)
        for azimuth in (0, 90)
        for wavelength in (450, 550, 650)
    )


SIMULATE = ("simulate", "--sun-zenith", "60", "--solver", "single", "--out", "new.nc")
ANALYTIC = ("simulate", "--sun-zenith", "60", "--out", "new.nc")
INVERT = ("invert", "sky.nc", "--solver", "single", "--geometry", "flat", "--preset", "draft", "--out", "new")
BROKEN = {
    "both hazes": ((*SIMULATE, "--turbidity", "3", "--aerosol-optical-depth", "0.2"), ["--turbidity", "exactly one"]),
    "no haze": (SIMULATE, ["--turbidity", "exactly one"]),
    "range and turbidity": (
        (*SIMULATE, "--turbidity", "3", "--meteorological-range", "40"),
        ["--meteorological-range", "exactly one"],
    ),
    "range beyond pure air": ((*SIMULATE, "--meteorological-range", "900"), ["--meteorological-range", "900"]),
    "published out of its range": (
        (*ANALYTIC, "--turbidity", "1.5", "--coefficients", "published"),
        ["`turbidity`", "1.7", "1.5"],
    ),
    "coefficients missing": ((*ANALYTIC, "--turbidity", "3", "--coefficients", "none.json"), ["none.json"]),
    "coefficients with ozone": (
        (*ANALYTIC, "--turbidity", "3", "--coefficients", "extended", "--ozone", "300"),
        ["--ozone", "--coefficients"],
    ),
    "coefficients with a solver": (
        (*SIMULATE, "--turbidity", "3", "--coefficients", "extended"),
        ["--solver", "--coefficients"],
    ),
    "asymmetry of a table": (
        ("refit", "--haze", "bullrich", "--asymmetry", "0.6", "--out", "new"),
        ["--asymmetry", "bullrich"],
    ),
    # refit's own haze is a table: an asymmetry must not be lost with it
    "asymmetry of refit": (("refit", "--asymmetry", "1", "--out", "new"), ["--asymmetry", "0.98", "got 1"]),
    "refit below the horizon": (("refit", "--flat-below", "95", "--out", "new"), ["--flat-below", "95"]),
    "refit to twilight over a flat Earth": (
        ("refit", "--form", "extended", "--geometry", "flat", "--out", "new"),
        ["`solver`", "92 degrees", "flat", "85"],
    ),
    "refit to twilight by shells": (
        ("refit", "--form", "extended", "--solver", "shells", "--out", "new"),
        ["`solver`", "92 degrees", "Shells", "90"],
    ),
    "refit by uniform air": (("refit", "--solver", "uniform", "--out", "new"), ["--geometry", "--solver uniform"]),
    "a sphere of uniform air": (
        ("simulate", "--sun-zenith", "50", "--turbidity", "3", "--solver", "uniform", "--out", "new.nc"),
        ["--geometry", "--solver uniform"],
    ),
    "low sun over a flat Earth": (
        ("simulate", "--sun-zenith", "86", "--turbidity", "3", "--geometry", "flat", "--out", "new.nc"),
        ["--sun-zenith", "85", "86"],
    ),
    "hectopascals": ((*SIMULATE, "--turbidity", "3", "--pressure", "1013.25"), ["--pressure", "2000", "1013.25"]),
    "refit with no haze": (("refit", "--haze-height", "0", "--out", "new"), ["--haze-height", "0"]),
    "turbidity too small": ((*SIMULATE, "--turbidity", "0.5"), ["--turbidity", "0.5"]),
    "turbidity nan": ((*SIMULATE, "--turbidity", "nan"), ["--turbidity", "nan"]),
    "sun below the horizon": (
        ("simulate", "--sun-zenith", "95", "--turbidity", "3", "--out", "new.nc"),
        ["--sun-zenith", "95"],
    ),
    "no sun": (("simulate", "--turbidity", "3", "--out", "new.nc"), ["--sun-zenith", "--time", "--at"]),
    "sun twice": ((*SIMULATE, "--turbidity", "3", "--time", "2020-07-04", "--at", "40,9"), ["--at", "--sun-zenith"]),
    "place without time": (("simulate", "--turbidity", "3", "--at", "40,9", "--out", "new.nc"), ["--at", "--time"]),
    "time that is none": ((*SIMULATE, "--turbidity", "3", "--time", "noon"), ["--time", "ISO", "'noon'"]),
    "place that is none": (
        ("simulate", "--turbidity", "3", "--time", "2020-07-04T17:00", "--at", "Bonn", "--out", "new.nc"),
        ["--at", "LAT,LON", "'Bonn'"],
    ),
    "place at night": (
        ("simulate", "--turbidity", "3", "--time", "2020-07-04T00:00", "--at", "51,7", "--out", "new.nc"),
        ["--time and --at", "sun zenith", "between 0 and 90"],
    ),
    "wavelengths that are none": (
        (*SIMULATE, "--turbidity", "3", "--wavelengths", "blue"),
        ["--wavelengths", "'blue'"],
    ),
    "wavelengths backwards": ((*SIMULATE, "--turbidity", "3", "--wavelengths", "700:400:10"), ["--wavelengths"]),
    "wavelengths without step": ((*SIMULATE, "--turbidity", "3", "--wavelengths", "400:700"), ["--wavelengths"]),
    "wavelengths step 0": ((*SIMULATE, "--turbidity", "3", "--wavelengths", "400:700:0"), ["--wavelengths"]),
    "wavelengths without end": ((*SIMULATE, "--turbidity", "3", "--wavelengths", "400:inf:10"), ["--wavelengths"]),
    "wavelengths without number": ((*SIMULATE, "--turbidity", "3", "--wavelengths", "400:700:1e-9"), ["--wavelengths"]),
    "wavelengths beyond the sun": ((*SIMULATE, "--turbidity", "3", "--wavelengths", "200,500"), ["wavelength", "200"]),
    "directions missing": ((*SIMULATE, "--turbidity", "3", "--directions", "none.csv"), ["none.csv"]),
    "directions broken": ((*SIMULATE, "--turbidity", "3", "--directions", "broken.csv"), ["broken.csv", "abc"]),
    "out of unknown kind": (
        ("simulate", "--sun-zenith", "60", "--turbidity", "3", "--solver", "single", "--out", "new.txt"),
        [".txt"],
    ),
    "out in no folder": (
        ("simulate", "--sun-zenith", "60", "--turbidity", "3", "--solver", "single", "--out", "no/new.nc"),
        ["no"],
    ),
    "unknown parameter": ((*INVERT, "--free", "haze"), ["`free`", "'haze'"]),
    "no parameter": ((*INVERT, "--free", ","), ["`free`"]),
    "turbidity and depth": ((*INVERT, "--free", "turbidity,aerosol_optical_depth"), ["both turbidity"]),
    "fixed and free": ((*INVERT, "--free", "ozone", "--fix", "ozone=300"), ["--fix", "--free", "ozone"]),
    "fix nonsense": ((*INVERT, "--free", "turbidity", "--fix", "nonsense"), ["--fix", "'nonsense'"]),
    "fix without value": ((*INVERT, "--free", "turbidity", "--fix", "ozone"), ["--fix", "'ozone'"]),
    "fix no number": ((*INVERT, "--free", "turbidity", "--fix", "ozone=much"), ["--fix", "much"]),
    "fix nan": ((*INVERT, "--free", "turbidity", "--fix", "ozone=nan"), ["--fix", "ozone", "nan"]),
    "fix out of range": ((*INVERT, "--free", "turbidity", "--fix", "asymmetry=2"), ["--fix", "asymmetry", "2"]),
    "fix what is not there": ((*INVERT, "--free", "turbidity", "--fix", "forward_fraction=0.8"), ["forward_fraction"]),
    "fix the haze that is free": (
        (*INVERT, "--free", "aerosol_optical_depth", "--fix", "turbidity=3"),
        ["--fix", "turbidity"],
    ),
    "fix the haze twice": (
        (*INVERT, "--free", "ozone", "--fix", "turbidity=3", "--fix", "aerosol_optical_depth=0.2"),
        ["--fix"],
    ),
    "fix one thing twice": (
        (*INVERT, "--free", "turbidity", "--fix", "ozone=300", "--fix", "ozone=310"),
        ["--fix", "ozone"],
    ),
    "prior without sigma": ((*INVERT, "--prior", "ozone=300"), ["--prior", "name=value,sigma", "ozone=300"]),
    "prior nonsense": ((*INVERT, "--prior", "haze=3,1"), ["--prior", "'haze'"]),
    "prior no number": ((*INVERT, "--prior", "ozone=much,1"), ["--prior", "ozone", "much"]),
    "prior of no width": ((*INVERT, "--prior", "ozone=300,0"), ["--prior", "ozone", "positive", "'0'"]),
    "prior twice": ((*INVERT, "--prior", "ozone=300,9", "--prior", "ozone=310,9"), ["--prior", "once", "ozone"]),
    "prior out of range": ((*INVERT, "--prior", "ozone=9,1"), ["--prior ozone", "50", "9"]),
    "prior of what is held": ((*INVERT, "--prior", "ozone=300,9"), ["`priors`", "'ozone'"]),
    "smooth nonsense": ((*INVERT, "--smooth", "ozone"), ["--smooth", "name=sigma"]),
    "smooth negative": ((*INVERT, "--smooth", "ozone=-1"), ["--smooth", "positive", "-1"]),
    "smooth and shared": (
        (*INVERT, "--free", "turbidity,ozone", "--shared", "ozone", "--smooth", "ozone=3"),
        ["`smooth`", "'ozone'"],
    ),
    "shared unknown": ((*INVERT, "--free", "turbidity", "--shared", "haze"), ["`shared`", "'haze'"]),
    "shared and independent": ((*INVERT, "--independent", "--shared", "ozone"), ["--shared", "--independent"]),
    "noise in per cent": ((*INVERT, "--relative", "2"), ["`relative`", "2"]),
    "no noise": ((*INVERT, "--relative", "0", "--floor", "0"), ["`relative`", "exact"]),
    "view of a fisheye": ((*INVERT, "--field-of-view", "180"), ["--field-of-view", "180"]),
    "threshold of nothing": ((*INVERT, "--threshold", "0"), ["`threshold`", "0"]),
    "no start": ((*INVERT, "--starts", "0"), ["--starts", "0"]),
    "response missing": ((*INVERT, "--response", "none.csv"), ["none.csv"]),
    "response broken": ((*INVERT, "--response", "broken.csv"), ["broken.csv", "row 2", "abc"]),
    "response of other channels": ((*INVERT, "--response", "xyz"), ["`response`", "14", "3"]),
    "sky missing": (("invert", "none.nc", "--out", "new"), ["none.nc"]),
    "sky broken": (("invert", "broken.nc", "--out", "new"), ["broken.nc"]),
    "table broken": (("invert", "broken.csv", "--out", "new"), ["broken.csv"]),
    "night": (("invert", "night.csv", "--free", "turbidity", "--solver", "single", "--out", "new"), ["sun", "horizon"]),
    "too many parameters": (
        (
            "invert",
            "timed.csv",
            "--free",
            ",".join([n for n in PARAMETERS if n not in ("turbidity", *SPHERES)]),
            "--solver",
            "single",
            "--out",
            "new",
        ),
        ["12 usable samples", "19 free"],
    ),
    "out is a file": ((*INVERT[:-1], "fit.json", "--free", "turbidity"), ["--out", "fit.json"]),
    "refit of a file and of options": (
        ("refit", "--atmosphere", "site.toml", "--ozone", "200", "--out", "new"),
        ["--ozone", "--atmosphere"],
    ),
    "refit of a file that is not there": (("refit", "--atmosphere", "no.toml", "--out", "new"), ["no.toml"]),
    "invert from a file that is not there": (
        ("invert", "sky.nc", "--atmosphere", "no.toml", "--out", "new"),
        ["no.toml"],
    ),
    "refit out is a file": (("refit", "--out", "fit.json"), ["--out", "fit.json"]),
    "refit of few directions": (("refit", "--directions", "3", "--out", "new"), ["--directions", "3"]),
    "fit missing": (("predict", "none.json", "--at", "sky.nc", "--out", "new.nc"), ["none.json"]),
    "fit broken": (("predict", "broken.json", "--at", "sky.nc", "--out", "new.nc"), ["broken.json"]),
    "fit is a sky": (("predict", "sky.nc", "--at", "sky.nc", "--out", "new.nc"), ["sky.nc"]),
    "place missing": (("predict", "fit.json", "--at", "none.nc", "--out", "new.nc"), ["none.nc"]),
    "prediction of unknown kind": (("predict", "fit.json", "--at", "sky.nc", "--out", "new.png"), [".png"]),
}


@pytest.fixture(scope="session")
def failures(chain, skyfit_command, tmp_path_factory):
    """What each broken call ended with, and what its folder held before and after."""
    place = tmp_path_factory.mktemp("broken")

    def files(case):
        return sorted(str(path.relative_to(place / case)) for path in (place / case).rglob("*"))

    before = {case: files_to_fail_on(chain[0], place / case) and files(case) for case in BROKEN}
    found = {}
    for case, (call, _) in BROKEN.items():
        done = skyfit_command(*call, cwd=place / case, check=False)
        found[case] = (done.returncode, done.stdout, done.stderr, before[case], files(case))
    return found


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_call_is_one_line_and_exit_code_2(failures, case):
    code, printed, error, before, after = failures[case]
    assert "Traceback" not in error, error
    assert code == 2, printed + error
    lines = [line for line in error.splitlines() if line.strip()]
    assert len(lines) == 1 and lines[0].startswith("skyfit: "), error
    assert all(part in lines[0] for part in BROKEN[case][1]), lines[0]
    # nothing written, nor left beside what was to be written
    assert after == before
    assert printed == ""


def test_a_broken_call_in_a_process_of_its_own(folder, skyfit_command):
    done = skyfit_command("invert", "broken.nc", "--out", "new", cwd=folder, check=False, alone=True)
    assert done.returncode == 2 and done.stdout == "" and not (folder / "new").exists()
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("skyfit: broken.nc")


def test_a_time_that_was_not_fitted_cannot_be_predicted(folder, skyfit_command):
    record = json.loads((folder / "fit.json").read_text())
    record["times"][0]["time"] = "2025-06-01T11:00:00Z"
    (folder / "timed.json").write_text(json.dumps(record))
    done = skyfit_command("predict", "timed.json", "--at", "timed.csv", "--out", "new.nc", cwd=folder, check=False)
    assert done.returncode == 2 and not (folder / "new.nc").exists()
    (line,) = [line for line in done.stderr.splitlines() if line.strip()]
    assert "2025-06-01T12:00:00" in line and "was not fitted" in line and "2025-06-01T11:00:00" in line


@pytest.mark.parametrize("arguments", [("nonsense",), ("simulate", "--turbidity", "3")])
def test_a_call_that_typer_refuses_ends_with_2_as_well(skyfit_command, tmp_path, arguments):
    done = skyfit_command(*arguments, cwd=tmp_path, check=False)
    assert done.returncode == 2 and done.stdout == "" and "Error" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_failed_prediction_keeps_the_file_that_was_there(folder, skyfit_command):
    (folder / "old.nc").write_bytes(b"kept")
    done = skyfit_command("predict", "fit.json", "--at", "broken.nc", "--out", "old.nc", cwd=folder, check=False)
    assert done.returncode == 2 and (folder / "old.nc").read_bytes() == b"kept"


ASD = ("measured", "kider2014", "2013-05-27___10.00.00")
STATION = ("--latitude", 42.443449, "--longitude", -76.481962)


def test_a_folder_of_instrument_files_needs_the_offset_of_its_clock(shared, skyfit_command, tmp_path):
    done = skyfit_command("invert", shared.joinpath(*ASD), *STATION, "--out", "new", cwd=tmp_path, check=False)
    assert done.returncode == 2 and list(tmp_path.iterdir()) == []
    (line,) = [line for line in done.stderr.splitlines() if line.strip()]
    assert "utc_offset" in line and ASD[-1] in line


def test_a_folder_of_instrument_files_is_inverted(shared, skyfit_command, tmp_path):
    done = skyfit_command(
        "invert", shared.joinpath(*ASD), *STATION, "--utc-offset", -4, 
        "--free", "turbidity,angstrom_exponent,asymmetry,asymmetry_second,forward_fraction,pointing_azimuth",
        "--solver", "single", "--geometry", "flat", "--preset", "draft", "--out", "asd", cwd=tmp_path,
    )  # fmt: skip
    (time,) = json.loads((tmp_path / "asd" / "fit.json").read_text())["times"]
    assert time["time"].startswith("2013-05-27T14:0") and time["result"] == "successful"
    # the sun at 10:00 EDT in Ithaca
    assert time["sun_zenith_deg"] == pytest.approx(43.5, abs=0.5)
    assert time["samples"] > 1000 and 0.0 < time["rmse"] < 0.1
    assert narrow(done.stdout)
    assert all(np.isfinite(entry["sigma"]) for entry in time["parameters"].values())


@pytest.mark.slow
def test_refit_writes_coefficients_and_a_picture(skyfit_command, tmp_path):
    done = skyfit_command(
        "refit", "--directions", 60, "--preset", "draft", "--geometry", "flat", "--asymmetry", 0.65, "--out", "r",
        cwd=tmp_path,
    )  # fmt: skip
    assert sorted(path.name for path in (tmp_path / "r").iterdir()) == ["coefficients.json", "errors.png", "skies.png"]
    assert narrow(done.stdout) and "published" in done.stdout and "refitted" in done.stdout
    record = json.loads((tmp_path / "r" / "coefficients.json").read_text())
    made = {"form": "linear", "haze": "henyey-greenstein", "asymmetry": 0.65, "pressure": 101325.0, "geometry": "flat"}
    assert made.items() <= record["simulated"].items()
    assert record["fitted"]["overall"]["refitted"]["luminance"] < 0.1
    # a row for each sky, and the two of all skies
    table = [line for line in done.stdout.splitlines() if line[:1] == " " and line.strip()[:1].isdigit()]
    assert len(table) == 60
    # what a user does with it
    skyfit_command(
        "simulate", "--coefficients", "r/coefficients.json", "--turbidity", 3, "--sun-zenith", 60, "--out", "s.nc",
        cwd=tmp_path,
    )  # fmt: skip
    model, sky = skyfit.read_coefficients(tmp_path / "r" / "coefficients.json"), skyfit.read(tmp_path / "s.nc")
    view = skyfit.Directions(sky.view_zenith[0], sky.view_azimuth[0])
    scene = skyfit.Scene.from_degrees(60.0, view, sky.wavelength_nm, 180.0)
    np.testing.assert_allclose(sky.radiance[0], model.radiance(3.0, scene), rtol=1e-3, atol=1e-7)


def test_simulate_by_coefficients_and_by_visibility(skyfit_command, tmp_path):
    common = ("--sun-zenith", 91, "--turbidity", 1.5, "--wavelengths", "450,550,650", "--out", "s.nc")
    skyfit_command("simulate", "--coefficients", "extended", *common, cwd=tmp_path)
    sky = skyfit.read(tmp_path / "s.nc")
    assert sky.radiance.shape == (1, 343, 3) and np.all(sky.radiance[0] > 0.0)
    seen = {}
    for name, value in (
        ("--turbidity", 2.0),
        ("--meteorological-range", float(skyfit.meteorological_range(2.0)) / 1e3),
    ):
        skyfit_command(
            "simulate", "--sun-zenith", 60, name, value, "--solver", "uniform", "--geometry", "flat",
            "--wavelengths", "450,550,650", "--out", "u.nc", cwd=tmp_path,
        )  # fmt: skip
        seen[name] = skyfit.read(tmp_path / "u.nc").radiance
    np.testing.assert_allclose(seen["--turbidity"], seen["--meteorological-range"], rtol=1e-4)


def test_a_visibility_is_that_of_haze_of_its_height():
    found = turbidity_of(None, None, float(skyfit.meteorological_range(2.0, 4000.0)) / 1e3, 4000.0)
    assert found == pytest.approx(2.0, rel=1e-5)


@pytest.mark.slow
def test_the_demo_recovers_the_sample(checkout, skyfit_command, tmp_path):
    free = "aerosol_optical_depth,angstrom_exponent,single_scattering_albedo,asymmetry,ground_albedo,ozone"
    sample = checkout / "data" / "skies" / "sample.nc"
    done = skyfit_command("invert", sample, "--free", free, "--out", "demo", cwd=tmp_path)
    (time,) = json.loads((tmp_path / "demo" / "fit.json").read_text())["times"]
    assert time["parameters"]["aerosol_optical_depth"]["value"] == pytest.approx(0.18, abs=0.01)
    assert time["parameters"]["angstrom_exponent"]["value"] == pytest.approx(1.35, abs=0.1)
    assert narrow(done.stdout)


def test_refit_varies_the_haze_of_a_file(skyfit_command, tmp_path):
    """All else in the file stays and is written along; a file without haze is refused."""
    from skyfit.cli.refit import _by_depth

    air = skyfit.Atmosphere(aerosol=skyfit.Aerosol(0.3), volcano=skyfit.Aerosol(0.02))
    by_depth = _by_depth(air, tmp_path)
    assert skyfit.atmosphere.describe(by_depth(0.3)) == skyfit.atmosphere.describe(air)
    assert by_depth(0.7).aerosol.optical_depth == pytest.approx(0.7) and by_depth(0.7).volcano is air.volcano
    clear = skyfit.atmosphere.describe(air.replace(aerosol=None))
    (tmp_path / "clear.json").write_text(json.dumps(clear))
    done = skyfit_command("refit", "--atmosphere", "clear.json", "--out", "new", cwd=tmp_path, check=False)
    assert done.returncode == 2 and "clear.json: must hold an `aerosol`" in done.stderr


def test_an_atmosphere_of_a_file_is_simulated_after_sunset_and_written_along(skyfit_command, tmp_path):
    (tmp_path / "site.toml").write_text(
        '[constituents.rayleigh]\nkind = "Rayleigh"\npressure = 9e4\n'
        '[constituents.volcano]\nkind = "Aerosol"\noptical_depth = 0.05\n'
        'phase = {kind = "HenyeyGreenstein", asymmetry = 0.6}\n[ground]\nalbedo = 0.3\n'
    )
    common = ("simulate", "--solver", "single", "--wavelengths", "450,600", "--atmosphere")
    skyfit_command(*common, "site.toml", "--sun-zenith", 95, "--out", "s.nc", cwd=tmp_path)
    sky = skyfit.read(tmp_path / "s.nc")
    made = sky.made_by["atmosphere"]
    assert made["constituents"]["volcano"]["optical_depth"] == pytest.approx(0.05)
    assert set(made["constituents"]) == {"rayleigh", "volcano"} and np.any(sky.radiance > 0.0)
    # what a file was made with makes it again
    (tmp_path / "again.json").write_text(json.dumps(made))
    skyfit_command(*common, "again.json", "--sun-zenith", 95, "--out", "again.nc", cwd=tmp_path)
    np.testing.assert_allclose(skyfit.read(tmp_path / "again.nc").radiance, sky.radiance, rtol=1e-6)


@pytest.mark.parametrize(
    ("text", "more", "words"),
    (
        ("x = [", (), "not TOML"),
        ('[constituents.haze]\nkind = "Smoke"\n', (), "found 'Smoke'"),
        ("[ground]\nalbedo = 0.3\n", ("--turbidity", 3), "`--turbidity` must be left out"),
        (None, (), "No such file"),
    ),
)
def test_a_file_that_is_no_atmosphere_is_one_line(skyfit_command, tmp_path, text, more, words):
    if text is not None:
        (tmp_path / "a.toml").write_text(text)
    call = ("simulate", "--atmosphere", "a.toml", "--sun-zenith", 60, "--out", "s.nc", *more)
    done = skyfit_command(*call, cwd=tmp_path, check=False)
    assert done.returncode == 2 and words in done.stderr and len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "s.nc").exists()
