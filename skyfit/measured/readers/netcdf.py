"""Read NetCDF along time, direction, wavelength."""

from pathlib import Path

import numpy as np

from ..response import Response
from ..samples import DEGREE, Sky
from ..units import IRRADIANCE, irradiance_factor, is_nanometre, is_radian, RADIANCE, radiance_factor
from .colours import coloured_dataset
from .dataset import load_dataset
from .flags import flag_variables, flagged, outside
from .header import Head, quantity_of
from .normalised import in_sunlight, normalised_name, share_of
from .photometer import is_photometer, read_photometer
from .scale import scale_of
from .screening import Contents, screened


AXES = ("time", "direction", "wavelength")
BEAM, DEPTH = "direct_normal_irradiance", "aerosol_optical_depth"
_USED = (
    *AXES, "radiance", "sigma", "suspect", "view_zenith", "view_azimuth", "sun_zenith", "sun_azimuth",
    "sun_azimuth_instrument", BEAM, f"{BEAM}_sigma", DEPTH, f"{DEPTH}_sigma", *DEGREE,
)  # fmt: skip
# attributes that describe a file to people and catalogues: those of CF and ACDD, and those that libraries leave
_DESCRIPTIVE = frozenset(
    "conventions title history institution source references featuretype summary keywords keywords_vocabulary id "
    "naming_authority processing_level acknowledgement license standard_name_vocabulary project program platform "
    "platform_vocabulary instrument instrument_vocabulary cdm_data_type metadata_link product_version coordinates "
    "coverage_content_type uuid doi licence copyright rights url contact author authors email creator publisher "
    "contributor".split()
)
_DESCRIPTIVE_PARTS = ("creator_", "publisher_", "contributor_", "date_", "geospatial_", "time_coverage_", "_nc")
# variables that must hold one number in a file
_CANONICAL = ("latitude", "longitude", "altitude_m", "elevation_m", "pressure_pa", "fwhm_nm")


def read_netcdf(path: Path, station: dict[str, float], own_units: bool = False) -> Sky:
    """Read a NetCDF file of sky radiance as a `Sky`.

    **Arguments**

    - `path`: NetCDF 4 (HDF5) or NetCDF 3; dimensions direction, wavelength and optionally time;
      variables `radiance`, optionally `sigma`, `suspect` (1 = masked), `degree_of_polarisation`,
      `direct_normal_irradiance` and `aerosol_optical_depth` [time, wavelength], each with a `_sigma`; coordinates
      `view_zenith`, `view_azimuth` [direction], [time, direction] or [time, direction, wavelength], both NaN past the
      end of a shorter scan, `wavelength`; `sun_zenith` and `sun_azimuth` [time] or [time, wavelength], or latitude,
      longitude and time.
      Channels of a camera or photometer: `channel` in place of the dimension wavelength, `response` [channel,
      spectrum], `spectrum` (nm), optionally `channel` (names), and `wavelength` [channel], the channels' labels;
      `radiance` is then in any unit, that of the response. `luminance` (cd m-2), alone or with `x` and `y`
      (CIE 1931), replaces radiance and wavelength; `normalized_radiance` (pi L / E0), or radiance in sr-1
      (L / E0), is multiplied by the sun's irradiance. A sun photometer's file (`photometer`) is known by its variables
    - `station`: numbers that replace the file's own, by name. The file's own are attributes, or variables of one value,
      in the spellings and units that `header` knows; `own_units`: whether units are those of channels, with any name

    **Returns** a `Sky`. `sun_azimuth_instrument`, where finite, replaces `sun_azimuth`.

    **Valid** the CF conventions: fill values, packing, valid ranges and flags (`flags`) mask samples, counted by
    reason; a note names what is not used. Units are W m-2 sr-1 nm-1 in any common spelling; mW, um, cm are
    converted, with a note; the same holds for the irradiance of the sun's beam, W m-2 nm-1.
    """
    data = load_dataset(path)
    name = path.name
    if is_photometer(data):
        return read_photometer(name, data, station)
    try:
        data, of_colours = coloured_dataset(data)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    normalised = normalised_name(list(map(str, data.variables)))
    data = data if normalised is None else data.rename({normalised: "radiance"})
    response, data = _response(name, data)
    _require(name, data)
    share = _share(name, data, own_units or response is not None, normalised)
    radiance, factor, notes, eye = _radiance(name, data, response, own_units, share)
    notes = of_colours + notes
    axes = radiance.dims
    shape = radiance.shape
    sigma = None
    if "sigma" in data:
        own = own_units or response is not None or eye is not None or share is not None
        units = None if own else data["sigma"].attrs.get("units")
        sigma = _spread(name, data, "sigma", axes, radiance)
        sigma = sigma * (factor if units is None else _factor(name, "sigma", units))
    suspect = None
    if "suspect" in data:
        suspect = _spread(name, data, "suspect", axes, radiance) != 0.0
    light = _stored(name, radiance)
    reasons = {"outside its valid range": outside(name, radiance)}
    flags = flag_variables(data)
    for key in flags:
        about = data[key].attrs
        if not {"flag_values", "flag_masks"} & about.keys():
            notes.append(f"`{key}` does not say what its flags mean: 0 is taken as good")
        for reason, where in flagged(name, key, _spread(name, data, key, axes, radiance), about):
            reasons[reason] = reasons.get(reason, False) | where
    zenith, known = _angle(name, data, "view_zenith", "direction", radiance)
    azimuth, _ = _angle(name, data, "view_azimuth", "direction", radiance)
    zenith, azimuth = _alike(zenith, azimuth, along=1)
    sun_zenith, _ = _angle(name, data, "sun_zenith", "time", radiance)
    sun_azimuth, note = _sun_azimuth(name, data, radiance)
    sun_zenith, sun_azimuth = _alike(sun_zenith, sun_azimuth, along=0)
    notes += note
    direct, direct_sigma, converted = _beam(name, data, radiance)
    notes += converted
    depth, depth_sigma = _depths(name, data, radiance)
    degree = [_spread(name, data, key, axes, radiance) if key in data else None for key in DEGREE]
    head, taken = _head(name, data)
    used = {*_USED, *taken, *flags} - (set() if depth is not None else {DEPTH, f"{DEPTH}_sigma"})
    unused = {
        "variables": [str(key) for key in data.variables if key not in used],
        "attributes": head.unknown,
    }
    notes += [f"{what} not used: {', '.join(keys)}" for what, keys in unused.items() if keys]
    sky = screened(
        Contents(
            name=name,
            radiance=light * factor,
            sigma=sigma,
            suspect=suspect,
            reasons=reasons,
            direct=direct,
            direct_sigma=direct_sigma,
            degree=degree[0],
            degree_sigma=degree[1],
            aerosol_depth=depth,
            aerosol_depth_sigma=depth_sigma,
            instrument=str(data.attrs.get("instrument", "")),
            view_zenith=zenith,
            view_azimuth=azimuth,
            wavelength=_wavelength(name, data),
            time=_time(name, data, shape[0], head.moment),
            sun_zenith=sun_zenith,
            sun_azimuth=sun_azimuth,
            station=head.station | station,
            saturation=_saturation(head, data, factor),
            notes=head.notes + notes,
            made_by=head.made_by,
            calibration_sigma=head.calibration_sigma,
            follows_sun=head.follows_sun,
            angles_known=known,
            turned=bool(note),
            response=eye if response is None else response,
        )
    )
    return sky if share is None else in_sunlight(sky, share)


def _require(name, data):
    for key in ("radiance", "view_zenith", "view_azimuth", "wavelength"):
        if key not in data:
            raise ValueError(f"{name}: expected variable `{key}`, found {', '.join(map(str, data.variables))}")


def _response(name, data):
    """The channels of a file, None without any, and the data with `wavelength`, their labels, as their axis."""
    if "response" not in data:
        return None, data
    variable = data["response"]
    lacking = [key for key in ("spectrum", "wavelength") if key not in data]
    if lacking or set(variable.dims) != {"channel", "spectrum"} or data["wavelength"].dims != ("channel",):
        raise ValueError(
            f"{name}: variable `response`: expected dimensions channel, spectrum, with `spectrum` and `wavelength` "
            f"[channel] in nm, found {', '.join(map(str, variable.dims))}{''.join(f', no `{key}`' for key in lacking)}"
        )
    weight = _numbers(name, variable).transpose([variable.dims.index(axis) for axis in ("channel", "spectrum")])
    names = tuple(map(str, data["channel"].values)) if "channel" in data.variables else ()
    try:
        response = Response(_numbers(name, data["spectrum"]), weight, names)
    except ValueError as error:
        raise ValueError(f"{name}: variable `response`: {error}") from None
    data = data.drop_vars(["response", "spectrum", "channel"], errors="ignore")
    return response, data.swap_dims(channel="wavelength")


def _share(name, data, own, normalised):
    """The factor of samples that are a share of the sun's irradiance; None if they are in a unit of their own."""
    units = data["radiance"].attrs.get("units")
    try:
        return None if own else share_of(None if units is None else str(units), normalised is not None)
    except ValueError as error:
        raise ValueError(f"{name}: variable `{normalised}`: {error}") from None


def _radiance(name, data, response, own_units, share):
    radiance = data["radiance"]
    extra = [axis for axis in radiance.dims if axis not in AXES]
    if extra or "direction" not in radiance.dims or "wavelength" not in radiance.dims:
        raise ValueError(
            f"{name}: variable `radiance`: expected dimensions time, direction, wavelength, "
            f"found {', '.join(map(str, radiance.dims)) or 'none'}"
        )
    if 0 in radiance.shape:
        raise ValueError(f"{name}: variable `radiance`: expected samples, found {radiance.shape}")
    units = radiance.attrs.get("units")
    factor, notes, eye = 1.0, [], None
    if response is None and share is None:
        told = None if units is None else str(units)
        try:
            factor, notes, eye = scale_of(told, radiance.sizes["wavelength"], own_units)
        except ValueError as error:
            raise ValueError(f"{name}: variable `radiance`: {error}") from None
    if "time" not in radiance.dims:
        radiance = radiance.expand_dims("time")
    radiance = radiance.transpose(*AXES)
    # the packing, which a change of axes loses
    radiance.encoding = data["radiance"].encoding
    return radiance, factor, notes, eye


def _beam(name, data, radiance):
    """Direct normal irradiance and its sigma, [time, wavelength], None if absent, and notes on conversions."""
    if BEAM not in data:
        return None, None, []
    across = radiance.isel(direction=0)
    units = data[BEAM].attrs.get("units")
    factor = _factor(name, BEAM, units, IRRADIANCE)
    notes = [] if factor == 1.0 else [f"direct normal irradiance converted from {units} to {IRRADIANCE}"]
    direct = factor * _spread(name, data, BEAM, across.dims, across)
    key = f"{BEAM}_sigma"
    if key not in data:
        return direct, None, notes
    units = data[key].attrs.get("units")
    sigma = _spread(name, data, key, across.dims, across)
    return direct, sigma * (factor if units is None else _factor(name, key, units, IRRADIANCE)), notes


def _depths(name, data, radiance):
    """The haze's optical depth at each wavelength and its sigma, [time, wavelength]; None without wavelengths."""
    if DEPTH not in data or "wavelength" not in data[DEPTH].dims:
        return None, None
    across = radiance.isel(direction=0)
    told = (_spread(name, data, key, across.dims, across) if key in data else None for key in (DEPTH, f"{DEPTH}_sigma"))
    return tuple(told)


def _factor(name, variable, units, wanted=RADIANCE):
    if units is None:
        raise ValueError(f"{name}: variable `{variable}`: expected units {wanted}, found none")
    try:
        return (radiance_factor if wanted == RADIANCE else irradiance_factor)(str(units))
    except ValueError as error:
        raise ValueError(f"{name}: variable `{variable}`: {error}") from None


def _numbers(name, variable):
    """The numbers of a variable, NaN where they are outside its valid range."""
    numbers = _stored(name, variable)
    return np.where(outside(name, variable), np.nan, numbers)


def _stored(name, variable):
    if variable.dtype.kind not in "fiub":
        raise ValueError(f"{name}: variable `{variable.name}`: expected numbers, found {variable.dtype}")
    return np.asarray(variable.values, dtype=np.float64)


def _spread(name, data, key, axes, radiance):
    """Broadcast a variable on any subset of the axes over all of them."""
    variable = data[key]
    extra = [axis for axis in variable.dims if axis not in radiance.dims]
    if extra:
        raise ValueError(
            f"{name}: variable `{key}`: expected dimensions among {', '.join(axes)}, "
            f"found {', '.join(map(str, variable.dims))}"
        )
    numbers = _numbers(name, variable)
    kept = [axis for axis in axes if axis in variable.dims]
    numbers = numbers.transpose([variable.dims.index(axis) for axis in kept])
    index = tuple(slice(None) if axis in kept else None for axis in axes)
    return np.broadcast_to(numbers[index], radiance.shape).copy()


# all dimensions that an angle may have, by its usual one
_OF_ANGLES = {"direction": AXES, "time": ("time", "wavelength")}


def _angle(name, data, key, along, radiance):
    """An angle in degrees, along one dimension or all it may have, and whether it was in radians; NaN if absent."""
    length = radiance.sizes[along]
    if key not in data:
        return np.full(length, np.nan), False
    variable, axes = data[key], _OF_ANGLES[along]
    if not set(variable.dims) <= set(axes) or (along == "direction" and along not in variable.dims):
        raise ValueError(
            f"{name}: variable `{key}`: expected dimension {along}{' or ' + ', '.join(axes) if len(axes) > 1 else ''}, "
            f"found {', '.join(map(str, variable.dims)) or 'none'}"
        )
    units = str(variable.attrs.get("units", ""))
    radian = is_radian(units)
    if radian is None:
        raise ValueError(f"{name}: variable `{key}`: expected units degree, found {units!r}")
    sizes = dict(radiance.sizes)
    if any(variable.sizes[axis] != sizes[axis] for axis in variable.dims):
        raise ValueError(
            f"{name}: variable `{key}`: expected dimensions of `radiance` {radiance.shape}, found {variable.shape}"
        )
    # views of each wavelength are held for each time too
    whole = (along,) if set(variable.dims) <= {along} else axes if "wavelength" in variable.dims else axes[:2]
    kept = [axis for axis in whole if axis in variable.dims]
    numbers = _numbers(name, variable).transpose([variable.dims.index(axis) for axis in kept])
    numbers = numbers[tuple(slice(None) if axis in kept else None for axis in whole)]
    numbers = np.broadcast_to(numbers, tuple(sizes[axis] for axis in whole)).copy()
    return (np.rad2deg(numbers) if radian else numbers), radian


def _alike(one, other, along):
    """Broadcast two angles to one shape; `along`: the axis, of two, of an angle that has only one axis."""
    if one.ndim == other.ndim:
        return one, other
    shape = max(one.shape, other.shape, key=len)
    wide = [angle[:, None] if along == 0 and angle.ndim == 1 else angle for angle in (one, other)]
    # a view that is the same at all wavelengths
    wide = [angle[..., None] if len(shape) == 3 > angle.ndim else angle for angle in wide]
    return tuple(np.broadcast_to(angle, shape).copy() for angle in wide)


def _sun_azimuth(name, data, radiance):
    azimuth, _ = _angle(name, data, "sun_azimuth", "time", radiance)
    own, _ = _angle(name, data, "sun_azimuth_instrument", "time", radiance)
    azimuth, own = _alike(azimuth, own, along=0)
    finite = np.isfinite(own)
    if not np.any(finite):
        return azimuth, []
    notes = ["sun azimuth from sun_azimuth_instrument"]
    if not np.all(finite):
        lacking = ", ".join(str(index) for index in np.flatnonzero(~finite.reshape(len(finite), -1).all(axis=1)))
        notes = [f"{notes[0]}, except times {lacking}"]
    return np.where(finite, own, azimuth), notes


def _wavelength(name, data):
    variable = data["wavelength"]
    units = str(variable.attrs.get("units", "nm"))
    if variable.dims != ("wavelength",) or not is_nanometre(units):
        raise ValueError(
            f"{name}: variable `wavelength`: expected nm along dimension wavelength, "
            f"found {units!r} along {', '.join(map(str, variable.dims)) or 'none'}"
        )
    return _numbers(name, variable)


def _time(name, data, length, moment):
    """The moment of each time; `moment` if the file has no variable `time`."""
    if "time" not in data.variables:
        return np.full(length, moment)
    values = data["time"]
    if values.dtype.kind != "M":
        raise ValueError(
            f"{name}: variable `time`: expected units such as 'seconds since 1970-01-01', "
            f"found {values.attrs.get('units', 'none')!r}"
        )
    return np.broadcast_to(values.values.astype("datetime64[ns]"), (length,)).copy()


def _head(name, data):
    """The head from the attributes and the variables of one number, and the names of those variables."""
    head, taken = Head(name), []
    for key, value in data.attrs.items():
        plain = str(key).lower()
        if quantity_of(plain) is None and (plain in _DESCRIPTIVE or plain.startswith(_DESCRIPTIVE_PARTS)):
            continue
        value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
        if not (isinstance(value, int | float | np.number) and not np.isfinite(value)):
            head.entry("attribute", str(key), value)
    for key in map(str, data.variables):
        if key in _USED or quantity_of(key) is None:
            continue
        numbers = np.unique(_numbers(name, data[key]))
        if numbers.size != 1:
            if key in _CANONICAL:
                raise ValueError(f"{name}: variable `{key}`: expected one number, found {numbers.size}")
            continue
        taken.append(key)
        if np.isfinite(numbers[0]):
            head.number("variable", key, f"{float(numbers[0])!r}", str(data[key].attrs.get("units", "")))
    return head, taken


def _saturation(head, data, factor):
    """The saturation radiance, an attribute of `radiance` or of the file, in its units."""
    value = data["radiance"].attrs.get("saturation", head.saturation)
    if value is None:
        return None
    try:
        return float(value) * factor
    except (TypeError, ValueError):
        raise ValueError(f"{head.name}: attribute `saturation`: expected a number, found {value!r}") from None
