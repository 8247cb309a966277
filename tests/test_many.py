"""Fits of many skies: each as if alone, failures flagged, nothing lost to a kill."""

import json
import logging
import os
import signal
import subprocess
import sys
from dataclasses import replace

import h5py
import jax
import numpy as np
import optimistix as optx
import pytest

import skyfit
from skyfit.light import extraterrestrial_irradiance
from skyfit.retrieve import simulate, start_model, with_values
from skyfit.retrieve.batch import _examined, ended, RESULTS
from skyfit.retrieve.prepared import flaws, prepared


SOLVER = skyfit.SingleScattering(8, "flat")
FREE = ("aerosol_optical_depth", "angstrom_exponent", "asymmetry")
WAVELENGTH = np.arange(400.0, 681.0, 40.0)
TIMES, CHUNK = 10, 4
# what is wrong with which time
WRONG = {1: "poor_fit", 2: "poor_fit", 4: "no_samples", 5: "too_few_samples", 6: "not_a_sky", 7: "sun_below_horizon"}
ALONE = ("values", "sigma", "covariance", "model_sigma", "reduced_chi_square", "scale", "degrees_of_freedom", "steps",
         "cost", "at_bound", "determined")  # fmt: skip
# the sky that a child process makes, its fit and its death after two chunks
CHILD = """
import os, signal, sys
import jax
from test_many import CHUNK, FREE, made, SOLVER
import skyfit
jax.config.update("jax_disable_most_optimizations", True)
def progress(done, of):
    print(len(jax.devices()), done, of, flush=True)
    if done >= 2 * CHUNK:
        os.kill(os.getpid(), signal.SIGKILL)
skyfit.fit_many(made(), FREE, solver=SOLVER, path=sys.argv[1], chunk=CHUNK, progress=progress)
"""


def made() -> skyfit.Sky:
    """Pixels: skies of different haze and sun, with noise, and no times."""
    random, view = np.random.default_rng(7), skyfit.hemisphere(20)
    irradiance = np.asarray(extraterrestrial_irradiance(WAVELENGTH, 6.0), float)
    model, sun = start_model(FREE, 101325.0), random.uniform(0.4, 1.2, TIMES)
    truth = np.stack([random.uniform(*ends, TIMES) for ends in ((0.05, 0.5), (0.5, 2.0), (0.5, 0.8))], axis=1)
    light = [
        simulate(SOLVER, with_values(model, FREE, row), skyfit.Scene(zenith, 1.0, view, WAVELENGTH, irradiance))
        for row, zenith in zip(truth, sun, strict=True)
    ]
    radiance = np.asarray(light, float)
    sigma = 0.01 * radiance
    return skyfit.Sky(
        radiance=radiance + sigma * random.standard_normal(radiance.shape), sigma=sigma,
        usable=np.ones(radiance.shape, bool), view_zenith=np.asarray(view.zenith, float),
        view_azimuth=np.asarray(view.azimuth, float), wavelength_nm=WAVELENGTH, sun_zenith=sun,
        sun_azimuth=np.ones(TIMES), time=np.full(TIMES, "NaT", "datetime64[ns]"), pressure_pa=101325.0, fwhm_nm=6.0,
    )  # fmt: skip


@pytest.fixture(scope="module")
def sky():
    return made()


@pytest.fixture(scope="module")
def fits(sky):
    return skyfit.fit_many(sky, FREE, solver=SOLVER, chunk=CHUNK)


def same(one, other, but=()):
    for name, value in vars(one).items():
        if name in but:
            continue
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(value, getattr(other, name), err_msg=name)
        else:
            assert value == getattr(other, name), name


# numbers


@pytest.mark.parametrize("t", (0, TIMES - 1))
def test_each_time_is_as_if_inverted_alone(sky, fits, t):
    alone = skyfit.invert(sky.at(t), FREE, SOLVER)
    for name in ALONE:
        # two programs in float32: their sums differ in the last digits, and covariances are inverses of them
        np.testing.assert_allclose(getattr(fits, name)[t], getattr(alone, name)[0], rtol=1e-4, err_msg=name)
    # as the instrument would read it, by another way
    assert fits.rmse[t] == pytest.approx(alone.rmse[0], rel=1e-4)
    assert fits.samples[t] == alone.used.sum() and fits.fixed == alone.fixed
    assert (fits.result == "successful").all() and "10 successful" in str(fits)


@pytest.mark.slow
def test_neither_chunks_nor_lock_step_nor_threads_change_a_fit_and_float64_reaches_them(sky, fits, x64):
    done = []
    other = skyfit.fit_many(sky, FREE, solver=SOLVER, chunk=6, batch_size=2, progress=lambda *told: done.append(told))
    # each ends within 0.02 sigma of the least cost
    assert np.max(np.abs(other.values - fits.values) / fits.sigma) < 0.02
    np.testing.assert_allclose(other.sigma, fits.sigma, rtol=1e-2)
    assert done[-1] == (TIMES, TIMES) and len(done) == 2
    # no float32 has these digits
    assert other.settings["dtype"] == "float64" and np.all(other.values != other.values.astype(np.float32))


def test_what_cannot_be_fitted_is_flagged_and_the_rest_is_as_before(sky, fits, tmp_path):
    radiance, sigma, usable, sun = sky.radiance.copy(), sky.sigma.copy(), sky.usable.copy(), sky.sun_zenith.copy()
    radiance[1] *= 0.03
    radiance[2] *= np.where(np.arange(20) % 2, 3.0, 0.3)[:, None]
    # float32 holds its inverse, but no square of it
    sigma[2] = 1.5e-38
    sigma[8] *= 0.2
    usable[4] = False
    usable[5] = False
    usable[5, 3, 3] = True
    radiance[6] *= 1e3
    sigma[6] *= 1e3
    sun[7] = 1.7
    spoilt = replace(sky, radiance=radiance, sigma=sigma, usable=usable, sun_zenith=sun)
    found = skyfit.fit_many(spoilt, FREE, solver=SOLVER, path=tmp_path / "f.nc", chunk=CHUNK)
    assert dict(enumerate(found.result)) == dict.fromkeys(range(TIMES), "successful") | WRONG
    # the stated sigma of time 8 is too small: its values are as they were, and a note says so
    assert "times their sigma" in found.notes[8][0] and found.values[8] == pytest.approx(fits.values[8], rel=1e-3)
    well = (found.result == "successful") & (np.arange(TIMES) != 8)
    without = [t for t, name in WRONG.items() if name != "poor_fit"]
    for name in (*ALONE, "rmse", "calibration"):
        np.testing.assert_array_equal(getattr(found, name)[well], getattr(fits, name)[well], err_msg=name)
        if getattr(found, name).dtype.kind == "f":
            assert np.isnan(getattr(found, name)[without]).all(), name
    assert not found.determined[without].any() and not found.at_bound[without].any()
    assert np.isfinite(found.values[1]).all()
    assert "1000 times" in found.notes[6][0] and found.notes[0] == ()
    same(skyfit.read_fits(tmp_path / "f.nc"), found)


def test_what_is_assumed_of_the_sky_is_said_as_by_invert(sky, fits, tmp_path):
    """No date in the file, its own notes and no pressure for all; a sun in a solver's last degrees for one time."""
    silent = replace(sky.at_times([0, 3]), pressure_pa=np.nan, notes=("a note of the file",))
    found = skyfit.fit_many(silent, FREE, solver=SOLVER, path=tmp_path / "f.nc", chunk=CHUNK)
    alone = skyfit.invert(silent, FREE, SOLVER)
    assert found.sky_notes == alone.notes and found.sky_notes[0] == "a note of the file"
    assert [any(word in note for note in found.sky_notes) for word in ("no date", "no pressure or altitude")] == [1, 1]
    assert "\nnote: a note of the file\nnote: no date" in str(found)
    same(skyfit.read_fits(tmp_path / "f.nc"), found)
    # the date is what these lack
    assert len(fits.sky_notes) == 1 and "no date" in fits.sky_notes[0]


def test_a_low_sun_is_said_of_its_time(sky):
    solver = skyfit.OrdersOfScattering.draft("flat")
    lowest = solver.suns.largest_deg - 1.0
    low = replace(sky.at_times([0, 3]), sun_zenith=np.radians([40.0, lowest]))
    asked = prepared(low, FREE, solver)
    ends, notes = _examined(asked, np.array([0, 1]), flaws(asked))
    assert ends == ["", ""] and "from the zenith" not in notes[0]
    assert notes[1].startswith(f"the sun is {lowest:g} degrees from the zenith: OrdersOfScattering in flat geom")


@pytest.mark.parametrize(
    ("result", "finite", "poor", "name"),
    (
        (optx.RESULTS.successful, True, False, "successful"),
        (optx.RESULTS.successful, True, True, "poor_fit"),
        (optx.RESULTS.nonlinear_max_steps_reached, True, True, "max_steps_reached"),
        (optx.RESULTS.nonlinear_divergence, True, False, "failed"),
        (optx.RESULTS.nonlinear_max_steps_reached, False, False, "failed"),
        (optx.RESULTS.successful, False, True, "failed"),
    ),
)
def test_how_a_search_ended_has_a_name(result, finite, poor, name):
    assert RESULTS[int(ended(result, finite, poor))] == name


def test_a_second_sky_of_the_same_shape_compiles_nothing(sky, fits, caplog):
    later = replace(sky, radiance=1.01 * sky.radiance, sun_zenith=sky.sun_zenith + 0.01).at(3)
    with caplog.at_level(logging.WARNING), jax.log_compiles():
        skyfit.fit_many(later, FREE, solver=SOLVER, chunk=CHUNK)
    chunks = [record.getMessage() for record in caplog.records if "_outcomes" in record.getMessage()]
    assert not [said for said in chunks if "compil" in said.lower()]


@pytest.mark.parametrize("setting", ("chunk", "batch_size", "starts"))
def test_counts_that_are_none_are_refused(sky, setting):
    with pytest.raises(ValueError, match=f"`{setting}` must be a whole number of 1 or more, got 0"):
        skyfit.fit_many(sky, FREE, solver=SOLVER, **{setting: 0})


# files


def test_a_file_reads_back_and_is_not_computed_again(sky, fits, tmp_path):
    path = tmp_path / "fits.nc"
    found = skyfit.fit_many(sky, FREE, solver=SOLVER, path=path, chunk=CHUNK)
    same(found, fits)
    same(skyfit.read_fits(path), fits)
    assert os.listdir(tmp_path) == ["fits.nc"]
    again = skyfit.fit_many(
        sky, FREE, solver=SOLVER, path=path, chunk=CHUNK, progress=lambda *_: pytest.fail("computed again")
    )
    same(again, fits)


def test_a_file_says_in_its_own_words_what_it_holds(sky, tmp_path):
    stamped = replace(sky, time=np.datetime64("2025-10-05T12:00:00.5") + np.arange(TIMES) * np.timedelta64(1, "s"))
    skyfit.fit_many(stamped, FREE, solver=SOLVER, path=tmp_path / "fits.nc", chunk=CHUNK)
    np.testing.assert_array_equal(skyfit.read_fits(tmp_path / "fits.nc").time, stamped.time)
    with h5py.File(tmp_path / "fits.nc") as file:
        assert [name.decode() for name in file["parameter"][:]] == list(FREE)
        assert [name.decode() for name in file["unit"][:]] == ["1", "1", "1"]
        assert file["values"].shape == (TIMES, 3) and file["covariance"].shape == (TIMES, 3, 3)
        assert file["rmse"].attrs["units"] == "W m-2 sr-1 nm-1" and file["wavelength"].attrs["units"] == "nm"
        assert file["result"].attrs["flag_meanings"].split() == list(RESULTS)
        assert "nodes=8" in file.attrs["solver"] and json.loads(file.attrs["fixed"])["ozone"] == 300.0


def test_a_file_of_another_sky_or_of_other_settings_is_refused(sky, tmp_path):
    path = tmp_path / "fits.nc"
    skyfit.fit_many(sky.at(0), FREE, solver=SOLVER, path=path, chunk=CHUNK)
    before = path.read_bytes()
    other = {"solver": skyfit.SingleScattering(9, "flat"), "draft": SOLVER}
    with pytest.raises(ValueError, match=r"fits.nc holds fits of other settings \(sky\): remove it"):
        skyfit.fit_many(sky.at(1), FREE, solver=SOLVER, path=path, chunk=CHUNK)
    with pytest.raises(ValueError, match=r"holds fits of other settings \(solver\): remove it"):
        skyfit.fit_many(sky.at(0), FREE, path=path, **other, chunk=CHUNK)
    assert path.read_bytes() == before and os.listdir(tmp_path) == ["fits.nc"]


@pytest.mark.parametrize(
    ("name", "content", "said"),
    (
        ("fits.csv", None, "fits.csv: expected a suffix of .nc"),
        ("none/fits.nc", None, "expected an existing folder to write to"),
        ("fits.nc", b"text", "fits.nc: expected NetCDF"),
        ("fits.nc", b"", "fits.nc: expected NetCDF, found an empty file"),
    ),
)
def test_a_path_that_cannot_be_written_is_refused_before_any_work(sky, tmp_path, name, content, said):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=said) as refusal:
        skyfit.fit_many(sky, FREE, solver=SOLVER, path=tmp_path / name, progress=lambda *_: pytest.fail("worked"))
    assert "\n" not in str(refusal.value)
    assert os.listdir(tmp_path) == ([] if content is None else [name])


def test_a_sky_file_is_no_file_of_fits(sky, tmp_path):
    skyfit.write_sky(sky, tmp_path / "sky.nc")
    with pytest.raises(ValueError, match=r"sky.nc: expected fits of `fit_many`, found no values"):
        skyfit.read_fits(tmp_path / "sky.nc")


# a process that is killed, on four devices


@pytest.fixture(scope="module")
def killed(tmp_path_factory, checkout):
    """A folder in which a child process has died after two chunks, and what it said."""
    folder = tmp_path_factory.mktemp("killed")
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=4"
    paths = os.pathsep.join((str(checkout), str(checkout / "tests")))
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(folder / "fits.nc")],
        env=os.environ | {"XLA_FLAGS": flags, "PYTHONPATH": paths}, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == -signal.SIGKILL, done.stderr
    return folder, done.stdout.splitlines()


def test_four_devices_share_a_chunk_and_end_as_one(killed, fits):
    folder, said = killed
    assert said == ["4 4 10", "4 8 10"]
    parts = sorted((folder / "fits.nc.parts").glob("*.npz"))
    assert len(parts) == 2 and not (folder / "fits.nc").exists()
    for part in parts:
        with np.load(part) as found:
            where = found["index"]
            for name in ("values", "sigma", "rmse", "cost"):
                np.testing.assert_allclose(found[name], getattr(fits, name)[where], rtol=1e-4, err_msg=name)
            assert list(found["result"]) == ["successful"] * CHUNK


def test_after_a_kill_nothing_is_lost_and_nothing_done_twice(killed, sky, fits):
    folder, _ = killed
    parts = folder / "fits.nc.parts"
    kept = sorted(parts.glob("*.npz"))
    # what a disc has spoilt is made again, and what a kill has left half written is no part
    kept[1].write_bytes(kept[1].read_bytes()[:-100])
    (parts / ".000000008-0123456789ab.npz").write_bytes(b"half")
    with np.load(kept[0]) as first:
        values = first["values"]
    with pytest.raises(ValueError, match=r"fits.nc.parts holds fits of other settings \(free\): remove it"):
        skyfit.fit_many(sky, FREE[:2], solver=SOLVER, path=folder / "fits.nc")
    done = []
    found = skyfit.fit_many(
        sky, FREE, solver=SOLVER, path=folder / "fits.nc", chunk=CHUNK, progress=lambda *told: done.append(told)
    )
    # the chunk of four and that of two end in any order
    assert done in ([(8, 10), (10, 10)], [(6, 10), (10, 10)])
    np.testing.assert_array_equal(found.values[:CHUNK], values)
    for name in ("values", "sigma"):
        np.testing.assert_allclose(getattr(found, name), getattr(fits, name), rtol=1e-4, err_msg=name)
    assert list(found.result) == list(fits.result) and os.listdir(folder) == ["fits.nc"]
    same(skyfit.read_fits(folder / "fits.nc"), found)
