"""Refitted coefficients of Preetham's model as JSON.

Schema "skyfit.coefficients", version 3: `form`, "linear" or "extended"; `formula`, `axes` and `units` explain the
numbers; `published` and `refitted`. In the linear form each holds `distribution` `[Y x y][A B C D E][slope,
constant]`, `zenith_luminance` `[tangent offset angle][slope, constant]` (kcd m^-2) and `zenith_chromaticity`
`[x y][T^2 T 1][cube square linear constant]`; in the extended form `refitted` holds `coefficients` `[Y x y]
[6 numbers][turbidity][sun]` of `skyfit.ExtendedPreetham`. `valid`, the suns and turbidities fitted; `fitted` and
`held_out` (random skies of that range): `skies`, by column, with the median and 95th percentile of the relative
luminance error and the median chromaticity distance to view zenith 80 degrees; `overall`, the same over all those
directions of skies with the sun to 85 degrees; `rest`, over all others; `simulated`, if given, the settings of the
skies, by the names of the command line's options, and `choice`, how their solver was chosen, if it was; `result`, how
each joint fit ended. Unknown numbers, such as the error of the published formula out of its range, are null.
`write_evaluator` writes code that evaluates them.
"""

import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..analytic import Comparison, ExtendedPreetham, Preetham, Refit
from ..analytic.extended import CORNER, LOWEST_TERM
from ..analytic.perez import LARGEST_EXPONENT, LOWEST_COSINE
from ..measured import atomic
from ..numerics import as_float
from .evaluator import digits


_SCHEMA, _VERSION = "skyfit.coefficients", 3
_LINEAR = {"distribution": (3, 5, 2), "zenith_luminance": (3, 2), "zenith_chromaticity": (2, 3, 4)}
_EXTENDED = {"coefficients": (3, 6, None, None)}
_LIGHT = (
    "Y = Y_z F(theta, gamma) / F(0, sun), so x and y; F = (1 + A exp(B / cos theta)) (1 + C exp(D gamma) "
    f"+ E cos(gamma)^2), cos theta at least {LOWEST_COSINE:g}, gamma the angle from the sun"
)
_FORMULAS = {
    "linear": {
        "light": _LIGHT,
        "A to E": "slope T + constant",
        "zenith": "Y_z = tangent tan(angle (pi - 2 sun)) + offset; x_z, y_z: cubics in sun, squares in T",
    },
    "extended": {
        "light": _LIGHT,
        "numbers": "u_k = sum_ij c_kij T_i(2 log10(T) - 1) T_j(2 (sun / 92 degrees)^2 - 1), T_i of Chebyshev",
        "A to E": f"B = -exp(u_1), D = -exp(u_3), both at least {-LARGEST_EXPONENT:g}; A = (exp(u_0) - 1) exp(-B); "
        f"C = s(u_2), E = s(u_4); s(v) = {LOWEST_TERM:g} + (v + sqrt(v^2 + {CORNER:g}^2)) / 2",
        "zenith": "exp(u_5)",
    },
}
_AXES = {
    "linear": {
        "distribution": ["Y x y", "A B C D E", "slope constant"],
        "zenith_luminance": ["tangent offset angle", "slope constant"],
        "zenith_chromaticity": ["x y", "T^2 T 1", "cube square linear constant"],
    },
    "extended": {"coefficients": ["Y x y", "u_0 to u_5", "degree in turbidity T", "degree in sun"]},
}
_UNITS = {
    "linear": {"sun": "rad from the zenith", "Y_z": "kcd m^-2"},
    "extended": {"sun": "rad from the zenith", "Y": "cd m^-2"},
}


def write_coefficients(refit: Refit, path, settings: Mapping[str, Any] | None = None) -> None:
    """Write published and refitted coefficients with their errors, in the schema of this module.

    **Arguments:** `refit`; `path` of a JSON file; `settings`, those that the skies were simulated with, by name.
    **Errors:** `ValueError` if the file cannot be written.
    """
    degrees, turbidity = np.degrees(refit.fitted.sun_zenith), refit.fitted.turbidity
    form = "linear" if isinstance(refit.refitted, Preetham) else "extended"
    record = {
        "schema": _SCHEMA,
        "version": _VERSION,
        "form": form,
        "formula": _FORMULAS[form],
        "axes": _AXES[form],
        "units": _UNITS[form],
        "published": _as_lists(refit.published, _LINEAR),
        "refitted": _as_lists(refit.refitted, _LINEAR if form == "linear" else _EXTENDED),
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
        temporary.write_text(_text(record))


def read_coefficients(path) -> Preetham | ExtendedPreetham:
    """Read the refitted model of a file that `write_coefficients` made.

    **Arguments:** `path`. **Returns:** `ExtendedPreetham` or `Preetham`, valid in the range that the file states.
    **Errors:** `ValueError` that names the file and what is wrong with it.

    **Example:**

        >>> found = skyfit.refit(
        ...     skyfit.SingleScattering.draft("flat"),
        ...     sun_zenith_deg=np.array([20.0, 40.0, 60.0, 75.0]),
        ...     turbidity=np.array([2.0, 4.0, 6.0]),
        ...     directions=40,
        ...     held_out=4,
        ... )
        >>> skyfit.records.write_coefficients(found, "coefficients.json")
        >>> model = skyfit.read_coefficients("coefficients.json")
        >>> scene = skyfit.Scene.from_degrees(60, skyfit.hemisphere(20), [450, 550, 650])
        >>> model.radiance(3.0, scene).shape
        (20, 3)
    """
    path = Path(path)
    try:
        record = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ValueError(f"{path.name}: expected a JSON file of coefficients, found {error}") from None
    found = (record.get("schema"), record.get("version")) if isinstance(record, dict) else (None, None)
    # the parts that are read here have not changed since version 2
    if found not in ((_SCHEMA, 2), (_SCHEMA, _VERSION)):
        raise ValueError(
            f'{path.name}: expected the schema "{_SCHEMA}" version {_VERSION}, found {found[0]} {found[1]}'
        )
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


def _text(record: dict) -> str:
    """JSON with a line for each name and innermost list of numbers."""
    text = json.dumps(record, indent=1, allow_nan=False)
    return re.sub(r"\[[^\[\]{}]*\]", lambda found: re.sub(r"\s+", " ", found[0]), text) + "\n"


def _comparison(of: Comparison) -> dict:
    skies = {
        "sun_zenith_deg": [round(float(angle), 6) for angle in np.degrees(of.sun_zenith)],
        "turbidity": [float(turbidity) for turbidity in of.turbidity],
    } | {
        name: {model: [_number(error) for error in errors] for model, errors in getattr(of, name).items()}
        for name in ("luminance_error", "luminance_95", "chromaticity_error")
    }
    pooled = {
        part: {n: {k: _number(v) for k, v in e._asdict().items()} for n, e in errors.items()}
        for part, errors in (("overall", of.overall), ("rest", of.rest))
    }
    return {"skies": skies, **pooled}


def _number(value) -> float | None:
    """The number rounded to four digits, for an error has no more, or None if it is not finite."""
    return float(f"{value:.4g}") if np.isfinite(value) else None


def _as_lists(model, shapes) -> dict:
    """The numbers in as few digits as restore them."""
    arrays = {name: np.asarray(getattr(model, name)) for name in shapes}
    return {n: np.array([float(digits(v)) for v in a.ravel()]).reshape(a.shape).tolist() for n, a in arrays.items()}
