import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skyfit.light import daylight, LUMINOUS_EFFICACY
from skyfit.tables import read_table


colour = pytest.importorskip("colour")
NODES = read_table("cie_daylight_basis.csv")["wavelength_nm"]
# CIE 015:2018: D50, D55, D65, D75; then skylight, bluer than any D illuminant, and the light of a low sun
D50, D65, BLUE, WARM = (0.3457, 0.3585), (0.3127, 0.3290), (0.2350, 0.2400), (0.3850, 0.3800)
LIGHTS = (D50, (0.3324, 0.3474), D65, (0.2990, 0.3149), BLUE, WARM)


@pytest.fixture(params=[False, True], ids=["float32", "float64"])
def precision(request):
    with jax.enable_x64(request.param):
        yield 1e-12 if request.param else 2e-6


def components(x, y):
    """M1 and M2 as Preetham 1999 A.5 prints them."""
    below = 0.0241 + 0.2562 * x - 0.7341 * y
    return (-1.3515 - 1.7703 * x + 5.9114 * y) / below, (0.0300 - 31.4424 * x + 30.0717 * y) / below


def tristimulus(spectrum):
    """X, Y, Z by colour-science's sum over its 1 nm table, ours being an integral of lines between nodes."""
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    spectrum = np.interp(observer.wavelengths, NODES, np.asarray(spectrum, dtype=float))
    return LUMINOUS_EFFICACY * spectrum @ observer.values


def test_the_basis_is_the_papers_table():
    ours, paper = read_table("cie_daylight_basis.csv"), read_table("preetham_table2_spectra.csv")
    rows = np.isin(NODES, paper["wavelength_nm"])
    assert rows.sum() == 41
    for name in ("s0", "s1", "s2"):
        np.testing.assert_array_equal(ours[name][rows], paper[f"daylight_{name}"])


def test_the_basis_is_that_of_colour_science():
    from colour.colorimetry import SDS_BASIS_FUNCTIONS_CIE_ILLUMINANT_D_SERIES as BASIS

    ours = read_table("cie_daylight_basis.csv")
    for name in ("S0", "S1", "S2"):
        np.testing.assert_array_equal(BASIS[name].wavelengths, NODES)
        np.testing.assert_allclose(ours[name.lower()], BASIS[name].values, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize(("x", "y"), LIGHTS)
def test_spectrum_is_that_of_the_printed_formula_and_of_colour_science(x, y, precision):
    got = np.asarray(daylight(x, y, NODES))
    table = read_table("cie_daylight_basis.csv")
    first, second = components(x, y)
    printed = table["s0"] + first * table["s1"] + second * table["s2"]
    assert printed.min() >= 0.0
    middle = int(np.flatnonzero(NODES == 560.0)[0])
    np.testing.assert_allclose(got / got[middle], printed / printed[middle], atol=20 * precision)
    theirs = colour.sd_CIE_illuminant_D_series(np.array([x, y]), M1_M2_rounding=False).values
    np.testing.assert_allclose(got / got[middle], theirs / theirs[middle], atol=20 * precision)


@pytest.mark.parametrize(("x", "y"), LIGHTS)
def test_luminance_is_one_and_the_colour_is_the_one_asked_for(x, y, precision):
    got = tristimulus(daylight(x, y, NODES))
    # the sum against the integral: 2e-5 at most
    assert got[1] == pytest.approx(1.0, rel=3e-5)
    np.testing.assert_allclose(colour.XYZ_to_xy(got), [x, y], atol=3e-4)


def test_d65_at_560_nm():
    # D65 as the CIE tabulates it, which rounds M1 and M2
    with jax.enable_x64(True):
        peak = float(daylight(*D65, np.array([560.0]))[0])
    d65 = colour.SDS_ILLUMINANTS["D65"].copy().align(colour.SpectralShape(360, 830, 1))
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    expected = d65[560] / (LUMINOUS_EFFICACY * np.sum(d65.values * observer.values[:, 1]))
    assert peak == pytest.approx(expected, rel=3e-4)


def test_wavelengths_asked_for_do_not_change_the_scale(precision):
    some = np.array([360.0, 412.3, 555.0, 700.0])
    got = daylight(*BLUE, some)
    np.testing.assert_allclose(
        got, np.interp(some, NODES, np.asarray(daylight(*BLUE, NODES), float)), rtol=9 * precision
    )


def test_the_pole_of_the_printed_formula_is_none(precision):
    # 0.0241 + 0.2562 x - 0.7341 y = 0 at x = 0.3, y = 0.1375265
    x, y = 0.3, (0.0241 + 0.2562 * 0.3) / 0.7341
    at, near = daylight(x, y, NODES), daylight(x, y + 1e-3, NODES)
    assert np.all(np.isfinite(at)) and float(jnp.max(at)) > 0.0
    np.testing.assert_allclose(at, near, atol=0.03 * float(jnp.max(at)))


def test_no_negative_radiance_and_finite_gradients_everywhere(precision):
    x, y = (jnp.ravel(a) for a in jnp.meshgrid(jnp.linspace(-2.0, 3.0, 11), jnp.linspace(-2.0, 3.0, 11)))

    def one(a, b):
        return daylight(a, b, NODES)

    values, slopes = jax.jit(jax.vmap(lambda a, b: (one(a, b), jax.jacfwd(one, (0, 1))(a, b))))(x, y)
    for leaf in jax.tree.leaves((values, slopes)):
        assert np.all(np.isfinite(leaf))
    assert float(jnp.min(values)) == 0.0
    # Preetham's sky at the setting sun, turbidity 2: the printed sum is negative in the blue, so that 0 stands there
    red = daylight(0.46, 0.49, NODES)
    first, second = components(0.46, 0.49)
    table = read_table("cie_daylight_basis.csv")
    negative = table["s0"] + first * table["s1"] + second * table["s2"] < 0.0
    assert 400.0 in NODES[negative] and 550.0 not in NODES[negative]
    np.testing.assert_array_equal(np.asarray(red) == 0.0, negative)


def test_shapes_batch(precision):
    x, y = jnp.array([[0.3, 0.32, 0.28]] * 2), jnp.array([[0.31, 0.33, 0.29]] * 2)
    batch = daylight(x, y, NODES)
    assert batch.shape == (2, 3, NODES.size)
    loop = np.array([[daylight(a, b, NODES) for a, b in zip(*rows, strict=True)] for rows in zip(x, y, strict=True)])
    np.testing.assert_allclose(batch, loop, rtol=9 * precision, atol=precision * float(batch.max()))


def test_gradient_is_the_central_difference():
    with jax.enable_x64(True):

        def values(at):
            return daylight(at[0], at[1], NODES)

        at, step = jnp.array(WARM), 1e-6
        slope = np.asarray(jax.jacfwd(values)(at))
        for k in range(2):
            difference = (values(at.at[k].add(step)) - values(at.at[k].add(-step))) / (2.0 * step)
            np.testing.assert_allclose(slope[:, k], difference, atol=1e-8 * np.abs(difference).max())


@pytest.mark.parametrize("bad", [299.9, 830.1, float("nan")])
def test_wavelengths_outside_are_refused_where_they_can_be_seen(bad, precision):
    with pytest.raises(ValueError, match=f"`wavelength_nm` must be between 300 and 830 nm.*got {bad:g}"):
        daylight(*D65, np.array([500.0, bad]))
    traced = jax.jit(lambda w: daylight(*D65, w))(jnp.array([200.0, 300.0, 830.0, 2000.0]))
    assert float(traced[0]) == float(traced[1]) and float(traced[2]) == float(traced[3])
