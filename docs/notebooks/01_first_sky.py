# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # First sky
#
# This notebook simulates a clear sky, looks at its spectrum and its colours, and asks how it changes with haze.
# It needs nothing but skyfit and runs in about a minute, most of which is compilation.

# %%
import jax
import matplotlib.pyplot as plt
import numpy as np

import skyfit

# %% [markdown]
# ## Three things make a sky
#
# An **atmosphere** says what is in the air: here air at sea level, 300 Dobson units of ozone, and haze (turbidity 3).
# A **scene** says where the sun stands, where you look, and at which wavelengths. A **solver** turns both into
# radiance.
#
# `draft` is the coarse preset, 0.05 % off in the median. Take `normal` for your own work.

# %%
air = skyfit.Atmosphere.from_turbidity(3.0)
view = skyfit.hemisphere(343)
wavelength = np.arange(380, 781, 10)
scene = skyfit.Scene.from_degrees(sun_zenith=60, view=view, wavelength_nm=wavelength, sun_azimuth=180)
solver = skyfit.OrdersOfScattering.draft("flat")

radiance = solver.radiance(air, scene)
radiance.shape

# %% [markdown]
# The result is an array: 343 directions by 41 wavelengths, in W m⁻² sr⁻¹ nm⁻¹. Zenith angles are measured from
# straight up, azimuths clockwise from north; inside skyfit all angles are radians, and names that end in `degrees`
# say otherwise.

# %% [markdown]
# ## The spectrum of the zenith and of the horizon
#
# Toward the horizon there is more air, so the sky is brighter and whiter.

# %%
up = int(np.argmin(view.zenith))
low = int(np.argmin(np.abs(view.zenith - np.radians(85)) + np.abs(view.azimuth - np.radians(0))))
figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
for place, name in ((up, "zenith"), (low, "5° above the northern horizon")):
    axes.plot(wavelength, 1e3 * radiance[place], label=name)
axes.set(xlabel="wavelength, nm", ylabel="radiance, mW m⁻² sr⁻¹ nm⁻¹", ylim=(0, None))
axes.legend(frameon=False)
plt.show()

# %% [markdown]
# ## What a parameter does
#
# Every number in the atmosphere can be differentiated by. `jax.jacfwd` gives the change of all 343 × 41 radiances
# with turbidity in one call.


# %%
def sky_of(turbidity):
    return solver.radiance(skyfit.Atmosphere.from_turbidity(turbidity), scene)


slope = jax.jacfwd(sky_of)(3.0)
print(
    f"one more turbidity: zenith {100 * slope[up].sum() / radiance[up].sum():+.0f} %, "
    f"horizon {100 * slope[low].sum() / radiance[low].sum():+.0f} %"
)

# %% [markdown]
# ## A picture
#
# `render` develops a picture of the whole dome. Simulating a spectrum for each of 60 000 pixels would be a waste:
# here the analytic sky `ExtendedPreetham` answers, one formula a pixel; give an `Atmosphere` in its place and a
# solver does. North is up, east is right as on a map, the sun is in the south.

# %%
camera = skyfit.Camera("fisheye", 240, 240)
outside = camera.solid_angle(*np.mgrid[:240, :240]) == 0
sky = skyfit.ExtendedPreetham.shipped()
figure, grid = plt.subplots(2, 4, figsize=(9, 4.7), layout="constrained")
for row, turbidity in zip(grid, (2, 6)):
    for axes, sun in zip(row, (30, 60, 80, 88)):
        image = skyfit.render(sky, camera, turbidity=turbidity, sun_zenith=np.radians(sun), sun_azimuth=np.pi)
        picture = image.developed()
        picture[outside] = 1.0
        axes.imshow(picture, interpolation="bilinear")
        axes.set_title(f"turbidity {turbidity}, sun at {sun}°", fontsize=9)
        axes.axis("off")
plt.show()

# %% [markdown]
# *Clear air above, hazy air below; the sun sinks from left to right.*
#
# Next: [invert a scan](02_invert_a_scan.md), the way back from radiance to haze.
