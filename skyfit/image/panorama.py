"""Reading of a picture of the whole sky for inversion: `read_panorama`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..analytic import ExtendedPreetham
from ..atmosphere import from_description
from ..atmosphere.description import describe
from ..light import SRGB_LUMINANCE
from ..measured import Response, Sky
from ..measured.quality.placed_sun import cosine_from_sun
from ..numerics import check_range
from ..retrieve import Fit
from ..retrieve.parameters import PICTURE_FREE, SUN_FREE
from ..scene import Directions, hemisphere, Scene, unit_vectors
from ..transport import AbstractSolver
from .camera import Camera, Mapping
from .files import Encoding, Pixels, read_mask, read_picture, reduced
from .found_sun import find_sun, FoundSun, Sight
from .picture import Image
from .render import render, Sun


# Larger pictures are reduced to this many pixels on a side, about a quarter of a degree each
_WIDEST = 1024
# Lowest angle above the horizon that is used, rad; ground, haze and refraction affect the sky below
_HORIZON = np.radians(2.0)
# Least radius of the averaged patches, and least distance from the sun that is used, rad
_PATCH, _NEAR_SUN = np.radians(1.5), np.radians(4.0)
# Least share of a patch that must be open sky; least number of patches; least share of the pattern that a sun explains
_SHARE, _FEWEST, _EXPLAINED = 0.5, 30, 0.5
# Noise of a patch, relative to itself and to the median: cameras' curves and vignettes are known to a few per cent
_RELATIVE, _FLOOR = 0.02, 0.02
# Sigma of each channel's scale if the picture's level and white are unknown
_ANY_SCALE = 0.9
# Turbidity of the sky that replaces an unknown level, and largest solar zenith angle of that formula, rad
_USUAL, _LOWEST = 3.0, np.radians(89.0)
# Longest wavelength of that formula, nm
_LONGEST = 830.0


@dataclass(frozen=True, eq=False)
class Panorama:
    """A picture of the sky with the sun found in it.

    - `rgb` `[row, column, 3]`: linear, the top row first, in cd m^-2; approximate if the level is unknown
    - `used` `[row, column]`: mask of open sky; excludes masked and saturated pixels, the sun's surroundings and the
      horizon
    - `camera` gives the directions of the pixels; `sun`, the sun's position found, in the camera's frame
    - `sky`, area averages of small patches all over the dome, for `skyfit.invert`; the fit includes a scale for each
      channel unless the level was given
    - `notes`: assumptions, and what was left out

    **Example:**

        >>> camera = skyfit.Camera("equirect", 256, 128)
        >>> skyfit.render(skyfit.Preetham.published(), camera, turbidity=3.0, sun_zenith=0.9).save("sky.exr")
        >>> found = skyfit.read_panorama("sky.exr", level=1.0)
        >>> found.sky.radiance.shape[1:], bool(found.used.any())
        ((300, 3), True)
    """

    rgb: Float[np.ndarray, "row column 3"]
    used: Bool[np.ndarray, "row column"]
    camera: Camera
    sun: FoundSun
    sky: Sky
    notes: tuple[str, ...]

    @property
    def free(self) -> tuple[str, ...]:
        """The parameters that the picture determines; includes the sun's position if only the pattern gave it."""
        return PICTURE_FREE + (SUN_FREE if self.sun.how == "pattern" else ())

    def clean(self, fit: Fit, camera: Camera | None = None, sun: Sun = "none", solver: AbstractSolver | None = None):
        """Render the fitted sky, without clouds, at the radiance of its atmosphere.

        **Arguments:** `fit` of this panorama's `sky`; `camera` (default: the panorama's); `sun` as in `skyfit.render`;
        `solver` (default: the fit's). **Returns:** `Image`, ground included.
        """
        model, (zenith, azimuth) = fit.fitted.models[0], self.fitted_sun(fit)
        # Converted to the float type of this process
        air = from_description(describe(model.atmosphere))
        camera = self.camera if camera is None else camera
        return render(
            air,
            camera,
            sun_zenith=zenith,
            sun_azimuth=azimuth,
            sun=sun,
            solver=fit.solver if solver is None else solver,
        )

    def fitted_sun(self, fit: Fit) -> tuple[float, float]:
        """Zenith angle and azimuth of the sun in the camera's frame, rad, including the shift found by the fit."""
        moved = fit.fitted.models[0].instrument
        azimuth = self.sun.azimuth + float(moved.pointing_azimuth)
        return self.sun.zenith + float(moved.sun_zenith), azimuth % (2.0 * np.pi)

    def predicted(self, fit: Fit, clean: Image | None = None) -> Float[np.ndarray, "row column 3"]:
        """The fitted sky for comparison with `rgb`: each channel of `clean` times the median ratio over used pixels."""
        made = (self.clean(fit) if clean is None else clean).rgb()
        with np.errstate(divide="ignore", invalid="ignore"):
            return made * np.nanmedian(self.rgb[self.used] / made[self.used], axis=0)


def read_panorama(
    path: str | Path,
    projection: str = "equirect",
    *,
    lens: tuple[float, float] = (0.0, 0.0),
    field_of_view: float | None = None,
    azimuth: float = np.pi,
    mirrored: bool = False,
    mask: str | Path | None = None,
    encoding: Encoding | None = None,
    level: float | None = None,
    response: Response | None = None,
    sun: tuple[float, float] | None = None,
    time: np.datetime64 | None = None,
    place: tuple[float, float] = (float("nan"), float("nan")),
    altitude: float = float("nan"),
    count: int = 300,
) -> Panorama:
    """Read a picture of the sky: an equirectangular panorama or an upward fisheye, with a level camera.

    **Arguments**

    - `path`: .exr, .hdr, .png or .tif with channels R, G and B
    - `projection`: "equirect" or "fisheye", optionally with the lens's mapping after a colon: "fisheye:equisolid";
      `lens`, k1 and k2 of its distortion, `field_of_view`, `azimuth` and `mirrored` as in `Camera`, rad
    - `mask`: a picture of the same size, white where the sky is to be used
    - `encoding`: "linear" or "srgb"; None: by the kind of the file's numbers
    - `level`: luminance of the value 1, cd m^-2 (or in the unit of `response`), None: unknown; `response` of a
      calibrated camera's red, green and blue, by default that of linear sRGB
    - `sun`: zenith angle and azimuth, rad, a first guess near which the sun is searched
    - `time`, UTC, `place`, latitude and longitude in degrees, and `altitude`, m, of the station, if known
    - `count`: number of patches spread over the dome

    **Returns:** a `Panorama`. **Errors:** `ValueError` if the file is no such picture, or shows no sky.
    **Valid:** a clear sky; the loss of the fit handles scattered clouds. Pixels within 2 degrees of the horizon and
    within 4 degrees of the sun or the region spoilt by its bloom are left out.

    **Example:**

        >>> camera = skyfit.Camera("equirect", 256, 128)
        >>> skyfit.render(skyfit.Preetham.published(), camera, turbidity=3.0, sun_zenith=0.9).save("sky.exr")
        >>> found = skyfit.read_panorama("sky.exr", level=1.0)
        >>> round(float(found.sky.sun_zenith[0]), 2)
        0.9
    """
    path = Path(path)
    check_range("count", count, 2.0 * _FEWEST, 5e3)
    check_range("level", level, 1e-9, 1e9, "cd m-2")
    if response is not None and len(response.weight) != 3:
        raise ValueError(f"`response` must have three channels, red, green and blue, got {len(response.weight)}")
    unit = "cd m-2" if response is None else "of the response"
    response = Response.linear_srgb() if response is None else response
    found = read_picture(path, encoding)
    camera = _camera(path, found, projection, lens, field_of_view, azimuth, mirrored)
    allowed: np.ndarray = np.ones(found.known.shape, bool) if mask is None else read_mask(Path(mask))
    if allowed.shape != found.known.shape:
        wanted, other = (" x ".join(map(str, flags.shape[::-1])) for flags in (found.known, allowed))
        raise ValueError(f"{Path(mask or '').name}: expected {wanted} pixels as the picture has, found {other}")
    pixels, allowed, camera = reduced(found, allowed, camera, _WIDEST)
    rgb = pixels.rgb
    views = camera.views()
    row, column = np.mgrid[: camera.height, : camera.width]
    size = camera.solid_angle(row.astype(float), column.astype(float))
    above = (size > 0.0) & (views[2] > np.sin(_HORIZON))
    if not above.any():
        raise ValueError(f"{path.name}: no pixel looks above the horizon")
    luminance = rgb @ SRGB_LUMINANCE.astype(np.float32)
    reasons = {
        "masked": ~allowed, "not finite or not opaque": ~pixels.known, "saturated": pixels.full,
        "black or negative": ~(luminance > 0.0),
    }  # fmt: skip
    notes, used = list(pixels.notes), above.copy()
    for reason, where in reasons.items():
        share = size[used & where].sum() / size[above].sum()
        if share > 0.0:
            notes.append(f"{100.0 * share:.3g} % of the sky left out: {reason}")
        used &= ~where
    if not used.any():
        raise ValueError(f"{path.name}: no pixel of sky is left: {'; '.join(notes)}")
    zenith, around = np.arccos(np.clip(views[2], -1.0, 1.0)).astype(float), np.arctan2(views[0], views[1]).astype(float)
    seen = above & allowed & pixels.known
    sight = Sight(*(part[seen] for part in (luminance.astype(float), used, pixels.full, zenith, around, size)))
    try:
        where = find_sun(sight, sun)
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from None
    if where.explained < _EXPLAINED:
        raise ValueError(
            f"{path.name}: no place of the sun explains where this picture is bright: overcast, or no sky?"
        )
    spoilt = cosine_from_sun(zenith, around, where.zenith, where.azimuth) > np.cos(max(where.blinded, _NEAR_SUN))
    used &= ~spoilt
    notes.append(_told(where))
    patches = _patches(rgb.astype(float), used, above, size, views.astype(float), count)
    if patches.open.sum() < _FEWEST:
        raise ValueError(
            f"{path.name}: {patches.open.sum()} patches of open sky are left, {_FEWEST} are needed: {'; '.join(notes)}"
        )
    if level is None:
        level = _usual_level(patches, where, response)
        notes.append(f"level unknown: 1 in the picture is taken as {level:.3g} {unit}, each channel's scale is fitted")
        scale_sigma = _ANY_SCALE
    else:
        scale_sigma = float("nan")
    sky = _sky(path, patches, level, scale_sigma, where, response, time, (*place, altitude), notes)
    return Panorama(rgb * np.float32(level), used, camera, where, sky, tuple(notes))


def _camera(path, found: Pixels, projection, lens: Sequence[float], field_of_view, azimuth, mirrored) -> Camera:
    kind, _, mapping = projection.partition(":")
    height, width = found.known.shape
    known = kind == "fisheye" and mapping in get_args(Mapping) or not mapping and kind in ("equirect", "fisheye")
    if not known:
        wanted = f"equirect, fisheye or fisheye:{', fisheye:'.join(get_args(Mapping))}"
        raise ValueError(f"`projection` must be one of {wanted}, got {projection!r}")
    if kind == "equirect" and width != 2 * height:
        raise ValueError(
            f"{path.name}: expected twice as many pixels across as down of an equirectangular picture of the whole "
            f"sphere, found {width} x {height}"
        )
    return Camera(
        kind, width, height, azimuth=azimuth, field_of_view=field_of_view, mirrored=mirrored,
        mapping=mapping or "equidistant", k1=lens[0], k2=lens[1],
    )  # pyright: ignore[reportArgumentType]  # fmt: skip


def _told(sun: FoundSun) -> str:
    how = {
        "disc": "by its disc", "patch": "in the middle of a saturated patch", "aureole": "by the light around it",
        "pattern": "by the pattern of the whole sky alone",
    }[sun.how]  # fmt: skip
    zenith, azimuth, sigma = np.degrees([sun.zenith, sun.azimuth, sun.sigma])
    return f"sun found {how}: zenith {zenith:.2f}, azimuth {azimuth:.2f} degrees, +- {sigma:.1g}"


class _Patches(NamedTuple):
    """Averages over small patches of the sky, `[patch]`: red, green and blue, directions, rad, and which are open."""

    rgb: Float[np.ndarray, "patch 3"]
    zenith: Float[np.ndarray, " patch"]
    azimuth: Float[np.ndarray, " patch"]
    open: Bool[np.ndarray, " patch"]


def _patches(rgb, used, above, size, views, count: int) -> _Patches:
    """Patches spread evenly over the dome; their number is fixed, so that another picture needs no compilation."""
    from scipy.spatial import KDTree

    dome = hemisphere(count, 0.5 * np.pi - _HORIZON)
    looks = np.array(unit_vectors(dome.zenith, dome.azimuth), float).T
    pixels, lit, weight, colour = views[:, above].T, used[above], size[above], rgb[above]
    radius = max(_PATCH, 0.8 * float(np.sqrt(np.max(weight))))
    light, seen = np.full((count, 3), np.nan), np.zeros(count, bool)
    for patch, places in enumerate(KDTree(pixels).query_ball_point(looks, 2.0 * np.sin(0.5 * radius))):
        inside = np.array(places, int)
        here = inside[lit[inside]]
        if here.size == 0 or weight[here].sum() < _SHARE * weight[inside].sum():
            continue
        share = weight[here] / weight[here].sum()
        light[patch], looks[patch], seen[patch] = share @ colour[here], share @ pixels[here], True
    east, north, up = looks.T
    return _Patches(light, np.arctan2(np.hypot(east, north), up), np.arctan2(east, north) % (2.0 * np.pi), seen)


def _usual_level(patches: _Patches, sun: FoundSun, response: Response) -> float:
    """The reading that corresponds to the value 1 if the patches have the green of a typical sky."""
    views = Directions(patches.zenith, patches.azimuth)
    known = response.wavelength_nm <= _LONGEST
    nm = response.wavelength_nm[known]
    scene = Scene(min(sun.zenith, _LOWEST), sun.azimuth, views, nm, np.ones(nm.size))
    usual = np.asarray(ExtendedPreetham.shipped().radiance(_USUAL, scene), float) @ response.weight[1][known]
    green = np.where(patches.open, patches.rgb[:, 1], 0.0)
    lit = (green > 0.0) & (usual > 0.0)
    return float(np.exp(np.median(np.log(usual[lit] / green[lit]))))


def _sky(path, patches, level, scale_sigma, sun: FoundSun, response, time, place, notes) -> Sky:
    radiance = level * patches.rgb
    usable = np.repeat(patches.open[:, None], 3, axis=1)
    sigma = np.hypot(_RELATIVE * np.abs(radiance), _FLOOR * np.nanmedian(radiance, axis=0))
    return Sky(
        radiance=radiance[None],
        sigma=sigma[None],
        usable=usable[None],
        view_zenith=patches.zenith, view_azimuth=patches.azimuth, wavelength_nm=response.centre_nm,
        sun_zenith=np.array([sun.zenith]), sun_azimuth=np.array([sun.azimuth]),
        time=np.array([np.datetime64("NaT") if time is None else time], "datetime64[ns]"),
        latitude_deg=place[0], longitude_deg=place[1], altitude_m=place[2],
        calibration_sigma=scale_sigma, response=response, notes=tuple(notes),
        masked={"not open sky": int(np.sum(~usable))} if not usable.all() else {},
        instrument="a picture", source=path.name,
    )  # fmt: skip
