"""Rebuild the fitted skies from a record."""

import os
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import numpy as np

from ...atmosphere import from_description
from ...measured import Response
from ...retrieve import Fitted, PARAMETERS, SkyModel, values_of, with_values
from ...transport import AbstractSolver, SOLVERS
from .schema import is_number, parse, shown


def rebuilt(record: dict) -> Fitted:
    """The fitted skies of a record of the form in `schema`; a `ValueError` names the key that is wrong."""
    free, shared, times = record["free"], record["shared"]["parameters"], record["times"]
    if not times:
        raise ValueError("key `times`: expected an entry or more, found none")
    model = SkyModel(from_description(record["atmosphere"], "atmosphere"))
    known = values_of(model, PARAMETERS).keys() - {"turbidity"}
    leaves = [_leaf_name(name) for name in free]
    if not known.issuperset(leaves) or len(set(leaves)) < len(leaves):
        raise ValueError(f"key `free`: expected each parameter of this atmosphere once, found {shown(free)}")
    _check_parameters("fixed", record["fixed"], known - set(leaves), fitted=False)
    _check_parameters("shared.parameters", shared, set(free) & set(shared))
    model = _with(_with_fixed(model, record["fixed"]), shared)
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
    """The fitted wavelengths, or the channels' labels, and the instrument's scale, `[time, wavelength]`."""
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


def _with_fixed(model, fixed: dict):
    """Set the fixed parameters of the instrument; the model must have those of the atmosphere already."""
    own = values_of(model, fixed)
    for name, entry in fixed.items():
        if PARAMETERS[name].of_instrument:
            continue
        if not np.isclose(entry["value"], own[name], rtol=1e-5, atol=0.0):
            raise ValueError(
                f"key `fixed.{name}.value`: expected that of `atmosphere`, {own[name]:g}, found {entry['value']:g}"
            )
    return _with(model, {name: entry for name, entry in fixed.items() if PARAMETERS[name].of_instrument})


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
        # rounding may put a fitted value slightly outside
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
    usual = {f.name: getattr(defaults, f.name) for f in fields(defaults)}
    for key in [*usual, *settings]:
        if key not in settings:
            raise ValueError(f"key `solver.{key}`: expected, found none")
        if key not in usual or type(settings[key]) is not type(usual[key]):
            raise ValueError(f"key `solver.{key}`: expected a setting of {name}, found {shown(settings[key])}")
    if record["geometry"] != settings["geometry"]:
        raise ValueError(f"key `geometry`: expected that of the solver, found {shown(record['geometry'])}")
    try:
        return known[name](**settings)
    except ValueError as error:
        raise ValueError(f"key `solver`: {error}") from None


def load(path: str | os.PathLike) -> Fitted:
    """Load the fitted skies of a file that `save` wrote, for `skyfit.predict`.

    **Arguments:** `path`, a JSON file of the form that `skyfit.records.fit.schema` documents.
    **Returns:** a `Fitted`, with values in the process's default float type.
    **Valid:** skyfit's own constituents, phase functions and profiles (`skyfit.atmosphere.CONSTITUENTS`).
    **Errors:** a one-line `ValueError` that names the file and the key for any other content.

    **Example:**

        >>> sky = skyfit.read("data/skies/sample.nc")
        >>> fit = skyfit.invert(sky, ["turbidity"], skyfit.SingleScattering.draft("flat"))
        >>> skyfit.save(fit, "fit.json")
        >>> skyfit.predict(skyfit.load("fit.json"), sky).shape
        (1, 94, 33)
    """
    path = Path(path)
    try:
        return rebuilt(parse(path))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error
