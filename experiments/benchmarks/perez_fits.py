"""Five Perez parameters of 10,000 simulated skies: `fit_perez` in float32 and float64 beside scipy's MINPACK.

    python -m experiments.benchmarks.perez_fits [--skies 10000] [--blocks 5] [--out FILE.json]

Everyone has two cores. Scipy: `least_squares(method="lm")` with the analytic Jacobian, its default tolerances, the same
unknowns and the same start, in two processes with one BLAS thread each; two more lines have the loose tolerance of
`fit_perez`, and plain A-E. Here: one process for each dtype, two threads that call `fit_perez` on half of the skies
each; one more line is one call with all of them; and for the record what `vmap` and `lax.map` make of the same steps,
one sky each. In each block scipy fits its share of the skies and `fit_perez` all of them, in turn; us per fit are
medians over the blocks, compilation is apart. Costs are scipy's own, and ours computed again in float64 from A-E as
they came back. A "failure" is a cost more than 0.1 % above that of scipy in the same unknowns.
"""

import argparse
import itertools
import json
import multiprocessing
import os
import pathlib
import statistics
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, wait

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from skyfit.analytic import fit_perez
from skyfit.light import xyz
from skyfit.numerics import as_float
from skyfit.scene import angle_between, hemisphere


SEED, WAVELENGTH_NM = 1, np.arange(380.0, 781.0, 40.0)
# turbidity, sun zenith in degrees, asymmetry, single-scattering albedo, Angstrom exponent, ground albedo
LOWEST, HIGHEST = (1.0, 0.0, 0.6, 0.85, 0.5, 0.0), (10.0, 85.0, 0.8, 1.0, 2.0, 0.4)
START = (-1.0, -0.4, 8.0, -2.3, 0.4)
# to this view zenith in degrees, in units of 5 %
HIGHEST_VIEW, UNIT = 85.0, 0.05
SLACK = 1e-3
THREADS, CHUNK, MAPPED = 2, 100, 1000
# name: whether in plain A-E, and the tolerance where it is not scipy's own
SCIPY = {"scipy": (False, None), "scipy, tolerance 3e-5": (False, 3e-5), "scipy, plain A-E": (True, None)}
# what a worker process works on
GIVEN: dict = {}


# --- the skies


@eqx.filter_jit
def luminance(cases, view):
    """Of each case, `[sky, direction]`."""
    solver, wavelength = skyfit.OrdersOfScattering.draft(), np.asarray(WAVELENGTH_NM)

    def sky(case):
        turbidity, sun, asymmetry, albedo, exponent, ground = case
        phase = skyfit.HenyeyGreenstein(asymmetry)
        air = skyfit.Atmosphere.from_turbidity(
            turbidity, phase=phase, single_scattering_albedo=albedo, angstrom_exponent=exponent
        )
        air = eqx.tree_at(lambda a: a.ground.albedo, air, ground)
        scene = skyfit.Scene.from_degrees(0.0, view, wavelength)
        scene = eqx.tree_at(lambda s: s.sun_zenith, scene, jnp.radians(sun))
        return xyz(solver.radiance(air, scene), wavelength)[:, 1]

    return jax.lax.map(sky, cases)


def simulate(count: int) -> dict:
    """Cases and what a fit is given, in float64."""
    cases = np.random.default_rng(SEED).uniform(LOWEST, HIGHEST, (count, len(LOWEST)))
    dome = hemisphere(342)
    view = skyfit.Directions(np.append(dome.zenith, 0.0), np.append(dome.azimuth, 0.0))
    with ThreadPoolExecutor(THREADS) as threads:
        parts = threads.map(lambda part: np.asarray(luminance(as_float(part), view), float), np.split(cases, THREADS))
        light = np.concatenate(list(parts))
    zenith, azimuth, sun = np.asarray(view.zenith, float), np.asarray(view.azimuth, float), np.radians(cases[:, 1])
    with jax.enable_x64(True):
        gamma = angle_between(zenith[None], sun[:, None], azimuth[None])
    weight = np.where(zenith <= np.radians(HIGHEST_VIEW), 1.0 / UNIT, 0.0)
    return {
        "cases": cases, "light": light, "theta": zenith, "gamma": np.asarray(gamma), "sun": sun, "weight": weight,
    }  # fmt: skip


# --- scipy


def unknowns(coefficients, sun):
    """As in the docstring of `fit_perez`."""
    a, b, c, d, e = coefficients
    at_zenith = 1.0 + c * np.exp(d * sun) + e * np.cos(sun) ** 2
    return np.array([np.log1p(a * np.exp(b)), np.log(-b), c / at_zenith, np.log(-d), e / at_zenith])


def in_unknowns(share, weight, slant, gamma, square, sun):
    """Residual and Jacobian as a function of the unknowns."""

    def both(u):
        b, d, rise = -np.exp(u[1]), -np.exp(u[3]), 1.0 - np.exp(-u[0])
        steep, here, there = np.exp(np.maximum(b * slant, -80.0)), np.exp(d * gamma), np.exp(d * sun)
        first, second = share * (1.0 + rise * (steep - 1.0)), 1.0 + u[2] * (here - there) + u[4] * square
        scaled = share * second
        jacobian = np.stack(
            [
                scaled * (steep - 1.0) * (1.0 - rise), scaled * rise * steep * slant * b, first * (here - there),
                first * u[2] * d * (here * gamma - there * sun), first * square,
            ],
            axis=1,
        )  # fmt: skip
        return first * second - weight, jacobian

    return both


def in_plain(share, weight, slant, gamma, square, sun):
    """Residual and Jacobian as a function of A-E."""
    secant, squared, at_sun = slant + 1.0, square + np.cos(sun) ** 2, np.cos(sun) ** 2

    def form(p, secant, gamma, squared):
        a, b, c, d, e = p
        steep, here = np.exp(b * secant), np.exp(d * gamma)
        first, second = 1.0 + a * steep, 1.0 + c * here + e * squared
        slopes = second * steep, second * a * steep * secant, first * here, first * c * here * gamma, first * squared
        return first * second, np.stack(slopes, axis=-1)

    def both(p):
        (value, slope), (zenith, zenith_slope) = form(p, secant, gamma, squared), form(p, 1.0, sun, at_sun)
        scaled = share / zenith
        ratio = value / zenith
        return scaled * value - weight, scaled[:, None] * (slope - ratio[:, None] * zenith_slope[None])

    return both


def scipy_fits(skies: range, plain: bool, tolerance: float | None) -> list:
    """Sum of squared residuals, evaluations and MINPACK's status of each sky."""
    found, last = [], {}
    tolerances = {} if tolerance is None else {"ftol": tolerance, "xtol": tolerance}
    slant = 1.0 / np.maximum(np.cos(GIVEN["theta"]), 0.01) - 1.0
    for i in skies:
        light, gamma, sun = GIVEN["light"][i], GIVEN["gamma"][i], GIVEN["sun"][i]
        square = np.cos(gamma) ** 2 - np.cos(sun) ** 2
        model = (in_plain if plain else in_unknowns)(
            GIVEN["weight"] * light[-1] / light, GIVEN["weight"], slant, gamma, square, sun
        )

        def residual(u, model=model):
            # the Jacobian is asked for where the residual has just been: what they share is computed once
            last["at"], last["both"] = u.copy(), model(u)
            return last["both"][0]

        def jacobian(u, model=model):
            return last["both"][1] if np.array_equal(u, last["at"]) else model(u)[1]

        start = np.array(START) if plain else unknowns(START, sun)
        with np.errstate(all="ignore"):
            result = least_squares(residual, start, jacobian, method="lm", **tolerances)
        found.append((2.0 * result.cost, result.nfev, result.status))
    return found


# --- a worker process


def begin(path: str, double: bool) -> None:
    jax.config.update("jax_enable_x64", double)
    GIVEN.update(np.load(path))


def arguments_of(part: slice) -> tuple:
    """Of a fit of some of the skies, in place as arrays of their own."""
    light, gamma, sun = (as_float(GIVEN[name][part]) for name in ("light", "gamma", "sun"))
    return jax.block_until_ready((light, light[:, -1], as_float(GIVEN["theta"]), gamma, sun, as_float(GIVEN["weight"])))


def our_fits(threads: int) -> tuple[float, list[np.ndarray]]:
    """Seconds, and A-E, cost, evaluations and whether converged, of all skies."""
    if threads not in GIVEN:
        count = len(GIVEN["sun"])
        ends = [k * count // threads for k in range(threads + 1)]
        GIVEN[threads] = [arguments_of(slice(*pair)) for pair in itertools.pairwise(ends)]
    with ThreadPoolExecutor(threads) as pool:
        start = time.perf_counter()
        found = list(pool.map(lambda part: jax.block_until_ready(fit_perez(*part, start=START)), GIVEN[threads]))
        seconds = time.perf_counter() - start
    return seconds, [np.concatenate(arrays) for arrays in zip(*found, strict=True)]


def mapped_fits() -> dict:
    """us per fit of one sky each by `vmap` and `lax.map`, compiled before."""
    light, _, theta, gamma, sun, weight = arguments_of(slice(MAPPED))

    def one(light, gamma, sun):
        return fit_perez(light[None], light[None, -1], theta, gamma[None], sun[None], weight, start=START).cost

    skies = light, gamma, sun
    us = {}
    for name, run in {"vmap": jax.vmap(one), "lax.map": lambda *s: jax.lax.map(lambda v: one(*v), s)}.items():
        program = jax.jit(run).lower(*skies).compile()
        times = []
        for _ in range(3):
            start = time.perf_counter()
            jax.block_until_ready(program(*skies))
            times.append(time.perf_counter() - start)
        us[name] = 1e6 * statistics.median(times) / len(skies[0])
    return us


# --- what came of it


def costs(given: dict, found: np.ndarray) -> np.ndarray:
    """Sums of squared residuals of A-E, in float64."""
    a, b, c, d, e = np.asarray(found, float).T[:, :, None]
    secant, sun = 1.0 / np.maximum(np.cos(given["theta"]), 0.01)[None], given["sun"][:, None]

    def form(secant, gamma):
        return (1.0 + a * np.exp(b * secant)) * (1.0 + c * np.exp(d * gamma) + e * np.cos(gamma) ** 2)

    with np.errstate(all="ignore"):
        ratio = form(secant, given["gamma"]) / form(1.0, sun)
        error = given["weight"][None] * (given["light"][:, -1:] * ratio / given["light"] - 1.0)
    return np.sum(np.square(error), axis=1)


def against(cost, best) -> dict:
    ratio = cost / best
    return {
        "share within 0.1 % or below": float(np.mean(ratio <= 1.0 + SLACK)),
        "share lower by more than 0.1 %": float(np.mean(ratio < 1.0 - SLACK)),
        "failures": int(np.sum(~(ratio <= 1.0 + SLACK))),
    }


def failures(given: dict, cost, best, steps, converged) -> list[dict]:
    bad = np.flatnonzero(~(cost <= best * (1.0 + SLACK)))
    return [
        {
            "turbidity": round(float(given["cases"][i, 0]), 2),
            "sun zenith": round(float(given["cases"][i, 1]), 1),
            "cost over scipy's": round(float(cost[i] / best[i]), 4),
            "evaluations": int(steps[i]),
            "converged": bool(converged[i]),
        }
        for i in bad[:20]
    ]


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--skies", type=int, default=10_000, help="a multiple of the blocks and of 2")
    arguments.add_argument("--blocks", type=int, default=5)
    arguments.add_argument("--out", type=pathlib.Path, default=HERE / "results" / "perez_fits.json")
    options = arguments.parse_args()
    count, blocks = options.skies, options.blocks
    if count % (THREADS * blocks):
        arguments.error(f"`--skies` must be a multiple of {THREADS * blocks}, got {count}")

    begun = time.perf_counter()
    given = simulate(count)
    print(f"{count} skies simulated in {time.perf_counter() - begun:.0f} s")
    # the children inherit them before they import numpy
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
    spawn = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as folder:
        path = str(pathlib.Path(folder) / "skies.npz")
        np.savez(path, **given)
        ours = {d: ProcessPoolExecutor(1, spawn, begin, (path, d == "float64")) for d in ("float32", "float64")}
        rival = ProcessPoolExecutor(THREADS, spawn, begin, (path, True))

        def scipy_block(block: int, settings):
            """Seconds and the fits of one block of the skies, in chunks that both processes draw from."""
            skies = range(count)[block * count // blocks : (block + 1) * count // blocks]
            chunks = [skies[k : k + CHUNK] for k in range(0, len(skies), CHUNK)]
            start = time.perf_counter()
            futures = [rival.submit(scipy_fits, chunk, *settings) for chunk in chunks]
            found = [fit for future in futures for fit in future.result()]
            return time.perf_counter() - start, found

        # processes start, programs compile
        wait([rival.submit(scipy_fits, range(CHUNK), *settings) for settings in SCIPY.values() for _ in range(4)])
        warm = {}
        for dtype, process in ours.items():
            warm[dtype] = {name: process.submit(our_fits, n).result()[0] for name, n in (("two", 2), ("one", 1))}
        times = {name: [] for name in SCIPY}
        found = {name: [] for name in SCIPY}
        for block in range(blocks):
            for name, settings in SCIPY.items():
                seconds, fits = scipy_block(block, settings)
                times[name].append(1e6 * seconds * blocks / count)
                found[name].extend(fits)
            for dtype, process in ours.items():
                for label, threads in ((f"{dtype}, two threads", THREADS), (f"{dtype}, one call", 1)):
                    seconds, found[label] = process.submit(our_fits, threads).result()
                    times.setdefault(label, []).append(1e6 * seconds / count)
        mapped = ours["float32"].submit(mapped_fits).result()
        for process in (*ours.values(), rival):
            process.shutdown()

    rows, best = {}, None
    for name in SCIPY:
        cost, evaluations, status = (np.array(v) for v in zip(*found[name], strict=True))
        best = cost if best is None else best
        rows[name] = against(cost, best) | {
            "evaluations, mean": float(evaluations.mean()),
            "not converged": int(np.sum(status <= 0)),
        }
    assert best is not None
    for dtype in ours:
        x, _, steps, converged = found[f"{dtype}, two threads"]
        cost = costs(given, x)
        row = against(cost, best) | {
            "scipy higher by more than 0.1 %": int(np.sum(cost < best * (1.0 - SLACK))),
            "evaluations, mean": float(steps.mean()),
            "not converged": int(np.sum(~converged)),
            "first call with compilation, seconds": round(warm[dtype]["two"], 2),
            "failures, the first 20": failures(given, cost, best, steps, converged),
        }
        rows[f"{dtype}, two threads"] = row
        rows[f"{dtype}, one call"] = {}
    for name, row in rows.items():
        row["us a fit"] = round(statistics.median(times[name]), 2)
        row["us a fit, blocks"] = [round(t, 2) for t in times[name]]
        ratios = [s / t for s, t in zip(times["scipy"], times[name], strict=True)]
        row["times faster than scipy"] = round(statistics.median(ratios), 2)
        said = {key: value for key, value in row.items() if not isinstance(value, list)}
        print(f"{name:24}", ", ".join(f"{key} {value:g}" for key, value in said.items()))
    print(f"one sky each, float32: {mapped}")
    result = {
        "skies": count,
        "directions": given["theta"].size,
        "blocks": blocks,
        "rows": rows,
        f"one sky each, float32, {MAPPED} skies, us a fit": {name: round(us, 1) for name, us in mapped.items()},
        "processes waiting": round(os.getloadavg()[0], 1),
        "whole run, seconds": round(time.perf_counter() - begun),
        **made_with(SEED, ("scipy",)),
        "dtype": "float32 and float64",
    }
    options.out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
