"""The sun's disc, drawn with the same total light at any resolution."""

import numpy as np
from jaxtyping import Float

from ..light import SUN_SOLID_ANGLE
from ..scene import unit_vectors
from .camera import Camera


RADIUS = float(np.sqrt(SUN_SOLID_ANGLE / np.pi))  # rad
# Representative wavelengths of X, Y and Z, nm
OF_OBSERVER = np.array([600.0, 555.0, 450.0])
# Number of points of the disc: at least, and for each pixel that it covers
_POINTS, _PER_PIXEL = 4000, 40


def add_disc(
    picture: Float[np.ndarray, "row column channel"],
    camera: Camera,
    sun_zenith: float,
    sun_azimuth: float,
    irradiance: Float[np.ndarray, " channel"],
    horizon: float = 0.5 * np.pi,
    wavelength_nm: Float[np.ndarray, " channel"] = OF_OBSERVER,
) -> None:
    r"""Add the light of the sun's disc to a picture, in place.

    Points fill the disc evenly, with limb darkening $\mu^{\alpha}$. Each adds its share of the irradiance to the pixel
    it falls on. The sum of radiance times solid angle is therefore `irradiance` for any pixel size.

    **Arguments:** `picture`, light per steradian; `irradiance` of the whole disc on a plane normal to it;
    `horizon`, the zenith angle beyond which points are hidden, rad; `wavelength_nm` of the channels, by default those
    that stand for X, Y and Z.
    **Source:** Hestroffer & Magnan 1998, A&A 333, 338, $\alpha = -0.023 + 0.292 / \lambda$ in um; the disc is round:
    refraction is left out.
    """
    middle = np.asarray(unit_vectors(sun_zenith, sun_azimuth), float)
    row, column, inside = camera.places(middle[:, None])
    covered = np.pi * RADIUS**2 / camera.solid_angle(row, column)[0] if inside[0] else 0.0
    count = int(min(max(_POINTS, _PER_PIXEL * covered), 4e6))
    # Points distributed evenly by area on a Fibonacci spiral
    share = (np.arange(count) + 0.5) / count
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    away = RADIUS * np.sqrt(share)
    east = np.array([np.cos(sun_azimuth), -np.sin(sun_azimuth), 0.0])
    north = np.cross(east, middle)
    tilt = np.sin(away) * np.stack([np.cos(turn), np.sin(turn)])
    views = np.cos(away) * middle[:, None] + east[:, None] * tilt[0] + north[:, None] * tilt[1]
    darker = np.sqrt(1.0 - share)[:, None] ** (-0.023 + 292.0 / wavelength_nm)
    light = irradiance * darker / darker.sum(axis=0)
    row, column, inside = camera.places(views)
    inside &= views[2] > np.cos(horizon)
    row, column, light = row[inside], column[inside], light[inside]
    light = light / camera.solid_angle(row, column)[:, None]
    np.add.at(picture, (row.astype(int), column.astype(int)), light.astype(picture.dtype))
