"""Measured sky: what the readers read, what they mask, and that files round-trip."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray
from hypothesis import given, settings, strategies as st

from skyfit.measured import atomic, read, read_directions, read_response, Sky, solar_position, write_sky
from skyfit.measured.units import radiance_factor


MEASURED = Path(__file__).parents[2] / "shared" / "measured" / "kider2014"
needs_measured = pytest.mark.skipif(not MEASURED.is_dir(), reason="the measured skies of ../shared are not here")
# Ithaca, NY, where the scans were made.
PLACE = {"latitude": 42.443449, "longitude": -76.481962}


def make_sky(times=2, directions=5, wavelengths=7, seed=0, sigma=True) -> Sky:
    random = np.random.default_rng(seed)
    shape = (times, directions, wavelengths)
    radiance = random.uniform(0.01, 0.4, shape)
    usable = random.uniform(size=shape) > 0.2
    radiance[0, 0, 0], usable[0, 0, 0] = np.nan, False
    time = np.datetime64("2013-05-27T14:00", "ns") + np.arange(times) * np.timedelta64(30, "m")
    # where it stood: a reader says so if a file's sun is elsewhere
    sun_zenith, sun_azimuth = solar_position(time, 42.4, -76.5)
    return Sky(
        radiance=radiance,
        sigma=0.02 * np.nan_to_num(radiance, nan=1.0) if sigma else None,
        usable=usable,
        view_zenith=np.deg2rad(np.linspace(0.0, 85.0, directions)),
        view_azimuth=np.deg2rad(np.linspace(0.0, 300.0, directions)),
        wavelength_nm=np.linspace(380.0, 780.0, wavelengths),
        sun_zenith=sun_zenith,
        sun_azimuth=sun_azimuth,
        time=time,
        latitude_deg=42.4,
        longitude_deg=-76.5,
        altitude_m=325.0,
        pressure_pa=97500.0,
        fwhm_nm=6.0,
        notes=("made up", "for a test"),
        source="made",
    )


def make_dataset(**changes) -> xarray.Dataset:
    """A small file in the layout of the measured skies."""
    radiance = np.random.default_rng(1).uniform(0.01, 0.4, (2, 4, 6))
    data = xarray.Dataset(
        {
            "radiance": (("time", "direction", "wavelength"), radiance),
            "sun_zenith": ("time", [48.9, 43.5]),
            "sun_azimuth": ("time", [98.1, 104.2]),
        },
        {
            "view_zenith": ("direction", [0.0, 30.0, 60.0, 80.0]),
            "view_azimuth": ("direction", [0.0, 90.0, 180.0, 270.0]),
            "wavelength": ("wavelength", [400.0, 450.0, 500.0, 550.0, 600.0, 650.0]),
            "time": np.array(["2013-05-27T13:30", "2013-05-27T14:00"], "datetime64[ns]"),
        },
        {"elevation_m": 325.0, **PLACE},
    )
    data["radiance"].attrs["units"] = "W m-2 sr-1 nm-1"
    return data.assign(**changes)


def save(data: xarray.Dataset, path: Path) -> Path:
    data.to_netcdf(path, engine="h5netcdf")
    return path


def write_rows(path: Path, rows, header=None, comments=()) -> Path:
    header = header or ["view_zenith", "view_azimuth", "wavelength", "radiance"]
    with open(path, "w", encoding="utf-8", newline="") as stream:
        stream.writelines(f"# {comment}\n" for comment in comments)
        csv.writer(stream, lineterminator="\n").writerows([header, *rows])
    return path


SUN = ["view_zenith", "view_azimuth", "wavelength", "radiance", "sun_zenith", "sun_azimuth"]


def assert_same(read_back: Sky, sky: Sky) -> None:
    np.testing.assert_array_equal(read_back.radiance, sky.radiance)
    np.testing.assert_array_equal(read_back.usable, sky.usable)
    if sky.sigma is None:
        assert read_back.sigma is None
    else:
        np.testing.assert_array_equal(read_back.sigma, sky.sigma)
    for name in ("view_zenith", "view_azimuth", "sun_zenith", "sun_azimuth"):
        np.testing.assert_allclose(getattr(read_back, name), getattr(sky, name), atol=2e-12)
    np.testing.assert_array_equal(read_back.wavelength_nm, sky.wavelength_nm)
    np.testing.assert_array_equal(read_back.time, sky.time)
    for name in ("latitude_deg", "longitude_deg", "altitude_m", "pressure_pa", "fwhm_nm"):
        np.testing.assert_equal(getattr(read_back, name), getattr(sky, name))
    assert read_back.notes == sky.notes
    for name in ("direct_irradiance", "direct_sigma"):
        np.testing.assert_equal(getattr(read_back, name), getattr(sky, name))


def test_a_file_of_responses(tmp_path):
    """A flat channel of weight 1 integrates the spectrum, as `numpy.trapezoid` does."""
    wavelength = np.array([400.0, 410.0, 440.0, 500.0])
    blue = np.array([0.0, 1.0, 0.5, 0.0])
    rows = zip(wavelength, np.ones(4), blue, strict=True)
    response = read_response(write_rows(tmp_path / "camera.csv", rows, ["wavelength_nm", "flat", "blue"]))
    np.testing.assert_array_equal(response.wavelength_nm, wavelength)
    spectrum = np.array([0.1, 0.3, 0.2, 0.4])
    expected = [np.trapezoid(spectrum, wavelength), np.trapezoid(blue * spectrum, wavelength)]
    np.testing.assert_allclose(response.weight @ spectrum, expected, rtol=1e-12)
    for rows, header, told in (
        ([(400, 1), (410, 1)], ["nm", "a"], "expected the column `wavelength_nm`"),
        ([(400,), (410,)], ["wavelength_nm"], "one or more channels"),
        ([(400, 1)], ["wavelength_nm", "a"], "and 1 rows"),
        ([(400, 1), (410, "x")], ["wavelength_nm", "a"], "row 3, column `a`"),
        ([(410, 1), (400, 1)], ["wavelength_nm", "a"], "increase"),
        ([(0.4, 1), (0.5, 1)], ["wavelength_nm", "a"], "between 300 and 1100 nm"),
    ):
        with pytest.raises(ValueError, match=rf"^odd\.csv: .*{told}"):
            read_response(write_rows(tmp_path / "odd.csv", rows, header))


@pytest.mark.parametrize("suffix", [".nc", ".csv"])
@pytest.mark.parametrize("sigma", [True, False])
@pytest.mark.parametrize("times", [1, 3])
def test_a_sky_round_trips(tmp_path, suffix, sigma, times):
    sky = make_sky(times=times, sigma=sigma)
    path = tmp_path / f"sky{suffix}"
    write_sky(sky, path)
    back = read(path)
    assert_same(back, sky)
    assert back.source == path.name
    assert sum(back.masked.values()) == np.sum(~sky.usable)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    write_sky(back, path)
    again = read(path)
    assert_same(again, back)
    assert again.masked == back.masked


@pytest.mark.parametrize("suffix", [".nc", ".csv"])
@pytest.mark.parametrize("sigma", [True, False])
def test_the_suns_beam_round_trips(tmp_path, suffix, sigma):
    beam = np.random.default_rng(2).uniform(0.1, 1.5, (2, 7))
    beam[0, 3] = np.nan
    sky = replace(make_sky(), direct_irradiance=beam, direct_sigma=0.02 * beam if sigma else None)
    write_sky(sky, tmp_path / f"sky{suffix}")
    assert_same(read(tmp_path / f"sky{suffix}"), sky)


def test_the_suns_beam_is_converted_put_in_order_and_screened(tmp_path):
    beam = np.array([[100.0, 200.0, 300.0, -1.0, np.inf, 600.0], [np.nan, 20.0, 30.0, 40.0, 50.0, 60.0]])
    about = {"units": "mW m-2 nm-1"}
    data = make_dataset(
        direct_normal_irradiance=(("time", "wavelength"), beam, about),
        direct_normal_irradiance_sigma=("wavelength", np.full(6, 2.0)),
    )
    sky = read(save(data.isel(wavelength=slice(None, None, -1)), tmp_path / "sky.nc"))
    expected = np.where(np.isfinite(beam) & (beam >= 0.0), 1e-3 * beam, np.nan)
    np.testing.assert_allclose(sky.direct_irradiance, expected, rtol=1e-12)
    np.testing.assert_allclose(sky.direct_sigma, np.full((2, 6), 2e-3), rtol=1e-12)
    assert "direct normal irradiance converted from mW m-2 nm-1 to W m-2 nm-1" in sky.notes
    assert "2 direct irradiances that are negative or infinite left out" in sky.notes
    # one beam for all times
    once = make_dataset(direct_normal_irradiance=("wavelength", beam[1], about))
    np.testing.assert_allclose(read(save(once, tmp_path / "once.nc")).direct_irradiance, [1e-3 * beam[1]] * 2)
    assert read(tmp_path / "once.nc").direct_sigma is None


@pytest.mark.parametrize(
    ("axes", "value", "units", "told"),
    [
        (("time", "wavelength"), 0.5, None, "expected units W m-2 nm-1, found none"),
        (("time", "wavelength"), 0.5, "W m-2 sr-1 nm-1", "expected units W m-2 nm-1, found 'W m-2 sr-1 nm-1'"),
        (("time", "wavelength"), 0.5, "W m-2", "expected units W m-2 nm-1"),
        (("time", "wavelength"), 500.0, "W m-2 nm-1", "3 W m-2 nm-1 at most, found 500; is this mW"),
        (("time", "direction"), 0.5, "W m-2 nm-1", "expected dimensions among time, wavelength"),
    ],
)
def test_a_beam_that_is_none_is_refused(tmp_path, axes, value, units, told):
    data = make_dataset()
    shape = tuple(data.sizes[axis] for axis in axes)
    data["direct_normal_irradiance"] = (axes, np.full(shape, value), {} if units is None else {"units": units})
    with pytest.raises(ValueError, match=rf"^sky\.nc: variable `direct_normal_irradiance`: .*{told}"):
        read(save(data, tmp_path / "sky.nc"))


def test_a_beam_of_a_table_is_one_of_each_time_and_wavelength(tmp_path):
    header = [*SUN, "direct_normal_irradiance"]
    rows = [(10, 0, 500, 0.1, 40, 120, 0.9), (20, 0, 500, 0.1, 40, 120, 0.9), (20, 0, 400, 0.1, 40, 120, "")]
    sky = read(write_rows(tmp_path / "s.csv", rows, header))
    np.testing.assert_array_equal(sky.direct_irradiance, [[np.nan, 0.9]])
    rows[1] = (20, 0, 500, 0.1, 40, 120, 0.8)
    with pytest.raises(
        ValueError, match=r"row 3, column `direct_normal_irradiance`: expected one value per time and w"
    ):
        read(write_rows(tmp_path / "s.csv", rows, header))


@pytest.mark.parametrize("suffix", [".nc", ".csv"])
def test_a_sky_of_unknown_time_and_place_round_trips(tmp_path, suffix):
    nowhere = dict.fromkeys(("latitude_deg", "longitude_deg", "altitude_m", "pressure_pa", "fwhm_nm"), np.nan)
    sky = replace(make_sky(times=1), time=np.array(["NaT"], "datetime64[ns]"), **nowhere)
    write_sky(sky, tmp_path / f"sky{suffix}")
    assert_same(read(tmp_path / f"sky{suffix}"), sky)


def test_times_finer_than_a_second_round_trip(tmp_path):
    sky = make_sky()
    sky = replace(sky, time=sky.time + np.array([1, 250_000_001], "timedelta64[ns]"))
    for suffix in (".nc", ".csv"):
        write_sky(sky, tmp_path / f"sky{suffix}")
        np.testing.assert_array_equal(read(tmp_path / f"sky{suffix}").time, sky.time)


def test_at_and_select_and_counts():
    sky = make_sky(times=3)
    one = sky.at(-1)
    assert one.radiance.shape == (1, 5, 7)
    np.testing.assert_array_equal(one.radiance[0], sky.radiance[2])
    assert one.time[0] == sky.time[2]
    assert one.counts()["usable"] == np.sum(sky.usable[2])
    assert one.counts()["samples"] == 35 == one.counts()["usable"] + sum(one.masked.values())
    own = sky.wavelength_nm
    wanted = np.array([own[0], 0.25 * own[1] + 0.75 * own[2], own[6]])
    chosen = sky.select(wavelength_nm=wanted)
    np.testing.assert_allclose(chosen.radiance[..., 1], 0.25 * sky.radiance[..., 1] + 0.75 * sky.radiance[..., 2])
    np.testing.assert_array_equal(chosen.usable[..., 1], sky.usable[..., 1] & sky.usable[..., 2])
    # A wavelength that is hit needs no neighbour.
    for place, index in ((0, 0), (2, 6)):
        np.testing.assert_array_equal(chosen.radiance[..., place], sky.radiance[..., index])
        np.testing.assert_array_equal(chosen.usable[..., place], sky.usable[..., index])
    assert sum(chosen.masked.values()) == np.sum(~chosen.usable)
    for outside in (own[0] - 0.1, own[-1] + 0.1, np.nan):
        with pytest.raises(ValueError, match="`wavelength_nm`"):
            sky.select(wavelength_nm=np.array([outside]))
    with pytest.raises(ValueError, match="`index`"):
        sky.at(3)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("radiance", np.ones((5, 7))),
        ("radiance", np.ones((0, 5, 7))),
        ("sigma", np.ones((2, 5, 6))),
        ("sigma", np.zeros((2, 5, 7))),
        ("usable", np.ones((2, 5, 7))),
        ("usable", np.ones((2, 5, 7), dtype=bool)),
        ("view_zenith", np.linspace(0.0, 85.0, 5)),
        ("view_azimuth", np.linspace(0.0, 300.0, 5)),
        ("view_azimuth", np.zeros(4)),
        ("wavelength_nm", np.linspace(0.38, 0.78, 7)),
        ("wavelength_nm", np.linspace(780.0, 380.0, 7)),
        ("sun_zenith", np.array([0.1, np.nan])),
        ("sun_azimuth", np.array([0.1])),
        ("time", np.array(["2013-05-27"], "datetime64[ns]")),
    ],
)
def test_a_sky_that_disagrees_with_itself_says_so(field, value):
    with pytest.raises(ValueError, match=f"`{field}`"):
        replace(make_sky(), **{field: value})


def test_samples_that_must_not_be_used_are_masked_and_counted(tmp_path):
    data = make_dataset()
    radiance = data["radiance"].values
    radiance[0, 0, 0] = np.nan
    radiance[0, 0, 1] = np.inf
    radiance[0, 0, 2:4] = -0.1
    radiance[0, 1, 1:5] = 0.9
    radiance[1, 1, 1:4] = 0.9
    # NetCDF's default fill value, where a file does not declare it.
    radiance[1, 0, 0] = 9.969209968386869e36
    data["view_zenith"] = ("direction", [0.0, 30.0, 60.0, 95.0])
    data["suspect"] = ("direction", np.array([0, 0, 1, 0], dtype=np.int8))
    data["sigma"] = ("direction", [0.01, 0.0, 0.01, 0.01])
    sky = read(save(data, tmp_path / "sky.nc"))
    assert sky.masked == {
        "missing": 2,
        "infinite": 1,
        "negative": 2,
        "below horizon": 12,
        "saturated": 4,
        "suspect": 12,
        "sigma not positive": 8,
    }
    assert sky.counts() == {"samples": 48, "usable": 48 - 41, **sky.masked}
    assert np.all(np.isfinite(sky.radiance[sky.usable]))
    assert not np.any(np.isinf(sky.radiance)) and np.nanmax(sky.radiance) < 1.0


@pytest.mark.parametrize("where", ["variable", "file"])
def test_a_stated_saturation_is_believed(tmp_path, where):
    data = make_dataset()
    data["radiance"].values[0, 0, 0] = 0.5
    (data["radiance"] if where == "variable" else data).attrs["saturation"] = 0.5
    assert read(save(data, tmp_path / "sky.nc")).masked == {"saturated": 1}


@pytest.mark.parametrize(
    ("units", "factor"),
    [
        ("W m-2 sr-1 nm-1", 1.0),
        ("W/m2/sr/nm", 1.0),
        ("W/(m^2 sr nm)", 1.0),
        ("W m**-2 sr**-1 nm**-1", 1.0),
        ("W·m⁻²·sr⁻¹·nm⁻¹", 1.0),
        ("W.m-2.sr-1.nm-1", 1.0),
        ("watt meter-2 steradian-1 nanometer-1", 1.0),
        ("mW m-2 sr-1 nm-1", 1e-3),
        ("W m-2 sr-1 um-1", 1e-3),
        ("W m-2 sr-1 µm-1", 1e-3),
        ("uW cm-2 sr-1 nm-1", 1e-2),
    ],
)
def test_units_are_understood(tmp_path, units, factor):
    assert radiance_factor(units) == pytest.approx(factor, rel=1e-12)
    data = make_dataset()
    data["radiance"].attrs["units"] = units
    sky = read(save(data, tmp_path / "sky.nc"))
    np.testing.assert_allclose(sky.radiance, factor * data["radiance"].values, rtol=1e-12)
    assert any("converted" in note for note in sky.notes) == (factor != 1.0)


def test_axes_in_another_order_and_no_time(tmp_path):
    data = make_dataset()
    expected = read(save(data, tmp_path / "a.nc"))
    turned = data.transpose("wavelength", "time", "direction")
    turned = turned.isel(wavelength=slice(None, None, -1))
    assert_same(read(save(turned, tmp_path / "b.nc")), expected)
    single = read(save(data.isel(time=1), tmp_path / "c.nc"))
    assert_same(single, expected.at(1))
    without = data.isel(time=1).drop_vars("time")
    assert np.isnat(read(save(without, tmp_path / "d.nc")).time[0])


def test_netcdf_3_is_read(tmp_path):
    data = make_dataset()
    data.to_netcdf(tmp_path / "classic.nc", engine="scipy")
    assert_same(read(tmp_path / "classic.nc"), read(save(data, tmp_path / "new.nc")))


def test_radians_by_their_units_are_converted(tmp_path):
    data = make_dataset()
    expected = read(save(data, tmp_path / "a.nc"))
    for name in ("view_zenith", "view_azimuth", "sun_zenith", "sun_azimuth"):
        data[name] = (data[name] * (np.pi / 180.0)).assign_attrs(units="radian")
    assert_same(read(save(data, tmp_path / "b.nc")), expected)


def test_the_suns_azimuth_is_the_instruments_where_it_is_known(tmp_path):
    data = make_dataset(sun_azimuth_instrument=("time", [91.1, np.nan]))
    sky = read(save(data, tmp_path / "sky.nc"))
    np.testing.assert_allclose(np.rad2deg(sky.sun_azimuth), [91.1, 104.2])
    assert sky.notes == ("sun azimuth from sun_azimuth_instrument, except times 1",)


def test_the_sun_is_computed_where_the_file_does_not_say(tmp_path):
    data = make_dataset().drop_vars(["sun_zenith", "sun_azimuth"])
    sky = read(save(data, tmp_path / "sky.nc"))
    zenith, azimuth = solar_position(sky.time, altitude=325.0, **PLACE)
    np.testing.assert_allclose(sky.sun_zenith, zenith, rtol=1e-14)
    np.testing.assert_allclose(sky.sun_azimuth, azimuth, rtol=1e-14)
    assert "computed" in sky.notes[0]
    # An argument stands before the file; the sun moves west with it.
    assert np.all(read(tmp_path / "sky.nc", longitude=-80.0).sun_azimuth < sky.sun_azimuth)
    given = read(tmp_path / "sky.nc", altitude=10.0, fwhm_nm=3.0)
    assert (given.altitude_m, given.fwhm_nm) == (10.0, 3.0)


def test_directions_of_a_table_are_the_union_over_times(tmp_path):
    rows = [
        ("2013-05-27T16:00:00+02:00", 0, 0, 500, 0.1),
        ("2013-05-27T14:00:00Z", 30, 10, 500, 0.2),
        ("2013-05-27 13:00:00", 0, 0, 500, ""),
        ("2013-05-27T13:00:00Z", 60, 20, 400, 0.4),
    ]
    header = ["time", "view_zenith", "view_azimuth", "wavelength", "radiance"]
    comments = ["latitude: 42.4", "longitude: -76.5", "altitude_m: 325", "note: by hand", "free"]
    sky = read(write_rows(tmp_path / "sky.csv", rows, header, comments))
    assert sky.radiance.shape == (2, 3, 2)
    assert list(sky.time) == list(np.array(["2013-05-27T13:00", "2013-05-27T14:00"], "datetime64[ns]"))
    assert sky.counts() == {"samples": 12, "usable": 3, "missing": 9}
    assert sky.radiance[1, 0, 1] == 0.1 and sky.radiance[0, 2, 0] == 0.4
    assert (sky.latitude_deg, sky.altitude_m) == (42.4, 325.0)
    assert sky.notes[0] == "by hand" and "computed" in sky.notes[1]


def test_a_table_with_units_station_columns_and_more(tmp_path):
    header = [*SUN, "latitude", "longitude", "suspect", "sigma", "remark"]
    rows = [
        (10, 0, 500, 100, 40, 120, 42.4, -76.5, 0, 2, "clear"),
        (20, 0, 500, 200, 40, 120, 42.4, -76.5, 1, 2, "bird, here"),
    ]
    sky = read(write_rows(tmp_path / "s.csv", rows, header, ["units: mW m-2 sr-1 nm-1"]))
    np.testing.assert_allclose(sky.radiance[0, :, 0], [0.1, 0.2])
    assert sky.sigma is not None
    np.testing.assert_allclose(sky.sigma[0, :, 0], 0.002)
    assert sky.usable[0, :, 0].tolist() == [True, False]
    assert (sky.latitude_deg, sky.longitude_deg) == (42.4, -76.5)
    assert any("remark" in note for note in sky.notes)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    directions=st.lists(st.tuples(st.integers(0, 90), st.integers(0, 359)), min_size=1, max_size=4, unique=True),
    wavelengths=st.lists(st.integers(300, 1100), min_size=1, max_size=3, unique=True),
    values=st.lists(st.floats(1e-6, 10.0), min_size=12, max_size=12),
    order=st.randoms(use_true_random=False),
)
def test_any_order_of_rows_reads_alike(tmp_path_factory, directions, wavelengths, values, order):
    if len(directions) > 3 and 0 < max(zenith for zenith, _ in directions) <= 1:
        return
    grid = [(d, w) for d in directions for w in wavelengths]
    radiance = dict(zip(grid, values, strict=False))
    rows = [(*d, w, repr(radiance[d, w]), 30, 40) for d, w in grid]
    order.shuffle(rows)
    path = write_rows(tmp_path_factory.mktemp("csv") / "sky.csv", rows, SUN)
    sky = read(path)
    assert sky.radiance.shape == (1, len(directions), len(wavelengths))
    assert sky.wavelength_nm.tolist() == sorted(wavelengths)
    assert np.all(sky.usable)
    for place in range(len(directions)):
        angles = np.round(np.rad2deg([sky.view_zenith[0, place], sky.view_azimuth[0, place]]))
        for index, wavelength in enumerate(sorted(wavelengths)):
            direction = (int(angles[0]), int(angles[1]))
            assert sky.radiance[0, place, index] == radiance[direction, wavelength]


@settings(max_examples=60, deadline=None, derandomize=True)
@given(text=st.text(max_size=200), headed=st.booleans())
def test_any_text_is_read_or_refused_in_one_line(tmp_path_factory, text, headed):
    path = tmp_path_factory.mktemp("csv") / "sky.csv"
    start = "view_zenith,view_azimuth,wavelength,radiance\n" if headed else ""
    path.write_bytes((start + text).encode("utf-8", "surrogatepass"))
    with pytest.raises(ValueError, match="sky.csv") as caught:
        read(path)
    assert "\n" not in str(caught.value)


def test_a_file_of_directions(tmp_path):
    header = ["name", "view_azimuth", "view_zenith"]
    path = write_rows(tmp_path / "views.csv", [("a", 10, 0), ("b", 350, 89.5)], header)
    zenith, azimuth = read_directions(path)
    np.testing.assert_allclose(np.rad2deg(zenith), [0.0, 89.5])
    np.testing.assert_allclose(np.rad2deg(azimuth), [10.0, 350.0])


def test_writing_keeps_a_link_and_the_rights_of_new_files(tmp_path):
    sky = make_sky()
    (tmp_path / "link.csv").symlink_to(tmp_path / "sky.csv")
    (tmp_path / "sky.csv").write_text("old")
    write_sky(sky, tmp_path / "link.csv")
    assert (tmp_path / "link.csv").is_symlink()
    assert_same(read(tmp_path / "sky.csv"), sky)
    with atomic(str(tmp_path / "note.txt")) as part:
        part.write_text("whole")
    (tmp_path / "plain.txt").write_text("")
    assert (tmp_path / "note.txt").stat().st_mode == (tmp_path / "plain.txt").stat().st_mode


@needs_measured
@pytest.mark.parametrize("suffix", [".nc", ".csv"])
def test_a_measured_scan_round_trips(tmp_path, suffix):
    sky = read(MEASURED / "2013-05-27.nc").at(3)
    write_sky(sky, tmp_path / f"sky{suffix}")
    assert_same(read(tmp_path / f"sky{suffix}"), sky)
