"""A picture of luminance and colour, and its conversion for screens and files."""

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..extras import require
from ..light import srgb_from_linear
from ..measured import atomic
from ..numerics import check_range
from ..scene import unit_vectors
from .camera import Camera
from .files import aces, write_picture
from .tone import agx


Space = Literal["srgb", "rec2020", "acescg", "xyz"]
Tone = Literal["filmic", "aces", "agx", "clip"]
_NAMES = {"srgb": "sRGB", "rec2020": "ITU-R BT.2020", "acescg": "ACEScg"}
# White is _WHITE times the mean luminance (cd m^-2) to the power _POWER: dark scenes stay a little darker
_WHITE, _POWER = 8.0, 0.93
# White at exposure value 0 and ISO 100, cd m^-2: Lagarde & de Rousiers 2014, Moving Frostbite to PBR, sec. 5.1.2
_WHITE_AT_EV_0 = 1.2
# Ranges of the exposure value and of the daylight temperature, K
_EXPOSURES, _DAYLIGHTS = (-20.0, 30.0), (4000.0, 25000.0)
# Parameters of "filmic": slope of the shoulder, and rate at which colours turn white beyond white
_SHOULDER, _PALER = 1.6, 0.1
# Largest number of half precision
_LARGEST_HALF = 65504.0


@dataclass(frozen=True)
class Lamp:
    """The sun as a light source: its position, rad, and X, Y, Z of its beam on a plane normal to it, lx."""

    sun_zenith: float
    sun_azimuth: float
    irradiance: tuple[float, float, float]


@dataclass(frozen=True)
class Spectrum:
    """Light of each pixel: wavelengths, nm, and `radiance` `[row, column, wavelength]`, W m^-2 sr^-1 nm^-1."""

    wavelength_nm: Float[np.ndarray, " wavelength"]
    radiance: Float[np.ndarray, "row column wavelength"]


@dataclass(frozen=True)
class Image:
    """A picture: `xyz` `[row, column, 3]`, the CIE 1931 observer's X, Y, Z in cd m^-2, the top row first.

    `camera` gives the directions of its pixels; `lamp` is the sun, whether the picture shows it or not; `made_by`, the
    solver or the formula; `spectrum` of its pixels, None unless it was asked for.

    **Example:**

        >>> camera = skyfit.Camera("equirect", 64, 32)
        >>> picture = skyfit.render(skyfit.Preetham.published(), camera, turbidity=3.0, sun_zenith=0.9)
        >>> picture.rgb().shape
        (32, 64, 3)
        >>> picture.save("sky.exr")
    """

    xyz: Float[np.ndarray, "row column 3"]
    camera: Camera
    lamp: Lamp
    made_by: str
    spectrum: Spectrum | None = None

    def rgb(self, space: Space = "srgb", white_balance: float | None = None) -> Float[np.ndarray, "row column 3"]:
        """Linear red, green, blue in cd m^-2: three equal values are white of that luminance. Not clipped.

        **Arguments:** `space`; `white_balance`, the temperature (K) of the daylight that becomes white, None: that of
        the space. ACEScg, whose white is D60, is adapted from D65; "xyz", which has no white, is not adapted.
        **Source:** matrices and Bradford's adaptation as colour-science has them.
        """
        return self.xyz @ _matrix(space, white_balance).astype(np.float32).T

    def white(self, exposure: float | None = None) -> float:
        """The luminance (cd m^-2) of white at an exposure value (ISO 100), None: derived from the mean luminance.

        The mean is over the solid angle seen, without pixels brighter than a thousand times the median (the sun).
        """
        if exposure is not None:
            check_range("exposure", exposure, *_EXPOSURES)
            return _WHITE_AT_EV_0 * 2.0**exposure
        row, column = np.mgrid[: self.camera.height, : self.camera.width].astype(np.float32)
        luminance = self.xyz[..., 1]
        seen = np.where(luminance < 1e3 * np.median(luminance), self.camera.solid_angle(row, column), 0.0)
        mean = float(np.sum(seen * luminance) / max(np.sum(seen), 1e-30))
        return _WHITE * max(mean, 1e-9) ** _POWER

    def developed(
        self,
        exposure: float | None = None,
        white_balance: float | None = None,
        tone: Tone = "filmic",
    ) -> Float[np.ndarray, "row column 3"]:
        """Encoded sRGB from 0 to 1, exposed so that `white` is 1 before the curve of `tone`.

        **Arguments:** `exposure` as for `white`; `white_balance` as for `rgb`; `tone`: "filmic" applies the same
        shoulder to the three channels, which keeps colours, and turns light far brighter than white into white; "aces"
        is the output transform of ACES 2.0; "agx" that of AgX, which is flat and turns bright colours pale; or "clip".
        **Source:** IEC 61966-2-1:1999; `agx`.
        """
        if tone not in ("filmic", "aces", "agx", "clip"):
            raise ValueError(f'`tone` must be "filmic", "aces", "agx" or "clip", got {tone!r}')
        linear = self.rgb("srgb", white_balance) / self.white(exposure)
        if tone == "aces":
            return aces(linear)
        if tone == "agx":
            return agx(linear)
        linear = np.maximum(linear, 0.0)
        if tone == "filmic":
            peak = np.maximum(linear.max(axis=2, keepdims=True), 1e-12)
            pale = -np.expm1(-_PALER * np.maximum(peak - 1.0, 0.0))
            linear = (linear / peak * (1.0 - pale) + pale) * -np.expm1(-_SHOULDER * peak)
        return np.clip(np.asarray(srgb_from_linear(jnp.asarray(linear))), 0.0, 1.0)

    def save(
        self,
        path: str | Path,
        *,
        exposure: float | None = None,
        white_balance: float | None = None,
        tone: Tone = "filmic",
        space: Space = "srgb",
        half: bool = False,
        spectral: bool = False,
    ) -> None:
        """Write the picture: `.exr` or `.hdr`, linear, or `.png`, developed, 8 bits.

        **Arguments:** `exposure` and `tone` of a PNG; `space` and `half` precision of an EXR. An EXR's values times its
        `whiteLuminance` are red, green, blue in cd m^-2. `whiteLuminance` is 1, or with `half` a power of two that
        keeps the largest value in range. A Radiance `.hdr` is linear sRGB in cd m^-2, with negative values set to 0.
        `spectral` adds the spectrum of each pixel to an EXR, in W m^-2 sr^-1 nm^-1, a layer for each wavelength.
        **Errors:** `ValueError` for another suffix, for `space`, `half` or `spectral` with a file other than an EXR,
        and for `spectral` of a picture that has no `spectrum`.
        **Source:** names of the layers: Fichet et al. 2021, J. Comput. Graph. Tech. 10 (3), 1.
        """
        path = Path(path)
        check_saving(path, exposure, white_balance, space, half, spectral)
        if spectral and self.spectrum is None:
            raise ValueError("`spectral` needs a picture with a spectrum: `render(..., spectral=True)`")
        if path.suffix == ".png":
            pixels = np.round(255.0 * self.developed(exposure, white_balance, tone)).astype(np.uint8)
            write_picture(path, pixels, "uint8", {"ImageDescription": self.told()})
        elif path.suffix == ".exr":
            rgb = self.rgb(space, white_balance)
            scale = _half_scale(rgb, half)
            about = {
                "compression": "zip", "whiteLuminance": scale, "chromaticities": _chromaticities(space),
                "ImageDescription": self.told(),
            }  # fmt: skip
            pixels, names = rgb / scale, ["R", "G", "B"]
            if spectral and self.spectrum is not None:
                pixels = np.concatenate([pixels, self.spectrum.radiance], axis=2)
                # a comma before the decimals: a point would part a layer from its channel
                names += [f"S0.{nm:.6f}nm"[::-1].replace(".", ",", 1)[::-1] for nm in self.spectrum.wavelength_nm]
                about |= {"spectralLayoutVersion": "1.0", "emissiveUnits": "W.m^-2.sr^-1.nm^-1"}
            dtype, kind = (np.float16, "half") if half else (np.float32, "float")
            write_picture(path, pixels.astype(dtype), kind, about, names)
        else:
            rgb = np.maximum(self.rgb("srgb", white_balance), 0.0).astype(np.float32)
            write_picture(path, rgb, "float", {"ImageDescription": self.told()})

    def told(self) -> str:
        """A description in words of the picture's orientation and sun."""
        camera, lamp = self.camera, self.lamp
        around = {
            "equirect": f"the whole sphere, zenith on top, azimuth growing to the right, {_degrees(camera.azimuth)} in "
            "the middle",
            "fisheye": f"zenith in the middle, north up, east {'left' if camera.mirrored else 'right'}, "
            f"{_degrees(camera.across)} across",
            "cube": "six faces as of a cube map, from left to right: right, left, up, down, ahead and behind of "
            f"azimuth {_degrees(camera.azimuth)}",
            "perspective": f"toward azimuth {_degrees(camera.azimuth)}, elevation {_degrees(camera.elevation)}, "
            f"{_degrees(camera.across)} from left to right",
        }[camera.projection]
        sun = f"sun {_degrees(lamp.sun_zenith)} from the zenith, azimuth {_degrees(lamp.sun_azimuth)}"
        return f"skyfit, {self.made_by}; {around}; azimuth clockwise from north; {sun}; cd m-2"

    def save_lamp(self, path: str | Path) -> None:
        """Write the sun as JSON: unit vector east, north, up toward it, illuminance, linear sRGB in lx."""
        lamp = self.lamp
        record = {
            "toward_east_north_up": np.asarray(unit_vectors(lamp.sun_zenith, lamp.sun_azimuth)).tolist(),
            "sun_zenith_deg": float(np.degrees(lamp.sun_zenith)),
            "sun_azimuth_deg": float(np.degrees(lamp.sun_azimuth)),
            "illuminance_lx": lamp.irradiance[1],
            "xyz_lx": list(lamp.irradiance),
            "linear_srgb_lx": (_matrix("srgb", None) @ np.array(lamp.irradiance)).tolist(),
        }
        with atomic(Path(path)) as part:
            part.write_text(json.dumps(record, indent=2) + "\n")


def check_saving(
    path: Path,
    exposure: float | None = None,
    white_balance: float | None = None,
    space: Space = "srgb",
    half: bool = False,
    spectral: bool = False,
) -> None:
    """Raise an error if `Image.save` cannot write such a file; same arguments."""
    if path.suffix not in (".exr", ".hdr", ".png"):
        raise ValueError(f"`path` must end in .exr, .hdr or .png, got {path}")
    if path.suffix != ".exr" and (space != "srgb" or half or spectral):
        raise ValueError(f"`space`, `half` and `spectral` are of an .exr, got them for {path}")
    require("OpenImageIO")
    check_range("exposure", exposure, *_EXPOSURES)
    check_range("white_balance", white_balance, *_DAYLIGHTS, "K")


def _degrees(angle: float) -> str:
    return f"{np.degrees(angle):.4g} degrees"


@lru_cache
def _matrix(space: str, white_balance: float | None) -> Float[np.ndarray, "3 3"]:
    """The matrix from X, Y, Z to linear red, green, blue, both in cd m^-2."""
    if space not in (*_NAMES, "xyz"):
        raise ValueError(f"`space` must be one of {', '.join(_NAMES)}, xyz, got {space!r}")
    check_range("white_balance", white_balance, *_DAYLIGHTS, "K")
    from colour import CCS_ILLUMINANTS, RGB_COLOURSPACES, xy_to_XYZ
    from colour.adaptation import matrix_chromatic_adaptation_VonKries
    from colour.temperature import CCT_to_xy_CIE_D

    def adapted(of, to):
        return matrix_chromatic_adaptation_VonKries(xy_to_XYZ(of), xy_to_XYZ(to), transform="Bradford")

    daylight = CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    balanced = np.eye(3) if white_balance is None else adapted(CCT_to_xy_CIE_D(white_balance), daylight)
    if space == "xyz":
        return balanced
    known = RGB_COLOURSPACES[_NAMES[space]]
    own = np.eye(3) if np.allclose(known.whitepoint, daylight, atol=1e-3) else adapted(daylight, known.whitepoint)
    return known.matrix_XYZ_to_RGB @ own @ balanced


def _half_scale(rgb: np.ndarray, half: bool) -> float:
    """The power of two that keeps the largest value within half precision; 1 without `half`."""
    largest = float(np.max(rgb, initial=0.0))
    return 2.0 ** max(np.ceil(np.log2(largest / _LARGEST_HALF)), 0.0) if half and largest > 0.0 else 1.0


def _chromaticities(space: Space) -> tuple[float, ...]:
    """x and y of red, green, blue and white."""
    if space == "xyz":
        return 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0 / 3.0, 1.0 / 3.0
    from colour import RGB_COLOURSPACES

    known = RGB_COLOURSPACES[_NAMES[space]]
    return *known.primaries.ravel().tolist(), *known.whitepoint.tolist()
