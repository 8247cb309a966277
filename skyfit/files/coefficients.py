"""Refitted coefficients of Preetham's model as JSON.

Schema "skyfit.coefficients", version 1: `published` and `refitted`, each with `distribution` `[Y x y][A B C D E]
[slope, constant]` (linear in turbidity), `zenith_luminance` `[tangent offset angle][slope, constant]` (kcd m^-2) and
`zenith_chromaticity` `[x y][T^2 T 1][cube square linear constant]` (of the sun's zenith angle in radians); `valid`,
the suns and turbidities fitted; `skies`, the median relative luminance error and chromaticity distance of each sky
to view zenith 80 degrees; `overall`, their medians; `result`, how each joint fit ended.
"""

import json
from pathlib import Path

import numpy as np

from ..fit import Refit
from ..scene import as_float
from ..sky import Preetham
from .writing import atomic


_SCHEMA, _VERSION = "skyfit.coefficients", 1
_SHAPES = {"distribution": (3, 5, 2), "zenith_luminance": (3, 2), "zenith_chromaticity": (2, 3, 4)}


def write_coefficients(refit: Refit, path) -> None:
    """Published and refitted coefficients with their errors, in the schema of this module.

    **Arguments:** `refit`; `path` of a JSON file. **Errors:** `ValueError` where the file cannot be written.
    """
    degrees = np.degrees(refit.sun_zenith)
    skies = [
        {
            "sun_zenith_deg": round(float(degrees[i]), 6),
            "turbidity": float(refit.turbidity[i]),
            "luminance_error": {n: float(e[i]) for n, e in refit.luminance_error.items()},
            "chromaticity_error": {n: float(e[i]) for n, e in refit.chromaticity_error.items()},
        }
        for i in range(degrees.size)
    ]
    record = {
        "schema": _SCHEMA,
        "version": _VERSION,
        "published": _as_lists(refit.published),
        "refitted": _as_lists(refit.refitted),
        "valid": {
            "sun_zenith_deg": [float(degrees.min()), float(degrees.max())],
            "turbidity": [float(refit.turbidity.min()), float(refit.turbidity.max())],
        },
        "skies": skies,
        "overall": {n: {"luminance": e[0], "chromaticity": e[1]} for n, e in refit.overall.items()},
        "result": refit.result,
    }
    with atomic(path) as temporary:
        temporary.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n")


def read_coefficients(path) -> Preetham:
    """The refitted model of a file that `write_coefficients` made.

    **Arguments:** `path`. **Returns:** `Preetham` with the file's range of turbidity as its valid one.
    **Errors:** `ValueError` naming the file and what is wrong with it.
    """
    path = Path(path)
    try:
        record = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ValueError(f"{path.name}: expected a JSON file of coefficients, found {error}") from None
    if not isinstance(record, dict) or record.get("schema") != _SCHEMA or record.get("version") != _VERSION:
        raise ValueError(f'{path.name}: expected the schema "{_SCHEMA}" version {_VERSION}')
    try:
        arrays = {name: np.asarray(record["refitted"][name], float) for name in _SHAPES}
        low, high = record["valid"]["turbidity"]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path.name}: the coefficients are incomplete: {error}") from None
    for name, shape in _SHAPES.items():
        if arrays[name].shape != shape or not np.all(np.isfinite(arrays[name])):
            raise ValueError(f"{path.name}: `{name}` must be numbers of shape {shape}, found {arrays[name].shape}")
    return Preetham(
        **{name: as_float(values) for name, values in arrays.items()},
        lowest_turbidity=float(low),
        fitted_turbidity=(float(low), float(high)),
    )


def _as_lists(model: Preetham) -> dict:
    return {name: np.asarray(getattr(model, name), float).tolist() for name in _SHAPES}
