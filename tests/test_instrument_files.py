"""Files as photometers and scanners leave them: read by what is in them, or refused in one line."""

import numpy as np
import pytest
from instrument_files import (
    aeronet,
    AZIMUTHS,
    boustrophedon,
    COLUMNS,
    csphot,
    DEPTHS,
    FILTERS,
    HEAD,
    MISSING,
    old_aeronet,
    optical_depths,
    patches,
    PLANE,
    radiance,
    RISE,
    row,
    scan,
    START,
    SUN_ZENITH,
)  # fmt: skip

import skyfit
from skyfit.measured import read, write_sky


WAVELENGTHS = 1e3 * np.sort(FILTERS)
LIGHT = 0.01 * np.array([radiance(AZIMUTHS[1:], f) for f in sorted(FILTERS)]).T
SUNS = SUN_ZENITH - RISE * np.array([3.0, 2.0, 1.0, 0.0])
MIDDLE = START + np.timedelta64(126, "s")


def said(sky, words):
    return [note for note in sky.notes if words in note]


@pytest.mark.parametrize("name", ["scan.alm", "scan.txt", "scan.csv", "scan.nc", "scan"])
def test_an_almucantar_is_known_by_what_is_in_it(tmp_path, name):
    sky = read(aeronet(tmp_path / name, scan()))
    assert sky.instrument == "AERONET photometer 7, Nowhere: almucantar" and sky.source == name
    np.testing.assert_allclose(sky.wavelength_nm, WAVELENGTHS)
    np.testing.assert_allclose(sky.radiance[0], LIGHT, rtol=1e-5)
    assert sky.time.astype("datetime64[s]") == [MIDDLE] and sky.usable.all() and sky.masked == {}
    assert (sky.latitude_deg, sky.longitude_deg, sky.altitude_m) == (40.0, 5.0, 120.0)
    assert (sky.fwhm_nm, sky.calibration_sigma) == (10.0, 0.05)
    np.testing.assert_allclose(sky.sigma, 0.02 * sky.radiance)
    # each filter under its own sun, each view at that sun's height and by its azimuth
    np.testing.assert_allclose(np.degrees(sky.sun_zenith), [SUNS], atol=1e-9)
    zenith, azimuth = sky.view_zenith_by_wavelength, sky.view_azimuth_by_wavelength
    np.testing.assert_allclose(np.degrees(zenith), np.broadcast_to(SUNS, (1, 14, 4)), atol=1e-9)
    turned = np.degrees(azimuth - sky.sun_azimuth[:, None]) - np.array(AZIMUTHS[1:])[:, None]
    np.testing.assert_allclose(np.remainder(turned + 180.0, 360.0), 180.0, atol=1e-9)
    assert said(sky, "radiance converted from uW/cm^2/sr/nm") and said(sky, "4 of 60 samples missing")
    assert not said(sky, "the stated sun")


def test_the_names_of_older_files_hold_the_angles(tmp_path):
    sky = read(old_aeronet(tmp_path / "scan.ppl", scan(PLANE, "Principal Plane"), PLANE))
    assert sky.instrument.endswith("principal plane")
    assert said(sky, "no latitude and longitude: azimuths are counted from the sun")
    assert np.degrees(sky.sun_azimuth) == pytest.approx([180.0])
    # upward from the sun, over the zenith and down behind it
    along = SUNS - np.array([a for a in PLANE if a != 0.0])[:, None]
    np.testing.assert_allclose(np.degrees(sky.view_zenith_by_wavelength)[0], np.abs(along), atol=1e-9)
    behind = np.isclose(np.degrees(sky.view_azimuth_by_wavelength)[0], 0.0)
    np.testing.assert_array_equal(behind, along < 0.0)
    assert read(tmp_path / "scan.ppl", latitude=40, longitude=5, altitude=120).sun_azimuth[0, 0] < 1.6


@pytest.mark.parametrize("backward", [False, True])
def test_scans_follow_each_other_whatever_the_order_of_lines(tmp_path, backward):
    later = START + np.timedelta64(50, "m")
    rows = [*scan(), *scan(begin=later)]
    sky = read(aeronet(tmp_path / "two.alm", rows[::-1] if backward else sorted(rows, key=lambda r: r.split(",")[5])))
    assert sky.radiance.shape == (2, 14, 4) and sky.usable.all()
    assert (sky.time.astype("datetime64[s]") == [MIDDLE, later + np.timedelta64(126, "s")]).all()


def test_two_scans_without_a_pause_are_two(tmp_path):
    rows = scan() + scan(begin=START + np.timedelta64(4 * 84, "s"))
    sky = read(aeronet(tmp_path / "two.alm", rows))
    assert sky.radiance.shape == (2, 14, 4) and not said(sky, "comes again")


def test_a_wavelength_that_comes_again_within_a_scan_is_kept_and_said(tmp_path):
    filters = (1.0203, 1.0203, 0.8701, 0.6749, 0.4402)
    sky = read(aeronet(tmp_path / "again.alm", scan(filters=filters)))
    assert sky.radiance.shape == (2, 14, 4) and sky.counts()["usable"] == 14 * 5
    assert said(sky, "a wavelength comes again within a scan, such as 1020.3 nm in row 10")


def test_wavelengths_beyond_the_suns_table_are_kept_and_left_out_of_a_fit(tmp_path):
    from skyfit.retrieve.sampling import Sampling

    sky = read(aeronet(tmp_path / "far.alm", scan(filters=(1.6400, *FILTERS))))
    assert sky.wavelength_nm[-1] == 1640.0 and sky.usable.all()
    sampling = Sampling(sky, None)
    assert not sampling.used[..., -1].any() and "14 samples beyond 300-1100 nm left out" in sampling.notes


def test_a_filter_that_one_scan_lacks_looks_where_its_neighbour_did(tmp_path):
    later = START + np.timedelta64(50, "m")
    sky = read(aeronet(tmp_path / "two.alm", scan() + scan(begin=later, filters=FILTERS[:3])))
    assert np.isfinite(sky.view_zenith_by_wavelength).all() and np.isfinite(sky.sun_zenith).all()
    assert sky.masked == {"missing": 14} and not sky.usable[1, :, 0].any()


def test_what_is_missing_is_counted_and_what_has_no_angle_named(tmp_path):
    light = radiance(AZIMUTHS, 0.4402)
    light[3] = -999.0
    rows = [*scan()[:3], row(3, light=light)]
    sky = read(aeronet(tmp_path / "scan.alm", rows))
    assert said(sky, "5 of 60 samples missing") and sky.masked == {"missing": 1}
    unknown = (*AZIMUTHS[:4], None, *AZIMUTHS[5:])
    sky = read(aeronet(tmp_path / "scan.alm", scan(), unknown))
    assert said(sky, "1 columns of radiance have no angle: left out") and sky.radiance.shape == (1, 13, 4)


def test_the_sun_itself_is_no_sky(tmp_path):
    rows = [line.replace(f",{MISSING}", ",123456.0", 1) for line in scan()]
    sky = read(aeronet(tmp_path / "scan.alm", rows))
    assert said(sky, "4 samples toward the sun itself left out") and sky.radiance.shape == (1, 14, 4)


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (lambda rows: [*rows, row(0, site="Elsewhere")], ["`AERONET_Site`", "one site", "Nowhere, Elsewhere"]),
        (lambda rows: [line.replace("Almucantar", "Cloud Mode") for line in rows], ["row 10", "'Cloud Mode'"]),
        (lambda rows: [*rows[:3], rows[3][:-40]], ["row 13", "expected 26 cells"]),
        (lambda rows: [rows[0].replace("06:30:00", "6h30")], ["row 10", "a time hh:mm:ss", "'6h30'"]),
        (lambda rows: [rows[0].replace("1.0203", "red")], ["row 10", "`Exact_Wavelength(um)`", "'red'"]),
        (lambda rows: [rows[0].replace("65.90000", MISSING)], ["row 10", "a solar zenith angle, found none"]),
        (lambda rows: [], ["expected rows below the names"]),
    ],
)
def test_a_scan_that_cannot_be_understood_is_refused_in_one_line(tmp_path, change, parts):
    aeronet(tmp_path / "scan.alm", change(scan()))
    with pytest.raises(ValueError, match=r"^scan\.alm: ") as caught:
        read(tmp_path / "scan.alm")
    assert all(part in str(caught.value) for part in parts) and "\n" not in str(caught.value), caught.value


def test_other_units_and_other_columns_of_a_scan(tmp_path):
    sky = read(aeronet(tmp_path / "scan.alm", scan(), units="mW/m^2/sr/nm"))
    np.testing.assert_allclose(sky.radiance[0], 0.1 * LIGHT, rtol=1e-5)
    with pytest.raises(
        ValueError, match=r"scan\.alm: column `Radiance`: expected units W m-2 sr-1 nm-1, found 'counts'"
    ):
        read(aeronet(tmp_path / "scan.alm", scan(), units="counts"))
    columns = COLUMNS.replace("Solar_Zenith_Angle(Degrees),", "")
    with pytest.raises(ValueError, match=r"scan\.alm: expected "):
        read(aeronet(tmp_path / "scan.alm", scan(), columns=columns))
    with pytest.raises(
        ValueError, match=r"siz\.csv: found a file of AERONET without radiances: expected a raw sky scan"
    ):
        (tmp_path / "siz.csv").write_text("\n".join([*HEAD, "Site,Date(dd:mm:yyyy),Time(hh:mm:ss),0.05,0.06"]) + "\n")
        read(tmp_path / "siz.csv")
    with pytest.raises(ValueError, match="`utc_offset` is for a sky scanner or a folder"):
        read(aeronet(tmp_path / "scan.alm", scan()), utc_offset=2)


def angled(path, off=0.0):
    """A file with its scattering angles, and with a group of columns that is none of radiance."""
    sun = [float(line.split(",")[6]) for line in scan()]
    away = np.radians(np.array(AZIMUTHS))
    rows = []
    for line, zenith in zip(scan(), np.radians(sun), strict=True):
        angle = np.degrees(np.arccos(np.cos(zenith) ** 2 + np.sin(zenith) ** 2 * np.cos(away))) + off
        rows.append(",".join([line, *(f"{v:.3f}" for v in angle), *["0.1"] * len(AZIMUTHS)]))
    lines = aeronet(path, rows).read_text().splitlines()
    for group in ("Scattering_Angle_for_Nominal_Azimuth_Angle(Degrees)", "Degree_of_Polarization"):
        lines[7] += f",{group}" + "," * (len(AZIMUTHS) - 1)
        lines[8] += "," + ",".join(f"{a:.3f}" for a in AZIMUTHS)
    path.write_text("\n".join(lines) + "\n")
    return path


def test_the_files_own_scattering_angles_confirm_its_views(tmp_path):
    sky = read(angled(tmp_path / "scan.alm"))
    assert sky.radiance.shape == (1, 14, 4) and not said(sky, "scattering angles")
    assert said(sky, "columns not used: Degree_of_Polarization")
    assert said(
        read(angled(tmp_path / "scan.alm", off=3.0)), "scattering angles are 3.0 degrees from those of its views"
    )


# degrees from the sun; of a hybrid scan both ways
AWAY = (0.0, -60.0, -20.0, -4.0, 4.0, 20.0, 60.0, 100.0)


def rotated(scattering, sun_deg):
    """Zenith angle and azimuth from the sun of views of a hybrid scan, by turning a vector, degrees.

    The sun's vector is turned about the axis that lies in its vertical plane, at right angles to it; from the zenith
    angle of 75 degrees on views are looked for by their scattering angle.
    """
    sun, away = np.radians(sun_deg), np.radians(scattering)
    vector = np.stack([np.cos(away) * np.sin(sun), np.sin(away), np.cos(away) * np.cos(sun)])
    zenith, azimuth = np.degrees(np.arccos(vector[2])), np.degrees(np.arctan2(vector[1], vector[0]))
    around = np.linspace(0.0, 180.0, 180001)
    low = np.radians(75.0)
    angles = np.degrees(np.arccos(np.cos(low) * np.cos(sun) + np.sin(low) * np.sin(sun) * np.cos(np.radians(around))))
    on = np.interp(np.abs(scattering), angles, around) * np.sign(scattering)
    return np.where(zenith <= 75.0, zenith, 75.0), np.where(zenith <= 75.0, azimuth, on)


@pytest.mark.parametrize("how", ["azimuths", "scattering angles", "scattering angles by their name"])
def test_a_hybrid_scan_leaves_the_sun_across_and_goes_around_below(tmp_path, how):
    suns = [float(line.split(",")[6]) for line in scan()]
    views = [rotated(np.array(AWAY), sun) for sun in suns]
    labels = AWAY if "scattering" in how else [round(a, 3) for a in views[0][1]]
    rows = [row(n, labels, f, "Hybrid", light=radiance(AWAY, f)) for n, f in enumerate(FILTERS)]
    if "name" not in how:
        rows = [",".join([line, *(f"{abs(a):.3f}" for a in AWAY)]) for line in rows]
    lines = aeronet(tmp_path / "scan.hyb", rows, labels).read_text().splitlines()
    if "name" in how:
        lines[7] = lines[7].replace("Radiance_for_Azimuth_Angle", "Radiance_for_Scattering_Angle")
    else:
        lines[7] += ",Scattering_Angle_for_Nominal_Angle(Degrees)" + "," * (len(AWAY) - 1)
        lines[8] += "," + ",".join(f"{a:.3f}" for a in labels)
    (tmp_path / "scan.hyb").write_text("\n".join(lines) + "\n")
    sky = read(tmp_path / "scan.hyb")
    assert sky.instrument.endswith("hybrid scan") and said(
        sky, f"hybrid scan taken as {how.removesuffix(' by their name')}"
    )
    zenith, azimuth = (np.degrees(v[0]) for v in sky.views)
    around = np.remainder(azimuth - np.degrees(sky.sun_azimuth) + 180.0, 360.0) - 180.0
    # by increasing wavelength the wheel goes back
    for w, (down, turned) in enumerate(views[::-1]):
        if how == "azimuths" and w < 3:
            # azimuths are those of the first filter: later ones stand as far round, not as far from the sun
            continue
        np.testing.assert_allclose(zenith[:, w], down[1:], atol=2e-3)
        np.testing.assert_allclose(around[:, w], turned[1:], atol=2e-3)


def test_a_hybrid_scan_has_no_view_so_far_from_a_high_sun(tmp_path):
    rows = [line.replace("Almucantar", "Hybrid") for line in scan()]
    lines = aeronet(tmp_path / "scan.hyb", rows).read_text().replace("Radiance_for_Azimuth", "Radiance_for_Scattering")
    (tmp_path / "scan.hyb").write_text(lines)
    with pytest.raises(ValueError, match=r"^scan\.hyb: row 10: a hybrid scan has no view at some of these scattering"):
        read(tmp_path / "scan.hyb")


# the beam beside it


def test_optical_depths_of_the_same_site_are_taken_along(tmp_path):
    optical_depths(tmp_path / "a.lev15", change=0.018)
    optical_depths(tmp_path / "b.lev20", site="Elsewhere")
    sky = read(aeronet(tmp_path / "scan.alm", scan()))
    # the sweep of 440 nm begins 252 s after the beginning: 432 of 540 s after the first depth
    assert sky.aerosol_optical_depth is not None and sky.aerosol_optical_depth_sigma is not None
    assert sky.aerosol_optical_depth[0, 0] == pytest.approx(0.48 + 0.018 * 432.0 / 540.0, abs=1e-6)
    assert sky.aerosol_optical_depth[0, 3] == pytest.approx(0.14 + 0.018 * 180.0 / 540.0, abs=1e-6)
    np.testing.assert_allclose(sky.aerosol_optical_depth_sigma, np.hypot(0.01, 0.009), rtol=1e-6)
    assert sky.ozone_du == 310.0 and said(sky, "ozone 310 DU from a.lev15")
    assert said(sky, "aerosol optical depths of a.lev15 within 30 minutes taken along: 4 of 4")
    # the better level stands
    optical_depths(tmp_path / "c.lev20")
    again = read(tmp_path / "scan.alm")
    assert again.aerosol_optical_depth is not None
    np.testing.assert_allclose(again.aerosol_optical_depth[0], sorted(DEPTHS.values(), reverse=True), atol=1e-6)
    write_sky(again, tmp_path / "sky.nc")
    np.testing.assert_allclose(read(tmp_path / "sky.nc").aerosol_optical_depth, again.aerosol_optical_depth)


def test_optical_depths_that_tell_nothing_of_a_scan(tmp_path):
    aeronet(tmp_path / "scan.alm", scan())
    optical_depths(tmp_path / "a.lev15", minutes=(-90.0, 60.0))
    sky = read(tmp_path / "scan.alm")
    assert sky.aerosol_optical_depth is None and said(sky, "a.lev15 beside it has no optical depth within 30 minutes")
    optical_depths(tmp_path / "a.lev15", columns=(870, 440))
    sky = read(tmp_path / "scan.alm")
    np.testing.assert_array_equal(np.isfinite(sky.aerosol_optical_depth[0]), [True, False, True, False])
    # what is no such file is none of ours
    (tmp_path / "a.lev15").write_text("no table\n")
    assert read(tmp_path / "scan.alm").aerosol_optical_depth is None
    with pytest.raises(ValueError, match=r"b\.lev15: found aerosol optical depths without a sky: expected a sky scan"):
        read(optical_depths(tmp_path / "b.lev15"))


# ARM's photometer


def test_an_almucantar_in_netcdf(tmp_path):
    sky = read(csphot(tmp_path / "csphot.nc"))
    same = read(aeronet(tmp_path / "scan.alm", scan()))
    assert sky.instrument == "ARM csphot photometer: almucantar"
    for name in ("radiance", "view_zenith_by_wavelength", "view_azimuth_by_wavelength", "sun_zenith", "sun_azimuth"):
        np.testing.assert_allclose(getattr(sky, name), getattr(same, name), rtol=1e-5)
    assert (sky.latitude_deg, sky.altitude_m, sky.time[0]) == (40.0, 120.0, same.time[0])
    assert said(sky, "radiance converted from microWatt/(cm^2 * nm * ster)") and said(sky, "4 of 60 samples missing")


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"units": "counts"}, ["variable `alm_rad`", "found 'counts'"]),
        ({"drop": ["zenith"]}, ["expected a variable `zenith`, the sun's"]),
        ({"drop": ["azimuth"]}, ["variable `azimuth`: expected angles from the sun"]),
        ({"wavelength": ("time", np.ones(4), {"units": "eV"})}, ["variable `wavelength`", "found 'eV'"]),
        ({"wavelength": ("time", np.full(4, np.nan), {"units": "um"})}, ["expected rows with a time, a wavelength"]),
    ],
)
def test_a_photometers_netcdf_that_cannot_be_understood(tmp_path, changes, parts):
    with pytest.raises(ValueError, match=r"^csphot\.nc: ") as caught:
        read(csphot(tmp_path / "csphot.nc", **changes))
    assert all(part in str(caught.value) for part in parts), caught.value


def test_samples_without_an_azimuth_and_variables_without_use_are_named(tmp_path):
    import xarray

    with xarray.open_dataset(csphot(tmp_path / "csphot.nc"), engine="h5netcdf") as data:
        data = data.load().drop_encoding()
    azimuth = data["azimuth"].values.copy()
    azimuth[3] = np.nan
    data.assign_coords(azimuth=azimuth).assign(gain=("time", np.ones(4))).to_netcdf(
        tmp_path / "other.nc", engine="h5netcdf"
    )
    sky = read(tmp_path / "other.nc")
    assert said(sky, "4 samples have no azimuth: left out") and said(sky, "variables not used: gain")
    assert sky.radiance.shape == (1, 13, 4)


# sky scanners


def scanner(path, values, units="# units: cd m-2", times=("2024-06-21T11:00:00", "2024-06-21T11:15:00"), station=True):
    place = ["# latitude: 51.5", "# longitude: -0.1"] if station else []
    rows = [",".join([time, *(f"{v:.6g}" for v in values)]) for time in times]
    names = ",".join(["time", *map(str, range(1, 146))])
    path.write_text("\n".join([*place, *filter(None, [units]), names, *rows]) + "\n")
    return path


@pytest.mark.parametrize("back", [False, True])
@pytest.mark.parametrize(("units", "scale"), [("# units: cd m-2", 1.0), ("# units: kcd/m2", 1e-3)])
def test_the_patches_of_a_scanner_are_luminances(tmp_path, back, units, scale):
    values = patches()
    sky = read(scanner(tmp_path / "scan.csv", scale * (boustrophedon(values) if back else values), units))
    assert sky.radiance.shape == (2, 145, 1) and sky.response is not None and sky.response.by_unit
    np.testing.assert_allclose(sky.radiance[0, :, 0], values, rtol=1e-5)
    assert sky.instrument == "sky scanner, 145 patches" and sky.one_pattern
    assert said(sky, "goes back" if back else "all bands of patches taken clockwise from north")
    assert np.degrees(sky.view_zenith[0, [0, 30, 144]]) == pytest.approx([84.0, 72.0, 0.0])
    # the sun by time and place, London before noon
    assert np.degrees(sky.sun_zenith[0]) == pytest.approx(30.5, abs=0.2)
    write_sky(sky, tmp_path / "sky.csv")
    np.testing.assert_allclose(read(tmp_path / "sky.csv").radiance, sky.radiance)


def test_what_a_scanner_leaves_out_is_said(tmp_path):
    values = patches()
    values[7] = -999.0
    sky = read(scanner(tmp_path / "scan.csv", values, "", ("2024/06/21 12:00",)), utc_offset=1)
    assert sky.time == [np.datetime64("2024-06-21T11:00")] and said(sky, "local time taken as UTC+1 h")
    assert said(sky, "luminance taken to be in cd m-2, the file does not say") and sky.masked == {"missing": 1}
    sky = read(scanner(tmp_path / "dim.csv", 1e-3 * patches(), ""))
    assert said(sky, "is this kcd m-2?") and said(sky, "times taken as UTC: give the offset of local time")


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        (lambda good: good.replace("cd m-2", "lux"), ["expected units cd m-2 of luminance, found 'lux'"]),
        (lambda good: good + "2024-06-21T11:30:00,1,2,3\n", ["row 7", "a time and 145 luminances, found 4 cells"]),
        (lambda good: good + "2024-06-21T11:30:00" + ",bright" * 145 + "\n", ["row 7", "a luminance, found 'bright'"]),
        (lambda good: good + "2024-06-99" + ",100" * 145 + "\n", ["row 7", "expected a time such as"]),
        (lambda good: good.replace("# latitude: 51.5\n", ""), ["to compute them; found no latitude"]),
    ],
)
def test_a_scanners_table_that_cannot_be_understood(tmp_path, text, parts):
    good = scanner(tmp_path / "scan.csv", patches()).read_text()
    (tmp_path / "scan.csv").write_text(text(good))
    with pytest.raises(ValueError, match=r"^scan\.csv: ") as caught:
        read(tmp_path / "scan.csv")
    assert all(part in str(caught.value) for part in parts), caught.value


def test_haze_comes_back_from_the_luminances_of_a_scanner(x64, tmp_path):
    from skyfit.light import earth_sun_factor, extraterrestrial_irradiance
    from skyfit.measured import solar_position
    from skyfit.measured.readers.scanner import tregenza

    solver, spectrum = skyfit.SingleScattering.draft("flat"), np.arange(380.0, 781.0, 10.0)
    time = np.array(["2024-06-21T09:00:00"], "datetime64[ns]")
    sun = [float(angle[0]) for angle in solar_position(time, 51.5, -0.1)]
    light = np.asarray(extraterrestrial_irradiance(spectrum), float) * float(earth_sun_factor(np.float64(173)))
    scene = skyfit.Scene(*sun, skyfit.Directions(*np.radians(tregenza())), spectrum, light)
    haze = skyfit.Aerosol(0.2, 1.3, 0.95, 0.0, skyfit.HenyeyGreenstein(0.7))
    air = skyfit.Atmosphere(skyfit.Rayleigh(101325.0), haze, skyfit.Ozone(300.0), skyfit.Ground(0.1))
    values = np.asarray(skyfit.xyz(solver.radiance(air, scene), spectrum), float)[:, 1]
    sky = read(scanner(tmp_path / "scan.csv", boustrophedon(values), "", ("2024-06-21T09:00:00",)))
    assert said(sky, "goes back")
    fit = skyfit.invert(sky, ("aerosol_optical_depth", "asymmetry"), solver)
    assert fit.values[0] == pytest.approx([0.2, 0.7], rel=0.02) and fit.result == ("successful",)


# what others have simulated


@pytest.mark.parametrize("file", ["simulated.alm", "simulated_csphotalm.nc"])
def test_the_shared_files_are_read(shared, file):
    path = shared / "formats" / file
    if not path.is_file():
        pytest.skip("the simulated files of instruments are absent")
    sky = read(path)
    np.testing.assert_allclose(sky.wavelength_nm, [440.2, 674.9, 870.1, 1020.3])
    assert sky.radiance.shape == (1, 60, 4) and sky.usable.all()
    if file.endswith("alm"):
        assert sky.aerosol_optical_depth is not None
        truth = np.array([[0.4824, 0.2556, 0.1763, 0.1446]])
        np.testing.assert_allclose(sky.aerosol_optical_depth, truth, atol=0.01)


def test_a_tidy_table_is_known_under_any_name(tmp_path):
    (tmp_path / "sky.txt").write_text(
        "view_zenith,view_azimuth,wavelength,radiance,sun_zenith,sun_azimuth\n10,20,500,0.1,30,40\n"
    )
    assert skyfit.read(tmp_path / "sky.txt").radiance.shape == (1, 1, 1)
