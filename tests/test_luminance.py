"""Luminance and other channels in units of their own: read as such, without a response and with one."""

import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from made_skies import by_hand, SOLVER

import skyfit
from skyfit.measured import read, read_response, write_sky
from skyfit.measured.units import luminance_factor


HEADER = "view_zenith,view_azimuth,wavelength,radiance,sun_zenith,sun_azimuth"
DIRECTIONS = 12


def luminance():
    """Of a made sky, cd m^-2, `[direction]`, and its directions in degrees."""
    spectrum = np.arange(380.0, 781.0, 10.0)
    light = jnp.asarray(by_hand(SOLVER, spectrum, directions=DIRECTIONS, fwhm_nm=None))
    view = skyfit.hemisphere(DIRECTIONS)
    return np.asarray(skyfit.xyz(light, spectrum))[:, 1], *np.degrees([view.zenith, view.azimuth])


def written(folder, suffix, units, scale=1.0, channels=(550.0,)):
    values, zenith, azimuth = luminance()
    values = scale * values
    path = folder / f"sky{suffix}"
    if suffix == ".csv":
        rows = [
            f"{z},{a},{w},{v},51.566,57.2958" for v, z, a in zip(values, zenith, azimuth, strict=True) for w in channels
        ]
        path.write_text("\n".join([f"# units: {units}", HEADER, *rows]) + "\n")
        return path
    data = xarray.Dataset(
        {
            "radiance": (("direction", "wavelength"), np.tile(values[:, None], len(channels)), {"units": units}),
            "sun_zenith": 51.566,
            "sun_azimuth": 57.2958,
        },
        {
            "view_zenith": ("direction", zenith),
            "view_azimuth": ("direction", azimuth),
            "wavelength": ("wavelength", list(channels)),
        },
    )
    data.to_netcdf(path, engine="h5netcdf")
    return path


@pytest.mark.parametrize(
    ("units", "factor"),
    [
        ("cd m-2", 1.0), ("cd/m2", 1.0), ("cd/m^2", 1.0), ("cd m^-2", 1.0), ("cd m⁻²", 1.0), ("cd·m-2", 1.0),
        ("candela/m^2", 1.0), ("nit", 1.0), ("nits", 1.0), ("kcd m-2", 1e3), ("kcd/m2", 1e3), ("mcd m-2", 1e-3),
        ("cd", None), ("lm m-2", None), ("W m-2 sr-1 nm-1", None), ("", None), ("lux", None),
    ],
)  # fmt: skip
def test_units_of_luminance(units, factor):
    assert luminance_factor(units) == factor


@pytest.mark.parametrize("suffix", [".csv", ".nc"])
@pytest.mark.parametrize(("units", "scale"), [("cd m-2", 1.0), ("kcd/m2", 1e-3)])
def test_luminance_is_what_the_eye_sees(tmp_path, suffix, units, scale):
    sky = read(written(tmp_path, suffix, units, scale))
    values, *_ = luminance()
    np.testing.assert_allclose(sky.radiance[0, :, 0], values, rtol=1e-6)
    assert sky.response is not None and sky.response.by_unit and sky.response.names == ("Y",)
    np.testing.assert_array_equal(sky.response.weight, skyfit.Response.xyz().weight[1:2])
    assert sky.notes == (() if scale == 1.0 else (f"radiance converted from {units} to cd m-2",))
    # it is written in its unit, and read again
    for again in ("again.csv", "again.nc"):
        write_sky(sky, tmp_path / again)
        back = read(tmp_path / again)
        np.testing.assert_allclose(back.radiance, sky.radiance, rtol=1e-12)
        assert back.response is not None and back.response.same_as(sky.response) and back.response.by_unit


@pytest.mark.parametrize("suffix", [".csv", ".nc"])
def test_a_response_that_is_given_stands_before_that_of_the_unit(tmp_path, suffix):
    path = written(tmp_path, suffix, "cd m-2")
    grid = np.arange(400.0, 701.0, 5.0)
    meter = skyfit.Response(grid, 683.0 * np.exp(-0.5 * ((grid - 560.0) / 45.0) ** 2), ("meter",))
    for sky in (read(path, response=meter), read(path).with_response(meter)):
        assert sky.response is not None and sky.response.same_as(meter)
    # that of a file or of a user is no guess
    with pytest.raises(ValueError, match="`response` must be left out or the sky's own"):
        read(path, response=meter).with_response(skyfit.Response.eye())
    with pytest.raises(ValueError, match="must have a channel for each of the sky's 1 wavelengths, got 3"):
        read(path, response=skyfit.Response.xyz())


@pytest.mark.parametrize("suffix", [".csv", ".nc"])
@pytest.mark.parametrize("units", ["counts", "cd m-2", "uV"])
def test_channels_have_the_unit_of_their_response(tmp_path, suffix, units):
    path = written(tmp_path, suffix, units, channels=(450.0, 550.0, 600.0))
    sky = read(path, response=skyfit.Response.xyz())
    np.testing.assert_allclose(sky.radiance[0, :, 1], luminance()[0], rtol=1e-6)
    told = "units cd m-2 of 3 wavelengths: expected one, of luminance, or a response"
    with pytest.raises(
        ValueError, match=told if units == "cd m-2" else f"found '{units}'; of channels give their resp"
    ):
        read(path)


def test_a_response_that_does_not_fit_is_refused_by_the_files_name(tmp_path):
    path = written(tmp_path, ".csv", "cd m-2")
    with pytest.raises(ValueError, match=r"sky\.csv: `response` must have a channel for each"):
        read(path, response=skyfit.Response.linear_srgb())


def test_haze_comes_back_from_luminance_alone(x64, tmp_path):
    """As from the same readings with a response of one's own."""
    path = written(tmp_path, ".csv", "cd m-2")
    start = skyfit.retrieve.with_values(
        skyfit.retrieve.start_model((), 101325.0), ("angstrom_exponent", "asymmetry"), [1.1, 0.65]
    )
    exact = skyfit.NoiseModel(model_error=0.0, calibration=0.0)
    fit = skyfit.invert(read(path), ("aerosol_optical_depth",), SOLVER, start, measurement=exact)
    assert fit.values[0, 0] == pytest.approx(0.2, rel=2e-3)


@pytest.mark.parametrize("file", ["lum.csv", "lum_cd.nc"])
def test_the_faulty_files_are_read(shared, file):
    folder = shared / "faults"
    if not folder.is_dir():
        pytest.skip("the faulty files are absent")
    own = read(folder / file)
    given = read(folder / file, response=read_response(folder / "vlambda.csv"))
    assert own.usable.all() and own.response is not None and given.response is not None
    assert own.response.names == ("Y",) and given.response.names == ("y",)
    assert own.response.weight.sum() == pytest.approx(given.response.weight.sum(), rel=1e-4)
