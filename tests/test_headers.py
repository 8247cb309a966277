"""What the head of a file says: common spellings and units are understood, the rest is named, nothing is dropped."""

import numpy as np
import pytest
import xarray

from skyfit.measured import read, Sky, write_sky


HEADER = "view_zenith,view_azimuth,wavelength,radiance,sun_zenith,sun_azimuth"
ROW = "10,20,500,0.1,30,40"


def table(folder, *comments, header=HEADER, row=ROW):
    path = folder / "sky.csv"
    path.write_text("".join(f"# {line}\n" for line in comments) + f"{header}\n{row}\n", encoding="utf-8")
    return path


def dataset(attributes=(), variables=()) -> xarray.Dataset:
    light = ("direction", "wavelength"), np.full((2, 2), 0.1), {"units": "W m-2 sr-1 nm-1"}
    own = {"radiance": light, "sun_zenith": 40.0, "sun_azimuth": 120.0, **dict(variables)}
    places = {"view_zenith": ("direction", [10.0, 60.0]), "view_azimuth": ("direction", [0.0, 90.0])}
    return xarray.Dataset(own, {**places, "wavelength": ("wavelength", [500.0, 600.0])}, dict(attributes))


def netcdf(folder, **parts):
    dataset(**parts).to_netcdf(folder / "sky.nc", engine="h5netcdf")
    return folder / "sky.nc"


# key, value as a file spells them; field of the sky, number
SPELLINGS = [
    ("altitude_m", "4200", "altitude_m", 4200.0),
    ("altitude", "4200", "altitude_m", 4200.0),
    ("Altitude (m)", "4200", "altitude_m", 4200.0),
    ("alt", "4.2 km", "altitude_m", 4200.0),
    ("altitude_km", "4.2", "altitude_m", 4200.0),
    ("altitude_m_asl", "4200", "altitude_m", 4200.0),
    ("elevation", "4200 m", "altitude_m", 4200.0),
    ("Elevation_ft", "13779.528", "altitude_m", 4200.0),
    ("station elevation", "4200", "altitude_m", 4200.0),
    ("height_asl", "4200", "altitude_m", 4200.0),
    ("height above mean sea level", "4200m", "altitude_m", 4200.0),
    ("site_altitude", "4.2e3", "altitude_m", 4200.0),
    ("pressure_pa", "60050", "pressure_pa", 60050.0),
    ("pressure", "60050", "pressure_pa", 60050.0),
    ("pressure", "600.5 hPa", "pressure_pa", 60050.0),
    ("pressure", "600.5", "pressure_pa", 60050.0),
    ("pressure", "60.05", "pressure_pa", 60050.0),
    ("Pressure [mbar]", "600.5", "pressure_pa", 60050.0),
    ("pressure_hpa", "600.5", "pressure_pa", 60050.0),
    ("pressure_mbar", "600.5", "pressure_pa", 60050.0),
    ("surface_air_pressure", "60.05 kPa", "pressure_pa", 60050.0),
    ("latitude", "42.4", "latitude_deg", 42.4),
    ("lat", "42.4", "latitude_deg", 42.4),
    ("latitude_deg", "42.4", "latitude_deg", 42.4),
    ("Station latitude", "42.4 S", "latitude_deg", -42.4),
    ("lat", "42.4°N", "latitude_deg", 42.4),
    ("lon", "-76.5", "longitude_deg", -76.5),
    ("long", "76.5 deg W", "longitude_deg", -76.5),
    ("longitude_degrees_east", "-76.5", "longitude_deg", -76.5),
    ("fwhm", "6", "fwhm_nm", 6.0),
    ("fwhm", "60 angstrom", "fwhm_nm", 6.0),
    ("ozone", "310", "ozone_du", 310.0),
    ("total_ozone", "310 DU", "ozone_du", 310.0),
    ("sun_distance_au", "1.01", "sun_distance_au", 1.01),
]


@pytest.mark.parametrize("form", ["{}: {}", "{} = {}", "{}={}"])
@pytest.mark.parametrize(("key", "value", "field", "expected"), SPELLINGS)
def test_a_key_of_a_table_is_understood(tmp_path, key, value, field, expected, form):
    sky = read(table(tmp_path, form.format(key, value)))
    assert getattr(sky, field) == pytest.approx(expected, rel=1e-7)
    assert not any("not used" in note for note in sky.notes)


@pytest.mark.parametrize(("key", "value", "field", "expected"), SPELLINGS)
def test_an_attribute_is_understood(tmp_path, key, value, field, expected):
    sky = read(netcdf(tmp_path, attributes={key: value}))
    assert getattr(sky, field) == pytest.approx(expected, rel=1e-7)
    assert not any("not used" in note for note in sky.notes)


@pytest.mark.parametrize(
    ("key", "value", "units", "field", "expected"),
    [
        ("elevation", 4.2, "km", "altitude_m", 4200.0),
        ("altitude", 4200.0, "m", "altitude_m", 4200.0),
        ("pressure", 600.5, "hPa", "pressure_pa", 60050.0),
        ("surface_pressure", 60050.0, "", "pressure_pa", 60050.0),
        ("lat", 42.4, "degrees_north", "latitude_deg", 42.4),
        ("lon", 76.5, "degrees_west", "longitude_deg", -76.5),
    ],
)
def test_a_variable_is_understood(tmp_path, key, value, units, field, expected):
    sky = read(netcdf(tmp_path, variables={key: ((), value, {"units": units} if units else {})}))
    assert getattr(sky, field) == pytest.approx(expected) and sky.notes == ()


def test_columns_of_one_value_are_understood(tmp_path):
    header, row = f"{HEADER},lat,lon,altitude_km,pressure_hpa", f"{ROW},42.4,-76.5,1.2,870"
    sky = read(table(tmp_path, header=header, row=f"{row}\n{row.replace('500', '600')}"))
    found = sky.latitude_deg, sky.longitude_deg, sky.altitude_m, sky.pressure_pa
    assert found == pytest.approx((42.4, -76.5, 1200.0, 87000.0)) and sky.notes == ()
    # that of each row is none of the station
    other = row.replace("500", "600").replace("870", "871")
    sky = read(table(tmp_path, header=header, row=f"{row}\n{other}"))
    assert np.isnan(sky.pressure_pa) and sky.notes == ("columns not used: pressure_hpa",)


@pytest.mark.parametrize(
    ("make", "unknown"),
    [
        (lambda folder: table(folder, "altitud: 4200", "clouds = 3"), "header keys not used: altitud, clouds"),
        (lambda folder: table(folder, "sea_level_pressure: 1013 hPa"), "header keys not used: sea_level_pressure"),
        (lambda folder: table(folder, "timezone: CET"), "header keys not used: timezone"),
        (lambda folder: netcdf(folder, attributes={"altitud": 4200.0}), "attributes not used: altitud"),
        (lambda folder: netcdf(folder, variables={"altitud": 4200.0}), "variables not used: altitud"),
        (
            lambda folder: netcdf(folder, variables={"elevation": ("direction", [80.0, 30.0])}),
            "variables not used: elevation",
        ),
    ],
)  # fmt: skip
def test_what_is_not_understood_is_named(tmp_path, make, unknown):
    sky = read(make(tmp_path))
    assert sky.notes == (unknown,) and np.isnan(sky.altitude_m) and np.isnan(sky.pressure_pa)


def test_prose_and_what_describes_a_file_are_no_keys(tmp_path):
    prose = "free", "the sky was clear until about half past ten: then cirrus came", "Measured at 10:30, roof"
    assert read(table(tmp_path, *prose)).notes == ()
    described = {"Conventions": "CF-1.8", "title": "a sky", "history": "made: 2020", "geospatial_lat_min": 42.0}
    assert read(netcdf(tmp_path, attributes=described)).notes == ()
    assert read(table(tmp_path, "altitude 4200 m")).altitude_m == 4200.0


@pytest.mark.parametrize(
    ("comments", "parts"),
    [
        (["altitude: high"], ["row 1", "`altitude`", "a number and a unit such as m, km", "'high'"]),
        (["altitude: 42 hPa"], ["row 1", "`altitude`", "'42 hPa'"]),
        (["altitude_m: 4.2 km"], ["row 1", "`altitude_m`", "one unit", "km, m"]),
        (["altitude: 4200", "elevation_m: 0"], ["row 2", "`elevation_m`", "as told before, 4200, found 0"]),
        (["pressure: 6005"], ["row 1", "`pressure`", "with its unit", "6005"]),
        (["pressure_pa: 600.5"], ["`pressure_pa`", "600.5"]),
        (["pressure_hpa: 60050"], ["`pressure_pa`", "6.005e+06"]),
        (["made_by: hand"], ["row 1", "`made_by`", "JSON", "'hand'"]),
    ],
)
def test_a_key_that_cannot_be_is_refused(tmp_path, comments, parts):
    with pytest.raises(ValueError, match=r"sky\.csv: ") as caught:
        read(table(tmp_path, *comments))
    assert all(part in str(caught.value) for part in parts), str(caught.value)


def test_a_pressure_without_unit_is_said(tmp_path):
    assert read(table(tmp_path, "pressure: 600.5")).notes == ("`pressure` 600.5 has no unit: taken as hPa",)


@pytest.mark.parametrize("key", ["time", "date", "datetime", "Date UTC"])
def test_a_time_or_a_day_of_the_head(tmp_path, key):
    for make in (lambda text: table(tmp_path, f"{key}: {text}"), lambda text: netcdf(tmp_path, attributes={key: text})):
        sky = read(make("2020-06-01T12:00:00Z"))
        assert sky.time == [np.datetime64("2020-06-01T12:00")] and np.isnan(sky.sun_distance_au)
        # a day says how far the sun is, not when
        sky = read(make("2020-07-04"))
        assert np.isnat(sky.time).all() and sky.sun_distance_au == pytest.approx(1.0167, abs=1e-3)


@pytest.mark.parametrize("suffix", [".nc", ".csv"])
def test_what_is_written_of_a_station_reads_back(tmp_path, suffix):
    sky = read(table(tmp_path, "altitude: 4200", "pressure: 600.5 hPa", "ozone: 310", "sun_distance: 1.01"))
    sky = Sky(**{**vars(sky), "made_by": {"solver": {"name": "a", "streams": 8}, "numbers": [1.5, 2.0]}})
    write_sky(sky, tmp_path / f"again{suffix}")
    again = read(tmp_path / f"again{suffix}")
    for name in ("altitude_m", "pressure_pa", "ozone_du", "sun_distance_au", "made_by", "notes"):
        assert getattr(again, name) == getattr(sky, name)


def test_the_header_of_the_faulty_file_is_understood(shared):
    path = shared / "faults" / "f12_header_typo.csv"
    if not path.is_file():
        pytest.skip("the faulty files are absent")
    assert read(path).altitude_m == 4200.0
