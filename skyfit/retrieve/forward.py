"""The arrays that a fit takes, and the instrument's simulated reading of a model."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..atmosphere import AbstractConstituent, Rayleigh
from ..numerics import as_float
from ..scene import Directions, Scene
from ..transport import AbstractSolver, Stokes
from ..transport.optics import optics, transmitted_sun
from .model import SkyModel


class Problem(eqx.Module):
    """Samples of some times in a given order of directions; masked samples have weight 0.

    Angles are in radians. The sun's angles are given for each time, or also for each channel if the sun moved between
    channels. `irradiance`: at the top of the air, W m^-2 nm^-1. `weight`: one over sigma. `response` None: samples are
    the radiance at the wavelengths themselves. If the instrument moves between channels, each channel has its own views
    and its own sun. `beside`, `beside_weight`: measurements besides the radiance in one row, and one over their sigma,
    or None. The row holds the beam of each channel if `has_beam`: irradiance on a plane normal to the sun, or the
    haze's optical depth if `direct_is_depth`. Then it holds the degree of polarisation of each direction and channel if
    `has_degree`.
    """

    sun_zenith: Float[Array, " time"] | Float[Array, "time channel"]
    sun_azimuth: Float[Array, " time"] | Float[Array, "time channel"]
    view_zenith: Float[Array, "time direction"] | Float[Array, "time direction channel"]
    view_azimuth: Float[Array, "time direction"] | Float[Array, "time direction channel"]
    irradiance: Float[Array, "time wavelength"]
    wavelength_nm: Float[Array, "time wavelength"]
    measured: Float[Array, "time direction channel"]
    weight: Float[Array, "time direction channel"]
    response: Float[Array, "time channel wavelength"] | None = None
    beside: Float[Array, "time other"] | None = None
    beside_weight: Float[Array, "time other"] | None = None
    field_of_view: float = eqx.field(static=True, default=0.0)
    has_beam: bool = eqx.field(static=True, default=False)
    has_degree: bool = eqx.field(static=True, default=False)
    direct_is_depth: bool = eqx.field(static=True, default=False)

    def at(self, times) -> "Problem":
        """The problem of some times only; where nothing is traced NumPy takes them, which compiles no program."""
        if any(isinstance(v, Tracer) for v in jax.tree.leaves((self, times))):
            return jax.tree.map(lambda v: v[times], self)
        return jax.tree.map(lambda v: jnp.asarray(np.asarray(v)[times]), self)

    def mean_sun(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Zenith angle and azimuth of the sun for a problem of one time, the mean over channels if these differ."""
        if not self.sun_zenith.ndim:
            return self.sun_zenith, self.sun_azimuth
        # azimuths may lie on both sides of north
        aside = jnp.remainder(self.sun_azimuth - self.sun_azimuth[0] + np.pi, 2.0 * np.pi) - np.pi
        return jnp.mean(self.sun_zenith), self.sun_azimuth[0] + jnp.mean(aside)

    def mean_view(self) -> tuple[Float[Array, " direction"], Float[Array, " direction"]]:
        """Zenith angles and azimuths of the views for a problem of one time, the mean over channels if these differ."""
        if self.view_zenith.ndim == 1:
            return self.view_zenith, self.view_azimuth
        aside = jnp.remainder(self.view_azimuth - self.view_azimuth[:, :1] + np.pi, 2.0 * np.pi) - np.pi
        return jnp.mean(self.view_zenith, axis=1), self.view_azimuth[:, 0] + jnp.mean(aside, axis=1)

    def scene(self, model: SkyModel) -> Scene:
        """The scene of a problem of one time (without a time axis), with the instrument's pointing offsets."""
        zenith, azimuth = self.view_zenith, self.view_azimuth
        if self.field_of_view > 0.0:
            zenith, azimuth = _cone(zenith, azimuth, 0.5 * self.field_of_view)
        view = Directions(zenith, azimuth)
        return model.instrument.sees(
            Scene(self.sun_zenith, self.sun_azimuth, view, self.wavelength_nm, self.irradiance)
        )


class Reading(NamedTuple):
    """An instrument's reading: radiance, the beam of each channel and the degree of polarisation, if measured."""

    radiance: Float[Array, "direction channel"]
    beam: Float[Array, " channel"] | None
    degree: Float[Array, "direction channel"] | None

    @property
    def beside(self) -> Float[Array, " other"] | None:
        """All but the radiance in the order of `Problem.beside`, or None."""
        parts = [part.reshape(-1) for part in (self.beam, self.degree) if part is not None]
        return jnp.concatenate(parts) if parts else None


def observe(solver: AbstractSolver, model: SkyModel, one: Problem) -> Reading:
    """Simulate the instrument's reading of a model at one time.

    If each channel has its own sun, each channel is a scene of its own, of one wavelength, or of the whole spectrum
    with a `response`. The number of angles from the sun, and with a response that of wavelengths, is then multiplied by
    the number of channels.
    """
    if one.sun_zenith.ndim:
        return _observe_each(solver, model, one)
    scene = one.scene(model)
    if one.has_degree:
        # `prepared` has refused solvers without Stokes parameters
        light = tuple(solver.stokes(model.atmosphere, scene))  # pyright: ignore[reportAttributeAccessIssue]
    else:
        light = (solver.radiance(model.atmosphere, scene),)
    if one.field_of_view > 0.0:
        weight = as_float([weight for *_, weight in _CONE])
        light = tuple(jnp.einsum("r,rdw->dw", weight, v.reshape(len(_CONE), -1, v.shape[1])) for v in light)
    if one.response is not None:
        light = tuple(part @ one.response.T for part in light)
    degree = Stokes(*light).degree if one.has_degree else None
    if not one.has_beam:
        return Reading(light[0], None, degree)
    constituents = model.atmosphere.constituents
    if one.direct_is_depth:
        return Reading(light[0], haze_depth(constituents, scene.wavelength_nm), degree)
    extinction = optics(constituents, scene.wavelength_nm).extinction
    beam = scene.solar_irradiance * transmitted_sun(constituents, scene, extinction, solver.geometry)
    return Reading(light[0], beam, degree)


def haze_depth(constituents: tuple[AbstractConstituent, ...], wavelength_nm) -> Float[Array, " channel"]:
    """The vertical optical depth of all scatterers except the air, as photometers define it."""
    haze = [c for c in constituents if c.phase is not None and not isinstance(c, Rayleigh)]
    return sum((c.optical_depth_at(wavelength_nm) for c in haze), jnp.zeros_like(wavelength_nm))


def _observe_each(solver, model, one: Problem):
    """The same as `observe`, for channels that each have a sun of their own."""
    if not model.atmosphere.smooth_in_wavelength:
        raise ValueError("a sun for each wavelength needs an atmosphere that has no values for each wavelength")

    def parts(problem):
        light = problem.irradiance, problem.wavelength_nm, problem.response
        return problem.sun_zenith, problem.sun_azimuth, problem.view_zenith, problem.view_azimuth, *light

    def read(own):
        found = observe(solver, model, eqx.tree_at(parts, one, own, is_leaf=lambda part: part is None))
        return jax.tree.map(lambda part: part[..., 0], found)

    zenith, azimuth, *views, irradiance, wavelength, response = parts(one)
    view_axis = 1 if one.view_zenith.ndim == 2 else None
    if response is None:
        irradiance, wavelength = irradiance[:, None], wavelength[:, None]
        spectrum = 0
    else:
        response, spectrum = response[:, None], None
    axes = (0, 0, view_axis, view_axis, spectrum, spectrum, None if response is None else 0)
    found = jax.vmap(read, in_axes=(axes,))((zenith, azimuth, *views, irradiance, wavelength, response))
    return jax.tree.map(lambda part: part.T, found)


# rays of a cone: distance from its axis over its half angle, angle about the axis, weight. Exact for polynomials of
# degree 5 over a disc (Abramowitz & Stegun 1964, 25.4.61, n = 7)
_CONE = ((0.0, 0.0, 0.25), *((np.sqrt(2.0 / 3.0), np.pi * k / 3.0, 0.125) for k in range(6)))


def _cone(zenith, azimuth, half_angle: float):
    """The rays of a cone about each direction, in the order ray, direction; rays below the horizon move up to it."""
    zeniths, azimuths = [], []
    for distance, turn, _ in _CONE:
        tilt = half_angle * distance
        cosine = jnp.cos(zenith) * np.cos(tilt) + jnp.sin(zenith) * np.sin(tilt) * np.cos(turn)
        across = np.sin(tilt) * np.sin(turn)
        along = jnp.sin(zenith) * np.cos(tilt) - jnp.cos(zenith) * np.sin(tilt) * np.cos(turn)
        # at the zenith any azimuth is valid
        at_axis = (along**2 + across**2) < 1e-12
        zeniths.append(jnp.arctan2(jnp.sqrt(jnp.where(at_axis, 1e-12, along**2 + across**2)), jnp.maximum(cosine, 0.0)))
        azimuths.append(azimuth + jnp.where(at_axis, 0.0, jnp.arctan2(across, jnp.where(at_axis, 1.0, along))))
    return jnp.concatenate(zeniths), jnp.concatenate(azimuths)


@eqx.filter_jit
def simulate(solver: AbstractSolver, model: SkyModel, scene: Scene):
    """The radiance of a model in a scene, with the instrument's pointing offsets, `[direction, wavelength]`."""
    return solver.radiance(model.atmosphere, model.instrument.sees(scene))
