"""Size distributions in bins, from almucantars that an independent solver and Mie code have made.

    python -m experiments.validation.size_bins [--cases 12]

The cases of experiments/validation/almucantars.py with an optical depth of 0.2 or more at 440 nm, by turns of two
lognormal modes and of straight lines between points that are a tenth off them, on 320 radii: none is a sum of the fit's
bells. Scalar light, made and fitted, which is a fifth of the work; noise of 1 % (2 % stated), filters 0.5 % off (5 %
stated), pointing 0.1 degrees off, the beam's optical depth 0.005 off (0.01 stated). All bins, the index n and k with
their slopes in wavelength and the ground are free. Writes experiments/results/size_bins.json.
"""

import argparse
import json
import time
from dataclasses import replace

import jax
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from experiments.validation.almucantars import BEAM, case_of, HAZY, made, NM, RADII, SEED, STATED_BEAM
from skyfit.atmosphere import BIN_RADII
from skyfit.retrieve import BINS_FREE


RESULT = HERE / "results" / "size_bins.json"
FREE = tuple(name for name in BINS_FREE if not name.startswith("pointing_"))
# um, between which the bins count
COUNTED = (0.1, 5.0)
# um, between which AERONET parts fine from coarse
PARTING = (0.439, 0.992)
SPECTRA = "single_scattering_albedo", "asymmetry", "refractive_index", "absorption_index"


def column(number: int, depth_440: float) -> np.ndarray:
    """dV/dln r of the column at `RADII`, um^3/um^2, of the optical depth at 440 nm, by sasktran2's Mie code."""
    import sasktran2 as sk

    case, volume, _ = case_of(number)
    index = case["index"] - 1j * case["absorption"]
    mie = sk.mie.LinearizedMie().calculate(2e3 * np.pi * RADII / NM[0], index, np.array([1.0, -1.0]), False)
    # of a sphere, cross-section over volume
    extinction = 0.75 * mie.values.Qext / RADII
    return volume * depth_440 / np.trapezoid(extinction * volume, np.log(RADII))


def effective_radii(volume: np.ndarray) -> tuple[float, float]:
    """Of what is fine and what is coarse, parted where there is least between `PARTING`."""
    between = (RADII > PARTING[0]) & (RADII < PARTING[1])
    fine = RADII[between][np.argmin(volume[between])] > RADII
    small, large = (float(volume[part].sum() / (volume / RADII)[part].sum()) for part in (fine, ~fine))
    return small, large


def case_row(number: int) -> dict | None:
    """A case, true and found; None where the haze is too thin to count."""
    sky, truth = made(number, polarised=False)
    if truth["beam"][0] < HAZY:
        return None
    random = np.random.default_rng([SEED, number, 1])
    depth = np.array(truth["beam"]) + BEAM * random.standard_normal(NM.size)
    stated = np.full((1, NM.size), STATED_BEAM)
    sky = replace(sky, aerosol_optical_depth=depth[None], aerosol_optical_depth_sigma=stated)
    began = time.perf_counter()
    # what is left of the model's error where both are scalar
    measurement = skyfit.NoiseModel(model_error=0.003)
    fit = skyfit.invert(sky, FREE, skyfit.OrdersOfScattering.normal(), measurement=measurement)
    seconds = time.perf_counter() - began
    found = skyfit.aerosol_products(fit, NM[:3])
    volume = column(number, truth["beam"][0])
    fine, coarse = effective_radii(volume)
    true = {
        "volume_size_distribution": np.interp(np.log(BIN_RADII), np.log(RADII), volume).tolist(),
        "fine_effective_radius": fine, "coarse_effective_radius": coarse,
        "refractive_index": truth["case"]["index"], "absorption_index": truth["case"]["absorption"],
        **{name: [truth["optics"][f"{name}_{nm:.0f}"] for nm in NM[:3]] for name in SPECTRA[:2]},
    }  # fmt: skip
    return {
        "number": number, "case": truth["case"], "binned": truth["binned"], "result": fit.result[0],
        "steps": int(fit.steps[0]), "seconds": seconds, "chi_square": float(fit.reduced_chi_square[0]),
        "freedom": float(fit.degrees_of_freedom[0]), "true": true,
        "found": {name: found[name].values[0].tolist() for name in true},
        "sigma": {name: found[f"{name}_sigma"].values[0].tolist() for name in true},
    }  # fmt: skip


def parts(rows: list[dict], name: str, key: str) -> np.ndarray:
    """A quantity of all cases, `[case, place]`."""
    return np.array([np.ravel(row[key][name]) for row in rows])


def summary(rows: list[dict]) -> dict:
    successful, quantities = sum(row["result"] == "successful" for row in rows), {}
    counted = (BIN_RADII >= COUNTED[0]) & (BIN_RADII <= COUNTED[1])
    for name in rows[0]["true"]:
        true, found, sigma = (parts(rows, name, key) for key in ("true", "found", "sigma"))
        true, some = np.broadcast_to(true, found.shape), counted if found.shape[1] == BIN_RADII.size else slice(None)
        off = (found - true)[:, some]
        relative = off / true[:, some]
        quantities[name] = {
            "within_2_sigma": float(np.mean(np.abs(off) <= 2.0 * sigma[:, some])),
            "median_sigma_relative": float(np.median(sigma[:, some] / found[:, some])),
            "rms": float(np.sqrt(np.mean(off**2))),
            "median_off_relative": float(np.median(np.abs(relative))),
            "within_10_percent": float(np.mean(np.abs(relative) <= 0.1)),
            "numbers": int(off.size),
        }
    return {"cases": len(rows), "counted_um": COUNTED, "successful": successful, "quantities": quantities}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--cases", type=int, default=12)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    about, rows = made_with(SEED, ("sasktran2",)), []
    for number in range(arguments.cases):
        row = case_row(number)
        if row is None:
            print(number, "too thin", flush=True)
            continue
        rows.append(row)
        told = {name: v["within_2_sigma"] for name, v in summary([row])["quantities"].items()}
        print(number, row["result"], row["steps"], f"{row['seconds']:.0f} s", told, flush=True)
        # what is done stays
        RESULT.write_text(json.dumps({"summary": summary(rows), "cases": rows, "made_with": about}, indent=1) + "\n")
    print(json.dumps(summary(rows), indent=1))


if __name__ == "__main__":
    main()
