"""Something is recomputed from every shipped table."""

import importlib

import numpy as np
import pytest

from skyfit.tables import data_path, read_table


TABLES = [
    "astm_g173_extraterrestrial.csv",
    "hoffman_air_scattering.csv",
    "preetham_perez_coefficients.csv",
    "preetham_table1_eta.csv",
    "preetham_table2_spectra.csv",
    "preetham_zenith_chromaticity.csv",
    "preetham_zenith_luminance.csv",
    "spectrl2_absorption.csv",
]


@pytest.mark.parametrize("name", TABLES)
def test_header_says_source_columns_and_licence(name):
    head = [line for line in data_path(name).read_text().splitlines() if line.startswith("#")]
    text = "\n".join(head)
    assert all(line.startswith("# ") for line in head)
    assert "# source: " in text and "# licence: " in text
    assert "# columns: " in text or "# columns:\n" in text or "# rows, " in text


def test_read_table_is_read_only_and_named():
    table = read_table("preetham_table2_spectra.csv")
    assert list(table)[:2] == ["wavelength_nm", "haze_scattering"]
    with pytest.raises(ValueError, match="read-only"):
        table["haze_scattering"][0] = 0.0
    table.clear()
    assert read_table("preetham_table2_spectra.csv")
    with pytest.raises(FileNotFoundError, match="`name` must be a file"):
        data_path("no_such_table.csv")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# c\na,b\n1,2\n1,x\n", "row 4, column b: expected a number, found 'x'"),
        ("a,b\n1,2,3\n", "row 2: expected 2 cells, found 3"),
        ("# only a comment\n", "expected a header row"),
    ],
)
def test_read_table_names_file_row_column(tmp_path, monkeypatch, text, message):
    from skyfit import tables

    path = tmp_path / f"bad{abs(hash(text))}.csv"
    path.write_text(text)
    monkeypatch.setattr(tables, "data_path", lambda name: path)
    with pytest.raises(ValueError, match=message):
        tables.read_table(path.name)


def test_eta_integrates_to_pi_k_only_with_log_interpolation():
    # ERRATA 3: at 550 nm pi K = 2.130; log 2.142, linear 2.276
    eta = read_table("preetham_table1_eta.csv")
    spectra = read_table("preetham_table2_spectra.csv")
    pi_k = np.pi * spectra["haze_scattering"][spectra["wavelength_nm"] == 550.0][0]
    assert pi_k == pytest.approx(2.130, abs=5e-4)
    angle = np.linspace(0.0, np.pi, 20001)
    node = np.radians(eta["theta_deg"])
    solid = np.pi * np.sin(angle)  # half eta over the circle of azimuths
    log = np.trapezoid(solid * np.exp(np.interp(angle, node, np.log(eta["eta_550nm"]))), angle)
    linear = np.trapezoid(solid * np.interp(angle, node, eta["eta_550nm"]), angle)
    assert log == pytest.approx(2.142, abs=5e-4)
    assert linear == pytest.approx(2.276, abs=5e-4)


def test_eta_changes_with_wavelength_alike_at_all_angles():
    # d ln(eta) / d lambda of neighbouring columns has one ratio from 60 degrees on: a misread last
    # digit leaves it. One printed cell does: 850 nm at 180 degrees, 0.1566 where 0.1546 would fit.
    eta = read_table("preetham_table1_eta.csv")
    wavelength = (400, 450, 550, 650, 850)
    values = np.stack([eta[f"eta_{w}nm"] for w in wavelength], axis=1)
    slope = (np.diff(np.log(values), axis=1) / np.diff(wavelength))[eta["theta_deg"] >= 60.0]
    ratio = slope[:, :-1] / slope[:, 1:]
    np.testing.assert_allclose(ratio[:, 0], 1.64, rtol=0.025)
    np.testing.assert_allclose(ratio[:, 1], 1.77, rtol=0.035)
    np.testing.assert_allclose(ratio[:-1, 2], 1.95, rtol=0.025)
    assert values[-1, -1] == 0.1566 and ratio[-1, 2] == pytest.approx(1.41, abs=0.01)
    mended = np.log(0.1546 / values[-1, -2]) / 200.0
    assert slope[-1, 2] / mended == pytest.approx(1.95, rel=0.025)


def test_haze_k_rises_smoothly():
    k = read_table("preetham_table2_spectra.csv")["haze_scattering"]
    assert k.sum() == pytest.approx(27.752, abs=5e-4)
    assert np.all((np.diff(k) >= 0.0) & (np.diff(k) < 0.0035))


def test_daylight_vectors_are_the_cie_ones():
    colour = pytest.importorskip("colour")
    table = read_table("preetham_table2_spectra.csv")
    cie = colour.colorimetry.datasets.SDS_BASIS_FUNCTIONS_CIE_ILLUMINANT_D_SERIES
    for name in ("S0", "S1", "S2"):
        expected = np.interp(table["wavelength_nm"], cie[name].wavelengths, cie[name].values)
        np.testing.assert_allclose(table[f"daylight_{name.lower()}"], expected, atol=1e-9)


def test_preetham_sun_is_nasa_irradiance_over_one_solid_angle():
    # Thekaekara's table (NASA SP-8005, 1971) is in whole W m^-2 um^-1: 1725 at 550 nm
    table = read_table("preetham_table2_spectra.csv")
    known = ~np.isnan(table["sun_radiance"])
    np.testing.assert_array_equal(table["wavelength_nm"][known], np.arange(380.0, 751.0, 10.0))
    milliwatts = 1e3 * np.pi * (6.96e8 / 1.5e11) ** 2 * table["sun_radiance"][known]
    np.testing.assert_allclose(milliwatts, np.round(milliwatts), atol=0.011)
    assert milliwatts[17] == pytest.approx(1725.0, abs=0.011)


def test_preetham_absorption_is_that_of_spectrl2_where_both_stand():
    # per metre against per cm; the mixed gases are Leckner's own there, Bird's adjusted here
    paper, bird = read_table("preetham_table2_spectra.csv"), read_table("spectrl2_absorption.csv")
    _, here, there = np.intersect1d(paper["wavelength_nm"], bird["wavelength_nm"], return_indices=True)
    assert here.size == 25
    for name in ("ozone_absorption", "water_absorption"):
        mine = np.nan_to_num(paper[name][here]) / 100.0
        np.testing.assert_allclose(mine, bird[name][there], atol=1e-12)
    known = ~np.isnan(paper["mixed_gas_absorption"])
    np.testing.assert_array_equal(paper["wavelength_nm"][known], [760.0, 770.0])
    np.testing.assert_array_equal(paper["mixed_gas_absorption"][known], [3.0, 0.21])


def test_ozone_absorption_at_its_peak_gives_the_known_depth():
    # Chappuis peak near 602 nm: 5.1e-21 cm2 (Gorshelev 2014) x 2.687e19 cm-3 (Loschmidt)
    bird = read_table("spectrl2_absorption.csv")
    per_cm = np.interp(602.0, bird["wavelength_nm"], bird["ozone_absorption"])
    assert per_cm == pytest.approx(5.1e-21 * 2.687e19, rel=0.15)


def test_hoffman_air_is_rayleigh():
    # ERRATA 19: N = 2.545e25 is the density at 288.15 K
    table = read_table("hoffman_air_scattering.csv")
    king = (6.0 + 3.0 * 0.035) / (6.0 - 7.0 * 0.035)
    wavelength = table["wavelength_nm"] * 1e-9
    beta = 8 * np.pi**3 * (1.0003**2 - 1.0) ** 2 / (3 * 2.545e25 * wavelength**4) * king
    half_digit = np.array([0.5e-8, 0.5e-7, 0.5e-7])
    assert np.all(np.abs(table["scattering"] - beta) <= half_digit)


def test_solar_tables_are_those_of_pvlib():
    pvlib = pytest.importorskip("pvlib")
    table = read_table("astm_g173_extraterrestrial.csv")
    spectra = pvlib.spectrum.get_reference_spectra(standard="ASTM G173-03")["extraterrestrial"]
    expected = spectra.loc[280.0:1130.0]
    np.testing.assert_array_equal(table["wavelength_nm"], expected.index)
    np.testing.assert_allclose(table["irradiance"], expected.to_numpy(), rtol=1e-11)
    bird = importlib.import_module("pvlib.spectrum.spectrl2")._SPECTRL2_COEFFS
    gases = read_table("spectrl2_absorption.csv")
    rows = bird[bird["wavelength"] <= 1130.0]
    np.testing.assert_array_equal(gases["ozone_absorption"], rows["ozone_absorption"])
    np.testing.assert_array_equal(gases["water_absorption"], rows["water_vapor_absorption"])
    np.testing.assert_array_equal(gases["mixed_gas_absorption"], rows["mixed_absorption"])


def test_g173_holds_the_suns_share_of_the_solar_constant():
    # 300-1100 nm holds 73.4 % of a 5772 K black body (IAU 2015) of 1361 W m^-2: 998.7
    table = read_table("astm_g173_extraterrestrial.csv")
    used = (table["wavelength_nm"] >= 300.0) & (table["wavelength_nm"] <= 1100.0)
    wavelength = table["wavelength_nm"][used] * 1e-9
    planck = 1.191042972e-16 / wavelength**5 / np.expm1(1.438776877e-2 / wavelength / 5772.0)
    share = np.trapezoid(planck, wavelength) * np.pi / (5.670374419e-8 * 5772.0**4)
    assert share == pytest.approx(0.734, abs=5e-4)
    total = np.trapezoid(table["irradiance"][used], table["wavelength_nm"][used])
    assert total == pytest.approx(1361.0 * share, rel=0.01)


def test_perez_and_zenith_coefficients_by_their_sums():
    # sums added by hand from the printed matrices of A.2
    perez = read_table("preetham_perez_coefficients.csv")
    sums = {name: column.sum() for name, column in perez.items()}
    expected = {
        "Y_slope": -0.1458,
        "Y_constant": 2.0828,
        "x_slope": -0.1536,
        "x_constant": -0.8996,
        "y_slope": -0.1746,
        "y_constant": -1.6422,
    }
    assert sums == pytest.approx(expected, abs=1e-9)
    zenith = read_table("preetham_zenith_chromaticity.csv")
    sums = [zenith[name].sum() for name in list(zenith)[1:]]
    expected = [0.0896, -0.1519, 0.0306, 0.2628, 0.1142, -0.1840, 0.0284, 0.2721]
    assert sums == pytest.approx(expected, abs=1e-9)
    luminance = read_table("preetham_zenith_luminance.csv")
    assert luminance["slope"].sum() == pytest.approx(4.0453 - 0.2155 - 1 / 120, abs=1e-12)
    assert luminance["constant"].sum() == pytest.approx(2.4192 - 4.9710 + 4 / 9, abs=1e-12)
