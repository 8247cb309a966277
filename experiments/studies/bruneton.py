"""Bruneton & Neyret 2008 again: their figures 6 and 7 against the CIE's clear sky, and what their tables do wrong.

    python -m experiments.studies.bruneton

Writes bruneton_figure_6.png, bruneton_figure_7.png, bruneton_artefacts.png and bruneton.json into experiments/results/.
The air scatters 13.5e-6 per metre at 550 nm and as the inverse fourth power of the wavelength, which gives the 5.8 and
33.1e-6 of the paper at 680 and 440 nm; ozone is absent, as there.
"""

import json

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from skyfit.analytic import CIEClear
from skyfit.atmosphere import CornetteShanks, Exponential, Ground, Prescribed, RayleighPhase
from skyfit.scene import angle_between
from skyfit.transport import Bruneton, OrdersOfScattering, SingleScattering


matplotlib.use("Agg")
import matplotlib.pyplot as plt


RESULTS = HERE / "results"
WAVELENGTH = np.linspace(400.0, 700.0, 8)
ONE = np.array([550.0])
# per metre at 550 nm, and m: sec. 2.1
AIR, AIR_HEIGHT, HAZE_HEIGHT = 13.5e-6, 8e3, 1.2e3
SUNS = (0.0, 30.0, 50.0, 70.0, 80.0)
PIXELS = 160


def atmosphere(scattering: float, asymmetry: float, wavelength=WAVELENGTH) -> skyfit.Atmosphere:
    """The paper's: haze that scatters this much per metre at the ground, nine tenths of what it takes away."""
    air = AIR * AIR_HEIGHT * (550.0 / wavelength) ** 4
    haze = np.full(wavelength.shape, scattering / 0.9 * HAZE_HEIGHT)
    return skyfit.Atmosphere(
        Prescribed(air, Exponential(AIR_HEIGHT), RayleighPhase(0.0)),
        Prescribed(haze, Exponential(HAZE_HEIGHT), CornetteShanks(asymmetry), 0.9),
        None,
        Ground(0.1),
    )


def scene(sun: float, view: skyfit.Directions, wavelength=WAVELENGTH, height=None) -> skyfit.Scene:
    return skyfit.Scene.from_degrees(sun, view, wavelength, height=height)


def luminance(radiance) -> np.ndarray:
    return np.asarray(skyfit.xyz(jnp.asarray(radiance), WAVELENGTH))[:, 1]


def cie(sun: float, view: skyfit.Directions) -> np.ndarray:
    """The CIE's clear sky, type 12, over its zenith."""
    theta_sun = jnp.radians(sun)
    angle = angle_between(view.zenith, theta_sun, view.azimuth)
    sky = CIEClear()
    there = sky.luminance_chromaticity(3.0, theta_sun, view.zenith, angle)[0]
    up = sky.luminance_chromaticity(3.0, theta_sun, jnp.zeros(1), jnp.reshape(theta_sun, (1,)))[0]
    return np.asarray(there / up)


def dome() -> tuple[skyfit.Directions, np.ndarray]:
    """Directions of the pixels of a dome with the sun's side up, and which are sky."""
    x, y, z = np.asarray(skyfit.fisheye(PIXELS))
    zenith, azimuth = np.arccos(np.clip(z, -1.0, 1.0)).ravel(), np.arctan2(x, y).ravel()
    return skyfit.Directions(zenith, azimuth), (z > 0.0).ravel()


def image(radiance, inside, share=90.0, brightness=0.7) -> np.ndarray:
    """sRGB with its own exposure: this percentile of the luminance at `brightness`."""
    exposure = brightness / np.percentile(luminance(radiance)[inside], share)
    pixels = np.array(skyfit.srgb(jnp.asarray(radiance), WAVELENGTH, exposure))
    return np.where(inside[:, None], np.clip(pixels, 0.0, 1.0), 1.0)


def zenith_of(field, sun: float) -> float:
    return float(luminance(field.radiance(scene(sun, skyfit.Directions(np.zeros(1), np.zeros(1)))))[0])


def figure_6(field) -> dict:
    """Domes in colour, their luminance over the zenith's, and the CIE's."""
    view, inside = dome()
    figure, axes = plt.subplots(3, len(SUNS), figsize=(2.2 * len(SUNS), 7.0), layout="constrained")
    levels, ratios = None, {}
    for column, sun in enumerate(SUNS):
        light = np.asarray(field.radiance(scene(sun, view)))
        relative, standard = luminance(light) / zenith_of(field, sun), cie(sun, view)
        axes[0, column].imshow(image(light, inside).reshape(PIXELS, PIXELS, 3))
        axes[0, column].set_title(f"sun zenith {sun:g}°")
        for row, values in ((1, relative), (2, standard)):
            shown = np.where(inside, np.log10(np.maximum(values, 1e-3)), np.nan).reshape(PIXELS, PIXELS)
            levels = axes[row, column].imshow(shown, vmin=-0.8, vmax=1.2, cmap="viridis")
            axes[row, column].contour(shown, np.log10([0.5, 1.0, 2.0, 4.0, 8.0]), colors="white", linewidths=0.6)
        bands = {"view zenith to 60": (0.0, 60.0), "60 to 80": (60.0, 80.0), "80 to 89": (80.0, 89.0)}
        angle = np.degrees(np.asarray(view.zenith))
        ratios[f"sun {sun:g}"] = {
            name: float(np.median((relative / standard)[(angle >= low) & (angle < high)]))
            for name, (low, high) in bands.items()
        }
    for row, label in enumerate(("Bruneton", "luminance over the zenith's", "CIE clear sky, type 12")):
        axes[row, 0].set_ylabel(label)
    for ax in axes.ravel():
        ax.set_xticks([])
        ax.set_yticks([])
        for side in ax.spines.values():
            side.set_visible(False)
    figure.colorbar(levels, ax=axes[1:], shrink=0.6, label="log10 of luminance over the zenith's")
    figure.suptitle("Figure 6: albedo 0.1, haze 2e-5 per metre, 0.9 of it scattered, g 0.76, 1.2 km")
    figure.savefig(RESULTS / "bruneton_figure_6.png", dpi=110)
    plt.close(figure)
    return ratios


def figure_7(field) -> None:
    """Luminance over the zenith's in the sun's vertical plane."""
    suns = (0.0, 20.0, 40.0, 60.0, 70.0, 80.0)
    angle = np.linspace(-89.5, 89.5, 359)
    view = skyfit.Directions(np.radians(np.abs(angle)), np.where(angle < 0.0, np.pi, 0.0))
    figure, axes = plt.subplots(2, 3, figsize=(11.0, 6.4), layout="constrained", sharex=True)
    for ax, sun in zip(axes.ravel(), suns, strict=True):
        relative = luminance(field.radiance(scene(sun, view))) / zenith_of(field, sun)
        ax.semilogy(angle, relative, label="Bruneton")
        ax.semilogy(angle, cie(sun, view), "--", label="CIE type 12")
        ax.axvline(sun, color="0.7", linewidth=0.8)
        ax.set_title(f"sun {sun:g}° from the zenith")
        ax.set_ylim(0.2, 40.0)
    axes[0, 0].legend()
    for ax in axes[1]:
        ax.set_xlabel("view zenith angle, degrees, the sun's side positive")
    for ax in axes[:, 0]:
        ax.set_ylabel("luminance over the zenith's")
    figure.suptitle("Figure 7: albedo 0.1, haze 2.2e-5 per metre, 0.9 of it scattered, g 0.73, 1.2 km")
    figure.savefig(RESULTS / "bruneton_figure_7.png", dpi=110)
    plt.close(figure)


def by_sun(ask, suns: np.ndarray, view: skyfit.Directions) -> np.ndarray:
    """Radiance of views under many suns, `[sun, direction]`."""

    def one(sun):
        return ask(skyfit.Scene(sun, 0.0, view, ONE, jnp.ones(1)))[:, 0]

    return np.asarray(jax.jit(lambda s: jax.lax.map(one, s))(jnp.radians(jnp.asarray(suns, jnp.float32))), float)


def steps(ax, field, sky) -> float:
    """How fast the twilight fades by the tables, which are linear between 32 suns, and the light scattered once."""
    suns = np.arange(84.0, 101.0, 0.05)
    view = skyfit.Directions.from_degrees([0.0, 80.0], [0.0, 0.0])
    middle = 0.5 * (suns[1:] + suns[:-1])
    worst = 0.0
    for ask, label, dash in (
        (field.radiance, "tables", "-"),
        (lambda s: SingleScattering.fine().radiance(sky, s), "scattered once, no table", ":"),
    ):
        light = by_sun(ask, suns, view)
        fade = -np.diff(np.log(np.maximum(light, 1e-30)), axis=0) / 0.05
        for place, name in enumerate(("zenith", "10° up, toward the sun")):
            ax.plot(middle, np.where(fade[:, place] < 3.0, fade[:, place], np.nan), dash, label=f"{label}: {name}",
                    color=f"C{place}")  # fmt: skip
        if dash == "-":
            worst = float(np.max(np.abs(np.diff(fade[:, 0]))))
    ax.set(xlabel="sun zenith angle, degrees", ylabel="fading, 1 / degree", title="Steps after sunset", ylim=(0, 2.5))
    ax.legend(fontsize=7)
    return worst


def stripe(ax, alone, sky) -> dict:
    """Light scattered once at the horizon, by the table over the integral."""
    worst = {}
    for height in (20.0, 200.0, 2000.0):
        dip = np.degrees(np.arccos(6371e3 / (6371e3 + height)))
        off = np.concatenate([-np.geomspace(3.0, 0.003, 150), np.geomspace(0.003, 3.0, 150)])
        view = skyfit.Directions.from_degrees(90.0 + dip - off, np.full(off.shape, 60.0))
        seen = scene(75.0, view, ONE, height)
        ratio = np.asarray(alone.radiance(seen) - ground_alone(alone, seen))[:, 0]
        ratio = ratio / np.asarray(SingleScattering.fine().radiance(sky, seen))[:, 0]
        ax.plot(off, 100.0 * (ratio - 1.0), label=f"{height:g} m up")
        worst[f"{height:g} m"] = float(np.max(np.abs(ratio - 1.0)))
    ax.set(xlabel="degrees above the horizon", ylabel="table over integral - 1, %", title="Stripe at the horizon",
           ylim=(-25, 5))  # fmt: skip
    ax.axvline(0.0, color="0.7", linewidth=0.8)
    ax.legend(fontsize=7)
    return worst


def ground_alone(field, seen: skyfit.Scene):
    """What the ground adds to views that meet it: all that the air before it does not."""
    return field.radiance(seen) - field.path(seen, jnp.full(seen.view.zenith.shape, jnp.inf)).inscatter


def blur(ax, field, alone, sky) -> None:
    """What is scattered more than once about the sun, by eight angles and by streams with their aureole."""
    turn = np.linspace(0.5, 90.0, 180)
    view = skyfit.Directions.from_degrees(np.full(turn.shape, 60.0), turn)
    seen = scene(60.0, view, ONE)
    angle = np.degrees(np.asarray(angle_between(view.zenith, seen.sun_zenith, view.azimuth)))
    fine = OrdersOfScattering.fine().radiance(sky, seen) - SingleScattering.fine().radiance(sky, seen)
    ax.plot(angle, np.asarray(fine)[:, 0], label="streams, fine")
    ax.plot(angle, np.asarray(field.radiance(seen) - alone.radiance(seen))[:, 0], label="tables, 8 angles")
    ax.set(xlabel="angle from the sun, degrees", ylabel="W m⁻² sr⁻¹ nm⁻¹", title="Blur: light scattered more than once")
    ax.legend(fontsize=7)


def twilight(axes, field) -> None:
    """The sky toward the sun from 2 km up, the horizon in the lower third, each sun with its own exposure."""
    rows, columns = 90, 160
    up = np.linspace(14.0, -6.0, rows)
    view = skyfit.Directions.from_degrees(90.0 - up[:, None], np.linspace(-40.0, 40.0, columns)[None])
    for ax, sun in zip(axes, (85.0, 89.0, 92.0, 95.0), strict=True):
        light = np.asarray(field.radiance(scene(sun, view, height=2000.0)))
        ax.imshow(image(light, np.ones(light.shape[0], bool), 97.0, 0.9).reshape(rows, columns, 3))
        ax.set_title(f"sun {sun:g}°", fontsize=9)
        ax.set_axis_off()


def main() -> None:
    solver = Bruneton.normal()
    field = solver.prepare(atmosphere(2e-5, 0.76), WAVELENGTH)
    record = made_with(0) | {
        "figure 6: luminance over the zenith's, Bruneton over CIE type 12, median": figure_6(field)
    }
    figure_7(solver.prepare(atmosphere(2.2e-5, 0.73), WAVELENGTH))
    figure = plt.figure(figsize=(13.0, 6.6), layout="constrained")
    grid = figure.add_gridspec(2, 12, height_ratios=(1.6, 1.0))
    graphs = [figure.add_subplot(grid[0, 4 * i : 4 * i + 4]) for i in range(3)]
    twilight([figure.add_subplot(grid[1, 3 * i : 3 * i + 3]) for i in range(4)], field)
    sky = atmosphere(2e-5, 0.76, ONE)
    single, whole = Bruneton(orders=1).prepare(sky, ONE), solver.prepare(sky, ONE)
    record["steps: largest jump of the zenith's fading, 1 / degree"] = steps(graphs[0], whole, sky)
    record["stripe: largest error of light scattered once within 3 degrees of the horizon"] = stripe(
        graphs[1], single, sky
    )
    blur(graphs[2], whole, single, sky)
    figure.suptitle("What the tables do wrong, at the paper's sizes; below, the sky toward the sun from 2 km up")
    figure.savefig(RESULTS / "bruneton_artefacts.png", dpi=110)
    (RESULTS / "bruneton.json").write_text(json.dumps(record, indent=1) + "\n")
    print(json.dumps(record, indent=1))


if __name__ == "__main__":
    main()
