"""Tables for engines: read as an engine reads them, against the solver; and what the files say of themselves."""

import json

import numpy as np
import OpenImageIO
import pytest
from skies import SPHERE
from test_air import HAZY, SMALL

import skyfit
from skyfit.image.luts import luts as tables
from skyfit.image.render import SPECTRUM, sunlight
from skyfit.light import SRGB_FROM_XYZ, xyz
from skyfit.scene import Directions


EARTH, TOP = 6371e3, 100e3
SUN, HEIGHT = np.radians(70.0), 500.0
CAMERA = skyfit.Camera("perspective", 160, 90, azimuth=2.0)


def read(table, u, v):
    """Bilinearly, with coordinates 0 to 1 in the middles of the texels at the edges."""
    from scipy.ndimage import map_coordinates

    place = np.asarray(v) * (table.shape[0] - 1), np.asarray(u) * (table.shape[1] - 1)
    return np.stack([map_coordinates(table[..., k], place, order=1) for k in range(table.shape[2])], axis=-1)


def linear(radiance):
    return np.asarray(xyz(radiance, SPECTRUM)) @ SRGB_FROM_XYZ.T


@pytest.mark.slow
def test_tables_read_as_engines_read_them_are_the_solver(monkeypatch, tmp_path):
    monkeypatch.setattr("skyfit.image.luts.VOLUME", (16, 9, 32))
    found = tables(HAZY, CAMERA, SMALL, sun_zenith=SUN, sun_azimuth=2.0, height=HEIGHT)
    field = SMALL.prepare(HAZY, SPECTRUM)

    def scene(zenith, azimuth, height=HEIGHT, sun=SUN):
        return skyfit.Scene(sun, 2.0, Directions(zenith, azimuth), SPECTRUM, sunlight(), height)

    rng = np.random.default_rng(5)
    zenith, turn = np.radians(rng.uniform(1.0, 89.5, 64)), rng.uniform(0.0, np.pi, 64)
    horizon = np.pi - np.arcsin(EARTH / (EARTH + HEIGHT))
    from_sky = read(found.sky_view, np.sqrt(0.5 - 0.5 * np.cos(turn)), 0.5 - 0.5 * np.sqrt(1.0 - zenith / horizon))
    wanted = linear(field.radiance(scene(zenith, 2.0 + turn)))
    apart = np.arccos(np.cos(SUN) * np.cos(zenith) + np.sin(SUN) * np.sin(zenith) * np.cos(turn))
    far = np.degrees(apart) > 5.0
    np.testing.assert_allclose(from_sky[far], wanted[far], rtol=0.02)
    assert np.median(np.abs(from_sky / wanted - 1.0)) < 2e-3

    heights, cosine = np.array([0.0, 900.0, 2e4, 6e4]), np.array([1.0, 0.3, 0.05, 0.01])
    radius, whole = EARTH + heights, np.sqrt(TOP * (2.0 * EARTH + TOP))
    rho, near = np.sqrt(heights * (2.0 * EARTH + heights)), TOP - heights
    away = np.sqrt((radius * cosine) ** 2 + whole**2 - rho**2) - radius * cosine
    passed = read(found.transmittance, (away - near) / (rho + whole - near), rho / whole)
    for k, height in enumerate(heights):
        path = skyfit.SingleScattering().path(
            HAZY, scene(np.arccos(cosine[[k]]), np.zeros(1), height), np.array([np.inf])
        )
        light = linear(path.transmittance * np.asarray(sunlight())[None]) / linear(np.asarray(sunlight())[None])
        np.testing.assert_allclose(passed[k], np.clip(light[0], 0.0, 1.0), atol=3e-3)

    node, weight = np.polynomial.legendre.leggauss(24)
    around = (np.arange(16) + 0.5) * np.pi / 16.0
    views = [v.ravel() for v in np.meshgrid(np.arccos(node), 2.0 + around, indexing="ij")]
    place = (2, 24)
    sun = np.arccos(2.0 * place[1] / 31.0 - 1.0)
    light = linear(field.radiance(scene(*views, place[0] / 31.0 * TOP, sun))).reshape(24, 16, 3).mean(axis=1)
    # the aureole counts as beam in the table
    np.testing.assert_allclose(found.multiple_scattering[place], 0.5 * weight @ light, rtol=0.1)

    seen = found.aerial_perspective.reshape(9, 32, 16, 4)
    middle = seen[4, 15, 7:9].mean(axis=0)
    ahead = skyfit.air_to(
        np.full((1, 1), 32e3), skyfit.Camera("perspective", 1, 1, azimuth=2.0), HAZY, SMALL,
        sun_zenith=SUN, sun_azimuth=2.0, height=HEIGHT,
    )  # fmt: skip
    np.testing.assert_allclose(middle[:3], ahead.inscatter[0, 0], rtol=0.03)
    assert middle[3] == pytest.approx(float(ahead.transmittance.mean()), rel=2e-3)

    monkeypatch.setattr("skyfit.image.luts.luts", lambda *_, **__: found)
    skyfit.write_luts(HAZY, tmp_path / "new", CAMERA, SMALL, sun_zenith=SUN, sun_azimuth=2.0, height=HEIGHT)
    told = json.loads((tmp_path / "new" / "luts.json").read_text())
    for name, table in found._asdict().items():
        entry = told["tables"][name]
        raw = OpenImageIO.ImageBuf(str(tmp_path / "new" / entry["file"]))
        values = np.asarray(raw.get_pixels(OpenImageIO.FLOAT), float)
        assert str(raw.spec().format) == "half"
        values[..., :3] *= entry.get("cd_m2_of_1", 1.0)
        np.testing.assert_allclose(values, table, rtol=1e-3, atol=1e-4 * table[..., :3].max())


def test_what_has_no_tables_is_refused(tmp_path):
    for camera, height, said in (
        (skyfit.Camera("fisheye"), 2.0, "`camera` must be a perspective one"), (CAMERA, 2e5, "`height` must be between")
    ):  # fmt: skip
        with pytest.raises(ValueError, match=said):
            skyfit.write_luts(HAZY, tmp_path, camera, SPHERE["spherical"], sun_zenith=1.0, height=height)
    assert not list(tmp_path.iterdir())
