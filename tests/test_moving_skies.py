"""Scans that move with the sun, directions of their own at each time; and a sun that moves between wavelengths."""

from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from made_skies import EXACT, FREE, HAZE, PLAIN

import skyfit
from skyfit.draw import plot
from skyfit.light import extraterrestrial_irradiance
from skyfit.records import load, save, write_prediction
from skyfit.retrieve import predict, SkyModel, start_model
from skyfit.retrieve.forward import observe, Problem


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
        (
            lambda v: v.expand_dims(other=2),
            "`view_zenith`: expected dimension direction or time, direction, wavelength, found",
        ),
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


@pytest.mark.parametrize("shared", [(), ("asymmetry",)])
def test_an_almucantar_that_follows_the_sun_recovers_its_truth(x64, shared):
    fit = skyfit.invert(almucantar(short=8), FREE, SOLVER, shared=shared, measurement=EXACT)
    assert fit.result == ("successful",) * 3 and not fit.rejected.any()
    assert np.all(np.abs(fit.values - TRUTH) < 3.5 * fit.sigma) and np.all(fit.sigma < 0.2 * TRUTH)
    assert np.all(fit.reduced_chi_square < 1.5)
    assert fit.model.shape == (3, 12, 15)
    assert np.isnan(fit.model[1, 8:]).all() and np.isfinite(fit.model[[0, 2]]).all()


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
    many = skyfit.fit_many(sky, FREE, SOLVER, measurement=EXACT)
    np.testing.assert_allclose(many.values, fit.values, rtol=1e-5)


# a sun for each wavelength

# of a filter wheel that takes half a minute for each of its filters, north of the sun's way at noon
LATER = np.arange(15) * np.radians(0.15)
WHEEL_ZENITH, WHEEL_AZIMUTH = SUN_ZENITH[:2, None] + LATER, np.radians([[359.0], [40.0]]) + LATER
VIEW = skyfit.hemisphere(30)
VIEWS = np.asarray(VIEW.zenith, float), np.asarray(VIEW.azimuth, float)


def under(zenith, azimuth):
    """By the solver alone, each wavelength under its own sun."""
    suns = enumerate(zip(zenith, azimuth, strict=True))
    return np.concatenate([light(*VIEWS, *sun, slice(i, i + 1)) for i, sun in suns], axis=1)


def wheel(noise=0.01, time=NO_DAY[:2], **about):
    clean = np.stack([under(*sun) for sun in zip(WHEEL_ZENITH, WHEEL_AZIMUTH, strict=True)])
    sigma = noise * clean
    radiance = clean + sigma * np.random.default_rng(4).standard_normal(clean.shape)
    settings = {"sun_zenith": WHEEL_ZENITH, "sun_azimuth": WHEEL_AZIMUTH % (2.0 * np.pi)} | about
    return skyfit.Sky(
        radiance=radiance, sigma=sigma, usable=np.ones(radiance.shape, bool), view_zenith=VIEWS[0],
        view_azimuth=VIEWS[1], wavelength_nm=PLAIN, time=time, pressure_pa=101325.0, fwhm_nm=6.0, source="made",
        **settings,
    )  # fmt: skip


def test_the_sun_has_an_axis_of_wavelength_only_where_it_moves():
    sky = wheel()
    assert sky.sun_zenith.shape == sky.sun_azimuth.shape == (2, 15)
    zenith, azimuth = sky.sun_at(0)
    assert zenith == pytest.approx(WHEEL_ZENITH[0].mean()) and azimuth % (2 * np.pi) == pytest.approx(
        WHEEL_AZIMUTH[0].mean() % (2.0 * np.pi)
    )
    still = replace(sky, sun_zenith=np.repeat(SUN_ZENITH[:2, None], 15, axis=1), sun_azimuth=SUN_AZIMUTH[:2])
    assert still.sun_zenith.shape == still.sun_azimuth.shape == (2,)
    assert still.sun_at(1) == (SUN_ZENITH[1], SUN_AZIMUTH[1])
    half = replace(sky, sun_azimuth=SUN_AZIMUTH[:2])
    np.testing.assert_array_equal(half.sun_azimuth, np.repeat(SUN_AZIMUTH[:2, None], 15, axis=1))
    np.testing.assert_array_equal(sky.at(1).sun_zenith, WHEEL_ZENITH[1:])
    # between the wavelengths, past north too
    between = sky.select(np.array([PLAIN[0], 0.5 * (PLAIN[6] + PLAIN[7])]))
    np.testing.assert_allclose(between.sun_zenith[0], SUN_ZENITH[0] + LATER[0] + np.array([0.0, 6.5 * LATER[1]]))
    np.testing.assert_allclose(np.degrees(between.sun_azimuth[0]) % 360.0, [359.0, (359.0 + 6.5 * 0.15) % 360.0])


@pytest.mark.parametrize(
    ("field", "shape"), [("sun_zenith", (2, 14)), ("sun_zenith", (3,)), ("sun_azimuth", (15, 2)), ("sun_azimuth", ())]
)
def test_suns_that_no_sky_has(field, shape):
    with pytest.raises(ValueError, match=f"`{field}` must have shape"):
        wheel(**{field: np.full(shape, 0.5)})


@pytest.mark.parametrize("name", ["sky.nc", "sky.csv"])
def test_a_sun_for_each_wavelength_reads_back(tmp_path, name):
    sky = wheel(time=TIME[:2], latitude_deg=40.0, longitude_deg=0.0)
    skyfit.write_sky(sky, tmp_path / name)
    back = skyfit.read(tmp_path / name)
    for field in ("view_zenith", "view_azimuth", "sun_zenith", "sun_azimuth"):
        np.testing.assert_allclose(getattr(back, field), getattr(sky, field), atol=2e-12, err_msg=field)
    np.testing.assert_array_equal(back.radiance, sky.radiance)
    # the stated sun is not that of the place
    assert "the stated sun is" in back.notes[0]


def test_rows_of_other_wavelengths_may_have_another_sun(tmp_path):
    def read(*rows):
        header = "time,view_zenith,view_azimuth,wavelength,radiance,sun_zenith,sun_azimuth\n"
        (tmp_path / "sky.csv").write_text(header + "".join(f"2024-06-21T{row}\n" for row in rows))
        return skyfit.read(tmp_path / "sky.csv")

    # wavelengths in any order; the second time has no row, and one without a sun, at one of them each
    sky = read(
        "12:00,10,0,600,1,41,359", "12:00,20,0,600,1,41,359", "12:00,10,0,500,1,40,2", "12:00,20,0,500,1,40,2",
        "12:00,10,0,700,1,,", "13:00,10,0,600,1,50,20", "13:00,10,0,700,1,50,20",
    )  # fmt: skip
    np.testing.assert_allclose(np.degrees(sky.sun_zenith), [[40.0, 41.0, 40.5], [50.0, 50.0, 50.0]])
    np.testing.assert_allclose(np.degrees(sky.sun_azimuth), [[2.0, 359.0, 0.5], [20.0, 20.0, 20.0]])
    alike = read("12:00,10,0,600,1,41,359", "12:00,10,0,500,1,,", "13:00,10,0,600,1,42,1")
    np.testing.assert_allclose(np.degrees(alike.sun_zenith), [41.0, 42.0])
    with pytest.raises(ValueError, match="row 3, column `sun_zenith`: expected one value per time and wavelength"):
        read("12:00,10,0,600,1,41,359", "12:00,20,0,600,1,42,359")
    with pytest.raises(ValueError, match=r"row 4, column `sun_zenith`: expected degrees in \[0, 180\], found 190"):
        read("12:00,10,0,600,1,41,359", "12:00,20,0,600,1,41,359", "12:00,20,0,500,1,190,359")
    with pytest.raises(ValueError, match="expected columns `sun_zenith` and `sun_azimuth`, or `latitude`"):
        read("12:00,10,0,600,1,41,359", "12:00,20,0,500,1,42,359", "13:00,20,0,500,1,,")


@pytest.mark.parametrize(
    ("key", "dims", "said"),
    [
        ("sun_zenith", ("time", "direction"), "`sun_zenith`: expected dimension time or time, wavelength"),
        ("sun_azimuth", ("other",), "`sun_azimuth`: expected dimension time or time, wavelength, found other"),
    ],
)
def test_suns_in_a_file_that_make_no_sense(tmp_path, key, dims, said):
    import xarray

    skyfit.write_sky(wheel(time=TIME[:2]), tmp_path / "sky.nc")
    with xarray.open_dataset(tmp_path / "sky.nc") as data:
        data = data.load()
    data[key] = dims, np.full([{"time": 2, "direction": 30, "other": 4}[axis] for axis in dims], 40.0)
    data.to_netcdf(tmp_path / "bad.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match=said) as caught:
        skyfit.read(tmp_path / "bad.nc")
    assert "\n" not in str(caught.value)


def test_the_sun_of_an_instrument_and_of_a_time_without_one(tmp_path):
    """`sun_azimuth_instrument` stands before `sun_azimuth`; what no wavelength of a time knows is computed."""
    import xarray

    skyfit.write_sky(wheel(time=TIME[:2], latitude_deg=40.0, longitude_deg=0.0), tmp_path / "sky.nc")
    with xarray.open_dataset(tmp_path / "sky.nc") as data:
        data = data.load()
    data["sun_azimuth_instrument"] = "time", np.array([10.0, np.nan])
    data["sun_zenith"] = data["sun_zenith"].where(data["time"] == TIME[0])
    data.to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    sky = skyfit.read(tmp_path / "other.nc")
    zenith, _ = skyfit.measured.solar_position(TIME[1:2], 40.0, 0.0)
    np.testing.assert_allclose(sky.sun_zenith[1], np.repeat(zenith, 15))
    np.testing.assert_allclose(np.degrees(sky.sun_azimuth[0]), 10.0)
    np.testing.assert_allclose(sky.sun_azimuth[1], WHEEL_AZIMUTH[1], atol=1e-11)
    assert sky.notes[:2] == ("sun azimuth from sun_azimuth_instrument, except times 1", sky.notes[1])
    assert "of 1 of 2 times computed" in sky.notes[1]


@pytest.mark.parametrize("name", [None, "xyz"])
def test_equal_suns_of_all_channels_are_one(x64, name):
    """The sky, the beam and the cone of view alike."""
    response = None if name is None else skyfit.Response.xyz()
    spectrum = PLAIN if response is None else response.wavelength_nm
    channels = 15 if response is None else 3
    nothing = np.zeros((1, 30, channels))
    common = {
        "view_zenith": VIEWS[0][None], "view_azimuth": VIEWS[1][None], "wavelength_nm": spectrum[None],
        "irradiance": np.ones((1, spectrum.size)), "measured": nothing, "weight": nothing,
        "response": None if response is None else response.weight[None],
        "beside": None if response is not None else nothing[:, 0], "has_beam": response is None, "field_of_view": 0.05,
    }  # fmt: skip
    common = {k: jax.numpy.asarray(v) if isinstance(v, np.ndarray) else v for k, v in common.items()}

    def read(zenith, azimuth):
        problem = Problem(jax.numpy.asarray([zenith]), jax.numpy.asarray([azimuth]), **common)
        return observe(SOLVER, SkyModel(air()), problem.at(0))

    one, each = read(0.9, 1.0), read(np.full(channels, 0.9), np.full(channels, 1.0))
    for plain, own in zip(one, each, strict=True):
        if plain is not None:
            np.testing.assert_allclose(own, plain, rtol=1e-10)
    moved = read(np.full(channels, 0.9) + 0.1 * (np.arange(channels) == 1), np.full(channels, 1.0))[0]
    changed = np.abs(moved / one[0] - 1.0).max(axis=0) > 1e-6
    assert changed.tolist() == (np.arange(channels) == 1).tolist()


def test_a_filter_wheel_recovers_its_truth(x64, tmp_path):
    sky = wheel()
    fit = skyfit.invert(sky, FREE, SOLVER, shared=("asymmetry",), measurement=EXACT)
    assert fit.result == ("successful",) * 2
    assert np.all(np.abs(fit.values - TRUTH) < 3.5 * fit.sigma) and np.all(fit.reduced_chi_square < 1.3)
    # as if it had stood still
    still = replace(sky, sun_zenith=WHEEL_ZENITH[:, 0], sun_azimuth=WHEEL_AZIMUTH[:, 0])
    wrong = skyfit.invert(still, FREE, SOLVER, shared=("asymmetry",), measurement=EXACT)
    assert np.all(wrong.reduced_chi_square > 1.5 * fit.reduced_chi_square)
    # angles are one number in what is told of a time
    for name in ("fit.json", "fit.nc"):
        save(fit, tmp_path / name)
    plot(fit, tmp_path / "fit.png")
    assert "sun zenith 41.1 deg" in str(fit)
    again = predict(load(tmp_path / "fit.json"), skyfit.read(tmp_path / "fit.nc"))
    np.testing.assert_allclose(again, fit.model, rtol=1e-6)
    one = skyfit.fit_many(sky, FREE, SOLVER, measurement=EXACT)
    assert np.all(np.abs(one.values - TRUTH) < 3.5 * one.sigma)


def test_a_sun_below_the_horizon_at_one_of_the_wavelengths_is_refused():
    sunset = replace(wheel(), sun_zenith=np.radians(89.5) + np.array([[0.0], [0.0]]) + LATER)
    with pytest.raises(ValueError, match="sun at or below the horizon at time 0"):
        skyfit.invert(sunset, FREE, SOLVER, measurement=EXACT)


def test_an_atmosphere_by_wavelength_cannot_be_seen_under_many_suns():
    by_band = eqx.tree_at(lambda m: m.atmosphere.ground.albedo, start_model(FREE, 101325.0), np.full(15, 0.1))
    with pytest.raises(ValueError, match="a sun for each wavelength needs an atmosphere"):
        skyfit.invert(wheel(), FREE, SOLVER, by_band, measurement=EXACT)
