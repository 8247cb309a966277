r"""The form of a fit's JSON record, and the check that a file has it.

`skyfit.save(fit, "*.json")` writes strict JSON (UTF-8; numbers that are not finite are null) of the schema
"skyfit.fit", version 5. Angles are in degrees, azimuth clockwise from north; a value has its unit beside it.

    schema, version       "skyfit.fit", 5
    skyfit_version        version of the package that wrote the file, or null
    source                name of the measured file
    solver                name: class in skyfit.transport; then all its settings by name
    geometry              "flat" or "spherical", that of the solver
    choice                how the solver was chosen, if it was: tolerance, expected_error, met, reasons
    instrument
      fwhm_nm             Gaussian line shape, null for none
      response            null, or names, wavelength_nm and weight [channel][wavelength]: the samples are channels
    station               latitude_deg, longitude_deg, altitude_m, pressure_pa, ozone_du, sun_distance_au
                          (the last two not in older files); null where unknown
    atmosphere            the start of the fit, as skyfit/atmosphere/description.py documents: constituents by name with
                          kind and every number, and ground; free parameters have their start values here
    measurement           relative, floor, calibration (null: by the file, else the default), model_error,
                          field_of_view_deg, loss, threshold, level, colour, pointing_deg, broad_level,
                          broad_colour (null: estimated) and time_level as in skyfit.NoiseModel;
                          calibration_prior: prior sigma of each wavelength's scale in the fit, 0: exact
    priors                name: {value, sigma, unit}
    smooth                name: {sigma_per_hour, unit}; of a positive parameter that of its logarithm, unit "1"
    free                  names of the fitted parameters, in the order of each correlation matrix
    shared                parameters that all times have in common
      parameters          name: {value, unit, sigma, model_sigma, jackknife_sigma (or null), at_bound, determined}
      correlation         [parameter][parameter] of these alone, in the order of `free`
    fixed                 name: {value, unit}; values of the atmosphere equal those above
    calibration           the instrument's scale at the fitted wavelengths; 1 and sigma 0 where it was not fitted
      wavelength_nm       [wavelength]
      scale, sigma        [time][wavelength], one row if all times share it
    times                 one entry for each time
      time                ISO 8601 in UTC, or null
      sun_zenith_deg, sun_azimuth_deg                   the mean, if they differ between wavelengths
      parameters          those of this time alone, as in shared; sigma includes model_sigma, the model's error
      correlation         [parameter][parameter] of all free parameters
      haze                name: {value, sigma, unit} of the optics that skyfit.aerosol_optics derives
      result, steps       how the solve ended, and after how many steps
      rmse, rmse_unit     over the usable samples
      samples             number of the usable samples
      masked              reason: count of the other samples
      reduced_chi_square  by the stated noise
      noise               the errors of this time as the residuals show them
        sample            each sample's own error, over the stated noise
        level, colour, pointing_deg    errors that all wavelengths of a direction share: relative, and of the view
        broad_level, broad_colour      relative errors that a broad part of the sky shares
        widening          factor by which sigma is larger, because samples are trusted less
        share             of sample, level, colour, pointing, broad_level, broad_colour in the sum of squares
        spectral_correlation, angular_correlation      of whitened residuals, with the next wavelength and direction
      beam                the direct beam, or []: wavelength_nm, residual (model minus measured, over sigma)
      degrees_of_freedom  how many parameters the data, not the priors, determine
      rejected            directions of a mean weight below one half: view_zenith_deg, view_azimuth_deg,
                          weight (mean over wavelengths)
      undetermined        sentences on what the data do not determine
    total_rmse            over the usable samples of all times, in rmse_unit
    notes                 sentences on the file and the fit
"""

import json
from pathlib import Path

from ...retrieve.components import KINDS


SCHEMA, VERSION = "skyfit.fit", 5
_NUMBER, _TEXT, _COUNT, _FLAG = "a number", "text", "a count", "true or false"
_NUMBER_OR_NULL, _TEXT_OR_NULL, _OBJECT_OR_NULL = "a number or null", "text or null", "an object or null"
_FITTED = {
    "value": _NUMBER, "unit": _TEXT, "sigma": _NUMBER_OR_NULL, "model_sigma": _NUMBER_OR_NULL,
    "jackknife_sigma": _NUMBER_OR_NULL, "at_bound": _FLAG,
    "determined": _FLAG,
}  # fmt: skip
_SHARED_NOISE = "level", "colour", "pointing_deg", "broad_level", "broad_colour"
# a dict lists the required keys; a dict with the key `_ANY` stands for any keys, each of that form
_ANY = "*"
_FORM = {
    "schema": _TEXT,
    "version": _COUNT,
    "skyfit_version": _TEXT_OR_NULL,
    "source": _TEXT,
    "solver": {"name": _TEXT},
    "geometry": _TEXT,
    "instrument": {"fwhm_nm": _NUMBER_OR_NULL, "response": _OBJECT_OR_NULL},
    "station": dict.fromkeys(("latitude_deg", "longitude_deg", "altitude_m", "pressure_pa"), _NUMBER_OR_NULL),
    "atmosphere": {"constituents": {_ANY: {"kind": _TEXT}}, "ground": {}},
    "measurement": {
        **dict.fromkeys(("relative", "floor", "calibration", *_SHARED_NOISE), _NUMBER_OR_NULL),
        **dict.fromkeys(("calibration_prior", "model_error", "field_of_view_deg", "threshold", "time_level"), _NUMBER),
        "loss": _TEXT,
    },
    "priors": {_ANY: {"value": _NUMBER, "sigma": _NUMBER, "unit": _TEXT}},
    "smooth": {_ANY: {"sigma_per_hour": _NUMBER, "unit": _TEXT}},
    "free": [_TEXT],
    "shared": {"parameters": {_ANY: _FITTED}, "correlation": [[_NUMBER_OR_NULL]]},
    "fixed": {_ANY: {"value": _NUMBER, "unit": _TEXT}},
    "calibration": {"wavelength_nm": [_NUMBER], "scale": [[_NUMBER]], "sigma": [[_NUMBER_OR_NULL]]},
    "times": [
        {
            "time": _TEXT_OR_NULL,
            "sun_zenith_deg": _NUMBER,
            "sun_azimuth_deg": _NUMBER,
            "parameters": {_ANY: _FITTED},
            "correlation": [[_NUMBER_OR_NULL]],
            "haze": {_ANY: {"value": _NUMBER_OR_NULL, "sigma": _NUMBER_OR_NULL, "unit": _TEXT}},
            "result": _TEXT,
            "steps": _COUNT,
            "rmse": _NUMBER_OR_NULL,
            "rmse_unit": _TEXT,
            "samples": _COUNT,
            "masked": {_ANY: _COUNT},
            "reduced_chi_square": _NUMBER_OR_NULL,
            "noise": {
                **dict.fromkeys(
                    ("sample", *_SHARED_NOISE, "widening", "spectral_correlation", "angular_correlation"),
                    _NUMBER_OR_NULL,
                ),
                "share": dict.fromkeys(("sample", *KINDS), _NUMBER_OR_NULL),
            },
            "beam": [{"wavelength_nm": _NUMBER, "residual": _NUMBER}],
            "degrees_of_freedom": _NUMBER_OR_NULL,
            "rejected": [dict.fromkeys(("view_zenith_deg", "view_azimuth_deg", "weight"), _NUMBER)],
            "undetermined": [_TEXT],
        }
    ],
    "total_rmse": _NUMBER_OR_NULL,
    "notes": [_TEXT],
}


def parse(path: Path) -> dict:
    """Read the record in a file.

    **Arguments:** `path`, a JSON file.
    **Returns:** the record, of the form above throughout; further keys are accepted.
    **Errors:** `ValueError` that names the first key that is not of the form.
    """

    def refuse(word):
        raise ValueError(f"expected strict JSON, found {word}")

    try:
        record = json.loads(path.read_bytes().decode("utf-8"), parse_constant=refuse)
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"expected JSON, found a damaged or other file ({error})") from error
    if not isinstance(record, dict) or record.get("schema") != SCHEMA:
        found = record.get("schema") if isinstance(record, dict) else None
        raise ValueError(f'key `schema`: expected "{SCHEMA}", found {shown(found)}')
    if record.get("version") != VERSION:
        advice = ", of an older skyfit: fit the sky again with it" if record.get("version") in (1, 2, 3, 4) else ""
        raise ValueError(f"key `version`: expected {VERSION}, found {shown(record.get('version'))}{advice}")
    _check(record, _FORM, "")
    return record


def _check(value, form, key: str) -> None:
    if isinstance(form, dict):
        if not isinstance(value, dict):
            raise ValueError(f"key `{key}`: expected an object, found {shown(value)}")
        for name in value if _ANY in form else form:
            below = f"{key}.{name}" if key else name
            if name not in value:
                raise ValueError(f"key `{below}`: expected, found none")
            _check(value[name], form.get(_ANY, form.get(name)), below)
    elif isinstance(form, list):
        if not isinstance(value, list):
            raise ValueError(f"key `{key}`: expected a list, found {shown(value)}")
        for i, entry in enumerate(value):
            _check(entry, form[0], f"{key}[{i}]")
    else:
        fits = {
            _NUMBER: is_number(value),
            _NUMBER_OR_NULL: value is None or is_number(value),
            _TEXT: isinstance(value, str),
            _TEXT_OR_NULL: value is None or isinstance(value, str),
            _OBJECT_OR_NULL: value is None or isinstance(value, dict),
            _COUNT: type(value) is int and value >= 0,
            _FLAG: type(value) is bool,
        }
        if not fits[form]:
            raise ValueError(f"key `{key}`: expected {form}, found {shown(value)}")


def is_number(value) -> bool:
    """Whether a value of the record is a finite number."""
    # an integer beyond the largest float counts as infinite
    return type(value) in (int, float) and abs(value) < 1.7e308


def shown(value) -> str:
    """A value of the record as JSON, short enough for an error of one line."""
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."
