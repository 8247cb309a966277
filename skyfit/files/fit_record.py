"""A fit on disk: `save` writes it, `load` rebuilds what `skyfit.predict` needs.

`save(fit, "*.json")` writes the record that `record_form` documents. `save(fit, "*.nc")` writes the sky as
`write_sky` lays it out, with two more variables: `model`, and `residual`, model minus measured, NaN where a
sample was not used.
"""

import json
import math
import os
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import equinox as eqx
import jax
import numpy as np

from .. import transport
from ..atmosphere import CornetteShanks, Rayleigh, SEA_LEVEL_PRESSURE
from ..fit import Fit, Fitted, PARAMETERS, start_model
from ..fit.parameters import partition, values_of, with_values
from ..scene import as_float, Sky
from ..transport import AbstractSolver
from .netcdf import degrees, write_netcdf
from .record_form import is_number, parse, SCHEMA, shown, VERSION
from .units import RADIANCE
from .writing import atomic, skyfit_version, write_sky


def save(fit: Fit, path: str | os.PathLike) -> None:
    """Write a fit, whole or not at all.

    **Arguments:** `fit`, from `skyfit.invert`; `path`, `*.json` for parameters and uncertainties (`load`
    reads it back) or `*.nc` for the measured, fitted and residual radiance.
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
        return _rebuild(parse(path))
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
    write_sky(replace(sky, radiance=radiance, sigma=None, usable=usable, masked={}, notes=notes), path)


def _write_field(fit: Fit, part: Path) -> None:
    import xarray

    axes = ("time", "direction", "wavelength")
    about = {
        "model": (fit.model, "fitted spectral radiance"),
        "residual": (np.where(fit.used, fit.residual, np.nan), "model minus radiance where it was used"),
    }
    variables = {name: (axes, values, {"units": RADIANCE, "long_name": text}) for name, (values, text) in about.items()}
    write_netcdf(fit.sky, part)
    encoding = {name: {"zlib": True} for name in variables}
    xarray.Dataset(variables).to_netcdf(part, mode="a", engine="h5netcdf", encoding=encoding)


def _write_json(fit: Fit, part: Path) -> None:
    text = json.dumps(_strict(_record(fit)), allow_nan=False, ensure_ascii=False, indent=2)
    part.write_text(text + "\n", encoding="utf-8")


def _record(fit: Fit) -> dict:
    sky, solver = fit.sky, fit.solver
    fixed = values_of(fit.start, [name for name in _names(fit.start) if name not in fit.free])
    if "turbidity" in fit.free:
        fixed.pop("aerosol_optical_depth", None)
    station = ("latitude_deg", "longitude_deg", "altitude_m", "pressure_pa")
    return {
        "schema": SCHEMA,
        "version": VERSION,
        "skyfit_version": skyfit_version(),
        "source": sky.source,
        "solver": {"name": _class_name(solver)} | {f.name: getattr(solver, f.name) for f in fields(solver)},
        "geometry": solver.geometry,
        "instrument": {"fwhm_nm": fit.fwhm_nm},
        "station": {name: getattr(sky, name) for name in station},
        "atmosphere": _kinds(fit.start) | {"constants": _constants(fit.start)},
        "free": list(fit.free),
        "shared": {"parameters": {}, "correlation": []},
        "fixed": {n: {"value": v, "unit": PARAMETERS[n].unit} for n, v in fixed.items()},
        "times": [_time_record(fit, t) for t in range(len(sky.time))],
        "total_rmse": fit.total_rmse,
        "notes": list(fit.notes),
    }


def _time_record(fit: Fit, t: int) -> dict:
    sky = fit.sky
    masked = dict(sky.at(t).masked)
    left_out = int(np.sum(sky.usable[t] & ~fit.used[t]))
    if left_out:
        masked["not modelled"] = left_out
    return {
        "time": _iso(sky.time[t]),
        "sun_zenith_deg": degrees(sky.sun_zenith)[t],
        "sun_azimuth_deg": degrees(sky.sun_azimuth)[t],
        "parameters": {
            name: {
                "value": fit.values[t, p],
                "unit": PARAMETERS[name].unit,
                "sigma": fit.sigma[t, p],
                "at_bound": fit.at_bound[t, p],
                "determined": fit.determined[t, p],
            }
            for p, name in enumerate(fit.free)
        },
        "correlation": fit.correlation[t],
        "result": fit.result[t],
        "steps": fit.steps[t],
        "rmse": fit.rmse[t],
        "rmse_unit": RADIANCE,
        "samples": np.sum(fit.used[t]),
        "masked": masked,
        "reduced_chi_square": fit.reduced_chi_square[t],
        "undetermined": list(fit.undetermined[t]),
    }


def _iso(time: np.datetime64) -> str | None:
    if np.isnat(time):
        return None
    whole = time.astype("datetime64[s]")
    return str(whole if whole == time else time) + "Z"


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


def _names(model) -> list[str]:
    """The parameters that a model has, each leaf once."""
    return [name for name in values_of(model, PARAMETERS) if name != "turbidity"]


def _class_name(thing) -> str | None:
    """The class's name; with its module where it is not skyfit's own."""
    kind = type(thing)
    own = kind.__module__.startswith("skyfit.")
    return None if thing is None else kind.__name__ if own else f"{kind.__module__}.{kind.__qualname__}"


def _kinds(model) -> dict[str, str | None]:
    """What an atmosphere is made of."""
    air, haze, ozone = model.atmosphere.rayleigh, model.atmosphere.aerosol, model.atmosphere.ozone
    return {
        "rayleigh": _class_name(air),
        "aerosol": _class_name(haze),
        "ozone": _class_name(ozone),
        "rayleigh_formula": getattr(air, "formula", None),
        "phase": _class_name(getattr(haze, "phase", None)),
        "rayleigh_phase": _class_name(getattr(air, "phase", None)),
        "aerosol_profile": _class_name(getattr(haze, "profile", None)),
        "rayleigh_profile": _class_name(getattr(air, "profile", None)),
        "ozone_profile": _class_name(getattr(ozone, "profile", None)),
    }


def _constants(model) -> dict[str, object]:
    """The leaves that no parameter names, by their place, such as "atmosphere.ozone.profile.height"."""
    _, rest = partition(model, tuple(_names(model)))
    leaves, _ = jax.tree_util.tree_flatten_with_path(rest)
    return {_place(path): np.asarray(leaf).tolist() for path, leaf in leaves}


def _place(path) -> str:
    return jax.tree_util.keystr(path, simple=True, separator=".")


def _rebuild(record: dict) -> Fitted:
    free, shared, times = record["free"], record["shared"]["parameters"], record["times"]
    if not times:
        raise ValueError("key `times`: expected an entry or more, found none")
    model = _model(record["atmosphere"])
    known = set(_names(model))
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
    return Fitted(stamps, tuple(models), _solver(record), float("nan") if width is None else float(width))


def _model(about: dict):
    """The model of the recorded kinds and constants; its parameters are still those of a start."""
    second = ("forward_fraction",) if about["phase"] == "TwoTermHenyeyGreenstein" else ()
    model = start_model(second, SEA_LEVEL_PRESSURE)
    if about["phase"] == "CornetteShanks":
        model = eqx.tree_at(lambda m: m.atmosphere.aerosol.phase, model, CornetteShanks(0.7))
    if about["rayleigh_formula"] == "paper":
        model = eqx.tree_at(lambda m: m.atmosphere.rayleigh, model, Rayleigh(formula="paper"))
    for place in ("rayleigh", "aerosol", "ozone"):
        if about[place] is None:
            model = eqx.tree_at(lambda m, place=place: getattr(m.atmosphere, place), model, None)
    for key, kind in _kinds(model).items():
        if about[key] != kind:
            raise ValueError(
                f"key `atmosphere.{key}`: expected {shown(kind)}, found {shown(about[key])}, which only the "
                "program that made it can rebuild"
            )
    constants, expected = about["constants"], _constants(model)
    for name in [*expected, *constants]:
        if name not in expected or not is_number(constants.get(name)):
            raise ValueError(
                f"key `atmosphere.constants.{name}`: expected {'a number' if name in expected else 'none'}, "
                f"found {shown(constants.get(name))}"
            )
    return jax.tree_util.tree_map_with_path(
        lambda path, leaf: as_float(constants[_place(path)]) if _place(path) in constants else leaf, model
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
    known: dict[str, Callable[..., AbstractSolver]] = {
        key: kind
        for key, kind in vars(transport).items()
        if isinstance(kind, type) and issubclass(kind, AbstractSolver) and kind is not AbstractSolver
    }
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
