"""`skyfit convert`: what was understood of a file, in a short report, and a sky that reads back."""

from dataclasses import replace

import numpy as np
import pytest
from instrument_files import aeronet, csphot, FILTERS, optical_depths, patches, scan
from test_luminance import written
from typer.testing import CliRunner

import skyfit
from skyfit.cli import app
from skyfit.cli.asked import free_of
from skyfit.measured import read
from skyfit.retrieve import LOBES_FREE, PARTICLE_FREE, usual_free


def converted(folder, file, *options, to="sky.nc"):
    """What the command prints, and the sky that it has written."""
    done = CliRunner().invoke(
        app, ["convert", str(file), "--to", str(folder / to), *map(str, options)], env={"COLUMNS": "80"}
    )
    assert done.exception is None, done.exception
    return done.output, read(folder / to)


def words(text: str) -> str:
    return " ".join(text.split())


def test_an_almucantar_with_its_beam(tmp_path):
    optical_depths(tmp_path / "a.lev15")
    printed, sky = converted(tmp_path, aeronet(tmp_path / "scan.alm", scan(filters=(1.6400, 0.9365, *FILTERS))))
    assert all(len(line) <= 80 for line in printed.splitlines() if not line.startswith("written: "))
    for part in (
        "scan.alm: AERONET photometer 7, Nowhere: almucantar",
        "station 40.0000 N, 5.0000 E, 120 m, pressure not told, ozone 310 DU",
        "times 1: 2024-06-21T06:33:30Z",
        "sun zenith 64.5 to 65.9 degrees, one for each wavelength",
        "wavelengths 6: 440.2, 674.9, 870.1, 936.5, 1020.3, 1640 nm, line shape 10 nm",
        "1640 nm beyond the sun's table, 300-1100 nm: kept in the file, left out of a fit",
        "936.5 nm in bands of oxygen and water vapour: kept in the file, left out of a fit",
        "views 14 directions, zenith 65.2 degrees; they follow the sun from one wavelength to the next",
        "samples 84 usable of 84, with the sigma of each, calibration 5.0%",
        "unit W m-2 sr-1 nm-1, spectral radiance",
        "beam aerosol optical depth, 4 of 6 times and wavelengths",
        "note: radiance converted from uW/cm^2/sr/nm to W m-2 sr-1 nm-1",
        "note: 6 of 90 samples missing, as the file says",
        f"written: {tmp_path / 'sky.nc'}",
    ):
        assert words(part) in words(printed), part
    whole = read(tmp_path / "scan.alm")
    for name in ("radiance", "sigma", "view_zenith_by_wavelength", "sun_azimuth", "aerosol_optical_depth"):
        np.testing.assert_allclose(getattr(sky, name), getattr(whole, name), rtol=1e-9)
    assert (sky.notes, sky.instrument, sky.calibration_sigma) == (whole.notes, whole.instrument, 0.05)


def test_other_files_and_what_the_user_knows(tmp_path):
    printed, sky = converted(tmp_path, csphot(tmp_path / "csphot.nc"), "--altitude", 300, "--fwhm", 8)
    assert "csphot.nc: ARM csphot photometer: almucantar" in printed and "300 m" in printed
    assert (sky.altitude_m, sky.fwhm_nm) == (300.0, 8.0)
    rows = [f"2024-06-21T{hour}:00:00," + ",".join(f"{v:.5g}" for v in patches()) for hour in (11, 12, 13)]
    (tmp_path / "patches.csv").write_text("\n".join(["# units: cd m-2", *rows]) + "\n")
    place = "--latitude", 51.5, "--longitude", -0.1
    printed, sky = converted(
        tmp_path, tmp_path / "patches.csv", *place, "--utc-offset", 1, "--times", "2..", to="sky.csv"
    )
    assert "2: 2024-06-21T11:00:00Z to 2024-06-21T12:00:00Z" in printed and "channels  Y" in printed
    assert "cd m-2, luminance" in printed and sky.radiance.shape == (2, 145, 1)
    printed, sky = converted(tmp_path, written(tmp_path, ".csv", "cd m-2"), to="other.nc")
    assert "place not told, altitude not told" in printed and "1, dates not told" in printed


@pytest.mark.parametrize(
    ("to", "said"), [("sky.txt", "`--to` must be a .nc or .csv"), ("none/sky.nc", "folder that is")]
)
def test_where_it_cannot_be_written(tmp_path, to, said):
    file = aeronet(tmp_path / "scan.alm", scan())
    done = CliRunner().invoke(app, ["convert", str(file), "--to", str(tmp_path / to)])
    assert isinstance(done.exception, ValueError) and said in str(done.exception)
    # views that move have no place in a table, and nothing is left behind
    done = CliRunner().invoke(app, ["convert", str(file), "--to", str(tmp_path / "sky.csv")])
    assert "write NetCDF" in str(done.exception) and not (tmp_path / "sky.csv").exists()


def test_what_is_free_where_nobody_says(tmp_path):
    """Of an instrument that follows the sun the pointing is held, unless it is asked for by its own name."""
    sky, still = read(aeronet(tmp_path / "scan.alm", scan())), read(written(tmp_path, ".csv", "cd m-2"))
    spheres = tuple(name for name in PARTICLE_FREE if not name.startswith("pointing_"))
    assert free_of(None, sky) == free_of("particles", sky) == spheres
    # two filters tell no sizes, and no luminance does
    assert free_of(None, read(aeronet(tmp_path / "few.alm", scan(filters=FILTERS[:2])))) == LOBES_FREE[:-2]
    assert free_of(None, still) == free_of("lobes", still) == LOBES_FREE
    assert free_of("turbidity,pointing_zenith", sky) == ("turbidity", "pointing_zenith")
    # what is known is not free, unless it is asked for by its own name
    known = {"fine_width": 0.4, "pointing_zenith": 0.0}
    kept = tuple(name for name in spheres if name != "fine_width")
    assert free_of(None, sky, known) == free_of("particles", sky, known) == kept
    assert free_of("particles", still, known) == tuple(name for name in PARTICLE_FREE if name not in known)
    assert "fine_width" in free_of("particles,fine_width", sky, known)


def test_a_sky_that_lobes_made_is_one_of_lobes():
    nm, view = np.array([440.0, 550.0, 870.0]), skyfit.hemisphere(4)
    for haze, names in ((skyfit.Aerosol(0.2), LOBES_FREE), (skyfit.TwoModeAerosol(0.2), PARTICLE_FREE)):
        air = skyfit.Atmosphere(skyfit.Rayleigh(), haze)
        sky = skyfit.Sky(
            radiance=np.ones((1, 4, 3)), sigma=None, usable=np.ones((1, 4, 3), bool),
            view_zenith=np.asarray(view.zenith), view_azimuth=np.asarray(view.azimuth), wavelength_nm=nm,
            sun_zenith=np.ones(1), sun_azimuth=np.ones(1), time=np.array(["NaT"], "datetime64[ns]"),
        )  # fmt: skip
        assert usual_free(sky) == PARTICLE_FREE
        assert usual_free(replace(sky, made_by={"atmosphere": skyfit.atmosphere.describe(air)})) == names
