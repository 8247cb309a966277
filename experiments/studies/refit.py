"""Every figure of the refit: how near Preetham's formula comes to simulated and to measured skies.

    python -m experiments.studies.refit [--shared ../shared] [--held-out 300]

Refits as the paper did (two orders of scattering), with all orders, and in the extended form; tests each on random
skies that it has not seen; says what a sixth term in Perez' formula would buy; scores published, refitted and extended
coefficients against measured skies. Writes experiments/results/refit.json, refit_errors.png and extended_errors.png,
and data/extended_preetham.csv, the coefficients that are shipped.
"""

import argparse
import csv
import importlib.metadata
import json
import pathlib
import platform
import time

import jax


jax.config.update("jax_enable_x64", True)

import equinox as eqx  # noqa: E402
import numpy as np  # noqa: E402
from scipy.optimize import least_squares, minimize_scalar  # noqa: E402

import skyfit  # noqa: E402
from skyfit.analytic import model_xyz, preetham_atmosphere  # noqa: E402
from skyfit.draw import plot_refit  # noqa: E402
from skyfit.light import earth_sun_factor  # noqa: E402
from skyfit.scene import angle_between  # noqa: E402


HERE = pathlib.Path(__file__).resolve().parents[1]
RESULTS = HERE / "results"
SHIPPED = HERE.parent / "data" / "extended_preetham.csv"
# nm, where the peers' scores of the measured skies are taken
SCORED_NM = 360.0 + 11.75 * np.arange(31)
STATED_ZENITH, STATED_SUN = np.radians(80.0), np.radians(85.0)


def timed_refit(**arguments):
    """A refit after compilation, its stages in seconds and what it is worth."""
    skyfit.refit(**arguments)
    stages, last = [], time.perf_counter()

    def report(done, of):
        nonlocal last
        stages.append(time.perf_counter() - last)
        last = time.perf_counter()

    result = skyfit.refit(progress=report, **arguments)
    record = {
        "simulation_seconds": stages[0],
        "fit_seconds": sum(stages[1:5]),
        "skies": len(result.fitted.turbidity),
        "fitted": part(result.fitted),
        "held_out": part(result.held_out),
        "result": result.result,
    }
    return result, record


def part(comparison) -> dict:
    """Pooled errors, null where a model has no answer."""
    return {
        where: {n: {k: number(v) for k, v in e._asdict().items()} for n, e in errors.items()}
        for where, errors in (("overall", comparison.overall), ("rest", comparison.rest))
    }


def number(value):
    return float(f"{value:.5g}") if np.isfinite(value) else None


def pooled_errors(model, view, skies) -> dict:
    """Luminance and chromaticity errors of any model over the skies of a comparison, stated region and the rest."""
    answer = model_xyz(model, view, skies)
    luminance = np.abs(answer[..., 1] / skies.simulated[..., 1] - 1.0)
    chromaticity = [xyz[..., :2] / xyz.sum(axis=-1, keepdims=True) for xyz in (answer, skies.simulated)]
    distance = np.linalg.norm(chromaticity[0] - chromaticity[1], axis=-1)
    stated = (np.asarray(view.zenith) <= STATED_ZENITH)[None] & (skies.sun_zenith <= STATED_SUN)[:, None]
    return {
        name: {
            "luminance": number(np.median(luminance[where])),
            "luminance_95": number(np.percentile(luminance[where], 95.0)),
            "chromaticity": number(np.median(distance[where])),
        }
        for name, where in (("overall", stated), ("rest", ~stated))
    }


# --- one more term

# name: what is added to the circumsolar factor of Perez' formula
TERMS = {
    "none": lambda theta, gamma: 0.0 * gamma,
    "sqrt(cos theta)": lambda theta, gamma: np.sqrt(np.maximum(np.cos(theta), 0.0)) + 0.0 * gamma,
    "cos gamma": lambda theta, gamma: np.cos(gamma),
    "exp(-20 gamma)": lambda theta, gamma: np.exp(-20.0 * gamma),
    "exp(-1 / cos theta)": lambda theta, gamma: np.exp(-1.0 / np.maximum(np.cos(theta), 0.01)) + 0.0 * gamma,
}


def one_more_term(view, skies, count=120) -> dict:
    """Pooled errors of the formula fitted to each sky, scale free, with a sixth term; whole dome in the fit."""
    theta = np.asarray(view.zenith)
    errors = {name: [] for name in TERMS}
    stated = []
    for i in range(min(count, len(skies.turbidity))):
        gamma = np.asarray(angle_between(view.zenith, skies.sun_zenith[i], view.azimuth))
        light = skies.simulated[i, :, 1]
        secant = 1.0 / np.maximum(np.cos(theta), 0.01) - 1.0
        stated.append((theta <= STATED_ZENITH) & (skies.sun_zenith[i] <= STATED_SUN))
        start = np.array([-0.9, -0.9, 8.0, 0.8, 0.4, np.log(light[-1]), 0.0])
        for name, term in TERMS.items():
            added = term(theta, gamma)

            def model(u, added=added, gamma=gamma, secant=secant):
                horizon = 1.0 + np.expm1(u[0]) * np.exp(-np.exp(u[1]) * secant)
                sun = 1.0 + u[2] * np.exp(-np.exp(u[3]) * gamma) + u[4] * np.cos(gamma) ** 2
                return np.exp(u[5]) * horizon * (sun + u[6] * added) / (1.0 + 8.0 * np.exp(-2.3))

            found = least_squares(lambda u, m=model, v=light: m(u) / v - 1.0, start, max_nfev=300)
            errors[name].append(np.abs(model(found.x) / light - 1.0))
    stated = np.array(stated)
    return {
        name: {
            where: {"luminance": number(np.median(e[at])), "luminance_95": number(np.percentile(e[at], 95.0))}
            for where, at in (("overall", stated), ("rest", ~stated))
        }
        for name, e in ((name, np.array(e)) for name, e in errors.items())
    }


# --- measured skies


def measured(path, models) -> dict:
    """RMSE of each model at the turbidity that fits each scan best; spectral in mW m^-2 sr^-1 nm^-1, luminance."""
    sky = skyfit.read(path).select(SCORED_NM)
    view = skyfit.Directions(sky.view_zenith[0], sky.view_azimuth[0])
    factor = float(earth_sun_factor(147))
    record = {}
    for name, (model, low, high) in models.items():
        answer = eqx.filter_jit(model.radiance)
        turbidity, spectral, luminance, bright = [], [], [], []
        for t in range(len(sky.time)):
            angles = np.degrees([sky.sun_zenith[t], sky.sun_azimuth[t]])
            scene = skyfit.Scene.from_degrees(angles[0], view, SCORED_NM, angles[1])
            used, seen = sky.usable[t], sky.radiance[t]

            def difference(haze, answer=answer, scene=scene, seen=seen):
                return factor * np.asarray(answer(haze, scene)) - seen

            def cost(haze, difference=difference, used=used):
                return float(np.mean(difference(haze)[used] ** 2))

            best = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-3}).x
            turbidity.append(best)
            spectral.append(1e3 * difference(best)[used])
            whole = used.all(axis=1)
            light = [np.asarray(skyfit.xyz(jax.numpy.asarray(v[whole]), SCORED_NM))[:, 1] for v in (
                difference(best) + seen, seen)]  # fmt: skip
            luminance.append(light[0] - light[1])
            bright.append(light[1])
        record[name] = {
            "spectral_rmse": number(rms(np.concatenate(spectral))),
            "scans": [number(rms(e)) for e in spectral],
            "luminance_rmse": number(rms(np.concatenate(luminance))),
            "mean_luminance": number(np.mean(np.concatenate(bright))),
            "turbidity": [number(v) for v in turbidity],
        }
        print(name, record[name], flush=True)
    return record


def rms(values) -> float:
    return float(np.sqrt(np.mean(values**2)))


def ship(model, record) -> None:
    """The extended coefficients as a table with its provenance."""
    overall = record["held_out"]["overall"]["refitted"]
    with SHIPPED.open("w", encoding="utf-8", newline="") as file:
        file.write(
            '# source: made by experiments/studies/refit.py: skyfit.refit(form="extended"), '
            "OrdersOfScattering.normal(),\n"
            "# skyfit's default atmosphere (Atmosphere.from_turbidity: Henyey-Greenstein haze, g 0.7, albedo 0.95,\n"
            "# Angstrom exponent 1.3, scale height 1.2 km; ozone 300 DU; ground albedo 0.1; ASTM G173 sun at 1 au)\n"
            "# quantity: 0 Y (cd m^-2), 1 x, 2 y; number: u_0 to u_5 of skyfit.ExtendedPreetham; turbidity, sun_j:\n"
            "# degrees of the Chebyshev polynomials\n"
            f"# held-out skies, view to 80, sun to 85 degrees: median luminance error {overall['luminance']:.2%}, "
            f"95th percentile\n# {overall['luminance_95']:.2%}, median xy distance {overall['chromaticity']:.4f}\n"
        )
        writer = csv.writer(file, lineterminator="\n")
        coefficients = np.asarray(model.coefficients)
        writer.writerow(["quantity", "number", "turbidity", *(f"sun_{j}" for j in range(coefficients.shape[3]))])
        for q, k, i in np.ndindex(coefficients.shape[:3]):
            writer.writerow([q, k, i, *(f"{c:.7g}" for c in coefficients[q, k, i])])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--shared", type=pathlib.Path, default=HERE.parent.parent / "shared")
    parser.add_argument("--held-out", type=int, default=300)
    arguments = parser.parse_args()
    record = {}
    cases = {
        "paper: two orders, no ground, flat below 70": {
            "solver": skyfit.DoubleScattering.normal(), "flat_below_deg": 70.0, "held_out": 60,
        },
        "two orders, spherical": {"solver": skyfit.DoubleScattering.normal(), "held_out": 60},
        "all orders, flat below 70": {"flat_below_deg": 70.0, "held_out": 60},
        "all orders": {"held_out": arguments.held_out},
        "extended": {"form": "extended", "held_out": arguments.held_out},
        "extended, Bullrich's haze": {
            "form": "extended", "atmosphere": preetham_atmosphere, "held_out": arguments.held_out,
        },
    }  # fmt: skip
    results = {}
    for name, options in cases.items():
        results[name], record[name] = timed_refit(**options)
        print(name, json.dumps(record[name]["held_out"]), f"{record[name]['simulation_seconds']:.2f} s,",
              f"{record[name]['fit_seconds']:.2f} s", flush=True)  # fmt: skip
    extended = results["extended"]
    # the linear form on the extended form's skies: fitted to the same atmosphere, range of turbidities and suns
    wide = skyfit.refit(
        atmosphere=skyfit.Atmosphere.from_turbidity, held_out=1,
        sun_zenith_deg=(0.0, 15.0, 30.0, 45.0, 55.0, 65.0, 72.0, 77.0, 81.0, 85.0),
        turbidity=(1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0),
    )  # fmt: skip
    skies = extended.held_out
    record["linear form on the extended form's skies"] = pooled_errors(wide.refitted, extended.view, skies)
    record["one more term"] = one_more_term(extended.view, skies)
    ship(extended.refitted, record["extended"])
    plot_refit(results["all orders"], RESULTS / "refit_errors.png")
    plot_refit(extended, RESULTS / "extended_errors.png")
    scans = arguments.shared / "measured" / "kider2014" / "2013-05-27.nc"
    if scans.exists():
        linear = skyfit.refit(atmosphere=skyfit.Atmosphere.from_turbidity, held_out=1)
        record["measured"] = measured(
            scans,
            {
                "published": (skyfit.Preetham.published(), 1.7, 10.0),
                "refitted": (results["all orders"].refitted, 2.0, 6.0),
                "refitted, Henyey-Greenstein haze": (linear.refitted, 2.0, 6.0),
                "extended": (extended.refitted, 1.0, 10.0),
                "extended, Bullrich's haze": (results["extended, Bullrich's haze"].refitted, 1.0, 10.0),
            },
        )
    else:
        print(f"{scans.name} is absent: the measured skies keep their last figures")
        record["measured"] = json.loads((RESULTS / "refit.json").read_text()).get("measured")
    record["made_with"] = {
        "dtype": "float64",
        "python": platform.python_version(),
        "machine": f"{platform.machine()}, 2 shared cores",
        **{name: importlib.metadata.version(name) for name in ("jax", "optimistix", "equinox", "numpy")},
    }
    (RESULTS / "refit.json").write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
