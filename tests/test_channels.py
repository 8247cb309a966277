"""A response that travels with the samples: through files, fits and predictions; one rule of where it comes from."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray
from made_skies import as_sky, by_hand, EXACT, PLAIN

import skyfit
from skyfit.draw import plot
from skyfit.measured import LineShape
from skyfit.records import load, save, write_prediction
from skyfit.retrieve import predict, start_model, with_values


SOLVER = skyfit.SingleScattering.draft("flat")
FREE = ("turbidity", "asymmetry")
XYZ = skyfit.Response.xyz()


def bands():
    """Three bands of a photometer, the order of its wheel that of no wavelength."""
    grid = np.arange(430.0, 700.0, 5.0)
    weight = np.exp(-0.5 * ((grid - np.array([[670.0], [440.0], [550.0]])) / 6.0) ** 2)
    return skyfit.Response(grid, weight, ("red", "blue", "green"))


def sky_of(response=XYZ, seed=5, noise=0.01, **about):
    spectrum = by_hand(SOLVER, response.wavelength_nm, fwhm_nm=None)
    known = {"wavelength_nm": response.centre_nm, "response": response, "fwhm_nm": np.nan, "altitude_m": 0.0} | about
    return as_sky(spectrum @ response.weight.T, noise, seed, **known)


def start():
    return with_values(start_model(FREE, 101325.0), ("angstrom_exponent", "ground_albedo"), [1.1, 0.1])


def fitted(sky, **changes):
    return skyfit.invert(sky, FREE, SOLVER, start(), measurement=EXACT, **changes)


def test_a_line_shape_is_a_response_of_its_own_wavelengths():
    sky = as_sky(by_hand())
    assert isinstance(sky.seen, LineShape) and sky.seen.fwhm_nm == 6.0 and sky.seen.weight is None
    assert sky.seen.spectrum(sky.wavelength_nm) is sky.wavelength_nm
    through = skyfit.light.extraterrestrial_irradiance(PLAIN, 6.0)
    np.testing.assert_array_equal(sky.seen.sunlight(PLAIN), through)
    for none in (np.nan, 0.0):
        plain = skyfit.light.extraterrestrial_irradiance(PLAIN)
        np.testing.assert_array_equal(LineShape(none).sunlight(PLAIN), plain)
    colours = sky_of()
    assert colours.seen is colours.response
    assert colours.seen.spectrum(colours.wavelength_nm) is XYZ.wavelength_nm


def test_names_and_parts_of_a_response():
    plain = skyfit.Response(XYZ.wavelength_nm, XYZ.weight)
    assert plain.names == tuple(f"{centre:.4g} nm" for centre in XYZ.centre_nm)
    turned = XYZ.take([2, 0])
    assert turned.names == ("Z", "X")
    np.testing.assert_array_equal(turned.weight, XYZ.weight[[2, 0]])
    assert XYZ.same_as(plain) and not XYZ.same_as(turned) and not XYZ.same_as(None)
    with pytest.raises(ValueError, match="`names` must hold one for each of 3 channels, got a, b"):
        skyfit.Response(XYZ.wavelength_nm, XYZ.weight, ("a", "b"))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"wavelength_nm": [500.0, 600.0, 500.0]}, "`wavelength_nm` must differ between channels"),
        ({"wavelength_nm": [500.0, np.nan, 550.0]}, "`wavelength_nm` must differ between channels, got values that"),
        ({"fwhm_nm": 6.0}, "`fwhm_nm` must be NaN with a `response`, which says how the instrument sees, got 6"),
        (
            {"response": bands().take([0, 1])},
            "`response` must have a channel for each of the sky's 3 wavelengths, got 2",
        ),
        ({"response": None}, "`wavelength_nm` must increase"),
    ],
)
def test_channels_that_no_sky_has(changes, said):
    with pytest.raises(ValueError, match=said):
        replace(sky_of(), **{k: np.array(v) if isinstance(v, list) else v for k, v in changes.items()})


def test_a_response_that_is_given_is_put_in_the_order_of_the_sky_or_is_its_own():
    sky = sky_of(bands())
    order = np.argsort(sky.wavelength_nm)
    bare = replace(
        sky, response=None, wavelength_nm=sky.wavelength_nm[order], radiance=sky.radiance[..., order], sigma=None
    )
    given = bare.with_response(bands())
    assert given.response.names == ("blue", "green", "red")
    np.testing.assert_array_equal(given.radiance, bare.radiance)
    np.testing.assert_array_equal(given.response.weight, bands().weight[order])
    assert bare.with_response(None) is bare and sky.with_response(None) is sky
    assert sky.with_response(bands()) is sky
    for wrong in (XYZ, bands().take([1, 0, 2])):
        with pytest.raises(ValueError, match="`response` must be left out or the sky's own, .* red, blue, green, got"):
            fitted(sky, response=wrong)
    with pytest.raises(ValueError, match="`fwhm_nm` must be left out with a `response`"):
        fitted(sky, fwhm_nm=5.0)
    with pytest.raises(ValueError, match="`fwhm_nm` must be NaN with a `response`"):
        fitted(replace(bare, fwhm_nm=6.0), response=bands())


def test_channels_are_selected_by_what_they_are_called():
    sky = sky_of(bands(), direct_irradiance=np.array([[0.1, 0.2, 0.3]]))
    part = sky.select(sky.wavelength_nm[[2, 0]])
    assert part.response.names == ("green", "red")
    np.testing.assert_array_equal(part.radiance, sky.radiance[..., [2, 0]])
    np.testing.assert_array_equal(part.direct_irradiance, [[0.3, 0.1]])
    for wanted in ([500.0], sky.wavelength_nm[[0, 0]]):
        with pytest.raises(ValueError, match="`wavelength_nm` must name channels once each"):
            sky.select(np.array(wanted))


@pytest.mark.parametrize("response", [XYZ, skyfit.Response.linear_srgb(), bands()], ids=["xyz", "srgb", "bands"])
def test_a_sky_of_channels_reads_back(tmp_path, response):
    sky = sky_of(response, direct_irradiance=np.full((1, 3), 7.0), direct_sigma=np.full((1, 3), 0.1))
    # a colour that no screen shows
    odd = sky.radiance.copy()
    odd[0, 3, 0] *= -0.01
    sky = replace(sky, radiance=odd, usable=sky.usable & ((odd >= 0.0) | np.any(response.weight < 0.0)))
    skyfit.write_sky(sky, tmp_path / "sky.nc")
    with xarray.open_dataset(tmp_path / "sky.nc") as data:
        assert data["radiance"].dims == ("time", "direction", "channel") and "units" not in data["radiance"].attrs
        assert data["response"].dims == ("channel", "spectrum")
        assert tuple(data["channel"].values) == response.names
    back = skyfit.read(tmp_path / "sky.nc")
    assert back.response.names == response.names and back.response.same_as(response)
    for name in ("radiance", "sigma", "usable", "wavelength_nm", "direct_irradiance", "direct_sigma", "sun_zenith"):
        np.testing.assert_allclose(getattr(back, name), getattr(sky, name), rtol=1e-12, err_msg=name)
    with pytest.raises(ValueError, match=r"sky\.csv: a CSV has no place for the response"):
        skyfit.write_sky(sky, tmp_path / "sky.csv")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.drop_vars("spectrum"), "`response`: expected dimensions channel, spectrum.* no `spectrum`"),
        (lambda d: d.rename(spectrum="fine"), "found channel, fine, no `spectrum`"),
        (lambda d: d.assign(response=-0.0 * d["response"]), "`response`: `weight` must not be 0 everywhere"),
        (lambda d: d.assign_coords(spectrum=d["spectrum"].values[::-1]), "`wavelength_nm` increase"),
        (lambda d: d.assign_coords(wavelength=("channel", [500.0, 600.0, 500.0])), "expected different values"),
        (lambda d: d.assign_attrs(fwhm_nm=5.0), "`fwhm_nm` must be NaN with a `response`"),
    ],
)
def test_responses_in_a_file_that_make_no_sense(tmp_path, change, said):
    skyfit.write_sky(sky_of(), tmp_path / "sky.nc")
    with xarray.open_dataset(tmp_path / "sky.nc") as data:
        changed = change(data.load())
    changed.to_netcdf(tmp_path / "bad.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match=said) as caught:
        skyfit.read(tmp_path / "bad.nc")
    assert str(caught.value).startswith("bad.nc: ") and "\n" not in str(caught.value)


def test_a_response_goes_from_the_file_to_the_prediction(x64, tmp_path):
    response = bands()
    skyfit.write_sky(sky_of(response, time=np.array(["NaT"], "datetime64[ns]")), tmp_path / "sky.nc")
    sky = skyfit.read(tmp_path / "sky.nc")
    fit = fitted(sky)
    assert fit.result == ("successful",) and fit.response is sky.response
    truth = np.array([float(skyfit.optical_depth_to_turbidity(0.2)), 0.65])
    assert np.all(np.abs(fit.values[0] - truth) < 3.5 * fit.sigma[0])
    for name in ("fit.json", "fit.nc"):
        save(fit, tmp_path / name)
    loaded = load(tmp_path / "fit.json")
    assert loaded.response is not None and loaded.response.names == response.names
    assert loaded.response.same_as(response)
    back = skyfit.read(tmp_path / "fit.nc")
    np.testing.assert_allclose(predict(loaded, back), fit.model, rtol=1e-6)
    write_prediction(back, fit.model, tmp_path / "again.nc")
    np.testing.assert_allclose(skyfit.read(tmp_path / "again.nc").radiance, fit.model, rtol=1e-12)
    # a sky of wavelengths is predicted as such, and seen by the channels where they are given
    plain = as_sky(by_hand(SOLVER, PLAIN), fwhm_nm=np.nan, time=np.array(["NaT"], "datetime64[ns]"))
    np.testing.assert_allclose(predict(loaded, plain)[0], by_hand(SOLVER, PLAIN, fwhm_nm=None), rtol=0.02)
    plot(fit, tmp_path / "fit.png")
    many = skyfit.fit_many(sky, FREE, solver=SOLVER, start=start(), path=tmp_path / "fits.nc", measurement=EXACT)
    np.testing.assert_allclose(many.values, fit.values, rtol=1e-5)
    np.testing.assert_array_equal(many.fitted_nm, sky.wavelength_nm)
    # the argument does the same as the file
    order = np.argsort(sky.wavelength_nm)
    bare = replace(
        sky, response=None, wavelength_nm=sky.wavelength_nm[order], radiance=sky.radiance[..., order],
        usable=sky.usable[..., order], sigma=sky.sigma[..., order],
    )  # fmt: skip
    given = fitted(bare, response=response)
    np.testing.assert_allclose(given.values, fit.values, rtol=1e-5)
    np.testing.assert_allclose(predict(fit, bare, response), fit.model[..., order], rtol=1e-6)
    record = json.loads((tmp_path / "fit.json").read_text())
    record["instrument"]["response"]["weight"] = record["instrument"]["response"]["weight"][:1] + [["wide"]]
    (tmp_path / "odd.json").write_text(json.dumps(record))
    with pytest.raises(ValueError, match=r"odd\.json: key `instrument\.response`: expected"):
        load(tmp_path / "odd.json")


def test_calibration_is_of_the_channels_that_it_was_found_for(x64):
    """One of them masked at all directions: the others are fitted, and it has no scale of its own."""
    sky = sky_of(bands())
    bright = sky.radiance * np.array([1.0, 1.04, 1.0])
    usable = sky.usable & (np.arange(3) < 2)
    found = skyfit.invert(
        replace(sky, radiance=bright, sigma=1.04 * sky.sigma, usable=usable), FREE, SOLVER, start(),
        measurement=replace(EXACT, calibration=0.05), priors={"turbidity": (2.0, 0.5)},
    )  # fmt: skip
    assert found.fitted_nm.tolist() == sky.wavelength_nm[:2].tolist() and found.calibration.shape == (1, 2)
    ratio = found.calibration[0, 1] / found.calibration[0, 0]
    assert ratio != 1.0
    without = predict(replace(found.fitted, calibration=np.ones((1, 2))), sky)
    np.testing.assert_allclose(predict(found, sky)[0, 0, :2] / without[0, 0, :2], found.calibration[0], rtol=1e-9)
    spectral = replace(as_sky(by_hand(SOLVER, PLAIN)), time=sky.time)
    np.testing.assert_array_equal(
        predict(found, spectral), predict(replace(found.fitted, calibration=np.ones((1, 2))), spectral)
    )
    np.testing.assert_array_equal(found.model[0, :, :2], predict(found, sky)[0, :, :2])


def test_a_filter_wheel_of_broad_bands(x64):
    """A sun for each channel of a response."""
    response = bands()
    zenith = 0.9 + np.array([0.0, 0.02, 0.04])
    spectra = [by_hand(SOLVER, response.wavelength_nm, sun_zenith=float(z), fwhm_nm=None) for z in zenith]
    light = np.stack([s @ w for s, w in zip(spectra, response.weight, strict=True)], axis=1)
    sky = as_sky(
        light, 0.01, 6, response.centre_nm, sun_zenith=0.0, response=response, fwhm_nm=np.nan,
        time=np.array(["NaT"], "datetime64[ns]"),
    )  # fmt: skip
    moving = fitted(replace(sky, sun_zenith=zenith[None], sun_azimuth=np.array([1.0])))
    truth = np.array([float(skyfit.optical_depth_to_turbidity(0.2)), 0.65])
    assert np.all(np.abs(moving.values[0] - truth) < 3.5 * moving.sigma[0]) and moving.reduced_chi_square[0] < 1.3
    still = fitted(replace(sky, sun_zenith=np.array([0.9])))
    assert still.reduced_chi_square[0] > 1.3 * moving.reduced_chi_square[0]
