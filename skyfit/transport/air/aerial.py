"""Aerial perspective: the effect of exponential air and haze on the light of distant objects, in closed form."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...atmosphere import AbstractConstituent, Atmosphere, Exponential
from ...numerics import check_range, exp_mean, phi_functions, Ranged, within
from ...scene import Scene
from ..contract import check_eye, Path
from ..optics import Optics, optics


# Largest distance (m) of objects; those further off are taken to be here.
_FARTHEST = 1e9
# Cosine below which a view is horizontal and does not meet the ground.
_LEVEL_COSINE = 1e-7
# Height of the mixed air in scale heights of the thinnest constituent; 5e-5 of that constituent lie above.
_RISE = 10.0
# Optical depth that the first pieces are spread over; measured errors hardly change from 1 to 3.
_FIRST_DEPTH = 2.0
# Extinction (m^-1) of air at a height of 180 km; its square is still a float32.
_NO_AIR = 1e-15


class AerialPerspective(Ranged):
    r"""Extinction and in-scatter between an eye and objects, for constituents that thin out exponentially.

    $L = L_0 \tau + \int_0^s \sum_i \beta_i P_i\, u_i(x)\, \tau(0..x)\, dx$, $u_i = e^{-h(x) / H_i}$,
    $h = h_0 + x \cos\theta$. `scattered_light` gives the light $P_i$ of sun, sky and ground, which does not vary along
    the view.

    In terms of the optical depth D from the eye the integral is $\int J e^{-D} dD$. The source function
    $J = \sum \beta_i P_i u_i / \sum \beta_c u_c$ is a mean of the $P_i$ and varies only as the mixture does. The
    view is cut into `pieces`. On each, J is the parabola in D that has its values at both ends and its mean, and
    $e^{-D}$ is exact, by phi functions: nothing is divided by $\cos\theta$ or by D. The result is exact for one
    constituent, for a horizontal view, for thick and for thin air. No light is gained or lost for any number of pieces
    ($P_i = 1$ gives $1 - \tau$ without absorption).

    **Valid:** constituents that scatter must have `Exponential` profiles, else `ValueError` (fog: `Shells`). Pure
    absorbers with another profile are left out: ozone's layer is 1.3e-7 m^-1 near the ground at 600 nm, 2 % over
    150 km. Polarisation is left out as in `scattered_light`, 4-9 % of the light that clear air scatters in the violet,
    1 % in the red. The Earth is flat: a view down ends at the ground, and an observer on the ground sees nothing below
    the horizon.
    The presets' errors are those of each constituent's integral alone against adaptive quadrature, for T 1-10, eyes at
    0-8 km and distances to 150 km, in either precision: experiments/validation/aerial_perspective.py.
    **Source:** Preetham 1999, sec. 4, eq. 5-9. The paper's K lacks a sign (eq. 7; transmittances above 1), its eq. 10
    has $e^{-H_1}$ for $H_1$, and its cubic in $u_1$ (A.4) with division by $K^4$ and $\cos\theta$ is 3 % off straight
    up at 5 km, useless at 20 km and in single precision.
    """

    pieces: int = eqx.field(static=True, default=9, metadata=within(2.0, np.inf))

    @classmethod
    def draft(cls) -> "AerialPerspective":
        """6 pieces: within 0.6 %."""
        return cls(6)

    @classmethod
    def normal(cls) -> "AerialPerspective":
        """9 pieces: within 0.1 %."""
        return cls()

    @classmethod
    def fine(cls) -> "AerialPerspective":
        """16 pieces: within 0.01 %."""
        return cls(16)

    def path(
        self,
        atmosphere: Atmosphere,
        scene: Scene,
        distance: Float[Array, " direction"],
        source: Float[Array, "constituent direction wavelength"],
    ) -> Path:
        """Effect of the air between the eye at `scene.height` and objects.

        **Arguments:** `distance` to the objects, m, infinite for the sky; `source`, the light that each scatterer
        scatters into each view, W m^-2 sr^-1 nm^-1, from `scattered_light`.
        **Returns:** `Path`. **Valid:** any view; objects beyond 1e9 m are taken to be at 1e9 m.
        """
        _check(atmosphere, scene, distance)
        return self._path(atmosphere, scene, distance, source)

    @eqx.filter_jit
    def _path(self, atmosphere: Atmosphere, scene: Scene, distance, source) -> Path:
        constituents = exponential_constituents(atmosphere)
        height, cosine, distance = _geometry(scene, distance)
        if not constituents:
            clear = jnp.zeros((distance.shape[0], scene.wavelength_nm.shape[0]))
            return Path(clear + 1.0, clear)
        scale = jnp.stack([c.profile.scale_height for c in constituents if isinstance(c.profile, Exponential)])
        depth = optics(constituents, scene.wavelength_nm)
        coefficient = Optics(depth.extinction / scale[:, None], depth.scattering / scale[:, None])
        whole = _column(height, height + distance * cosine, distance, scale)
        light = coefficient.scattering[:, None] * _at_scatterers(constituents, source)
        ends = self._ends(height, cosine, distance, coefficient, scale)
        inscatter = _inscatter(height, cosine, ends, coefficient.extinction, light, scale)
        return Path(jnp.exp(-(whole @ coefficient.extinction)), inscatter)

    def _ends(self, height, cosine, distance, coefficient: Optics, scale) -> Float[Array, "direction end"]:
        """Distances (m) of the ends of the pieces: dense at the eye where the air is thick, else even.

        The last piece is the air that lies so high that only one constituent is left.
        """
        at_eye = jnp.exp(-height / scale) @ coefficient.extinction
        length = _FIRST_DEPTH / jnp.maximum(jnp.mean(at_eye), 1.0 / _FARTHEST)
        rise = _RISE * jnp.min(scale)
        mixed = jnp.minimum(distance, rise / jnp.maximum(cosine, rise / _FARTHEST))
        share = jnp.arange(self.pieces) / (self.pieces - 1.0)
        within = length * jnp.expm1(jnp.log1p(mixed / length)[:, None] * share[None])
        return jnp.concatenate([within[:, :-1], mixed[:, None], distance[:, None]], axis=1)


def constant_ambient(
    atmosphere: Atmosphere,
    scene: Scene,
    distance: Float[Array, " direction"],
    ambient: Float[Array, " wavelength"],
) -> Path:
    r"""Ward-Larson's aerial perspective: one colour of air for all views, $L_{in} = L_a (1 - t^{s / 1\,km})$.

    **Arguments:** `distance` m; `ambient` $L_a$, W m^-2 sr^-1 nm^-1, the zenith's radiance in the paper. $t$ is the
    transmittance of 1 km of level air at the eye.
    **Returns:** `Path`. **Valid:** for comparison only: it depends neither on view nor on sun, and the air does not
    thin out with height.
    **Source:** Ward-Larson 1998, as Preetham 1999, sec. 5 and Fig. 8, have it.
    """
    _check(atmosphere, scene, distance)
    constituents = exponential_constituents(atmosphere)
    height, _, distance = _geometry(scene, distance)
    extinction = jnp.zeros_like(scene.wavelength_nm)
    for c in constituents:
        extinction = extinction + c.optical_depth_at(scene.wavelength_nm) * c.profile.density(height)
    slant = distance[:, None] * extinction[None]
    return Path(jnp.exp(-slant), -jnp.expm1(-slant) * ambient[None])


def _check(atmosphere: Atmosphere, scene: Scene, distance) -> None:
    check_eye(scene)
    check_range("distance", distance, 0.0, np.inf, "m")
    atmosphere.check_wavelengths(scene.wavelength_nm)


def exponential_constituents(atmosphere: Atmosphere) -> tuple[AbstractConstituent, ...]:
    """The constituents with exponential profiles; raises a `ValueError` if a scatterer has another profile."""
    for c in atmosphere.constituents:
        if c.phase is not None and not isinstance(c.profile, Exponential):
            raise ValueError(
                "`atmosphere` must have scatterers of `Exponential` profile for aerial perspective, "
                f"got {type(c).__name__} with {type(c.profile).__name__}: `Shells` has a path through layers"
            )
    return tuple(c for c in atmosphere.constituents if isinstance(c.profile, Exponential))


def _geometry(scene: Scene, distance):
    """Height of the eye, cosines of the views, and distances of the object or ground that they meet."""
    cosine = jnp.cos(scene.view.zenith)
    height = jnp.zeros_like(scene.sun_zenith) if scene.height is None else scene.height
    down = cosine < -_LEVEL_COSINE
    to_ground = jnp.where(down, height / jnp.where(down, -cosine, 1.0), _FARTHEST)
    return height, cosine, jnp.minimum(jnp.clip(distance, 0.0, _FARTHEST), to_ground)


def _at_scatterers(constituents: tuple[AbstractConstituent, ...], source):
    """The source with rows of zeros for pure absorbers."""
    scatters = [c.phase is not None for c in constituents]
    if source.shape[0] != sum(scatters):
        raise ValueError(f"`source` must have a row for each of {sum(scatters)} scatterers, got {source.shape}")
    rows = iter(source)
    return jnp.stack([next(rows) if s else jnp.zeros_like(source[0]) for s in scatters])


def _column(start, end, length, scale) -> Float[Array, "*shape constituent"]:
    """Length (m) that, times the density at the ground, is the column of a ray from one height to another."""
    start, end = jnp.broadcast_arrays(start, end)
    rate = jnp.expand_dims(1.0 / scale, range(end.ndim))
    return length[..., None] * exp_mean(start[..., None] * rate, end[..., None] * rate)


def _inscatter(height, cosine, ends, extinction, light, scale) -> Float[Array, "direction wavelength"]:
    levels = height + ends * cosine[:, None]
    step = jnp.diff(ends, axis=1)
    density = jnp.exp(-levels[..., None] / scale[None, None])
    column = _column(levels[:, :-1], levels[:, 1:], step, scale)
    depth = column @ extinction
    before = jnp.cumsum(depth, axis=1) - depth
    rate = density @ extinction + _NO_AIR
    # Source function times the piece's optical depth: emission per metre times the ratio of optical depth to rate.
    emitted = jnp.einsum("dec,cdw->dew", density, light)
    passed = depth + _NO_AIR * step[..., None]
    near = emitted[:, :-1] * (passed / rate[:, :-1])
    far = emitted[:, 1:] * (passed / rate[:, 1:])
    mean = jnp.einsum("dec,cdw->dew", column, light)
    first, second, third = phi_functions(depth, 3)
    bulge = 6.0 * (mean - 0.5 * (near + far)) * (second - 2.0 * third)
    piece = near * second + far * (first - second) + bulge
    return jnp.sum(jnp.exp(-before) * piece, axis=1)
