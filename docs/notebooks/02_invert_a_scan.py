# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Invert a scan
#
# From a measured sky to the amount and kind of its haze, with error bars. The scan is `data/skies/sample.nc`: 94
# directions at 33 wavelengths with 1 % noise, made by another solver (sasktran2, with polarisation), so that the
# truth is known and skyfit did not write it.

# %%
import json
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import skyfit

jax.config.update("jax_enable_x64", True)
sky = skyfit.read("data/skies/sample.nc")
print(
    f"{sky.radiance.shape[1]} directions, {sky.radiance.shape[2]} wavelengths, "
    f"sun {np.degrees(sky.sun_zenith[0]):.0f}° from the zenith, {sky.usable.mean():.0%} of the samples usable"
)

# %% [markdown]
# ## Ask
#
# `free` names what is to be found. Everything else stays at its value in `start`, or at its default. Here we ask for
# six numbers. `draft` keeps this page quick to build; leave `solver` out and you get the polarised `normal`.

# %%
free = ["aerosol_optical_depth", "angstrom_exponent", "single_scattering_albedo", "asymmetry", "ground_albedo", "ozone"]
solver = skyfit.OrdersOfScattering.draft(polarised=True)
fit = skyfit.invert(sky, free, solver)
print(fit)

# %% [markdown]
# Read it from the top. *successful*: the search converged. *rmse* is what is left between model and measurement.
# *reduced chi-square* near 1 says that this is the noise and nothing more. Each line is value ± sigma; sigma contains
# the noise and the stated error of the model.
#
# ## Was it right?

# %%
truth = json.loads(Path("data/skies/sample_truth.json").read_text())["parameters"]
names = {"aerosol_optical_depth": "aod550", "single_scattering_albedo": "aerosol_albedo", "ozone": "ozone_du"}
for name, value, sigma in zip(free, fit.values[0], fit.sigma[0]):
    true = truth[names.get(name, name)]["value"]
    print(f"{name:26} true {true:8.4g}   found {value:8.4g}   off by {(value - true) / sigma:+.1f} sigma")

# %% [markdown]
# ## What each says of the other
#
# Two parameters that do nearly the same to the sky cannot be told apart well. The correlation matrix shows such
# pairs: a red or blue square off the diagonal.

# %%
figure, axes = plt.subplots(figsize=(5.4, 4.2), layout="constrained")
shown = axes.imshow(fit.correlation[0], cmap="RdBu_r", vmin=-1, vmax=1)
labels = [name.replace("_", " ") for name in free]
axes.set_xticks(range(len(free)), labels, rotation=40, ha="right", fontsize=8)
axes.set_yticks(range(len(free)), labels, fontsize=8)
figure.colorbar(shown, label="correlation")
plt.show()

# %% [markdown]
# ## The whole fit on a page
#
# `skyfit.plot` draws the measured sky, the model, what is left, and the parameters. `skyfit.save` writes `fit.json`
# with sigma and correlations, or `fit.nc` with the residuals of every sample.

# %%
Path("build").mkdir(exist_ok=True)
skyfit.plot(fit, "build/fit.png")
skyfit.save(fit, "build/fit.json")
figure, axes = plt.subplots(figsize=(14.2, 5.2), layout="constrained")
axes.imshow(plt.imread("build/fit.png"))
axes.axis("off")
plt.show()

# %% [markdown]
# The command line does the same, by `normal`, with `skyfit invert data/skies/sample.nc --out fit --free` and the six
# names with commas between them. Without `--free` it asks for spheres.
#
# Next: a scan of your own. [Read your instrument's file](../how-to/instruments.md),
# [choose what is free](../how-to/free-parameters.md), and mind
# [noise, priors and error bars](../how-to/error-bars.md).
