"""Picture files and the tone curve of ACES, by OpenImageIO."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Num

from ..extras import require
from ..light import SRGB_FROM_XYZ
from ..measured import atomic
from .camera import Camera


Kind = Literal["float", "half", "uint8"]
Encoding = Literal["linear", "srgb"]
# Share of white above which a channel of integers counts as saturated
_FULL = 0.98
# If at least this many pixels have the largest value of a channel of floats, that value counts as saturation
_SAME = 20
# Chromaticity x, y of red, green, blue and white of sRGB: IEC 61966-2-1:1999
_SRGB = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
# Names in OpenColorIO's configuration; a display's white is 100 cd m^-2 there, and the scene's 1
_DISPLAY, _VIEW, _LINEAR = "sRGB - Display", "ACES 2.0 - SDR 100 nits (Rec.709)", "Linear Rec.709 (sRGB)"
_CONFIG = "ocio://cg-config-v4.0.0_aces-v2.0_ocio-v2.5"


def write_picture(
    path: Path,
    pixels: Num[np.ndarray, "row column channel"],
    kind: Kind,
    about: Mapping[str, str | float | tuple[float, ...]],
    names: Sequence[str] | None = None,
) -> None:
    """Write a picture in the format given by the file's suffix.

    **Arguments:** `pixels`, the top row first; `kind` of number in the file; `about`, attributes by their OpenImageIO
    names; each format keeps those that it knows; `names` of the channels, None: as the format has them.
    **Errors:** `OSError` if the file cannot be written.
    """
    require("OpenImageIO")
    import OpenImageIO as oiio

    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, kind)
    if names is not None:
        spec.channelnames = tuple(names)
    for name, value in about.items():
        if isinstance(value, tuple):
            spec.attribute(name, oiio.TypeDesc(f"float[{len(value)}]"), value)
        else:
            spec.attribute(name, value)
    with atomic(path) as part:
        out = oiio.ImageOutput.create(str(part))
        done = out is not None and out.open(str(part), spec) and out.write_image(np.ascontiguousarray(pixels))
        if out is None or not (out.close() and done):
            raise OSError(oiio.geterror() if out is None else out.geterror())


@dataclass(frozen=True)
class Pixels:
    """The contents of a picture file: `rgb`, linear sRGB in an arbitrary unit, the top row first.

    `known`: mask of pixels whose channels are finite and which are opaque; `full`: mask of pixels with a channel at the
    largest value that the file or the camera can hold; `notes`: the assumptions made.
    """

    rgb: Float[np.ndarray, "row column 3"]
    known: Bool[np.ndarray, "row column"]
    full: Bool[np.ndarray, "row column"]
    notes: tuple[str, ...]


def read_picture(path: Path, encoding: Encoding | None = None) -> Pixels:
    """Read the red, green and blue channels of a picture, found by name.

    **Arguments:** `encoding` of the numbers; None: sRGB's curve for integers, linear for floats. If an EXR states other
    primaries, its colours are converted to those of sRGB.
    **Errors:** `ValueError` if the file is no picture, or has no red, green and blue.
    """
    raw, names, whole, primaries, alpha = _read(path)
    places = _channels(path, names)
    rgb = np.ascontiguousarray(raw[..., places])
    notes = []
    if encoding is None:
        encoding = "srgb" if whole else "linear"
        kind = "whole" if whole else "real"
        curve = "encoded by sRGB's curve" if whole else "linear"
        notes.append(f"{kind} numbers taken as {curve}, for `encoding` does not say")
    known = np.all(np.isfinite(rgb), axis=2)
    if alpha is not None:
        known &= raw[..., alpha] >= 1.0 - 1e-3
        notes.append("pixels that are not opaque left out")
    rgb = np.where(known[..., None], rgb, 0.0)
    if whole:
        full = rgb.max(axis=2) >= _FULL
    else:
        top = rgb.max(axis=(0, 1))
        at_top = (rgb >= top) & (top > 0.0)
        full = np.any(at_top & (at_top.sum(axis=(0, 1)) >= _SAME), axis=2)
    if encoding == "srgb":
        rgb = _decoded(rgb)
    if primaries is not None and not np.allclose(primaries, _SRGB, atol=2e-3):
        rgb = rgb @ _to_srgb(primaries).astype(np.float32).T
        notes.append("converted from the primaries that the file states to those of sRGB")
    return Pixels(rgb.astype(np.float32), known, full, tuple(notes))


def read_mask(path: Path) -> Bool[np.ndarray, "row column"]:
    """A mask from a picture: True where the mean of its colour channels is above one half.

    **Errors:** `ValueError` if the file is no picture.
    """
    raw, names, _, _, alpha = _read(path)
    colours = [place for place in range(len(names)) if place != alpha]
    return np.asarray(np.nan_to_num(raw[..., colours]).mean(axis=2) > 0.5)


def reduced(
    pixels: Pixels, allowed: Bool[np.ndarray, "row column"], camera: Camera, widest: int
) -> tuple[Pixels, Bool[np.ndarray, "row column"], Camera]:
    """A picture and its mask reduced to at most `widest` pixels on a side, by averages over areas.

    A reduced pixel is known or allowed if all pixels in it are, and full if any is.
    """
    import OpenImageIO as oiio

    if max(camera.width, camera.height) <= widest:
        return pixels, allowed, camera
    share = widest / max(camera.width, camera.height)
    smaller = replace(camera, width=round(camera.width * share), height=round(camera.height * share))
    flags = np.stack([pixels.known, pixels.full, allowed], axis=2)
    stacked = oiio.ImageBuf(np.concatenate([pixels.rgb, flags.astype(np.float32)], axis=2))
    roi = oiio.ROI(0, smaller.width, 0, smaller.height, 0, 1, 0, 6)
    made = np.asarray(oiio.ImageBufAlgo.resize(stacked, filtername="box", roi=roi).get_pixels(oiio.FLOAT))
    known, full, may = made[..., 3] > 1.0 - 1e-3, made[..., 4] > 1e-3, made[..., 5] > 1.0 - 1e-3
    return Pixels(np.ascontiguousarray(made[..., :3]), known, full, pixels.notes), may, smaller


def _read(path: Path):
    """Values `[row, column, channel]`, channel names, whether they are integers, the primaries and alpha's index."""
    require("OpenImageIO")
    import OpenImageIO as oiio

    if not path.is_file():
        raise ValueError(f"{path}: expected a picture, found no file")
    picture = oiio.ImageInput.open(str(path))
    if picture is None:
        oiio.geterror()
        raise ValueError(f"{path.name}: expected a picture (.exr, .hdr, .png, .tif), found none that can be read")
    spec = picture.spec()
    raw = picture.read_image("float")
    said = picture.geterror()
    picture.close()
    if raw is None or np.size(raw) == 0:
        raise ValueError(f"{path.name}: the picture cannot be read: {' '.join(said.split())[:200]}")
    raw = np.asarray(raw).reshape(spec.height, spec.width, spec.nchannels)
    whole = str(spec.format) not in ("float", "half", "double")
    alpha = None if spec.alpha_channel < 0 else int(spec.alpha_channel)
    return raw, list(spec.channelnames), whole, spec.getattribute("chromaticities"), alpha


def _channels(path: Path, names: list[str]) -> list[int]:
    """The indices of red, green and blue in the first layer that has all three."""
    lower = [name.lower() for name in names]
    layers = [name.rpartition(".")[0] for name in lower]
    for layer in dict.fromkeys(layers):
        dotted = f"{layer}." if layer else ""
        for three in (("r", "g", "b"), ("red", "green", "blue")):
            wanted = [dotted + one for one in three]
            if set(wanted) <= set(lower):
                return [lower.index(one) for one in wanted]
    raise ValueError(f"{path.name}: expected channels R, G and B, found {', '.join(names)[:200]}")


def _decoded(encoded: Float[np.ndarray, "row column 3"]) -> Float[np.ndarray, "row column 3"]:
    """Linear values of colours encoded by sRGB's curve."""
    import OpenImageIO as oiio

    picture = oiio.ImageBuf(np.ascontiguousarray(encoded, np.float32))
    return np.asarray(oiio.ImageBufAlgo.colorconvert(picture, "sRGB", "linear").get_pixels(oiio.FLOAT))


def _to_srgb(primaries: tuple[float, ...]) -> Float[np.ndarray, "3 3"]:
    """The matrix from linear red, green and blue of other primaries to linear sRGB."""
    from colour.models import normalised_primary_matrix

    corners = np.reshape(np.asarray(primaries, float), (4, 2))
    return SRGB_FROM_XYZ @ normalised_primary_matrix(corners[:3], corners[3])


def aces(linear: Float[np.ndarray, "row column 3"]) -> Float[np.ndarray, "row column 3"]:
    """Encoded sRGB, 0 to 1, from linear sRGB by the ACES 2.0 output transform for standard screens.

    **Source:** Academy S-2025-001 in OpenColorIO's own configuration.
    """
    require("OpenImageIO")
    import OpenImageIO as oiio

    shown = oiio.ImageBufAlgo.ociodisplay(
        oiio.ImageBuf(np.ascontiguousarray(linear, np.float32)), _DISPLAY, _VIEW, _LINEAR, colorconfig=_CONFIG
    )
    if shown.has_error:
        raise ValueError(f"no tone curve of ACES: {shown.geterror()}")
    return np.clip(np.asarray(shown.get_pixels(oiio.FLOAT)), 0.0, 1.0)
