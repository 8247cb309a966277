"""Solvers, atmospheres and spectra from the text of options."""

import math
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from ..atmosphere import (
    AbstractPhase,
    Aerosol,
    Atmosphere,
    Exponential,
    from_description,
    Ground,
    meteorological_range as meteorological_range_of,
    optical_depth_to_turbidity,
    Ozone,
    Rayleigh,
    turbidity_from_range,
)
from ..programs import kept
from ..scene import Scene
from ..transport import AbstractSolver, OrdersOfScattering, SOLVERS
from .options import GeometryName, in_range, PresetName


def _radiance(solver: AbstractSolver, atmosphere: Atmosphere, scene: Scene):
    return solver.radiance(atmosphere, scene)


kept_radiance = kept(_radiance, lambda *_: 0)


def make_solver(name: str, preset: PresetName, geometry: GeometryName, polarised: bool = False) -> AbstractSolver:
    """The solver with a name, preset and geometry; only `orders` may be polarised."""
    if name not in SOLVERS:
        raise ValueError(f"`--solver` must be one of {', '.join(SOLVERS)}, got {name!r}")
    if name == "uniform" and geometry is not GeometryName.flat:
        raise ValueError(
            f"`--geometry` must be flat with `--solver uniform`, which knows no other, got {geometry.value}"
        )
    if polarised and name != "orders":
        raise ValueError(f"`--polarised` must be left out with `--solver {name}`: only orders knows polarisation")
    settings = {"polarised": True} if polarised else {}
    return getattr(SOLVERS[name], preset.value)(geometry.value, **settings)


# Names of analytic skies
FORMULAS = ("extended", "published")


def analytic_of(name: str, said: str = "the sky must be one of"):
    """The analytic sky with a name among `FORMULAS`, or of a file of coefficients.

    **Errors:** `ValueError` that begins with `said`.
    """
    from ..analytic import ExtendedPreetham, Preetham
    from ..records import read_coefficients

    if name not in FORMULAS and not Path(name).is_file():
        raise ValueError(f"{said} {', '.join(FORMULAS)} or a coefficients.json, got {name!r}")
    known = {"extended": ExtendedPreetham.shipped, "published": Preetham.published}
    return known[name]() if name in FORMULAS else read_coefficients(name)


def make_atmosphere(
    phase: AbstractPhase,
    angstrom_exponent: float,
    single_scattering_albedo: float,
    haze_height: float,
    ground_albedo: float,
    ozone: float,
    pressure: float,
) -> Callable:
    """A function from the haze's optical depth at 550 nm, maybe traced, to an `Atmosphere`; checks the options."""
    haze = {
        "angstrom_exponent": in_range("--angstrom-exponent", angstrom_exponent, -1.0, 4.0),
        "single_scattering_albedo": in_range("--single-scattering-albedo", single_scattering_albedo, 0.0, 1.0),
        "profile": Exponential(in_range("--haze-height", haze_height, 50.0, 20000.0)),
        "phase": phase,
    }
    gas = Ozone(column=in_range("--ozone", ozone, 0.0, 1000.0))
    ground = Ground(albedo=in_range("--ground-albedo", ground_albedo, 0.0, 1.0))
    air = Rayleigh(pressure=in_range("--pressure", pressure, 2e3, 1.2e5))
    return lambda depth: Atmosphere(rayleigh=air, aerosol=Aerosol(depth, **haze), ozone=gas, ground=ground)


def atmosphere_of(path: Path) -> Atmosphere:
    """The atmosphere of a TOML or JSON file in the layout of `describe`, which simulated files use, too."""
    import json
    import tomllib

    try:
        text = path.read_text(encoding="utf-8")
        block = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except OSError as error:
        raise ValueError(f"`--atmosphere`: {path}: {error.strerror}") from error
    except (json.JSONDecodeError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"`--atmosphere`: {path}: not TOML (or JSON, where its name ends so): {error}") from error
    return from_description(block, str(path))


def in_words(solver: AbstractSolver) -> str:
    """The solver in words: name, geometry, streams and polarisation."""
    name = type(solver).__name__
    if not isinstance(solver, OrdersOfScattering):
        return f"{name}, {solver.geometry}, scalar (polarisation left out)"
    kind = "polarised" if solver.polarised else "scalar (polarisation left out)"
    return f"{name}, {solver.geometry}, {solver.streams} streams, {kind}"


def sizes(free: tuple[str, ...], scene: Scene, atmosphere: Atmosphere) -> str:
    """What a program is compiled for beside its solver, in words: sizes, constituents and free parameters."""
    shape = f"{scene.view.zenith.shape[0]} directions, {scene.wavelength_nm.shape[0]} wavelengths"
    return f"{shape}, {', '.join(atmosphere.names)}; {', '.join(free)}"


def settings_of(solver: AbstractSolver) -> dict:
    """The name and all settings of a solver, for a file."""
    return {"name": type(solver).__name__} | {field.name: getattr(solver, field.name) for field in fields(solver)}


def tolerance_of(text: str) -> float:
    """A relative error from "1%" or "0.01"."""
    number, percent, rest = text.partition("%")
    try:
        value = float(number) / (100.0 if percent else 1.0)
    except ValueError:
        value = math.nan
    if rest or not 0.0 < value <= 1.0:
        raise ValueError(f"`--tolerance` must be a share of the radiance such as 1% or 0.01, at most 1, got {text!r}")
    return value


def precision() -> str:
    """The name of JAX's default float type."""
    return str(jnp.result_type(float))


def wavelengths_of(text: str) -> np.ndarray:
    """Wavelengths from "first:last:step" or a comma-separated list, nm."""
    try:
        parts = np.array([float(part) for part in text.split(":" if ":" in text else ",")])
    except ValueError:
        parts = np.array([np.nan])
    if not np.all(np.isfinite(parts)):
        raise ValueError(f"`--wavelengths` must be first:last:step or a list in nm, got {text!r}")
    if ":" not in text:
        if np.any(np.diff(parts) <= 0.0):
            raise ValueError(f"`--wavelengths` must increase, got {text!r}")
        return parts
    if parts.size != 3 or parts[2] <= 0.0 or not 0.0 <= parts[1] - parts[0] <= 1e4 * parts[2]:
        raise ValueError(f"`--wavelengths` must be first:last:step in nm, 10000 steps at most, got {text!r}")
    return np.arange(parts[0], parts[1] + 0.5 * parts[2], parts[2])


def turbidity_of(
    turbidity: float | None, optical_depth: float | None, range_km: float | None, haze_height: float
) -> float:
    """Preetham's turbidity from the given one of turbidity, optical depth and meteorological range."""
    if sum(value is not None for value in (turbidity, optical_depth, range_km)) != 1:
        raise ValueError(
            "exactly one of `--turbidity`, `--aerosol-optical-depth` and `--meteorological-range` must be given"
        )
    if turbidity is not None:
        return in_range("--turbidity", turbidity, 1.0, 50.0)
    if optical_depth is not None:
        return float(optical_depth_to_turbidity(in_range("--aerosol-optical-depth", optical_depth, 0.0, 5.0)))
    assert range_km is not None
    clearest = float(meteorological_range_of(1.0)) / 1e3
    metres = 1e3 * in_range("--meteorological-range", range_km, 1.0, clearest)
    return float(turbidity_from_range(metres, haze_height))
