"""Values out of range, refused where they can be seen: what jit, vmap and grad trace is left alone."""

from dataclasses import fields

import equinox as eqx
import numpy as np
from jax.core import Tracer
from jaxtyping import Float

from .dtype import as_float


def concrete(value) -> Float[np.ndarray, "..."] | None:
    """The numbers of an argument; None where it is traced, or a placeholder of a tree without numbers."""
    if isinstance(value, Tracer):
        return None
    try:
        return np.asarray(value, np.float64)
    except (TypeError, ValueError):
        return None


def check_range(name: str, value, low: float, high: float, unit: str = "", hint: str = "") -> None:
    """A `ValueError` that names the argument, unless every number of it lies in [low, high].

    **Arguments:** `name` as the caller wrote it; `value`, a number or an array: traced values pass unseen;
    `low`, `high`, infinite where that side is open; `unit` and `hint` for the message.
    """
    known = concrete(value)
    if known is None:
        return
    outside = ~((known >= low) & (known <= high))
    if not np.any(outside):
        return
    unit = unit and f" {unit}"
    if not np.isfinite(high):
        wanted = f"at least {low:g}{unit}" if np.isfinite(low) else "finite"
    else:
        wanted = f"between {low:g} and {high:g}{unit}" if np.isfinite(low) else f"at most {high:g}{unit}"
    raise ValueError(f"`{name}` must be {wanted}, got {float(known[outside].flat[0]):g}{hint and f' ({hint})'}")


def ranged(low: float, high: float, unit: str = "", **known):
    """A float field of a `Ranged` module, whose concrete values must lie in [low, high]; `known` as of `eqx.field`."""
    return eqx.field(converter=as_float, metadata={"range": (low, high, unit)}, **known)


class Ranged(eqx.Module):
    """A module that refuses concrete values outside the ranges of its fields when it is made: `ValueError`."""

    def __check_init__(self):
        for field in fields(self):
            if "range" in field.metadata:
                check_range(field.name, getattr(self, field.name), *field.metadata["range"])
