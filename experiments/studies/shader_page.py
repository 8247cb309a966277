"""A sky drawn by a browser's shader, that `skyfit export --to glsl` wrote, beside the same sky by `sky.rgb`.

    python -m experiments.studies.shader_page

Needs chromium. A page with WebGL 2 draws the dome by the exported functions in float32 on the graphics stack of
SwiftShader, and a headless chromium takes its picture. Writes experiments/results/shader_page.png, the browser's on the
left, and experiments/results/shader_page.json: how far apart they are, in steps of 8 bits.
"""

import json
import shutil
import subprocess
import tempfile
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import PIL.Image

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from skyfit.light import srgb_from_linear
from skyfit.records import evaluator
from skyfit.scene import fisheye, unit_vectors


RESULT, PICTURE = HERE / "results" / "shader_page.json", HERE / "results" / "shader_page.png"
SIZE, TURBIDITY, SUN, AZIMUTH, WHITE = 256, 3.0, np.radians(70.0), np.radians(200.0), 20000.0
PAGE = """<!doctype html><body style="margin:0"><canvas id="sky" width="@size@" height="@size@"></canvas><script>
const vertex = `#version 300 es
in vec2 place; void main() { gl_Position = vec4(place, 0.0, 1.0); }`;
const fragment = `#version 300 es
precision highp float;
@evaluator@
out vec4 pixel;
void main() {
  vec2 p = gl_FragCoord.xy / @half@ - 1.0;
  float r = length(p);
  if (r > 1.0) { pixel = vec4(0.0, 0.0, 0.0, 1.0); return; }
  float theta = r * 1.5707963267948966;
  vec3 view = vec3(p / max(r, 1e-9) * sin(theta), cos(theta));
  vec3 away = view - vec3(@sun@);
  float frame[18];
  skyfit_frame(@turbidity@, @sun_zenith@, frame);
  float rgb[3];
  skyfit_rgb(frame, view.z, dot(away, away), rgb);
  vec3 c = clamp(vec3(rgb[0], rgb[1], rgb[2]) / @white@, 0.0, 1.0);
  pixel = vec4(mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c)), 1.0);
}`;
const gl = document.getElementById("sky").getContext("webgl2", {preserveDrawingBuffer: true});
const program = gl.createProgram();
for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
  const shader = gl.createShader(kind);
  gl.shaderSource(shader, text); gl.compileShader(shader);
  if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) document.body.innerText = gl.getShaderInfoLog(shader);
  gl.attachShader(program, shader);
}
gl.linkProgram(program); gl.useProgram(program);
gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 3, -1, -1, 3]), gl.STATIC_DRAW);
gl.enableVertexAttribArray(0); gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
gl.drawArrays(gl.TRIANGLES, 0, 3);
</script></body>
"""


def by_browser() -> np.ndarray:
    """The page as chromium shows it, `[row, column, 3]`, 8 bits."""
    words = {
        "size": str(SIZE), "half": f"{0.5 * SIZE:.1f}",
        "evaluator": evaluator(skyfit.ExtendedPreetham.shipped(), "glsl"),
        "sun": ", ".join(f"{v:.9f}" for v in np.asarray(unit_vectors(SUN, AZIMUTH))), "white": f"{WHITE:.1f}",
        "turbidity": f"{TURBIDITY:.6f}", "sun_zenith": f"{SUN:.9f}",
    }  # fmt: skip
    page = PAGE
    for word, value in words.items():
        page = page.replace(f"@{word}@", value)
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        raise SystemExit("no chromium on this machine")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "page.html").write_text(page)
        subprocess.run(
            [
                browser, "--headless", "--no-sandbox", "--hide-scrollbars", "--use-angle=swiftshader",
                "--enable-unsafe-swiftshader", "--force-color-profile=srgb", f"--user-data-dir={folder / 'profile'}",
                f"--window-size={SIZE},{SIZE + 200}", "--virtual-time-budget=5000",
                f"--screenshot={folder / 'page.png'}", (folder / "page.html").as_uri(),
            ],
            check=True, capture_output=True, timeout=120,
        )  # fmt: skip
        return np.asarray(PIL.Image.open(folder / "page.png").convert("RGB"))[:SIZE, :SIZE]


def by_skyfit() -> np.ndarray:
    """The same dome by `sky.rgb`."""
    view = fisheye(SIZE)
    light = skyfit.ExtendedPreetham.shipped().rgb(TURBIDITY, unit_vectors(SUN, AZIMUTH), view)
    encoded = srgb_from_linear(jnp.clip(light / WHITE, 0.0, 1.0))
    return np.asarray(np.round(255.0 * np.moveaxis(np.asarray(encoded), 0, -1)), np.uint8)


def main() -> None:
    theirs, ours = by_browser(), by_skyfit()
    PIL.Image.fromarray(np.concatenate([theirs, ours], axis=1)).save(PICTURE)
    inside = ours.max(axis=2) > 0
    apart = np.abs(theirs.astype(int) - ours.astype(int))[inside]
    told = made_with(0) | {
        "size": SIZE, "largest_step_of_8_bits": int(apart.max()), "share_that_differs": float(np.mean(apart > 0)),
    }  # fmt: skip
    print(told)
    RESULT.write_text(json.dumps(told, indent=1) + "\n")


if __name__ == "__main__":
    main()
