"""What each direction of a clear sky tells of haze, ozone and ground, and in which directions AOD is best measured.

    python -m experiments.studies.sensitivity [--out FILE.json]

Turbidity 3, sun at 50 degrees; all orders of scattering, 440-870 nm, noise of 2 %, eight free parameters with weak
priors. The greedy choice is free among 343 directions of the dome and those of its rivals: an almucantar, the
principal plane, and the median of seeded random choices among the 343. A figure beside the json.
"""

import argparse
import json
import pathlib
import time

import jax
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from skyfit.draw import plot_sensitivity


SEED = 0
TURBIDITY, SUN_DEG, SUN_AZIMUTH_DEG = 3.0, 50.0, 180.0
WAVELENGTH_NM = np.array([440.0, 500.0, 550.0, 600.0, 675.0, 870.0])
SHOWN = (
    "aerosol_optical_depth", "angstrom_exponent", "single_scattering_albedo", "asymmetry", "ground_albedo", "ozone",
)  # fmt: skip
# free parameters and the sigma with which each is known before
PRIOR = {
    "aerosol_optical_depth": 0.5, "angstrom_exponent": 1.0, "single_scattering_albedo": 0.1, "asymmetry": 0.1,
    "ground_albedo": 0.2, "ozone": 50.0, "pointing_zenith": 0.5, "pointing_azimuth": 0.5,
}  # fmt: skip
NOISE = 0.02
MOST, NUMBERED, DRAWS = 24, 10, 200
# degrees from the sun's azimuth, either side, in the manner of AERONET: Holben et al. 1998, Remote Sens. Environ. 66, 1
ALMUCANTAR = (
    3.5, 4, 5, 6, 7, 8, 10, 12, 14, 16, 18, 20, 25, 30, 35, 40, 45, 50, 60, 70, 80, 90, 100, 110, 120, 130, 140, 160,
    180,
)  # fmt: skip
# degrees from the sun in its vertical plane, positive past the zenith; to a view zenith of 80
PLANE = (
    -6,
    -5,
    -4,
    -3.5,
    3.5,
    4,
    5,
    6,
    8,
    10,
    12,
    14,
    16,
    18,
    20,
    25,
    30,
    35,
    40,
    45,
    50,
    60,
    70,
    80,
    90,
    100,
    110,
    120,
)


def pool() -> tuple[skyfit.Directions, dict[str, np.ndarray]]:
    """All directions, and the indices of each group in them."""
    dome = skyfit.hemisphere(343, np.radians(80.0))
    offset = np.array(ALMUCANTAR)
    around = np.concatenate([-offset[::-1], offset[:-1]])
    zenith = SUN_DEG - np.array(PLANE)
    across = SUN_AZIMUTH_DEG + np.where(zenith < 0.0, 180.0, 0.0)
    parts = {
        "dome": (np.degrees(dome.zenith), np.degrees(dome.azimuth)),
        "almucantar": (np.full(around.size, SUN_DEG), SUN_AZIMUTH_DEG + around),
        "principal plane": (np.abs(zenith), across),
    }
    angles = np.concatenate([np.stack(part) for part in parts.values()], axis=1)
    ends = np.cumsum([0, *(len(part[0]) for part in parts.values())])
    groups = {name: np.arange(ends[i], ends[i + 1]) for i, name in enumerate(parts)}
    return skyfit.Directions.from_degrees(*angles), groups


def even(group: np.ndarray, count: int) -> np.ndarray:
    """So many of a scan, evenly chosen of its order, its ends included."""
    return group[np.linspace(0, group.size - 1, count).round().astype(int)]


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--out", type=pathlib.Path, default=HERE / "results" / "sensitivity.json")
    given = arguments.parse_args()
    jax.config.update("jax_enable_x64", True)

    atmosphere = skyfit.Atmosphere.from_turbidity(TURBIDITY)
    view, groups = pool()
    scene = skyfit.Scene.from_degrees(SUN_DEG, view, WAVELENGTH_NM, SUN_AZIMUTH_DEG)
    free, prior = tuple(PRIOR), np.array(list(PRIOR.values()))
    information = np.asarray(skyfit.fisher_information(scene, atmosphere, free, NOISE))
    target = free[0]

    def sigma(indices) -> float:
        spread = skyfit.posterior_covariance(information[indices].sum(axis=0), prior)
        return float(np.sqrt(spread[0, 0]))

    skyfit.next_directions(information, free, 1, target, prior=prior)
    begin = time.perf_counter()
    choice = skyfit.next_directions(information, free, MOST, target, prior=prior)
    seconds = time.perf_counter() - begin
    counts = range(1, MOST + 1)
    draw = np.random.default_rng(SEED)
    random = np.array([[sigma(draw.choice(groups["dome"], n, replace=False)) for n in counts] for _ in range(DRAWS)])
    curves = {
        "greedy": choice.sigma[:, 0],
        "principal plane": np.array([sigma(even(groups["principal plane"], n)) for n in counts]),
        "almucantar": np.array([sigma(even(groups["almucantar"], n)) for n in counts]),
        "random, median": np.median(random, axis=0),
    }

    few = np.array([440.0, 600.0, 870.0])
    dome = skyfit.hemisphere(700, np.radians(88.0))
    drawn = skyfit.Scene.from_degrees(SUN_DEG, dome, few, SUN_AZIMUTH_DEG)
    solver = skyfit.OrdersOfScattering.normal()
    relative = skyfit.sensitivity(drawn, atmosphere, SHOWN, solver) / solver.radiance(atmosphere, drawn)[None]
    first = choice.order[:NUMBERED]
    plot_sensitivity(
        drawn, SHOWN, np.asarray(relative), given.out.with_suffix(".png"),
        chosen=skyfit.Directions(view.zenith[first], view.azimuth[first]), sigmas=curves,
        title=f"What a clear sky tells: turbidity {TURBIDITY:g}, sun zenith {SUN_DEG:g}\N{DEGREE SIGN}, "
        f"{WAVELENGTH_NM.size} wavelengths with {100.0 * NOISE:g} % noise",
    )  # fmt: skip
    degrees = np.degrees(np.stack([view.zenith, view.azimuth], axis=1)) % 360.0
    report = {
        "turbidity": TURBIDITY, "sun zenith": SUN_DEG, "sun azimuth": SUN_AZIMUTH_DEG,
        "wavelengths nm": WAVELENGTH_NM.tolist(), "relative noise": NOISE, "prior sigma": PRIOR,
        "candidates": len(information), "target": target,
        "greedy directions, zenith and azimuth in degrees": [
            f"{zenith:.1f} {azimuth:.1f}" for zenith, azimuth in degrees[choice.order]
        ],
        "greedy, ms for all steps": round(1e3 * seconds, 1),
        "sigma after 1, 2, ... directions": {name: _rounded(values) for name, values in curves.items()},
        "random, 10th and 90th percentile": [_rounded(row) for row in np.percentile(random, (10.0, 90.0), axis=0)],
        "sigma of all candidates": {
            name: float(f"{value:.3g}") for name, value in zip(
                free, np.sqrt(np.diag(skyfit.posterior_covariance(information.sum(axis=0), prior))), strict=True
            )
        },
        **made_with(SEED),
    }  # fmt: skip
    given.out.write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))


def _rounded(values) -> list[float]:
    return [float(f"{value:.3g}") for value in values]


if __name__ == "__main__":
    main()
