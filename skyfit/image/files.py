"""Files of pictures, and the tone curve of ACES, by OpenImageIO."""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Num

from ..measured import atomic


Kind = Literal["float", "half", "uint8"]
# a display's white is 100 cd m^-2 there, and the scene's 1
_DISPLAY, _VIEW, _LINEAR = "sRGB - Display", "ACES 2.0 - SDR 100 nits (Rec.709)", "Linear Rec.709 (sRGB)"
_CONFIG = "ocio://cg-config-v4.0.0_aces-v2.0_ocio-v2.5"


def write_picture(
    path: Path,
    pixels: Num[np.ndarray, "row column channel"],
    kind: Kind,
    about: Mapping[str, str | float | tuple[float, ...]],
) -> None:
    """Writes a file of the format that its suffix names.

    **Arguments:** `pixels`, the top row first; `kind` of number in the file; `about`, attributes by the names that
    OpenImageIO has for them; each format keeps those that it knows.
    **Errors:** `ValueError` where the file cannot be written.
    """
    import OpenImageIO as oiio

    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, kind)
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


def aces(linear: Float[np.ndarray, "row column 3"]) -> Float[np.ndarray, "row column 3"]:
    """Encoded sRGB of linear sRGB by the ACES 2.0 output transform for standard screens, 0 to 1.

    **Source:** Academy S-2025-001 in OpenColorIO's own configuration.
    """
    import OpenImageIO as oiio

    shown = oiio.ImageBufAlgo.ociodisplay(
        oiio.ImageBuf(np.ascontiguousarray(linear, np.float32)), _DISPLAY, _VIEW, _LINEAR, colorconfig=_CONFIG
    )
    if shown.has_error:
        raise ValueError(f"no tone curve of ACES: {shown.geterror()}")
    return np.clip(np.asarray(shown.get_pixels(oiio.FLOAT)), 0.0, 1.0)
