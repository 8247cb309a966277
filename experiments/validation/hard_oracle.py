"""Harder plane-parallel cases than those of the shared oracles, by nanodisort, for `oracle_check.py`.

    python -m experiments.validation.hard_oracle OUT.npz [--check ../shared/oracles/oracle_pp_aerosol.npz] [--converge]

Delta-M and Nakajima & Tanaka's intensity correction; levels at equal steps of the two constituents' mean column
share, so that they are dense in haze. Conventions of the shared oracles: exponential profiles of 8 and 1.2 km cut
at 100 km and renormalised, Rayleigh phase without depolarisation, Henyey-Greenstein, Lambertian ground, observer on
it, unit irradiance. 64 streams leave 1e-4 in the aureole of g = 0.88 and 3e-5 of g = 0.87; all else 2e-5 (layers).
"""

import argparse
import pathlib
import time

import numpy as np

from experiments.benchmarks.rivals import layer_shares, Optics, prepare_nanodisort, View


FIELDS = ("tau_rayleigh", "aod", "ssa_aerosol", "g", "albedo")
LOW = np.array([0.02, 0.0, 0.75, 0.5, 0.0])
HIGH = np.array([0.7, 1.5, 1.0, 0.88, 0.9])
SZA = np.array([0.0, 20.0, 45.0, 65.0, 80.0, 85.0])
VZA = np.array([0.0, 10.0, 30.0, 50.0, 70.0, 80.0, 85.0])
RAZ = np.array([0.0, 20.0, 45.0, 90.0, 135.0, 180.0])
# hard in other ways each: bright aureole and ground; dark haze; bright ground under air; deep isotropic-like haze
CORNERS = np.array(
    [[0.1, 1.5, 1.0, 0.88, 0.9], [0.7, 1.5, 0.75, 0.88, 0.0], [0.7, 0.0, 1.0, 0.7, 0.9], [0.02, 1.5, 1.0, 0.5, 0.0]]
)


def random_cases(count: int, seed: int) -> np.ndarray:
    """The corners and seeded cases, `[case, field]`."""
    drawn = np.random.default_rng(seed).uniform(LOW, HIGH, (count, 5))
    return np.round(np.concatenate([CORNERS, drawn])[:count], 4)


def radiance(cases, sun: float, vza, raz, streams: int, layers: int) -> np.ndarray:
    """Sky radiance `[case, vza, raz]` under one sun, sr^-1."""
    air, haze, albedo, asymmetry, ground = np.transpose(cases)
    optics, found = Optics(air, haze, albedo, asymmetry, 0.1, ground), np.full((len(cases), len(vza), len(raz)), np.nan)
    # at some depths the eigenvalues come out as NaN, silently: other layers, other depths
    for more in (0, 1, 3, 7):
        bad = ~np.all(np.isfinite(found), axis=(1, 2))
        if not np.any(bad):
            return found
        few = Optics(*(v[bad] if np.ndim(v) else v for v in optics))
        solved = prepare_nanodisort(few, View(vza, raz, sun), streams, layers + more)()
        found[bad] = np.moveaxis(solved.reshape(len(vza), len(raz), -1), -1, 0)
    raise ArithmeticError(f"no finite radiance for {cases[bad]}, sun {sun}")


def table(cases, streams: int, layers: int) -> np.ndarray:
    """Radiance `[case, sza, vza, raz]`."""
    return np.stack([radiance(cases, sun, VZA, RAZ, streams, layers) for sun in SZA], axis=1)


def single_scatter(case, sza: float, vza, raz) -> np.ndarray:
    """Single scattering `[vza, raz]` over a black ground, continuous in height: midpoint rule in 20000 thin layers."""
    air, haze, albedo, asymmetry, _ = case
    share = layer_shares(20_000)
    depth = np.array([air, haze]) @ share
    above = np.cumsum(depth) - 0.5 * depth
    view, sun = np.cos(np.radians(vza)), np.cos(np.radians(sza))
    path = np.exp(-(depth.sum() - above)[None] / view[:, None] - above[None] / sun) / view[:, None]
    integral = path @ (share * np.array([[air], [haze * albedo]])).T
    across = np.sin(np.radians(vza))[:, None] * np.sin(np.radians(sza)) * np.cos(np.radians(raz))[None]
    cosine = view[:, None] * sun + across
    rayleigh = 3.0 / (16.0 * np.pi) * (1.0 + cosine**2)
    lobe = (1.0 - asymmetry**2) / (4.0 * np.pi * (1.0 + asymmetry**2 - 2.0 * asymmetry * cosine) ** 1.5)
    return rayleigh * integral[:, :1] + lobe * integral[:, 1:]


def difference(first, second) -> str:
    error = np.abs(first / second - 1.0)
    return f"max {error.max():.1e}, 99th percentile {np.quantile(error, 0.99):.1e}, median {np.median(error):.1e}"


def check(path: pathlib.Path, layers: int) -> str:
    """Points of a shared oracle with parameter axes made anew with its 32 streams, view zenith to 85."""
    data = np.load(path)
    few = data["vza"] <= 85.0
    first, second = [], []
    for i, j, k, m, n in ((0, 0, 0, 0, 0), (1, 1, 0, 2, 2), (1, 1, 2, 1, 4), (0, 1, 1, 2, 3), (1, 0, 2, 2, 1)):
        values = (data[name][at] for name, at in zip(FIELDS[:3], (i, j, k), strict=True))
        case = (*values, float(data["g"]), data["albedo"][m])
        first.append(radiance([case], data["sza"][n], data["vza"][few], data["raz"], 32, layers)[0])
        second.append(data["radiance"][i, j, k, m, n][few])
    return difference(np.array(first), np.array(second))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--cases", type=int, default=24)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--streams", type=int, default=64)
    parser.add_argument("--layers", type=int, default=150)
    parser.add_argument("--check", type=pathlib.Path, help="a file of the shared oracles to agree with, parameter axes")
    parser.add_argument("--converge", action="store_true", help="other streams and layers, the first four cases")
    arguments = parser.parse_args()
    cases = random_cases(arguments.cases, arguments.seed)
    streams, layers = arguments.streams, arguments.layers
    if arguments.check:
        print(f"32 streams against {arguments.check.name}: {check(arguments.check, layers)}", flush=True)
    start = time.perf_counter()
    found = table(cases, streams, layers)
    print(f"{len(cases)} cases, {streams} streams, {layers} layers: {time.perf_counter() - start:.0f} s", flush=True)
    once = np.array([[single_scatter(case, sun, VZA, RAZ) for sun in SZA] for case in cases])
    np.savez_compressed(
        arguments.out, cases=cases, case_fields=FIELDS, sza=SZA, vza=VZA, raz=RAZ, radiance=found,
        sigma=np.zeros_like(found), single_scatter=once,
    )  # fmt: skip
    if arguments.converge:
        for other in ((streams // 2, layers), (3 * streams // 4, layers), (streams, 2 * layers)):
            error = difference(table(cases[:4], *other), found[:4])
            print(f"{other[0]} streams, {other[1]} layers, the first four cases: {error}", flush=True)


if __name__ == "__main__":
    main()
