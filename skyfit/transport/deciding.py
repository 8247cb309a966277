"""A few numbers of each direction and wavelength that decide the error of a simplified sky."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..atmosphere import Atmosphere
from ..scene import haversine, Scene
from .columns import outward_columns
from .contract import Geometry
from .optics import optics


# Streams per hemisphere; `forward` is the moment beyond those that they carry.
STREAMS = (6, 8, 12, 16)
# Angle from the sun (rad) within which `nearness` is constant; height (m) below which an absorber attenuates views.
_AUREOLE, _LOW = 0.02, 8000.0
_LEAST, _APART = 1e-12, 1e-4


class Deciding(NamedTuple):
    """Numbers of one scene that decide errors, dimensionless.

    `depth`, vertical optical depth of scattering; `view_airmass` and `sun_airmass`, those of the scatterers on a
    sphere; `albedo` of the ground; `haze`, the share of the scattering that has a forward peak; `forward`, the moment
    of the scattering beyond `STREAMS`; `nearness` to the sun, the inverse of the angle in rad; `bent`, the relative
    change of singly scattered light by a flat Earth; `without`, its relative change without each constituent.
    """

    depth: Float[Array | np.ndarray, "direction wavelength"]
    view_airmass: Float[Array | np.ndarray, "direction wavelength"]
    sun_airmass: Float[Array | np.ndarray, "direction wavelength"]
    albedo: Float[Array | np.ndarray, "direction wavelength"]
    haze: Float[Array | np.ndarray, "direction wavelength"]
    forward: Float[Array | np.ndarray, "stream direction wavelength"]
    nearness: Float[Array | np.ndarray, "direction wavelength"]
    bent: Float[Array | np.ndarray, "direction wavelength"]
    without: Float[Array | np.ndarray, "constituent direction wavelength"]


class _Once(NamedTuple):
    """Airmasses of the scatterers; singly scattered light, of all constituents and without each."""

    view_airmass: Float[Array, "direction wavelength"]
    sun_airmass: Float[Array, " wavelength"]
    light: Float[Array, "direction wavelength"]
    without: Float[Array, "constituent direction wavelength"]


@eqx.filter_jit
def deciding(atmosphere: Atmosphere, scene: Scene) -> Deciding:
    """Compute the numbers of a scene seen from the ground; views below the horizon count as level."""
    wavelength = scene.wavelength_nm
    half = haversine(scene.view.zenith, scene.sun_zenith, scene.view.azimuth - scene.sun_azimuth)
    scattering = optics(atmosphere.constituents, wavelength).scattering
    total = jnp.sum(scattering, axis=0) + _LEAST
    shares = scattering / total[None]
    forward, haze = jnp.zeros((len(STREAMS), *wavelength.shape)), jnp.zeros_like(wavelength)
    phases = []
    for share, phase in zip(shares, (c.phase for c in atmosphere.constituents), strict=True):
        if phase is None:
            phases.append(jnp.zeros((*half.shape, *wavelength.shape)))
            continue
        phases.append(phase.at_haversine(half, wavelength) + jnp.zeros_like(wavelength)[None])
        if phase.last_degree is None:
            moments = phase.moments(2 * STREAMS[-1] + 1, wavelength) + jnp.zeros_like(wavelength)[None]
            forward = forward + jnp.maximum(moments[2 * np.array(STREAMS)], 0.0) * share[None]
            haze = haze + share
    on_sphere, on_plane = (_once(atmosphere, scene, jnp.stack(phases), geometry) for geometry in ("spherical", "flat"))
    shape = half.shape[0], wavelength.shape[0]
    angle = jnp.maximum(2.0 * jnp.arcsin(jnp.sqrt(half)), _AUREOLE)

    def everywhere(row):
        return jnp.broadcast_to(row[..., None, :], (*row.shape[:-1], *shape))

    return Deciding(
        everywhere(total),
        on_sphere.view_airmass,
        everywhere(on_sphere.sun_airmass),
        everywhere(atmosphere.ground.reflectance(wavelength)),
        everywhere(haze),
        everywhere(forward),
        jnp.broadcast_to((1.0 / angle)[:, None], shape),
        jnp.abs(on_plane.light / on_sphere.light - 1.0),
        jnp.abs(on_sphere.without / on_sphere.light[None] - 1.0),
    )


def _once(
    atmosphere: Atmosphere, scene: Scene, phase: Float[Array, "constituent direction wavelength"], geometry: Geometry
) -> _Once:
    """Single scattering in closed form: scatterers are mixed throughout, absorbers lie above or below them."""
    constituents = atmosphere.constituents
    profiles = [c.profile for c in constituents]
    depths = optics(constituents, scene.wavelength_nm)
    views, sun = (jnp.maximum(jnp.cos(z), 0.0) for z in (scene.view.zenith, scene.sun_zenith[None]))
    # One call for views and sun, so that one program is compiled.
    airmass = outward_columns(profiles, jnp.zeros(views.shape[0] + 1), jnp.concatenate([views, sun]), geometry)
    along, toward = airmass[:, :-1], airmass[:, -1]
    seen = jnp.stack(
        [
            jnp.asarray(1.0) if c.phase is not None else 1.0 - c.profile.column_above(jnp.asarray(_LOW))
            for c in constituents
        ]
    )
    scattered = phase * depths.scattering[:, None] * along[:, :, None]
    on_view = depths.extinction[:, None] * (seen[:, None] * along)[:, :, None]
    on_sun = (depths.extinction * toward[:, None])[:, None]

    def light(scattered, on_view, on_sun):
        apart = on_view - on_sun
        far = jnp.abs(apart) > _APART
        mean = (jnp.exp(-on_sun) - jnp.exp(-on_view)) / jnp.where(far, apart, 1.0)
        return scattered * jnp.where(far, mean, jnp.exp(-0.5 * (on_sun + on_view))) + _LEAST

    sums = scattered.sum(axis=0), on_view.sum(axis=0), on_sun.sum(axis=0)
    parts = jnp.broadcast_to(on_sun, on_view.shape)
    without = light(*(whole[None] - part for whole, part in zip(sums, (scattered, on_view, parts), strict=True)))
    total = depths.scattering.sum(axis=0) + _LEAST
    return _Once(along.T @ depths.scattering / total[None], toward @ depths.scattering / total, light(*sums), without)
