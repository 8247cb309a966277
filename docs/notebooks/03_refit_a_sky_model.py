# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Refit a sky model to air of your own
#
# Preetham's formula gives the colour of a sky from turbidity and sun, fast enough for every pixel of every frame. Its
# published coefficients are those of one haze, and about twice too bright. Here they are fitted anew, to the haze of
# your choice, and written as a shader.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import skyfit

# %% [markdown]
# ## An atmosphere that depends on turbidity
#
# Any function from turbidity to an `Atmosphere` will do. This one is dusty: it scatters forward more strongly than
# the usual haze, depends less on wavelength, and lies higher.


# %%
def dusty(turbidity):
    return skyfit.Atmosphere.from_turbidity(
        turbidity,
        phase=skyfit.HenyeyGreenstein(0.75),
        angstrom_exponent=0.4,
        single_scattering_albedo=0.93,
        profile=skyfit.Exponential(2000.0),
    )


# %% [markdown]
# ## The fit
#
# `refit` simulates a sky for every pair of sun and turbidity, fits all coefficients to all of them, and tests the
# result on skies that it has not seen. The defaults are 12 suns, 5 turbidities and 343 directions; this page takes
# fewer.

# %%
solver = skyfit.OrdersOfScattering.draft("flat")
result = skyfit.refit(
    solver, dusty, sun_zenith_deg=[0, 25, 45, 60, 72, 80], turbidity=[2, 3, 4.5, 6], directions=120, held_out=12
)
print(result.result)
for name, errors in result.held_out.overall.items():
    print(f"{name:10}  luminance off by {100 * errors.luminance:5.1f} % in the median")

# %% [markdown]
# *published*: the coefficients of 1999. *refitted*: these. *best five*: the formula fitted to each sky by itself,
# which is all that it can do. `form="extended"` does better: its coefficients follow turbidity and sun more freely.
#
# ## Into a shader
#
# `write_evaluator` writes GLSL, HLSL, C or Python, without any need for skyfit.

# %%
Path("build").mkdir(exist_ok=True)
skyfit.records.write_coefficients(result, "build/coefficients.json", {"haze": "dusty"})
skyfit.records.write_evaluator(result.refitted, "build/sky.glsl", "glsl")
print("\n".join(Path("build/sky.glsl").read_text().splitlines()[:12]))

# %% [markdown]
# ## Side by side

# %%
view = skyfit.hemisphere(400, np.radians(88))
colours = np.arange(380, 781, 20)
rows = []
for turbidity, sun in ((2.5, 40), (5, 70)):
    scene = skyfit.Scene.from_degrees(sun, view, colours, 180)
    skies = {
        "simulated": skyfit.xyz(solver.radiance(dusty(turbidity), scene), colours),
        "published": skyfit.Preetham.published().xyz(turbidity, scene),
        "refitted": result.refitted.xyz(turbidity, scene),
    }
    rows.append((f"turbidity {turbidity}, sun at {sun}°", skies))
skyfit.draw.plot_skies(view, rows, "build/skies.png", [(np.radians(sun), np.pi) for sun in (40, 70)])
figure, axes = plt.subplots(figsize=(12, 5.4), layout="constrained")
axes.imshow(plt.imread("build/skies.png"))
axes.axis("off")
plt.show()

# %% [markdown]
# *The simulated sky, the published model, the refit, and how far off the luminance of both is.*
#
# The command line refits with `skyfit refit --out refit`, whose options describe the haze, and writes the shader with
# `skyfit export refit/coefficients.json --to glsl --out sky.glsl`. See
# [use an analytic sky](../how-to/analytic-skies.md).
