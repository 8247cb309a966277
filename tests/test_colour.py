import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skyfit.light import extraterrestrial_irradiance, srgb, srgb_from_xyz, xyY, xyz, xyz_from_xyY
from skyfit.tables import read_table


colour = pytest.importorskip("colour")


@pytest.fixture(params=[False, True], ids=["float32", "float64"])
def precision(request):
    with jax.enable_x64(request.param):
        yield 1e-12 if request.param else 2e-6


def grid(step):
    return np.arange(360.0, 830.5, step)


@pytest.mark.parametrize("step", [0.7, 1.0, 5.0, 10.0])
def test_equal_energy_has_683_times_106_857(step, precision):
    # CIE 1931: the three functions have the integrals 106.8655, 106.8569, 106.8922 nm (1 nm table)
    wavelength = np.append(grid(step), 830.0) if grid(step)[-1] < 830.0 else grid(step)
    got = xyz(jnp.ones(wavelength.size), wavelength)
    np.testing.assert_allclose(got, 683.0 * np.array([106.866, 106.857, 106.892]), rtol=2e-5)


def test_coarse_grid_is_exact_for_linear_spectra(precision):
    fine, coarse = grid(1.0), np.array([360.0, 391.0, 433.3, 500.0, 612.0, 700.0, 830.0])

    def ramp(wavelength):
        return jnp.asarray((wavelength - 300.0) / 500.0)

    tolerance = max(precision, 1e-9)
    np.testing.assert_allclose(xyz(ramp(coarse), coarse), xyz(ramp(fine), fine), rtol=tolerance)


def test_monochromatic_555_gives_683_lumen_per_watt(precision):
    # 1 W in a triangle of 1 nm at 555 nm, where the CIE's function is 1.0000 and its neighbours 1
    wavelength = np.concatenate([np.arange(380.0, 554.0), [554, 555, 556], np.arange(557.0, 781.0)])
    radiance = jnp.zeros(wavelength.size).at[np.flatnonzero(wavelength == 555.0)[0]].set(1.0)
    assert float(xyz(radiance, wavelength)[1]) == pytest.approx(683.0, rel=1e-4)


def test_sun_of_both_tables_through_colour_science():
    # against the same integral in colour-science; the old sun (NASA 1971) is the bluer one
    table = read_table("preetham_table2_spectra.csv")
    known = ~np.isnan(table["sun_radiance"])
    wavelength = table["wavelength_nm"][known]
    suns = {
        "preetham": table["sun_radiance"][known],
        "astm_g173": np.asarray(extraterrestrial_irradiance(wavelength, 10.0)),
    }
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    temperature = {}
    for name, sun in suns.items():
        distribution = colour.SpectralDistribution(dict(zip(wavelength, sun, strict=True)))
        distribution = distribution.interpolate(
            colour.SpectralShape(380, 750, 1), interpolator=colour.LinearInterpolator
        )
        # held constant beyond its ends, as ours is
        distribution.extrapolate(observer.shape)
        # there a sum over 1 nm steps
        expected = colour.sd_to_XYZ(distribution, observer, method="Integration", k=683.0)
        with jax.enable_x64(True):
            got = np.asarray(xyz(jnp.asarray(sun), wavelength))
            x, y, _ = np.asarray(xyY(jnp.asarray(sun), wavelength))
            temperature[name] = colour.temperature.xy_to_CCT([x, y], "McCamy 1992")
        np.testing.assert_allclose(got, expected, rtol=1e-3, err_msg=name)
        np.testing.assert_allclose([x, y], colour.XYZ_to_xy(expected), atol=1e-4)
    assert temperature == pytest.approx({"preetham": 6290.0, "astm_g173": 5930.0}, abs=10.0)


def test_sun_luminance():
    # extraterrestrial solar illuminance: 127.5 klx (IES, from NASA 1971), 133.1 klx with G173
    wavelength = np.arange(360.0, 831.0, 1.0)
    illuminance = xyz(extraterrestrial_irradiance(wavelength), wavelength)[1]
    assert float(illuminance) == pytest.approx(133.1e3, rel=1e-3)
    wavelength = np.arange(380.0, 751.0, 10.0)
    illuminance = xyz(extraterrestrial_irradiance(wavelength, None, "preetham"), wavelength)[1]
    assert float(illuminance) == pytest.approx(127.5e3, rel=3e-3)


def test_truncated_grid_loses_little_and_short_grid_is_refused(precision):
    full, cut = grid(5.0), np.arange(400.0, 701.0, 5.0)
    planck = np.exp(-(((full - 550.0) / 200.0) ** 2))
    whole = xyz(jnp.asarray(planck), full)
    part = xyz(jnp.asarray(planck[np.isin(full, cut)]), cut)
    np.testing.assert_allclose(part, whole, rtol=3e-3)
    for bad in (np.arange(410.0, 701.0), np.arange(400.0, 700.0)):
        with pytest.raises(ValueError, match="must cover 400-700 nm"):
            xyz(jnp.ones(bad.size), bad)
    with pytest.raises(ValueError, match="must be increasing"):
        xyz(jnp.ones(301), np.arange(700.0, 399.0, -1.0))


def test_shapes_batch_and_round_trip(precision):
    wavelength = np.arange(380.0, 781.0, 10.0)
    radiance = 1.0 + jnp.asarray(np.random.default_rng(4).random((2, 3, wavelength.size)))
    batch = xyz(radiance, wavelength)
    loop = np.array([[xyz(r, wavelength) for r in rows] for rows in radiance])
    np.testing.assert_allclose(batch, loop, rtol=5 * precision)
    back = xyz_from_xyY(xyY(radiance, wavelength))
    np.testing.assert_allclose(back, batch, rtol=5 * precision)
    assert srgb(radiance, wavelength, 1e-5).shape == (2, 3, 3)


def test_srgb_of_white_grey_and_of_colour_science(precision):
    white = jnp.asarray(colour.xy_to_XYZ(colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]))
    np.testing.assert_allclose(srgb_from_xyz(200.0 * white, 1 / 200.0), np.ones(3), atol=2e-4)
    for level in (0.001, 0.0031308, 0.2, 0.8):
        tristimulus = level * np.array([0.7, 0.6, 0.5])
        expected = colour.XYZ_to_sRGB(tristimulus)
        np.testing.assert_allclose(srgb_from_xyz(jnp.asarray(tristimulus), 1.0), expected, atol=3e-4)


def test_gradients_are_finite_at_black_and_outside_the_gamut(precision):
    wavelength = np.arange(380.0, 781.0, 10.0)
    black = jnp.zeros(wavelength.size)
    # a spectral line at 500 nm has negative red
    line = black.at[12].set(1.0)
    assert float(srgb(line, wavelength, 1e-4)[0]) < 0.0

    def transforms(r):
        chromaticity = xyY(r, wavelength)
        pixel = srgb(r, wavelength, 1e-4)
        return jnp.stack([xyz(r, wavelength), chromaticity, xyz_from_xyY(chromaticity), pixel])

    everything = jax.jit(lambda r: (transforms(r), jax.jacfwd(transforms)(r), jax.jacrev(transforms)(r)))
    for radiance in (black, line, 1.0 + black):
        value, forward, reverse = everything(radiance)
        assert np.all(np.isfinite(value)) and np.all(np.isfinite(forward))
        np.testing.assert_allclose(forward, reverse, rtol=1e-3, atol=1e-3)
        assert np.all(np.abs(forward[3]).max(axis=-1) > 0.0)
    np.testing.assert_allclose(xyY(black, wavelength), [1 / 3, 1 / 3, 0.0], rtol=1e-6)


def test_srgb_gradient_is_the_central_difference():
    with jax.enable_x64(True):
        wavelength = np.arange(380.0, 781.0, 20.0)
        radiance = jnp.asarray(0.5 + np.random.default_rng(2).random(wavelength.size))
        pixel = jax.jit(lambda r: srgb(r, wavelength, 1e-5))
        slope = jax.jit(jax.jacfwd(pixel))(radiance)
        step = 1e-5
        for k in range(0, wavelength.size, 4):
            up, down = pixel(radiance.at[k].add(step)), pixel(radiance.at[k].add(-step))
            np.testing.assert_allclose(slope[:, k], (up - down) / (2 * step), atol=1e-7 * float(jnp.abs(slope).max()))
