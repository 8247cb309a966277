"""Broken inputs: one line that names the file and the place, and nothing half-written."""

import csv
import os
import re

import h5netcdf
import numpy as np
import pytest
import xarray

from skyfit.measured import atomic, read, read_directions, Sky, write_sky


HEADER = "view_zenith,view_azimuth,wavelength,radiance,sun_zenith,sun_azimuth"
GOOD = "10,20,500,0.1,30,40"
PLACE = {"latitude": 42.4, "longitude": -76.5}


def refused(read_it, *parts: str) -> str:
    """The one line of the error, which must hold all `parts`."""
    with pytest.raises(ValueError) as caught:
        read_it()
    line = str(caught.value)
    assert "\n" not in line and len(line) < 500
    for part in parts:
        assert part in line, line
    return line


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["empty file"]),
        ("# only: a comment\n\n", ["empty file"]),
        (f"{HEADER}\n", ["expected rows of samples"]),
        (f"{HEADER}\n{GOOD}\n20,20,500,bright,30,40\n", ["row 3", "`radiance`", "'bright'"]),
        (f"# a\n\n{HEADER}\n{GOOD}\nN,20,500,1,30,40\n", ["row 5", "`view_zenith`", "'N'"]),
        (f"{HEADER}\n10,20,,0.1,30,40\n", ["row 2", "`wavelength`", "expected a number", "''"]),
        (f"{HEADER}\n10,20,5_00,0.1,30,40\n", ["row 2", "`wavelength`", "'5_00'"]),
        (f"{HEADER}\n10,20,inf,0.1,30,40\n", ["row 2", "`wavelength`", "'inf'"]),
        (f"{HEADER}\n10,20,-500,0.1,30,40\n{GOOD}", ["row 2", "`wavelength`", "-500"]),
        (f"{HEADER}\n{GOOD}\n10,20,501\n", ["row 3", "expected 6 columns", "found 3"]),
        (f"{HEADER}\n{GOOD}\n\n{GOOD},7\n", ["row 4", "expected 6 columns", "found 7"]),
        (f'{HEADER}\n{GOOD}\n10,"20,501,0.1,30,40\n{GOOD}', ["row 3", "expected CSV"]),
        (f"{HEADER}\n{GOOD}\n20,20,500,0.1,30,40\n{GOOD}\n", ["rows 2 and 4", "twice"]),
        (f"{HEADER},radiance\n{GOOD},1\n", ["row 1", "`radiance` twice"]),
        ("zenith,azimuth,wl,L\n1,2,3,4\n", ["`view_zenith`, `view_azimuth`", "found zenith"]),
        (HEADER.replace(",", ";") + "\n" + GOOD.replace(",", ";"), ["expected column"]),
        (f"{HEADER}\n{GOOD}\n20,20,500,0.1,31,40\n", ["row 3", "`sun_zenith`", "row 2"]),
        (f"{HEADER}\n10,20,0.5,0.1,30,40\n", ["`wavelength`", "expected nm", "um?"]),
        (f"{HEADER}\n-1,20,500,0.1,30,40\n", ["row 2", "`view_zenith`", "[0, 180]"]),
        (f"{HEADER}\n{GOOD}\n10,999,500,0.1,30,40\n", ["row 3", "`view_azimuth`", "999"]),
        (f"{HEADER}\n10,20,500,0.1,200,40\n", ["row 2", "`sun_zenith`", "200"]),
        (f"# units: W m-2\n{HEADER}\n{GOOD}\n", ["row 1", "expected units", "'W m-2'"]),
        (f"# latitude: north\n{HEADER}\n{GOOD}\n", ["row 1", "`latitude`", "'north'"]),
        (f"# latitude: 420\n{HEADER}\n{GOOD}\n", ["`latitude`", "-90 to 90", "420"]),
        (f"# pressure_pa: 1013\n{HEADER}\n{GOOD}\n", ["`pressure_pa`", "Pa", "1013"]),
        (
            f"{HEADER}\n" + "".join(f"{z},0,500,0.1,30,40\n" for z in (0.1, 0.5, 1.0, 1.5)),
            ["`view_zenith`", "expected degrees", "radians?"],
        ),
        (
            "view_zenith,view_azimuth,wavelength,radiance\n10,20,500,0.1\n",
            ["`sun_zenith`", "found no latitude, longitude, time"],
        ),
        (f"time,{HEADER}\nyesterday,{GOOD}\n", ["row 2", "`time`", "ISO", "'yesterday'"]),
        (f"time,{HEADER}\n,{GOOD}\n", ["row 2", "`time`", "''"]),
        (f"time,{HEADER}\n9999-01-01,{GOOD}\n", ["row 2", "`time`", "9999"]),
        (
            f"latitude,{HEADER}\n42,{GOOD}\n43,20,20,500,0.1,30,40\n",
            ["row 3", "`latitude`", "one value per file"],
        ),
    ],
)
def test_a_broken_table(tmp_path, text, parts):
    path = tmp_path / "sky.csv"
    path.write_text(text, encoding="utf-8")
    refused(lambda: read(path), "sky.csv", *parts)


def test_a_table_that_is_not_text(tmp_path):
    (tmp_path / "sky.csv").write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe")
    refused(lambda: read(tmp_path / "sky.csv"), "sky.csv", "UTF-8")
    (tmp_path / "long.csv").write_text("x" * 200_000)
    refused(lambda: read(tmp_path / "long.csv"), "long.csv", "row 1")


def test_a_table_whose_samples_share_no_grid(tmp_path):
    rows = "".join(f"{z / 20},{z / 10},{400 + z / 7},0.1,30,40\n" for z in range(1, 6000))
    header = "time," + HEADER
    days = [f"2013-05-{1 + i % 31:02},{row}" for i, row in enumerate(rows.splitlines(True))]
    (tmp_path / "sky.csv").write_text(f"{header}\n{''.join(days)}")
    refused(lambda: read(tmp_path / "sky.csv"), "sky.csv", "`wavelength`", "shared grid")


def make_dataset() -> xarray.Dataset:
    data = xarray.Dataset(
        {
            "radiance": (
                ("time", "direction", "wavelength"),
                np.linspace(0.1, 0.2, 40).reshape(1, 5, 8),
                {"units": "W m-2 sr-1 nm-1"},
            ),
            "sun_zenith": ("time", [40.0]),
            "sun_azimuth": ("time", [120.0]),
        },
        {
            "view_zenith": ("direction", [0.0, 20.0, 40.0, 60.0, 80.0]),
            "view_azimuth": ("direction", [0.0, 90.0, 180.0, 270.0, 300.0]),
            "wavelength": ("wavelength", np.linspace(400.0, 680.0, 8)),
            "time": np.array(["2013-05-27T14:00"], "datetime64[ns]"),
        },
    )
    return data


def with_attrs(name, **attrs):
    def change(data):
        target = data[name] if name else data
        target.attrs.clear()
        target.attrs.update(attrs)
        return data

    return change


def with_variable(**variables):
    return lambda data: data.assign(**variables)


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (lambda data: data.drop_vars("radiance"), ["variable `radiance`"]),
        (lambda data: data.drop_vars("view_zenith"), ["variable `view_zenith`"]),
        (lambda data: data.drop_vars("wavelength"), ["variable `wavelength`"]),
        (lambda data: data.rename(direction="view"), ["`radiance`", "time, view, wavelength"]),
        (lambda data: data.isel(wavelength=0), ["`radiance`", "expected dimensions"]),
        (lambda data: data.isel(direction=slice(0)), ["`radiance`", "(1, 0, 8)"]),
        (with_attrs("radiance"), ["`radiance`", "expected units W m-2 sr-1 nm-1", "none"]),
        (with_attrs("radiance", units="W m-2 nm-1"), ["`radiance`", "'W m-2 nm-1'"]),
        (with_attrs("radiance", units="counts"), ["`radiance`", "'counts'"]),
        (with_attrs("view_zenith", units="gon"), ["`view_zenith`", "degree", "'gon'"]),
        (with_attrs("wavelength", units="um"), ["`wavelength`", "expected nm", "'um'"]),
        (with_attrs("", latitude="north"), ["attribute `latitude`", "'north'"]),
        (with_attrs("", saturation="high"), ["attribute `saturation`", "'high'"]),
        (with_attrs("", fwhm_nm=-1.0), ["`fwhm_nm`", "found -1"]),
        (lambda data: data.drop_vars("sun_zenith"), ["`sun_zenith`", "no latitude, longitude"]),
        (with_variable(sun_zenith=("time", [np.inf])), ["time 0", "`sun_zenith`"]),
        (with_variable(sun_zenith=("direction", np.ones(5))), ["`sun_zenith`", "dimension time"]),
        (with_variable(view_zenith=("direction", np.full(5, 200.0))), ["direction 0", "200"]),
        (
            with_variable(view_zenith=("direction", np.linspace(0.0, 1.5, 5))),
            ["`view_zenith`", "radians?"],
        ),
        (
            with_variable(view_azimuth=("direction", [np.nan, 0.0, np.nan, 0.0, 0.0])),
            ["direction 2", "`view_azimuth`", "nan"],
        ),
        (
            with_variable(
                radiance=(("time", "direction", "wavelength"), np.full((1, 5, 8), "x"), {"units": "W m-2 sr-1 nm-1"})
            ),
            ["`radiance`", "expected numbers"],
        ),
        (with_variable(suspect=("band", [0, 1])), ["`suspect`", "found band"]),
        (with_variable(time=("time", [5.0])), ["`time`", "seconds since"]),
        (with_variable(latitude=("direction", np.arange(5.0))), ["`latitude`", "one number"]),
        (with_variable(wavelength=("wavelength", np.arange(8) // 2 + 400.0)), ["different"]),
        (with_variable(wavelength=("wavelength", np.linspace(0.4, 0.7, 8))), ["um?"]),
        (
            with_variable(wavelength=("wavelength", [400.0, np.nan, *range(410, 416)])),
            ["wavelength 1", "`wavelength`", "nan"],
        ),
    ],
)
def test_a_broken_netcdf(tmp_path, change, parts):
    path = tmp_path / "sky.nc"
    change(make_dataset()).to_netcdf(path, engine="h5netcdf")
    refused(lambda: read(path), "sky.nc", *parts)


@pytest.mark.parametrize("engine", ["h5netcdf", "scipy"])
@pytest.mark.parametrize("kept", [0.0, 0.05, 0.3, 0.6])
def test_a_truncated_netcdf(tmp_path, engine, kept):
    path = tmp_path / "sky.nc"
    make_dataset().to_netcdf(path, engine=engine)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(kept * len(whole))])
    refused(lambda: read(path), "sky.nc", "expected NetCDF")


def test_a_file_that_is_no_netcdf(tmp_path):
    (tmp_path / "sky.nc").write_text("time,radiance\n")
    refused(lambda: read(tmp_path / "sky.nc"), "sky.nc", "expected NetCDF", "b'time'")


def test_a_path_that_is_not_there_or_of_another_kind(tmp_path):
    refused(lambda: read(tmp_path / "none.nc"), "none.nc", "found none")
    (tmp_path / "sky.txt").write_text("1")
    refused(lambda: read(tmp_path / "sky.txt"), "sky.txt", "'.txt'", "a tidy CSV")
    (tmp_path / "sky.csv").write_text(f"{HEADER}\n{GOOD}\n")
    refused(lambda: read(tmp_path / "sky.csv", utc_offset=-4), "sky.csv", "`utc_offset`", "UTC")
    refused(lambda: read(tmp_path / "sky.csv", latitude=100), "sky.csv", "`latitude`", "100")


NAME = "2013-05-27___10.00.00_-_{}____{}___12.5.asd.rad"
OFFSET = {**PLACE, "utc_offset": -4}


def write_scan(folder, second="Wavelength\tx\r\n400\t0.1 \r\n401\t0.2 \r\n"):
    for index, text in enumerate(["Wavelength\tx\r\n400\t0.1 \r\n401\t0.2 \r\n", second]):
        (folder / f"{NAME.format(index, 90.0 * index)}.txt").write_bytes(text.encode())
    return folder


@pytest.mark.parametrize(
    ("second", "parts"),
    [
        ("", ["empty file"]),
        ("Wavelength\tx\r\n", ["expected rows"]),
        ("400\t0.1\r\n401\t0.2\r\n", ["row 1", "Wavelength"]),
        ("Wavelength\tx\r\n400\t0.1\r\n401\t\r\n", ["row 3", "'401"]),
        ("Wavelength\tx\r\n400\t0.1\r\n401\tdark\r\n", ["row 3", "`radiance`", "'dark'"]),
        ("Wavelength\tx\r\n4OO\t0.1\r\n401\t0.2\r\n", ["row 2", "`Wavelength`", "'4OO'"]),
        ("Wavelength\tx\r\n400\t0.1\r\n", ["`Wavelength`", "(1 rows)"]),
    ],
)
def test_a_broken_asd_file(tmp_path, second, parts):
    write_scan(tmp_path, second)
    refused(lambda: read(tmp_path, **OFFSET), NAME.format(1, 90.0), *parts)


def test_a_broken_asd_folder(tmp_path):
    refused(lambda: read(tmp_path, **OFFSET), tmp_path.name, "<azimuth>", "found none")
    write_scan(tmp_path)
    for key in OFFSET:
        less = {name: value for name, value in OFFSET.items() if name != key}
        refused(lambda less=less: read(tmp_path, **less), tmp_path.name, f"found no `{key}`")
    refused(lambda: read(tmp_path, **{**OFFSET, "utc_offset": -240}), "`utc_offset`", "-240")
    (tmp_path / f"{NAME.format(2, 90.0)}.txt").write_text("Wavelength\tx\n400\t1\n401\t1\n")
    refused(lambda: read(tmp_path, **OFFSET), NAME.format(2, 90.0), NAME.format(1, 90.0), "once")
    (tmp_path / "2013-13-27___10.00.00_-_3____0.0___9.0.asd.rad.txt").write_text("")
    refused(lambda: read(tmp_path, **OFFSET), "2013-13-27", "expected a file name")


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["empty file"]),
        ("view_zenith\n10\n", ["column `view_azimuth`"]),
        ("view_zenith,view_azimuth\n", ["expected rows"]),
        ("view_zenith,view_azimuth\n10,x\n", ["row 2", "`view_azimuth`", "'x'"]),
        ("view_zenith,view_azimuth\n10,20\n91,20\n", ["row 3", "`view_zenith`", "91"]),
        ("view_zenith,view_azimuth\n0,0\n.5,0\n1,0\n1.5,0\n", ["radians?"]),
    ],
)
def test_broken_directions(tmp_path, text, parts):
    path = tmp_path / "views.csv"
    path.write_text(text)
    refused(lambda: read_directions(path), "views.csv", *parts)


def make_sky(times=1) -> Sky:
    return Sky(
        radiance=np.full((times, 2, 3), 0.1),
        sigma=None,
        usable=np.ones((times, 2, 3), dtype=bool),
        view_zenith=np.array([0.1, 0.2]),
        view_azimuth=np.array([0.0, 0.0]),
        wavelength_nm=np.array([400.0, 500.0, 600.0]),
        sun_zenith=np.full(times, 0.5),
        sun_azimuth=np.full(times, 0.5),
        time=np.full(times, np.datetime64("NaT"), "datetime64[ns]"),
    )


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "sky.csv"
    path.write_text("old")

    class Broken:
        rows = 0

        def __init__(self, stream, **_):
            self.stream = stream

        def writerow(self, row):
            self.stream.write("half")
            self.stream.flush()
            Broken.rows += 1
            if Broken.rows == 3:
                raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(csv, "writer", Broken)
        refused(lambda: write_sky(make_sky(), path), "sky.csv", "No space left on device")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["sky.csv"]

    def fail(*_, **__):
        raise RuntimeError("interrupted")

    with monkeypatch.context() as patch:
        patch.setattr(h5netcdf, "File", fail)
        with pytest.raises(RuntimeError, match="interrupted"):
            write_sky(make_sky(), tmp_path / "sky.nc")
    with pytest.raises(KeyboardInterrupt), atomic(tmp_path / "new.txt") as part:
        part.write_text("half")
        raise KeyboardInterrupt
    assert os.listdir(tmp_path) == ["sky.csv"]


def test_what_cannot_be_written_is_refused(tmp_path):
    sky = make_sky()
    refused(lambda: write_sky(sky, tmp_path / "sky.png"), "sky.png", "'.png'", ".nc, .csv")
    refused(lambda: write_sky(sky, tmp_path / "no" / "sky.nc"), "sky.nc", "existing folder")
    (tmp_path / "folder.csv").mkdir()
    refused(lambda: write_sky(sky, tmp_path / "folder.csv"), "folder.csv", "found a folder")
    # Two times that nothing tells apart, and a direction that was measured twice.
    refused(lambda: write_sky(make_sky(2), tmp_path / "sky.csv"), "sky.csv", "`time`", "NetCDF")
    same = Sky(**{**vars(sky), "view_zenith": np.array([0.1, 0.1])})
    refused(lambda: write_sky(same, tmp_path / "sky.csv"), "sky.csv", "`view_zenith`")
    with pytest.raises(ValueError, match=re.escape("empty.txt")), atomic(tmp_path / "empty.txt"):
        pass
    assert os.listdir(tmp_path) == ["folder.csv"]
    for twice in (make_sky(2), same):
        write_sky(twice, tmp_path / "sky.nc")
        assert read(tmp_path / "sky.nc").radiance.shape == twice.radiance.shape
