"""Long spectra: the streams solve a few wavelengths, coarse streams all of them."""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...atmosphere import Atmosphere
from ...numerics import chebyshev_nodes, chebyshev_weights, concrete
from ...scene import above_horizon, Scene
from .layering import Resolution, scaled_optics
from .reconstruct import Multiple, multiple_scattering


# Albedo of the lit ground. Streams solve over it and over a black one; light over any other follows from the two.
_LIT = 0.8
# Nodes over a black ground: this many per unit of ln(wavelength), less one. 8 from 380 to 780 nm, 16 from 300 to 1100.
_DENSITY = 12.5
# Least number of nodes over a black ground. Numbers over a black and a lit one for 300 to 1100 nm, which are the most
# and serve where wavelengths are traced.
_LEAST, _MOST = 4, (16, 8)
# With F nodes, W wavelengths and V views, a quarter of the time is saved where V (W + 2 F) is below this times
# (W - 1.6 F). Coarse streams look at all wavelengths over two grounds, which costs as much per view as full streams.
_VIEWS = 370.0
# Shares of the diffuse light's mean radiance: the floor of coarse light, which may undershoot where there is little,
# and the value to which light is drawn there. Last, the least error of an interpolant.
_LEAST_SHARE, _DRAWN, _LEAST_MISSED = 1e-3, 1.0, 1e-6
# Largest ratio of full to coarse streams. If they are further apart, neither is right.
_FAR = 1e3
# Radiance, sr^-1 per unit irradiance, below which light counts as black. Its square is still a float32.
_DARK = 1e-16


class SpectralNodes(NamedTuple):
    """Numbers of wavelengths, static, at which streams solve over a black ground and over a lit one."""

    black: int
    lit: int


def spectral_nodes(atmosphere: Atmosphere, scene: Scene, asked: int | None) -> SpectralNodes | None:
    """Numbers of wavelengths of a spectrum that streams solve; None for each of the scene's.

    Streams solve each wavelength where that costs about as much or less. They also do where a constituent is known at
    the scene's wavelengths alone, or absorbs in bands low in the air: coarse streams get these wrong by per cents.

    **Arguments:** `asked`, the number over a black ground, 0 for each wavelength, None for as many as the range of
    wavelengths needs.
    """
    count = scene.wavelength_nm.shape[-1]
    if asked == 0 or not all(c.factors_out for c in atmosphere.constituents):
        return None
    if asked is not None:
        return SpectralNodes(asked, (asked + 1) // 2) if asked < count else None
    known, most = concrete(scene.wavelength_nm), SpectralNodes(*_MOST)
    if known is not None and known.size:
        black = min(max(_LEAST, math.ceil(_DENSITY * math.log(known.max() / known.min()) - 1.0)), _MOST[0])
        most = SpectralNodes(black, black // 2)
    nodes, views = sum(most), scene.view.zenith.shape[0]
    saves = views * (count + 2 * nodes) < _VIEWS * (count - 1.6 * nodes)
    return most if count > 2 * nodes and saves else None


def interpolated(
    atmosphere: Atmosphere, scene: Scene, resolution: Resolution, few: SpectralNodes, stokes: bool
) -> Float[Array, "stokes direction wavelength"]:
    r"""Multiple scattering at all wavelengths of a scene, by the ratio of full to coarse streams at a few.

    The coarse streams contain ozone, ground and haze of each wavelength, so the ratio is smooth. Over a Lambertian
    ground of albedo A the light is $(1 - y) L(0) + y L(A_1)$ with $y = \frac{A (1 - A_1 s)}{A_1 (1 - A s)}$, where s is
    the spherical albedo of the atmosphere. This is exact for any ground.

    **Returns:** as `multiple_scattering`'s `light`, per unit solar irradiance.
    **Source:** low-streams interpolation, O'Dell 2010, J. Geophys. Res. 115, D10206; the ground: Chandrasekhar 1950.
    """
    wavelength = scene.wavelength_nm
    low, high = jnp.log(jnp.min(wavelength)), jnp.log(jnp.max(wavelength))

    def nodes(count):
        unit = jnp.asarray(chebyshev_nodes(count), wavelength.dtype)
        return jnp.exp(0.5 * (low + high) + 0.5 * (high - low) * unit)

    def spread(at_nodes, to):
        """Interpolate values at the nodes of one ground to other wavelengths."""
        place = (2.0 * jnp.log(to) - low - high) / jnp.maximum(high - low, 1e-9)
        return at_nodes @ chebyshev_weights(place, at_nodes.shape[-1]).T

    def cut(values, *sizes):
        ends = [sum(sizes[: i + 1]) for i in range(len(sizes) - 1)]
        return jnp.split(values, ends, axis=-1)

    black, lit = nodes(few.black), nodes(few.lit)
    constituents, few_streams = atmosphere.constituents, resolution.coarse()
    solved = multiple_scattering(
        constituents,
        scene,
        scaled_optics(constituents, jnp.concatenate([black, lit]), resolution),
        jnp.concatenate([jnp.zeros_like(black), jnp.full_like(lit, _LIT)]),
        resolution,
        stokes,
    )
    every = jnp.concatenate([wavelength, black, lit])
    coarse = multiple_scattering(
        constituents,
        scene,
        scaled_optics(constituents, jnp.concatenate([every, every]), few_streams),
        jnp.concatenate([jnp.zeros_like(every), jnp.full_like(every, _LIT)]),
        few_streams,
    )
    sizes = (*wavelength.shape, few.black, few.lit)
    over_black, over_lit = cut(jnp.concatenate([solved.light[0], _flux(solved)[None]]), few.black, few.lit)

    def by(reference):
        """Light at all wavelengths over both grounds by one reference, and the error of a smaller interpolant."""
        dark, dark_black, dark_lit, bright, _, bright_lit = cut(reference, *sizes, *sizes)
        ratio = _log_ratio(over_black, dark_black)
        # What the ground adds to the ratio is smoother still.
        more = _log_ratio(over_lit, bright_lit) - spread(ratio, lit)
        everywhere = spread(ratio, wavelength)
        found_black = jnp.where(_any_light(over_black), dark * _exp(everywhere), 0.0)
        found_lit = jnp.where(_any_light(over_lit), bright * _exp(everywhere + spread(more, wavelength)), 0.0)
        return found_black, found_lit, _missed(ratio) + _missed(more)

    # In directions where coarse streams oscillate about zero, the ratio to the mean light is smoother.
    own, mean = (by(light) for light in _positive(coarse, _air_seen(atmosphere, scene)))
    off, other = (jnp.maximum(found[2], _LEAST_MISSED) ** 2 for found in (own, mean))
    rest = off / (off + other)
    found_black, found_lit = (one + rest * (more - one) for one, more in zip(own[:2], mean[:2], strict=True))

    spherical_albedo = (1.0 - _share(found_black[-1], found_lit[-1])) / _LIT
    albedo = atmosphere.ground.reflectance(wavelength)
    lit_share = (albedo * (1.0 - _LIT * spherical_albedo) / (_LIT * (1.0 - albedo * spherical_albedo)))[None]
    lights = (1.0 - lit_share) * found_black[:-1], lit_share * found_lit[:-1]
    # Q and U, over the radiance
    shares = cut(_share(solved.light[1:], solved.light[:1]), few.black, few.lit)
    polarised = lights[0][None] * spread(shares[0], wavelength) + lights[1][None] * spread(shares[1], wavelength)
    return jnp.concatenate([(lights[0] + lights[1])[None], polarised])


def _flux(found: Multiple):
    return found.diffuse + found.beam


def _air_seen(atmosphere: Atmosphere, scene: Scene) -> Float[Array, " direction"] | None:
    """Largest share of a scatterer above the observer for views up, 1 for views down; None on the ground."""
    if scene.height is None:
        return None
    left = [c.profile.column_above(scene.height) for c in atmosphere.constituents if c.phase is not None]
    return jnp.where(above_horizon(scene.view.zenith), jnp.max(jnp.stack(left)), 1.0)


def _positive(found: Multiple, seen: Float[Array, " direction"] | None):
    """Radiances and, as the last row, the flux onto the ground: with a floor, and drawn to the diffuse light's mean.

    The floor of the first is a share of that mean. The second are never far below it.
    """
    mean = (found.diffuse / np.pi)[None]
    if seen is not None:
        mean = jnp.pad(seen, (0, 1), constant_values=1.0)[:, None] * mean
    # The square root below has no derivative at 0.
    mean = jnp.maximum(mean, _DARK)
    light = jnp.concatenate([found.light[0], _flux(found)[None]])
    drawn = 0.5 * (light + jnp.sqrt(light**2 + (2.0 * _DRAWN * mean) ** 2))
    return tuple(jnp.maximum(one, _DARK) for one in (jnp.maximum(light, _LEAST_SHARE * mean), drawn))


def _missed(ratio: Float[Array, "row node"]) -> Float[Array, "row 1"]:
    """Largest error at the nodes of the interpolant without the last quarter of its coefficients."""
    count = ratio.shape[-1]
    if count == 1:
        # A single node has no smaller interpolant.
        return jnp.zeros_like(ratio)
    at = jnp.asarray(chebyshev_nodes(count), ratio.dtype)
    kept = ratio @ chebyshev_weights(at, count, count - max(1, count // 4)).T
    return jnp.max(jnp.abs(ratio - kept), axis=-1, keepdims=True)


def _any_light(found):
    return jnp.any(found > _DARK, axis=-1, keepdims=True)


def _log_ratio(found, reference):
    return jnp.log(jnp.clip(found / reference, 1.0 / _FAR, _FAR))


def _exp(ratio):
    # Interpolation between far ratios must not run away.
    return jnp.exp(jnp.clip(ratio, -math.log(_FAR), math.log(_FAR)))


def _share(part, whole):
    """`part` over `whole`; 0 where `whole` is dark."""
    dark = jnp.abs(whole) <= _DARK
    return jnp.where(dark, 0.0, part / jnp.where(dark, 1.0, whole))
