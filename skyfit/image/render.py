"""A picture of a sky: `render`."""

from typing import Literal

import jax.numpy as jnp
import numpy as np

from ..analytic import Sunlight
from ..analytic.analytic import AbstractAnalyticSky
from ..atmosphere import Atmosphere
from ..light import extraterrestrial_irradiance, observer_weights, SRGB_FROM_XYZ, xyz
from ..numerics import as_float, check_range
from ..scene import Directions, Scene, unit_vectors
from ..transport import AbstractSolver, Spherical
from ..transport.columns import EARTH_RADIUS, slant_columns, TOP_OF_AIR
from ..transport.optics import optics
from .camera import Camera
from .disc import add_disc, OF_OBSERVER
from .picture import Image, Lamp, Spectrum
from .table import LightTable


Sun = Literal["disc", "none", "lamp"]
# Wavelengths of the simulation, nm
SPECTRUM = np.arange(390.0, 751.0, 20.0)
# Number of views per call of the solver, and of pixels computed at once
_CHUNK, _PIXELS = 4096, 1 << 20
# Eye height of an observer on the ground, m
EYE = 2.0
# Upper limit of the refraction of the sun, rad
_REFRACTED = 0.02


def render(
    sky: Atmosphere | AbstractAnalyticSky,
    camera: Camera | None = None,
    *,
    sun_zenith: float,
    sun_azimuth: float = np.pi,
    sun_seen_zenith: float | None = None,
    turbidity: float | None = None,
    solver: AbstractSolver | None = None,
    height: float = EYE,
    sun: Sun = "disc",
    ground_albedo: float = 0.1,
    spectral: bool = False,
) -> Image:
    """Render a picture of the sky, the ground below it, and the sun.

    **Arguments:** `sky`, an atmosphere, or an analytic sky with its `turbidity`; `camera`, by default the whole sphere
    in 1024 by 512 pixels; `sun_zenith`, `sun_azimuth` clockwise from north, rad, the direction of sunlight along
    straight rays; `sun_seen_zenith`, the refracted zenith angle at which the disc appears, used for the beam's path
    through the air too, None: `sun_zenith`; `solver` for an atmosphere, by default `Spherical.normal()`; `height` of
    the observer, m, other than the default for `Spherical` only; `sun`: "disc" of true size, or "none" or "lamp" to
    leave it out of the picture (`Image.lamp` has its light in any case); `ground_albedo` below an analytic sky (an
    atmosphere has its own); `spectral` of an atmosphere: keep the spectrum of every pixel, 19 numbers, in the `Image`.
    **Returns:** `Image`, X, Y, Z in cd m^-2. **Errors:** `ValueError` outside the range of the solver or the sky.
    **Valid:** a solver computes 18000 directions (12000 without ground). The light is interpolated between them within
    0.5 %, in the first 0.2 degrees below the horizon within 2 % (tests). An analytic sky is evaluated at every pixel.
    Except with `Spherical` the ground is uniform, without air in front of it. Light paths are not refracted.

    **Example:**

        >>> camera = skyfit.Camera("equirect", 64, 32)
        >>> picture = skyfit.render(skyfit.Preetham.published(), camera, turbidity=3.0, sun_zenith=0.9)
        >>> picture.xyz.shape
        (32, 64, 3)
    """
    camera = Camera() if camera is None else camera
    sun_zenith, sun_azimuth, height = float(sun_zenith), float(sun_azimuth), float(height)
    seen_zenith = sun_zenith if sun_seen_zenith is None else float(sun_seen_zenith)
    check_range("sun_zenith", sun_zenith, 0.0, np.pi, "rad")
    low, high = max(sun_zenith - _REFRACTED, 0.0), min(sun_zenith + _REFRACTED, np.pi)
    check_range("sun_seen_zenith", seen_zenith, low, high, "rad", "what air refracts")
    if sun not in ("disc", "none", "lamp"):
        raise ValueError(f'`sun` must be "disc", "none" or "lamp", got {sun!r}')
    check_range("height", height, 0.0, 1e9, "m")
    if isinstance(sky, Atmosphere):
        if turbidity is not None:
            raise ValueError("`turbidity` must be left out with an atmosphere, whose haze is its own")
        solver = Spherical.normal() if solver is None else solver
        made_by = type(solver).__name__
        check_height(height, solver)
        pixels, beam, horizon = _of_solver(solver, sky, sun_zenith, sun_azimuth, seen_zenith, height, spectral)
    else:
        if turbidity is None or solver is not None:
            raise ValueError("an analytic sky must come with `turbidity`, and without `solver`")
        if spectral:
            raise ValueError("`spectral` must be left out with an analytic sky, which has colours and no spectrum")
        made_by, horizon = type(sky).__name__, 0.5 * np.pi
        check_height(height, sky)
        pixels, beam = _of_formula(sky, turbidity, sun_zenith, sun_azimuth, seen_zenith, ground_albedo)
    rows = max(_PIXELS // camera.width, 1)
    picture = np.empty((camera.height, camera.width, beam.size), np.float32)
    for first in range(0, camera.height, rows):
        views = camera.views(first, min(first + rows, camera.height))
        row, column = np.mgrid[first : first + views.shape[1], : camera.width]
        seen = camera.solid_angle(row, column)[..., None] > 0.0
        picture[first : first + rows] = seen * pixels(views.reshape(3, -1)).reshape(*views.shape[1:], -1)
    if sun == "disc":
        add_disc(picture, camera, seen_zenith, sun_azimuth, beam, horizon, SPECTRUM if spectral else OF_OBSERVER)
    spectrum = None
    if spectral:
        spectrum, weights = Spectrum(SPECTRUM, picture), observer_weights(SPECTRUM)
        picture, beam = picture @ weights.astype(np.float32), beam @ weights
    lamp = Lamp(seen_zenith, sun_azimuth, (float(beam[0]), float(beam[1]), float(beam[2])))
    return Image(picture, camera, lamp, made_by, spectrum)


def check_height(height: float, asked: AbstractSolver | AbstractAnalyticSky) -> None:
    """Raise `ValueError` if the height is not `EYE` and `asked` is not `Spherical`."""
    if height != EYE and not isinstance(asked, Spherical):
        name = type(asked).__name__
        raise ValueError(f"`height` must be left at {EYE:g} m with {name}: Spherical alone knows other heights here")


def sunlight():
    """Solar irradiance at the wavelengths of `SPECTRUM`, averaged with a line width equal to their spacing."""
    return extraterrestrial_irradiance(SPECTRUM, float(SPECTRUM[1] - SPECTRUM[0]))


def _of_solver(
    solver: AbstractSolver, sky: Atmosphere, sun_zenith: float, sun_azimuth: float, seen_zenith: float, height: float,
    spectral: bool,
):  # fmt: skip
    """A function of views that gives X, Y, Z or a spectrum; the same of the sun's beam; the horizon's zenith angle."""

    def channels(spectra):
        return np.asarray(spectra if spectral else xyz(spectra, SPECTRUM))

    aloft = isinstance(solver, Spherical) and height > 0.0
    one = Directions(np.zeros(1), np.zeros(1))
    scene = Scene(sun_zenith, sun_azimuth, one, SPECTRUM, sunlight(), height if aloft else None)

    def seen(views: Directions) -> Scene:
        return Scene(sun_zenith, sun_azimuth, views, SPECTRUM, scene.solar_irradiance, scene.height)

    field = None
    if isinstance(solver, Spherical):
        field = solver.prepare(sky, scene.wavelength_nm, sun_zenith=sun_zenith, height=height)

    def radiance(views: Directions):
        return solver.radiance(sky, seen(views)) if field is None else field.radiance(seen(views))

    def light(zenith, azimuth):
        found = np.empty((zenith.size, SPECTRUM.size if spectral else 3))
        for first in range(0, zenith.size, _CHUNK):
            # The last piece is filled up, so that all pieces use one compiled program
            part = np.arange(first, first + _CHUNK) % zenith.size
            views = Directions(zenith[part], sun_azimuth + azimuth[part])
            here = min(_CHUNK, zenith.size - first)
            found[first : first + here] = channels(radiance(views))[:here]
        return found

    horizon = np.pi - _tangent(EARTH_RADIUS, height) if aloft else 0.5 * np.pi
    air = np.pi - _tangent(EARTH_RADIUS + TOP_OF_AIR, height) if aloft and height > TOP_OF_AIR else 0.0
    table = LightTable(light, sun_zenith, air, horizon, aloft)
    constituents = sky.constituents
    profiles = [c.profile for c in constituents]
    column = slant_columns(profiles, as_float(height if aloft else 0.0), jnp.cos(as_float(seen_zenith)), "spherical")
    depth = column @ optics(constituents, scene.wavelength_nm).extinction
    beam = channels(jnp.exp(-depth) * scene.solar_irradiance) * (seen_zenith < horizon)
    ground = None
    if not aloft:
        fluxes = solver.fluxes(sky, scene)
        ground = channels(fluxes.up / np.pi)

    def pixels(views):
        east, north, up = views
        found = table.at(np.arccos(np.clip(up, -1.0, 1.0)), np.arctan2(east, north) - sun_azimuth)
        if ground is not None:
            found[up < 0.0] = ground
        return found

    return pixels, beam, horizon


def _tangent(radius: float, height: float) -> float:
    """The nadir angle of views that touch a sphere about the Earth's centre."""
    return float(np.arcsin(radius / (EARTH_RADIUS + height)))


def _of_formula(
    sky: AbstractAnalyticSky, turbidity: float, sun_zenith: float, sun_azimuth: float, seen_zenith: float, albedo: float
):
    """A function of views that gives X, Y, Z, and X, Y, Z of the sun's beam."""
    check_range("ground_albedo", albedo, 0.0, 1.0)
    sun = unit_vectors(sun_zenith, sun_azimuth)
    matrix = np.linalg.inv(SRGB_FROM_XYZ).astype(np.float32)
    dome = Camera("equirect", 128, 128)
    above = dome.views(0, 64)
    scene = Scene(seen_zenith, sun_azimuth, Directions(np.zeros(1), np.zeros(1)), SPECTRUM, sunlight())
    beam = np.zeros(3)
    if np.cos(seen_zenith) > 0.0:
        beam = np.asarray(xyz(Sunlight(max(turbidity, 1.0)).irradiance(scene), SPECTRUM))
    rgb = np.asarray(sky.rgb(turbidity, sun, jnp.asarray(above)))
    size = dome.solid_angle(np.arange(64.0), np.zeros(64))
    lit = np.einsum("crx,r,rx->c", rgb, size, above[2]) @ matrix.T + beam * max(np.cos(sun_zenith), 0.0)
    ground = (albedo / np.pi * lit).astype(np.float32)

    def pixels(views):
        found = np.asarray(sky.rgb(turbidity, sun, jnp.asarray(views))).T @ matrix.T
        found[views[2] < 0.0] = ground
        return found

    return pixels, beam
