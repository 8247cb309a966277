"""The tiers, presets and geometries that the experiments run over, and what they say of the machine."""

import importlib.metadata
import itertools
import os
import pathlib
import platform
import statistics
import subprocess
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import skyfit
from experiments.benchmarks.rivals import Optics


HERE = pathlib.Path(__file__).resolve().parents[1]
PRESETS, GEOMETRIES = ("draft", "normal", "fine"), ("flat", "spherical")
# short name: class in skyfit, class methods that make it, their geometries (None: the method takes none)
TIERS = {
    "uniform": ("Uniform", ("normal",), ("flat",)),
    "shells": ("Shells", PRESETS, GEOMETRIES),
    "single": ("SingleScattering", PRESETS, GEOMETRIES),
    "double": ("DoubleScattering", PRESETS, GEOMETRIES),
    "orders": ("OrdersOfScattering", PRESETS, GEOMETRIES),
    "orders polarised": ("OrdersOfScattering", PRESETS, GEOMETRIES),
}
WAVELENGTH_NM = np.arange(380.0, 781.0, 10.0)


class Model(NamedTuple):
    """One row of a table: a solver and what it is called."""

    name: str
    preset: str
    geometry: str
    solver: skyfit.transport.AbstractSolver


def make(name: str, preset: str, geometry: str | None) -> skyfit.transport.AbstractSolver:
    """The solver that a row of `TIERS` means."""
    method = getattr(getattr(skyfit, TIERS[name][0]), preset)
    settings = {"polarised": True} if name.endswith("polarised") else {}
    return method() if geometry is None else method(geometry, **settings)


def models() -> list[Model]:
    """Every tier, preset and geometry."""
    rows = []
    for name, (_, presets, geometries) in TIERS.items():
        for preset, geometry in itertools.product(presets, geometries or (None,)):
            solver = make(name, preset, geometry)
            rows.append(Model(name, preset, solver.geometry, solver))
    return rows


def compiled(function: Callable, *arguments) -> tuple[Callable, float]:
    """The function compiled for these arguments, and the seconds of tracing and compiling it."""
    start = time.perf_counter()
    # a solver's bound method has no hash
    program = jax.jit(lambda *given: function(*given)).lower(*arguments).compile()
    return program, time.perf_counter() - start


def seconds(run: Callable, *arguments) -> float:
    """Of one call, its result waited for."""
    start = time.perf_counter()
    jax.block_until_ready(run(*arguments))
    return time.perf_counter() - start


def interleaved(runs: dict, repeats: int, slow: float = 3.0) -> dict:
    """Median seconds of each of `runs`, warmed up, taken in turn; what needs over `slow` seconds has two turns."""
    times = {name: [] for name in runs}
    first = {name: seconds(run) for name, run in runs.items()}
    for turn in range(repeats):
        for name, run in runs.items():
            if turn < 2 or first[name] < slow:
                times[name].append(seconds(run))
    return {name: {"seconds": statistics.median(t), "fastest": min(t), "repeats": len(t)} for name, t in times.items()}


def rival_optics(atmosphere: skyfit.Atmosphere, wavelength_nm: np.ndarray) -> Optics:
    """What a rival is told of an atmosphere of air and haze with the rivals' own scale heights."""
    spectrum, (air, haze) = jnp.asarray(wavelength_nm, float), atmosphere.constituents
    assert air.phase is not None and haze.phase is not None
    second = float(jnp.ravel(air.phase.moments(3, spectrum)[2])[0])
    asymmetry = jnp.broadcast_to(haze.phase.moments(2, spectrum)[1], spectrum.shape)
    each = (
        air.optical_depth_at(spectrum),
        haze.optical_depth_at(spectrum),
        haze.single_scattering_albedo_at(spectrum),
        asymmetry,
    )
    # copies: a view of an array of jax cannot be written to, and compiled rivals refuse it
    ground = np.array(atmosphere.ground.reflectance(spectrum), float)
    return Optics(*(np.array(v, float) for v in each), second, ground)


def made_with(seed: int, packages: tuple[str, ...] = ()) -> dict:
    """Versions, dtype, seed, commit and machine, for a result file."""
    device = jax.devices()[0]
    cores = f"{os.cpu_count()} shared cores {platform.machine()}"
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=HERE)
    return {
        "commit": commit.stdout.strip(),
        "dtype": str(jnp.result_type(float)),
        "seed": seed,
        "python": platform.python_version(),
        "machine": cores if device.platform == "cpu" else f"{device.device_kind}, {cores}",
        **{name: importlib.metadata.version(name) for name in ("jax", "equinox", "numpy", *packages)},
    }
