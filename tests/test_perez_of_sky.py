"""Perez' parameters of measured skies: known ones come back, with the covariance that scipy finds."""

import csv

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import curve_fit
from typer.testing import CliRunner

import skyfit
from skyfit.cli import app
from skyfit.measured import read, Sky
from skyfit.measured.readers.scanner import tregenza


TRUTH = np.array([-0.9, -0.35, 9.0, -2.8, 0.4])
SUN = np.radians([41.0, 150.0])
ZENITH, AZIMUTH = np.radians(tregenza())
LEVEL = 4000.0


def away(zenith=ZENITH, azimuth=AZIMUTH):
    cosine = np.cos(zenith) * np.cos(SUN[0]) + np.sin(zenith) * np.sin(SUN[0]) * np.cos(azimuth - SUN[1])
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def form(zenith, gamma, a, b, c, d, e):
    """Perez 1993 eq. 1, written out again."""
    return (1 + a * np.exp(b / np.cos(zenith))) * (1 + c * np.exp(d * gamma) + e * np.cos(gamma) ** 2)


LIGHT = LEVEL * form(ZENITH, away(), *TRUTH)


def as_sky(light, wavelength=(560.0,), zenith=ZENITH, azimuth=AZIMUTH, usable=None, luminance=True):
    """`light` `[time, direction, channel]` as a `Sky`, of luminance if of one channel."""
    response = skyfit.Response.eye() if luminance else None
    where = response.centre_nm if response else np.array(wavelength)
    count = len(light)
    return Sky(
        radiance=light, sigma=None, usable=np.isfinite(light) if usable is None else usable, view_zenith=zenith,
        view_azimuth=azimuth, wavelength_nm=where, sun_zenith=np.full(count, SUN[0]),
        sun_azimuth=np.full(count, SUN[1]), time=np.full(count, "NaT", "datetime64[ns]"), response=response,
    )  # fmt: skip


def test_the_parameters_of_a_perez_sky_come_back():
    found = skyfit.perez_of_sky(as_sky(LIGHT[None, :, None]))
    assert found.light == ("luminance",) and found.settled.all() and found.directions == 145
    np.testing.assert_allclose(found.coefficients[0, 0], TRUTH, rtol=1e-6)
    at_zenith = LEVEL * form(0.0, SUN[0], *TRUTH)
    assert found.zenith[0, 0] == pytest.approx(at_zenith, rel=1e-8) and found.rmse[0, 0] < 1e-8


def test_the_covariance_is_that_of_scipy():
    noise = 1.0 + 0.05 * np.random.default_rng(3).standard_normal(145)
    found = skyfit.perez_of_sky(as_sky((LIGHT * noise)[None, :, None]))

    def model(place, level, *coefficients):
        return level * form(*place, *coefficients)

    own, spread = curve_fit(
        model, (ZENITH, away()), LIGHT * noise, (LEVEL, *TRUTH), sigma=LIGHT * noise, absolute_sigma=False, ftol=1e-12,
        xtol=1e-12, maxfev=20000,
    )  # fmt: skip
    np.testing.assert_allclose(found.coefficients[0, 0], own[1:], rtol=1e-3)
    np.testing.assert_allclose(found.covariance[0, 0], spread[1:, 1:], rtol=0.02)
    slope = np.array([model((0.0, SUN[0]), *(own + step)) for step in np.diag(1e-6 * own)])
    slope = (slope - model((0.0, SUN[0]), *own)) / (1e-6 * own)
    assert found.zenith_sigma[0, 0] == pytest.approx(float(np.sqrt(slope @ spread @ slope)), rel=0.02)


def test_error_bars_cover_the_truth():
    noise = 1.0 + 0.04 * np.random.default_rng(4).standard_normal((60, 145, 1))
    found = skyfit.perez_of_sky(as_sky(LIGHT[None, :, None] * noise))
    off = (found.coefficients[:, 0] - TRUTH) / found.sigma[:, 0]
    # the widths of the glow and of the horizon are skewed
    within = np.mean(np.abs(off) < 2.0, axis=0)
    assert found.settled.mean() > 0.95 and np.all(within >= 0.88), within


def test_no_patch_at_the_zenith_is_needed_and_few_are_too_few():
    light = LIGHT[None, :, None].copy()
    light[:, 120:] = np.nan
    found = skyfit.perez_of_sky(as_sky(light))
    np.testing.assert_allclose(found.coefficients[0, 0], TRUTH, rtol=1e-5)
    assert found.zenith[0, 0] == pytest.approx(LEVEL * form(0.0, SUN[0], *TRUTH), rel=1e-6)
    light[:, 6:] = np.nan
    found = skyfit.perez_of_sky(as_sky(light))
    assert not found.settled.any() and found.directions == 6 and np.isnan(found.coefficients).all()


def test_what_a_sky_does_not_tell_has_no_sigma():
    # one azimuth distance and one height: neither horizon nor glow are known
    ring = np.full(40, np.radians(50.0)), SUN[1] + np.linspace(0.5, 5.5, 40)
    light = LEVEL * form(ring[0], away(*ring), *TRUTH)
    light = light * (1.0 + 0.01 * np.random.default_rng(5).standard_normal(40))
    found = skyfit.perez_of_sky(as_sky(light[None, :, None], zenith=ring[0], azimuth=ring[1]))
    assert np.isinf(found.sigma[0, 0, :2]).all() and np.isinf(found.zenith_sigma).all()


def test_of_a_spectrum_luminance_or_each_wavelength():
    wavelength = np.arange(380.0, 781.0, 20.0)
    scale = np.linspace(1.0, 3.0, wavelength.size)
    light = 1e-5 * LIGHT[None, :, None] * scale
    usable = np.ones(light.shape, bool)
    usable[0, 3, 9] = False
    sky = as_sky(light, wavelength, usable=usable, luminance=False)
    found, each = skyfit.perez_of_sky(sky), skyfit.perez_of_sky(sky, each=True)
    assert found.light == ("luminance",) and found.directions == 144 and len(each.light) == wavelength.size
    luminance = np.asarray(skyfit.xyz(jnp.asarray(light[0]), wavelength), float)[:, 1]
    assert found.zenith[0, 0] == pytest.approx(luminance[-1], rel=1e-5)
    np.testing.assert_allclose(found.coefficients[0, 0], TRUTH, rtol=1e-5)
    np.testing.assert_allclose(each.coefficients[0], np.broadcast_to(TRUTH, (wavelength.size, 5)), rtol=1e-5)
    assert each.directions[0].tolist() == [145 - (w == 9) for w in range(wavelength.size)]
    few = as_sky(light[..., 5:8], wavelength[5:8], luminance=False)
    assert skyfit.perez_of_sky(few).light == ("480 nm", "500 nm", "520 nm")


def test_the_command_takes_a_scanners_table(tmp_path):
    noise = 1.0 + 0.05 * np.random.default_rng(6).standard_normal((2, 145))
    rows = [",".join([f"2024-06-21T1{hour}:00:00", *(f"{v:.7g}" for v in LIGHT * n)]) for hour, n in enumerate(noise)]
    (tmp_path / "scan.csv").write_text("\n".join(["# latitude: 51.5", "# longitude: -0.1", *rows]) + "\n")
    out = tmp_path / "perez.csv"
    done = CliRunner().invoke(app, ["perez", str(tmp_path / "scan.csv"), "--out", str(out)], env={"COLUMNS": "80"})
    assert done.exception is None, done.exception
    # a path stays whole
    lines = [line for line in done.output.splitlines() if not line.startswith("written: ")]
    assert all(len(line) <= 80 for line in lines if " " in line.strip())
    table = list(csv.DictReader(out.read_text().splitlines()))
    found = skyfit.perez_of_sky(read(tmp_path / "scan.csv"))
    assert [row["time"] for row in table] == ["2024-06-21T10:00:00Z", "2024-06-21T11:00:00Z"]
    for t, row in enumerate(table):
        assert float(row["backscatter"]) == pytest.approx(found.coefficients[t, 0, 4])
        assert float(row["horizon_gradient_sigma"]) == pytest.approx(found.sigma[t, 0, 1])
        both = float(row["covariance_horizon_darkening_circumsolar_width"])
        assert both == pytest.approx(found.covariance[t, 0, 0, 3])
    assert "+-" in done.output and "UTC" in done.output
    failed = CliRunner().invoke(app, ["perez", str(tmp_path / "scan.csv"), "--out", str(tmp_path / "perez.json")])
    assert isinstance(failed.exception, ValueError) and "expected a suffix of .csv" in str(failed.exception)
