"""Scans as SKYRAD.pack writes them, made of simulated skies: read, understood where they are odd, or refused."""

import re

import numpy as np
import pytest
from instrument_files import CURRENTS, dt5_scan, ins_para
from made_skies import by_hand, SOLVER
from typer.testing import CliRunner

import skyfit
from skyfit.cli import app
from skyfit.light import extraterrestrial_irradiance
from skyfit.measured import read, solar_position, write_sky


WAVELENGTHS = np.array(list(CURRENTS))
OUTSIDE = np.array(list(CURRENTS.values()))
AZIMUTHS = np.array([3.0, 4.0, 6.0, 10.0, 15.0, 25.0, 40.0, 60.0, 90.0, 120.0, 150.0, 170.0])
DISTANCE = 1.0162
# on Japan's clock, nine hours ahead
TIME, UTC = np.datetime64("2024-06-21T08:00:00", "s"), np.datetime64("2024-06-20T23:00:00", "s")
# where time and place put the sun, to the decimals of a file, its azimuth from south
SUN = tuple(
    round(float(np.degrees(angle[0])) - turn, 1)
    for angle, turn in zip(solar_position(np.array([UTC]), 35.75, 139.32), (0.0, 180.0), strict=True)
)
HAZE = {"aerosol_optical_depth": 0.25, "angstrom_exponent": 1.2, "asymmetry": 0.68}
# SKYRAD gives five digits
DIGITS = 1e-4


def simulated(zenith, azimuth, **haze):
    """Radiance `[direction, wavelength]` and beam `[wavelength]` of a hazy sky, views counted from the sun."""
    turned = np.radians(180.0 + SUN[1] + np.asarray(azimuth))
    view = skyfit.Directions(np.radians(zenith), turned)
    near = DISTANCE**-2
    sun = np.radians(SUN[0]), np.radians(180.0 + SUN[1])
    haze = HAZE | haze
    light = by_hand(SOLVER, WAVELENGTHS, 0, *sun, near, **haze, fwhm_nm=10.0, view=view)
    depth = haze["aerosol_optical_depth"] * (WAVELENGTHS / 550.0) ** -haze["angstrom_exponent"]
    air = np.asarray(skyfit.Rayleigh(101325.0).optical_depth_at(WAVELENGTHS), float)
    gas = np.asarray(skyfit.Ozone(300.0).optical_depth_at(WAVELENGTHS), float)
    beam = near * np.asarray(extraterrestrial_irradiance(WAVELENGTHS, 10.0), float)
    return light, beam * np.exp(-(depth + air + gas) / np.cos(sun[0]))


def currents(light, beam):
    """What the instrument reads of them: R of each view, and the current toward the sun at 1 au."""
    outside = np.asarray(extraterrestrial_irradiance(WAVELENGTHS, 10.0), float)
    return light * np.cos(np.radians(SUN[0])) / beam, beam / outside * OUTSIDE * DISTANCE**2


@pytest.fixture(scope="module")
def almucantar():
    light, beam = simulated(np.full(AZIMUTHS.size, SUN[0]), AZIMUTHS)
    ratio, current = currents(light, beam)
    text = dt5_scan(WAVELENGTHS, np.full(AZIMUTHS.size, SUN[0]), AZIMUTHS, ratio, current, SUN, TIME, DISTANCE)
    return text, light, beam


def written(folder, text, **calibration):
    ins_para(folder / "ins.para", **calibration)
    (folder / "scan.DT5").write_text(text)
    return folder / "scan.DT5"


def said(sky, words):
    return [note for note in sky.notes if words in note]


def test_radiance_beam_angles_and_times_of_a_scan(tmp_path, almucantar):
    text, light, beam = almucantar
    sky = read(written(tmp_path, text))
    assert sky.instrument == "PREDE sky radiometer PS1: almucantar"
    np.testing.assert_allclose(sky.wavelength_nm, WAVELENGTHS)
    np.testing.assert_allclose(sky.radiance[0], light, rtol=DIGITS)
    np.testing.assert_allclose(sky.direct_irradiance, beam[None], rtol=DIGITS)
    np.testing.assert_allclose(sky.direct_sigma, 0.02 * sky.direct_irradiance)
    assert sky.usable.all() and sky.masked == {} and sky.time.astype("datetime64[s]") == [UTC]
    assert (sky.latitude_deg, sky.longitude_deg, sky.altitude_m) == (35.75, 139.32, 40.0)
    assert (sky.sun_distance_au, sky.fwhm_nm, sky.calibration_sigma) == (DISTANCE, 10.0, 0.03)
    np.testing.assert_allclose(np.degrees(sky.sun_zenith), [SUN[0]])
    np.testing.assert_allclose(np.degrees(sky.sun_azimuth), [180.0 + SUN[1]])
    np.testing.assert_allclose(np.degrees(sky.view_zenith), np.full((1, AZIMUTHS.size), SUN[0]))
    np.testing.assert_allclose(np.degrees(sky.view_azimuth[0] - sky.sun_azimuth), AZIMUTHS)
    assert not said(sky, "the stated sun") and said(sky, "currents outside the air of ins.para, 2024-06-01")
    assert said(sky, "cones of 1.00 degrees") and said(sky, "calibration 3%, the sun's beam 2%")
    write_sky(sky, tmp_path / "sky.nc")
    np.testing.assert_allclose(read(tmp_path / "sky.nc").direct_irradiance, sky.direct_irradiance)


@pytest.mark.slow
def test_haze_comes_back_from_a_scan_and_its_beam(x64, tmp_path, almucantar):
    sky = read(written(tmp_path, almucantar[0]))
    fit = skyfit.invert(sky, tuple(HAZE), SOLVER)
    assert fit.result == ("successful",)
    assert fit.values[0] == pytest.approx(list(HAZE.values()), rel=0.01)


@pytest.mark.parametrize("name", ["24062100.DT5", "scan.txt", "scan.csv", "scan"])
def test_a_scan_is_known_by_what_is_in_it(tmp_path, almucantar, name):
    ins_para(tmp_path / "ins.para.PS1")
    (tmp_path / name).write_text(almucantar[0])
    assert read(tmp_path / name).radiance.shape == (1, AZIMUTHS.size, 5)


def test_the_vertical_plane_goes_on_beyond_the_zenith(tmp_path):
    zenith = np.array([40.0, 20.0, 5.0, -10.0, -30.0, -60.0])
    light, beam = simulated(np.abs(zenith), np.where(zenith < 0.0, 180.0, 0.0))
    ratio, current = currents(light, beam)
    text = dt5_scan(WAVELENGTHS, zenith, np.zeros(6), ratio, current, SUN, TIME, DISTANCE)
    sky = read(written(tmp_path, text))
    assert sky.instrument.endswith("principal plane")
    np.testing.assert_allclose(sky.radiance[0], light, rtol=DIGITS)
    np.testing.assert_allclose(np.degrees(sky.view_zenith[0]), np.abs(zenith))
    around = np.degrees(sky.view_azimuth[0] - sky.sun_azimuth)
    np.testing.assert_allclose(np.cos(np.radians(around)), np.where(zenith < 0.0, -1.0, 1.0), atol=1e-12)


def test_scans_follow_each_other_each_under_its_own_sun(tmp_path, almucantar):
    other = (
        almucantar[0].replace(" 08 00 00   8.0000", " 08 20 00   8.3333").replace(f"{SUN[0]:.1f}", f"{SUN[0] - 4:.1f}")
    )
    sky = read(written(tmp_path, almucantar[0] + "\n" + other))
    assert sky.radiance.shape == (2, AZIMUTHS.size, 5) and sky.time[1] - sky.time[0] == np.timedelta64(20, "m")
    assert np.degrees(sky.sun_zenith) == pytest.approx([SUN[0], SUN[0] - 4.0])
    np.testing.assert_allclose(sky.view_zenith, np.broadcast_to(sky.sun_zenith[:, None], sky.view_zenith.shape))


def test_older_heads_hold_the_hour_alone(tmp_path, almucantar):
    sky = read(written(tmp_path, almucantar[0].replace("06 21 08 00 00   8.0000", "06 21 8.0")))
    assert sky.time.astype("datetime64[s]") == [UTC]


def test_currents_outside_the_air_are_those_of_the_day(tmp_path, almucantar):
    dates = ("2024  6 10 23.0", "2024  6 30 23.0")
    sky = read(written(tmp_path, almucantar[0], dates=dates, factors=(0.9, 1.1)))
    np.testing.assert_allclose(sky.radiance[0], almucantar[1], rtol=DIGITS)
    assert said(sky, "of ins.para, 2024-06-10 to 2024-06-30")
    sky = read(written(tmp_path, almucantar[0], dates=dates[:1], factors=(2.0,)))
    np.testing.assert_allclose(sky.direct_irradiance[0], 0.5 * almucantar[2], rtol=DIGITS)


def test_what_is_not_calibrated_or_beyond_the_suns_table_is_named(tmp_path, almucantar):
    outside = dict(CURRENTS) | {400.0: -9.99e-4, 870.0: 0.0}
    text = almucantar[0].replace("1.020000E-04", "1.627000E-04")
    sky = read(written(tmp_path, text, outside=outside))
    np.testing.assert_allclose(sky.wavelength_nm, [500.0, 675.0])
    assert said(sky, "400, 870 nm left out, without a current in ins.para") and said(sky, "1627 nm left out, beyond")


def test_missing_currents_and_angles_are_counted(tmp_path, almucantar):
    lines = almucantar[0].splitlines()
    # no sample of 400 nm 3 degrees from the sun, none of 500 nm at 4 degrees, which has no place either
    lines[9] = lines[9][:14] + "  0.0000E+00" + lines[9][26:]
    lines[11] = lines[11][:26] + "  -99.0 -999.0" + lines[11][40:]
    sky = read(written(tmp_path, "\n".join(lines)))
    assert sky.masked == {"missing": 2} and not sky.usable[0, 0, 0] and not sky.usable[0, 1, 1]
    assert said(sky, "1 samples have no zenith angle or azimuth") and said(sky, "2 of 60 samples missing")
    # no beam of 400 nm, hence no radiance
    lines = almucantar[0].splitlines()
    lines[7] = lines[7][:14] + "  -999.0    " + lines[7][26:]
    sky = read(written(tmp_path, "\n".join(lines)))
    assert sky.masked == {"missing": 12} and np.isnan(sky.direct_irradiance[0, 0])
    assert said(sky, "1 of 5 scans and wavelengths have no current of the sun")


def test_a_wavelength_that_is_there_twice_begins_a_scan_of_its_own(tmp_path, almucantar):
    sky = read(written(tmp_path, almucantar[0].replace("8.700000E-05", "6.750000E-05")))
    assert sky.radiance.shape == (2, AZIMUTHS.size, 4) and sky.counts()["usable"] == 5 * AZIMUTHS.size
    assert said(sky, "a wavelength comes again within a scan, such as 675 nm in row 1")


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (lambda text: text[:-60], ["row 3", "expected 15 numbers", "view 13 of 13", "then 'the end of the file'"]),
        (lambda text: text.replace("    3.0  ", "    3.O  ", 1), ["row 10", "expected 15 numbers", "found 2, then 'O"]),
        (lambda text: text.replace("2024 06 21", "2024 06 31"), ["row 1", "year, month and day, found 2024 6 31"]),
        (lambda text: text.replace(" 08 00 00", " 25 00 00"), ["row 1", "an hour of the day, found 25"]),
        (lambda text: text.replace("1.0162", "1.5162"), ["row 1", "the sun at 0.98 to 1.02 au, found 1.5162"]),
        (lambda text: text.replace("    0.0  ", "   12.0  "), ["row 1", "the first view toward the sun"]),
        (lambda text: text.replace(f"{SUN[0]:.1f}", "91.0"), ["row 1", "zenith angle in [0, 90), found 91"]),
        (
            lambda text: re.sub(r"(\d{6})E-0[45]", r"\1E-02", text),
            ["expected a calibrated wavelength", "870000 nm left out"],
        ),
    ],
)
def test_a_scan_that_cannot_be_understood_is_refused_in_one_line(tmp_path, almucantar, change, parts):
    with pytest.raises(ValueError, match=r"^scan\.DT5: ") as caught:
        read(written(tmp_path, change(almucantar[0])))
    assert all(part in str(caught.value) for part in parts) and "\n" not in str(caught.value), caught.value


def test_a_scan_without_its_calibration_is_refused(tmp_path, almucantar):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "scan.DT5").write_text(almucantar[0])
    with pytest.raises(ValueError, match=r"^scan\.DT5: expected a file ins\.para beside it .*found none"):
        read(tmp_path / "a" / "scan.DT5")
    # that of the folder above, as SKYRAD.pack has it
    ins_para(tmp_path / "ins.para.one")
    assert read(tmp_path / "a" / "scan.DT5").usable.all()
    ins_para(tmp_path / "ins.para.two")
    with pytest.raises(ValueError, match=r"expected one ins\.para beside it, found ins\.para\.one, ins\.para\.two"):
        read(tmp_path / "a" / "scan.DT5")
    (tmp_path / "ins.para").write_text("- instrument -\nPS1\n30\n 7 : NW\n3e-5\n")
    with pytest.raises(ValueError, match=r"^ins\.para: row 5: expected 7 numbers, wavelengths in cm, found 1"):
        read(tmp_path / "a" / "scan.DT5")


def test_convert_shows_what_was_understood(tmp_path, almucantar):
    out = tmp_path / "sky.nc"
    call = ["convert", str(written(tmp_path, almucantar[0])), "--to", str(out)]
    done = CliRunner().invoke(app, call, env={"COLUMNS": "80"})
    assert done.exception is None, done.exception
    printed = " ".join(done.output.split())
    for part in (
        "scan.DT5: PREDE sky radiometer PS1: almucantar", "times 1: 2024-06-20T23:00:00Z",
        "wavelengths 5: 400, 500, 675, 870, 1020 nm, line shape 10 nm", "beam direct normal irradiance, 5 of 5",
    ):  # fmt: skip
        assert part in printed, part
    np.testing.assert_allclose(read(out).radiance[0], almucantar[1], rtol=DIGITS)
