"""Checks of the range of values; values that jit, vmap and grad trace are not checked."""

from dataclasses import fields

import equinox as eqx
import numpy as np
from jax.core import Tracer
from jaxtyping import Float

from .dtype import as_float


# Relative tolerance: an end of a range that is rounded to float32 lies in the range.
_ROUNDING = 1e-6
# Tolerance of the length of unit vectors, which may have been written with few digits.
_LENGTH = 1e-3
# Hint, in messages, at what was meant.
IN_MICROMETRES = "micrometres times 1000"
# Range (nm) of formulas, and of quantities given at the wavelengths that are asked for.
ALL_WAVELENGTHS = (0.0, float("inf"))
_IN_DEGREES = "angles are radians: np.radians(degrees)"


def concrete(value) -> Float[np.ndarray, "..."] | None:
    """The numbers of an argument; None where it is traced, or a placeholder of a tree without numbers."""
    if value is None or isinstance(value, Tracer):
        return None
    try:
        return np.asarray(value, np.float64)
    except (TypeError, ValueError):
        return None


def check_range(name: str, value, low: float, high: float, unit: str = "", hint: str = "") -> None:
    """Raise a `ValueError` that names the argument, unless every number of it lies in [low, high].

    **Arguments:** `name` as the caller wrote it; `value`, a number or an array (traced values are not checked);
    `low`, `high`, infinite where that side is open (infinity itself then passes, NaN never); `unit` and `hint` for the
    message.
    """
    known = concrete(value)
    if known is None:
        return
    outside = ~((known >= low - _ROUNDING * abs(low)) & (known <= high + _ROUNDING * abs(high)))
    if not np.any(outside):
        return
    unit = unit and f" {unit}"
    if not np.isfinite(high):
        wanted = f"at least {low:g}{unit}" if np.isfinite(low) else "finite"
    else:
        wanted = f"between {low:g} and {high:g}{unit}" if np.isfinite(low) else f"at most {high:g}{unit}"
    raise ValueError(f"`{name}` must be {wanted}, got {float(known[outside].flat[0]):g}{hint and f' ({hint})'}")


def check_increasing(name: str, value) -> None:
    """Raise a `ValueError` that names the argument, unless its numbers increase along the last axis."""
    known = concrete(value)
    if known is not None and not np.all(np.diff(known) > 0.0):
        raise ValueError(f"`{name}` must increase, got {np.array2string(known, threshold=8).replace(chr(10), '')}")


def check_radians(name: str, value, low: float, high: float) -> None:
    """`check_range` of an angle in radians; the message says so, because most that are out of range are degrees."""
    check_range(name, value, low, high, "rad", _IN_DEGREES)


def check_unit_vectors(name: str, value) -> None:
    """Raise a `ValueError` that names the argument, unless vectors along its first axis have the length 1."""
    known = concrete(value)
    if known is not None:
        check_range(f"|{name}|", np.linalg.norm(known, axis=0), 1.0 - _LENGTH, 1.0 + _LENGTH, hint="unit vectors")


def check_wavelength(wavelength_nm, low: float, high: float, of: str) -> None:
    """`check_range` of wavelengths in nm; `of` names the table or formula that ends at `low` and `high`."""
    check_range("wavelength_nm", wavelength_nm, low, high, "nm", of)


def table_range(table_nm, values=None) -> tuple[float, float]:
    """Range of the wavelengths at which a table is known: between its ends, and beyond an end with the value 0.

    **Arguments:** `table_nm`, increasing along its last axis; `values` there, None if 0 at an end says nothing.
    **Returns:** two wavelengths, nm; those of `ALL_WAVELENGTHS` for a table that is traced.
    """
    low, high = ALL_WAVELENGTHS
    nodes, known = concrete(table_nm), concrete(values)
    if nodes is None or nodes.size == 0 or (values is not None and known is None):
        return low, high
    starts, ends = (known is None or bool(np.any(known[..., at] != 0.0)) for at in (0, -1))
    return float(nodes[..., 0].max()) if starts else low, float(nodes[..., -1].min()) if ends else high


def within(low: float, high: float, unit: str = "", hint: str = "") -> dict[str, tuple]:
    """The metadata of a field of a `Ranged` module whose concrete values must lie in [low, high]."""
    return {"range": (low, high, unit, hint)}


def radians_within(low: float, high: float) -> dict[str, tuple]:
    """`within` for an angle in radians."""
    return within(low, high, "rad", _IN_DEGREES)


def as_float_or_none(value):
    """`as_float` of a field that may be None."""
    return None if value is None else as_float(value)


class Ranged(eqx.Module):
    """A module that raises a `ValueError` when it is made with concrete values outside the ranges of its fields."""

    def __check_init__(self):
        for field in fields(self):
            if "range" in field.metadata:
                check_range(field.name, getattr(self, field.name), *field.metadata["range"])
