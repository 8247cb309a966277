"""Conversion between an `Atmosphere` and a plain block of names, numbers and lists, as in a JSON or TOML file.

    constituents
      NAME            in the order of the atmosphere; a constituent that is not listed is absent
        kind          "Rayleigh", "Aerosol", "TwoModeAerosol", "BinnedAerosol", "Droplets", "Gas", "Ozone" or
                      "Prescribed"
        ...           the fields of that class by name, in its units; arrays are lists
        phase         kind: "HenyeyGreenstein", ...; then its fields, as above
        profile       kind: "Exponential", "OzoneLayer", "Layered" or "Levels"; then its fields
    ground            albedo, albedo_slope, red_edge

A field that a block leaves out has the default of its class. A block without `constituents` has those of
`Atmosphere()`.
"""

import reprlib
from dataclasses import Field, fields, MISSING
from typing import Any, get_args

import equinox as eqx
import jax
import numpy as np

from ..numerics import as_float
from .aerosol import Aerosol
from .atmosphere import Atmosphere, Ground
from .constituent import AbstractConstituent, Prescribed
from .droplets import Droplets
from .gas import Gas, Ozone
from .mie import TwoModeAerosol, TwoModePhase
from .phase import (
    AbstractPhase,
    CornetteShanks,
    HenyeyGreenstein,
    RayleighPhase,
    Tabulated,
    TwoTermHenyeyGreenstein,
)
from .profile import AbstractProfile, Exponential, Layered, Levels, OzoneLayer
from .rayleigh import Rayleigh
from .size_bins import BinnedAerosol, BinnedPhase


def _by_name(*kinds: type) -> dict[str, type]:
    return {kind.__name__: kind for kind in kinds}


CONSTITUENTS = _by_name(Rayleigh, Aerosol, TwoModeAerosol, BinnedAerosol, Droplets, Gas, Ozone, Prescribed)
PHASES = _by_name(
    RayleighPhase, HenyeyGreenstein, TwoTermHenyeyGreenstein, CornetteShanks, Tabulated, TwoModePhase, BinnedPhase
)  # fmt: skip
PROFILES = _by_name(Exponential, OzoneLayer, Layered, Levels)
_REGISTRIES = {AbstractConstituent: CONSTITUENTS, AbstractPhase: PHASES, AbstractProfile: PROFILES}


def describe(atmosphere: Atmosphere) -> dict[str, Any]:
    """The block of an atmosphere, in built-in Python types.

    **Arguments:** `atmosphere`, not traced. **Returns:** names, kinds, settings and every number. The kind of a class
    that is in no registry includes its module's name; such a block cannot be read back.
    """
    named = zip(atmosphere.names, atmosphere.constituents, strict=True)
    return {"constituents": {name: _block(c) for name, c in named}, "ground": _block(atmosphere.ground)}


def _block(thing: eqx.Module) -> dict[str, Any]:
    kind = type(thing)
    registry = _registry(kind)
    block = {}
    if registry is not None:
        known = registry.get(kind.__name__) is kind
        block["kind"] = kind.__name__ if known else f"{kind.__module__}.{kind.__qualname__}"
    for field in fields(thing):
        value = getattr(thing, field.name)
        if isinstance(value, eqx.Module):
            block[field.name] = _block(value)
        elif isinstance(value, jax.Array | np.ndarray):
            block[field.name] = _plain(np.asarray(value))
        elif value is not None:
            block[field.name] = value
    return block


def _plain(values):
    """Numbers as Python floats with the fewest digits that identify them in their float type."""
    if np.ndim(values):
        return [_plain(row) for row in values]
    # `str` would depend on NumPy's print options, which other packages set
    return float(np.format_float_scientific(values[()], unique=True))


def from_description(block: dict[str, Any], key: str = "") -> Atmosphere:
    """The atmosphere that a block describes, in the process's default float type.

    **Arguments:** `block`, made by `describe` or by hand; `key`, the block's position in its file, for error messages.
    **Returns:** an `Atmosphere`. **Errors:** a one-line `ValueError` that names the first invalid key.
    """
    _check_keys(block, ("constituents", "ground"), key)
    parts: dict[str, Any] = {}
    if "constituents" in block:
        place, named = _below(key, "constituents"), block["constituents"]
        _check_keys(named, None, place)
        if "ground" in named:
            raise ValueError(f"key `{place}.ground`: expected beside `{place}`, not in it")
        parts = dict.fromkeys(("rayleigh", "ozone")) | {
            name: _built(part, AbstractConstituent, _below(place, name)) for name, part in named.items()
        }
    if "ground" in block:
        parts["ground"] = _built(block["ground"], Ground, _below(key, "ground"))
    try:
        return Atmosphere(**parts)
    except ValueError as error:
        raise ValueError(f"key `{_below(key, 'constituents')}`: {error}") from None


def _built(block: Any, kind: type, key: str) -> Any:
    """The object that a block describes: of class `kind`, or of the subclass that the block's own `kind` names."""
    registry = _REGISTRIES.get(kind)
    _check_keys(block, None, key)
    if registry is not None:
        name = block.get("kind")
        if not isinstance(name, str) or name not in registry:
            found = _shown(name) if "kind" in block else "none"
            own = ", which only the program that made it can rebuild" if "." in found else ""
            raise ValueError(f"key `{_below(key, 'kind')}`: expected one of {', '.join(registry)}, found {found}{own}")
        kind = registry[name]
    known = {field.name: field for field in fields(kind) if field.init}
    _check_keys(block, (*(() if registry is None else ("kind",)), *known), key)
    sizes: dict[str, tuple[str, int]] = {}
    values = {}
    for name, field in known.items():
        place = _below(key, name)
        if name in block:
            values[name] = _value(block[name], field, place, sizes)
        elif field.default is MISSING and field.default_factory is MISSING:
            raise ValueError(f"key `{place}`: expected, found none")
    try:
        return kind(**values)
    except ValueError as error:
        raise ValueError(f"key `{key}`: {' '.join(str(error).split())}") from None


def _value(value: Any, field: Field, key: str, sizes: dict[str, tuple[str, int]]) -> Any:
    types = field.type, *get_args(field.type)
    kinds = [k for k in types if isinstance(k, type) and issubclass(k, eqx.Module)]
    if kinds:
        return _built(value, kinds[0], key)
    if field.metadata.get("static"):
        choices, plain = get_args(field.type), field.type if isinstance(field.type, type) else str
        if type(value) is not plain or (choices and value not in choices):
            expected = " or ".join(f'"{c}"' for c in choices) or plain.__name__
            raise ValueError(f"key `{key}`: expected {expected}, found {_shown(value)}")
        return value
    axes = "".join(str(getattr(k, "dim_str", "")) for k in types)
    return _array(value, axes.split(), key, sizes)


def _array(value: Any, axes: list[str], key: str, sizes: dict[str, tuple[str, int]]) -> Any:
    """An array from nested lists, one level per axis. A starred axis is optional. Axes of one name have one size."""
    if axes and axes[0].startswith("*"):
        axes = [axes[0][1:]] if isinstance(value, list) else []
    _check_numbers(value, axes, key)
    for axis, size in zip(axes, np.shape(value), strict=True):
        other, known = sizes.setdefault(axis, (key, size))
        if size != known:
            raise ValueError(f"key `{key}`: expected as many numbers as in `{other}`, {known}, found {size}")
    return as_float(np.asarray(value, np.float64))


def _check_numbers(value: Any, axes: list[str], key: str) -> None:
    if axes:
        if not isinstance(value, list) or not value:
            raise ValueError(f"key `{key}`: expected a list, found {_shown(value)}")
        for i, row in enumerate(value):
            _check_numbers(row, axes[1:], f"{key}[{i}]")
            if len(axes) > 1 and len(row) != len(value[0]):
                raise ValueError(f"key `{key}[{i}]`: expected {len(value[0])} numbers, found {len(row)}")
    # Excludes booleans and numbers that overflow the float type
    elif type(value) not in (int, float) or not abs(value) <= float(np.finfo(as_float(0.0).dtype).max):
        raise ValueError(f"key `{key}`: expected a number, found {_shown(value)}")


def _check_keys(block: Any, known: tuple[str, ...] | None, key: str) -> None:
    if not isinstance(block, dict):
        raise ValueError(f"key `{key}`: expected a block, found {_shown(block)}")
    for name in block:
        if known is not None and name not in known:
            raise ValueError(f"key `{_below(key, name)}`: expected only {', '.join(known)}")


def _registry(kind: type) -> dict[str, type] | None:
    return next((registry for base, registry in _REGISTRIES.items() if issubclass(kind, base)), None)


def _below(key: str, name: object) -> str:
    return f"{key}.{name}" if key else f"{name}"


def _shown(value: Any) -> str:
    return reprlib.repr(value)
