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


COLOURS = {"x": 0.28, "y": 0.30}
XYZ = 0.28 / 0.30, 1.0, 0.42 / 0.30


def coloured(folder, suffix, columns, units="cd m-2", scale=1.0, **more):
    """A file of luminance, with columns beside it; `more` are columns of the directions."""
    values, zenith, azimuth = luminance()
    table = {"view_zenith": zenith, "view_azimuth": azimuth, "luminance": scale * values.astype(float)}
    table |= {name: np.full(DIRECTIONS, value) for name, value in columns.items()} | more
    path = folder / f"sky{suffix}"
    if suffix == ".csv":
        comments = [f"# units: {units}"] * bool(units)
        rows = [",".join(map(str, row)) + ",51.566,57.2958" for row in zip(*table.values(), strict=True)]
        path.write_text("\n".join([*comments, ",".join([*table, "sun_zenith", "sun_azimuth"]), *rows]) + "\n")
        return path
    data = xarray.Dataset({name: ("direction", column) for name, column in table.items()})
    data = data.assign(sun_zenith=51.566, sun_azimuth=57.2958)
    if units:
        data["luminance"].attrs["units"] = units
    data.to_netcdf(path, engine="h5netcdf")
    return path


@pytest.mark.parametrize("suffix", [".csv", ".nc"])
@pytest.mark.parametrize(("units", "scale"), [("cd m-2", 1.0), ("kcd/m2", 1e-3)])
def test_a_column_of_luminance_is_what_the_eye_sees(tmp_path, suffix, units, scale):
    sky = read(coloured(tmp_path, suffix, {}, units, scale))
    np.testing.assert_allclose(sky.radiance[0, :, 0], luminance()[0], rtol=1e-6)
    assert sky.response is not None and sky.response.by_unit and sky.response.names == ("Y",)
    assert sky.wavelength_nm == pytest.approx(sky.response.centre_nm)
    assert len(sky.notes) == (0 if scale == 1.0 else 1) and all("converted" in note for note in sky.notes)
    meter = skyfit.Response(np.arange(400.0, 701.0, 50.0), np.ones(7), ("meter",))
    given = read(coloured(tmp_path, suffix, {}), response=meter).response
    assert given is not None and given.same_as(meter)


@pytest.mark.parametrize("suffix", [".csv", ".nc"])
@pytest.mark.parametrize("names", [("x", "y"), ("cie_x", "cie_y"), ("chromaticity_x", "chromaticity_y")])
def test_luminance_and_chromaticity_are_x_y_and_z(tmp_path, suffix, names):
    columns = dict(zip(names, COLOURS.values(), strict=True)) | {"sigma": 20.0}
    sky = read(coloured(tmp_path, suffix, columns, "kcd m-2", 1e-3))
    assert sky.response is not None and sky.response.same_as(skyfit.Response.xyz())
    assert sky.response.names == ("X", "Y", "Z")
    np.testing.assert_allclose(sky.radiance[0], luminance()[0][:, None] * XYZ, rtol=1e-6)
    assert sky.sigma is not None
    np.testing.assert_allclose(sky.sigma[0], np.tile(2e4 * np.array(XYZ), (DIRECTIONS, 1)), rtol=1e-9)
    assert sky.notes == ("luminance converted from kcd m-2 to cd m-2",)
    # what is known already may be said again
    assert read(tmp_path / f"sky{suffix}", response=skyfit.Response.xyz()).response is not None
    write_sky(sky, tmp_path / "again.nc")
    np.testing.assert_allclose(read(tmp_path / "again.nc").radiance, sky.radiance, rtol=1e-12)


@pytest.mark.parametrize("suffix", [".csv", ".nc"])
def test_a_chromaticity_of_no_colour_leaves_luminance(tmp_path, suffix):
    x = np.full(DIRECTIONS, 0.28)
    x[:4] = 0.9, -0.1, np.nan, 0.28
    y = np.full(DIRECTIONS, 0.30)
    y[3] = 0.0
    sky = read(coloured(tmp_path, suffix, {}, x=x, y=y))
    assert sky.usable[0, :, 1].all()
    for channel in (0, 2):
        np.testing.assert_array_equal(sky.usable[0, :, channel], np.arange(DIRECTIONS) >= 4)
    assert sky.notes == ("3 chromaticities are of no colour: X and Z left out there",)
    assert sky.masked == {"missing": 8}


@pytest.mark.parametrize("suffix", [".csv", ".nc"])
def test_what_is_no_luminance_is_refused_and_half_a_chromaticity_named(tmp_path, suffix):
    with pytest.raises(ValueError, match=rf"sky\{suffix}: .*expected units cd m-2 of `luminance`, found 'W m-2'"):
        read(coloured(tmp_path, suffix, {}, "W m-2"))
    told = read(coloured(tmp_path, suffix, {"x": 0.3})).notes
    assert told == (f"{'columns' if suffix == '.csv' else 'variables'} not used: x",)
    # a table without a word is in cd m-2, as one of radiance is in W m-2 sr-1 nm-1
    if suffix == ".nc":
        with pytest.raises(ValueError, match=r"sky\.nc: variable `luminance`: expected units cd m-2, found none"):
            read(coloured(tmp_path, suffix, {}, ""))
    else:
        assert read(coloured(tmp_path, suffix, {}, "")).notes == ()


def test_luminance_beside_radiance_is_named(tmp_path):
    path = written(tmp_path, ".csv", "W m-2 sr-1 nm-1")
    path.write_text(path.read_text().replace(HEADER, f"{HEADER},luminance").replace(",57.2958\n", ",57.2958,900\n"))
    sky = read(path)
    assert sky.response is None and sky.notes == ("columns not used: luminance",)
    path = coloured(tmp_path, ".csv", {}, wavelength=np.arange(500.0, 500.0 + DIRECTIONS))
    with pytest.raises(ValueError, match="column `wavelength`: expected one value with `luminance`"):
        read(path)


def test_haze_comes_back_from_luminance_and_colour(x64, tmp_path):
    """Of a made sky as its CIE x, y and luminance, with the exact values held elsewhere."""
    spectrum = np.arange(380.0, 781.0, 10.0)
    light = jnp.asarray(by_hand(SOLVER, spectrum, directions=DIRECTIONS, fwhm_nm=None))
    values = np.asarray(skyfit.xyz(light, spectrum), float)
    x, y = (values[:, place] / values.sum(axis=1) for place in (0, 1))
    path = coloured(tmp_path, ".csv", {}, x=x, y=y)
    start = skyfit.retrieve.with_values(skyfit.retrieve.start_model((), 101325.0), ("asymmetry",), [0.65])
    exact = skyfit.NoiseModel(model_error=0.0, calibration=0.0)
    fit = skyfit.invert(read(path), ("aerosol_optical_depth", "angstrom_exponent"), SOLVER, start, measurement=exact)
    assert fit.values[0] == pytest.approx([0.2, 1.1], rel=5e-3)
