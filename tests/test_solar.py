import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skyfit.light import earth_sun_factor, extraterrestrial_irradiance, SUN_SOLID_ANGLE
from skyfit.tables import read_table


@pytest.fixture(autouse=True)
def double():
    with jax.enable_x64(True):
        yield


def test_solid_angle_of_the_sun():
    # mean angular radius 959.63 arc seconds (Auwers), 6.8e-5 sr
    radius = np.radians(959.63 / 3600.0)
    assert SUN_SOLID_ANGLE == pytest.approx(2 * np.pi * (1 - np.cos(radius)), rel=2e-3)


def test_without_line_shape_the_table_itself():
    got = extraterrestrial_irradiance(np.array([300.0, 500.0, 800.0, 1100.0]))
    # pvlib's documentation of get_reference_spectra prints these
    np.testing.assert_allclose(got, [0.45794, 1.916, 1.1248, 0.6], rtol=1e-6)


def test_between_rows_it_is_linear():
    got = np.asarray(extraterrestrial_irradiance(np.array([500.0, 500.25, 501.0])))
    assert got[1] == pytest.approx(0.75 * got[0] + 0.25 * got[2], rel=1e-12)
    assert got[0] != got[2]


@pytest.mark.parametrize("fwhm", [0.3, 2.0, 6.0])
@pytest.mark.parametrize("centre", [300.0, 393.4, 399.9, 1100.0])
def test_convolution_is_the_integral(fwhm, centre):
    table = read_table("astm_g173_extraterrestrial.csv")
    sigma = fwhm / 2.354820045
    at = np.linspace(centre - 9 * sigma, centre + 9 * sigma, 200001)
    at = at[(at >= 280.0) & (at <= 1130.0)]
    line = np.exp(-0.5 * ((at - centre) / sigma) ** 2)
    solar = np.interp(at, table["wavelength_nm"], table["irradiance"])
    expected = np.trapezoid(solar * line, at) / np.trapezoid(line, at)
    got = extraterrestrial_irradiance(np.array([centre]), fwhm)
    np.testing.assert_allclose(got, expected, rtol=1e-6)


def test_convolution_keeps_energy_and_a_narrow_line_is_no_line():
    wavelength = np.arange(350.0, 1050.0, 0.5)
    sharp = np.asarray(extraterrestrial_irradiance(wavelength))
    wide = np.asarray(extraterrestrial_irradiance(wavelength, 6.0))
    assert wide.sum() == pytest.approx(sharp.sum(), rel=1e-3)
    # Ca II K at 393.4 nm is filled in
    deepest = np.argmin(np.abs(wavelength - 393.5))
    assert wide[deepest] > 1.4 * sharp[deepest]
    narrow = extraterrestrial_irradiance(wavelength, 1e-4)
    np.testing.assert_allclose(narrow, sharp, rtol=1e-3)


def test_preetham_sun_is_two_percent_darker():
    wavelength = np.arange(380.0, 751.0, 1.0)
    old = np.asarray(extraterrestrial_irradiance(wavelength, None, "preetham"))
    new = np.asarray(extraterrestrial_irradiance(wavelength))
    assert old[wavelength == 550.0][0] == pytest.approx(1.725, abs=5e-4)
    assert old.sum() / new.sum() == pytest.approx(0.978, abs=2e-3)


@pytest.mark.parametrize(
    ("wavelength", "fwhm", "source", "message"),
    [
        (299.9, None, "astm_g173", "between 300 and 1100 nm.*got 299.9"),
        (1100.1, None, "astm_g173", "between 300 and 1100 nm"),
        (float("nan"), None, "astm_g173", "between 300 and 1100 nm"),
        (750.1, None, "preetham", "between 380 and 750 nm"),
        (379.0, None, "preetham", "between 380 and 750 nm"),
        (380.0, 6.0, "preetham", "`fwhm_nm` = 6 must leave 10.2 nm"),
        (300.0, 20.0, "astm_g173", "`fwhm_nm` = 20 must leave"),
        (550.0, 0.0, "astm_g173", "`fwhm_nm` must be positive"),
        (550.0, float("nan"), "astm_g173", "`fwhm_nm` must be positive"),
    ],
)
def test_outside_the_range_it_says_so(wavelength, fwhm, source, message):
    with pytest.raises(ValueError, match=message):
        extraterrestrial_irradiance(np.array([550.0, wavelength]), fwhm, source)


def test_unknown_source():
    # under run-time type checks the annotation refuses it first
    with pytest.raises(Exception, match="source"):
        extraterrestrial_irradiance(np.array([550.0]), None, "moon")


def test_integer_wavelengths_and_float32():
    with jax.enable_x64(False):
        got = extraterrestrial_irradiance(np.arange(400, 701, 100), 5.0)
        assert got.dtype == jnp.float32
    expected = extraterrestrial_irradiance(np.arange(400.0, 701.0, 100.0), 5.0)
    np.testing.assert_allclose(got, expected, rtol=1e-6)


def test_earth_sun_factor():
    # 27 May is day 147: 0.973; perihelion and aphelion from e = 0.0167
    assert float(earth_sun_factor(147)) == pytest.approx(0.973, abs=5e-4)
    assert float(earth_sun_factor(3)) == pytest.approx((1 - 0.0167) ** -2, abs=1e-3)
    assert float(earth_sun_factor(185)) == pytest.approx((1 + 0.0167) ** -2, abs=1e-3)


def test_earth_sun_factor_against_pvlib():
    pvlib = pytest.importorskip("pvlib")
    day = np.arange(1, 366)
    expected = pvlib.irradiance.get_extra_radiation(day, solar_constant=1.0, method="spencer")
    np.testing.assert_allclose(earth_sun_factor(day), expected, atol=2e-6)
    gradient = jax.vmap(jax.grad(earth_sun_factor))(jnp.asarray(day, dtype=float))
    assert np.max(np.abs(gradient)) == pytest.approx(2 * np.pi / 365 * 0.034, rel=0.1)
