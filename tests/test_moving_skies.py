"""Scans that move with the sun: directions of their own at each time."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from made_skies import EXACT, FREE, HAZE, PLAIN

import skyfit
from skyfit.draw import plot
from skyfit.light import extraterrestrial_irradiance
from skyfit.records import load, save, write_prediction
from skyfit.retrieve import predict


pytestmark = pytest.mark.usefixtures("haste")
SOLVER = skyfit.SingleScattering.draft("flat")
# radians from the sun's azimuth, at the sun's height
AWAY = np.radians([-150.0, -90.0, -45.0, -20.0, -10.0, -6.0, 6.0, 10.0, 20.0, 45.0, 90.0, 150.0])
SUN_ZENITH, SUN_AZIMUTH = np.radians([40.0, 50.0, 60.0]), np.radians([150.0, 200.0, 255.0])
TIME = np.datetime64("2024-06-21T12:00", "ns") + np.arange(3) * np.timedelta64(90, "m")
IRRADIANCE = np.asarray(extraterrestrial_irradiance(PLAIN, 6.0), float)
TRUTH = np.array(list(HAZE.values()))


def air(depth=0.2, exponent=1.1, asymmetry=0.65):
    haze = skyfit.Aerosol(depth, exponent, 0.95, 0.0, skyfit.HenyeyGreenstein(asymmetry))
    return skyfit.Atmosphere(skyfit.Rayleigh(101325.0), haze, skyfit.Ozone(300.0), skyfit.Ground(0.1))


def light(zenith, azimuth, sun_zenith, sun_azimuth, wavelength=slice(None)):
    """By the solver alone, at the mean distance of the sun, `[direction, wavelength]`."""
    scene = skyfit.Scene(
        sun_zenith, sun_azimuth, skyfit.Directions(zenith, azimuth), PLAIN[wavelength], IRRADIANCE[wavelength]
    )
    return np.asarray(SOLVER.radiance(air(), scene), float)


NO_DAY = np.array(["NaT"] * 3, "datetime64[ns]")


def almucantar(time=NO_DAY, short=None, noise=0.01):
    """Three times, no two alike in any direction; the second ends before direction `short`."""
    zenith = np.repeat(SUN_ZENITH[:, None], AWAY.size, axis=1)
    azimuth = (SUN_AZIMUTH[:, None] + AWAY) % (2.0 * np.pi)
    clean = np.stack([light(*angles) for angles in zip(zenith, azimuth, SUN_ZENITH, SUN_AZIMUTH, strict=True)])
    sigma = noise * clean
    radiance = clean + sigma * np.random.default_rng(3).standard_normal(clean.shape)
    usable = np.ones(radiance.shape, bool)
    if short is not None:
        zenith, azimuth = zenith.copy(), azimuth.copy()
        zenith[1, short:], azimuth[1, short:], radiance[1, short:], usable[1, short:] = np.nan, np.nan, np.nan, False
        sigma[1, short:] = np.nan
    return skyfit.Sky(
        radiance=radiance, sigma=sigma, usable=usable, view_zenith=zenith, view_azimuth=azimuth, wavelength_nm=PLAIN,
        sun_zenith=SUN_ZENITH, sun_azimuth=SUN_AZIMUTH, time=time, pressure_pa=101325.0, fwhm_nm=6.0,
        source="made",
    )  # fmt: skip


def test_one_pattern_is_held_for_each_time():
    pattern = replace(almucantar(), view_zenith=np.full(12, 0.5), view_azimuth=AWAY + np.pi)
    assert pattern.view_zenith.shape == pattern.view_azimuth.shape == (3, 12) and pattern.one_pattern
    np.testing.assert_array_equal(pattern.view_azimuth, np.tile(AWAY + np.pi, (3, 1)))
    moving = almucantar()
    assert not moving.one_pattern and moving.at(1).one_pattern
    np.testing.assert_array_equal(moving.at(1).view_azimuth[0], moving.view_azimuth[1])
    np.testing.assert_array_equal(moving.select(PLAIN[:2]).view_zenith, moving.view_zenith)


@pytest.mark.parametrize(
    ("field", "change", "said"),
    [
        ("view_zenith", lambda v: v[:2], r"`view_zenith` must have shape \(3, 12\) or \(12,\)"),
        ("view_azimuth", lambda v: v[:, :, None], r"`view_azimuth` must have shape \(3, 12\)"),
        ("view_zenith", lambda v: np.where(np.arange(12) == 2, np.nan, v), r"`view_zenith` must be in \[0, pi\] rad"),
        ("view_azimuth", lambda v: np.where(np.arange(12) == 2, np.nan, v), "`view_azimuth` must be finite"),
        ("view_zenith", lambda v: v + 0.7, "`usable` must be False where `view_zenith` is below the horizon"),
    ],
)
def test_directions_that_no_sky_has(field, change, said):
    sky = almucantar()
    with pytest.raises(ValueError, match=said):
        replace(sky, **{field: change(getattr(sky, field))})
    nowhere = np.where(np.arange(12) == 2, np.nan, sky.view_zenith)
    with pytest.raises(ValueError, match="`usable` must be False where `view_zenith` and `view_azimuth` are NaN"):
        replace(sky, view_zenith=nowhere, view_azimuth=nowhere)


@pytest.mark.parametrize("short", [None, 7])
@pytest.mark.parametrize("name", ["sky.nc", "sky.csv"])
def test_a_moving_scan_reads_back(tmp_path, name, short):
    sky = almucantar(TIME, short)
    skyfit.write_sky(sky, tmp_path / name)
    back = skyfit.read(tmp_path / name)
    for field in ("radiance", "usable", "sigma", "wavelength_nm", "time"):
        np.testing.assert_array_equal(getattr(back, field), getattr(sky, field), err_msg=field)
    for field in ("view_zenith", "view_azimuth", "sun_zenith", "sun_azimuth"):
        np.testing.assert_allclose(getattr(back, field), getattr(sky, field), atol=2e-12, err_msg=field)
    assert (
        back.counts() == {"samples": 540, "usable": 540}
        if short is None
        else {"missing": 75}.items() <= (back.masked.items())
    )


def test_the_layout_of_one_pattern_is_as_it_was(tmp_path):
    import xarray

    for sky, dims in ((almucantar(TIME), ("time", "direction")), (almucantar(TIME).at(0), ("direction",))):
        skyfit.write_sky(sky, tmp_path / "sky.nc")
        with xarray.open_dataset(tmp_path / "sky.nc") as data:
            assert data["view_zenith"].dims == data["view_azimuth"].dims == dims
            # as a program would write it that names its dimensions in another order
            turned = data.load().transpose("direction", ...)
        turned.to_netcdf(tmp_path / "turned.nc", engine="h5netcdf")
        np.testing.assert_allclose(skyfit.read(tmp_path / "turned.nc").view_azimuth, sky.view_azimuth, atol=1e-11)


def test_a_table_of_few_common_directions_has_each_times_own(tmp_path):
    def rows(hour, azimuths):
        return [f"2024-06-21T{hour}:00Z,40,{azimuth},500,0.{hour}{azimuth},40,{hour}0\n" for azimuth in azimuths]

    header = "time,view_zenith,view_azimuth,wavelength,radiance,sun_zenith,sun_azimuth\n"

    def read(*lines):
        (tmp_path / "sky.csv").write_text(header + "".join(line for part in lines for line in part))
        return skyfit.read(tmp_path / "sky.csv")

    # one of three is common, 4 of 6 places are filled: the union, in the order of the rows
    union = read(rows(12, (10, 20)), rows(13, (20, 30)))
    assert union.one_pattern and np.degrees(union.view_azimuth[0]).round().tolist() == [10, 20, 30]
    # of these each time has half: its own
    own = read(rows(13, (40, 50)), rows(12, (30, 10, 20)), rows(14, (10, 60)))
    assert not own.one_pattern and own.radiance.shape == (3, 3, 1)
    azimuth = np.degrees(own.view_azimuth).round()
    np.testing.assert_array_equal(azimuth, [[30, 10, 20], [40, 50, np.nan], [10, 60, np.nan]])
    np.testing.assert_array_equal(own.radiance[1, :, 0], [0.1340, 0.1350, np.nan])
    assert own.masked == {"missing": 2}
    with pytest.raises(ValueError, match=r"row 6, column `view_azimuth`: expected degrees in .*found 999"):
        read(rows(13, (40, 50)), rows(12, (30, 10)), rows(14, (999, 60)))
    with pytest.raises(ValueError, match="rows 5 and 6: expected each time, direction and wavelength once"):
        read(rows(13, (40, 50)), rows(12, (30, 10, 10)), rows(14, (80, 60)))


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    scans=st.lists(
        st.lists(st.tuples(st.integers(2, 89), st.integers(0, 359)), min_size=1, max_size=4, unique=True),
        min_size=1, max_size=4,
    ),
    order=st.randoms(use_true_random=False),
)  # fmt: skip
def test_every_sample_of_any_scans_is_read_in_its_place(tmp_path_factory, scans, order):
    samples = {(t, *direction): 0.01 * (1 + t) + 1e-5 * i for t, s in enumerate(scans) for i, direction in enumerate(s)}
    rows = [f"2024-06-21T{t:02d}:00Z,{z},{a},500,{value!r},30,40\n" for (t, z, a), value in samples.items()]
    order.shuffle(rows)
    path = tmp_path_factory.mktemp("csv") / "sky.csv"
    path.write_text("time,view_zenith,view_azimuth,wavelength,radiance,sun_zenith,sun_azimuth\n" + "".join(rows))
    sky = skyfit.read(path)
    assert sky.usable.sum() == len(rows) and sky.radiance.shape[1] <= len({d for s in scans for d in s})
    found = {}
    for t, d, _ in np.argwhere(sky.usable):
        angles = np.degrees([sky.view_zenith[t, d], sky.view_azimuth[t, d]]).round().astype(int)
        found[t, *angles.tolist()] = sky.radiance[t, d, 0]
    assert found == samples


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda v: v.expand_dims(other=2), "`view_zenith`: expected dimension direction or time, direction, found oth"),
        (lambda v: v.isel(direction=0, drop=True), "`view_zenith`: expected dimension direction"),
        (lambda v: v.where(v["time"] > v["time"][0]), "time 0, direction 0, column `view_zenith`"),
    ],
)
def test_views_in_a_file_that_make_no_sense(tmp_path, change, said):
    import xarray

    skyfit.write_sky(almucantar(TIME), tmp_path / "sky.nc")
    with xarray.open_dataset(tmp_path / "sky.nc") as data:
        data = data.load().reset_coords(["view_zenith"])
    data["view_zenith"] = change(data["view_zenith"])
    data.to_netcdf(tmp_path / "bad.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match=said) as caught:
        skyfit.read(tmp_path / "bad.nc")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("short", [None, 8])
@pytest.mark.parametrize("shared", [(), ("asymmetry",)])
def test_an_almucantar_that_follows_the_sun_recovers_its_truth(x64, shared, short):
    fit = skyfit.invert(almucantar(short=short), FREE, SOLVER, shared=shared, measurement=EXACT)
    assert fit.result == ("successful",) * 3 and not fit.rejected.any()
    assert np.all(np.abs(fit.values - TRUTH) < 3.5 * fit.sigma) and np.all(fit.sigma < 0.2 * TRUTH)
    assert np.all(fit.reduced_chi_square < 1.5)
    assert fit.model.shape == (3, 12, 15)
    if short is not None:
        assert np.isnan(fit.model[1, short:]).all() and np.isfinite(fit.model[[0, 2]]).all()


def test_what_is_made_of_a_fit_knows_each_times_directions(x64, tmp_path):
    sky = almucantar(TIME, short=8)
    bright = sky.radiance.copy()
    bright[2, 1] *= 3.0
    sky = replace(sky, radiance=bright)
    fit = skyfit.invert(sky, FREE, SOLVER, measurement=EXACT)
    assert np.argwhere(fit.rejected).tolist() == [[2, 1]]
    for name in ("fit.json", "fit.nc"):
        save(fit, tmp_path / name)
    text = (tmp_path / "fit.json").read_text()
    assert f'"view_azimuth_deg": {np.degrees(sky.view_azimuth[2, 1]):.6g}' in text
    back = skyfit.read(tmp_path / "fit.nc")
    np.testing.assert_allclose(back.view_azimuth, sky.view_azimuth, atol=1e-11)
    again = predict(load(tmp_path / "fit.json"), back)
    np.testing.assert_allclose(again, fit.model, rtol=1e-6)
    write_prediction(back, again, tmp_path / "again.csv")
    np.testing.assert_allclose(skyfit.read(tmp_path / "again.csv").radiance, again, rtol=1e-12)
    plot(fit, tmp_path / "fit.png")
    many = skyfit.fit_many(sky, FREE, None, SOLVER, measurement=EXACT)
    np.testing.assert_allclose(many.values, fit.values, rtol=1e-5)
