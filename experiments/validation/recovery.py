"""Skies of other solvers with 1 % noise, inverted: how often the truth lies within limits and error bars.

    python -m experiments.validation.recovery [--skies 100] [--spherical 24] [--shared ../shared] [--only PART]
        [--out FILE.json]

sasktran2's flat skies of 30 directions and 8 wavelengths (tests/foreign_skies.py) are inverted with
`OrdersOfScattering.normal("flat")` and, for comparison, `draft`; haze of two lobes with the default parameters; skies
of the shared oracle (nanodisort, two wavelengths, sun and haze on its grid); sasktran2's spherical skies with the
default solver. Of these the Monte Carlo of the shared oracles says that sasktran2 itself is 0.6 % bright in clear air
and 1-2 % dark in haze at its levels of 1 km: they are no reference, and stand here for the size of such an error.
`model_error`: the noise-free radiance of skyfit over sasktran2's, what it does to the parameters, and which amplitude
of smooth relative errors accounts for that.
"""

import argparse
import importlib.util
import json
import pathlib
import sys
import time
from collections import Counter

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from skyfit.retrieve import LOBES_FREE, simulate, SkyModel, with_values


def tests_module(name: str):
    """A module of the tests' folder, which is no package."""
    spec = importlib.util.spec_from_file_location(name, HERE.parent / "tests" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


foreign = tests_module("foreign_skies")

SEED, NOISE = 5, 0.01
FREE = ("aerosol_optical_depth", "angstrom_exponent", "single_scattering_albedo", "asymmetry", "ground_albedo")
# what must be reached; single-scattering albedo where the optical depth is at least HAZY
LIMITS = {"aerosol_optical_depth": 0.005, "angstrom_exponent": 0.05, "single_scattering_albedo": 0.02}
HAZY = 0.2
FLAT = {name: getattr(skyfit.OrdersOfScattering, name)("flat") for name in ("normal", "draft")}
# sets of smooth relative errors, each with the same amplitude
SHAPES = {
    "constant": ("constant",),
    "constant, wavelength": ("constant", "wavelength"),
    "constant, wavelength, airmass": ("constant", "wavelength", "airmass"),
    "constant, wavelength, airmass, P1-P2": ("constant", "wavelength", "airmass", "P1", "P2"),
    "constant, wavelength, airmass, P1-P4": ("constant", "wavelength", "airmass", "P1", "P2", "P3", "P4"),
    "constant, wavelength, airmass, P1-P6": ("constant", "wavelength", "airmass", *(f"P{i}" for i in range(1, 7))),
}


def recover(rows, free, solver) -> dict:
    """Inverts the skies (truth, sky, start) and sums up."""
    truths, errors, sigmas, results, seconds = [], [], [], Counter(), []
    for truth, sky, start in rows:
        begin = time.perf_counter()
        fit = skyfit.invert(sky, free, solver, start)
        seconds.append(time.perf_counter() - begin)
        results[fit.result[0]] += 1
        values, sigma = fit.values[0].copy(), fit.sigma[0].copy()
        if "forward_fraction" in free:
            first, second, share = (free.index(n) for n in ("asymmetry", "asymmetry_second", "forward_fraction"))
            if values[first] < values[second]:
                # the lobes have no order: the same phase function
                values[[first, second]], sigma[[first, second]] = values[[second, first]], sigma[[second, first]]
                values[share] = 1.0 - values[share]
        truths.append(truth)
        errors.append(values - truth.values(free))
        sigmas.append(sigma)
    return {
        "skies": len(truths),
        "results": dict(results),
        "seconds a fit": float(np.median(seconds[1:])),
        "parameters": summary(free, truths, np.array(errors), np.array(sigmas)),
    }


def summary(free, truths, errors, sigmas) -> dict:
    """Shares and extremes for each parameter."""
    table = {}
    for p, name in enumerate(free):
        hazy = [t.aerosol_optical_depth >= HAZY or name != "single_scattering_albedo" for t in truths]
        kept = np.flatnonzero(hazy)
        error, sigma = errors[kept, p], sigmas[kept, p]
        off = np.abs(error) / sigma
        row = {"cases": int(kept.size)}
        if name in LIMITS:
            row |= {
                "limit": LIMITS[name],
                "share within limit": float(np.mean(np.abs(error) <= LIMITS[name])),
                "share of sigma within limit": float(np.mean(sigma <= LIMITS[name])),
            }
        worst = kept[np.argsort(-off)[:3]]
        table[name] = row | {
            "share within 1 sigma": float(np.mean(off <= 1.0)),
            "share within 2 sigma": float(np.mean(off <= 2.0)),
            "error rms": float(np.sqrt(np.mean(error**2))),
            "error max": float(np.max(np.abs(error))),
            "sigma median": float(np.median(sigma)),
            "sigma max": float(np.max(sigma)),
            "worst": [
                {"sigmas off": float(errors[i, p] / sigmas[i, p])}
                | {k: round(v, 4) for k, v in vars(truths[i]).items()}
                for i in worst
            ],
        }
    return table


def noisy_skies(truths, **settings):
    """sasktran2's, each with its own noise."""
    for seed, truth in enumerate(truths):
        yield truth, foreign.with_noise(foreign.sasktran2_sky(truth, NOISE, **settings), seed), None


def noisy_oracle(path, draws: int = 4):
    """The shared oracle's skies, each with several draws of noise."""
    for place, (truth, sky, start) in enumerate(foreign.oracle_skies(path, NOISE)):
        for seed in range(draws):
            yield truth, foreign.with_noise(sky, 1000 * place + seed), start


@eqx.filter_jit
def _radiance_and_jacobian(solver, model, values, scene):
    def radiance(values):
        sky = simulate(solver, with_values(model, FREE, values), scene)
        return sky, sky

    jacobian, sky = jax.jacfwd(radiance, has_aux=True)(values)
    return sky, jacobian


def relative_shapes(sky, names) -> np.ndarray:
    """Smooth relative errors of size about one on the sky's samples, `[sample, shape]`."""
    zenith, azimuth = sky.view_zenith[0], sky.view_azimuth[0]
    airmass = 1.0 / np.cos(zenith)
    cosine = np.cos(sky.sun_zenith[0]) * np.cos(zenith)
    cosine = cosine + np.sin(sky.sun_zenith[0]) * np.sin(zenith) * np.cos(azimuth - sky.sun_azimuth)
    one = np.ones_like(cosine)
    colour, grey = np.log(sky.wavelength_nm / 550.0) / 0.3, np.ones_like(sky.wavelength_nm)
    every = {
        "constant": np.outer(one, grey),
        "wavelength": np.outer(one, colour),
        "airmass": np.outer((airmass - 1.0) / 3.0, grey),
    }
    every |= {f"P{i}": np.outer(np.polynomial.Legendre.basis(i)(cosine), grey) for i in range(1, 7)}
    return np.stack([every[name].ravel() for name in names], axis=1)


def model_error(truths, solver) -> dict:
    """Noise-free radiance against sasktran2's and, to first order, what it does to the parameters."""
    errors, biases, gains, sigmas, skies = [], [], [], [], []
    for truth in truths:
        sky = foreign.sasktran2_sky(truth)
        view = skyfit.Directions(sky.view_zenith[0], sky.view_azimuth[0])
        sun = skyfit.light.extraterrestrial_irradiance(sky.wavelength_nm, sky.fwhm_nm)
        scene = skyfit.Scene(sky.sun_zenith[0], sky.sun_azimuth[0], view, sky.wavelength_nm, sun)
        found = _radiance_and_jacobian(solver, SkyModel(truth.atmosphere()), jnp.asarray(truth.values(FREE)), scene)
        radiance, jacobian = (np.asarray(a) for a in found)
        error = (radiance / sky.radiance[0] - 1.0).ravel()
        jacobian = (jacobian / radiance[..., None]).reshape(-1, len(FREE))
        covariance = np.linalg.inv(jacobian.T @ jacobian)
        # the fit of relative errors of one size
        gain = -covariance @ jacobian.T
        errors.append(error)
        gains.append(gain)
        biases.append(gain @ error)
        sigmas.append(NOISE * np.sqrt(np.diag(covariance)))
        skies.append(sky)
    errors, biases, sigmas = (np.array(a) for a in (errors, biases, sigmas))
    sets = {}
    for name, shapes in SHAPES.items():
        unit = np.array(
            [np.linalg.norm(g @ relative_shapes(s, shapes), axis=1) for g, s in zip(gains, skies, strict=True)]
        )
        ratio = np.sqrt(np.mean((biases / unit) ** 2, axis=0))
        amplitude = float(np.sqrt(np.mean((biases / unit) ** 2)))
        sets[name] = {
            "amplitude": amplitude,
            "bias over sigma, rms": dict(zip(FREE, map(float, ratio / amplitude), strict=True)),
        }
    return {
        "skies": len(truths),
        "relative error": {
            "rms": float(np.sqrt(np.mean(errors**2))),
            "median": float(np.median(np.abs(errors))),
            "max": float(np.max(np.abs(errors))),
        },
        "bias over noise sigma, rms": dict(
            zip(FREE, map(float, np.sqrt(np.mean((biases / sigmas) ** 2, axis=0))), strict=True)
        ),
        "bias over noise sigma, max": dict(zip(FREE, map(float, np.max(np.abs(biases / sigmas), axis=0)), strict=True)),
        "shapes": sets,
    }


def show(name: str, record: dict) -> None:
    print(f"\n{name}: {record['skies']} skies")
    if "shapes" in record:
        print({k: v for k, v in record.items() if k != "shapes"})
        for shapes, row in record["shapes"].items():
            ratios = " ".join(f"{v:5.2f}" for v in row["bias over sigma, rms"].values())
            print(f"  {shapes:42s} amplitude {100.0 * row['amplitude']:7.4f} %  bias over sigma {ratios}")
        return
    print(f"  {record['results']}, {1e3 * record['seconds a fit']:.0f} ms a fit")
    print(f"{'':28s}cases  in limit  1 sigma  2 sigma  sigma median    max  in limit  error rms      max")
    for parameter, row in record["parameters"].items():
        shares = [row.get("share within limit"), row["share within 1 sigma"], row["share within 2 sigma"]]
        first = "".join("        -" if s is None else f"{100.0 * s:7.0f} %" for s in shares)
        held = row.get("share of sigma within limit")
        print(
            f"  {parameter:25s}{row['cases']:6d} {first}  {row['sigma median']:11.5f} {row['sigma max']:8.5f}"
            + ("        -" if held is None else f"{100.0 * held:7.0f} %")
            + f"  {row['error rms']:9.5f} {row['error max']:8.5f}"
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--skies", type=int, default=100)
    parser.add_argument("--spherical", type=int, default=24)
    parser.add_argument("--shared", type=pathlib.Path, default=HERE.parent.parent / "shared")
    parser.add_argument("--only", default="", help="the parts to make anew, with semicolons")
    parser.add_argument("--out", type=pathlib.Path, default=HERE / "results" / "recovery.json")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    record = json.loads(arguments.out.read_text()) if arguments.out.exists() else {}
    truths = foreign.random_truths(arguments.skies, SEED)
    two_lobes = foreign.random_truths(arguments.skies // 2, SEED, two_lobes=True)
    oracle = arguments.shared / "oracles" / "oracle_pp_aerosol.npz"
    parts = {
        "sasktran2 flat, normal": lambda: recover(noisy_skies(truths), FREE, FLAT["normal"]),
        "sasktran2 flat, draft": lambda: recover(noisy_skies(truths), FREE, FLAT["draft"]),
        "sasktran2 flat, two lobes, default parameters": lambda: recover(
            noisy_skies(two_lobes), LOBES_FREE, FLAT["normal"]
        ),
        "shared oracle flat, normal": lambda: recover(noisy_oracle(oracle), FREE, FLAT["normal"]),
        "sasktran2 spherical, default solver": lambda: recover(
            noisy_skies(truths[: arguments.spherical], geometry="spherical", layers=80),
            FREE,
            skyfit.OrdersOfScattering.normal(),
        ),
        "model error, flat, normal": lambda: model_error(truths, FLAT["normal"]),
        "model error, flat, draft": lambda: model_error(truths, FLAT["draft"]),
    }
    for name, make in parts.items():
        if arguments.only and name not in arguments.only.split(";"):
            continue
        if name.startswith("shared") and not oracle.exists():
            print(f"{oracle} is absent: that part keeps its last figures")
            continue
        record[name] = make()
        show(name, record[name])
        record["made_with"] = made_with(SEED, ("optimistix", "sasktran2")) | {"noise": NOISE}
        arguments.out.parent.mkdir(exist_ok=True)
        arguments.out.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
