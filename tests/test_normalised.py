"""Radiance that a file gives as a share of the sun's irradiance."""

import numpy as np
import pytest
import xarray

import skyfit
from skyfit.light import earth_sun_factor, extraterrestrial_irradiance
from skyfit.measured import read, write_sky


WAVELENGTHS = np.array([440.0, 675.0, 1020.0, 1640.0])
SHARES = np.array([0.09, 0.05, 0.02, 0.01])  # pi L / E0
SUN = np.asarray(extraterrestrial_irradiance(WAVELENGTHS[:3], 10.0), float)
# of 21 June
FACTOR = float(earth_sun_factor(np.float64(173)))


def written(folder, suffix, name="normalized_radiance", units="1", scale=1.0, day="2024-06-21T10:00:00Z"):
    path = folder / f"sky{suffix}"
    values = scale * SHARES
    if suffix == ".csv":
        rows = [f"{day},30,20,{w},{v},{0.1 * v},40,120" for w, v in zip(WAVELENGTHS, values, strict=True)]
        header = f"time,view_zenith,view_azimuth,wavelength,{name},sigma,sun_zenith,sun_azimuth"
        comments = ["# fwhm: 10 nm", *([f"# units: {units}"] if units else [])]
        path.write_text("\n".join([*comments, header, *rows]) + "\n")
        return path
    about = {"units": units} if units else {}
    whole = ("time", "direction", "wavelength")
    data = xarray.Dataset(
        {
            name: (whole, values[None, None], about),
            "sigma": (whole, 0.1 * values[None, None], about),
            "sun_zenith": ("time", [40.0]),
            "sun_azimuth": ("time", [120.0]),
        },
        {
            "view_zenith": ("direction", [30.0]),
            "view_azimuth": ("direction", [20.0]),
            "wavelength": WAVELENGTHS,
            "time": np.array([day.removesuffix("Z")], "datetime64[ns]"),
        },
        {"fwhm_nm": 10.0},
    )
    data.to_netcdf(path, engine="h5netcdf")
    return path


@pytest.mark.parametrize("suffix", [".csv", ".nc"])
@pytest.mark.parametrize(
    ("name", "units", "scale"),
    [
        ("normalized_radiance", "1", 1.0),
        ("normalised_radiance", "", 1.0),
        ("normalized_radiance", "sr-1", 1.0 / np.pi),
        ("radiance", "sr-1", 1.0 / np.pi),
        ("radiance", "1/sr", 1.0 / np.pi),
    ],
)
def test_shares_of_the_suns_irradiance_are_radiances(tmp_path, suffix, name, units, scale):
    sky = read(written(tmp_path, suffix, name, units, scale))
    expected = SHARES[:3] * SUN * FACTOR / np.pi
    np.testing.assert_allclose(sky.radiance[0, 0, :3], expected, rtol=1e-6)
    np.testing.assert_allclose(sky.sigma[0, 0, :3], 0.1 * expected, rtol=1e-6)
    # beyond the table of the sun there is no telling
    assert sky.usable[0, 0].tolist() == [True, True, True, False] and sky.masked == {"beyond the sun's table": 1}
    assert sky.notes == ("normalised radiance times the sun's irradiance of ASTM G173 on that day",)
    assert sky.at(0) is sky and sky.at_times([0, 0]).masked == {"beyond the sun's table": 2}
    write_sky(sky, tmp_path / f"again{suffix}")
    again = read(tmp_path / f"again{suffix}")
    np.testing.assert_allclose(again.radiance[0, 0, :3], expected, rtol=1e-6)
    assert again.notes == sky.notes


@pytest.mark.parametrize("suffix", [".csv", ".nc"])
def test_a_normalised_radiance_in_watts_is_none(tmp_path, suffix):
    with pytest.raises(
        ValueError, match=rf"^sky\{suffix}: .*expected units 1 \(pi L / E0\) or sr-1 .*'W m-2 sr-1 nm-1'"
    ):
        read(written(tmp_path, suffix, units="W m-2 sr-1 nm-1"))


def test_a_file_of_both_is_read_by_its_radiance(tmp_path):
    path = written(tmp_path, ".csv", "radiance", "W m-2 sr-1 nm-1")
    lines = path.read_text().splitlines()
    lines[2:] = [lines[2] + ",normalized_radiance", *(line + ",0.1" for line in lines[3:])]
    path.write_text("\n".join(lines) + "\n")
    sky = skyfit.read(path)
    np.testing.assert_allclose(sky.radiance[0, 0], SHARES)
    assert sky.notes == ("columns not used: normalized_radiance",)
