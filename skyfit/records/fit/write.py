"""Write a fit as the record that `schema` documents."""

import json
import math
import os
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ...atmosphere import describe
from ...extras import require
from ...measured import atomic, Sky, STATION_RANGES, write_sky
from ...measured.samples import BEAM, DEGREE
from ...measured.units import RADIANCE
from ...measured.writers import axes, degrees, write_netcdf
from ...measured.writing import skyfit_version
from ...retrieve import aerosol_optics, Derived, Fit, PARAMETERS
from ...retrieve.components import KINDS
from .schema import SCHEMA, VERSION


def record_of(fit: Fit) -> dict:
    """The record of a fit, in Python's and NumPy's types; numbers that are not finite stay so."""
    sky, solver, given = fit.sky, fit.solver, fit.measurement
    common, optics = [p for p, name in enumerate(fit.free) if name in fit.shared], aerosol_optics(fit)
    return {
        "schema": SCHEMA,
        "version": VERSION,
        "skyfit_version": skyfit_version(),
        "source": sky.source,
        "solver": {"name": type(solver).__name__} | {f.name: getattr(solver, f.name) for f in fields(solver)},
        "geometry": solver.geometry,
        "instrument": {"fwhm_nm": fit.fwhm_nm, "response": _response(fit)},
        "station": {name: getattr(sky, name) for name in STATION_RANGES if name != "fwhm_nm"},
        "atmosphere": describe(fit.start.atmosphere),
        "measurement": {
            "relative": given.relative,
            "floor": given.floor,
            "calibration": given.calibration,
            "calibration_prior": given.calibration_prior(sky),
            "model_error": fit.model_error,
            "field_of_view_deg": np.round(np.degrees(given.field_of_view), 10),
            "loss": given.loss,
            "threshold": given.threshold,
            "level": given.level,
            "colour": given.colour,
            "pointing_deg": None if given.pointing is None else np.degrees(given.pointing),
            "broad_level": given.broad_level,
            "broad_colour": given.broad_colour,
            "time_level": given.time_level,
        },
        "priors": {n: {"value": v, "sigma": s, "unit": PARAMETERS[n].unit} for n, (v, s) in fit.priors.items()},
        "smooth": {n: {"sigma_per_hour": s, "unit": _scale_unit(n)} for n, s in fit.smooth.items()},
        "free": list(fit.free),
        "shared": {
            "parameters": _parameters(fit, 0, common),
            "correlation": fit.correlation[0][np.ix_(common, common)],
        },
        "fixed": {n: {"value": v, "unit": PARAMETERS[n].unit} for n, v in fit.fixed.items()},
        "calibration": {
            "wavelength_nm": fit.fitted_nm,
            "scale": _once(fit.calibration),
            "sigma": _once(fit.calibration_sigma),
        },
        "times": [_time_record(fit, t, optics) for t in range(len(sky.time))],
        "total_rmse": fit.total_rmse,
        "notes": list(fit.notes),
    }


def _response(fit: Fit) -> dict | None:
    response = fit.response
    if response is None:
        return None
    return {"names": response.names, "wavelength_nm": response.wavelength_nm, "weight": response.weight}


def _scale_unit(name: str) -> str:
    """The unit of a change on the parameter's scale: a logarithm has none."""
    return "1" if PARAMETERS[name].log else PARAMETERS[name].unit


def _once(rows: np.ndarray) -> np.ndarray:
    """The rows of all times, or one row if all are equal."""
    return rows[:1] if np.array_equal(rows, np.broadcast_to(rows[:1], rows.shape), equal_nan=True) else rows


def _parameters(fit: Fit, t: int, places: list[int]) -> dict:
    return {
        fit.free[p]: {
            "value": fit.values[t, p],
            "unit": PARAMETERS[fit.free[p]].unit,
            "sigma": fit.sigma[t, p],
            "model_sigma": fit.model_sigma[t, p],
            "jackknife_sigma": fit.jackknife_sigma[t, p],
            "at_bound": fit.at_bound[t, p],
            "determined": fit.determined[t, p],
        }
        for p in places
    }


def _time_record(fit: Fit, t: int, optics: dict[str, Derived]) -> dict:
    sky = fit.sky
    sun = degrees(np.array(sky.sun_at(t)))
    masked = dict(sky.at(t).masked)
    left_out = int(np.sum(sky.usable[t] & ~fit.used[t]))
    if left_out:
        masked["not modelled"] = left_out
    return {
        "time": _iso(sky.time[t]),
        "sun_zenith_deg": sun[0],
        "sun_azimuth_deg": sun[1],
        "parameters": _parameters(fit, t, [p for p, name in enumerate(fit.free) if name not in fit.shared]),
        "correlation": fit.correlation[t],
        "haze": {n: {"value": d.value[t], "sigma": d.sigma[t], "unit": d.unit} for n, d in optics.items()},
        "result": fit.result[t],
        "steps": fit.steps[t],
        "rmse": fit.rmse[t],
        "rmse_unit": RADIANCE if fit.response is None else "of the channels",
        "samples": np.sum(fit.used[t]),
        "masked": masked,
        "reduced_chi_square": fit.reduced_chi_square[t],
        "noise": _noise(fit, t),
        "beam": _beam(fit, t),
        "degrees_of_freedom": fit.degrees_of_freedom[t],
        "rejected": _rejected(fit, t),
        "undetermined": list(fit.undetermined[t]),
    }


def _noise(fit: Fit, t: int) -> dict:
    level, colour, pointing, broad_level, broad_colour = fit.common[t]
    spectral, angular = fit.residual_correlation[t]
    return {
        "sample": fit.scale[t],
        "level": level,
        "colour": colour,
        "pointing_deg": np.degrees(pointing),
        "broad_level": broad_level,
        "broad_colour": broad_colour,
        "widening": fit.widening[t],
        "share": dict(zip(("sample", *KINDS), fit.error_share[t], strict=True)),
        "spectral_correlation": spectral,
        "angular_correlation": angular,
    }


def _beam(fit: Fit, t: int) -> list[dict]:
    places = np.flatnonzero(np.isfinite(fit.beam_residual[t]))
    return [{"wavelength_nm": fit.fitted_nm[i], "residual": fit.beam_residual[t, i]} for i in places]


def _rejected(fit: Fit, t: int) -> list[dict]:
    sky, weight = fit.sky, fit.weight[t]
    zenith, azimuth = degrees(sky.view_zenith[t]), degrees(sky.view_azimuth[t])
    return [
        {
            "view_zenith_deg": zenith[d],
            "view_azimuth_deg": azimuth[d],
            "weight": np.nanmean(weight[d]),
        }
        for d in np.flatnonzero(fit.rejected[t])
    ]


def _iso(time: np.datetime64) -> str | None:
    if np.isnat(time):
        return None
    whole = time.astype("datetime64[s]")
    return str(whole if whole == time else time) + "Z"


# largest number of values of `gain` that a file holds
_MOST_GAIN = 2_000_000


def save(fit: Fit, path: str | os.PathLike, *, choice: Mapping[str, Any] | None = None) -> None:
    """Write a fit, whole or not at all.

    **Arguments:** `fit`, from `skyfit.invert`; `path`, `*.json` for parameters and uncertainties (`load`
    reads it back) or `*.nc` for the measured, fitted and residual radiance and the samples' weights; `choice`, how the
    solver was chosen, which JSON keeps.
    **Valid:** any other suffix is a `ValueError`; a failure leaves no file and keeps an old one.

    **Example:**

        >>> sky = skyfit.read("data/skies/sample.nc")
        >>> fit = skyfit.invert(sky, ["turbidity"], skyfit.SingleScattering.draft("flat"))
        >>> skyfit.save(fit, "fit.json")
        >>> skyfit.load("fit.json").models[0].atmosphere.names
        ('rayleigh', 'aerosol', 'ozone')
    """
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in (".json", ".nc"):
        raise ValueError(f"{target.name}: expected a suffix of .json, .nc, found {target.suffix!r}")
    with atomic(target) as part:
        if suffix == ".nc":
            _write_field(fit, part)
        else:
            _write_json(record_of(fit) | ({} if choice is None else {"choice": dict(choice)}), part)


def write_prediction(sky: Sky, radiance: np.ndarray, path: str | os.PathLike) -> None:
    """Write predicted radiance on a sky's times, directions and wavelengths, as `skyfit.read` reads it.

    **Arguments:** `sky`, the times, directions and wavelengths; `radiance`, W m^-2 sr^-1 nm^-1, `[time, direction,
    wavelength]`, NaN where there is none; `path`, `*.nc` (or `*.csv`, a tidy table).
    **Valid:** a failure leaves no file and keeps an old one.
    """
    radiance = np.asarray(radiance, np.float64)
    if radiance.shape != sky.radiance.shape:
        raise ValueError(f"`radiance` must have the shape {sky.radiance.shape} of `sky`, got {radiance.shape}")
    seen = sky.views[0] <= 0.5 * np.pi
    seen = seen if seen.ndim == 3 else seen[..., None]
    usable = np.isfinite(radiance) & seen & ((radiance >= 0.0) | (sky.response is not None))
    notes = (f"predicted by skyfit for the samples of {sky.source}",)
    predicted = {"radiance": radiance, "sigma": None, "usable": usable, **dict.fromkeys((*BEAM, *DEGREE))}
    write_sky(replace(sky, **predicted, masked={}, notes=notes, instrument=""), path)


def _write_field(fit: Fit, part: Path) -> None:
    require("xarray", "h5netcdf")
    import xarray

    everywhere, fitted = axes(fit.sky), ("time", "direction", "fitted_wavelength")
    residual = np.where(fit.used, fit.residual, np.nan)
    unit = {"units": RADIANCE} if fit.sky.response is None else {}
    variables: dict[str, tuple] = {
        "model": (everywhere, fit.model, unit | {"long_name": "fitted spectral radiance"}),
        "residual": (everywhere, residual, unit | {"long_name": "model minus radiance where it was used"}),
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


def _write_json(record: dict, part: Path) -> None:
    text = json.dumps(_strict(record), allow_nan=False, ensure_ascii=False, indent=2)
    part.write_text(text + "\n", encoding="utf-8")


def _strict(value):
    """The value in Python's own types, with None for numbers that are not finite."""
    if isinstance(value, dict):
        return {key: _strict(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        return _strict(np.asarray(value).tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
