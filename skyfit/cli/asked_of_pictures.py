"""Options of `skyfit invert` for pictures, and the files it writes for them."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from .options import in_range


# Suffixes of pictures, which need `--projection`
_SUFFIXES = (".exr", ".hdr", ".png", ".tif", ".tiff", ".jpg", ".jpeg")
# Largest difference between the zenith angles of the sun found and computed that is not reported, degrees
_FAR = 2.0


class EncodingName(StrEnum):
    """What the numbers of a picture are."""

    linear = "linear"
    srgb = "srgb"


ProjectionOption = Annotated[
    str | None,
    typer.Option(
        metavar="[equirect|fisheye[:MAPPING]]",
        help="of a picture that looks up, level; mappings: equidistant, equisolid, stereographic",
    ),
]
LensOption = Annotated[str | None, typer.Option(help="k1,k2 of a fisheye: t (1 + k1 t^2 + k2 t^4)")]
AcrossOption = Annotated[float | None, typer.Option(help="degrees that a fisheye's picture spans  [default: 180]")]
AzimuthOption = Annotated[
    float | None,
    typer.Option(help="degrees, of the middle column of an equirect  [default: 180]", show_default=False),
]
MirrorOption = Annotated[bool, typer.Option("--mirror", help="a fisheye with east left, as all-sky cameras have it")]
MaskOption = Annotated[Path | None, typer.Option(help="a picture of the same size, white where the sky is open")]
EncodingOption = Annotated[
    EncodingName | None, typer.Option(help="of a picture  [default: by its numbers: real linear, whole srgb]")
]
LevelOption = Annotated[float | None, typer.Option(help="cd/m2 of the value 1 in a picture, if it is known")]
MomentOption = Annotated[str | None, typer.Option(help="of a picture, ISO, UTC unless it says, with --at")]


def check_kind(path: Path, projection: str | None, **of_pictures) -> None:
    """Raise `ValueError` for a picture without `--projection`, and for options of pictures with another file."""
    if projection is not None:
        return
    if path.suffix.lower() in _SUFFIXES:
        raise ValueError(
            f"{path.name}: `--projection` must say how this picture lies on the sphere, equirect or fisheye"
        )
    for name, value in of_pictures.items():
        if value is not None and value is not False:
            raise ValueError(f"`--{name.replace('_', '-')}` is of a picture and must come with `--projection`")


def panorama_asked(
    path: Path, projection: str, lens, across, azimuth, mirror, mask, encoding, level, response, sun_zenith,
    sun_azimuth, time, at, altitude,
):  # fmt: skip
    """The panorama of a file, read with the user's options, and the sun computed from time and place, if given."""
    import numpy as np

    from ..image import read_panorama
    from .sun import sun_of

    about, guess = {}, None
    if time is not None or at is not None or sun_zenith is not None or sun_azimuth is not None:
        if sun_zenith is not None and sun_azimuth is None:
            raise ValueError("`--sun-zenith` of a picture must come with `--sun-azimuth`, as a first guess")
        *guess, about = sun_of(sun_zenith, sun_azimuth, time, at, 101325.0, 90.0)
    # Time and place alone do not give the picture's azimuth
    oriented = guess is not None and (at is None or azimuth is not None)
    found = read_panorama(
        path, projection, lens=(0.0, 0.0) if lens is None else _lens(lens),
        field_of_view=None if across is None else float(np.radians(across)),
        azimuth=float(np.radians(180.0 if azimuth is None else azimuth)), mirrored=mirror, mask=mask,
        encoding=None if encoding is None else encoding.value, level=level, response=response,
        sun=(float(np.radians(guess[0])), float(np.radians(guess[1]))) if guess is not None and oriented else None,
        time=about["time"][0] if "time" in about else None,
        place=(about.get("latitude_deg", np.nan), about.get("longitude_deg", np.nan)),
        altitude=np.nan if altitude is None else altitude,
    )  # fmt: skip
    return found, guess if at is not None else None


def told_of_place(panorama, fit, placed) -> str:
    """A sentence on the sun's position in the picture's frame, compared with that computed from time and place."""
    import numpy as np

    zenith, azimuth = (float(np.degrees(angle)) for angle in panorama.fitted_sun(fit))
    said = f"sun: zenith {zenith:.2f}, azimuth {azimuth:.2f} degrees in the frame of the picture"
    if placed is None:
        return said
    turn = (placed[1] - azimuth + 180.0) % 360.0 - 180.0
    said += f"; by time and place zenith {placed[0]:.2f}, azimuth {placed[1]:.2f}: the picture is turned by {turn:.1f}"
    if abs(placed[0] - zenith) > _FAR:
        said += f", and its sun stands {zenith - placed[0]:.1f} degrees too low: another time, or a picture not level?"
    return said


def told_of_haze(fit) -> str:
    """A sentence on the haze's optical depth and the turbidity of Hosek & Wilkie's similar sky; "" if not fitted."""
    import math

    from ..atmosphere import hosek_turbidity, turbidity_to_optical_depth

    free = dict(zip(fit.free, zip(fit.values[0], fit.sigma[0], strict=True), strict=True))
    if "turbidity" in free:
        value, sigma = free["turbidity"]
        depth, sigma = float(turbidity_to_optical_depth(value)), float(turbidity_to_optical_depth(2.0)) * sigma
    elif "aerosol_optical_depth" in free:
        depth, sigma = free["aerosol_optical_depth"]
    else:
        return ""
    other = hosek_turbidity(depth)
    alike = "" if math.isnan(other) else f"; Hosek & Wilkie's sky has this pattern at turbidity {other:.2g}"
    return f"haze: aerosol optical depth {depth:.3f} +- {sigma:.2g} at 550 nm{alike}"


def write_pictures(panorama, fit, out: Path) -> list[str]:
    """Write the clean sky, its atmosphere and a drawing of the residual; return the names of the files."""
    import json

    import jax
    import numpy as np

    from ..atmosphere import describe
    from ..draw import plot_panorama

    # float32 is enough for a picture
    with jax.enable_x64(False):
        clean = panorama.clean(fit)
        clean.save(out / "sky.exr")
        plot_panorama(panorama.rgb, np.asarray(panorama.predicted(fit, clean)), panorama.used, out / "picture.png")
    (out / "atmosphere.json").write_text(json.dumps(describe(fit.fitted.models[0].atmosphere), indent=1) + "\n")
    return ["sky.exr", "picture.png", "atmosphere.json"]


def _lens(text: str) -> tuple[float, float]:
    try:
        first, second = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"`--lens` must be k1,k2, such as -0.02,0.001, got {text!r}") from None
    return in_range("--lens k1", first, -0.5, 0.5), in_range("--lens k2", second, -0.5, 0.5)
