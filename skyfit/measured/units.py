"""The units that files spell, and their factors to the units of this package."""

import re


RADIANCE, IRRADIANCE, LUMINANCE = "W m-2 sr-1 nm-1", "W m-2 nm-1", "cd m-2"

_SPELLINGS = {
    "µ": "u",
    "μ": "u",
    "Å": "angstrom",
    "⁻": "-",
    "¹": "1",
    "²": "2",
    "³": "3",
    "·": " ",
    "⋅": " ",
    "−": "-",
    "**": "^",
    "*": " ",
    "[": "(",
    "]": ")",
}
_POWER = {
    **{"W": 1.0, "mW": 1e-3, "uW": 1e-6, "nW": 1e-9, "kW": 1e3},
    **{
        f"{prefix}{watt}": scale
        for prefix, scale in (("", 1.0), ("milli", 1e-3), ("micro", 1e-6), ("nano", 1e-9), ("kilo", 1e3))
        for watt in ("watt", "watts", "Watt", "Watts")
    },
}
_LENGTH = {
    "m": 1.0,
    "meter": 1.0,
    "metre": 1.0,
    "cm": 1e-2,
    "mm": 1e-3,
    "um": 1e-6,
    "micron": 1e-6,
    "micrometer": 1e-6,
    "micrometre": 1e-6,
    "nm": 1e-9,
    "nanometer": 1e-9,
    "nanometre": 1e-9,
    "angstrom": 1e-10,
    "Angstrom": 1e-10,
}
_PREFIX = {"": 1.0, "k": 1e3, "m": 1e-3}
_LUMINANCE = re.compile(r"([km]?)(?:(?:cd|candela)(?:[ .]*m\^?-2|[ ]*/[ (]*m\^?2\)?)|nits?)")
_ANGLE = ("sr", "steradian", "steradians", "ster")


def radiance_factor(units: str) -> float:
    """The factor that turns a spectral radiance in `units` into W m^-2 sr^-1 nm^-1.

    **Arguments** `units`: as spelled in a file, such as "W m-2 sr-1 nm-1", "mW/(m^2 sr nm)".

    **Returns** the factor, 1.0 for W m^-2 sr^-1 nm^-1.

    **Valid** power per area, solid angle and wavelength; anything else is a `ValueError`.
    """
    return _factor(units, RADIANCE)


def irradiance_factor(units: str) -> float:
    """The factor that turns a spectral irradiance in `units` into W m^-2 nm^-1, as `radiance_factor` does."""
    return _factor(units, IRRADIANCE)


def luminance_factor(units: str) -> float | None:
    """The factor that turns a luminance in `units` into cd m^-2; None where they are not of luminance."""
    match = _LUMINANCE.fullmatch(_spelled(units).strip())
    return None if match is None else _PREFIX[match[1]]


def _spelled(units):
    for old, new in _SPELLINGS.items():
        units = units.replace(old, new)
    return units


def _factor(units, wanted):
    text = _spelled(units)
    # "W.m-2.sr-1": a point between letters or digits is a product.
    text = re.sub(r"(?<=\w)\.(?=[A-Za-z])", " ", text)
    scale, power, length, solid = 1.0, 0, 0, 0
    for name, exponent in _factors(text, units, wanted):
        singular = name[:-1] if name.endswith("s") and name[:-1] in _LENGTH else name
        if name in _POWER:
            scale, power = scale * _POWER[name] ** exponent, power + exponent
        elif singular in _LENGTH:
            scale, length = scale * _LENGTH[singular] ** exponent, length + exponent
        elif name in _ANGLE:
            solid += exponent
        else:
            raise ValueError(f"expected units {wanted}, found {units!r}")
    if (power, length, solid) != (1, -3, -1 if wanted == RADIANCE else 0):
        raise ValueError(f"expected units {wanted}, found {units!r}")
    factor = scale / 1e9
    return 1.0 if abs(factor - 1.0) < 1e-12 else factor


def _factors(text, units, wanted):
    """(name, exponent) of each factor; a slash divides by the next factor, or by its bracket."""
    factors, sign, in_bracket, place = [], 1, False, 0
    text = text.strip()
    while place < len(text):
        letter = text[place]
        if letter.isspace():
            place += 1
        elif letter == "/":
            sign, place = -1, place + 1
        elif letter == "(" and not in_bracket:
            in_bracket, place = True, place + 1
        elif letter == ")" and in_bracket:
            in_bracket, sign, place = False, 1, place + 1
        else:
            match = re.compile(r"([A-Za-z]+)\s*\^?\s*([+-]?\d+)?").match(text, place)
            if match is None:
                raise ValueError(f"expected units {wanted}, found {units!r}")
            factors.append((match[1], sign * int(match[2] or 1)))
            place = match.end()
            if not in_bracket:
                sign = 1
    return factors


def is_radian(units: str) -> bool | None:
    """Whether `units` of an angle are radians (True), degrees (False) or something else (None)."""
    text = units.strip().lower()
    if text in ("rad", "radian", "radians"):
        return True
    if text == "" or text == "°" or text.startswith("deg"):
        return False
    return None


def is_nanometre(units: str) -> bool:
    """Whether `units` of a wavelength are nanometres."""
    return units.strip().lower() in ("nm", "nanometer", "nanometers", "nanometre", "nanometres")
