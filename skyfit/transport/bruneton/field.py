"""Reading the tables: radiance from the ground to space, the air in front of objects, light shafts."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...atmosphere import Atmosphere
from ...numerics import check_range, concrete
from ...scene import Scene
from ..columns import TOP_OF_AIR
from ..contract import check_eye, Irradiances, Path
from ..optics import optics
from ..views import points_at, Views, views_of
from .lookup import irradiance, optical_depth, Rays, scattered, sunlight
from .parameterisation import meets_ground, Sizes
from .tables import Air, reflected, Tables


def air_of(atmosphere: Atmosphere, wavelength_nm: Float[Array, " wavelength"]) -> Air:
    """The properties of an atmosphere that the tables need."""
    depths = optics(atmosphere.constituents, wavelength_nm)
    reflectance = atmosphere.ground.reflectance(wavelength_nm)
    return Air(atmosphere.constituents, wavelength_nm, depths.extinction, depths.scattering, reflectance)


class BrunetonField(eqx.Module):
    r"""The tables of `Bruneton.prepare`, which answer any observer, view and sun at their wavelengths.

    **Valid:** observers from the ground to space; suns that, at the point where a view enters the air, are no lower
    than the lowest sun of the tables (`known` tells for which views; a lower sun is replaced by the lowest). Scenes at
    other wavelengths than those of the tables raise a `ValueError`, and so do suns that are too low for the observer.
    """

    atmosphere: Atmosphere
    wavelength_nm: Float[Array, " wavelength"]
    tables: Tables
    sizes: Sizes = eqx.field(static=True)

    @property
    def nbytes(self) -> int:
        """Memory of the tables, bytes."""
        return sum(table.nbytes for table in self.tables)

    def radiance(
        self, scene: Scene, shadowed: Float[Array, " direction"] | None = None
    ) -> Float[Array, "direction wavelength"]:
        r"""Diffuse radiance, including light of the ground where a view meets it, W m^-2 sr^-1 nm^-1.

        A view to the ground has $L = R[L_0] + R[L_*] + S|_x - T(x, x_s)\, S|_{x_s}$, where $x_s$ is the start of the
        last `shadowed` m. A view to the sky has $T(x, x_s)\, S|_{x_s}$, where $x_s$ is the end of the first `shadowed`
        m.

        **Arguments:** `shadowed`, the length that mountains or clouds shade, m; None for no shadow. The shadow lacks
        multiple scattering, too. **Returns:** black below the horizon of an observer on the ground.
        **Source:** Bruneton & Neyret 2008, eq. 16-18.
        """
        self._check(scene)
        check_range("shadowed", shadowed, 0.0, np.inf, "m")
        return _radiance(self, scene, shadowed)

    def path(self, scene: Scene, distance: Float[Array, " direction"]) -> Path:
        r"""Effect of the air in front of objects: $T(x, x_o) = T(x) / T(x_o)$ and $S|_x - T(x, x_o)\, S|_{x_o}$.

        **Arguments:** `distance`, m, >= 0, infinite for the sky. **Valid:** views that meet the ground end there.
        The light of short paths is a difference of large numbers.
        **Source:** Bruneton & Neyret 2008, eq. 16 and sec. 4.
        """
        self._check(scene)
        check_eye(scene)
        check_range("distance", distance, 0.0, np.inf, "m")
        return _path(self, scene, distance)

    def fluxes(self, scene: Scene) -> Irradiances:
        """Direct, diffuse and reflected irradiance on the ground under the scene's sun."""
        self._check(scene)
        return _fluxes(self, scene)

    def ambient(
        self, height: Float[Array, " place"], sun_cosine: Float[Array, " place"], tilt_cosine: Float[Array, " place"]
    ) -> Float[Array, "place wavelength"]:
        r"""Diffuse irradiance of terrain, $\frac{1 + n \cdot \bar n}{2} E[L_*]$, per unit irradiance of the sun.

        **Arguments:** `height`, m; `sun_cosine`, the cosine of the sun's zenith angle there; `tilt_cosine`, the cosine
        of the slope's tilt.
        **Source:** Bruneton & Neyret 2008, eq. 14, 15.
        """
        open_sky = (0.5 + 0.5 * tilt_cosine)[:, None]
        return open_sky * irradiance(self.tables.irradiance, height, sun_cosine, self.sizes)

    def known(self, scene: Scene) -> Bool[Array, " direction"]:
        """Whether the sun, where each view enters the air, is no lower than the lowest sun of the tables."""
        rays, _, sees = _starts(scene)
        return ~sees | (rays.sun_cosine >= self.sizes.lowest_sun - 1e-6)

    def _check(self, scene: Scene) -> None:
        own, asked = concrete(self.wavelength_nm), concrete(scene.wavelength_nm)
        if scene.wavelength_nm.shape != self.wavelength_nm.shape or (
            own is not None and asked is not None and not np.allclose(own, asked, rtol=1e-6)
        ):
            raise ValueError(
                f"`wavelength_nm` of the scene must be those of the tables, {_listed(own)}, got {_listed(asked)}"
            )
        check_sun(scene, self.sizes.lowest_sun)


def check_sun(scene: Scene, lowest_sun: float) -> None:
    """Raise a `ValueError` for a sun lower than the lowest of the tables; traced suns are not checked."""
    lowest = np.degrees(np.arccos(lowest_sun))
    known = f"Bruneton, spherical: suns to {lowest:g} degrees"
    check_range("sun_zenith", scene.sun_zenith, 0.0, float(np.radians(lowest)), "rad", known)


def _listed(wavelength) -> str:
    return "traced ones" if wavelength is None else np.array2string(wavelength, threshold=4, precision=5)


def _starts(scene: Scene) -> tuple[Rays, Views, Bool[Array, " direction"]]:
    """Rays where the views enter the air, the whole views, and which of them cross any air."""
    views = views_of(scene, "spherical")
    return _rays_at(views, views.entry, _lands(views)), views, views.length > views.entry


def _lands(views: Views) -> Bool[Array, " direction"]:
    return meets_ground(views.height, views.cosine) & views.aloft


def _rays_at(views: Views, distance, ground) -> Rays:
    points = points_at(views, distance[:, None])
    height = jnp.clip(points.height[:, 0], 0.0, TOP_OF_AIR)
    cosine, sun = (jnp.clip(v[:, 0], -1.0, 1.0) for v in (points.view_cosine, points.sun_cosine))
    return Rays(height, cosine, sun, 1.0 - 2.0 * views.half_angle, ground)


def _depth(field: BrunetonField, rays: Rays):
    return optical_depth(field.tables.optical_depth, rays.height, rays.cosine, rays.ground, field.sizes)


def _in_scattered(field: BrunetonField, rays: Rays, half_angle) -> Float[Array, "direction wavelength"]:
    r"""$S = P_R C_* + \sum P_M C_M$, the phase functions at the view's own angle."""
    air, tables = air_of(field.atmosphere, field.wavelength_nm), field.tables
    smooth = scattered(tables.air, rays, field.sizes)
    light = air.smooth_phase.at_haversine(half_angle, field.wavelength_nm) * smooth
    others = [(i, p) for i, p in zip(air.scatterers, air.phases, strict=True) if i != air.smooth]
    for (place, phase), table in zip(others, tables.apart, strict=True):
        once = scattered(table, rays, field.sizes)
        if table.shape[-1] != field.wavelength_nm.shape[0]:
            once = _in_proportion(air, place, smooth, once)
        light = light + phase.at_haversine(half_angle, field.wavelength_nm) * once
    return light


def _in_proportion(air: Air, place: int, smooth, once):
    r"""The one-component shortcut, $C_M = C_* \frac{C_{M,r}}{C_{*,r}} \frac{\beta_{R,r}}{\beta_{M,r}}
    \frac{\beta_M}{\beta_R}$; r is red, the longest wavelength, the only one that is stored."""
    red = jnp.argmax(air.wavelength_nm)
    reference = smooth[:, red][:, None]
    lit = reference > 0.0
    ratio = jnp.where(lit, once / jnp.where(lit, reference, 1.0), 0.0)
    haze, clear = air.scattering[place], air.scattering[air.smooth]
    both = (haze[red] > 0.0) & (clear > 0.0)
    scale = clear[red] / jnp.where(both, haze[red], 1.0) * haze / jnp.where(both, clear, 1.0)
    return smooth * ratio * jnp.where(both, scale, 0.0)[None]


@eqx.filter_jit
def _radiance(field: BrunetonField, scene: Scene, shadowed):
    start, views, sees = _starts(scene)
    whole = _in_scattered(field, start, views.half_angle)
    light = whole
    if shadowed is not None:
        dark = jnp.clip(shadowed, 0.0, views.length - views.entry)
        turning = jnp.where(start.ground, views.length - dark, views.entry + dark)
        edge = _rays_at(views, turning, start.ground)
        beyond = jnp.exp(-jnp.maximum(_depth(field, start) - _depth(field, edge), 0.0))
        beyond = beyond * _in_scattered(field, edge, views.half_angle)
        light = jnp.where(start.ground[:, None], jnp.maximum(whole - beyond, 0.0), beyond)
    if views.aloft:
        tables = field.tables

        def of_ground(sun_cosine):
            ground = jnp.zeros_like(sun_cosine)
            direct = (
                sunlight(tables.optical_depth, ground, sun_cosine, field.sizes) * jnp.maximum(sun_cosine, 0.0)[:, None]
            )
            return direct + irradiance(tables.irradiance, ground, sun_cosine, field.sizes)

        air = air_of(field.atmosphere, field.wavelength_nm)
        # At height 0 a view down crosses no air and still sees the ground.
        ground = reflected(air, tables.optical_depth, start, of_ground, field.sizes)
        light = jnp.where((sees | start.ground)[:, None], light, 0.0) + ground
    else:
        light = jnp.where(sees[:, None], light, 0.0)
    return light * scene.solar_irradiance[None]


@eqx.filter_jit
def _path(field: BrunetonField, scene: Scene, distance) -> Path:
    start, views, sees = _starts(scene)
    end = jnp.clip(distance, views.entry, views.length)
    there = _rays_at(views, end, start.ground)
    through = jnp.exp(-jnp.maximum(_depth(field, start) - _depth(field, there), 0.0))
    beyond = through * _in_scattered(field, there, views.half_angle)
    inside = (sees & (end > views.entry))[:, None]
    inscatter = jnp.maximum(_in_scattered(field, start, views.half_angle) - beyond, 0.0)
    inscatter = jnp.where(inside, inscatter, 0.0) * scene.solar_irradiance[None]
    return Path(jnp.where(inside, through, 1.0), inscatter)


@eqx.filter_jit
def _fluxes(field: BrunetonField, scene: Scene) -> Irradiances:
    sun = jnp.cos(scene.sun_zenith)
    ground, tables = jnp.zeros_like(sun), field.tables
    direct = jnp.maximum(sun, 0.0) * sunlight(tables.optical_depth, ground, sun, field.sizes) * scene.solar_irradiance
    diffuse = irradiance(tables.irradiance, ground, sun, field.sizes) * scene.solar_irradiance
    reflectance = field.atmosphere.ground.reflectance(field.wavelength_nm)
    return Irradiances(direct, diffuse, reflectance * (direct + diffuse))
