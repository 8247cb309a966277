r"""Fits of many skies, written chunk by chunk: `fit_many` and `read_fits`.

Each finished chunk becomes a file of its own in the folder `PATH.parts`. It is written beside its place and then moved
there, so that no kill can damage it. A later run of the same call takes the chunks that are there and goes on. The last
step joins all chunks in `PATH`, as NetCDF with the dimensions time, parameter and wavelength, and removes the folder.
`settings.json` in the folder, and attributes in the file, state the sky and the settings of the fits.
"""

import hashlib
import json
import os
import shutil
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import jax
import numpy as np

from ..extras import require
from ..measured import atomic, NoiseModel, Response, Sky, STATION_RANGES
from ..measured.readers.dataset import load_dataset
from ..measured.units import RADIANCE
from ..measured.writing import skyfit_version
from ..numerics import as_float
from ..retrieve import Fits, PARAMETERS, SkyModel
from ..retrieve.batch import fit_chunks, fits_of_parts, RESULTS
from ..retrieve.components import KINDS
from ..retrieve.parameters import fixed_values
from ..retrieve.prepared import Prepared, prepared
from ..transport import AbstractSolver


_SETTINGS = "settings.json"
_BY_TIME, _BY_PARAMETER, _BY_WAVELENGTH = ("time",), ("time", "parameter"), ("time", "wavelength")
_BY_KIND = ("time", "kind")
# dimensions, units and meaning of each variable
_VARIABLES = {
    "values": (_BY_PARAMETER, None, "fitted value, in the unit of its parameter"),
    "sigma": (_BY_PARAMETER, None, "standard deviation, that by the model's stated error included"),
    "model_sigma": (_BY_PARAMETER, None, "the part of sigma by the model's stated error"),
    "covariance": (("time", "parameter", "other_parameter"), None, "of noise, priors and the model's stated error"),
    "at_bound": (_BY_PARAMETER, None, "1 where the value stands at a bound"),
    "determined": (_BY_PARAMETER, None, "1 where the data determine the value"),
    "rmse": (_BY_TIME, RADIANCE, "over the usable samples at the fitted wavelengths"),
    "samples": (_BY_TIME, "1", "how many those are"),
    "reduced_chi_square": (_BY_TIME, "1", "of all samples and the stated noise"),
    "scale": (_BY_TIME, "1", "the samples' own noise, in what was stated"),
    "common": (_BY_KIND, None, "errors in common, as `kind` names them; pointing in radians"),
    "widening": (_BY_TIME, "1", "factor by which samples that are trusted less widen sigma"),
    "degrees_of_freedom": (_BY_TIME, "1", "parameters that the data determine, not the priors"),
    "calibration": (_BY_WAVELENGTH, "1", "the instrument's scale"),
    "calibration_sigma": (_BY_WAVELENGTH, "1", "its standard deviation"),
    "steps": (_BY_TIME, "1", "steps of the search"),
    "cost": (_BY_TIME, "1", "half the sum of squares after the loss"),
}
_FLAGS, _SKY_NOTES = ("at_bound", "determined"), "sky_notes"


def fit_many(
    sky: Sky,
    free: Sequence[str] | None = None,
    solver: AbstractSolver | None = None,
    start: SkyModel | None = None,
    fwhm_nm: float | None = None,
    max_steps: int = 100,
    progress: Callable[[int, int], None] | None = None,
    *,
    path: str | os.PathLike | None = None,
    chunk: int = 32,
    batch_size: int = 1,
    measurement: NoiseModel | None = None,
    response: Response | None = None,
    priors: Mapping[str, tuple[float, float] | None] | None = None,
    draft: AbstractSolver | None = None,
    guess: bool = True,
    starts: int = 1,
) -> Fits:
    """Fit each time of a sky, or each pixel that stands for one, by itself, in chunks of one compiled call.

    **Arguments:** those that are not named here are as in `skyfit.invert`

    - `path`, `*.nc`: each finished chunk is kept, so that the same call after a kill continues where it stopped. A
      complete file of the same call is only read
    - `chunk`: times in a call; `batch_size`: how many of them run in lock-step, 1 for a CPU, more for an accelerator
    - `progress(done, of)` is called after each chunk, with numbers of times

    **Returns:** `Fits`. A time that cannot be fitted has NaN and a result that says why; the others are as if alone.
    **Valid:** chunks are split over all of JAX' local devices. Results do not depend on `chunk`, and on `batch_size` by
    rounding only.
    **Errors:** `ValueError` as in `invert` for names and settings, for a sky without any usable sample, and for a
    `path` that holds anything else.

    **Example:**

        >>> sky = skyfit.read("data/skies/sample.nc")
        >>> fits = skyfit.fit_many(
        ...     sky,
        ...     ["turbidity"],
        ...     skyfit.SingleScattering.draft("flat"),
        ...     draft=skyfit.SingleScattering.draft("flat"),
        ... )
        >>> fits.values.shape, fits.result.shape
        ((1, 1), (1,))
    """
    for name, value in (("chunk", chunk), ("batch_size", batch_size), ("starts", starts)):
        if not (isinstance(value, int) and value >= 1):
            raise ValueError(f"`{name}` must be a whole number of 1 or more, got {value!r}")
    asked = prepared(sky, free, solver, start, fwhm_nm, max_steps, (), measurement, response, priors, None, draft)
    settings = _settings(asked, max_steps, guess, starts)
    times = len(sky.time)
    target = None if path is None else Path(path)
    parts = None if target is None else _opened(target, settings)
    if target is not None and target.exists():
        return read_fits(target)
    chunks = [] if parts is None else _kept(parts)
    done = np.concatenate([np.zeros(0, int), *(part["index"] for part in chunks)])
    left = np.setdiff1d(np.arange(times), done)
    for part in fit_chunks(asked, left, chunk, batch_size, guess, starts):
        if parts is not None:
            with atomic(parts / f"{part['index'][0]:09d}.npz") as file:
                np.savez(file, allow_pickle=False, **part)
        chunks.append(part)
        if progress is not None:
            progress(sum(len(part["index"]) for part in chunks), times)
    fits = fits_of_parts(
        sky, asked.free, sky.wavelength_nm[asked.chosen], chunks, tuple(dict.fromkeys(asked.sampling.notes)),
        fixed_values(asked.start, asked.free), settings,
    )  # fmt: skip
    if target is not None and parts is not None:
        with atomic(target) as file:
            _write(fits, file)
        shutil.rmtree(parts, ignore_errors=True)
    return fits


def _settings(asked: Prepared, max_steps: int, guess: bool, starts: int) -> dict[str, str]:
    """All inputs that the results depend on, as text."""
    sky, response = asked.sky, asked.sampling.response
    station = tuple(getattr(sky, name) for name in STATION_RANGES if name != "fwhm_nm")
    samples = np.where(sky.usable, sky.radiance, np.nan)
    views = [view[0] if sky.one_pattern else view for view in sky.views]
    # included only if there are some: the digest of other skies stays as it was
    depths = [v for v in (sky.aerosol_optical_depth, sky.aerosol_optical_depth_sigma) if v is not None]
    depths += [np.array(sky.calibration_sigma)] if np.isfinite(sky.calibration_sigma) else []
    if sky.degree_of_polarisation is not None:
        depths += [np.array(0), sky.degree_of_polarisation, sky.degree_of_polarisation_sigma]
    leaves, structure = jax.tree.flatten(asked.start)
    kinds = np.frombuffer(repr(structure).encode(), np.uint8)
    return {
        "skyfit_version": str(skyfit_version()),
        "sky": _digest(
            samples, sky.sigma, sky.usable, *views, sky.wavelength_nm, sky.sun_zenith,
            sky.sun_azimuth, sky.time.astype(np.int64), station, sky.direct_irradiance, sky.direct_sigma,
            *depths,
        ),
        "free": ", ".join(asked.free),
        "solver": _line(asked.solver),
        "slopes": _line(asked.slopes),
        "measurement": _line(asked.measurement),
        "priors": json.dumps(asked.priors),
        "response": "" if response is None else _digest(response.wavelength_nm, response.weight),
        "start": _digest(kinds, *leaves),
        "fwhm_nm": f"{asked.sampling.fwhm_nm:.9g}",
        "max_steps": str(max_steps),
        "guess": str(guess),
        "starts": str(starts),
        "dtype": str(as_float(0.0).dtype),
    }  # fmt: skip


def _line(thing) -> str:
    return " ".join(repr(thing).split())


def _digest(*arrays) -> str:
    found = hashlib.sha256()
    for array in arrays:
        array = np.ascontiguousarray(np.zeros(0) if array is None else array)
        found.update(f"{array.dtype} {array.shape} ".encode())
        found.update(array.tobytes())
    return found.hexdigest()


def _opened(target: Path, settings: dict[str, str]) -> Path:
    """The folder for the parts of a file, made if it is missing, after a check of its content."""
    if target.suffix.lower() != ".nc":
        raise ValueError(f"{target.name}: expected a suffix of .nc, found {target.suffix!r}")
    if target.is_dir():
        raise ValueError(f"{target}: expected a file to write, found a folder")
    parts = target.with_name(target.name + ".parts")
    if target.exists():
        _refuse_other(target, read_fits(target).settings, settings)
        # a run that was killed after its last chunk
        shutil.rmtree(parts, ignore_errors=True)
        return parts
    if not target.parent.is_dir():
        raise ValueError(f"{target}: expected an existing folder to write to, found none")
    try:
        parts.mkdir(exist_ok=True)
    except OSError as error:
        raise ValueError(f"{parts}: cannot be written: {error.strerror or error}") from error
    about = parts / _SETTINGS
    if about.exists():
        try:
            found = json.loads(about.read_text(encoding="utf-8"))
        except ValueError:
            found = {}
        _refuse_other(parts, found, settings)
    elif any(parts.glob("*.npz")):
        _refuse_other(parts, {}, settings)
    else:
        with atomic(about) as file:
            file.write_text(json.dumps(settings, indent=1), encoding="utf-8")
    return parts


def _refuse_other(path: Path, found: dict, settings: dict[str, str]) -> None:
    other = [name for name in settings if found.get(name) != settings[name]]
    if other:
        raise ValueError(
            f"`path` {path} holds fits of other settings ({', '.join(other)}): remove it or name another file"
        )


def _kept(parts: Path) -> list[dict[str, np.ndarray]]:
    """The chunks that an earlier run finished; a damaged file is removed and counts as never made."""
    chunks = []
    for file in sorted(parts.glob("[0-9]*.npz")):
        try:
            # open the file here: NumPy leaves a file open if it is no archive
            with open(file, "rb") as stream, np.load(stream, allow_pickle=False) as data:
                chunks.append({name: data[name] for name in data.files})
        except (OSError, ValueError, EOFError, zipfile.BadZipFile):
            file.unlink(missing_ok=True)
    return chunks


def _write(fits: Fits, file: Path) -> None:
    require("xarray", "h5netcdf")
    import xarray

    variables = {}
    for name, (axes, units, text) in _VARIABLES.items():
        values = getattr(fits, name)
        about = {"long_name": text} | ({} if units is None else {"units": units})
        variables[name] = axes, values.astype(np.int8) if name in _FLAGS else values, about
    codes = {"flag_values": np.arange(len(RESULTS), dtype=np.int8), "flag_meanings": " ".join(RESULTS)}
    ended = np.array([RESULTS.index(name) for name in fits.result], np.int8)
    variables["result"] = _BY_TIME, ended, {"long_name": "how the fit ended"} | codes
    variables["notes"] = _BY_TIME, np.array(["\n".join(said) for said in fits.notes], object)
    variables["unit"] = ("parameter",), np.array([PARAMETERS[name].unit for name in fits.free], object)
    names = np.array(fits.free, object)
    coordinates = {
        "time": ("time", fits.time),
        "parameter": ("parameter", names),
        "other_parameter": ("other_parameter", names),
        "kind": ("kind", np.array(KINDS, object)),
        "wavelength": ("wavelength", fits.fitted_nm, {"units": "nm"}),
    }
    attributes = fits.settings | {"fixed": json.dumps(fits.fixed), _SKY_NOTES: "\n".join(fits.sky_notes)}
    xarray.Dataset(variables, coordinates, attributes).to_netcdf(file, engine="h5netcdf")


def read_fits(path: str | os.PathLike) -> Fits:
    """Read the fits of a file that `fit_many` wrote.

    **Arguments:** `path`, `*.nc`. **Returns:** `Fits`.
    **Errors:** a one-line `ValueError` that names the file for any other file.

    **Example:**

        >>> sky = skyfit.read("data/skies/sample.nc")
        >>> _ = skyfit.fit_many(
        ...     sky,
        ...     ["turbidity"],
        ...     skyfit.SingleScattering.draft("flat"),
        ...     draft=skyfit.SingleScattering.draft("flat"),
        ...     path="fits.nc",
        ... )
        >>> skyfit.read_fits("fits.nc").free
        ('turbidity',)
    """
    path = Path(path)
    try:
        data = load_dataset(path)
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from error
    missing = [name for name in (*_VARIABLES, "result", "notes", "parameter", "wavelength") if name not in data]
    if missing or "fixed" not in data.attrs:
        raise ValueError(f"{path.name}: expected fits of `fit_many`, found no {(missing or ['fixed'])[0]}")
    columns = {name: data[name].values for name in _VARIABLES}
    columns |= {name: columns[name] != 0 for name in _FLAGS}
    settings = {name: str(text) for name, text in data.attrs.items() if name not in ("fixed", _SKY_NOTES)}
    return Fits(
        time=data["time"].values.astype("datetime64[ns]"),
        free=tuple(map(str, data["parameter"].values)),
        fitted_nm=data["wavelength"].values,
        result=np.array(RESULTS)[data["result"].values],
        notes=tuple(tuple(str(text).splitlines()) for text in data["notes"].values),
        # files of earlier versions have none
        sky_notes=tuple(str(data.attrs.get(_SKY_NOTES, "")).splitlines()),
        fixed=json.loads(data.attrs["fixed"]),
        settings=settings,
        **columns,
    )
