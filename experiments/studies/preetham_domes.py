"""Domes of the published analytic sky: six turbidities and suns as a screen shows them.

python -m experiments.studies.preetham_domes [--out FILE.png]
"""

import argparse
import pathlib

import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE
from skyfit.draw.dome import draw_dome
from skyfit.light import srgb_from_linear
from skyfit.scene import fisheye, unit_vectors


TURBIDITIES = (2.0, 4.0, 8.0)
# sun zenith in degrees, and the luminance of a white that is just not dimmed, cd m^-2
SUNS = ((30.0, 40e3), (80.0, 20e3))
SIZE = 480


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--out", type=pathlib.Path, default=HERE / "results" / "preetham_dome.png")
    given = arguments.parse_args()

    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    view, model = fisheye(SIZE), skyfit.Preetham.published()
    figure, grid = plt.subplots(2, 3, figsize=(7.8, 5.6), layout="constrained")
    for axes_row, (sun_deg, white) in zip(grid, SUNS, strict=True):
        sun = np.radians(sun_deg), np.radians(135.0)
        for axes, turbidity in zip(axes_row, TURBIDITIES, strict=True):
            linear = np.maximum(model.rgb(turbidity, unit_vectors(*sun), view), 0.0)
            # too bright for the screen: dimmed, its colour kept
            shown = linear / np.maximum(np.max(linear, axis=0), white)
            pixels = np.clip(np.moveaxis(np.asarray(srgb_from_linear(shown)), 0, -1), 0.0, 1.0)
            draw_dome(axes, pixels, sun, compass=False)
            axes.set_title(f"turbidity {turbidity:g}, sun zenith {sun_deg:g}°", fontsize=9)
    figure.savefig(given.out, dpi=110)


if __name__ == "__main__":
    main()
