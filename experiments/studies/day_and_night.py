"""Skies from day to night by one solver and one law of exposure, and the Earth's limb from 400 km.

    python -m experiments.studies.day_and_night [--size 160]

Writes experiments/results/twilight_skies.png: fisheye skies (zenith in the middle, north up, east right) with the sun
10 degrees above to 12 degrees below the horizon, in the west, and limb.png: the limb over a setting sun, seen from
400 km. `Spherical.normal`, spectral; the white of each picture is a power of its mean luminance.
"""

import argparse

import jax.numpy as jnp
import matplotlib
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE
from skyfit.light import srgb_from_linear, SRGB_FROM_XYZ
from skyfit.scene import fisheye


matplotlib.use("Agg")
from matplotlib import pyplot as plt


SKIES, LIMB = HERE / "results" / "twilight_skies.png", HERE / "results" / "limb.png"
NM = np.arange(390.0, 731.0, 20.0)
# degrees above the horizon
ELEVATIONS = (10.0, 6.0, 3.0, 1.0, 0.0, -1.5, -3.0, -4.5, -6.0, -8.0, -10.0, -12.0)
CHUNK = 4096
# white is this many times the mean luminance (cd m^-2) to this power: what was once dark stays a little darker
WHITE, POWER = 8.0, 0.93


def luminance(field, sun_deg, zenith, azimuth, height=None):
    """Tristimulus values, cd m^-2, of views `[pixel]`, the sun in the west."""
    found = []
    for start in range(0, zenith.size, CHUNK):
        part = np.arange(start, start + CHUNK) % zenith.size
        views = skyfit.Directions(zenith[part], azimuth[part])
        scene = skyfit.Scene.from_degrees(sun_deg, views, NM, sun_azimuth=270.0, height=height)
        found.append(np.asarray(skyfit.xyz(field.radiance(scene), NM)))
    return np.concatenate(found)[: zenith.size]


def developed(tristimulus, shape):
    """Pixels of a picture and the luminance of its white."""
    mean = max(float(np.mean(tristimulus[:, 1])), 1e-9)
    white = WHITE * mean**POWER
    linear = np.maximum(tristimulus / white @ SRGB_FROM_XYZ.T, 0.0)
    # a shoulder in place of clipping, the same for all channels, so that colours stay
    peak = np.maximum(linear.max(axis=1, keepdims=True), 1e-12)
    linear = linear / peak * (1.0 - np.exp(-1.6 * peak))
    return np.clip(np.asarray(srgb_from_linear(jnp.asarray(linear))), 0.0, 1.0).reshape(*shape, 3), white


def skies(size: int):
    atmosphere = skyfit.Atmosphere.from_optical_depth(0.1)
    suns = np.radians([90.0 - ELEVATIONS[0], 90.0 - ELEVATIONS[-1]])
    field = skyfit.Spherical.normal().prepare(atmosphere, NM, sun_zenith=suns)
    east, north, up = np.asarray(fisheye(size)).reshape(3, -1)
    inside = up > 0.0
    zenith, azimuth = np.arccos(np.clip(up[inside], -1.0, 1.0)), np.arctan2(east[inside], north[inside])
    figure, grid = plt.subplots(3, 4, figsize=(9.6, 7.8), layout="constrained")
    for axes, elevation in zip(grid.ravel(), ELEVATIONS, strict=True):
        light = luminance(field, 90.0 - elevation, zenith, azimuth)
        pixels, white = developed(light, (zenith.size,))
        picture = np.ones((size * size, 3))
        picture[inside] = pixels
        axes.imshow(picture.reshape(size, size, 3), interpolation="bilinear")
        axes.set_title(f"sun {elevation:+g}°, white {white:.2g} cd m$^{{-2}}$", fontsize=9)
        axes.axis("off")
    figure.savefig(SKIES, dpi=100)


def limb(width: int = 360, rows: int = 150):
    """The limb from 400 km with the sun 18 degrees below the level, just behind it."""
    field = skyfit.Spherical.normal().prepare(skyfit.Atmosphere.from_optical_depth(0.05), NM)
    zenith, azimuth = np.meshgrid(
        np.linspace(108.2, 110.6, rows), 270.0 + np.linspace(-20.0, 20.0, width), indexing="ij"
    )
    views = np.radians(zenith.ravel()), np.radians(azimuth.ravel())
    figure, grid = plt.subplots(3, 1, figsize=(7.6, 8.2), layout="constrained")
    for axes, sun in zip(grid, (85.0, 100.0, 107.5), strict=True):
        pixels, white = developed(luminance(field, sun, *views, height=400e3), zenith.shape)
        axes.imshow(pixels, extent=(-20.0, 20.0, 110.6, 108.2), aspect="auto", interpolation="bilinear")
        axes.set_title(f"sun at {sun:g}° from the zenith, white {white:.2g} cd m$^{{-2}}$", fontsize=9)
        axes.set_ylabel("view zenith, degrees", fontsize=8)
    grid[-1].set_xlabel("azimuth from the sun, degrees", fontsize=8)
    figure.savefig(LIMB, dpi=100)


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--size", type=int, default=160, help="pixels across a sky")
    given = arguments.parse_args()
    skies(given.size)
    limb()


if __name__ == "__main__":
    main()
