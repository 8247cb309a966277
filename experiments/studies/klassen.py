"""Klassen 1987 again: his sweeps of the sky and his fog as one picture, and his Table I beside our seconds."""

import argparse
import csv
import platform
import statistics
import time
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib
import numpy as np

import skyfit
from skyfit.atmosphere import Aerosol, Exponential, HenyeyGreenstein, Rayleigh, SEA_LEVEL_PRESSURE


matplotlib.use("Agg")
import matplotlib.pyplot as plt


RESULTS = Path(__file__).resolve().parents[1] / "results"
# sec. 8: 33 wavelengths, 10 nm apart
WAVELENGTH = np.arange(400.0, 721.0, 10.0)
# Table I: CPU seconds of a VAX 8600
TABLE_1 = {
    "noon": {131072: 153, 32768: 60, 8192: 25, 2048: 11, 512: 5, 128: 3},
    "sunset": {131072: 654, 32768: 309, 8192: 144, 2048: 64, 512: 31, 128: 13},
}
SUN_ELEVATION = {"noon": 60.0, "sunset": 2.0}
# views at once: what they need in memory stays under 100 MB
CHUNK = 4096


def sky_view(width, height):
    """Directions of an image, row by row from the top: 120 degrees of azimuth, 60 of elevation, the horizon below."""
    azimuth = (np.arange(width) + 0.5) / width * 120.0 - 60.0
    elevation = 60.0 * (1.0 - (np.arange(height) + 0.5) / height)
    return skyfit.Directions.from_degrees(90.0 - elevation[:, None], azimuth[None])


def make_atmosphere(haze=0.08, thickness=1500.0, air=1.0):
    """`haze` is the optical depth of 1.5 km of it: thicker haze is more of the same density."""
    depth = haze * thickness / 1500.0
    aerosol = Aerosol(depth, 0.8, 0.97, 0.0, HenyeyGreenstein(0.76), Exponential(thickness))
    # more air than any planet's weather has
    rayleigh = eqx.tree_at(lambda r: r.pressure, Rayleigh(), jnp.asarray(air * SEA_LEVEL_PRESSURE))
    return skyfit.Atmosphere(rayleigh, aerosol)


def scene_of(sun_elevation, view, height=None, sun_azimuth=0.0):
    return skyfit.Scene.from_degrees(
        90.0 - sun_elevation, view, WAVELENGTH, sun_azimuth=sun_azimuth, fwhm_nm=10.0, height=height
    )


def picture(radiance, shape, share=75.0, brightness=0.5):
    """sRGB with each frame's own exposure, as a camera's: this percentile of the luminance at `brightness`."""
    luminance = np.percentile(np.asarray(skyfit.xyz(jnp.asarray(radiance), WAVELENGTH))[:, 1], share)
    pixels = np.asarray(skyfit.srgb(jnp.asarray(radiance), WAVELENGTH, brightness / luminance))
    return np.clip(pixels, 0.0, 1.0).reshape(*shape, 3)


def sweeps(solver):
    """Rows of frames: a title and for each frame a label, an atmosphere, the sun's elevation, the solver."""
    low, high = 2.0, 40.0
    constant = skyfit.Shells(blue_sky="constant")
    densities, suns = (0.01, 0.03, 0.08, 0.2, 0.4, 0.8), (0.5, 2.0, 6.0, 15.0, 40.0, 75.0)
    return {
        f"Fig. 8: haze density, sunset ({low:g}°)": [
            (f"{v:g}", make_atmosphere(haze=v), low, solver) for v in densities
        ],
        f"Fig. 9: haze thickness, sunset ({low:g}°)": [
            (f"{v / 1e3:g} km", make_atmosphere(thickness=v), low, solver) for v in (200, 500, 1000, 2000, 4000, 7000)
        ],
        f"Fig. 10: air density, sunset ({low:g}°)": [
            (f"x {v:g}", make_atmosphere(air=v), low, solver) for v in (0.1, 0.3, 0.6, 1, 2, 4)
        ],
        f"Fig. 11: haze density, midday ({high:g}°)": [
            (f"{v:g}", make_atmosphere(haze=v), high, solver) for v in densities
        ],
        "Fig. 12, 13: sun elevation": [(f"{v:g}°", make_atmosphere(), v, solver) for v in suns],
        "the same, his constant blue": [(f"{v:g}°", make_atmosphere(), v, constant) for v in suns],
    }


# --- fog


SHAPE = (108, 180)
EYE = 2.0
# centre and radius, m: x across, y ahead
SPHERES = (((-5.0, 14.0, 2.0), 2.0), ((4.0, 24.0, 3.0), 3.0), ((-9.0, 45.0, 5.0), 5.0), ((14.0, 75.0, 9.0), 9.0))
ALBEDOS = (0.75, 0.55, 0.65, 0.5)


def cast():
    """Rays of a pinhole camera: directions, distance (infinite in the sky), normal and colour of what they meet."""
    rows, columns = SHAPE
    across = (np.arange(columns) + 0.5 - 0.5 * columns) / columns
    up = 0.16 + (0.5 * rows - np.arange(rows) - 0.5) / columns
    x, z = np.meshgrid(1.1 * across, 1.1 * up)
    ray = np.stack([x, np.ones_like(x), z], -1).reshape(-1, 3)
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    eye = np.array([0.0, 0.0, EYE])
    down = ray[:, 2] < -1e-9
    distance = np.where(down, -EYE / np.where(down, ray[:, 2], -1.0), np.inf)
    normal = np.tile([0.0, 0.0, 1.0], (len(ray), 1))
    tile = np.where(down, distance, 0.0)[:, None] * ray
    albedo = np.where((np.floor(tile[:, 0] / 4) + np.floor(tile[:, 1] / 4)) % 2 == 0, 0.12, 0.3)
    for (centre, radius), reflectance in zip(SPHERES, ALBEDOS, strict=True):
        to_eye = eye - np.array(centre)
        along = ray @ to_eye
        root = along**2 - to_eye @ to_eye + radius**2
        hit = root > 0.0
        near = -along - np.sqrt(np.where(hit, root, 0.0))
        first = hit & (near > 0.0) & (near < distance)
        distance = np.where(first, near, distance)
        point = eye + np.where(first, near, 0.0)[:, None] * ray
        normal = np.where(first[:, None], (point - np.array(centre)) / radius, normal)
        albedo = np.where(first, reflectance, albedo)
    view = skyfit.Directions(np.arccos(ray[:, 2]), np.arctan2(ray[:, 0], ray[:, 1]))
    return view, distance, normal, albedo


def foggy_scene(fog, sun_azimuth, sun_elevation=28.0):
    """Objects lit by the sun and the sky that reach the ground, then the path added from the depth image."""
    view, distance, normal, albedo = cast()
    solver = skyfit.Shells(geometry="flat")
    atmosphere = skyfit.Atmosphere(aerosol=fog)
    on_ground = scene_of(sun_elevation, skyfit.Directions(np.zeros(1), np.zeros(1)), sun_azimuth=sun_azimuth)
    flux = solver.fluxes(atmosphere, on_ground)
    zenith, azimuth = np.radians([90.0 - sun_elevation, sun_azimuth])
    sun = np.array([np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)])
    facing = np.maximum(normal @ sun, 0.0)[:, None] * np.asarray(flux.direct) / np.cos(zenith)
    ambient = 0.5 * (1.0 + normal[:, 2:]) * np.asarray(flux.diffuse_down)
    own = (albedo / np.pi)[:, None] * (facing + ambient) * np.isfinite(distance)[:, None]
    scene = scene_of(sun_elevation, view, EYE, sun_azimuth)
    path = solver.path(atmosphere, scene, jnp.asarray(distance, float))
    return path.over(jnp.asarray(own, float))


def draw(path):
    solver, shape = skyfit.Shells(), (48, 96)
    rows = sweeps(solver)
    figure = plt.figure(figsize=(11.5, 9.4), dpi=100)
    top, bottom = figure.subfigures(2, 1, height_ratios=[7.3, 2.1])
    axes = top.subplots(len(rows), 6)
    for line, (title, frames) in zip(axes, rows.items(), strict=True):
        line[0].set_title(title, loc="left", fontsize=8)
        for axis, (label, atmosphere, sun, use) in zip(line, frames, strict=True):
            radiance = use.radiance(atmosphere, scene_of(sun, sky_view(shape[1], shape[0])))
            axis.imshow(picture(radiance, shape), interpolation="bilinear")
            axis.text(2, 8, label, color="white", fontsize=7)
            axis.set_axis_off()
    top.subplots_adjust(left=0.01, right=0.99, top=0.97, bottom=0.01, hspace=0.22, wspace=0.03)
    fog = skyfit.Droplets.fog(0.02, 60.0)
    panels = {
        "Fig. 15: lit from the front": (None, 160.0),
        "Fig. 16: with fog of 0.02 /m": (fog, 160.0),
        "Fig. 17: back lit": (None, 15.0),
        "Fig. 18: with fog of 0.02 /m": (fog, 15.0),
    }
    for axis, (title, (constituent, azimuth)) in zip(bottom.subplots(1, 4).flat, panels.items(), strict=True):
        axis.imshow(picture(foggy_scene(constituent, azimuth), SHAPE, 90.0, 0.7), interpolation="bilinear")
        axis.set_title(title, loc="left", fontsize=8)
        axis.set_axis_off()
    bottom.subplots_adjust(left=0.01, right=0.99, top=0.9, bottom=0.01, wspace=0.03)
    figure.savefig(path)
    plt.close(figure)


# --- Table I


@jax.jit
def whole_image(atmosphere, scene):
    """The radiance of any number of views, a chunk at a time."""
    solver, view = skyfit.Shells(), scene.view

    def one(angles):
        at = skyfit.Directions(angles[0][None], angles[1][None])
        part = skyfit.Scene(scene.sun_zenith, scene.sun_azimuth, at, scene.wavelength_nm, scene.solar_irradiance)
        return solver.radiance(atmosphere, part)[0]

    return jax.lax.map(one, (view.zenith, view.azimuth), batch_size=min(CHUNK, view.zenith.shape[0]))


def seconds(function, repeats=3):
    """Compile apart, then the median."""
    jax.block_until_ready(function())
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(function())
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def table_1(path, largest):
    rows = []
    for sky, published in TABLE_1.items():
        for pixels, klassen in sorted(published.items()):
            if pixels > largest:
                continue
            height = int(np.sqrt(pixels / 2))
            scene = scene_of(SUN_ELEVATION[sky], sky_view(2 * height, height))
            atmosphere = make_atmosphere()
            ours = seconds(lambda a=atmosphere, s=scene: whole_image(a, s))
            spread = seconds(lambda a=atmosphere, s=scene: skyfit.upsample(skyfit.Shells(), a, s))
            rows.append([sky, pixels, klassen, f"{ours:.6f}", f"{spread:.6f}", f"{klassen / ours:.1f}"])
            print(*rows[-1], flush=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(
            "# source: made by experiments/studies/klassen.py\n"
            "# klassen_1987_s: Klassen 1987, Table I, CPU seconds of a VAX 8600; the others: this machine's seconds\n"
            f"# 33 wavelengths, Shells(16 nodes), float32, jax {jax.__version__}, {platform.machine()}, "
            f"{jax.device_count()} {jax.default_backend()} device; medians of 3 after compilation, seconds\n"
        )
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["sky", "pixels", "klassen_1987_s", "every_pixel_s", "upsample_s", "klassen_over_every_pixel"])
        writer.writerows(rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=("picture", "table"))
    parser.add_argument("--largest", type=int, default=131072, help="leave out larger images of Table I")
    arguments = parser.parse_args()
    if arguments.only != "table":
        draw(RESULTS / "klassen.png")
    if arguments.only != "picture":
        table_1(RESULTS / "klassen_table1.csv", arguments.largest)


if __name__ == "__main__":
    main()
