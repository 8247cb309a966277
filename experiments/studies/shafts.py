"""The shadow of a ridge in the air, into a low sun and from the side: lit segments, and what the paper does.

    python -m experiments.studies.shafts [--width 240]

A ridge 15 km north of the eye, its crest uneven, the sun 4 degrees high behind it. Left to right: without shade;
sunlight integrated over the lit parts of each view alone, the light of higher orders left in the shade
(`SphericalField.path(lit=)`); higher orders taken out of the shade too, as eq. 17 and 18 of Bruneton & Neyret 2008 do.
Above: into the sun; below: toward the east, along the ridge's shadow. Writes experiments/results/shafts.png.
"""

import argparse

import matplotlib
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE
from experiments.studies.day_and_night import developed


matplotlib.use("Agg")
from matplotlib import pyplot as plt


RESULT = HERE / "results" / "shafts.png"
NM = np.arange(400.0, 711.0, 31.0)
# m: the eye, the ridge's line, the end of what it shades
EYE, RIDGE, FAR = 300.0, 15e3, 150e3
SUN_DEG, CHUNK, STEPS, SEGMENTS = 86.0, 4096, 400, 3


def crest(east):
    """Height of the ridge, m."""
    return (
        900.0
        + 500.0 * np.sin(east / 2100.0 + 0.6)
        + 350.0 * np.sin(east / 800.0)
        + 900.0 * np.exp(-((east / 900.0) ** 2))
    )


def segments(view):
    """Distance to the ridge or the ground (m, infinite for the sky), and the lit parts of views `[3, pixel]`."""
    east, north, up = view
    with np.errstate(divide="ignore", invalid="ignore"):
        to_ridge = np.where(north > 1e-9, RIDGE / north, np.inf)
        to_ground = np.where(up < 0.0, EYE / -up, np.inf)
        meets = np.isfinite(to_ridge) & (EYE + up * to_ridge < crest(np.nan_to_num(east * to_ridge, posinf=0.0)))
    hit = np.minimum(np.where(meets, to_ridge, np.inf), to_ground)
    end = np.minimum(hit, FAR)
    # dense near the eye; the sun stands due north, so that a place is shaded by the crest north of it
    along = np.concatenate([[0.0], np.geomspace(30.0, 1.0e0 * FAR, STEPS)])[:, None] * np.ones_like(end)
    along = np.minimum(along, end)
    x, y, z = east * along, north * along, EYE + up * along
    shaded = (y < RIDGE) & (z < crest(x) - (RIDGE - y) / np.tan(np.radians(SUN_DEG)))
    change = np.diff(np.pad(~shaded, ((1, 1), (0, 0))).astype(int), axis=0)
    parts = []
    for k in range(SEGMENTS):
        begin = np.argmax((np.cumsum(change == 1, axis=0) == k + 1) & (change == 1), axis=0)
        stop = np.argmax((np.cumsum(change == -1, axis=0) == k + 1) & (change == -1), axis=0)
        there = np.any(np.cumsum(change == 1, axis=0) == k + 1, axis=0)
        low = np.where(there, np.take_along_axis(along, np.minimum(begin, STEPS)[None], 0)[0], 0.0)
        high = np.where(there, np.take_along_axis(along, np.minimum(np.maximum(stop - 1, 0), STEPS)[None], 0)[0], 0.0)
        # what is lit to the end of the samples is lit to the end
        open_end = there & (stop == STEPS + 1)
        parts.append((low, np.where(open_end, np.where(np.isfinite(hit), hit, 1e7), high)))
    return hit, parts


def pictures(field, azimuth_deg: float, width: int, rows: int):
    across, up = np.meshgrid(np.linspace(-25.0, 25.0, width), np.linspace(22.0, -4.0, rows))
    zenith, azimuth = np.radians(90.0 - up.ravel()), np.radians(azimuth_deg + across.ravel())
    view = np.stack([np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)])
    hit, parts = segments(view)
    found = {"no shade": [], "lit segments": [], "as the paper": []}
    for start in range(0, zenith.size, CHUNK):
        pick = np.arange(start, start + CHUNK) % zenith.size
        views = skyfit.Directions(zenith[pick], azimuth[pick])
        scene = skyfit.Scene.from_degrees(SUN_DEG, views, NM, height=EYE)
        away = np.minimum(hit[pick], 1e7)
        lit = [(low[pick], high[pick]) for low, high in parts]
        whole = field.path(scene, away)
        light = scene.solar_irradiance[None] * 0.012 * np.isfinite(hit[pick])[:, None] * whole.transmittance
        shaded = field.path(scene, away, lit=lit)
        paper = sum(field.path(scene, high).inscatter - field.path(scene, low).inscatter for low, high in lit)
        for name, inscatter in zip(found, (whole.inscatter, shaded.inscatter, paper), strict=True):
            found[name].append(np.asarray(skyfit.xyz(inscatter + light, NM)))
    return {name: np.concatenate(parts)[: zenith.size] for name, parts in found.items()}


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--width", type=int, default=240)
    given = arguments.parse_args()
    rows = given.width * 26 // 50
    atmosphere = skyfit.Atmosphere.from_optical_depth(0.35)
    field = skyfit.Spherical.normal().prepare(atmosphere, NM, sun_zenith=np.radians(SUN_DEG), height=EYE)
    figure, grid = plt.subplots(2, 3, figsize=(13.0, 5.2), layout="constrained")
    for axes_row, azimuth, name in zip(grid, (0.0, 90.0), ("into the sun", "from the side"), strict=True):
        seen = pictures(field, azimuth, given.width, rows)
        for axes, (title, light) in zip(axes_row, seen.items(), strict=True):
            pixels, _ = developed(light, (rows, given.width))
            axes.imshow(pixels, extent=(-25.0, 25.0, -4.0, 22.0), interpolation="bilinear")
            axes.set_title(f"{name}: {title}", fontsize=9)
            axes.tick_params(labelsize=7)
    figure.savefig(RESULT, dpi=90)


if __name__ == "__main__":
    main()
