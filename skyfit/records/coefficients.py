"""Refitted coefficients of Preetham's model as JSON.

Schema "skyfit.coefficients", version 2: `form`, "linear" or "extended"; `published` and `refitted`. Of the linear form
each holds `distribution` `[Y x y][A B C D E][slope, constant]` (linear in turbidity), `zenith_luminance`
`[tangent offset angle][slope, constant]` (kcd m^-2) and `zenith_chromaticity` `[x y][T^2 T 1][cube square linear
constant]` (of the sun's zenith angle in radians); of the extended form `refitted` holds `coefficients` `[Y x y]
[6 numbers][turbidity][sun]` of `skyfit.ExtendedPreetham`. `valid`, the suns and turbidities fitted; `fitted` and
`held_out` (random skies of that range): `skies`, each with the median and 95th percentile of the relative luminance
error and the median chromaticity distance to view zenith 80 degrees; `overall`, the same over all those directions of
skies with the sun to 85 degrees; `rest`, over all others; `simulated`, where given, the settings of the skies, by the
names of the command line's options; `result`, how each joint fit ended. What is not known, such
as the error of the published formula out of its range, is null.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..analytic import Comparison, ExtendedPreetham, Preetham, Refit
from ..measured import atomic
from ..numerics import as_float


_SCHEMA, _VERSION = "skyfit.coefficients", 2
_LINEAR = {"distribution": (3, 5, 2), "zenith_luminance": (3, 2), "zenith_chromaticity": (2, 3, 4)}
_EXTENDED = {"coefficients": (3, 6, None, None)}


def write_coefficients(refit: Refit, path, settings: Mapping[str, str | float | None] | None = None) -> None:
    """Published and refitted coefficients with their errors, in the schema of this module.

    **Arguments:** `refit`; `path` of a JSON file; `settings`, what the skies were simulated with, by name.
    **Errors:** `ValueError` where the file cannot be written.
    """
    degrees, turbidity = np.degrees(refit.fitted.sun_zenith), refit.fitted.turbidity
    linear = isinstance(refit.refitted, Preetham)
    record = {
        "schema": _SCHEMA,
        "version": _VERSION,
        "form": "linear" if linear else "extended",
        "published": _as_lists(refit.published, _LINEAR),
        "refitted": _as_lists(refit.refitted, _LINEAR if linear else _EXTENDED),
        "valid": {
            "sun_zenith_deg": [float(degrees.min()), float(degrees.max())],
            "turbidity": [float(turbidity.min()), float(turbidity.max())],
        },
        "fitted": _comparison(refit.fitted),
        "held_out": _comparison(refit.held_out),
        **({} if settings is None else {"simulated": dict(settings)}),
        "result": refit.result,
    }
    with atomic(path) as temporary:
        temporary.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n")


def read_coefficients(path) -> Preetham | ExtendedPreetham:
    """The refitted model of a file that `write_coefficients` made.

    **Arguments:** `path`. **Returns:** `ExtendedPreetham` or `Preetham`, valid where the file says.
    **Errors:** `ValueError` naming the file and what is wrong with it.
    """
    path = Path(path)
    try:
        record = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ValueError(f"{path.name}: expected a JSON file of coefficients, found {error}") from None
    if not isinstance(record, dict) or record.get("schema") != _SCHEMA or record.get("version") != _VERSION:
        raise ValueError(f'{path.name}: expected the schema "{_SCHEMA}" version {_VERSION}')
    form = record.get("form")
    if form not in ("linear", "extended"):
        raise ValueError(f'{path.name}: `form` must be "linear" or "extended", found {form!r}')
    shapes = _LINEAR if form == "linear" else _EXTENDED
    try:
        arrays = {name: np.asarray(record["refitted"][name], float) for name in shapes}
        low, high = (float(turbidity) for turbidity in record["valid"]["turbidity"])
        highest_sun, lowest_sun = (math.radians(angle) for angle in record["valid"]["sun_zenith_deg"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path.name}: the coefficients are incomplete: {error}") from None
    for name, shape in shapes.items():
        found = arrays[name].shape
        fits = len(found) == len(shape) and all(
            want in (None, have) and have > 1 for want, have in zip(shape, found, strict=True)
        )
        if not fits or not np.all(np.isfinite(arrays[name])):
            wanted = str(shape).replace("None", "more")
            raise ValueError(f"{path.name}: `{name}` must be numbers of shape {wanted}, found {found}")
    if form == "extended":
        return ExtendedPreetham(
            as_float(arrays["coefficients"]), fitted_turbidity=(low, high), fitted_sun=(highest_sun, lowest_sun)
        )
    return Preetham(
        **{name: as_float(values) for name, values in arrays.items()},
        lowest_turbidity=low,
        fitted_turbidity=(low, high),
        lowest_sun=lowest_sun,
    )


def _comparison(of: Comparison) -> dict:
    degrees = np.degrees(of.sun_zenith)
    skies = [
        {
            "sun_zenith_deg": round(float(degrees[i]), 6),
            "turbidity": float(of.turbidity[i]),
            "luminance_error": {n: _number(e[i]) for n, e in of.luminance_error.items()},
            "luminance_95": {n: _number(e[i]) for n, e in of.luminance_95.items()},
            "chromaticity_error": {n: _number(e[i]) for n, e in of.chromaticity_error.items()},
        }
        for i in range(degrees.size)
    ]
    pooled = {
        part: {n: {k: _number(v) for k, v in e._asdict().items()} for n, e in errors.items()}
        for part, errors in (("overall", of.overall), ("rest", of.rest))
    }
    return {"skies": skies, **pooled}


def _number(value) -> float | None:
    return float(value) if np.isfinite(value) else None


def _as_lists(model, shapes) -> dict:
    return {name: np.asarray(getattr(model, name), float).tolist() for name in shapes}
