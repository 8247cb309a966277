"""Writes data/error_model.csv: how far each simplification of a sky is off, by the numbers that decide it.

    python -m experiments.tables.make_error_model --work FOLDER [--scenes 512] [--seed 18] [--measure-only]

Scenes are a Sobol sequence over sun zenith 0-88 degrees, haze of optical depth 0.003-1.5, asymmetry 0.5-0.85,
single-scattering albedo 0.75-1 and scale height 0.5-4 km, ground albedo 0-0.9, ozone, pressure and Angstrom exponent;
each with 16 directions (three within 15 degrees of the sun, two within 4 of the horizon) and 4 wavelengths from 340 to
1000 nm. `PROGRAMS` answer them in float64. FOLDER keeps what was answered: a run that was cut off goes on there.

Truth is `OrdersOfScattering.fine("spherical", polarised=True)`. `EFFECTS` says which two programs differ by what. The
error of an effect is a sum of mechanisms, each a product of powers of `skyfit.transport.error_model.FEATURES`, whose
powers are held to the sign that physics gives them. They are fitted to the largest error of each scene and, less, to
all its errors; factors make them safe for `SAFE` of scenes that a fit in two halves has not seen.
Provenance: skyfit's own solvers; no measured data enter. Licence: that of this project.
"""

import argparse
import time
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

import skyfit
from skyfit.transport import AbstractSolver
from skyfit.transport.choose import RUNGS, streams_of
from skyfit.transport.deciding import Deciding, deciding
from skyfit.transport.error_model import FEATURES, shared_features, TABLE, with_left_out, with_streams


DATA = Path(__file__).resolve().parents[2] / "data"
# low and high ends; those of `LOGARITHMIC` are drawn evenly in the logarithm
RANGES = {
    "sun_zenith_deg": (0.0, 88.0), "optical_depth": (0.003, 1.5), "asymmetry": (0.5, 0.85), "albedo": (0.75, 1.0),
    "ground": (0.0, 0.9), "scale_height": (500.0, 4000.0), "ozone": (150.0, 500.0), "exponent": (0.0, 2.0),
    "pressure": (6e4, 1.04e5),
}  # fmt: skip
LOGARITHMIC = ("optical_depth", "scale_height")
SHORTEST, LONGEST, COLOURS = 340.0, 1000.0, 4
SPECTRUM = np.arange(340.0, 1001.0, 10.0)
CHUNK = 32
# scenes of which whole spectra are solved
FEW = 64


class Scenes(NamedTuple):
    """Parameters in the order of `RANGES`, `[scene, parameter]`; views in radians, the sun in the south, and nm."""

    values: np.ndarray
    zenith: np.ndarray
    azimuth: np.ndarray
    wavelength: np.ndarray


class Program(NamedTuple):
    """A solver, the constituent that it leaves out, and whether it answers a spectrum of the first scenes alone."""

    solver: AbstractSolver
    without: str | None = None
    spectrum: bool = False


def _orders(streams: str, geometry, polarised=True, spectral_nodes: int | None = 0):
    return streams_of(f"{streams} streams", geometry, polarised, spectral_nodes)


PROGRAMS = {
    "truth": Program(skyfit.OrdersOfScattering.fine("spherical", polarised=True)),
    "8 spherical": Program(_orders("8", "spherical")),
    "8 spherical scalar": Program(_orders("8", "spherical", polarised=False)),
    "6 spherical": Program(_orders("6", "spherical")),
    "12 flat": Program(_orders("12", "flat")),
    "8 flat": Program(_orders("8", "flat")),
    "6 flat": Program(_orders("6", "flat")),
    "12 spherical": Program(_orders("12", "spherical")),
    "12 deep spherical": Program(_orders("12 deep", "spherical")),
    "16 spherical": Program(_orders("16", "spherical")),
    "single": Program(skyfit.SingleScattering.normal("spherical")),
    "double": Program(skyfit.DoubleScattering.normal("spherical")),
    "no ozone": Program(_orders("8", "spherical"), "ozone"),
    "no haze": Program(_orders("8", "spherical"), "aerosol"),
    "8 every wavelength": Program(_orders("8", "spherical"), spectrum=True),
    "8 few wavelengths": Program(_orders("8", "spherical", spectral_nodes=13), spectrum=True),
}


def scenes(count: int, seed: int) -> Scenes:
    """The scenes of a seed; more of them begin with the same."""
    low, high = np.array(list(RANGES.values())).T
    share = qmc.Sobol(len(RANGES), seed=seed).random(1 << (count - 1).bit_length())[:count]
    values = low + share * (high - low)
    for i, name in enumerate(RANGES):
        if name in LOGARITHMIC:
            values[:, i] = low[i] * (high[i] / low[i]) ** share[:, i]
    views = [_views(np.random.default_rng((seed, i)), row[0]) for i, row in enumerate(values)]
    return Scenes(values, *(np.stack(part) for part in zip(*views, strict=True)))


def _views(draw: np.random.Generator, sun_deg: float):
    """Zenith angles and azimuths, rad, and wavelengths of one scene; the sun's azimuth is 0."""
    edges = np.concatenate([np.linspace(0.0, 78.0, 9), [82.0, 86.0, 88.0, 89.9]])
    zenith = draw.uniform(edges[:-1], edges[1:])
    azimuth = 180.0 * draw.uniform(size=zenith.size) ** 1.5
    near = np.clip(sun_deg + draw.uniform(-12.0, 12.0, 4), 0.0, 89.0)
    aside = draw.uniform(1.0, 15.0, 4) / np.maximum(np.sin(np.radians(near)), 0.2)
    colour = SHORTEST * (LONGEST / SHORTEST) ** ((np.arange(COLOURS) + draw.uniform(size=COLOURS)) / COLOURS)
    return np.radians(np.append(zenith, near)), np.radians(np.append(azimuth, aside)), colour


def sky(values, zenith, azimuth, wavelength) -> tuple[skyfit.Atmosphere, skyfit.Scene]:
    """The atmosphere and the scene of one row; values may be traced."""
    sun, depth, asymmetry, albedo, ground, height, ozone, exponent, pressure = values
    haze = skyfit.Aerosol(
        depth, exponent, albedo, phase=skyfit.HenyeyGreenstein(asymmetry), profile=skyfit.Exponential(height)
    )
    air = skyfit.Atmosphere(skyfit.Rayleigh(pressure), haze, skyfit.Ozone(ozone), skyfit.Ground(ground))
    return air, skyfit.Scene.from_degrees(sun, skyfit.Directions(zenith, azimuth), wavelength, irradiance="unit")


def answered(program: Program, drawn: Scenes, chunks: int, place) -> np.ndarray:
    """Radiances `[scene, direction, wavelength]` of some chunks; each that is not there yet is computed and kept."""

    @jax.jit
    def light(values, zenith, azimuth, wavelength):
        air, scene = sky(values, zenith, azimuth, wavelength)
        if program.without is not None:
            air = air.replace(**{program.without: None})
        return program.solver.radiance(air, scene)

    found = []
    for chunk in range(chunks):
        path = place(chunk)
        if not path.exists():
            rows = range(CHUNK * chunk, CHUNK * (chunk + 1))
            given = [
                (
                    drawn.values[i],
                    drawn.zenith[i],
                    drawn.azimuth[i],
                    SPECTRUM if program.spectrum else drawn.wavelength[i],
                )
                for i in rows
            ]
            light_of = np.stack([np.asarray(light(*(jnp.asarray(v) for v in row))) for row in given])
            part = path.with_suffix(".part.npy")
            np.save(part, light_of)
            part.rename(path)
        found.append(np.load(path))
    return np.concatenate(found)


def measured(folder: Path, count: int, seed: int, spectra: bool = True) -> dict[str, np.ndarray]:
    """The answers of all `PROGRAMS`, or of those that answer no spectra."""
    folder.mkdir(parents=True, exist_ok=True)
    drawn, found = scenes(count, seed), {}
    for name, program in PROGRAMS.items():
        if program.spectrum and not spectra:
            continue
        start = time.perf_counter()
        chunks = -(-(min(count, FEW) if program.spectrum else count) // CHUNK)
        stem = name.replace(" ", "_")
        found[name] = answered(program, drawn, chunks, lambda c, stem=stem: folder / f"{seed}-{stem}-{c:03d}.npy")
        print(f"{name}: {len(found[name])} scenes, {time.perf_counter() - start:.0f} s", flush=True)
    return found


class Effect(NamedTuple):
    """Two programs, the streams of the first, the powers that each mechanism may have, and what is left out."""

    program: str
    reference: str
    streams: int
    mechanisms: dict[str, dict[str, tuple[float, float]]]


_UP, _ANY = (0.0, 3.0), (-2.0, 2.0)
RESOLUTION = {
    "paths": {"sun airmass": _UP, "low sun": _UP, "bent paths": _UP, "depth": (-1.0, 1.0), "ground albedo": _UP},
    "peak": {"forward peak": _UP, "depth of haze": _UP, "view airmass": _UP, "sun airmass": _UP},
    "horizon": {"depth along the view": _UP, "depth of haze along the view": _UP, "nearness to the sun": _UP},
}
ORDERS = {
    "all": {
        "depth along the view": _UP, "depth": _UP, "ground albedo": _UP, "nearness to the sun": (-2.0, 0.0),
        "low sun": _ANY, "depth of haze": _ANY,
    }
}  # fmt: skip
BENT = {
    "all": {
        "bent paths": _UP, "view airmass": _UP, "nearness to the sun": _UP, "low sun": _UP, "sun airmass": _UP,
        "depth": _ANY, "depth of haze": _ANY,
    }
}  # fmt: skip
# air polarises, haze hides it
AIR = {
    "all": {
        "bent paths": _UP, "sun airmass": _UP, "view airmass": _ANY, "nearness to the sun": _ANY, "low sun": _ANY,
        "depth": _ANY, "depth of haze": (-2.0, 0.0), "ground albedo": (-2.0, 0.0),
    }
}  # fmt: skip
GONE = {
    "all": {
        "left out": _UP, "depth": _ANY, "sun airmass": _ANY, "view airmass": _ANY, "nearness to the sun": _ANY,
        "ground albedo": _ANY,
    }
}  # fmt: skip
SPECTRAL = {"all": {"depth along the view": _UP, "sun airmass": _UP, "low sun": _UP}}
EFFECTS = {
    **{name: Effect(name.replace("streams", "spherical"), "truth", int(name.split()[0]), RESOLUTION) for name in RUNGS},
    "6 streams flat": Effect("6 flat", "12 flat", 6, RESOLUTION),
    "8 streams flat": Effect("8 flat", "12 flat", 8, RESOLUTION),
    "flat Earth": Effect("12 flat", "truth", 12, BENT),
    "no polarisation": Effect("8 spherical scalar", "8 spherical", 8, AIR),
    "one order": Effect("single", "truth", 16, ORDERS),
    "two orders": Effect("double", "truth", 16, ORDERS),
    "left out": Effect("no ozone", "8 spherical", 8, GONE),
    "few wavelengths": Effect("8 few wavelengths", "8 every wavelength", 8, SPECTRAL),
}
# shares of scenes; the largest error by which a constituent that is left out still counts; weights of the fit
SAFE, COUNTS, OF_ALL, RIDGE = 0.985, 0.3, 0.3, 3e-3


def numbers_of(drawn: Scenes, spectrum: bool = False) -> Deciding:
    """What decides in each scene, `[scene, .., direction, wavelength]`."""
    given = (
        drawn._replace(wavelength=np.broadcast_to(SPECTRUM, (len(drawn.values), SPECTRUM.size))) if spectrum else drawn
    )
    found = jax.jit(jax.vmap(lambda *row: deciding(*sky(*row))))(*(jnp.asarray(part) for part in given))
    return Deciding(*(np.asarray(part, np.float64) for part in found))


def samples(effect: Effect, numbers: Deciding, names: tuple[str, ...], found: dict[str, np.ndarray]):
    """Features `[scene, direction, wavelength]` by name, and errors; `names`, of the constituents."""
    error = np.abs(found[effect.program] / found[effect.reference] - 1.0)
    shared = shared_features(numbers)
    if PROGRAMS[effect.program].without is None:
        return with_streams(shared, numbers, effect.streams), error
    parts = []
    for name, program in (("ozone", "no ozone"), ("aerosol", "no haze")):
        off = np.abs(found[program] / found[effect.reference] - 1.0)
        some = off.max(axis=(1, 2)) < COUNTS
        of = with_left_out(shared, numbers, names.index(name))
        parts.append(({key: value[some] for key, value in of.items()}, off[some]))
    (first, low), (second, high) = parts
    return {key: np.concatenate([first[key], second[key]]) for key in first}, np.concatenate([low, high])


def fitted(
    effect: Effect, of: dict[str, np.ndarray], error: np.ndarray, near: list[np.ndarray] | None = None
) -> list[np.ndarray]:
    """The powers of each mechanism, the first of them that of the constant, e; sought `near` others."""
    keys = [["constant", *powers] for powers in effect.mechanisms.values()]
    bounds = [b for powers in effect.mechanisms.values() for b in ((None, None), *powers.values())]
    inputs = [jnp.asarray(np.stack([of[key] for key in row], axis=-1)) for row in keys]
    ends = np.cumsum([len(row) for row in keys])
    wanted = jnp.log(jnp.maximum(error, 1e-6))
    largest = jnp.max(wanted, axis=(1, 2))
    powers = jnp.asarray([float(key != "constant") for row in keys for key in row])

    def soft(value):
        return jnp.sqrt(value**2 + 0.01) - 0.1

    def loss(parameters):
        parts = jnp.split(parameters, ends[:-1])
        model = jax.nn.logsumexp(jnp.stack([x @ p for x, p in zip(inputs, parts, strict=True)]), axis=0)
        off = wanted - model
        peak = jax.nn.logsumexp(8.0 * model, axis=(1, 2)) / 8.0
        # four fifths of all errors lie below
        every = jnp.mean(0.3 * off + 0.5 * soft(off))
        return jnp.mean(soft(largest - peak)) + OF_ALL * every + RIDGE * jnp.sum(powers * parameters**2)

    value = jax.jit(jax.value_and_grad(loss))
    base = float(jnp.median(largest))
    if near is None:
        starts = [[base - 2.0 - 3.0 * i, *(0.5 if low == 0.0 else 0.0 for low, _ in mechanism.values())]
                  for i, mechanism in enumerate(effect.mechanisms.values())]  # fmt: skip
    else:
        starts = near
    start = np.concatenate(starts)
    found = minimize(
        lambda p: tuple(np.asarray(v, float) for v in value(jnp.asarray(p))), start, jac=True, method="L-BFGS-B",
        bounds=bounds, options={"maxiter": 160 if near is None else 40},
    )  # fmt: skip
    return np.split(found.x, ends[:-1])


def model_of(effect: Effect, of: dict[str, np.ndarray], powers: list[np.ndarray]) -> np.ndarray:
    rows = [["constant", *mechanism] for mechanism in effect.mechanisms.values()]
    logs = [sum(p * of[key] for p, key in zip(part, row, strict=True)) for part, row in zip(powers, rows, strict=True)]
    return np.exp(np.logaddexp.reduce(logs))


def columns_of(name: str, effect: Effect, of: dict[str, np.ndarray], error: np.ndarray) -> dict[str, np.ndarray]:
    """The table's columns of an effect: powers of `FEATURES`, and factors that make maximum and median safe."""
    fold = np.random.default_rng(0).permutation(len(error)) % 2
    best, ratios = fitted(effect, of, error), []
    for part in range(2):
        seen, unseen = fold != part, fold == part
        powers = fitted(effect, {key: value[seen] for key, value in of.items()}, error[seen], best)
        model = model_of(effect, {key: value[unseen] for key, value in of.items()}, powers)
        ratios.append([reduced(error[unseen], (1, 2)) / reduced(model, (1, 2)) for reduced in (np.max, np.median)])
    maximum, median = np.concatenate(ratios, axis=1)
    factors = np.quantile(maximum, SAFE), np.quantile(median, SAFE)
    print(f"{name}: {len(error)} scenes, largest error {np.median(error.max((1, 2))):.2g} in the median scene, "
          f"over the model's {np.median(maximum):.2f} (log sd {np.log(maximum).std():.2f}); safe x {factors[0]:.2f}, "
          f"median x {factors[1]:.2f}", flush=True)  # fmt: skip
    columns = {}
    for (mechanism, allowed), part in zip(effect.mechanisms.items(), best, strict=True):
        power = dict(zip(["constant", *allowed], part, strict=True))
        columns[f"{name}:{mechanism}"] = np.array([*(power.get(key, 0.0) for key in FEATURES), *factors])
    return columns


def write(columns: dict[str, np.ndarray], count: int, seed: int, path: Path) -> None:
    """The table, with what made it."""
    rows = [*FEATURES, "factor of the maximum", "factor of the median"]
    head = [
        "# errors of simplifications: a column is a mechanism of an effect, factor x exp(sum of power x log(feature))",
        f"# by experiments/tables/make_error_model.py, {count} scenes, seed {seed}; licence: that of this project",
        "# rows: " + ", ".join(rows),
        "# range:most is the largest logarithm of each feature in these scenes",
    ]
    lines = [",".join(columns), *(",".join(f"{c[i]:.4g}" for c in columns.values()) for i in range(len(rows)))]
    path.write_text("\n".join([*head, *lines]) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--work", type=Path, required=True, help="folder that keeps what was answered")
    parser.add_argument("--scenes", type=int, default=512, help=f"a multiple of {CHUNK}")
    parser.add_argument("--seed", type=int, default=18)
    parser.add_argument("--measure-only", action="store_true")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    found = measured(options.work, options.scenes, options.seed)
    if options.measure_only:
        return
    drawn = scenes(options.scenes, options.seed)
    numbers = numbers_of(drawn)
    of_spectra = numbers_of(Scenes(*(part[:FEW] for part in drawn)), spectrum=True)
    names = sky(*(part[0] for part in drawn))[0].names
    columns = {}
    for name, effect in EFFECTS.items():
        here = of_spectra if PROGRAMS[effect.program].spectrum else numbers
        columns |= columns_of(name, effect, *samples(effect, here, names, found))
    of = with_streams(shared_features(numbers), numbers, 8)
    columns["range:most"] = np.array([*(float(of[key].max()) for key in FEATURES), 1.0, 1.0])
    write(columns, options.scenes, options.seed, DATA / TABLE)


if __name__ == "__main__":
    main()
