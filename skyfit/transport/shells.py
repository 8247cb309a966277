"""Shells: homogeneous layers of air and haze around the Earth, and fog on a flat one."""

from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..atmosphere import AbstractConstituent, Atmosphere
from ..numerics import exp_mean, gauss_legendre, safe_sqrt, within
from ..scene import above_horizon, haversine, Scene
from .columns import EARTH_RADIUS, height_gain, length_scale, MIN_COSINE, slant_column
from .contract import (
    AbstractSolver,
    check_geometry,
    checked,
    Geometry,
    Irradiances,
    Observers,
    ON_GROUND,
    Path,
    SCALAR_ERROR,
    Suns,
)
from .dome import fluxes_by_quadrature
from .optics import optics, scatterer_indices
from .views import in_pieces


# Least density (m^-1): a constituent that is absent at the ground gets a layer of 1000 km, not of infinite thickness.
_MIN_DENSITY = 1e-6
# Distance (m) that stands for infinity, as of the sky in a depth image on a horizontal view.
_FAR = 1e9
# Cosine below which a view is horizontal and meets neither the ground nor the top of a layer.
_LEVEL_COSINE = 1e-7
# Errors that 95 % of views to 85 degrees stay under, against `SingleScattering.fine` on a sphere, haze to 0.3: for a
# sun at 85 degrees, and at 89.9 (0.4 at 88).
_FLAT_SUNS, _SPHERICAL_SUNS = Suns(85.0, 0.3), Suns(90.0, 0.8)


class ShellLayers(NamedTuple):
    """Homogeneous layers from the ground up, one for each constituent that scatters.

    `top` in m; `extinction` and `scattering` coefficients in m^-1; `level`, the tops in ascending order; `present`,
    whether a constituent reaches into the piece under each level.
    """

    top: Float[Array, " constituent"]
    extinction: Float[Array, "constituent wavelength"]
    scattering: Float[Array, "constituent wavelength"]
    level: Float[Array, " level"]
    present: Array


def layers(constituents: tuple[AbstractConstituent, ...], wavelength_nm: Float[Array, " wavelength"]) -> ShellLayers:
    r"""Layers with each constituent's column and its density at the ground, $R - R_E = \tau / (\tau \rho(0))$.

    **Arguments:** `constituents` that scatter, one at least. **Returns:** `ShellLayers`.
    **Valid:** profiles whose density at the ground exceeds 1e-6 m^-1; layers aloft do not fit the model.
    **Source:** Klassen 1987, sec. 6: a reduced, "effective" radius stands for the density's fall with height.
    """
    ground = jnp.zeros_like(wavelength_nm[0])
    density = jnp.stack(
        [jnp.maximum(c.profile.density(ground) / c.profile.column_above(ground), 0.0) for c in constituents]
    )
    top = 1.0 / jnp.maximum(density, _MIN_DENSITY)
    extinction, scattering = optics(constituents, wavelength_nm)
    # Compare ranks, not heights: where two tops are equal, the gradient is that of one order, and right.
    rank = jnp.argsort(jnp.argsort(top))
    present = rank[None] >= jnp.arange(top.shape[0])[:, None]
    return ShellLayers(top, extinction / top[:, None], scattering / top[:, None], jnp.sort(top), present)


def sun_transmittance(
    constituents: tuple[AbstractConstituent, ...], scene: Scene, geometry: Geometry, above: Array | None = None
) -> Float[Array, " wavelength"]:
    r"""The colour of the sun, $e^{-\beta_m (d_1 + d_2) - \beta_p d_2}$; 0 with the sun below the horizon.

    **Arguments:** `above`, a height in m that the light comes down to, None for the ground. **Returns:**
    dimensionless; a constituent without a phase function attenuates by its column toward the sun from the ground.
    **Source:** Klassen 1987, eq. 22, which prints $e^{+\beta d}$ (and eq. 13): a transmittance is at most 1, as by
    his eq. 4; $d_1$ (eq. 20) has the sun's elevation of the ground at every sphere, 1.5 times too long at 2
    degrees: the ray keeps $r \cos\phi_r$.
    """
    cosine = jnp.cos(scene.sun_zenith)
    # On a sphere a sun on the horizon shines, whatever the rounding of pi / 2.
    lit = cosine > (-_LEVEL_COSINE if geometry == "spherical" else 0.0)
    cosine = jnp.maximum(cosine, 0.0)
    depth = jnp.zeros_like(scene.wavelength_nm)
    for c in constituents:
        if c.phase is None:
            column = slant_column(c.profile, jnp.zeros_like(cosine), cosine, geometry)
            depth = depth + column * c.optical_depth_at(scene.wavelength_nm)
    places = scatterer_indices(constituents)
    if places:
        air = layers(tuple(constituents[i] for i in places), scene.wavelength_nm)
        path = _sun_path(air.top, cosine, geometry)
        if above is not None:
            path = path - _sun_path(jnp.minimum(above, air.top), cosine, geometry)
        depth = depth + path @ air.extinction
    return jnp.where(lit, jnp.exp(-depth), 0.0)


def _sun_path(height, cosine, geometry: Geometry):
    """Distance along the sun's ray from the ground to `height`, m."""
    if geometry == "flat":
        return height / jnp.maximum(cosine, MIN_COSINE)
    return length_scale(EARTH_RADIUS, cosine, height)


def shell_integral(air: ShellLayers, scene: Scene, nodes: int) -> Float[Array, "direction constituent wavelength"]:
    r"""Light that a unit of scattering coefficient of each constituent sends to the ground along each view, m.

    $\int e^{-\sum \beta_c (d_{sun,c}(r) + d_{view,c}(l))} dl$ by Gauss nodes in $l$ on each layer's piece of the view.

    **Arguments:** `nodes` for each piece.
    **Returns:** `[direction, constituent, wavelength]`, without attenuation by pure absorbers.
    **Source:** Klassen 1987, eq. 23-26. His eq. 27 and 28 take $l(r)$ linear in $r$ (and print it with a wrong
    dimension), 16 % off at 2 degrees: here $r$ follows from $l$. His eq. 24 and 25 have the sun's elevation of the
    ground at every sphere: here it is the local one, $r \sin\phi_r = R_E \sin\phi + l \cos\psi$, which keeps
    $r \cos\phi_r = R_E \cos\phi$ on the way to the sun and $\phi_r = \phi$ straight up.
    """
    cosine = jnp.maximum(jnp.cos(scene.view.zenith), 0.0)
    half = haversine(scene.view.zenith, scene.sun_zenith, scene.view.azimuth - scene.sun_azimuth)
    x, weight = (jnp.asarray(v, cosine.dtype) for v in gauss_legendre(nodes))
    edge = length_scale(EARTH_RADIUS, cosine[:, None], air.level[None])
    start = jnp.concatenate([jnp.zeros_like(edge[:, :1]), edge[:, :-1]], axis=1)
    step = edge - start
    distance = start[..., None] + step[..., None] * x[None, None]
    height = height_gain(EARTH_RADIUS, cosine[:, None, None], distance)
    sunward = EARTH_RADIUS * jnp.maximum(jnp.cos(scene.sun_zenith), 0.0) + distance * (1.0 - 2.0 * half)[:, None, None]
    inside = air.present[None, :, None]
    whole = length_scale(EARTH_RADIUS, cosine[:, None], air.top[None])[:, None, None]
    seen = jnp.where(inside, distance[..., None], whole)
    column = seen + _toward_sun(height[..., None], sunward[..., None], air.top[None, None, None], inside)
    transmittance = jnp.exp(-(column @ air.extinction))
    piece = jnp.einsum("dl,n,dlnw->dlw", step, weight, transmittance)
    return jnp.einsum("lc,dlw->dcw", air.present.astype(step.dtype), piece)


def _toward_sun(height, sunward, top, inside):
    """Distance (m) within a layer toward the sun; `sunward` is the radius times the sine of the local elevation."""
    rise = (top - height) * (2.0 * EARTH_RADIUS + top + height)
    # 1 m^2 corresponds to a height of 0.1 micrometres.
    guarded = jnp.where(inside, jnp.maximum(rise, 1.0), 1.0)
    root = jnp.sqrt(sunward**2 + guarded)
    out = root + jnp.abs(sunward)
    # A ray that starts above the layer and first descends may dip into it.
    dip = jnp.where(sunward < 0.0, 2.0 * safe_sqrt(sunward**2 + rise), 0.0)
    return jnp.where(inside, jnp.where(sunward >= 0.0, guarded / out, out), dip)


def layer_path(
    air: ShellLayers, scene: Scene, distance: Float[Array, " direction"], beam: bool = True
) -> tuple[Array, Array]:
    r"""Integrals in closed form through layers of constant density over a flat Earth, for any eye and any view.

    The exponent is linear in the distance within a layer, so each piece gives its length times `exp_mean`.

    **Arguments:** `distance` along each view, m, from the eye at `scene.height`; `beam`, whether the light comes down
    through the layers (else it is the same everywhere).
    **Returns:** the view's optical depth `[direction, wavelength]` and, as `shell_integral`,
    `[direction, constituent, wavelength]`. **Valid:** distances end at the ground and at 1e9 m.
    **Source:** Klassen 1987, eq. 36-46 without his $d_2$ = const, which is the limit of an eye near the ground;
    eq. 47 prints the sign of eq. 40 wrongly: an extinction has a minus.
    """
    eye = jnp.zeros_like(scene.sun_zenith) if scene.height is None else scene.height
    cosine, sun = jnp.cos(scene.view.zenith), jnp.maximum(jnp.cos(scene.sun_zenith), MIN_COSINE)
    slope = jnp.where(jnp.abs(cosine) < _LEVEL_COSINE, _LEVEL_COSINE, cosine)
    rising = slope > 0.0
    to_ground = jnp.where(rising, _FAR, eye / jnp.where(rising, 1.0, -slope))
    end = jnp.minimum(jnp.clip(distance, 0.0, _FAR), to_ground)

    def crossing(height):
        return jnp.clip((height[None] - eye) / slope[:, None], 0.0, end[:, None])

    level, top = crossing(air.level), crossing(air.top)
    # Under the lowest level a view begins at the eye, or ends at its own end.
    under = jnp.concatenate([jnp.where(rising, 0.0, end)[:, None], level[:, :-1]], axis=1)
    near, far = jnp.where(rising[:, None], under, level), jnp.where(rising[:, None], level, under)

    def depth(at):
        """Optical depth from the eye to a place on the view and on to the sun, `[direction, place, wavelength]`."""
        place = at[..., None]
        seen = jnp.where(rising[:, None, None], jnp.minimum(place, top[:, None]), jnp.maximum(place - top[:, None], 0))
        if not beam:
            return seen @ air.extinction
        height = eye + cosine[:, None, None] * place
        return (seen + jnp.maximum(air.top[None, None] - height, 0.0) / sun) @ air.extinction

    piece = (far - near)[..., None] * exp_mean(depth(near), depth(far))
    seen = jnp.where(rising[:, None], top, end[:, None] - top)
    return seen @ air.extinction, jnp.einsum("lc,dlw->dcw", air.present.astype(piece.dtype), piece)


class Shells(AbstractSolver):
    r"""Klassen's sky and fog: single scattering in homogeneous layers with sharp tops.

    $L = E_0 \sum_c \beta_c p_c(\psi) \int e^{-\beta_m d_1 - (\beta_m + \beta_p)(d_2 + d_3)} dl$

    Every constituent that scatters is a layer from the ground up (`layers`). `geometry`: "spherical" is the sky of
    concentric layers; "flat" is the fog, in closed form and with `path`. `nodes`: Gauss nodes for each layer's piece of
    a view (flat: none). `blue_sky`: with "scattered" the air (the constituent named `rayleigh`) scatters like the haze.
    With "constant" (spherical) only haze scatters, within its layer, in front of Klassen's constant blue
    $E_0 (1 - e^{-\tau_m}) \sin\phi / 4\pi$. Klassen gives no scale of brightness; the sine of the sun's elevation is
    the one taken here. `low_sun` (flat): no direct light passes the fog, which sends to the eye its opacity times the
    sunlight above it, isotropic, $E / 4\pi$. The air still scatters the beam.

    **Valid:** sun above the horizon, else black; views above the horizon, else 0. The presets are within 1 % for slant
    optical depths of one layer up to 40, 150 and over 300 (beyond, nodes miss the bright near end; flat: any depth).
    For a sun within a degree of the horizon and behind the eye they are within 5, 0.4 and 0.8 %, where its rays graze a
    top. Polarisation has no effect on the radiance of light that is scattered once.
    **Source:** Klassen 1987, ACM Trans. Graph. 6, 215; the scattering angle is the one between the two directions
    (his $\theta + \phi$ of eq. 41 holds in the sun's vertical plane only).
    """

    nodes: int = eqx.field(static=True, default=16, metadata=within(1.0, np.inf))
    geometry: Geometry = eqx.field(static=True, default="spherical")
    blue_sky: Literal["scattered", "constant"] = eqx.field(static=True, default="scattered")
    low_sun: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        check_geometry(self.geometry)
        if self.blue_sky not in ("scattered", "constant"):
            raise ValueError(f'`blue_sky` must be "scattered" or "constant", got {self.blue_sky!r}')
        if self.blue_sky == "constant" and self.geometry == "flat":
            raise ValueError('`blue_sky` must be "scattered" in "flat" geometry, got "constant"')
        if self.low_sun and self.geometry == "spherical":
            raise ValueError('`low_sun` must be False in "spherical" geometry, got True')

    @classmethod
    def draft(cls, geometry: Geometry = "spherical") -> "Shells":
        """8 nodes."""
        return cls(nodes=8, geometry=geometry)

    @classmethod
    def normal(cls, geometry: Geometry = "spherical") -> "Shells":
        """16 nodes."""
        return cls(nodes=16, geometry=geometry)

    @classmethod
    def fine(cls, geometry: Geometry = "spherical") -> "Shells":
        """48 nodes."""
        return cls(nodes=48, geometry=geometry)

    @property
    def suns(self) -> Suns:
        # The light of a low sun reaches the fog through curved air.
        return _SPHERICAL_SUNS if self.geometry == "spherical" or self.low_sun else _FLAT_SUNS

    @property
    def observers(self) -> Observers:
        return ON_GROUND

    @property
    def model_error(self) -> float:
        return SCALAR_ERROR

    def coarser(self) -> AbstractSolver:
        return self

    @checked
    def radiance(self, atmosphere: Atmosphere, scene: Scene) -> Float[Array, "direction wavelength"]:
        """Sky radiance of the layers, W m^-2 sr^-1 nm^-1, for an observer on the ground."""
        return in_pieces(lambda scene: _radiance(self, atmosphere, scene), scene)

    @checked
    def fluxes(self, atmosphere: Atmosphere, scene: Scene) -> Irradiances:
        """Irradiance on the ground: the sun's colour (eq. 22), the sky by quadrature, the ground's reflection."""
        beam = sun_transmittance(atmosphere.constituents, scene, self.geometry)
        return fluxes_by_quadrature(
            lambda sky: _radiance(self, atmosphere, sky), atmosphere, scene, scene.solar_irradiance * beam
        )

    @checked
    def path(self, atmosphere: Atmosphere, scene: Scene, distance: Float[Array, " direction"]) -> Path:
        """Fog, haze and air between the eye and objects; `.over(image)` adds them to a finished image.

        **Arguments:** `distance` of the objects along each view, m, infinite for the sky. The eye, at `scene.height`,
        may be in or above the fog; views may go up, level and down. **Returns:** `Path`.
        **Valid:** "flat" geometry, else `ValueError`; constituents without a phase function filter the sun only.
        """
        if self.geometry != "flat":
            raise ValueError('`geometry` must be "flat" for the path to objects, got "spherical"')
        return _path(self, atmosphere, scene, distance)


def _scatterers(atmosphere: Atmosphere) -> tuple[AbstractConstituent, ...]:
    return tuple(c for c in atmosphere.constituents if c.phase is not None)


def _is_air(atmosphere: Atmosphere) -> list[bool]:
    """Whether each scatterer is the air."""
    named = zip(atmosphere.names, atmosphere.constituents, strict=True)
    return [name == "rayleigh" for name, c in named if c.phase is not None]


def _absorbers(atmosphere: Atmosphere) -> tuple[AbstractConstituent, ...]:
    return tuple(c for c in atmosphere.constituents if c.phase is None)


def _scattered(integral, air: ShellLayers, constituents, scene: Scene):
    """The sum over constituents of phase function, scattering coefficient and integral."""
    half = haversine(scene.view.zenith, scene.sun_zenith, scene.view.azimuth - scene.sun_azimuth)
    total = jnp.zeros_like(integral[:, 0])
    for i, c in enumerate(constituents):
        total = total + c.phase.at_haversine(half, scene.wavelength_nm) * air.scattering[i][None] * integral[:, i]
    return total


def _path(solver: Shells, atmosphere: Atmosphere, scene: Scene, distance) -> Path:
    scatterers = _scatterers(atmosphere)
    if not scatterers:
        nothing = jnp.zeros((scene.view.zenith.shape[0], scene.wavelength_nm.shape[0]))
        return Path(nothing + 1.0, nothing)
    air = layers(scatterers, scene.wavelength_nm)
    depth, integral = layer_path(air, scene, distance)
    beam = scene.solar_irradiance * sun_transmittance(_absorbers(atmosphere), scene, "flat")
    clear = _is_air(atmosphere)
    fog = [i for i, is_clear in enumerate(clear) if not is_clear]
    if not (solver.low_sun and fog):
        return Path(jnp.exp(-depth), _scattered(integral, air, scatterers, scene) * beam[None])
    by_air = jnp.where(jnp.array(clear)[None, :, None], integral, 0.0)
    inscatter = _scattered(by_air, air, scatterers, scene) * beam[None]
    # The light of so low a sun comes through curved air.
    above = jnp.max(jnp.stack([air.top[i] for i in fog]))
    around = scene.solar_irradiance * sun_transmittance(atmosphere.constituents, scene, "spherical", above)
    _, lit = layer_path(air, scene, distance, beam=False)
    for i in fog:
        inscatter = inscatter + air.scattering[i][None] * lit[:, i] * (around / (4.0 * np.pi))[None]
    return Path(jnp.exp(-depth), inscatter)


def _radiance(solver: Shells, atmosphere: Atmosphere, scene: Scene):
    scatterers, zenith = _scatterers(atmosphere), scene.view.zenith
    if not scatterers:
        return jnp.zeros((zenith.shape[0], scene.wavelength_nm.shape[0]))
    above = above_horizon(zenith)[:, None]
    if solver.geometry == "flat":
        slanted = eqx.tree_at(lambda s: s.view.zenith, scene, jnp.minimum(zenith, np.arccos(MIN_COSINE)))
        beyond = jnp.full(zenith.shape, _FAR, zenith.dtype)
        return jnp.where(above, _path(solver, atmosphere, slanted, beyond).inscatter, 0.0)
    air = layers(scatterers, scene.wavelength_nm)
    beam = scene.solar_irradiance * sun_transmittance(_absorbers(atmosphere), scene, "spherical")
    integral = shell_integral(air, scene, solver.nodes)
    blue = jnp.zeros_like(integral[:, 0])
    if solver.blue_sky == "constant":
        haze = ~jnp.array(_is_air(atmosphere))
        integral = jnp.where(haze[None, :, None], integral, 0.0)
        blue = _constant_blue(air, haze, scene)
    return jnp.where(above, _scattered(integral, air, scatterers, scene) * beam[None] + blue, 0.0)


def _constant_blue(air: ShellLayers, haze, scene: Scene):
    """Klassen's blue behind the haze (opacity eq. 31): the fraction of each wavelength that air scatters."""
    cosine = jnp.maximum(jnp.cos(scene.view.zenith), 0.0)
    beneath = jnp.where(haze[None], length_scale(EARTH_RADIUS, cosine[:, None], air.top[None]), 0.0) @ air.extinction
    fraction = -jnp.expm1(-jnp.where(haze, 0.0, air.top) @ air.extinction)
    brightness = scene.solar_irradiance * fraction * jnp.maximum(jnp.cos(scene.sun_zenith), 0.0) / (4.0 * np.pi)
    return brightness[None] * jnp.exp(-beneath)
