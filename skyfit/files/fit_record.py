"""A fit on disk: `save` writes it, `load` rebuilds what `skyfit.predict` needs.

`save(fit, "*.json")` writes the record that `record_form` documents. `save(fit, "*.nc")` writes the sky as
`write_sky` lays it out, with more variables: `model`; `residual`, model minus measured, NaN where a sample was not
used; `weight`, that of the loss on the fitted wavelengths, NaN where not used; and `gain`, d parameter / d radiance of
the same time, left out where it would be more than two million numbers.
"""

import json
import math
import os
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

from ..fit import Fit, Fitted
from ..scene import Sky
from .netcdf import write_netcdf
from .rebuilt import rebuilt
from .record_form import parse
from .record_of import record_of
from .units import RADIANCE
from .writing import atomic, write_sky


# numbers of `gain` that a file holds
_MOST_GAIN = 2_000_000


def save(fit: Fit, path: str | os.PathLike) -> None:
    """Write a fit, whole or not at all.

    **Arguments:** `fit`, from `skyfit.invert`; `path`, `*.json` for parameters and uncertainties (`load`
    reads it back) or `*.nc` for the measured, fitted and residual radiance and the samples' weights.
    **Valid:** any other suffix is a `ValueError`; a failure leaves no file and keeps an old one.
    """
    target = Path(path)
    writer = {".json": _write_json, ".nc": _write_field}.get(target.suffix.lower())
    if writer is None:
        raise ValueError(f"{target.name}: expected a suffix of .json, .nc, found {target.suffix!r}")
    with atomic(target) as part:
        writer(fit, part)


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


def write_prediction(sky: Sky, radiance: np.ndarray, path: str | os.PathLike) -> None:
    """Write predicted radiance on a sky's times, directions and wavelengths, as `skyfit.read` reads it.

    **Arguments:** `sky`, the places and times; `radiance`, W m^-2 sr^-1 nm^-1, `[time, direction,
    wavelength]`, NaN where there is none; `path`, `*.nc` (or `*.csv`, a tidy table).
    **Valid:** a failure leaves no file and keeps an old one.
    """
    radiance = np.asarray(radiance, np.float64)
    if radiance.shape != sky.radiance.shape:
        raise ValueError(f"`radiance` must have the shape {sky.radiance.shape} of `sky`, got {radiance.shape}")
    seen = (sky.view_zenith <= 0.5 * np.pi)[None, :, None]
    usable = np.isfinite(radiance) & (radiance >= 0.0) & seen
    notes = (f"predicted by skyfit for the samples of {sky.source}",)
    predicted = {"radiance": radiance, "sigma": None, "usable": usable, "direct_irradiance": None, "direct_sigma": None}
    write_sky(replace(sky, **predicted, masked={}, notes=notes), path)


def _write_field(fit: Fit, part: Path) -> None:
    import xarray

    everywhere, fitted = ("time", "direction", "wavelength"), ("time", "direction", "fitted_wavelength")
    residual = np.where(fit.used, fit.residual, np.nan)
    variables: dict[str, tuple] = {
        "model": (everywhere, fit.model, {"units": RADIANCE, "long_name": "fitted spectral radiance"}),
        "residual": (everywhere, residual, {"units": RADIANCE, "long_name": "model minus radiance where it was used"}),
        "weight": (fitted, fit.weight, {"units": "1", "long_name": "trust of the loss in the sample"}),
    }
    coordinates = {"fitted_wavelength": ("fitted_wavelength", fit.fitted_nm, {"units": "nm"})}
    if fit.gain.size <= _MOST_GAIN:
        about = {"units": f"unit of the parameter per {RADIANCE}", "long_name": "d parameter / d radiance of its time"}
        variables["gain"] = (("time", "parameter", *fitted[1:]), fit.gain.astype(np.float32), about)
        coordinates["parameter"] = ("parameter", np.array(fit.free, dtype=object), {})
    write_netcdf(fit.sky, part)
    encoding = {name: {"zlib": True} for name in variables}
    data = xarray.Dataset(variables, coordinates)
    data.to_netcdf(part, mode="a", engine="h5netcdf", encoding=encoding)


def _write_json(fit: Fit, part: Path) -> None:
    text = json.dumps(_strict(record_of(fit)), allow_nan=False, ensure_ascii=False, indent=2)
    part.write_text(text + "\n", encoding="utf-8")


def _strict(value):
    """The value in Python's own types, with None for what is not finite."""
    if isinstance(value, dict):
        return {key: _strict(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        return _strict(np.asarray(value).tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
