# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # A photometer's scan
#
# A sun photometer looks at the sky along a circle at the sun's height, the almucantar, at four wavelengths. This page
# reads such a file and finds the optical depth of the haze, how much it absorbs, and the sizes of its particles.
#
# `data/skies/almucantar.alm` has the layout of AERONET's raw sky scans. Its numbers were made by another solver and
# its own Mie code (sasktran2), with noise, so that the truth is known. The site is called Nowhere.

# %%
import json
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import skyfit

jax.config.update("jax_enable_x64", True)
sky = skyfit.read("data/skies/almucantar.alm")
print(sky.instrument)
for note in sky.notes:
    print("-", note)

# %% [markdown]
# `read` knows the format by its content and says what it assumed. It found the optical depths of the direct sun in
# the file beside it (`almucantar.lev20`) and takes them along.
#
# The filters follow each other within minutes, while the sun moves. Each is seen under its own sun.

# %%
figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
turned = np.degrees(sky.view_azimuth_by_wavelength[0] - sky.sun_azimuth[0])
for i, nm in enumerate(sky.wavelength_nm):
    side = (turned[:, i] + 180) % 360 - 180
    axes.semilogy(side, 1e3 * sky.radiance[0, :, i], ".", markersize=4, label=f"{nm:.0f} nm")
axes.set(xlabel="azimuth from the sun, degrees", ylabel="radiance, mW m⁻² sr⁻¹ nm⁻¹")
axes.legend(frameon=False, ncols=2)
plt.show()

# %% [markdown]
# ## Invert
#
# Nothing is named as free: for spectra `invert` asks for spheres in two modes of size, their refractive index, and the
# ground. `draft` keeps this page quick, and the last note says what that costs; leave `solver` out for `normal`.

# %%
fit = skyfit.invert(sky, solver=skyfit.OrdersOfScattering.draft(polarised=True))
print(fit)

# %% [markdown]
# ## The products
#
# `aerosol_products` states the haze as networks do, each number with its sigma.

# %%
products = skyfit.aerosol_products(fit).isel(time=0)
truth = json.loads(Path("data/skies/almucantar_truth.json").read_text())["optics"]
print(f"{'':26}" + "".join(f"{nm:>18.0f} nm" for nm in truth["wavelength_nm"]))
for name in ("aerosol_optical_depth", "single_scattering_albedo", "asymmetry"):
    found, sigma = products[name].values, products[f"{name}_sigma"].values
    print(f"{name:26}" + "".join(f"{v:12.3f} ± {s:.3f} " for v, s in zip(found, sigma)))
    print(f"{'  truth':26}" + "".join(f"{v:12.3f}         " for v in truth[name]))

# %%
radius = np.geomspace(0.05, 15, 120)
sizes = skyfit.aerosol_products(fit, radius_um=radius).isel(time=0)
size, spread = sizes["volume_size_distribution"].values, sizes["volume_size_distribution_sigma"].values
figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.6), layout="constrained")
left.fill_between(radius, np.maximum(size - spread, 0), size + spread, alpha=0.25, linewidth=0)
left.semilogx(radius, size)
left.set(xlabel="radius, µm", ylabel="dV / dln r, µm³ µm⁻²", title="sizes of the particles, ± sigma")
nm = sky.wavelength_nm
for name, colour in (("aerosol_optical_depth", "#d55e00"), ("single_scattering_albedo", "#0072b2")):
    right.errorbar(nm, products[name], products[f"{name}_sigma"], fmt="o", color=colour, markersize=4,
                   label=name.replace("_", " "))  # fmt: skip
    right.plot(truth["wavelength_nm"], truth[name], color=colour, linewidth=0.9, linestyle=":")
right.set(xlabel="wavelength, nm", ylim=(0, 1.05), title="found (dots) and true (dotted)")
right.legend(frameon=False, loc="center right", fontsize=8)
plt.show()

# %% [markdown]
# The command line does the same, by `normal`, with `skyfit invert data/skies/almucantar.alm --out fit --products`.
# Which files are known, and what is assumed of each, stands in [read your instrument's
# file](../how-to/instruments.md).
