"""Lookup tables of the air for rendering engines: `write_luts`."""

import json
from pathlib import Path as FilePath
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..atmosphere import Atmosphere
from ..extras import require
from ..measured import atomic
from ..numerics import as_float, check_range
from ..scene import Directions, Scene
from ..transport import check_scene, Path, Spherical, SphericalField
from ..transport.columns import EARTH_RADIUS, slant_columns, TOP_OF_AIR
from ..transport.optics import optics
from .air import along, coloured
from .camera import Camera
from .files import write_picture
from .render import EYE, SPECTRUM, sunlight


# Sizes of the tables in texels, as in Hillaire's paper; the slices of the volume are side by side in its file
TRANSMITTANCE, MULTIPLE, SKY_VIEW, VOLUME = (256, 64), (32, 32), (192, 108), (32, 32, 32)
# Mean depth of a slice of the volume, m
_SLICE = 4000.0
# Instructions for readers of the files: how to find a texel
_WORDS = {
    "transmittance": "Of the sun's light to the top of the air, by place and direction. earth = earth_radius_m, "
    "top = earth + top_of_air_m, r = earth + height, H = sqrt(top^2 - earth^2), rho = sqrt(r^2 - earth^2), "
    "d = distance to the top; v = rho / H, "
    "u = (d - (top - r)) / (rho + H - (top - r)).",
    "multiple_scattering": "Diffuse light from all sides over 4 pi, all orders: times the scattering coefficient it is "
    "what air sends out in each direction, beside sunlight scattered once. u = 0.5 + 0.5 cos(sun zenith), "
    "v = height / top_of_air_m.",
    "sky_view": "What the air sends to the eye from each direction, all orders, without the sun's disc and the ground. "
    "a = zenith angle, h = that of the horizon (pi - asin(earth / (earth + height))): v = 0.5 - 0.5 sqrt(1 - a / h) "
    "above it, 0.5 + 0.5 sqrt((a - h) / (pi - h)) below; u = sqrt(0.5 - 0.5 cos(azimuth from the sun)).",
    "aerial_perspective": "R, G, B: what the air sends to the eye before an object; A: the mean transmittance of R, G, "
    "B. Slices side by side: in each u, v are the picture's, from the left and the top, u kept within the slice. "
    f"Slice k of 0 to {VOLUME[2] - 1} ends at distance ((k + 1) / {VOLUME[2]})^2 * {1e-3 * _SLICE * VOLUME[2]:g} km "
    "along the view; before the first, light and 1 - A grow in proportion to the distance.",
}


class Luts(NamedTuple):
    """Hillaire's four tables, top row first, in linear sRGB: transmittances are dimensionless, light is in cd m^-2."""

    transmittance: Float[np.ndarray, "row column 3"]
    multiple_scattering: Float[np.ndarray, "row column 3"]
    sky_view: Float[np.ndarray, "row column 3"]
    aerial_perspective: Float[np.ndarray, "row column 4"]


def luts(
    atmosphere: Atmosphere,
    camera: Camera,
    solver: Spherical | None = None,
    *,
    sun_zenith: float,
    sun_azimuth: float = np.pi,
    height: float = EYE,
) -> Luts:
    """The tables that `write_luts` writes; same arguments."""
    solver = Spherical.normal() if solver is None else solver
    check_range("height", height, 0.0, 0.999 * TOP_OF_AIR, "m")
    if camera.projection != "perspective":
        raise ValueError(f"`camera` must be a perspective one, whose frustum is cut, got {camera.projection!r}")

    def scene(views: Directions) -> Scene:
        return Scene(sun_zenith, sun_azimuth, views, SPECTRUM, sunlight(), height)

    def path(views: Directions, distance, _) -> Path:
        return field.path(scene(views), distance)

    zenith, turn = _sky_view_views(height)
    # Checked here with concrete numbers, because the pieces below are traced
    check_scene(solver, atmosphere, scene(Directions(as_float(zenith[:1]), as_float(turn[:1]))))
    # Prepared for all suns and heights, which the multiple scattering table needs
    field = solver.prepare(atmosphere, SPECTRUM)
    sky = coloured(along(path, zenith, sun_azimuth + turn, np.full(zenith.size, np.inf)))
    east, north, up = _frustum(camera).reshape(3, -1)
    far = _SLICE * VOLUME[2] * (np.arange(1, VOLUME[2] + 1) / VOLUME[2]) ** 2
    zenith, azimuth = (np.tile(v, VOLUME[2]) for v in (np.arctan2(np.hypot(east, north), up), np.arctan2(east, north)))
    air = coloured(along(path, zenith, azimuth, np.repeat(far, east.size)))
    volume = np.concatenate([air.inscatter, np.mean(air.transmittance, axis=1, keepdims=True)], axis=1)
    # A row of the file holds the same row of every slice
    volume = volume.reshape(VOLUME[2], VOLUME[1], VOLUME[0], 4).transpose(1, 0, 2, 3).reshape(VOLUME[1], -1, 4)
    return Luts(
        _transmittance(field),
        _multiple(field),
        np.asarray(sky.inscatter).reshape(SKY_VIEW[1], SKY_VIEW[0], 3),
        volume,
    )


def write_luts(
    atmosphere: Atmosphere,
    folder: str | FilePath,
    camera: Camera | None = None,
    solver: Spherical | None = None,
    *,
    sun_zenith: float,
    sun_azimuth: float = np.pi,
    height: float = EYE,
) -> None:
    """Write tables for engines in Hillaire's layout: four half-precision EXR files, and luts.json, which explains them.

    `transmittance.exr` (256 x 64) and `multiple_scattering.exr` (32 x 32) are for any sun and height; `sky_view.exr`
    (192 x 108) and `aerial_perspective.exr` (32 slices of 32 x 32 side by side) are for the given sun.

    **Arguments:** `folder`, created if absent; `camera`, a perspective camera whose frustum the volume fills, None:
    the default camera toward the sun; `solver`, `Spherical`; `sun_zenith`, `sun_azimuth`, rad; `height` of the eye, m.
    **Errors:** `ValueError` for another camera, and for scenes outside the solver's range.
    **Valid:** light is linear sRGB in cd m^-2 divided by the scale in the JSON. Colours outside sRGB have a negative
    component; transmittances are clipped to 0 to 1. Read bilinearly with clamped edges, the sky view agrees with the
    solver within 2 % outside the sun's aureole and the last half degree to the horizon (tests).
    **Source:** Hillaire 2020, Comput. Graph. Forum 39, 13; transmittance as Bruneton & Neyret 2008 lay it out.

    **Example:**

        >>> air = skyfit.Atmosphere.from_turbidity(2.0)
        >>> skyfit.write_luts(air, "luts", solver=skyfit.Spherical.draft(), sun_zenith=1.0)
    """
    require("OpenImageIO")
    check_range("sun_azimuth", sun_azimuth, -4.0 * np.pi, 4.0 * np.pi, "rad")
    camera = Camera("perspective", azimuth=sun_azimuth) if camera is None else camera
    found = luts(atmosphere, camera, solver, sun_zenith=sun_zenith, sun_azimuth=sun_azimuth, height=height)
    folder = FilePath(folder)
    folder.mkdir(parents=True, exist_ok=True)
    about: dict = {
        "earth_radius_m": EARTH_RADIUS,
        "top_of_air_m": TOP_OF_AIR,
        "sun_zenith_deg": float(np.degrees(sun_zenith)),
        "sun_azimuth_deg": float(np.degrees(sun_azimuth)),
        "height_m": float(height),
        "camera": {
            "azimuth_deg": float(np.degrees(camera.azimuth)),
            "elevation_deg": float(np.degrees(camera.elevation)),
            "field_of_view_deg": float(np.degrees(camera.across)),
            "width_over_height": camera.width / camera.height,
        },
        "texels": "of n along an axis the middles hold coordinates 0 to 1: texture = (0.5 + coordinate * (n - 1)) / n; "
        "v grows downward, the first row of the file is v = 0",
        "colour": "linear sRGB, D65",
        "tables": {},
    }
    for name, table in found._asdict().items():
        light = name != "transmittance"
        scale = _scale(table) if light else 1.0
        half = table.copy()
        half[..., :3] /= scale
        attributes = {"compression": "zip", "ImageDescription": _WORDS[name]}
        write_picture(folder / f"{name}.exr", half.astype(np.float16), "half", attributes)
        unit = {"cd_m2_of_1": scale} if light else {}
        about["tables"][name] = {"file": f"{name}.exr", "coordinates": _WORDS[name]} | unit
    with atomic(folder / "luts.json") as part:
        part.write_text(json.dumps(about, indent=1) + "\n")


def _scale(light: np.ndarray) -> float:
    """The power of two that scales the largest value to 512 to 1024, well within half precision."""
    largest = float(np.max(light[..., :3], initial=0.0))
    return 2.0 ** np.ceil(np.log2(largest / 1024.0)) if largest > 0.0 else 1.0


def _units(count: int) -> Float[np.ndarray, " texel"]:
    return np.arange(count) / (count - 1.0)


def _sky_view_views(height: float) -> tuple[np.ndarray, np.ndarray]:
    """Zenith angles, and azimuths from the sun, of the sky view's texels, row by row."""
    horizon = np.pi - np.arcsin(EARTH_RADIUS / (EARTH_RADIUS + height))
    v, u = _units(SKY_VIEW[1]), _units(SKY_VIEW[0])
    above, below = np.minimum(2.0 * v, 1.0), np.maximum(2.0 * v - 1.0, 0.0)
    zenith = np.where(v < 0.5, horizon * (1.0 - (1.0 - above) ** 2), horizon + (np.pi - horizon) * below**2)
    turn = np.arccos(1.0 - 2.0 * u**2)
    every = np.meshgrid(zenith, turn, indexing="ij")
    return every[0].ravel(), every[1].ravel()


def _frustum(camera: Camera) -> Float[np.ndarray, "3 row column"]:
    """Views of the volume's texels, whose centres span the camera's picture from edge to edge."""
    right, up, ahead = camera.axes
    across = np.tan(0.5 * camera.across)
    x = across * (2.0 * _units(VOLUME[0]) - 1.0)
    y = across * camera.height / camera.width * (1.0 - 2.0 * _units(VOLUME[1]))
    views = ahead[:, None, None] + right[:, None, None] * x[None, None] + up[:, None, None] * y[None, :, None]
    return views / np.linalg.norm(views, axis=0)


def _transmittance(field: SphericalField) -> Float[np.ndarray, "row column 3"]:
    (columns, rows), top = TRANSMITTANCE, EARTH_RADIUS + TOP_OF_AIR
    whole = np.sqrt(TOP_OF_AIR * (EARTH_RADIUS + top))
    rho, u = np.meshgrid(whole * _units(rows), _units(columns), indexing="ij")
    radius = np.hypot(rho, EARTH_RADIUS)
    nearest = top - radius
    away = nearest + u * (rho + whole - nearest)
    # At the top of the air the distance may be 0: there the view goes straight up
    cosine = np.where(away > 0.0, (whole**2 - rho**2 - away**2) / (2.0 * radius * np.maximum(away, 1.0)), 1.0)
    constituents = field.atmosphere.constituents
    place = as_float((radius - EARTH_RADIUS).ravel()), as_float(np.clip(cosine, -1.0, 1.0).ravel())
    column = slant_columns([c.profile for c in constituents], *place, "spherical")
    passed = jnp.exp(-(column.T @ optics(constituents, field.wavelength_nm).extinction))
    found = coloured(Path(passed, jnp.zeros_like(passed))).transmittance
    return np.asarray(found, np.float32).reshape(rows, columns, 3)


def _multiple(field: SphericalField) -> Float[np.ndarray, "row column 3"]:
    columns, rows = MULTIPLE
    height, cosine = np.meshgrid(TOP_OF_AIR * _units(rows), 2.0 * _units(columns) - 1.0, indexing="ij")
    sun = np.arccos(cosine.ravel())
    # The field ends at this sun; light of lower suns is about a millionth
    lowest = np.radians(float(field.suns_deg[1]))
    light = field.mean_radiance(as_float(height.ravel()), as_float(np.minimum(sun, lowest)))
    light = jnp.where(as_float(sun)[:, None] <= lowest, light * as_float(sunlight())[None], 0.0)
    found = coloured(Path(jnp.ones_like(light), light)).inscatter
    return np.asarray(found, np.float32).reshape(rows, columns, 3)
