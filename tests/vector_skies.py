r"""Polarised skies to compare with: the tables of Natraj et al. 2009, and light scattered once.

The frame of skyfit's Q and U: z points down, x north, y east; light travels along n, away from the view; e_theta is the
derivative of n with respect to the view's zenith angle (up, at the horizon) and e_phi its derivative with respect to
azimuth over the sine (to the left, for who looks at the horizon), so that (e_theta, e_phi, n) is right-handed.
Q = |E_theta|^2 - |E_phi|^2, U = 2 Re(E_theta conj(E_phi)). `frame` is this in vectors, and all signs follow from it.

Natraj's tables have minus skyfit's Q and minus its U, where their azimuth is the view's, clockwise from the sun's: both
signs, for they count as positive what vibrates across the meridian, which is the same frame turned by a right angle.
Light scattered once says so: at depth 0.02 it is within 4 % of the radiance of the tables, with any other choice of
signs 190 % off; so does sasktran2, whose Q and U are skyfit's as they are (but see `greek_coefficients`).

sasktran2 with 24 streams and 240 layers is within 6e-4 of the tables' radiance in I, Q and U (cosines of sun and view
from 0.1, all depths and albedos tried); 120 layers: 1e-3, and 1.6e-3 at cosine 0.1 and depth 1; 16 streams, 60 layers:
5.6e-3. Air has to lie low for it (1 km): the Earth that stands for a flat one is 1e-3 round at cosine 0.1 for 8 km,
and a larger one costs digits (5e-4 at ten times the radius, 7 % at a hundred times).
"""

from functools import cache

import numpy as np

import skyfit
from skyfit.atmosphere import Exponential, Ground, Prescribed, RayleighPhase


DEPTHS = (0.02, 0.05, 0.1, 0.15, 0.25, 0.5, 1.0)
ALBEDOS = (0.0, 0.25, 0.8)
SUN_COSINES = (0.1, 0.2, 0.4, 0.6, 0.8, 0.92, 1.0)
COSINES = (0.02, 0.06, 0.1, 0.16, 0.2, 0.28, 0.32, 0.4, 0.52, 0.64, 0.72, 0.84, 0.92, 0.96, 0.98, 1.0)
AZIMUTHS_DEG = (0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 180.0)


@cache
def natraj(folder) -> np.ndarray:
    """I, Q, U of skyfit's signs on the ground under air, per unit irradiance.

    `[component, albedo, sun cosine, view cosine, azimuth, depth]`. Depolarisation 0; the tables' irradiance is pi.
    """
    shape = len(ALBEDOS), len(SUN_COSINES), len(COSINES), 2 + len(AZIMUTHS_DEG)
    rows = [_rows(folder / f"{name}_DN_TAU_{depth:g}").reshape(shape) for name in "IQU" for depth in DEPTHS]
    for row in rows:
        assert np.all(row[..., 0] == np.array(SUN_COSINES)[:, None]) and np.all(row[..., 1] == np.array(COSINES))
    table = np.stack(rows).reshape(3, len(DEPTHS), *shape)[..., 2:]
    return np.moveaxis(table, 1, -1) * np.array([1.0, -1.0, -1.0])[:, None, None, None, None, None] / np.pi


def _rows(path) -> np.ndarray:
    """The lines of nine numbers; headings have other counts or are no numbers."""
    lines = [line.split() for line in path.read_text().splitlines()]
    return np.array([line for line in lines if len(line) == 9 and line[0][0].isdigit()], float)


def natraj_views(least_cosine: float = 0.1) -> tuple[np.ndarray, np.ndarray, slice]:
    """Zenith angles and azimuths from the sun's, degrees, `[view cosine x azimuth]`, and their place in `COSINES`."""
    kept = slice(sum(c < least_cosine for c in COSINES), None)
    zenith, azimuth = np.meshgrid(np.degrees(np.arccos(COSINES[kept])), AZIMUTHS_DEG, indexing="ij")
    return zenith.ravel(), azimuth.ravel(), kept


def natraj_air(albedo, scale_height: float = 8000.0) -> skyfit.Atmosphere:
    """Air over a Lambertian ground, its depths standing for wavelengths; flat, the scale height does not matter."""
    air = Prescribed(np.array(DEPTHS), Exponential(scale_height), RayleighPhase(0.0))
    return skyfit.Atmosphere(air, None, None, Ground(albedo))


def frame(zenith_deg, azimuth_deg) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The direction n that light from a view travels in, e_theta and e_phi, each `[..., 3]`: north, east, down."""
    zenith, azimuth = np.broadcast_arrays(np.radians(zenith_deg), np.radians(azimuth_deg))
    m, s, c, d = np.cos(zenith), np.sin(zenith), np.cos(azimuth), np.sin(azimuth)
    light = np.stack([-s * c, -s * d, m], axis=-1)
    return light, np.stack([-m * c, -m * d, -s], axis=-1), np.stack([d, -c, np.zeros_like(d)], axis=-1)


def scattered_once(sun_zenith_deg, zenith_deg, azimuth_deg, depth, phase_function, polarisation) -> np.ndarray:
    """I, Q, U on the ground under a homogeneous layer, per unit irradiance, `[component, direction]`.

    Azimuths from the sun's. `phase_function` (sr^-1) and `polarisation`, F12 over F11, are functions of the cosine of
    the scattering angle; `depth` is what scatters and dims alike.
    """
    sunlight, *_ = frame(sun_zenith_deg, 0.0)
    light, e_theta, e_phi = frame(zenith_deg, azimuth_deg)
    across = np.cross(sunlight, light)
    # light that goes straight on has no plane, and no polarisation
    normal = across / np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-12)
    theta, phi = (np.sum(normal * e, axis=-1) for e in (e_theta, e_phi))
    cosine = np.clip(light @ sunlight, -1.0, 1.0)
    sun, view = np.cos(np.radians(sun_zenith_deg)), np.cos(np.radians(zenith_deg))
    # exp(-depth / sun) of the light, over the layer: (exp(d x) - 1) / x with x -> 0 where view and sun have one height
    x = 1.0 / sun - 1.0 / view
    safe = np.where(np.abs(x) < 1e-9, 1.0, x)
    layer = np.exp(-depth / sun) * np.where(np.abs(x) < 1e-9, depth, np.expm1(depth * safe) / safe) / view
    # F12 is of what vibrates in the plane, and `normal` is across it
    across_plane = -polarisation(cosine)
    turned = [np.ones_like(cosine), across_plane * (theta**2 - phi**2), across_plane * 2.0 * theta * phi]
    return phase_function(cosine) * layer * np.stack(turned)


def air_once(cosine):
    """The phase function of air without depolarisation, sr^-1."""
    return 3.0 / (16.0 * np.pi) * (1.0 + cosine**2)


def polarised_by_air(cosine):
    """Its F12 over F11."""
    return -(1.0 - cosine**2) / (1.0 + cosine**2)
