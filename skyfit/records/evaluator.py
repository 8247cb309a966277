"""Write analytic skies as self-contained source code for shaders and engines: formula, numbers, one value to test.

GLSL (ES 3.00 and desktop 3.30), HLSL and C share one text, written in the subset that the three languages have in
common. Python has its own text, which needs only numpy. A sky becomes two functions. The first computes 18 numbers from
turbidity and sun, once per frame. The second computes the light of each pixel from these. For one sky only the 18
numbers are written.
"""

import math
from pathlib import Path
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np

from ..analytic import AbstractAnalyticSky, ExtendedPreetham, Preetham
from ..analytic.extended import CORNER, LOWEST_TERM, STEEPEST, SUN_ZENITH_RANGE_DEG, TURBIDITY_RANGE
from ..analytic.perez import LARGEST_EXPONENT, LOWEST_COSINE
from ..analytic.pixels import ARCSINE
from ..analytic.preetham import LARGEST_CHI
from ..light import SMALLEST_Y, SRGB_FROM_XYZ
from ..measured import atomic
from ..scene import unit_vectors


Language = Literal["glsl", "hlsl", "c", "python"]
# the point of the value to test: turbidity, and degrees of the sun's zenith, the view's zenith, and between azimuths
_TESTED = (3.0, 50.0, 70.0, 40.0)


class _Dialect(NamedTuple):
    """The differences of a language: comments, its first line, a table's beginning and end, functions, results."""

    comment: str
    first: str
    table: str
    end: str
    function: str
    result: str


_DIALECTS = {
    "glsl": _Dialect("//", "", "const float @name@[@count@] = float[@count@](", ");", "", "out float"),
    "hlsl": _Dialect("//", "", "static const float @name@[@count@] = {", "};", "", "out float"),
    "c": _Dialect(
        "//",
        "#pragma once\n#include <math.h>\n",
        "static const float @name@[@count@] = {",
        "};",
        "static inline ",
        "float",
    ),
    "python": _Dialect("#", "import numpy as np\n", "@name@ = np.array([", "])", "", ""),
}


def write_evaluator(
    sky: AbstractAnalyticSky,
    path: str | Path,
    to: Language,
    *,
    turbidity: float | None = None,
    sun_zenith: float | None = None,
) -> None:
    """Write source code that evaluates an analytic sky without skyfit.

    **Arguments:** `sky`, `Preetham` or `ExtendedPreetham`; `path` of the file; `to`: "glsl", "hlsl", "c" or "python";
    `turbidity` and `sun_zenith` (rad), given together, select one sky: the 18 numbers of a frame, without the table.
    **Errors:** `ValueError` for another sky or language, a turbidity or sun for which the sky has no answer, and a file
    that cannot be written.
    **Valid:** above the horizon and within the range of the fit; turbidity and sun are clipped to it. There the light
    is within 1e-4 of the largest component of `sky.rgb`, in float32 too (tests). Below the horizon it is the horizon's.
    """
    text = evaluator(sky, to, turbidity=turbidity, sun_zenith=sun_zenith)
    with atomic(Path(path)) as temporary:
        temporary.write_text(text, encoding="ascii")


def evaluator(
    sky: AbstractAnalyticSky, to: Language, *, turbidity: float | None = None, sun_zenith: float | None = None
) -> str:
    """The text that `write_evaluator` writes, from the same arguments."""
    if to not in _DIALECTS:
        raise ValueError(f"`to` must be one of {', '.join(_DIALECTS)}, got {to!r}")
    if not isinstance(sky, Preetham | ExtendedPreetham):
        raise ValueError(f"`sky` must be Preetham or ExtendedPreetham, got {type(sky).__name__}")
    if (turbidity is None) != (sun_zenith is None):
        raise ValueError("`turbidity` and `sun_zenith` must be given together, of one sky, or left out")
    haze, degrees, view, around = _TESTED
    (low, high), (highest, lowest) = sky.fitted_turbidity, sky.fitted_sun
    haze, sun, one = min(max(haze, low), high), min(max(math.radians(degrees), highest), lowest), False
    if turbidity is not None and sun_zenith is not None:
        haze, sun, one = float(turbidity), float(sun_zenith), True
    sky.check_range(haze, sun)
    dialect, python = _DIALECTS[to], to == "python"
    parts = [_head(sky, to, one, haze, sun), dialect.first]
    if one:
        parts.append(_table(dialect, "SKYFIT_FRAME", sky.frame(haze, sun)))
    elif isinstance(sky, Preetham):
        parts += [
            _table(dialect, "SKYFIT_DISTRIBUTION", sky.distribution),
            _table(dialect, "SKYFIT_ZENITH_LUMINANCE", sky.zenith_luminance),
            _table(dialect, "SKYFIT_ZENITH_CHROMATICITY", sky.zenith_chromaticity),
        ]
    else:
        parts.append(_table(dialect, "SKYFIT_COEFFICIENTS", sky.coefficients))
    shared, own = (_PYTHON, _PYTHON_FRAME) if python else (_SHADER, _SHADER_FRAME)
    parts.append(shared["perez"])
    if not one:
        parts.append(own["linear" if isinstance(sky, Preetham) else "extended"])
    parts.append(shared["light"])
    body = ("\n\n" if python else "\n").join(part.strip("\n") + "\n" for part in parts if part)
    for word, value in (_numbers(sky) | dialect._asdict()).items():
        body = body.replace(f"@{word}@", value)
    value = _rgb(sky, haze, sun, math.radians(view), math.radians(around))
    what = "SKYFIT_FRAME" if one else f"the frame of turbidity {haze:g}, sun_zenith {sun:.9g}"
    away = _chord(sun, math.radians(view), math.radians(around))
    test = (
        f"To test it: skyfit_rgb of {what}, cos_theta {math.cos(math.radians(view)):.9g}, chord {away:.9g} is\n"
        f"{value[0]:.7g}, {value[1]:.7g}, {value[2]:.7g}"
    )
    comment = "\n".join(f"{dialect.comment} {line}" for line in test.splitlines())
    return f"{body}\n{comment}\n"


def _head(sky: Preetham | ExtendedPreetham, to: Language, one: bool, haze: float, sun: float) -> str:
    """The head of the file, in comments."""
    low, high = sky.fitted_turbidity
    highest, lowest = sky.fitted_sun
    of = f"at turbidity {haze:g} with the sun {math.degrees(sun):g} degrees from the zenith" if one else "of any sun"
    lines = [
        f"A clear sky {of}: {type(sky).__name__}, written by skyfit.",
        "Light is in cd m^-2: linear sRGB in which white of that luminance has three equal values; not clipped.",
        "cos_theta: z of the view, a unit vector with z up; the sky's lower edge goes on below the horizon.",
        "chord: squared distance of the unit vectors of view and sun, dot(view - sun, view - sun).",
        "frame: of Y (cd m^-2), x and y, each A, B, C, D, E and the zenith's value over F there, where",
        "F = (1 + A exp(B / cos_theta)) (1 + C exp(D gamma) + E cos(gamma)^2), gamma the angle from the sun.",
    ]
    if not one:
        lines.append(
            f"turbidity {low:g} to {high:g}, sun_zenith {highest:g} to {lowest:.6g} rad: beyond, as at its edge."
        )
    if to == "glsl":
        lines.append("OpenGL ES: after #version 300 es and precision highp float;")
    lines.append("Preetham, Shirley & Smits 1999, eq. 3, 4 and A.2; Perez, Seals & Michalsky 1993, eq. 1.")
    return "\n".join(f"@comment@ {line}" for line in lines)


def digits(value: np.floating) -> str:
    """As few digits as restore a number, with a point. `str` has fewer once colour-science is loaded."""
    return np.format_float_positional(value, unique=True, trim="0")


def _table(dialect: _Dialect, name: str, values) -> str:
    """The numbers of a table in their order in memory, eight to a line."""
    flat = np.asarray(values).ravel()
    words = [digits(value) for value in flat]
    lines = [", ".join(words[first : first + 8]) for first in range(0, flat.size, 8)]
    start = dialect.table.replace("@name@", name).replace("@count@", str(flat.size))
    return start + "\n  " + ",\n  ".join(lines) + dialect.end


def _numbers(sky: Preetham | ExtendedPreetham) -> dict[str, str]:
    """The numbers in the text, by name."""
    low, high = sky.fitted_turbidity
    first, last = sky.fitted_sun
    found = {
        "thin": low, "thick": high, "highest": first, "lowest": last, "cosine": LOWEST_COSINE,
        "exponent": LARGEST_EXPONENT, "smallest_y": SMALLEST_Y, "chi": LARGEST_CHI, "pi": math.pi,
        "from": math.log(TURBIDITY_RANGE[0]), "across": math.log(TURBIDITY_RANGE[1] / TURBIDITY_RANGE[0]),
        "down": math.radians(SUN_ZENITH_RANGE_DEG[1]), "term": LOWEST_TERM, "corner": CORNER**2, "steepest": STEEPEST,
    }  # fmt: skip
    words = {name: repr(float(value)) for name, value in found.items()}
    words |= {f"m{i}{j}": repr(float(SRGB_FROM_XYZ[i, j])) for i in range(3) for j in range(3)}
    words["arcsine"] = _horner(ARCSINE)
    if isinstance(sky, ExtendedPreetham):
        words |= {"rows": str(sky.coefficients.shape[2]), "columns": str(sky.coefficients.shape[3])}
    return words


def _horner(coefficients: tuple[float, ...]) -> str:
    """Statements that evaluate `arc`, a polynomial in m, from its highest power on."""
    first, *others = (f"{value:.9g}" for value in coefficients)
    return "\n  ".join([f"float arc = {first};", *(f"arc = arc * m + {word};" for word in others)]).replace("+ -", "- ")


def _chord(sun: float, view: float, around: float) -> float:
    """The squared distance of two unit vectors, from their zenith angles and the azimuth between them."""
    return float(np.sum((unit_vectors(sun, 0.0) - unit_vectors(view, around)) ** 2))


def _rgb(sky: AbstractAnalyticSky, turbidity: float, sun_zenith: float, view: float, around: float) -> np.ndarray:
    """The value that skyfit itself computes."""
    light = sky.rgb(turbidity, unit_vectors(sun_zenith, 0.0), jnp.asarray(unit_vectors(view, around))[:, None])
    return np.asarray(light)[:, 0]


_SHADER = {
    "perez": """
@function@float skyfit_perez(float a, float b, float c, float d, float e, float cos_theta, float chord) {
  float height = cos_theta > @cosine@ ? cos_theta : @cosine@;
  float m = chord < 2.0 ? 0.25 * chord : 1.0 - 0.25 * chord;
  m = m > 0.0 ? m : 0.0;
  // arcsin(sqrt(m)) / sqrt(m)
  @arcsine@
  float away = 2.0 * sqrt(m) * arc;
  float turn = d * (chord < 2.0 ? away : @pi@ - away);
  float slant = b / height;
  float cosine = 1.0 - 0.5 * chord;
  float horizon = 1.0 + a * exp(slant < @exponent@ ? slant : @exponent@);
  return horizon * (1.0 + c * exp(turn < @exponent@ ? turn : @exponent@) + e * cosine * cosine);
}
""",
    "light": """
@function@void skyfit_xyz(const float frame[18], float cos_theta, float chord, @result@ xyz[3]) {
  float seen[3];
  for (int q = 0; q < 3; q++) {
    int i = 6 * q;
    seen[q] = frame[i + 5] * skyfit_perez(
      frame[i], frame[i + 1], frame[i + 2], frame[i + 3], frame[i + 4], cos_theta, chord);
  }
  float luminance = seen[0] > 0.0 ? seen[0] : 0.0;
  float total = luminance / (seen[2] > @smallest_y@ ? seen[2] : @smallest_y@);
  xyz[0] = seen[1] * total;
  xyz[1] = luminance;
  xyz[2] = total - xyz[0] - luminance;
}

@function@void skyfit_rgb(const float frame[18], float cos_theta, float chord, @result@ rgb[3]) {
  float xyz[3];
  skyfit_xyz(frame, cos_theta, chord, xyz);
  rgb[0] = @m00@ * xyz[0] + (@m01@) * xyz[1] + (@m02@) * xyz[2];
  rgb[1] = @m10@ * xyz[0] + (@m11@) * xyz[1] + (@m12@) * xyz[2];
  rgb[2] = @m20@ * xyz[0] + (@m21@) * xyz[1] + (@m22@) * xyz[2];
}
""",
}
_SHADER_FRAME = {
    "linear": """
@function@float skyfit_within(float value, float low, float high) {
  return value < low ? low : (value > high ? high : value);
}

@function@void skyfit_frame(float turbidity, float sun_zenith, @result@ frame[18]) {
  float haze = skyfit_within(turbidity, @thin@, @thick@);
  float sun = skyfit_within(sun_zenith, @highest@, @lowest@);
  for (int q = 0; q < 3; q++) {
    for (int k = 0; k < 5; k++) {
      int i = 2 * (5 * q + k);
      frame[6 * q + k] = SKYFIT_DISTRIBUTION[i] * haze + SKYFIT_DISTRIBUTION[i + 1];
    }
  }
  float part[3];
  for (int k = 0; k < 3; k++) {
    part[k] = SKYFIT_ZENITH_LUMINANCE[2 * k] * haze + SKYFIT_ZENITH_LUMINANCE[2 * k + 1];
  }
  float chi = skyfit_within(part[2] * (@pi@ - 2.0 * sun), -@chi@, @chi@);
  frame[5] = 1000.0 * (part[0] * tan(chi) + part[1]);
  for (int q = 0; q < 2; q++) {
    float value = 0.0;
    for (int k = 0; k < 3; k++) {
      float cubic = 0.0;
      for (int n = 0; n < 4; n++) {
        cubic = cubic * sun + SKYFIT_ZENITH_CHROMATICITY[12 * q + 4 * k + n];
      }
      value = value * haze + cubic;
    }
    frame[6 * q + 11] = value;
  }
  float chord = 2.0 - 2.0 * cos(sun);
  for (int q = 0; q < 3; q++) {
    int i = 6 * q;
    frame[i + 5] /= skyfit_perez(frame[i], frame[i + 1], frame[i + 2], frame[i + 3], frame[i + 4], 1.0, chord);
  }
}
""",
    "extended": """
@function@float skyfit_within(float value, float low, float high) {
  return value < low ? low : (value > high ? high : value);
}

// a smooth map of all numbers to those above @term@
@function@float skyfit_above(float value) {
  return @term@ + 0.5 * (value + sqrt(value * value + @corner@));
}

// each of six numbers u of Y, x and y is a Chebyshev series in the logarithm of turbidity and the sun's angle squared
@function@void skyfit_frame(float turbidity, float sun_zenith, @result@ frame[18]) {
  float haze = skyfit_within(turbidity, @thin@, @thick@);
  float sun = skyfit_within(sun_zenith, @highest@, @lowest@);
  float place = 2.0 * (log(haze) - @from@) / @across@ - 1.0;
  float low = 2.0 * (sun / @down@) * (sun / @down@) - 1.0;
  float rows[@rows@];
  float columns[@columns@];
  rows[0] = 1.0;
  rows[1] = place;
  for (int i = 2; i < @rows@; i++) {
    rows[i] = 2.0 * place * rows[i - 1] - rows[i - 2];
  }
  columns[0] = 1.0;
  columns[1] = low;
  for (int j = 2; j < @columns@; j++) {
    columns[j] = 2.0 * low * columns[j - 1] - columns[j - 2];
  }
  for (int q = 0; q < 3; q++) {
    float u[6];
    for (int k = 0; k < 6; k++) {
      u[k] = 0.0;
      for (int i = 0; i < @rows@; i++) {
        for (int j = 0; j < @columns@; j++) {
          u[k] += SKYFIT_COEFFICIENTS[((6 * q + k) * @rows@ + i) * @columns@ + j] * rows[i] * columns[j];
        }
      }
    }
    float steep = exp(u[1] < @steepest@ ? u[1] : @steepest@);
    float a = (exp(u[0]) - 1.0) * exp(steep);
    float c = skyfit_above(u[2]);
    float d = -exp(u[3] < @steepest@ ? u[3] : @steepest@);
    float e = skyfit_above(u[4]);
    frame[6 * q] = a;
    frame[6 * q + 1] = -steep;
    frame[6 * q + 2] = c;
    frame[6 * q + 3] = d;
    frame[6 * q + 4] = e;
    frame[6 * q + 5] = exp(u[5]) / skyfit_perez(a, -steep, c, d, e, 1.0, 2.0 - 2.0 * cos(sun));
  }
}
""",
}
_PYTHON = {
    "perez": '''
def skyfit_perez(coefficients, cos_theta, chord):
    """F of A, B, C, D, E, in directions."""
    a, b, c, d, e = coefficients
    angle = 2.0 * np.arcsin(np.minimum(0.5 * np.sqrt(chord), 1.0))
    horizon = 1.0 + a * np.exp(np.minimum(b / np.maximum(cos_theta, @cosine@), @exponent@))
    return horizon * (1.0 + c * np.exp(np.minimum(d * angle, @exponent@)) + e * np.cos(angle) ** 2)
''',
    "light": '''
def skyfit_xyz(frame, cos_theta, chord):
    """X, Y, Z in directions, first axis, cd m^-2."""
    rows = np.reshape(frame, (3, 6))
    luminance, x, y = (row[5] * skyfit_perez(row[:5], cos_theta, chord) for row in rows)
    luminance = np.maximum(luminance, 0.0)
    total = luminance / np.maximum(y, @smallest_y@)
    return np.stack([x * total, luminance, total - x * total - luminance])


def skyfit_rgb(frame, cos_theta, chord):
    """Linear sRGB in directions, first axis, cd m^-2."""
    matrix = np.array([[@m00@, @m01@, @m02@], [@m10@, @m11@, @m12@], [@m20@, @m21@, @m22@]])
    return np.tensordot(matrix, skyfit_xyz(frame, cos_theta, chord), axes=1)
''',
}
_PYTHON_FRAME = {
    "linear": '''
def skyfit_frame(turbidity, sun_zenith):
    """The 18 numbers of a sky."""
    haze, sun = np.clip(turbidity, @thin@, @thick@), np.clip(sun_zenith, @highest@, @lowest@)
    coefficients = np.reshape(SKYFIT_DISTRIBUTION, (3, 5, 2)) @ [haze, 1.0]
    tangent, offset, angle = np.reshape(SKYFIT_ZENITH_LUMINANCE, (3, 2)) @ [haze, 1.0]
    chi = np.clip(angle * (@pi@ - 2.0 * sun), -@chi@, @chi@)
    cubic = np.reshape(SKYFIT_ZENITH_CHROMATICITY, (2, 3, 4)) @ [sun**3, sun**2, sun, 1.0]
    zenith = [1000.0 * (tangent * np.tan(chi) + offset), *(cubic @ [haze**2, haze, 1.0])]
    scale = [value / skyfit_perez(row, 1.0, 2.0 - 2.0 * np.cos(sun)) for value, row in zip(zenith, coefficients)]
    return np.concatenate([coefficients, np.array(scale)[:, None]], axis=1).ravel()
''',
    "extended": '''
def skyfit_frame(turbidity, sun_zenith):
    """The 18 numbers of a sky, by Chebyshev series in the logarithm of turbidity and the sun's angle squared."""
    haze, sun = np.clip(turbidity, @thin@, @thick@), np.clip(sun_zenith, @highest@, @lowest@)
    place = 2.0 * (np.log(haze) - @from@) / @across@ - 1.0
    low = 2.0 * (sun / @down@) ** 2 - 1.0
    table = np.reshape(SKYFIT_COEFFICIENTS, (3, 6, @rows@, @columns@))
    frame = np.empty((3, 6))
    for row, series in zip(frame, table):
        u = np.polynomial.chebyshev.chebval2d(place, low, np.moveaxis(series, 0, -1))
        steep = np.exp(min(u[1], @steepest@))
        above = @term@ + 0.5 * (u + np.sqrt(u**2 + @corner@))
        row[:5] = np.expm1(u[0]) * np.exp(steep), -steep, above[2], -np.exp(min(u[3], @steepest@)), above[4]
        row[5] = np.exp(u[5]) / skyfit_perez(row[:5], 1.0, 2.0 - 2.0 * np.cos(sun))
    return frame.ravel()
''',
}
