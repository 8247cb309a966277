# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Twilight and space
#
# `Spherical` solves an atmosphere once for every sun from the zenith to 18 degrees below the horizon and for every
# observer from the ground to space. What comes back is a *field*, which answers scenes. This page sees a dusk from
# the ground and the Earth's limb from orbit.

# %%
import matplotlib.pyplot as plt
import numpy as np

import skyfit

solver = skyfit.Spherical.draft()
air = skyfit.Atmosphere.from_optical_depth(0.1)
colours = np.array([400, 450, 500, 550, 600, 650, 700])
field = solver.prepare(air, colours)
print(f"all suns, all heights, {len(colours)} wavelengths: {field.nbytes / 1e6:.0f} MB")

# %% [markdown]
# ## A dusk
#
# A camera says which way each pixel looks. The field gives radiance there, which becomes X, Y, Z and then a picture,
# all by one law of exposure. The fisheye looks up, north up and east right as on a map, while the sun goes down in
# the west. The brightness above each picture is that of the zenith.


# %%
def photograph(camera, sun, height=None):
    east, north, up = np.asarray(camera.views())
    seen = camera.solid_angle(*np.mgrid[: camera.height, : camera.width]) > 0
    if height is None:
        seen &= up > 0.003
    views = skyfit.Directions(np.arccos(np.clip(up[seen], -1, 1)), np.arctan2(east[seen], north[seen]))
    scene = skyfit.Scene.from_degrees(sun, views, colours, 270, height=height)
    light = np.zeros((*seen.shape, 3), np.float32)
    light[seen] = skyfit.xyz(field.radiance(scene), colours)
    picture = skyfit.Image(light, camera, skyfit.image.Lamp(np.radians(sun), 1.5 * np.pi, (0, 0, 0)), "Spherical")
    shown = picture.developed()
    shown[~seen] = 1.0
    return shown, light


camera = skyfit.Camera("fisheye", 121, 121)
figure, grid = plt.subplots(2, 3, figsize=(8.4, 6.2), layout="constrained")
for axes, sun in zip(grid.ravel(), (80, 88, 92, 95, 98, 101)):
    shown, light = photograph(camera, sun)
    axes.imshow(shown, interpolation="bilinear")
    axes.set_title(f"sun {90 - sun:+}°, zenith {light[60, 60, 1]:.3g} cd m⁻²", fontsize=9)
    axes.axis("off")
plt.show()

# %% [markdown]
# *The sun sets on the left (west). The glow stays there, the shadow of the Earth rises in the east, and ozone keeps
# the zenith blue long after sunset.*
#
# ## How fast it gets dark

# %%
up = skyfit.Directions.from_degrees(0, 0)
depression = np.arange(-6.0, 18.1, 2.0)
light = [skyfit.xyz(field.radiance(skyfit.Scene.from_degrees(90 + d, up, colours)), colours)[0, 1] for d in depression]
figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
axes.semilogy(depression, light)
for name, degrees in (("civil", 6), ("nautical", 12), ("astronomical", 18)):
    axes.axvline(degrees, color="#999999", linewidth=0.8)
    axes.text(degrees - 0.15, 2e-5, name, rotation=90, ha="right", va="bottom", fontsize=8, color="#555555")
axes.set(xlabel="sun below the horizon, degrees", ylabel="zenith luminance, cd m⁻²", ylim=(1e-5, 3e3))
plt.show()

# %% [markdown]
# ## From orbit
#
# The same field, seen from 400 km. The horizon is 110 degrees from the zenith there, with the thin blue limb of the
# air above it. The sun sinks toward it straight ahead.

# %%
camera = skyfit.Camera("perspective", 180, 60, azimuth=1.5 * np.pi, elevation=np.radians(-19.6), field_of_view=0.2)
figure, grid = plt.subplots(3, 1, figsize=(7.6, 8.2), layout="constrained")
for axes, sun in zip(grid, (95, 103, 107.5)):
    axes.imshow(photograph(camera, sun, height=400e3)[0], interpolation="bilinear")
    axes.set_title(f"sun at {sun}° from the zenith", fontsize=9)
    axes.axis("off")
plt.show()

# %% [markdown]
# `skyfit.render` and `skyfit render` make finished pictures of such scenes. More in
# [twilight, heights and space](../how-to/twilight-and-space.md).
