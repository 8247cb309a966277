"""Analytic skies as source code: compiled, run, and held against `sky.rgb`."""

import re
import shutil
import subprocess

import jax.numpy as jnp
import numpy as np
import pytest

import skyfit
from skyfit.records import evaluator, write_evaluator
from skyfit.records.evaluator import digits
from skyfit.scene import unit_vectors


SKIES = {"linear": skyfit.Preetham.published, "extended": skyfit.ExtendedPreetham.shipped}
# turbidities and suns of each, the edges of its range among them
CASES = {
    "linear": [(2.0, 0.0), (3.0, 50.0), (6.5, 80.0), (10.0, 90.0)],
    "extended": [(1.0, 0.0), (1.7, 88.0), (3.0, 50.0), (10.0, 92.0)],
}
# reads turbidity, sun, and of each view cos_theta and chord; writes red, green and blue
DRIVER = """
#include <stdio.h>
#include "sky.h"

int main(void) {
  float turbidity, sun, cos_theta, chord, frame[18], rgb[3];
  while (scanf("%f %f %f %f", &turbidity, &sun, &cos_theta, &chord) == 4) {
    skyfit_frame(turbidity, sun, frame);
    skyfit_rgb(frame, cos_theta, chord, rgb);
    printf("%.9g %.9g %.9g\\n", rgb[0], rgb[1], rgb[2]);
  }
  return 0;
}
"""


def views() -> np.ndarray:
    """Unit vectors from the zenith to the horizon, at and beside the sun's azimuth."""
    zenith, azimuth = np.meshgrid(np.radians([0.0, 20.0, 49.9, 50.0, 75.0, 89.0, 90.0]), np.radians([0, 0.2, 40, 180]))
    return np.asarray(unit_vectors(zenith.ravel(), azimuth.ravel()), np.float32)


def expected(form: str, turbidity: float, sun: np.ndarray) -> np.ndarray:
    return np.asarray(SKIES[form]().rgb(turbidity, jnp.asarray(sun), jnp.asarray(views())))


def sun_and_chord(degrees: float) -> tuple[np.ndarray, np.ndarray]:
    sun = np.asarray(unit_vectors(np.radians(degrees), 0.0), np.float32)
    return sun, np.sum((views() - sun[:, None]) ** 2, axis=0)


def compiled(text: str, folder, driver: str = DRIVER, *words: str) -> str:
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler on this machine")
    (folder / "sky.h").write_text(text)
    (folder / "main.c").write_text(driver)
    words = (compiler, "-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", *words, "main.c", "-o", "main", "-lm")
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return str(folder / "main")


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("form", SKIES)
def test_c_compiles_without_a_warning_and_gives_the_sky(form, precision, tmp_path):
    """In double precision as it stands, and with the arithmetic of a shader."""
    text, words = evaluator(SKIES[form](), "c"), ()
    if precision == "float":
        text, words = text.replace("math.h", "tgmath.h"), ("-fsingle-precision-constant",)
    program = compiled(text, tmp_path, DRIVER, *words)
    for turbidity, degrees in CASES[form]:
        sun, chord = sun_and_chord(degrees)
        lines = [f"{turbidity} {np.radians(degrees)} {z} {c}" for z, c in zip(views()[2], chord, strict=True)]
        out = subprocess.run([program], input="\n".join(lines), capture_output=True, text=True, check=True).stdout
        got, wanted = np.array(out.split(), float).reshape(-1, 3).T, expected(form, turbidity, sun)
        np.testing.assert_allclose(got, wanted, atol=1e-4 * np.abs(wanted).max())


def test_numbers_keep_their_digits_once_colour_is_loaded():
    """It has numpy print as in 2017."""
    import colour

    assert colour.__name__ and digits(np.float32(2.135593)) == "2.135593" and digits(np.float32(1.0)) == "1.0"


@pytest.mark.parametrize("form", SKIES)
def test_python_needs_numpy_alone_and_gives_the_sky(form):
    text = evaluator(SKIES[form](), "python")
    assert re.findall(r"^(?:import|from) .*", text, re.MULTILINE) == ["import numpy as np"]
    made: dict = {}
    exec(text, made)
    for turbidity, degrees in CASES[form]:
        sun, chord = sun_and_chord(degrees)
        got = made["skyfit_rgb"](made["skyfit_frame"](turbidity, np.radians(degrees)), views()[2], chord)
        wanted = expected(form, turbidity, sun)
        np.testing.assert_allclose(got, wanted, atol=1e-4 * np.abs(wanted).max())
    # beyond the range the edge's value holds
    thick, low = CASES[form][-1][0], np.radians(CASES[form][-1][1])
    np.testing.assert_allclose(made["skyfit_frame"](99.0, 2.0), made["skyfit_frame"](thick, low), rtol=1e-6)


@pytest.mark.parametrize("to", ["glsl", "hlsl"])
@pytest.mark.parametrize("form", SKIES)
def test_shaders_are_the_same_program_as_c(form, to):
    sky = SKIES[form]()
    c = evaluator(sky, "c").replace("#pragma once\n#include <math.h>\n\n", "").replace("static inline ", "")
    text = re.sub(r"// OpenGL ES: .*\n", "", evaluator(sky, to))
    plain = re.sub(r"const float (\w+)\[(\d+)\] = float\[\2\]\(([^)]*)\)", r"static const float \1[\2] = {\3}", text)
    assert plain.replace("out float ", "float ") == c
    # what GLSL does not have: functions of C's library, suffixes of numbers, integers where floats stand
    assert not re.search(r"\b(expf|fmin|fmax|math)\b|\d[fF]\b", text)


@pytest.mark.parametrize("to", ["glsl", "hlsl"])
@pytest.mark.parametrize("form", SKIES)
def test_shaders_compile(form, to, tmp_path):
    validator = shutil.which("glslangValidator")
    if validator is None:
        pytest.skip("no glslangValidator (Debian's glslang-tools) on this machine")
    path = tmp_path / f"sky.{'frag' if to == 'glsl' else 'hlsl'}"
    path.write_text(SHADER[to].replace("@sky@", evaluator(SKIES[form](), to)))
    words = [validator, *(() if to == "glsl" else ("-D", "-S", "frag", "-e", "main", "-V")), str(path)]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


SHADER = {
    "glsl": """#version 300 es
precision highp float;
@sky@
in vec3 view;
uniform vec3 sun;
out vec4 color;
void main() {
  float frame[18];
  float rgb[3];
  skyfit_frame(3.0, acos(sun.z), frame);
  vec3 away = view - sun;
  skyfit_rgb(frame, view.z, dot(away, away), rgb);
  color = vec4(rgb[0], rgb[1], rgb[2], 1.0);
}
""",
    "hlsl": """
@sky@
float4 main(float3 view : TEXCOORD0, float3 sun : TEXCOORD1) : SV_Target {
  float frame[18];
  float rgb[3];
  skyfit_frame(3.0, acos(sun.z), frame);
  float3 away = view - sun;
  skyfit_rgb(frame, view.z, dot(away, away), rgb);
  return float4(rgb[0], rgb[1], rgb[2], 1.0);
}
""",
}


@pytest.mark.parametrize("form", SKIES)
def test_one_sky_is_eighteen_numbers_and_the_value_in_the_file_is_right(form):
    turbidity, degrees = CASES[form][1]
    for one in (True, False):
        given = {"turbidity": turbidity, "sun_zenith": np.radians(degrees)} if one else {}
        text = evaluator(SKIES[form](), "python", **given)
        made: dict = {}
        exec(text, made)
        tested = re.search(r"cos_theta (\S+), chord (\S+) is\n# (.*)$", text)
        assert tested is not None
        frame = made["SKYFIT_FRAME"] if one else made["skyfit_frame"](3.0, np.radians(50.0))
        assert np.size(frame) == 18 and ("skyfit_frame" in made) != one
        got = made["skyfit_rgb"](frame, float(tested[1]), float(tested[2]))
        np.testing.assert_allclose(got, [float(word) for word in tested[3].split(", ")], rtol=1e-4)


def test_one_sky_in_c_takes_its_own_numbers(tmp_path):
    text = evaluator(skyfit.ExtendedPreetham.shipped(), "c", turbidity=2.5, sun_zenith=1.0)
    tested = re.search(r"cos_theta (\S+), chord (\S+) is\n// (.*)$", text)
    assert tested is not None
    call = f"skyfit_rgb(SKYFIT_FRAME, {tested[1]}, {tested[2]}, rgb)"
    driver = f"""
#include <stdio.h>
#include "sky.h"

int main(void) {{
  float rgb[3];
  {call};
  printf("%.9g, %.9g, %.9g", rgb[0], rgb[1], rgb[2]);
  return 0;
}}
"""
    out = subprocess.run([compiled(text, tmp_path, driver)], capture_output=True, text=True, check=True).stdout
    got, wanted = ([float(word) for word in words.split(", ")] for words in (out, tested[3]))
    np.testing.assert_allclose(got, wanted, rtol=1e-5)


def test_the_value_to_test_lies_within_the_range_of_a_narrow_fit():
    whole = skyfit.Preetham.published()
    narrow = skyfit.Preetham(
        whole.distribution, whole.zenith_luminance, whole.zenith_chromaticity, lowest_turbidity=4.0,
        fitted_turbidity=(4.0, 6.0), lowest_sun=float(np.radians(40.0)),
    )  # fmt: skip
    made: dict = {}
    text = evaluator(narrow, "python")
    exec(text, made)
    tested = re.search(r"turbidity (\S+), sun_zenith (\S+), cos_theta (\S+), chord (\S+) is\n# (.*)$", text)
    assert tested is not None and float(tested[1]) == 4.0
    frame = made["skyfit_frame"](float(tested[1]), float(tested[2]))
    got = made["skyfit_rgb"](frame, float(tested[3]), float(tested[4]))
    np.testing.assert_allclose(got, [float(word) for word in tested[5].split(", ")], rtol=1e-4)


def test_what_has_no_evaluator_is_refused(tmp_path):
    sky = skyfit.ExtendedPreetham.shipped()
    for change, part in (
        ({"to": "wgsl"}, "glsl"),
        ({"turbidity": 3.0}, "together"),
        ({"turbidity": 30.0, "sun_zenith": 0.5}, "turbidity"),
        ({"turbidity": 3.0, "sun_zenith": 2.5}, "sun_zenith"),
        ({"sky": skyfit.CIEClear()}, "CIEClear"),
    ):
        with pytest.raises((ValueError, TypeError), match=part) as caught:
            evaluator(**({"sky": sky, "to": "c"} | change))
        assert "\n" not in str(caught.value) or "WGSL" in str(caught.value).upper()
    with pytest.raises(ValueError, match="there/sky.h"):
        write_evaluator(sky, tmp_path / "not" / "there" / "sky.h", "c")


def test_the_command_writes_a_refitted_sky(skyfit_command, tmp_path):
    done = skyfit_command("export", "extended", "--to", "c", "--out", "sky.h", cwd=tmp_path)
    assert "lines of c" in done.stdout
    assert (tmp_path / "sky.h").read_text() == evaluator(skyfit.ExtendedPreetham.shipped(), "c")
    for words, part in (
        (("export", "nothing.json", "--to", "c", "--out", "x.h"), "nothing.json"),
        (("export", "extended", "--to", "c", "--out", "x.h", "--turbidity", 3), "together"),
        (("export", "extended", "--to", "c", "--out", "no/x.h"), "--out"),
        (("export", "published", "--to", "c", "--out", "x.h", "--turbidity", 3, "--sun-zenith", 95), "0 and 90"),
        (("export", "extended", "--to", "c", "--out", "x.h", "--height", 5), "`--height` must be left out"),
        (("export", "extended", "--to", "lut", "--out", "x", "--sun-zenith", 60), "spherical, or the file"),
    ):
        refused = skyfit_command(*words, cwd=tmp_path, check=False)
        assert refused.returncode == 2 and part in refused.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["sky.h"]
