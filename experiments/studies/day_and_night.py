"""Skies from day to night by one solver and one law of exposure, and the Earth's limb from 400 km.

    python -m experiments.studies.day_and_night [--size 240]

Writes experiments/results/twilight_skies.png: fisheye skies (zenith in the middle, north up, east right) with the sun
10 degrees above to 12 degrees below the horizon, in the west, and limb.png: the limb over a setting sun, seen from
400 km; all by `skyfit.render` with `Spherical.normal`.
"""

import argparse

import matplotlib
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE


matplotlib.use("Agg")
from matplotlib import pyplot as plt


SKIES, LIMB = HERE / "results" / "twilight_skies.png", HERE / "results" / "limb.png"
# degrees above the horizon
ELEVATIONS = (10.0, 6.0, 3.0, 1.0, 0.0, -1.5, -3.0, -4.5, -6.0, -8.0, -10.0, -12.0)
WEST = np.radians(270.0)


def skies(size: int):
    air, camera = skyfit.Atmosphere.from_optical_depth(0.1), skyfit.Camera("fisheye", size, size)
    outside = camera.solid_angle(*np.mgrid[:size, :size]) == 0.0
    figure, grid = plt.subplots(3, 4, figsize=(9.6, 7.8), layout="constrained")
    for axes, elevation in zip(grid.ravel(), ELEVATIONS, strict=True):
        image = skyfit.render(air, camera, sun_zenith=np.radians(90.0 - elevation), sun_azimuth=WEST)
        picture = image.developed()
        picture[outside] = 1.0
        axes.imshow(picture, interpolation="bilinear")
        axes.set_title(f"sun {elevation:+g}°, white {image.white():.2g} cd m$^{{-2}}$", fontsize=9)
        axes.axis("off")
    figure.savefig(SKIES, dpi=100)


def limb():
    """The limb from 400 km; the last sun is just behind it."""
    camera = skyfit.Camera("perspective", 720, 150, azimuth=WEST, elevation=np.radians(-19.2), field_of_view=0.35)
    air = skyfit.Atmosphere.from_optical_depth(0.05)
    figure, grid = plt.subplots(3, 1, figsize=(7.6, 5.6), layout="constrained")
    for axes, sun in zip(grid, (85.0, 100.0, 107.5), strict=True):
        image = skyfit.render(air, camera, sun_zenith=np.radians(sun), sun_azimuth=WEST, height=400e3)
        axes.imshow(image.developed(), interpolation="bilinear")
        axes.set_title(f"sun at {sun:g}° from the zenith, white {image.white():.2g} cd m$^{{-2}}$", fontsize=9)
        axes.axis("off")
    figure.savefig(LIMB, dpi=100)


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--size", type=int, default=240, help="pixels across a sky")
    given = arguments.parse_args()
    skies(given.size)
    limb()


if __name__ == "__main__":
    main()
