"""The fitted skies of a record."""

import os
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import equinox as eqx
import jax
import numpy as np

from ...atmosphere import CornetteShanks, Rayleigh, SEA_LEVEL_PRESSURE
from ...measured import Response
from ...numerics import as_float
from ...retrieve import Fitted, PARAMETERS, start_model, with_values
from ...transport import AbstractSolver, SOLVERS
from .schema import is_number, parse, shown
from .write import constants_of, kinds_of, names_of, place_of


def rebuilt(record: dict) -> Fitted:
    """The fitted skies of a record of the form in `record_form`; a `ValueError` names the key that cannot be."""
    free, shared, times = record["free"], record["shared"]["parameters"], record["times"]
    if not times:
        raise ValueError("key `times`: expected an entry or more, found none")
    model = _model(record["atmosphere"])
    known = set(names_of(model))
    leaves = [_leaf_name(name) for name in free]
    if not known.issuperset(leaves) or len(set(leaves)) < len(leaves):
        raise ValueError(f"key `free`: expected each parameter of this atmosphere once, found {shown(free)}")
    _check_parameters("fixed", record["fixed"], known - set(leaves), fitted=False)
    _check_parameters("shared.parameters", shared, set(free) & set(shared))
    model = _with(_with(model, record["fixed"]), shared)
    models = []
    for t, entry in enumerate(times):
        _check_parameters(f"times[{t}].parameters", entry["parameters"], set(free) - set(shared))
        models.append(_with(model, entry["parameters"]))
    width = record["instrument"]["fwhm_nm"]
    stamps = np.array([_stamp(entry["time"], t) for t, entry in enumerate(times)], "datetime64[ns]")
    response = _response(record["instrument"]["response"])
    fitted_nm, calibration = _calibration(record["calibration"], len(times), response is not None)
    width = float("nan") if width is None else float(width)
    return Fitted(stamps, tuple(models), _solver(record), width, fitted_nm, calibration, response)


def _response(about: dict | None) -> Response | None:
    if about is None:
        return None
    try:
        rows = [about["wavelength_nm"], *about["weight"]]
        if not all(is_number(value) for row in rows for value in row):
            raise ValueError("found something else than numbers")
        return Response(np.array(rows[0], float), np.array(rows[1:], float), tuple(about.get("names", ())))
    except (KeyError, TypeError, ValueError) as error:
        expected = "wavelength_nm and weight [channel][wavelength]"
        raise ValueError(f"key `instrument.response`: expected {expected} ({error})") from None


def _calibration(about: dict, times: int, channels: bool):
    """The fitted wavelengths, or what channels are called, and the instrument's scale, `[time, wavelength]`."""
    wavelength, rows = np.array(about["wavelength_nm"], float), about["scale"]
    if wavelength.size == 0 or not (channels or np.all(np.diff(wavelength) > 0.0)):
        raise ValueError(
            f"key `calibration.wavelength_nm`: expected nm, increasing, found {shown(wavelength.tolist())}"
        )
    if len(rows) not in (1, times) or any(len(row) != wavelength.size for row in rows):
        raise ValueError(
            f"key `calibration.scale`: expected 1 or {times} rows of {wavelength.size} numbers, found {shown(rows)}"
        )
    return wavelength, np.broadcast_to(np.array(rows, float), (times, wavelength.size))


def _model(about: dict):
    """The model of the recorded kinds and constants; its parameters are still those of a start."""
    # by what is free in it a start has the kind of haze that it has
    kinds = {"TwoTermHenyeyGreenstein": ("forward_fraction",), "TwoModePhase": ("fine_fraction",)}
    model = start_model(kinds.get(about["phase"], ()), SEA_LEVEL_PRESSURE)
    if about["phase"] == "CornetteShanks":
        model = eqx.tree_at(lambda m: m.atmosphere.aerosol.phase, model, CornetteShanks(0.7))
    if about["rayleigh_formula"] == "paper":
        model = eqx.tree_at(lambda m: m.atmosphere.rayleigh, model, Rayleigh(formula="paper"))
    for place in ("rayleigh", "aerosol", "ozone"):
        if about[place] is None:
            model = eqx.tree_at(lambda m, place=place: getattr(m.atmosphere, place), model, None)
    for key, kind in kinds_of(model).items():
        if about[key] != kind:
            raise ValueError(
                f"key `atmosphere.{key}`: expected {shown(kind)}, found {shown(about[key])}, which only the "
                "program that made it can rebuild"
            )
    constants, expected = about["constants"], constants_of(model)
    for name in [*expected, *constants]:
        if name not in expected or not is_number(constants.get(name)):
            raise ValueError(
                f"key `atmosphere.constants.{name}`: expected {'a number' if name in expected else 'none'}, "
                f"found {shown(constants.get(name))}"
            )
    return jax.tree_util.tree_map_with_path(
        lambda path, leaf: as_float(constants[place_of(path)]) if place_of(path) in constants else leaf, model
    )


def _with(model, values: dict):
    names = tuple(values)
    return with_values(model, names, [values[name]["value"] for name in names]) if names else model


def _leaf_name(name: str) -> str:
    """Turbidity is another name of the aerosol's optical depth."""
    return "aerosol_optical_depth" if name == "turbidity" else name


def _check_parameters(key: str, entries: dict, expected: set[str], fitted: bool = True) -> None:
    for name in [*sorted(expected), *entries]:
        if name not in entries:
            raise ValueError(f"key `{key}.{name}`: expected, found none")
        if name not in expected:
            raise ValueError(f"key `{key}.{name}`: expected only {', '.join(sorted(expected)) or 'none'}")
        parameter, value, unit = PARAMETERS[name], entries[name]["value"], entries[name]["unit"]
        if unit != parameter.unit:
            raise ValueError(f"key `{key}.{name}.unit`: expected {shown(parameter.unit)}, found {shown(unit)}")
        # rounding may put a fitted value a little outside
        slack = 1e-5 * (parameter.upper - parameter.lower)
        if fitted and not parameter.lower - slack <= value <= parameter.upper + slack:
            raise ValueError(
                f"key `{key}.{name}.value`: expected {parameter.lower:g} to {parameter.upper:g}, found {value:g}"
            )


def _stamp(text: str | None, t: int) -> np.datetime64:
    try:
        return np.datetime64("NaT" if text is None else text.removesuffix("Z"), "ns")
    except ValueError:
        raise ValueError(f"key `times[{t}].time`: expected ISO 8601 in UTC, found {shown(text)}") from None


def _solver(record: dict) -> AbstractSolver:
    settings = dict(record["solver"])
    name = settings.pop("name")
    known: dict[str, Callable[..., AbstractSolver]] = {kind.__name__: kind for kind in SOLVERS.values()}
    if name not in known:
        raise ValueError(f"key `solver.name`: expected one of {', '.join(known)}, found {shown(name)}")
    defaults = known[name]()
    for key in [f.name for f in fields(defaults)] + list(settings):
        if key not in settings:
            raise ValueError(f"key `solver.{key}`: expected, found none")
        usual = getattr(defaults, key, None)
        if usual is None or type(settings[key]) is not type(usual):
            raise ValueError(f"key `solver.{key}`: expected a setting of {name}, found {shown(settings[key])}")
    if record["geometry"] != settings["geometry"]:
        raise ValueError(f"key `geometry`: expected that of the solver, found {shown(record['geometry'])}")
    try:
        return known[name](**settings)
    except ValueError as error:
        raise ValueError(f"key `solver`: {error}") from None


def load(path: str | os.PathLike) -> Fitted:
    """The fitted skies of a file that `save` wrote, for `skyfit.predict`.

    **Arguments:** `path`, a JSON file of the form that `record_form` documents.
    **Returns:** a `Fitted`, with values in the process's default float type.
    **Valid:** air, haze of any Henyey-Greenstein kind in an exponential profile, ozone or none.
    **Errors:** a one-line `ValueError` that names the file and the key for everything else.
    """
    path = Path(path)
    try:
        return rebuilt(parse(path))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error
