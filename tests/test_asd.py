"""ASD folders: file names, azimuth, local time and sun, and the measured scan against its NetCDF."""

from pathlib import Path

import numpy as np
import pandas
import pvlib
import pytest

from skyfit.measured import read, solar_position


MEASURED = Path(__file__).parents[2] / "shared" / "measured" / "kider2014"
needs_measured = pytest.mark.skipif(not MEASURED.is_dir(), reason="the measured skies of ../shared are not here")
# Ithaca, NY, where the scans were made.
PLACE = {"latitude": 42.443449, "longitude": -76.481962}


def write_scan(folder: Path, local="10.00.00", wavelengths=(400, 401, 402)) -> Path:
    """An ASD folder: azimuth counter-clockwise, elevation."""
    folder.mkdir(exist_ok=True)
    for index, (azimuth, elevation) in enumerate([(0.0, 12.5), (90.0, 12.5), (315.0, 90.0)]):
        name = f"2013-05-27___{local}_-_{index}____{azimuth}___{elevation}.asd.rad"
        lines = [f"Wavelength\t{name}\t"]
        lines += [f"{w}\t {0.1 + index + 1e-3 * w:.14E} " for w in wavelengths]
        (folder / f"{name}.txt").write_bytes("\r\n".join([*lines, ""]).encode())
    return folder


def test_an_asd_folder(tmp_path):
    folder = write_scan(tmp_path / "scan")
    sky = read(folder, **PLACE, utc_offset=-4, altitude=325, fwhm_nm=6)
    assert sky.time.tolist() == np.array(["2013-05-27T14:00"], "datetime64[ns]").tolist()
    np.testing.assert_allclose(np.rad2deg(sky.view_azimuth[0]), [0.0, 270.0, 45.0])
    np.testing.assert_allclose(np.rad2deg(sky.view_zenith[0]), [77.5, 77.5, 0.0], atol=1e-12)
    np.testing.assert_allclose(sky.radiance[0, 1], [1.5, 1.501, 1.502])
    assert (sky.altitude_m, sky.fwhm_nm, sky.source) == (325.0, 6.0, "scan")
    zenith, azimuth = np.rad2deg(solar_position(sky.time, altitude=325.0, **PLACE))
    np.testing.assert_allclose(np.rad2deg(sky.sun_zenith), zenith)
    np.testing.assert_allclose(np.rad2deg(sky.sun_azimuth), azimuth)


def test_a_folder_of_asd_folders_is_a_day(tmp_path):
    write_scan(tmp_path / "b", "10.00.00")
    write_scan(tmp_path / "a", "11.30.00")
    next((tmp_path / "a").glob("*_-_1__*")).unlink()
    sky = read(tmp_path, **PLACE, utc_offset=-4.0)
    assert sky.radiance.shape == (2, 3, 3)
    assert sky.masked == {"missing": 3}
    assert not np.any(sky.usable[1, 1])
    assert np.diff(sky.time)[0] == np.timedelta64(90, "m")


def test_the_sun_sets_without_a_jump():
    time = np.datetime64("2026-06-21T19:00") + np.arange(60).astype("timedelta64[m]")
    true = pvlib.solarposition.get_solarposition(pandas.DatetimeIndex(time, tz="UTC"), 48.0, 11.0)
    seen, lit = (np.rad2deg(solar_position(time, 48.0, 11.0, refracted=share)[0]) for share in (1.0, 0.5))
    day = true["elevation"] > -0.8
    np.testing.assert_allclose(seen[day], true["apparent_zenith"][day], atol=1e-9)
    np.testing.assert_allclose(lit, 0.5 * (seen + true["zenith"]), atol=1e-9)
    assert np.sum(~day) > 30 and np.all(np.abs(np.diff(seen, 2)) < 0.03)


def test_solar_position_at_an_equinox():
    # On 20 March 2020 the equation of time is -7.4 min and the declination within 0.1 degrees of
    # 0: over (0, 0) the sun culminates at 12:07:24 UTC and has risen due east. At 7:00 the hour
    # angle is 76.85 degrees, of which refraction takes 0.07.
    time = np.array(["2020-03-20T12:07:24", "2020-03-20T07:00"], "datetime64[ns]")
    zenith, azimuth = np.rad2deg(solar_position(time, 0.0, 0.0))
    assert zenith[0] < 0.3
    np.testing.assert_allclose(azimuth[1], 90.0, atol=0.2)
    np.testing.assert_allclose(zenith[1], 76.78, atol=0.02)
    with pytest.raises(ValueError, match="`latitude`"):
        solar_position(time, 91.0, 0.0)
    with pytest.raises(ValueError, match="`longitude`"):
        solar_position(time, 0.0, 400.0)
    with pytest.raises(ValueError, match="`time`"):
        solar_position(np.array(["NaT"], "datetime64[ns]"), 0.0, 0.0)


@needs_measured
def test_the_measured_day_and_the_scan_it_came_from():
    day = read(MEASURED / "2013-05-27.nc")
    assert day.radiance.shape == (8, 81, 471)
    # One direction of eighty-one is marked as shaded.
    assert day.counts() == {"samples": 305208, "usable": 301440, "suspect": 3768}
    assert day.notes == (
        "sun azimuth from sun_azimuth_instrument",
        "variables not used: global_horizontal_irradiance",
    )
    assert (day.altitude_m, day.latitude_deg) == (325.0, PLACE["latitude"])
    scan = read(MEASURED / "2013-05-27___10.00.00", **PLACE, utc_offset=-4, altitude=325)
    assert scan.radiance.shape == (1, 81, 2151)
    assert set(scan.masked) == {"negative"}
    second = day.at(1)
    assert scan.time[0] == second.time[0]
    # The ephemeris of the file is true, that of the scan apparent: 0.02 degrees of refraction.
    np.testing.assert_allclose(scan.sun_zenith, second.sun_zenith, atol=np.deg2rad(0.03))
    chosen = scan.select(wavelength_nm=day.wavelength_nm)
    # Whatever the order of directions: each view of one is matched to the nearest of the other.
    places = []
    for zenith, azimuth in zip(second.view_zenith[0], second.view_azimuth[0], strict=True):
        apart = np.hypot(
            chosen.view_zenith[0] - zenith,
            np.sin(zenith) * np.sin(0.5 * (chosen.view_azimuth[0] - azimuth)),
        )
        places.append(int(np.argmin(apart)))
        assert apart[places[-1]] < 1e-6
    assert sorted(places) == list(range(81))
    # The file holds float32.
    np.testing.assert_allclose(chosen.radiance[:, places], second.radiance, rtol=1e-6)
