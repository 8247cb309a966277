"""The arrays that a fit takes, and what an instrument would read of a model."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..atmosphere import AbstractConstituent, Rayleigh
from ..numerics import as_float
from ..scene import Directions, Scene
from ..transport import AbstractSolver
from ..transport.optics import optics, transmitted_sun
from .model import SkyModel


class Problem(eqx.Module):
    """Samples of some times in a given order of directions; what is masked has weight 0.

    Angles in radians; the sun's of each time, or of each of its channels too, between which it moved. `irradiance` at
    the top of the air in W m^-2 nm^-1, `weight` one over sigma. `response` None: samples are the radiance at the
    wavelengths themselves. Views of each channel, where the instrument moves between them, go with a sun of each.
    `direct` irradiance on a plane normal to the sun, or the haze's optical depth if `direct_is_depth`; or None.
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
    direct: Float[Array, "time channel"] | None = None
    direct_weight: Float[Array, "time channel"] | None = None
    field_of_view: float = eqx.field(static=True, default=0.0)
    direct_is_depth: bool = eqx.field(static=True, default=False)

    def at(self, times) -> "Problem":
        """The problem of some times only."""
        return jax.tree.map(lambda v: v[times], self)

    def mean_sun(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Zenith angle and azimuth of the sun of a problem of one time, the mean where the channels' differ."""
        if not self.sun_zenith.ndim:
            return self.sun_zenith, self.sun_azimuth
        # azimuths may lie on both sides of north
        aside = jnp.remainder(self.sun_azimuth - self.sun_azimuth[0] + np.pi, 2.0 * np.pi) - np.pi
        return jnp.mean(self.sun_zenith), self.sun_azimuth[0] + jnp.mean(aside)

    def mean_view(self) -> tuple[Float[Array, " direction"], Float[Array, " direction"]]:
        """Zenith angles and azimuths of the views of a problem of one time, the mean where the channels' differ."""
        if self.view_zenith.ndim == 1:
            return self.view_zenith, self.view_azimuth
        aside = jnp.remainder(self.view_azimuth - self.view_azimuth[:, :1] + np.pi, 2.0 * np.pi) - np.pi
        return jnp.mean(self.view_zenith, axis=1), self.view_azimuth[:, 0] + jnp.mean(aside, axis=1)

    def scene(self, model: SkyModel) -> Scene:
        """The scene of a problem of one time (its time axis taken off), pointing offsets of the instrument included."""
        zenith, azimuth = self.view_zenith, self.view_azimuth
        if self.field_of_view > 0.0:
            zenith, azimuth = _cone(zenith, azimuth, 0.5 * self.field_of_view)
        view = Directions(zenith, azimuth)
        return model.instrument.sees(
            Scene(self.sun_zenith, self.sun_azimuth, view, self.wavelength_nm, self.irradiance)
        )


def observe(
    solver: AbstractSolver, model: SkyModel, one: Problem
) -> tuple[Float[Array, "direction channel"], Float[Array, " channel"] | None]:
    """What the instrument would read of a model at one time: the sky, and the direct beam where it is measured.

    Under a sun for each channel each is a scene of its own, of one wavelength, or of the whole spectrum with a
    `response`: channels times as many angles from the sun, and with a response as many wavelengths, as under one sun.
    """
    if one.sun_zenith.ndim:
        return _observe_each(solver, model, one)
    scene = one.scene(model)
    radiance = solver.radiance(model.atmosphere, scene)
    if one.field_of_view > 0.0:
        rays = radiance.reshape(len(_CONE), -1, radiance.shape[1])
        radiance = jnp.einsum("r,rdw->dw", as_float([weight for *_, weight in _CONE]), rays)
    if one.response is not None:
        radiance = radiance @ one.response.T
    if one.direct is None:
        return radiance, None
    constituents = model.atmosphere.constituents
    if one.direct_is_depth:
        return radiance, haze_depth(constituents, scene.wavelength_nm)
    extinction = optics(constituents, scene.wavelength_nm).extinction
    return radiance, scene.solar_irradiance * transmitted_sun(constituents, scene, extinction, solver.geometry)


def haze_depth(constituents: tuple[AbstractConstituent, ...], wavelength_nm) -> Float[Array, " channel"]:
    """The vertical optical depth of all that scatters but the air, as photometers have it."""
    haze = [c for c in constituents if c.phase is not None and not isinstance(c, Rayleigh)]
    return sum((c.optical_depth_at(wavelength_nm) for c in haze), jnp.zeros_like(wavelength_nm))


def _observe_each(solver, model, one: Problem):
    """As `observe`, of channels that each have a sun of their own."""
    if not model.atmosphere.smooth_in_wavelength:
        raise ValueError("a sun for each wavelength needs an atmosphere that has no values for each wavelength")

    def parts(problem):
        light = problem.irradiance, problem.wavelength_nm, problem.response, problem.direct
        return problem.sun_zenith, problem.sun_azimuth, problem.view_zenith, problem.view_azimuth, *light

    def read(own):
        radiance, direct = observe(solver, model, eqx.tree_at(parts, one, own, is_leaf=lambda part: part is None))
        return radiance[:, 0], None if direct is None else direct[0]

    zenith, azimuth, *views, irradiance, wavelength, response, direct = parts(one)
    view_axis = 1 if one.view_zenith.ndim == 2 else None
    if response is None:
        irradiance, wavelength = irradiance[:, None], wavelength[:, None]
        spectrum = 0
    else:
        response, spectrum = response[:, None], None
    direct = None if direct is None else direct[:, None]
    axes = (0, 0, view_axis, view_axis, spectrum, spectrum, None if response is None else 0)
    given = (zenith, azimuth, *views, irradiance, wavelength, response, direct)
    radiance, direct = jax.vmap(read, in_axes=((*axes, None if direct is None else 0),))(given)
    return radiance.T, direct


# rays of a cone: distance from its axis over its half angle, turn about it, weight. Exact for polynomials of degree
# 5 over a disc (Abramowitz & Stegun 1964, 25.4.61, n = 7)
_CONE = ((0.0, 0.0, 0.25), *((np.sqrt(2.0 / 3.0), np.pi * k / 3.0, 0.125) for k in range(6)))


def _cone(zenith, azimuth, half_angle: float):
    """The rays of a cone about each direction, one ray of all directions after the other; none below the horizon."""
    zeniths, azimuths = [], []
    for distance, turn, _ in _CONE:
        tilt = half_angle * distance
        cosine = jnp.cos(zenith) * np.cos(tilt) + jnp.sin(zenith) * np.sin(tilt) * np.cos(turn)
        across = np.sin(tilt) * np.sin(turn)
        along = jnp.sin(zenith) * np.cos(tilt) - jnp.cos(zenith) * np.sin(tilt) * np.cos(turn)
        # at the zenith every azimuth is as good
        at_axis = (along**2 + across**2) < 1e-12
        zeniths.append(jnp.arctan2(jnp.sqrt(jnp.where(at_axis, 1e-12, along**2 + across**2)), jnp.maximum(cosine, 0.0)))
        azimuths.append(azimuth + jnp.where(at_axis, 0.0, jnp.arctan2(across, jnp.where(at_axis, 1.0, along))))
    return jnp.concatenate(zeniths), jnp.concatenate(azimuths)


@eqx.filter_jit
def simulate(solver: AbstractSolver, model: SkyModel, scene: Scene):
    """The radiance a model gives in a scene, the instrument's pointing included, `[direction, wavelength]`."""
    return solver.radiance(model.atmosphere, model.instrument.sees(scene))
