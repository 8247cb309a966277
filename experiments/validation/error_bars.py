"""Whether error bars hold: on halves of measured skies, on held-out directions, and on simulated skies.

    python -m experiments.validation.error_bars [--shared ../shared] [--only halves,simulated] [--seeds 10]

`halves`: each of the eight scans of Kider et al. 2014 fitted twice, by two disjoint halves of its directions; the
difference of each parameter, and of what follows of the haze, over the two sigmas together; how often a held-out sample
lies within one and two of its predicted sigma; the misfit of held-out directions. By particles, and by two lobes, with
polarisation, as `invert` does where nobody asks for other.
`simulated`: coverage of the truth over 600 skies of a known haze with white noise, and with pointing and levels that
all wavelengths of a direction share. Writes experiments/results/error_bars.json.
"""

import argparse
import json
import pathlib
import sys
import time
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from experiments.studies.measured_sky import from_sun, random_half, rms, SETTLED
from skyfit.numerics.chain import Begin
from skyfit.retrieve import LOBES_FREE, PARAMETERS, PARTICLE_FREE
from skyfit.retrieve.components import errors_of
from skyfit.retrieve.parameters import partition, start_model, with_values
from skyfit.retrieve.prepared import first_points, prepared
from skyfit.retrieve.residuals import linearised, nothing_known
from skyfit.retrieve.retrieve import retrieve


RESULT = HERE / "results" / "error_bars.json"
SOLVER = skyfit.OrdersOfScattering.normal(polarised=True)
SETS = {"particles": PARTICLE_FREE, "two lobes": LOBES_FREE}
# seeds of the set that is not the first
FEWER = 1
# columns of `Errors.common`
KIND_OF = np.array([0, 1, 1, 2, 2], np.uint8)
# degrees from the sun
NEAR, FAR = 10.0, 20.0
NEIGHBOURS = ("single_scattering_albedo_440", "asymmetry_440", "fine_effective_radius")

# simulated skies: those of a haze of two lobes, by single scattering over a sphere
SKIES, VIEWS = 600, 48
NM = np.array([400.0, 440.0, 500.0, 550.0, 610.0, 675.0, 780.0, 870.0])
MADE_BY = skyfit.SingleScattering(16, "spherical")
FREE = (
    "aerosol_optical_depth", "angstrom_exponent", "asymmetry", "asymmetry_second", "forward_fraction",
    "pointing_zenith", "pointing_azimuth",
)  # fmt: skip
TRUTH = (0.2, 1.2, 0.75, 0.1, 0.8, 0.3, -0.5)
NOISE, LEVEL, POINTING = 0.01, 0.02, np.radians(0.2)


def halves(path: pathlib.Path, seeds: int) -> dict:
    sky = skyfit.read(path)
    record = {}
    for name, free in SETS.items():
        rows = [row for seed in range(seeds if name == "particles" else FEWER) for row in by_halves(sky, free, seed)]
        record[name] = summary(rows, free, len(sky.time))
        record[name]["neighbours"] = neighbours(sky, free) if name == "particles" else None
        told = {k: record[name][k] for k in ("held_out_rmse", "held_out_within", "steps", "neighbours")}
        print(name, json.dumps(told, indent=1), flush=True)
        for parameter, row in record[name]["parameters"].items():
            print(f"  {parameter:32s}", {k: round(v, 4) for k, v in row.items()}, flush=True)
    return record


def by_halves(sky: skyfit.Sky, free: tuple[str, ...], seed: int) -> list[dict]:
    """What the fits of two halves say of each time."""
    half, began = random_half(sky, seed), time.perf_counter()
    fits = [skyfit.invert(replace(sky, usable=sky.usable & h[None, :, None]), free, SOLVER) for h in (half, ~half)]
    optics = [skyfit.aerosol_optics(fit) for fit in fits]
    whole = prepared(sky, free, SOLVER)
    angle = from_sun(sky)
    rows = []
    for t in range(len(sky.time)):
        row = {"time": t, "steps": [int(fit.steps[t]) for fit in fits], "result": [fit.result[t] for fit in fits]}
        row["values"] = {
            n: [(float(fit.values[t, i]), float(fit.sigma[t, i])) for fit in fits] for i, n in enumerate(free)
        } | {n: [(float(o[n].value[t]), float(o[n].sigma[t])) for o in optics] for n in optics[0]}
        row["determined"] = {n: bool(all(fit.determined[t, i] for fit in fits)) for i, n in enumerate(free)}
        row["held_out"] = []
        for fit, mine in zip(fits, (half, ~half), strict=True):
            off, sigma = predicted(whole, fit, t)
            held = np.isfinite(sigma) & ~mine[:, None]
            row["held_out"].append(
                {
                    part: {
                        "rmse_mw": 1e3 * rms(off[where]),
                        "within": [float(np.mean(np.abs(off[where]) < k * sigma[where])) for k in (1.0, 2.0)],
                    }
                    for part, where in (
                        ("all", held),
                        ("within_10", held & (angle[t] <= NEAR)[:, None]),
                        ("beyond_10", held & (angle[t] > NEAR)[:, None]),
                        ("beyond_20", held & (angle[t] > FAR)[:, None]),
                    )
                }
            )
        rows.append(row)
    print(seed, f"{time.perf_counter() - began:.0f} s", [row["steps"] for row in rows], flush=True)
    return rows


@eqx.filter_jit
def _slopes(solver, names, fixed, scaled, one):
    no = jnp.zeros((), bool)
    begin = Begin(nothing_known(one, len(names)), no, no)
    known = linearised(names, solver, None, fixed, scaled, one, begin, no)
    errors = errors_of(one, known.radiance, known.turn)
    return known.radiance, known.jacobian[: known.radiance.size], errors.common, jnp.sum(errors.broad**2, axis=-1)


def predicted(whole, fit: skyfit.Fit, t: int) -> tuple[np.ndarray, np.ndarray]:
    """Model minus data of every direction, and its sigma by that of the parameters and the noise; NaN where unusable.

    What a sample has of its own counts as stated times `scale`; the wavelengths' scales by their sigma.
    """
    free = fit.free
    one = whole.problem.at(t)
    scaled = jnp.asarray([PARAMETERS[n].to_scale(v) for n, v in zip(free, fit.values[t], strict=True)])
    radiance, jacobian, common, broad = (
        np.asarray(v) for v in _slopes(SOLVER, free, partition(fit.start, free)[1], scaled, one)
    )
    # sigma in the stated unit, slopes by the parameter's scale
    unit = np.array([v if PARAMETERS[n].log else 1.0 for n, v in zip(free, fit.values[t], strict=True)])
    covariance = fit.covariance[t] / unit[:, None] / unit[None]
    variance = np.einsum("sp,pq,sq->s", jacobian, covariance, jacobian).reshape(radiance.shape)
    variance += np.sum((common * fit.common[t][KIND_OF]) ** 2, axis=-1) + broad @ fit.common[t][3:] ** 2
    weight = np.asarray(one.weight)
    held = weight > 0.0
    variance += (fit.scale[t] / np.where(held, weight, 1.0)) ** 2 + (radiance * fit.calibration_sigma[t][None]) ** 2
    off = radiance * fit.calibration[t][None] - np.asarray(one.measured)
    place = whole.places[t]
    every = np.full((2, fit.sky.radiance.shape[1], radiance.shape[1]), np.nan)
    some = held.any(axis=1)
    every[:, place[some]] = np.where(held, np.stack([off, np.sqrt(variance)]), np.nan)[:, some]
    return every[0], every[1]


def summary(rows: list[dict], free: tuple[str, ...], times: int) -> dict:
    """Each parameter's differences over sigma, and the held-out directions."""
    record = {"parameters": {}, "fits": 2 * len(rows)}
    for name in rows[0]["values"]:
        pairs = np.array([row["values"][name] for row in rows])
        known = np.isfinite(pairs).all(axis=(1, 2))
        if name in free:
            known &= np.array([row["determined"][name] for row in rows])
        if not known.any():
            continue
        z = (pairs[known, 0, 0] - pairs[known, 1, 0]) / np.hypot(pairs[known, 0, 1], pairs[known, 1, 1])
        settled = known & np.array([row["time"] < SETTLED for row in rows])
        record["parameters"][name] = {
            "rms": rms(z),
            "within_2": float(np.mean(np.abs(z) < 2.0)),
            "rms_settled": rms(z[np.array([row["time"] < SETTLED for row in rows])[known]]),
            "median_sigma_settled": float(np.median(pairs[settled, :, 1])),
            "share_determined": float(known.mean()),
        }
    held = [part for row in rows for part in row["held_out"]]
    settled = [part for row in rows if row["time"] < SETTLED for part in row["held_out"]]

    def rmse(parts, where):
        # a half may have no direction so near the sun
        return float(np.sqrt(np.nanmean([part[where]["rmse_mw"] ** 2 for part in parts])))

    record["held_out_rmse"] = {
        f"{which}, {where}": rmse(parts, where)
        for which, parts in (("settled", settled), ("all scans", held))
        for where in ("all", "within_10", "beyond_10", "beyond_20")
    }
    record["held_out_within"] = {
        where: np.nanmean([part[where]["within"] for part in held], axis=0).tolist()
        for where in ("all", "within_10", "beyond_10", "beyond_20")
    }
    steps = np.array([row["steps"] for row in rows])
    record["steps"] = {"median": float(np.median(steps)), "most": int(steps.max())}
    record["results"] = sorted({name for row in rows for name in row["result"]})
    return record


def neighbours(sky: skyfit.Sky, free: tuple[str, ...]) -> dict:
    """How the scans of one morning agree, each fitted by itself: differences over sigma from one to the next."""
    fit = skyfit.invert(sky.at_times(range(SETTLED)), free, SOLVER)
    optics = skyfit.aerosol_optics(fit)
    record = {}
    for name in NEIGHBOURS:
        z = np.diff(optics[name].value) / np.hypot(optics[name].sigma[1:], optics[name].sigma[:-1])
        record[name] = {"within_2": float(np.mean(np.abs(z) < 2.0)), "z": z.tolist()}
    record["aerosol_optical_depth"] = list(zip(fit.values[:, 0].tolist(), fit.sigma[:, 0].tolist(), strict=True))
    record["rmse_mw"] = (1e3 * fit.rmse).tolist()
    record["common"] = fit.common.tolist()
    record["residual_correlation"] = fit.residual_correlation.tolist()
    return record


def simulated() -> dict:
    """How often the truth lies within one and two sigma."""
    view = skyfit.hemisphere(VIEWS, np.radians(80.0))
    scene = skyfit.Scene.from_degrees(50.0, view, NM)
    model = with_values(start_model(FREE, 101325.0), FREE, TRUTH)
    random = np.random.default_rng(12)

    def light(zenith, azimuth):
        moved = eqx.tree_at(lambda s: s.view, scene, skyfit.Directions(zenith, azimuth))
        return MADE_BY.radiance(model.atmosphere, model.instrument.sees(moved))

    clean = np.asarray(jax.jit(light)(view.zenith, view.azimuth))
    size = (SKIES, VIEWS)
    white = clean * (1.0 + NOISE * random.standard_normal((SKIES, *clean.shape)))
    away = POINTING * random.standard_normal((2, *size))
    zenith = jnp.asarray(np.asarray(view.zenith) + away[0])
    azimuth = jnp.asarray(np.asarray(view.azimuth) + away[1] / np.sin(np.asarray(view.zenith)))
    moved = np.asarray(jax.lax.map(lambda item: light(*item), (zenith, azimuth)))
    moved = moved * np.exp(LEVEL * random.standard_normal((*size, 1)))
    moved = moved * (1.0 + NOISE * random.standard_normal(moved.shape))
    noise = skyfit.NoiseModel(model_error=0.0)
    record = {"truth": dict(zip(FREE, TRUTH, strict=True)), "skies": SKIES}
    for name, skies in (("white", white), ("pointing and level", moved)):
        asked = prepared(
            skyfit.Sky(
                radiance=clean[None], sigma=NOISE * clean[None], usable=np.ones((1, *clean.shape), bool),
                view_zenith=np.asarray(view.zenith, float), view_azimuth=np.asarray(view.azimuth, float),
                wavelength_nm=NM, sun_zenith=np.radians([50.0]), sun_azimuth=np.zeros(1), sun_distance_au=1.0,
                time=np.full(1, np.datetime64("NaT")), pressure_pa=101325.0, fwhm_nm=float("nan"),
            ),
            FREE, MADE_BY, measurement=noise,
        )  # fmt: skip
        start, problem = first_points(asked, np.array([0])), asked.problem

        @jax.jit
        def fitted(skies, asked=asked, start=start, problem=problem):
            def one(sky):
                mine = eqx.tree_at(lambda p: p.measured, problem, sky[None])
                found = retrieve(mine, asked.start, asked.names, priors=asked.rows, start=start, **asked.options())
                return found.values[0], jnp.diagonal(found.noise[0]), found.common[0], found.finite

            return jax.lax.map(one, skies)

        values, variance, common, finite = (np.asarray(v) for v in fitted(jnp.asarray(skies)))
        z = (values - np.array([TRUTH[FREE.index(n)] for n in asked.names])) / np.sqrt(variance)
        record[name] = {
            "finite": int(finite.sum()),
            "common_median": np.median(common, axis=0).tolist(),
            "within_1_2": {
                n: [float(np.mean(np.abs(z[:, i]) < k)) for k in (1.0, 1.96)] for i, n in enumerate(asked.names)
            },
        }
        print(name, json.dumps(record[name], indent=1), flush=True)
    return record


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--shared", type=pathlib.Path, default=HERE.parent.parent / "shared")
    parser.add_argument("--only", default="halves,simulated", help="the parts to make anew, with commas")
    parser.add_argument("--seeds", type=int, default=10, help="halves of the particles' fits")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    record = json.loads(RESULT.read_text()) if RESULT.exists() else {}
    parts = arguments.only.split(",")
    if "simulated" in parts:
        record["simulated"] = simulated() | {"made_with": made_with(0)}
        write(record)
    if "halves" in parts:
        path = arguments.shared / "measured" / "kider2014" / "2013-05-27.nc"
        if not path.exists():
            sys.exit(f"{path} is absent: nothing to invert")
        record["halves"] = halves(path, arguments.seeds) | {"made_with": made_with(0)}
        write(record)


def write(record: dict) -> None:
    """The file, null where there is no number."""

    def strict(value):
        if isinstance(value, dict):
            return {key: strict(entry) for key, entry in value.items()}
        if isinstance(value, list | tuple):
            return [strict(entry) for entry in value]
        return None if isinstance(value, float) and not np.isfinite(value) else value

    RESULT.write_text(json.dumps(strict(record), indent=2) + "\n")


if __name__ == "__main__":
    main()
