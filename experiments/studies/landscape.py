"""Mountains in the manner of Preetham 1999, Fig. 7 and 8: sky, aerial perspective, Ward-Larson's rival, Klassen's fog.

A fractal height field, cast column by column, lit by sun and sky; all light is spectral. The sky behind it and around
every point of the air is that of all orders of scattering, or an analytic sky's (`--sky published`, `--sky extended`).
"""

import argparse
import time
from pathlib import Path

import jax.numpy as jnp
import matplotlib
import numpy as np

import skyfit
from skyfit.analytic import overcast_luminance
from skyfit.atmosphere import Ground
from skyfit.light import daylight


matplotlib.use("Agg")
import matplotlib.pyplot as plt


RESULTS = Path(__file__).resolve().parents[1] / "results"
WAVELENGTH = np.arange(380.0, 781.0, 20.0)
SHAPE = (153, 400)
# half the width of the picture over its distance
WIDE = 0.5
# m: the eye above the valley's floor, the nearest and the farthest ground
EYE, NEAR, FAR = 900.0, 60.0, 110e3
FOG_TOP = 420.0
CHUNK = 8192
SKY, AIR = skyfit.OrdersOfScattering.normal(), skyfit.AerialPerspective.normal()
NOTHING = skyfit.Directions(np.zeros(1), np.zeros(1))


# --- the terrain


LATTICES = np.random.default_rng(0).uniform(-1.0, 1.0, (12, 256, 256))


def noise(east, north, octave):
    """Smooth noise in [-1, 1] on a lattice of random values with steps of one."""
    i, j = np.floor(east).astype(int), np.floor(north).astype(int)
    x, y = east - i, north - j
    x, y = (v * v * v * (v * (6.0 * v - 15.0) + 10.0) for v in (x, y))
    value = LATTICES[octave]
    i, j, right, up = i % 256, j % 256, (i + 1) % 256, (j + 1) % 256
    low = value[i, j] + x * (value[right, j] - value[i, j])
    return low + y * (value[i, up] + x * (value[right, up] - value[i, up]) - low)


def terrain(east, north, octaves=10):
    """Height in m: ridges, rougher where they are high, around a wide valley with a knoll under the eye."""
    total, weight, size = np.zeros_like(east), np.ones_like(east), 1.0
    for octave in range(octaves):
        # each octave is turned, or the lattice shows
        angle, step = 0.7 * octave + 0.3, 13e3 * 0.5**octave
        across = (np.cos(angle) * east + np.sin(angle) * north) / step + 37.0 * octave
        along = (np.cos(angle) * north - np.sin(angle) * east) / step + 11.0 * octave
        ridge = (1.0 - np.abs(noise(across, along, octave))) ** 2
        total += size * weight * ridge
        weight = np.clip(1.6 * ridge * weight, 0.0, 1.0)
        size *= 0.56
    away = np.hypot(east, north)
    mountains = 0.18 + np.clip((away - 4e3) / 22e3, 0.0, 1.0)
    return 1900.0 * mountains * np.maximum(total - 0.62, 0.0) + 0.6 * EYE * np.exp(-((away / 1300.0) ** 2))


def cast(azimuth_deg):
    """What a level camera sees: view, distance (infinite in the sky), point and normal, row by row from the top."""
    rows, columns = SHAPE
    across = WIDE * (2.0 * (np.arange(columns) + 0.5) / columns - 1.0)
    # the horizon in the lower half
    up = WIDE * (2.0 * (0.55 * rows - np.arange(rows) - 0.5) / columns)
    azimuth = np.radians(azimuth_deg) + np.arctan(across)
    slope = up[:, None] / np.sqrt(1.0 + across**2)[None]
    steps = np.geomspace(NEAR, FAR, 1400)
    ground = terrain(np.sin(azimuth)[:, None] * steps, np.cos(azimuth)[:, None] * steps)
    rise = (ground - EYE) / steps
    horizon = np.maximum.accumulate(rise, axis=1)
    level = np.full(slope.shape, np.inf)
    for c in range(columns):
        place = np.searchsorted(horizon[c], slope[:, c])
        last, hit = np.clip(place, 1, steps.size - 1), place < steps.size
        # the ray's height over the ground changes sign between two steps
        before, after = rise[c, last - 1] - slope[:, c], rise[c, last] - slope[:, c]
        share = np.clip(before / np.where(before == after, 1.0, before - after), 0.0, 1.0)
        level[:, c] = np.where(hit, steps[last - 1] + share * (steps[last] - steps[last - 1]), np.inf)
    reach = np.where(np.isfinite(level), level, NEAR)
    east, north = np.sin(azimuth)[None] * reach, np.cos(azimuth)[None] * reach
    d = 8.0 + reach / 900.0
    slopes = [terrain(east - x, north - y) - terrain(east + x, north + y) for x, y in ((d, 0.0), (0.0, d))]
    normal = np.stack([*slopes, 2.0 * d])
    normal /= np.linalg.norm(normal, axis=0)
    view = skyfit.Directions(np.arctan2(1.0, slope).ravel(), np.broadcast_to(azimuth, SHAPE).ravel())
    point = np.stack([east, north, EYE + slope * reach]).reshape(3, -1)
    return view, (level * np.sqrt(1.0 + slope**2)).ravel(), point, normal.reshape(3, -1)


def shadow(point, sun):
    """1 where the sun reaches a point, over ground to 25 km from it; soft over the sun's disc and more."""
    lit, start = np.ones(point.shape[1]), point + np.array([[0.0], [0.0], [15.0]])
    for step in np.geomspace(60.0, 25e3, 36):
        east, north, height = start + step * sun[:, None]
        lit = np.minimum(lit, np.clip(0.5 + (height - terrain(east, north, 6)) / (0.03 * step), 0.0, 1.0))
    return lit


# nm, and reflectances of forest, rock and snow
NODES = [380.0, 480.0, 550.0, 620.0, 680.0, 720.0, 780.0]
FOREST = np.interp(WAVELENGTH, NODES, [0.02, 0.03, 0.07, 0.045, 0.04, 0.16, 0.3])
ROCK = np.interp(WAVELENGTH, NODES, [0.12, 0.17, 0.21, 0.25, 0.27, 0.28, 0.29])
SNOW = np.full(WAVELENGTH.size, 0.85)


def reflectance(point, normal):
    """Forest below, rock where it is steep or high, snow on what is high and not steep."""
    east, north, height = point
    rough = 250.0 * noise(east / 900.0, north / 900.0, 10) + 120.0 * noise(east / 170.0, north / 170.0, 11)
    bare = np.clip((height + rough - 1500.0) / 400.0 + 6.0 * (0.72 - normal[2]), 0.0, 1.0)[:, None]
    white = np.clip((height + rough - 2150.0) / 250.0 + 5.0 * (normal[2] - 0.75), 0.0, 1.0)[:, None]
    white = white * np.clip((height - 1700.0) / 300.0, 0.0, 1.0)[:, None]
    return (1.0 - white) * ((1.0 - bare) * FOREST + bare * ROCK) + white * SNOW


# --- its light


def scene_of(view, sun, irradiance="astm_g173", height=None):
    elevation, azimuth = sun
    return skyfit.Scene.from_degrees(90.0 - elevation, view, WAVELENGTH, azimuth, None, 20.0, irradiance, height)


def overcast(scene):
    """CIE's overcast sky, Preetham 1999, eq. 2: daylight of 6500 K, a screen's white."""
    luminance = overcast_luminance(scene.sun_zenith, scene.view.zenith)
    white = jnp.full_like(luminance, 0.3127), jnp.full_like(luminance, 0.329)
    return luminance[:, None] * daylight(*white, scene.wavelength_nm)


def in_chunks(function, *arrays):
    """Programs of one shape, for parts of the picture."""
    count = arrays[0].shape[0]
    parts = []
    for start in range(0, count, CHUNK):
        part = [np.resize(a[start : start + CHUNK], (CHUNK, *a.shape[1:])) for a in arrays]
        parts.append(jnp.stack(function(*part)))
    return np.asarray(jnp.concatenate(parts, axis=1))[:, :count]


def render(seen, turbidity, sun, sky, air="ours", fog=None):
    """Spectral radiance `[pixel, wavelength]`."""
    view, distance, point, normal = seen
    clear = skyfit.Atmosphere.from_turbidity(turbidity)
    atmosphere = skyfit.Atmosphere(clear.rayleigh, clear.aerosol, clear.ozone, Ground(0.12))
    elevation, azimuth = np.radians(sun)
    sunward = np.array([np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)])
    skies = {
        "orders": lambda scene: SKY.radiance(atmosphere, scene),
        "published": lambda scene: skyfit.Preetham.published().radiance(turbidity, scene),
        "extended": lambda scene: skyfit.ExtendedPreetham.shipped().radiance(turbidity, scene),
        "overcast": overcast,
    }
    radiance = skies[sky]
    sunlight = SKY.fluxes(atmosphere, scene_of(NOTHING, sun)).direct / sunward[2] * (sky != "overcast")
    dome = skyfit.hemisphere(2000)
    diffuse = (dome.weight * jnp.cos(dome.zenith)) @ radiance(scene_of(dome, sun))

    solid = np.isfinite(distance)
    facing = np.maximum(sunward @ normal, 0.0) * shadow(point, sunward)
    light = facing[:, None] * np.asarray(sunlight) + 0.5 * (1.0 + normal[2])[:, None] * np.asarray(diffuse)
    own = reflectance(point, normal) / np.pi * light

    angles = np.asarray(view.zenith), np.asarray(view.azimuth)
    behind = in_chunks(lambda *a: [radiance(scene_of(skyfit.Directions(*a), sun))], *angles)[0]
    if fog is not None:
        own, distance = through_fog(fog, own, angles, distance, sun, sunlight)
    if air == "none":
        return np.where(solid[:, None], own, behind)

    source = skyfit.scattered_light(atmosphere, scene_of(view, sun), radiance, sunlight, grid=(16, 17))

    def between(zenith, azimuth, distance, *source):
        scene = scene_of(skyfit.Directions(zenith, azimuth), sun, height=EYE)
        if air == "ward-larson":
            ambient = radiance(scene_of(NOTHING, sun))[0]
            return skyfit.constant_ambient(atmosphere, scene, jnp.asarray(distance, float), ambient)
        return AIR.path(atmosphere, scene, jnp.asarray(distance, float), jnp.stack(source))

    transmittance, inscatter = in_chunks(between, *angles, np.minimum(distance, FAR), *np.asarray(source))
    return np.where(solid[:, None], transmittance * own + inscatter, behind)


def through_fog(fog, own, angles, distance, sun, sunlight):
    """The ground under a fog, by Klassen's layers, and how far the fog's top is: the clear air ends there."""
    cosine = np.cos(angles[0].astype(float))
    top = np.where(cosine < 0.0, (EYE - FOG_TOP) / np.maximum(-cosine, 1e-9), np.inf)
    foggy = skyfit.Atmosphere(None, fog, None)

    def layer(zenith, azimuth, distance):
        scene = scene_of(skyfit.Directions(zenith, azimuth), sun, np.asarray(sunlight), EYE)
        return skyfit.Shells(geometry="flat").path(foggy, scene, jnp.asarray(distance, float))

    transmittance, inscatter = in_chunks(layer, *angles, np.minimum(distance, FAR))
    return transmittance * own + inscatter, np.minimum(distance, top)


def picture(radiance):
    """sRGB with each picture's own exposure."""
    luminance = np.asarray(skyfit.xyz(jnp.asarray(radiance), WAVELENGTH))[:, 1]
    pixels = skyfit.srgb(jnp.asarray(radiance), WAVELENGTH, 0.75 / np.percentile(luminance, 88.0))
    return np.clip(np.asarray(pixels), 0.0, 1.0).reshape(*SHAPE, 3)


def main():
    begin, parser = time.perf_counter(), argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sky", choices=("orders", "published", "extended"), default="orders")
    sky = parser.parse_args().sky
    west, east = cast(270.0), cast(90.0)
    # elevation and azimuth of the sun, degrees
    morning, evening = (28.0, 115.0), (7.0, 300.0)
    cases = {
        "morning, T = 2, looking west": (west, 2.0, morning, sky),
        "the same without the air between": (west, 2.0, morning, sky, "none"),
        "evening, T = 2": (west, 2.0, evening, sky),
        "evening, T = 6": (west, 6.0, evening, sky),
        "evening, T = 6, looking east": (east, 6.0, evening, sky),
        "the same with Ward-Larson's air of one colour": (east, 6.0, evening, sky, "ward-larson"),
        "overcast, T = 10": (west, 10.0, morning, "overcast"),
        "evening, T = 2, Klassen's fog of 0.02 /m": (
            west,
            2.0,
            evening,
            sky,
            "ours",
            skyfit.Droplets.fog(0.02, FOG_TOP),
        ),
    }
    figure, axes = plt.subplots(4, 2, figsize=(12.0, 9.8), dpi=100)
    for axis, (title, case) in zip(axes.flat, cases.items(), strict=True):
        axis.imshow(picture(render(*case)), interpolation="bilinear")
        axis.set_title(title, loc="left", fontsize=9)
        axis.set_axis_off()
    figure.subplots_adjust(left=0.01, right=0.99, top=0.97, bottom=0.01, hspace=0.12, wspace=0.02)
    figure.savefig(RESULTS / ("landscape.png" if sky == "orders" else f"landscape_{sky}.png"))
    print(f"{len(cases)} pictures of {SHAPE[1]} x {SHAPE[0]} in {time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
