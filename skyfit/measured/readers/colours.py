"""Convert luminance, alone or with chromaticity, to channels: Y, or X, Y and Z."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from ..response import Response
from ..units import LUMINANCE, luminance_factor
from .flags import outside


LUMINANCES = ("luminance", "luminances")
# CIE 1931 x and y as files call them
_X, _Y = ((axis, f"cie_{axis}", f"chromaticity_{axis}", f"{axis}_chromaticity") for axis in ("x", "y"))


def colour_names(names: Iterable[str]) -> tuple[str, tuple[str, str] | None] | None:
    """The file's names of luminance, and of x and y, None for these unless both are there; None without luminance."""
    known = {name.lower(): name for name in names}
    light = next((known[name] for name in LUMINANCES if name in known), None)
    if light is None:
        return None
    x, y = (next((known[name] for name in axis if name in known), None) for axis in (_X, _Y))
    return light, None if x is None or y is None else (x, y)


def tristimulus(
    luminance: Float[np.ndarray, "*samples"], x: Float[np.ndarray, "*samples"], y: Float[np.ndarray, "*samples"]
) -> tuple[Float[np.ndarray, "*samples 3"], list[str]]:
    """X, Y and Z, in the unit of the luminance, and a note if some x and y are of no colour.

    $X = Y x / y$, $Z = Y (1 - x - y) / y$ (CIE 15:2004, section 7).

    **Valid** y > 0, x >= 0, x + y <= 1; elsewhere, and where one is missing, X and Z are NaN.
    """
    with np.errstate(invalid="ignore"):
        colour = (y > 0.0) & (x >= 0.0) & (x + y <= 1.0)
    beside = ~colour & np.isfinite(x) & np.isfinite(y)
    below = np.where(colour, y, 1.0)
    shares = np.stack([np.where(colour, x / below, np.nan), np.where(colour, (1.0 - x - y) / below, np.nan)], axis=-1)
    values = np.stack([luminance * shares[..., 0], luminance, luminance * shares[..., 1]], axis=-1)
    count = int(np.count_nonzero(beside))
    return values, [f"{count} chromaticities are of no colour: X and Z left out there"] if count else []


def channels_of(coloured: bool) -> Response:
    """The eye's luminance alone, or the CIE's X, Y and Z."""
    return Response.xyz() if coloured else Response.eye()


def coloured_rows(
    names: tuple[str, tuple[str, str] | None], number: dict[str, np.ndarray], units: str | None
) -> tuple[dict[str, np.ndarray], Response, list[str]]:
    """Convert the columns of a table of luminance to those of its channels, all rows of one channel after the other.

    **Arguments:** `number`: columns by name, `[row]`, those of `names` among them; `units` of the luminance, cd m-2 if
    None.
    **Returns:** the columns `[channel row]` with `wavelength`, the channels' mean wavelengths, and `radiance` and
    `sigma` in cd m-2; the channels; notes.
    **Errors:** `ValueError` for other units than those of luminance, and for more than one wavelength.
    """
    light, colour = names
    factor, notes = luminance_scale(units)
    if len(np.unique(number.get("wavelength", np.zeros(1)))) > 1:
        raise ValueError("column `wavelength`: expected one value with `luminance`, which is of all, found several")
    response = channels_of(colour is not None)
    values = factor * number[light]
    if colour is None:
        values = values[:, None]
    else:
        values, said = tristimulus(values, *(number[name] for name in colour))
        notes += said
    count = values.shape[1]
    used = {light, *(colour or ())}
    told = {key: np.tile(column, count) for key, column in number.items() if key not in used}
    if "sigma" in number:
        told["sigma"] = (spread_sigma(factor * number["sigma"], values)).T.ravel()
    if colour is not None or "wavelength" not in number:
        told["wavelength"] = np.repeat(response.centre_nm, len(values))
    return told | {"radiance": values.T.ravel()}, response, notes


def spread_sigma(sigma: Float[np.ndarray, "*samples"], values: np.ndarray) -> Float[np.ndarray, "*samples channel"]:
    """The standard deviation of each channel in `values` from that of luminance, with an exact chromaticity."""
    if values.shape[-1] == 1:
        return sigma[..., None]
    luminance = values[..., 1]
    with np.errstate(invalid="ignore", divide="ignore"):
        return sigma[..., None] * np.where(luminance[..., None] > 0.0, values / luminance[..., None], np.nan)


def luminance_scale(units: str | None) -> tuple[float, list[str]]:
    """The factor of units to cd m-2, 1 if none are stated, and a note if it is not 1."""
    factor = 1.0 if units is None else luminance_factor(units)
    if factor is None:
        raise ValueError(f"expected units {LUMINANCE} of `luminance`, found {units!r}")
    return factor, [] if factor == 1.0 else [f"luminance converted from {units} to {LUMINANCE}"]


def coloured_dataset(data):
    """Convert a dataset of `luminance` `[time, direction]`, alone or with x and y, to one of `radiance` in channels.

    **Returns:** the dataset, unchanged if it has a `radiance` or no luminance, and notes.
    **Errors:** `ValueError` if the luminance has other units, or none.
    """
    names = None if "radiance" in data else colour_names(map(str, data.variables))
    if names is None:
        return data, []
    light, colour = names
    if colour is not None and not all(set(data[axis].dims) <= set(data[light].dims) for axis in colour):
        colour = None
    variable = data[light].drop_vars(colour or (), errors="ignore")
    units = variable.attrs.get("units")
    if units is None:
        raise ValueError(f"variable `{light}`: expected units {LUMINANCE}, found none")
    factor, notes = luminance_scale(str(units))
    response = channels_of(colour is not None)
    rest = data.drop_vars([light, *(colour or ()), "wavelength"], errors="ignore")
    if colour is None:
        label = np.ravel(data["wavelength"].values) if "wavelength" in data else response.centre_nm
        if "wavelength" not in variable.dims:
            variable = variable.expand_dims(wavelength=label)
            variable.encoding = data[light].encoding
        # its unit is converted, with a note, later, like that of every radiance
        return rest.assign(radiance=variable).assign_coords(wavelength=("wavelength", label, {"units": "nm"})), []
    columns = [np.broadcast_to(part.values.astype(float), variable.shape) for part in _alike(data, variable, colour)]
    luminance = np.where(outside("", variable), np.nan, variable.values.astype(float)) * factor
    values, said = tristimulus(luminance, *columns)
    about = {key: told for key, told in variable.attrs.items() if key == "ancillary_variables"} | {"units": LUMINANCE}
    dims = *variable.dims, "channel"
    rest = rest.assign(
        radiance=(dims, values, about),
        response=(("channel", "spectrum"), response.weight),
        spectrum=("spectrum", response.wavelength_nm),
    )
    if "sigma" in rest and set(rest["sigma"].dims) <= set(variable.dims):
        (sigma,) = _alike(rest, variable, ["sigma"])
        sigma = factor * np.broadcast_to(sigma.values.astype(float), variable.shape)
        rest = rest.assign(sigma=(dims, spread_sigma(sigma, values), {}))
    places = {"wavelength": ("channel", response.centre_nm, {"units": "nm"}), "channel": list(response.names)}
    return rest.assign_coords(places), notes + said


def _alike(data, variable, names):
    """Broadcast variables over the dimensions of another one, in its order."""
    for name in names:
        one = data[name].drop_vars(names, errors="ignore")
        yield one.broadcast_like(variable).transpose(*variable.dims)
