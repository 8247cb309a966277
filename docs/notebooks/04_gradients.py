# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Gradients through the sky
#
# Every number in an `Atmosphere` is a leaf that JAX differentiates by. Three uses: what a direction of the sky tells
# of the haze, where to point an instrument, and a loop of gradient descent through the solver.

# %%
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import optax

import skyfit

solver = skyfit.OrdersOfScattering.draft("flat")
air = skyfit.Atmosphere.from_turbidity(3.0)

# %% [markdown]
# ## What each direction tells
#
# `sensitivity` gives d radiance / d parameter for every direction and wavelength.

# %%
names = ("aerosol_optical_depth", "single_scattering_albedo", "asymmetry", "ground_albedo")
view = skyfit.hemisphere(300, np.radians(85))
scene = skyfit.Scene.from_degrees(50, view, [440, 675, 870], 180)
slopes = skyfit.sensitivity(scene, air, names, solver)
relative = slopes / solver.radiance(air, scene)[None]
relative.shape

# %% [markdown]
# ## Where to point
#
# `fisher_information` says what a measurement of each direction, with 2 % noise, tells of all parameters together.
# `next_directions` then picks, one after the other, those that lessen the error of one of them most. Compare its
# choice with as many directions taken at random.

# %%
prior = [0.5, 0.1, 0.1, 0.3]
information = skyfit.fisher_information(scene, air, names, 0.02, solver=solver)
choice = skyfit.next_directions(information, names, 8, interest="aerosol_optical_depth", prior=prior)
draw = np.random.default_rng(0)


def sigma_of(directions):
    covariance = skyfit.posterior_covariance(information[directions].sum(axis=0), prior)
    return float(jnp.sqrt(covariance[0, 0]))


random = [np.median([sigma_of(draw.choice(300, n, replace=False)) for _ in range(20)]) for n in range(1, 9)]
print(f"sigma of optical depth after 8 directions: {choice.sigma[-1, 0]:.4f} chosen, {random[-1]:.4f} at random")

# %%
Path("build").mkdir(exist_ok=True)
skyfit.draw.plot_sensitivity(
    scene,
    names,
    np.asarray(relative),
    "build/sensitivity.png",
    chosen=skyfit.Directions(view.zenith[choice.order], view.azimuth[choice.order]),
    sigmas={"chosen": choice.sigma[:, 0], "at random": np.array(random)},
    title="What a clear sky tells: turbidity 3, sun at 50°",
)
figure, axes = plt.subplots(figsize=(10, 11), layout="constrained")
axes.imshow(plt.imread("build/sensitivity.png"))
axes.axis("off")
plt.show()

# %% [markdown]
# ## Learn through the solver
#
# `invert` is the right tool for fitting one sky. Where the sky is a part of something larger (a renderer, a network),
# its gradient goes into any optimiser. Here optax's Adam finds the haze that a picture of 60 directions was made
# with.
#
# The optimiser moves three free numbers; exp and the logistic curve keep depth, albedo and asymmetry where they have
# a meaning.

# %%
few = skyfit.Scene.from_degrees(50, skyfit.hemisphere(60, np.radians(80)), [440, 675, 870], 180)
labels, true = ("optical depth", "single-scattering albedo", "asymmetry"), (0.3, 0.9, 0.65)


def haze(free):
    return jnp.exp(free[0]), jax.nn.sigmoid(free[1]), jax.nn.sigmoid(free[2])


def sky_of(depth, albedo, asymmetry):
    phase = skyfit.HenyeyGreenstein(asymmetry)
    hazy = skyfit.Atmosphere.from_optical_depth(depth, single_scattering_albedo=albedo, phase=phase)
    return solver.radiance(hazy, few)


seen = sky_of(*true)
optimiser = optax.adam(0.05)


@jax.jit
def step(free, state):
    value, slope = jax.value_and_grad(lambda f: jnp.mean(jnp.log(sky_of(*haze(f)) / seen) ** 2))(free)
    change, state = optimiser.update(slope, state)
    return free + change, state, value


free = jnp.array([jnp.log(0.1), 3.0, 0.0])
state, history = optimiser.init(free), []
for _ in range(300):
    history.append([float(v) for v in haze(free)])
    free, state, loss = step(free, state)
for name, found, right in zip(labels, history[-1], true):
    print(f"{name:26} found {found:.3f}, true {right}")

# %%
figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
for row, right, name in zip(zip(*history), true, labels):
    (line,) = axes.plot(row, label=name)
    axes.axhline(right, color=line.get_color(), linewidth=0.9, linestyle=":")
axes.set(xlabel="step", ylim=(0, 1), title="three numbers of the haze, and where they should end (dotted)")
axes.title.set_fontsize(10)
axes.legend(frameon=False, loc="center right")
plt.show()

# %% [markdown]
# More in [gradients and design](../how-to/gradients.md).
