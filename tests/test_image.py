"""Pictures: which way pixels look, that no light is lost, and that files hold what was rendered."""

import json

import colour
import numpy as np
import OpenEXR
import OpenImageIO
import PIL.Image
import pytest

import skyfit
from skyfit.draw import plot_contact_sheet
from skyfit.image.disc import add_disc, RADIUS
from skyfit.image.files import aces, read_picture
from skyfit.image.render import SPECTRUM
from skyfit.image.tone import agx
from skyfit.light import extraterrestrial_irradiance, observer_weights


CAMERAS = (
    skyfit.Camera("equirect", 48, 24, azimuth=1.0),
    skyfit.Camera("fisheye", 40, 30),
    skyfit.Camera("fisheye", 30, 30, field_of_view=2.0 * np.pi, mirrored=True),
    skyfit.Camera("fisheye", 40, 40, field_of_view=3.3, mapping="equisolid", k1=-0.02, k2=0.002),
    skyfit.Camera("fisheye", 41, 41, mapping="stereographic", k1=0.03),
    skyfit.Camera("perspective", 40, 30, azimuth=4.0, elevation=0.5, field_of_view=1.2),
    skyfit.Camera("perspective", 40, 30, azimuth=-1.0, elevation=-0.4, field_of_view=2.5),
    skyfit.Camera("cube", 192, 32, azimuth=2.0),
)
EXTENDED = skyfit.ExtendedPreetham.shipped()
SUN = {"sun_zenith": np.radians(60.0), "sun_azimuth": np.radians(240.0)}


def every(camera):
    return np.mgrid[: camera.height, : camera.width].astype(float)


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_view_falls_on_its_own_pixel(camera):
    views = camera.views()
    np.testing.assert_allclose(np.linalg.norm(views, axis=0), 1.0, rtol=1e-6)
    row, column, inside = camera.places(views.reshape(3, -1).astype(float))
    seen = camera.solid_angle(*every(camera)).ravel() > 0.0
    assert inside[seen].all()
    np.testing.assert_array_equal(np.stack([row, column])[:, seen], every(camera).reshape(2, -1)[:, seen])
    np.testing.assert_array_equal(camera.views(3, 5), views[:, 3:5])


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_pixel_sees_what_its_neighbours_leave_it(camera):
    """Its solid angle is that of the parallelogram of the steps to the pixels beside it."""
    views = camera.views().astype(float)
    middle = camera.height // 2, 5 * camera.width // 12
    down = 0.5 * (views[:, middle[0] + 1, middle[1]] - views[:, middle[0] - 1, middle[1]])
    right = 0.5 * (views[:, middle[0], middle[1] + 1] - views[:, middle[0], middle[1] - 1])
    size = camera.solid_angle(np.array(float(middle[0])), np.array(float(middle[1])))
    assert size == pytest.approx(np.linalg.norm(np.cross(down, right)), rel=0.02)
    # seen from inside, with down below and right to the right, unless mirrored
    outward = np.cross(right, down) @ views[:, middle[0], middle[1]]
    as_map = camera.projection == "fisheye" and not camera.mirrored
    assert np.sign(outward) == (-1.0 if as_map else 1.0)


def test_lenses_keep_what_their_names_say():
    """Equal areas; equal angles; and the perfect lens bent by the polynomial of its distortion."""
    equal = skyfit.Camera("fisheye", 64, 64, mapping="equisolid")
    size = equal.solid_angle(*every(equal))
    np.testing.assert_allclose(size[size > 0.0], 4.0 * np.pi * np.sin(np.pi / 4) ** 2 / (np.pi * 32.0**2), rtol=1e-9)
    alike = skyfit.Camera("fisheye", 65, 65, mapping="stereographic").views().astype(float)
    # a step outward is as long as a step aside
    out, aside = alike[:, 32, 61] - alike[:, 32, 59], alike[:, 33, 60] - alike[:, 31, 60]
    assert np.linalg.norm(out) == pytest.approx(np.linalg.norm(aside), rel=2e-3)
    bent = skyfit.Camera("fisheye", 201, 201, k1=0.05, k2=-0.01)
    angle = np.arccos(bent.views()[2, 100, 100:200].astype(float))
    reach = angle + 0.05 * angle**3 - 0.01 * angle**5
    edge = 0.5 * np.pi * (1.0 + 0.05 * (0.5 * np.pi) ** 2 - 0.01 * (0.5 * np.pi) ** 4)
    np.testing.assert_allclose(reach / edge, np.arange(100) / 100.5, atol=3e-4)


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ({"mapping": "stereographic", "field_of_view": 2.0 * np.pi}, "`field_of_view` must be one that the lens"),
        ({"k1": -0.3}, "`field_of_view` must be one that the lens spreads out, got 180 degrees with equidistant"),
        ({"projection": "perspective", "k1": 0.1}, "must be left out with"),
        ({"projection": "perspective", "field_of_view": 3.0}, "`field_of_view` must be between"),
    ],
)
def test_a_lens_that_folds_the_sphere_is_refused(told, said):
    with pytest.raises(ValueError, match=said):
        skyfit.Camera(**{"projection": "fisheye", "width": 40, "height": 40} | told)


def test_the_whole_sphere_and_where_things_are():
    camera = CAMERAS[0]
    assert camera.solid_angle(*every(camera)).sum() == pytest.approx(4.0 * np.pi, rel=1e-6)
    # zenith on top, the named azimuth in the middle, growing to the right
    views = camera.views()
    assert views[2, 0].min() > 0.99 and np.arctan2(*views[:2, 12, 24]) == pytest.approx(1.0, abs=0.1)
    assert np.arctan2(*views[:2, 12, 30]) > 1.5
    fisheye = skyfit.Camera("fisheye", 101, 101)
    east = fisheye.views()[:, 50, 90]
    assert east[0] > 0.9 and fisheye.views()[1, 10, 50] > 0.9 and fisheye.views()[2, 50, 50] == 1.0
    assert skyfit.Camera("fisheye", 101, 101, mirrored=True).views()[0, 50, 90] < -0.9
    cube = skyfit.Camera("cube", 72, 12, azimuth=2.0)
    assert cube.solid_angle(*every(cube)).sum() == pytest.approx(4.0 * np.pi, rel=2e-3)
    faces = cube.views().reshape(3, 12, 6, 12)
    # the middles of the faces: right, left, up, down, ahead, behind
    middles = faces[:, 5:7, :, 5:7].mean(axis=(1, 3))
    level = [skyfit.unit_vectors(0.5 * np.pi, 2.0 + turn) for turn in (0.5 * np.pi, -0.5 * np.pi, 0.0, np.pi)]
    wanted = np.stack([*level[:2], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], *level[2:]], axis=1)
    np.testing.assert_allclose(middles, wanted, atol=0.02)
    # the sides stand upright; who looks up has what is behind on top
    assert all(faces[2, 0, face, 6] > 0.5 > -0.5 > faces[2, -1, face, 6] for face in (0, 1, 4, 5))
    assert faces[:, 0, 2, 6] @ level[3] > 0.5 and faces[:, 0, 3, 6] @ level[2] > 0.5
    narrow = skyfit.Camera("perspective", 3, 3, azimuth=0.5, elevation=0.3, field_of_view=0.1)
    np.testing.assert_allclose(narrow.views()[:, 1, 1], skyfit.unit_vectors(0.5 * np.pi - 0.3, 0.5), atol=1e-6)
    assert narrow.views()[2, 0, 1] > narrow.views()[2, 2, 1]


@pytest.mark.parametrize(
    "camera",
    (
        skyfit.Camera("equirect", 64, 32),
        skyfit.Camera("equirect", 4096, 2048),
        skyfit.Camera("fisheye", 64, 64),
        skyfit.Camera("cube", 192, 32),
        skyfit.Camera("perspective", 256, 256, azimuth=0.7, elevation=np.radians(20.0), field_of_view=0.02),
    ),
)
def test_the_disc_keeps_its_light_at_any_resolution(camera):
    picture = np.zeros((camera.height, camera.width, 3))
    beam = np.array([9.0, 10.0, 8.0])
    add_disc(picture, camera, np.radians(70.0), 0.7, beam)
    row, column = np.nonzero(picture[..., 1])
    size = camera.solid_angle(row.astype(float), column.astype(float))
    np.testing.assert_allclose(size @ picture[row, column], beam, rtol=1e-9)
    # as wide as the sun, and darker toward the limb, in blue more
    views = camera.views()[:, row, column]
    away = np.arccos(np.clip(skyfit.unit_vectors(np.radians(70.0), 0.7) @ views, -1.0, 1.0))
    assert away.max() < RADIUS + 1.5 * np.sqrt(size.max())
    if camera.projection == "perspective":
        assert away.max() == pytest.approx(RADIUS, rel=0.02)
        inner, outer = (picture[row[w], column[w]].mean(axis=0) for w in (away < 0.2 * RADIUS, away > 0.9 * RADIUS))
        darker = outer / inner
        assert 0.4 < darker[1] < 0.7 and darker[2] < darker[1] < darker[0]


def test_a_picture_is_as_large_as_its_projection_usually_is():
    sizes = {name: (c.width, c.height) for name in ("equirect", "cube", "fisheye") for c in [skyfit.Camera(name)]}
    assert sizes == {"equirect": (1024, 512), "cube": (1536, 256), "fisheye": (1024, 1024)}
    with pytest.raises(ValueError, match="`width` and `height` must be given together"):
        skyfit.Camera("equirect", 64)


def test_the_disc_stands_where_the_sun_is_seen():
    """Light comes from half way between the true and the apparent sun; the disc, and the lamp, are at the apparent."""
    camera = skyfit.Camera("perspective", 200, 100, azimuth=SUN["sun_azimuth"], elevation=0.03, field_of_view=0.15)
    seen = np.radians(88.0)
    asked = {"turbidity": 3.0, "sun_zenith": np.radians(88.3), "sun_azimuth": SUN["sun_azimuth"]}
    with_disc = skyfit.render(EXTENDED, camera, **asked, sun_seen_zenith=seen)
    disc = with_disc.xyz[..., 1] - skyfit.render(EXTENDED, camera, **asked, sun="none").xyz[..., 1]
    place = np.einsum("rc,xrc->x", disc, camera.views()) / disc.sum()
    assert np.arccos(place[2] / np.linalg.norm(place)) == pytest.approx(seen, abs=2e-4)
    assert with_disc.lamp.sun_zenith == seen


def test_a_sun_that_the_camera_does_not_see_leaves_no_light():
    camera = skyfit.Camera("perspective", 32, 32, azimuth=0.0, elevation=0.3, field_of_view=1.0)
    picture = np.zeros((32, 32, 3))
    add_disc(picture, camera, np.radians(70.0), np.pi, np.ones(3))
    assert not picture.any()


def test_the_horizon_hides_half_of_a_setting_disc():
    camera = skyfit.Camera("perspective", 200, 200, azimuth=0.0, field_of_view=0.02)
    picture = np.zeros((200, 200, 3))
    add_disc(picture, camera, 0.5 * np.pi, 0.0, np.ones(3))
    light = np.sum(picture[..., 1] * camera.solid_angle(*every(camera)))
    assert light == pytest.approx(0.5, abs=0.01) and not picture[100:].any()


def on_a_plane(image):
    """Illuminance on level ground, lx."""
    row, column = every(image.camera)
    up = image.camera.views()[2]
    return float(np.sum(image.xyz[..., 1] * image.camera.solid_angle(row, column) * np.maximum(up, 0.0)))


def test_a_formula_is_rendered_as_it_says_and_lights_a_plane():
    camera = skyfit.Camera("equirect", 512, 256)
    image = skyfit.render(EXTENDED, camera, turbidity=3.0, sun="none", **SUN)
    views = skyfit.hemisphere(4000)
    scene = skyfit.Scene(SUN["sun_zenith"], SUN["sun_azimuth"], views, SPECTRUM, np.ones(SPECTRUM.size))
    xyz = np.asarray(EXTENDED.xyz(3.0, scene))
    row, column, _ = camera.places(np.asarray(skyfit.unit_vectors(views.zenith, views.azimuth), float))
    found = image.xyz[row.astype(int), column.astype(int)]
    # a pixel is a third of a degree off the view at most
    assert np.median(np.abs(found / xyz - 1.0)) < 0.01
    dome = float(np.sum(xyz[:, 1] * np.cos(views.zenith) * views.weight))
    assert on_a_plane(image) == pytest.approx(dome, rel=3e-3)
    beam = image.lamp.irradiance[1] * np.cos(SUN["sun_zenith"])
    lit = skyfit.render(EXTENDED, camera, turbidity=3.0, ground_albedo=0.3, **SUN)
    assert on_a_plane(lit) == pytest.approx(dome + beam, rel=5e-3)
    # the ground sends back its share of both
    assert lit.xyz[-1, 0, 1] == pytest.approx(0.3 / np.pi * (dome + beam), rel=0.01)


def test_between_the_directions_that_a_solver_is_asked_for_its_light_is_right():
    solver, air = skyfit.SingleScattering(16, "spherical"), skyfit.Atmosphere.from_turbidity(3.0)
    camera = skyfit.Camera("fisheye", 301, 301, field_of_view=np.radians(178.0))
    image = skyfit.render(air, camera, solver=solver, sun="none", **SUN)
    off = compared(image, lambda scene: solver.radiance(air, scene), None)
    assert off.max() < 5e-3 and np.median(off) < 3e-4
    # a round picture in black
    assert image.made_by == "SingleScattering" and not image.xyz[0, 0].any() and image.xyz[0, 150, 1] > 0.0


def compared(image, radiance, height, count=300, edge=0.006):
    """Relative differences of Y of random pixels, and of those near the sun, from the solver itself.

    `edge`: the cosine of views that are too near to the horizon.
    """
    random = np.random.default_rng(3)
    views = image.camera.views()
    lamp = image.lamp
    near = np.einsum("c,crx->rx", np.asarray(skyfit.unit_vectors(lamp.sun_zenith, lamp.sun_azimuth)), views)
    row, column = random.integers(0, views.shape[1], count), random.integers(0, views.shape[2], count)
    around = np.argwhere((near > np.cos(np.radians(6.0))) & (near < np.cos(np.radians(0.4))))
    if len(around):
        around = around[random.integers(0, len(around), 50)]
        row, column = np.concatenate([row, around[:, 0]]), np.concatenate([column, around[:, 1]])
    kept = image.camera.solid_angle(row, column) > 0.0
    # below, the ground is not the solver's
    kept &= (views[2, row, column] > edge) | ((height is not None) & (views[2, row, column] < -edge))
    row, column = row[kept], column[kept]
    zenith = np.arccos(np.clip(views[2, row, column].astype(float), -1.0, 1.0))
    azimuth = np.arctan2(*views[:2, row, column].astype(float))
    sun = extraterrestrial_irradiance(SPECTRUM, 20.0)
    scene = skyfit.Scene(lamp.sun_zenith, lamp.sun_azimuth, skyfit.Directions(zenith, azimuth), SPECTRUM, sun, height)
    true = np.asarray(skyfit.xyz(radiance(scene), SPECTRUM))
    return np.abs(image.xyz[row, column, 1] / true[:, 1] - 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(("sun", "height"), ((60.0, 2.0), (94.0, 2.0), (70.0, 1e4)))
def test_spherical_skies_from_the_ground_and_aloft(sun, height):
    solver, air = skyfit.Spherical.draft(), skyfit.Atmosphere.from_turbidity(3.0)
    camera = skyfit.Camera("equirect", 400, 200, azimuth=0.5)
    seen = {"sun_zenith": np.radians(sun), "sun_azimuth": 0.5, "height": height, "sun": "none", "solver": solver}
    image = skyfit.render(air, camera, **seen)
    off = compared(image, lambda scene: solver.radiance(air, scene), height)
    assert off.max() < 5e-3 and np.median(off) < 3e-4
    assert np.all(np.isfinite(image.xyz)) and image.xyz.min() >= 0.0
    if height == 2.0:
        narrow = skyfit.Camera("perspective", 100, 100, azimuth=0.5, field_of_view=np.radians(1.0))
        image_of_edge = skyfit.render(air, narrow, **seen)
        assert compared(image_of_edge, lambda scene: solver.radiance(air, scene), height, edge=1e-3).max() < 0.02
        light = solver.fluxes(
            air, skyfit.Scene(np.radians(sun), 0.5, skyfit.hemisphere(1), SPECTRUM,
                              extraterrestrial_irradiance(SPECTRUM, 20.0))
        )  # fmt: skip
        beam = image.lamp.irradiance[1] * max(np.cos(np.radians(sun)), 0.0)
        diffuse = float(skyfit.xyz(light.diffuse_down, SPECTRUM)[1])
        assert on_a_plane(image) == pytest.approx(diffuse, rel=0.02)
        assert beam == pytest.approx(float(skyfit.xyz(light.direct, SPECTRUM)[1]), rel=1e-3, abs=1e-6)


def test_a_spectral_picture_has_the_solvers_radiances_and_its_file_is_read_by_others(tmp_path):
    solver, air = skyfit.SingleScattering.draft(), skyfit.Atmosphere.from_turbidity(3.0)
    camera = skyfit.Camera("equirect", 64, 32, azimuth=0.5)
    seen = {"sun_zenith": 0.7, "sun_azimuth": 0.5, "solver": solver}
    plain = skyfit.render(air, camera, **seen)
    image = skyfit.render(air, camera, **seen, spectral=True)
    assert plain.spectrum is None and image.spectrum is not None
    np.testing.assert_array_equal(image.spectrum.wavelength_nm, SPECTRUM)
    assert image.spectrum.radiance.shape == (32, 64, SPECTRUM.size)
    np.testing.assert_allclose(image.xyz, plain.xyz, rtol=5e-3, atol=1e-3 * np.median(plain.xyz))
    np.testing.assert_allclose(image.lamp.irradiance, plain.lamp.irradiance, rtol=1e-6)
    row, column = np.array([4, 9, 14]), np.array([5, 20, 60])
    east, north, up = camera.views()[:, row, column].astype(float)
    views = skyfit.Directions(np.arccos(up), np.arctan2(east, north))
    sun = extraterrestrial_irradiance(SPECTRUM, 20.0)
    expected = solver.radiance(air, skyfit.Scene(0.7, 0.5, views, SPECTRUM, sun))
    np.testing.assert_allclose(image.spectrum.radiance[row, column], expected, rtol=5e-3)
    # the light of the disc is the beam, whatever pixels it falls on
    without = skyfit.render(air, camera, **seen, spectral=True, sun="none")
    place = np.mgrid[:32, :64]
    disc = np.einsum("rcw,rc->w", image.spectrum.radiance - without.spectrum.radiance, camera.solid_angle(*place))
    assert disc @ observer_weights(SPECTRUM)[:, 1] == pytest.approx(image.lamp.irradiance[1], rel=1e-3)
    image.save(tmp_path / "a.exr", spectral=True)
    found = colour.read_spectral_image_Fichet2021(str(tmp_path / "a.exr"))
    wavelength, radiance = found["S0"]
    np.testing.assert_allclose(wavelength, SPECTRUM)
    np.testing.assert_allclose(radiance, image.spectrum.radiance, rtol=1e-6)
    np.testing.assert_allclose(read_picture(tmp_path / "a.exr").rgb, image.rgb(), rtol=1e-5, atol=1e-3)
    with pytest.raises(ValueError, match="`spectral` needs a picture with a spectrum"):
        plain.save(tmp_path / "b.exr", spectral=True)
    with pytest.raises(ValueError, match="`spectral` must be left out with an analytic sky"):
        skyfit.render(EXTENDED, camera, turbidity=3.0, sun_zenith=0.7, spectral=True)
    assert not (tmp_path / "b.exr").exists()


@pytest.mark.slow
def test_the_limb_from_space_fades_into_black():
    solver, air = skyfit.Spherical.draft(), skyfit.Atmosphere.from_turbidity(2.0)
    camera = skyfit.Camera("perspective", 40, 200, azimuth=0.5, elevation=np.radians(-19.0), field_of_view=0.014)
    image = skyfit.render(
        air, camera, sun_zenith=np.radians(100.0), sun_azimuth=0.5, height=400e3, sun="none", solver=solver
    )
    row = image.xyz[:, 20, 1].astype(float)
    assert row[0] == 0.0 and row[-1] > 0.0
    lit = np.flatnonzero(row > 1e-3 * row.max())
    views = image.camera.views()[:, lit[::8], 20].astype(float)
    there = skyfit.Directions(np.arccos(views[2]), np.arctan2(views[0], views[1]))
    sun = extraterrestrial_irradiance(SPECTRUM, 20.0)
    scene = skyfit.Scene(np.radians(100.0), 0.5, there, SPECTRUM, sun, 400e3)
    true = np.asarray(skyfit.xyz(solver.radiance(air, scene), SPECTRUM))[:, 1]
    off = np.abs(row[lit[::8]] / true - 1.0)
    # the horizon cuts a pixel
    assert np.sort(off)[-2] < 0.02 and np.median(off) < 2e-3
    # up there the sun is ten degrees above the limb, and no air before it
    space = float(skyfit.xyz(sun, SPECTRUM)[1])
    assert image.lamp.irradiance[1] == pytest.approx(space, rel=1e-3)
    # no light above that is not there
    assert np.all(np.diff(row[: lit[0]]) > -1e-3 * row.max())


@pytest.fixture(scope="module")
def image():
    return skyfit.render(EXTENDED, skyfit.Camera("equirect", 64, 32), turbidity=3.0, **SUN)


def test_files_hold_the_picture(image, tmp_path):
    image.save(tmp_path / "a.exr")
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        header, pixels = file.header(), file.channels()["RGB"].pixels
        np.testing.assert_array_equal(pixels, image.rgb())
        assert header["whiteLuminance"] == 1.0 and "zenith on top" in header["comments"]
        np.testing.assert_allclose(header["chromaticities"][:2], (0.64, 0.33), atol=1e-6)
    image.save(tmp_path / "b.exr", half=True, space="xyz")
    with OpenEXR.File(str(tmp_path / "b.exr")) as file:
        scale, pixels = file.header()["whiteLuminance"], file.channels()["RGB"].pixels
        assert pixels.dtype == np.float16 and np.isfinite(pixels).all() and scale > 1.0
        np.testing.assert_allclose(pixels.astype(float) * scale, image.xyz, rtol=1e-3, atol=scale * 1e-4)
    image.save(tmp_path / "a.hdr")
    assert (tmp_path / "a.hdr").read_bytes().startswith(b"#?RADIANCE")
    shared_exponent = OpenImageIO.ImageBuf(str(tmp_path / "a.hdr")).get_pixels(OpenImageIO.FLOAT)
    linear = np.maximum(image.rgb(), 0.0)
    assert np.all(np.abs(shared_exponent - linear) <= linear.max(axis=2, keepdims=True) / 128.0)
    image.save(tmp_path / "a.png", exposure=14.0, tone="clip")
    png = np.asarray(PIL.Image.open(tmp_path / "a.png"))
    expected = image.developed(14.0, tone="clip")
    assert png.shape == (32, 64, 3) and np.abs(png / 255.0 - expected).max() <= 0.5 / 255.0 + 1e-6
    # blue above, and the sun white
    assert png[4, 5, 2] > png[4, 5, 0] and png.max() == 255
    image.save_lamp(tmp_path / "lamp.json")
    lamp = json.loads((tmp_path / "lamp.json").read_text())
    assert lamp["toward_east_north_up"][2] == pytest.approx(0.5) and 4e4 < lamp["illuminance_lx"] < 1.2e5
    with pytest.raises(ValueError, match="must end in .exr, .hdr or .png"):
        image.save(tmp_path / "a.jpg")
    with pytest.raises(ValueError, match="are of an .exr"):
        image.save(tmp_path / "b.hdr", space="acescg")
    with pytest.raises(ValueError, match="existing folder"):
        image.save(tmp_path / "no" / "a.png")


def agx_by_polynomial(colours):
    """Matrices and the polynomial of Wrensch 2023, whose mean square from AgX's own table he states as 3.7e-6."""
    into = [[0.842479, 0.0784336, 0.0792237], [0.0423282, 0.878469, 0.0791661], [0.0423757, 0.0784336, 0.879143]]
    out = [[1.196879, -0.098021, -0.0990297], [-0.052897, 1.151903, -0.0989612], [-0.052972, -0.0980434, 1.151074]]
    place = np.clip((np.log2(colours @ np.transpose(into)) + 12.47393) / 16.5, 0.0, 1.0)
    return np.polyval([15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232], place) @ np.transpose(out)


def test_the_curve_of_agx(image):
    ramp = np.repeat(0.18 * np.exp2(np.linspace(-10.0, 6.5, 400))[None, :, None], 3, axis=2)
    off = agx(ramp) - np.clip(agx_by_polynomial(ramp), 0.0, 1.0)
    assert np.abs(off).max() < 6e-3 and np.sqrt(np.mean(off**2)) < 3e-3
    colours = np.random.default_rng(3).uniform(0.0, 2.0, (1, 50, 3))
    np.testing.assert_allclose(agx(colours), np.clip(agx_by_polynomial(colours), 0.0, 1.0), atol=0.012)
    ends = agx(np.array([[[0.18, 0.18, 0.18], [-1.0, 0.0, 0.0], [1e9, 0.0, 0.0]]]))
    np.testing.assert_allclose(ends, np.repeat([[[0.5], [0.0], [1.0]]], 3, axis=2), atol=1e-12)
    picture = image.developed(tone="agx")
    assert picture.shape == image.xyz.shape and np.isfinite(picture).all() and 0.2 < picture.mean() < 0.8


def test_the_curve_of_aces(image):
    """Grey of 18 % at a tenth of white, as its makers set it; grey stays grey, brighter is brighter."""
    ramp = np.append(0.18, np.geomspace(1e-3, 1e3, 30)).astype(np.float32)
    shown = aces(np.repeat(ramp[None, :, None], 3, axis=2))[0]
    assert np.ptp(shown, axis=1).max() < 2e-3 and np.all(np.diff(shown[1:, 1]) > -1e-5) and shown.max() <= 1.0
    assert ((shown[0, 1] + 0.055) / 1.055) ** 2.4 == pytest.approx(0.1, rel=0.02)
    picture = image.developed(tone="aces")
    assert picture.shape == image.xyz.shape and np.isfinite(picture).all() and 0.2 < picture.mean() < 0.8


def test_colours_are_those_of_the_spaces(image):
    import colour

    for space, name in (("srgb", "sRGB"), ("rec2020", "ITU-R BT.2020"), ("acescg", "ACEScg")):
        known = colour.XYZ_to_RGB(image.xyz.astype(float), name, colour.CCS_ILLUMINANTS[
            "CIE 1931 2 Degree Standard Observer"]["D65"], chromatic_adaptation_transform="Bradford")  # fmt: skip
        np.testing.assert_allclose(image.rgb(space), known, rtol=2e-3, atol=1e-3 * np.abs(known).max())
    # daylight of 5000 K is white after the balance to it
    white = colour.xy_to_XYZ(colour.temperature.CCT_to_xy_CIE_D(5000.0))
    one = skyfit.Image(np.asarray(white, np.float32)[None, None], image.camera, image.lamp, "a test")
    np.testing.assert_allclose(one.rgb("srgb", 5000.0), 1.0, atol=2e-3)
    with pytest.raises(ValueError, match="`white_balance` must be"):
        image.rgb("srgb", 100.0)


def test_the_law_of_exposure_is_even(image):
    assert image.white(15.0) == 2.0 * image.white(14.0)
    brighter = skyfit.Image(image.xyz * 10.0, image.camera, image.lamp, "a test")
    assert brighter.white() / image.white() == pytest.approx(10.0**0.93, rel=1e-4)
    # the sun has no say in it
    without = skyfit.render(EXTENDED, image.camera, turbidity=3.0, sun="none", **SUN)
    assert image.white() == pytest.approx(without.white(), rel=0.01)


@pytest.mark.parametrize(
    ("change", "said"),
    (
        ({"turbidity": None}, "must come with `turbidity`"),
        ({"height": -1.0}, "`height`"),
        ({"ground_albedo": 2.0}, "`ground_albedo`"),
        ({"turbidity": 60.0}, "turbidity"),
    ),
)
def test_what_cannot_be_rendered_is_refused(change, said):
    with pytest.raises(ValueError, match=said):
        skyfit.render(EXTENDED, CAMERAS[0], **({"turbidity": 3.0} | SUN | change))
    with pytest.raises(ValueError, match="`turbidity` must be left out"):
        skyfit.render(skyfit.Atmosphere.from_turbidity(2.0), turbidity=3.0, **SUN)
    with pytest.raises(ValueError, match="`height` must be left at 2 m"):
        skyfit.render(skyfit.Atmosphere.from_turbidity(2.0), solver=skyfit.SingleScattering(), height=1e4, **SUN)
    with pytest.raises(ValueError, match="`width` must be"):
        skyfit.Camera("equirect", 0, 8)
    with pytest.raises(ValueError, match="6 times"):
        skyfit.Camera("cube", 100, 50)
    with pytest.raises(ValueError, match="`mirrored` must be left out"):
        skyfit.Camera(mirrored=True)


def test_a_sheet_of_many_pictures_has_an_even_choice(image, tmp_path):
    image.save(tmp_path / "a.png")
    pictures, titles = [tmp_path / "a.png"] * 100, [f"number {k}" for k in range(100)]
    plot_contact_sheet(pictures, titles, tmp_path / "sheet.png")
    # 48 of 64 x 32 pixels in rows of five
    with PIL.Image.open(tmp_path / "sheet.png") as sheet:
        width, height = sheet.size
    assert width == 1650 and 1500 < height < 2400
    for wrong in (([], []), (pictures, titles[1:])):
        with pytest.raises(ValueError, match="`pictures` must be one or more"):
            plot_contact_sheet(*wrong, tmp_path / "other.png")
    assert not (tmp_path / "other.png").exists()


def test_the_command_writes_a_picture_and_a_lamp(skyfit_command, tmp_path):
    asked = "--sun-zenith", 70, "--sun-azimuth", 200, "--size", "64x32", "--solver", "extended", "--sun", "lamp"
    done = skyfit_command("render", "--out", "a.exr", *asked, cwd=tmp_path)
    assert "zenith on top" in done.stdout and "azimuth 200 degrees" in " ".join(done.stdout.split())
    image = skyfit.render(
        EXTENDED, skyfit.Camera("equirect", 64, 32, azimuth=np.radians(200.0)), turbidity=3.0, sun="none",
        sun_zenith=np.radians(70.0), sun_azimuth=np.radians(200.0),
    )  # fmt: skip
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        np.testing.assert_allclose(file.channels()["RGB"].pixels, image.rgb(), rtol=1e-4, atol=1e-2)
    assert json.loads((tmp_path / "a.lamp.json").read_text())["sun_zenith_deg"] == pytest.approx(70.0)
    # the file says which error its solver was chosen for
    words = "--out", "b.png", "--sun-zenith", 60, "--tolerance", "100%", "--size", "32x16"
    assert "white" in skyfit_command("render", *words, cwd=tmp_path).stdout
    with PIL.Image.open(tmp_path / "b.png") as picture:
        assert "SingleScattering" in picture.info["Description"] and "error to expect: " in picture.info["Description"]


@pytest.mark.parametrize(
    ("words", "said"),
    (
        (("--sun-zenith", 60, "--solver", "mine"), "`--solver` must be one of"),
        (("--sun-zenith", 60, "--size", "64"), "`--size` must be WxH"),
        (("--sun-zenith", 60, "--frames", 3), "`--frames` must come with `--until`"),
        (("--sun-zenith", 60, "--half"), "`space`, `half` and `spectral` are of an .exr"),
        (("--sun-zenith", 91, "--solver", "published"), "`--sun-zenith` must be between 0 and 90"),
        (("--sun-zenith", 120), "`--sun-zenith` must be between 0 and 108"),
        (("--sun-zenith", 60, "--solver", "extended", "--atmosphere", "a.toml"), "`--atmosphere` must be left out"),
    ),
)
def test_the_command_says_what_is_wrong_in_a_line(skyfit_command, tmp_path, words, said):
    done = skyfit_command("render", "--out", "a.png", *words, cwd=tmp_path, check=False)
    assert done.returncode == 2 and len(done.stderr.strip().splitlines()) == 1 and said in done.stderr
    assert not (tmp_path / "a.png").exists()


def test_a_time_lapse_goes_on_where_it_ended(skyfit_command, tmp_path):
    words = (
        "render", "--out", "day.png", "--at", "48,11", "--time", "2026-06-21T16:00Z", "--until", "2026-06-21T18:00Z",
        "--solver", "extended", "--size", "32x16",
    )  # fmt: skip
    done = skyfit_command(*words, "--frames", 3, cwd=tmp_path)
    names = ["day.0001.png", "day.0002.png", "day.0003.png", "day.png.frames.json", "day.sheet.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names and "16:00:00Z" in done.stdout
    kept = tmp_path / "day.0001.png"
    before, frame = kept.stat().st_mtime_ns, (tmp_path / "day.0002.png").read_bytes()
    (tmp_path / "day.0002.png").unlink()
    skyfit_command(*words, "--frames", 3, cwd=tmp_path)
    assert kept.stat().st_mtime_ns == before and (tmp_path / "day.0002.png").read_bytes() == frame
    # the sun goes down: the picture before is brighter by day's law
    light = [np.asarray(PIL.Image.open(tmp_path / name)).mean() for name in names[:3]]
    assert light[0] > light[2]
    refused = skyfit_command(*words, "--frames", 4, cwd=tmp_path, check=False)
    assert refused.returncode == 2 and "frames of other settings" in refused.stderr
    for wrong in (
        ("--frames", 1),
        (),
        ("--frames", 3, "--until", "2026-06-21T15:00Z"),
        ("--frames", 3, "--until", "x"),
        ("--frames", 3, "--sun-zenith", 60),
    ):
        refused = skyfit_command(*words, *wrong, cwd=tmp_path, check=False)
        assert refused.returncode == 2 and len(refused.stderr.strip().splitlines()) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == names
