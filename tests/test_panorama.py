"""Pictures of the sky read to be inverted: channels by name, the sun found, what is no sky refused."""

import json
import warnings

import numpy as np
import OpenImageIO as oiio
import pytest

import skyfit
from skyfit.image.files import read_picture, write_picture
from skyfit.image.found_sun import cosine_from_sun
from skyfit.retrieve import start_model


SUN = np.radians([50.0, 250.0])


def clear(camera, sun=SUN, colour=(0.5, 0.8, 1.2)):
    """The clear sky of CIE S 011 (type 12) over a dark ground, written out; linear, of no unit."""
    east, north, up = camera.views().astype(float)
    zenith, azimuth = np.arccos(np.clip(up, -1.0, 1.0)), np.arctan2(east, north)
    away = np.arccos(np.clip(cosine_from_sun(zenith, azimuth, *sun), -1.0, 1.0))
    gradation = 1.0 - np.exp(-0.32 / np.maximum(up, 0.01))
    lobe = 1.0 + 10.0 * (np.exp(-3.0 * away) - np.exp(-1.5 * np.pi)) + 0.45 * np.cos(away) ** 2
    sky = np.where(up > 0.0, gradation * lobe, 0.02)[..., None] * np.array(colour)
    return sky.astype(np.float32), away


def apart(found, sun=SUN):
    return np.degrees(np.arccos(np.clip(cosine_from_sun(found.zenith, found.azimuth, *sun), -1.0, 1.0)))


EQUIRECT = skyfit.Camera("equirect", 256, 128)
FISHEYE = skyfit.Camera("fisheye", 200, 200, mirrored=True, mapping="equisolid", k1=-0.02)


@pytest.mark.parametrize(
    ("camera", "told"),
    [(EQUIRECT, {}), (FISHEYE, {"projection": "fisheye:equisolid", "mirrored": True, "lens": (-0.02, 0.0)})],
)
def test_a_sun_is_found_by_the_light_around_it_whatever_the_guess(tmp_path, camera, told):
    write_picture(tmp_path / "sky.exr", clear(camera)[0], "float", {})
    for guess in (None, SUN + np.radians([20.0, 0.0]), SUN - np.radians([0.0, 26.0])):
        first = None if guess is None else (float(guess[0]), float(guess[1]))
        found = skyfit.read_panorama(tmp_path / "sky.exr", sun=first, **told)
        assert found.sun.how == "aureole" and apart(found.sun) < 0.5, guess
    assert found.sky.usable.mean() > 0.95 and found.sky.calibration_sigma == 0.9
    assert found.free == ("turbidity", "asymmetry")
    # nothing of the ground, of the horizon or of the sun's surroundings
    up = camera.views()[2]
    assert up[found.used].min() > 0.03 and clear(camera)[1][found.used].min() > np.radians(3.9)
    # every patch has the light of where it looks
    zenith, azimuth = found.sky.view_zenith[0], found.sky.view_azimuth[0]
    away = np.arccos(cosine_from_sun(zenith, azimuth, *SUN))
    gradation = 1.0 - np.exp(-0.32 / np.cos(zenith))
    expected = gradation * (1.0 + 10.0 * (np.exp(-3.0 * away) - np.exp(-1.5 * np.pi)) + 0.45 * np.cos(away) ** 2)
    ratio = found.sky.radiance[0, :, 1] / expected
    np.testing.assert_allclose(ratio / np.nanmedian(ratio), np.where(found.sky.usable[0, :, 1], 1.0, np.nan), rtol=0.03)


def test_discs_and_saturated_patches_are_the_sun(tmp_path):
    sky, away = clear(EQUIRECT)
    bright = sky.copy()
    bright[away < np.radians(1.0)] = 3e4
    write_picture(tmp_path / "disc.hdr", bright, "float", {})
    found = skyfit.read_panorama(tmp_path / "disc.hdr")
    assert found.sun.how == "disc" and apart(found.sun) < 0.4
    encoded = np.round(255.0 * np.asarray(skyfit.srgb_from_linear(np.minimum(sky / 4.0, 1.0)))).astype(np.uint8)
    write_picture(tmp_path / "cut.png", encoded, "uint8", {})
    found = skyfit.read_panorama(tmp_path / "cut.png")
    assert found.sun.how == "patch" and apart(found.sun) < 1.0
    assert any("saturated" in note for note in found.notes)
    # a sun behind a house, of which the pattern alone tells: its place is then fitted too
    mask = np.repeat((away > np.radians(30.0))[..., None], 3, axis=2)
    write_picture(tmp_path / "mask.png", 255 * mask.astype(np.uint8), "uint8", {})
    write_picture(tmp_path / "sky.exr", sky, "float", {})
    found = skyfit.read_panorama(tmp_path / "sky.exr", mask=tmp_path / "mask.png")
    assert found.sun.how == "pattern" and apart(found.sun) < 5.0
    assert found.free[2:] == ("sun_zenith_offset", "pointing_azimuth")
    assert not found.used[~mask[..., 0]].any()


def test_channels_are_found_by_name_and_encodings_undone(tmp_path):
    sky = clear(skyfit.Camera("equirect", 64, 32))[0]
    spec = oiio.ImageSpec(64, 32, 4, "float")
    spec.channelnames = ("view.B", "view.A", "view.G", "view.R")
    out = oiio.ImageOutput.create(str(tmp_path / "odd.exr"))
    alpha = np.ones((32, 64, 1), np.float32)
    alpha[:4] = 0.5
    out.open(str(tmp_path / "odd.exr"), spec)
    out.write_image(np.ascontiguousarray(np.concatenate([sky[..., 2:], alpha, sky[..., 1:2], sky[..., :1]], axis=2)))
    out.close()
    found = read_picture(tmp_path / "odd.exr")
    np.testing.assert_array_equal(found.rgb[4:], sky[4:])
    assert not found.known[:4].any() and found.known[4:].all()
    # IEC 61966-2-1, backwards
    codes = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(3, axis=2)
    write_picture(tmp_path / "codes.tif", codes, "uint8", {})
    share = codes / 255.0
    expected = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(read_picture(tmp_path / "codes.tif").rgb, expected, atol=3e-5)
    np.testing.assert_allclose(read_picture(tmp_path / "codes.tif", "linear").rgb, share, atol=1e-6)
    # ACES' primaries: their white is white
    write_picture(tmp_path / "aces.exr", sky * 0.0 + 1.0, "float", {"chromaticities": (
        0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)})  # fmt: skip
    made = read_picture(tmp_path / "aces.exr").rgb[0, 0]
    np.testing.assert_allclose(
        skyfit.light.SRGB_FROM_XYZ @ [0.32168 / 0.33767, 1.0, 0.34065 / 0.33767], made, rtol=1e-3
    )


def broken(name, folder):
    sky = clear(skyfit.Camera("equirect", 64, 32))[0]
    told, file = {}, "sky.exr"
    if name == "no picture":
        file = "sky.png"
        (folder / file).write_text("hello")
        return folder / file, told
    if name == "one channel":
        sky = sky[..., :1]
    elif name == "wide":
        sky = sky[:20]
    elif name == "all masked":
        write_picture(folder / "mask.png", np.zeros((32, 64, 3), np.uint8), "uint8", {})
        told = {"mask": folder / "mask.png"}
    elif name == "another mask":
        write_picture(folder / "mask.png", np.zeros((32, 32, 3), np.uint8), "uint8", {})
        told = {"mask": folder / "mask.png"}
    elif name == "noise":
        sky = np.random.default_rng(0).uniform(0.5, 1.0, sky.shape).astype(np.float32)
    elif name == "all NaN":
        sky = sky * np.nan
    elif name == "negative":
        sky = -sky
    elif name == "even":
        sky = np.ones_like(sky)
    elif name == "odd lens":
        told = {"projection": "fisheye:orthographic"}
    write_picture(folder / file, sky, "float", {})
    return folder / file, told


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("no picture", r"^sky\.png: expected a picture .*, found none that can be read$"),
        ("one channel", r"^sky\.exr: expected channels R, G and B, found Y$"),
        ("wide", r"^sky\.exr: expected twice as many pixels across as down .*, found 64 x 20$"),
        ("all masked", r"^sky\.exr: no pixel of sky is left: .*100 % of the sky left out: masked$"),
        ("another mask", r"^mask\.png: expected 64 x 32 pixels as the picture has, found 32 x 32$"),
        ("noise", r"^sky\.exr: no place of the sun explains"),
        ("all NaN", r"^sky\.exr: no pixel of sky is left: .*not finite"),
        ("negative", r"^sky\.exr: no pixel of sky is left: .*black or negative$"),
        ("even", r"^sky\.exr: no pixel of sky is left: .*saturated$"),
        (
            "odd lens",
            r"^`projection` must be one of equirect, fisheye or fisheye:equidistant, .*'fisheye:orthographic'$",
        ),
    ],
)
def test_what_is_no_picture_of_a_sky_is_refused_in_one_line(tmp_path, name, said):
    path, told = broken(name, tmp_path)
    with pytest.raises(ValueError, match=said) as error:
        skyfit.read_panorama(path, **told)
    assert "\n" not in str(error.value)


def test_some_bad_pixels_are_left_out_and_told(tmp_path):
    sky = clear(EQUIRECT)[0]
    sky[10:20, 30:40, 1], sky[20:30, 30:40] = np.nan, -1.0
    write_picture(tmp_path / "sky.exr", sky, "float", {})
    found = skyfit.read_panorama(tmp_path / "sky.exr")
    assert not found.used[10:30, 30:40].any() and apart(found.sun) < 0.5
    assert [note.partition(": ")[2] for note in found.notes[1:3]] == ["not finite or not opaque", "black or negative"]


@pytest.mark.slow
def test_a_sky_of_unknown_level_and_sun_comes_back(tmp_path):
    """A picture by single scattering; the fit begins with a sun that is off."""
    solver, bands = skyfit.SingleScattering.draft("flat"), np.array([450.0, 550.0, 620.0])
    response = skyfit.Response(bands, np.eye(3)[::-1], ("R", "G", "B"))
    camera = skyfit.Camera("equirect", 64, 32)
    views = camera.views(0, 16).reshape(3, -1).astype(float)
    view = skyfit.Directions(np.arccos(views[2]), np.arctan2(views[0], views[1]))
    sun = np.degrees(SUN)
    scene = skyfit.Scene.from_degrees(sun[0], view, response.wavelength_nm, sun[1])
    air = start_model(("turbidity",), 101325.0).atmosphere
    haze = skyfit.turbidity_to_optical_depth(3.0)
    air = air.replace(aerosol=skyfit.Aerosol(haze, phase=air.aerosol.phase))
    rgb = np.asarray(solver.radiance(air, scene), float) @ response.weight.T
    picture = np.full((32, 64, 3), np.median(rgb))
    picture[:16] = rgb.reshape(16, 64, 3) * np.array([1.1, 1.0, 0.9])
    write_picture(tmp_path / "sky.exr", (7e-5 * picture).astype(np.float32), "float", {})
    found = skyfit.read_panorama(tmp_path / "sky.exr", response=response)
    assert apart(found.sun) < 1.0
    off = skyfit.Sky(**{
        **vars(found.sky), "sun_zenith": found.sky.sun_zenith + np.radians(5.0),
        "sun_azimuth": found.sky.sun_azimuth - np.radians(4.0),
    })  # fmt: skip
    free = ("turbidity", *skyfit.retrieve.SUN_FREE)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = skyfit.invert(off, free, solver)
    turbidity, zenith, azimuth = fit.values[0]
    assert turbidity == pytest.approx(3.0, abs=0.15)
    there = np.degrees(off.sun_zenith[0]) + zenith, np.degrees(off.sun_azimuth[0]) + azimuth
    assert there == pytest.approx(tuple(sun), abs=0.3)


@pytest.mark.parametrize(
    ("told", "said"),
    [
        (("sky.exr",), "sky.exr: `--projection` must say how this picture lies on the sphere, equirect or fisheye"),
        (("sky.csv", "--mask", "mask.png"), "`--mask` is of a picture and must come with `--projection`"),
    ],
)
def test_the_command_refuses_in_one_line(skyfit_command, tmp_path, told, said):
    write_picture(tmp_path / "sky.exr", clear(EQUIRECT)[0], "float", {})
    done = skyfit_command("invert", *told, "--out", "new", cwd=tmp_path, check=False)
    assert done.returncode == 2 and not (tmp_path / "new").exists()
    (line,) = [line for line in done.stderr.splitlines() if line.strip()]
    assert said in line


@pytest.mark.slow
def test_the_command_writes_what_is_behind_the_clouds(skyfit_command, tmp_path):
    write_picture(tmp_path / "sky.exr", clear(skyfit.Camera("equirect", 96, 48))[0], "float", {})
    done = skyfit_command(
        "invert", "sky.exr", "--projection", "equirect", "--out", "new", "--solver", "single", "--preset", "draft",
        "--geometry", "flat", "--free", "turbidity", "--at", "48,11", "--time", "2026-06-21T14:00Z", cwd=tmp_path,
    )  # fmt: skip
    names = {"atmosphere.json", "fit.json", "fit.nc", "fit.png", "picture.png", "sky.exr"}
    assert {path.name for path in (tmp_path / "new").iterdir()} == names
    (time,) = json.loads((tmp_path / "new" / "fit.json").read_text())["times"]
    assert np.degrees(SUN[0]) == pytest.approx(time["sun_zenith_deg"], abs=0.5)
    said = " ".join(done.stdout.split())
    assert "sun: zenith" in said and "the picture is turned by" in said and "haze: aerosol optical depth" in said
    # it is a picture that can be read again, its sun in the same place
    again = skyfit.read_panorama(tmp_path / "new" / "sky.exr")
    assert apart(again.sun) < 1.0
    done = skyfit_command(
        "render", "--atmosphere", "new/atmosphere.json", "--sun-zenith", "50", "--solver", "single", "--preset",
        "draft", "--size", "64x32", "--out", "again.png", cwd=tmp_path,
    )  # fmt: skip
    assert (tmp_path / "again.png").exists()


def test_the_turbidity_of_hosek_is_that_of_the_table():
    table = skyfit.tables.read_table("hosek_turbidity.csv")
    for turbidity, depth in zip(table["hosek_turbidity"], table["aerosol_optical_depth"], strict=True):
        assert skyfit.atmosphere.hosek_turbidity(float(depth)) == pytest.approx(turbidity)
    assert np.isnan(skyfit.atmosphere.hosek_turbidity(2.0))
