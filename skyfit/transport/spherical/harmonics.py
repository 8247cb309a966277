"""Harmonics about the sun's axis, which represent the light of a spherical atmosphere."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...numerics import legendre_series, of_angle, safe_sqrt


# Lengths that count as zero: of unit vectors, and in metres.
_NONE, _NO_LENGTH = 1e-9, 1.0
# Harmonics of degrees below this are carried along curved paths.
TRAVELLING = 3


def kept(moments: int, peaked: bool) -> list[tuple[int, int]]:
    """Degrees and modes of the harmonics that are kept; air alone needs degrees below 3."""
    degrees = range(moments if peaked else TRAVELLING)
    return [(degree, mode) for degree in degrees for mode in range(degree + 1)]


def travelling(harmonics: list[tuple[int, int]]) -> int:
    """Number of harmonics, the first ones, whose light is carried along curved paths."""
    return sum(degree < TRAVELLING for degree, _ in harmonics)


def along_sun(zenith_cosine, azimuth, sun_zenith):
    """Components of views along the sun's axis, out from it on the side of the vertical, and aside."""
    sine = safe_sqrt(1.0 - zenith_cosine**2)
    toward = sine * jnp.cos(azimuth)
    sin_sun, cos_sun = jnp.sin(sun_zenith), jnp.cos(sun_zenith)
    return (
        zenith_cosine * cos_sun + toward * sin_sun,
        zenith_cosine * sin_sun - toward * cos_sun,
        sine * jnp.sin(azimuth),
    )


def of_views(harmonics, along, out, aside) -> Float[Array, "harmonic ..."]:
    r"""$\Lambda_l^m(\theta) \cos m\phi$ of unit vectors given along the sun's axis, out from it and aside."""
    across = safe_sqrt(out**2 + aside**2)
    angle = jnp.arctan2(across, along)
    turn = jnp.arctan2(aside, jnp.where(across > _NONE, out, 1.0))
    modes = max(mode for _, mode in harmonics) + 1
    series = legendre_series(modes, max(degree for degree, _ in harmonics) + 1)
    degree, mode = np.array(harmonics).T
    around = jnp.cos(jnp.arange(modes, dtype=along.dtype).reshape(-1, *[1] * along.ndim) * turn[None])
    return jnp.asarray(of_angle(series[degree, mode], angle)) * around[mode]


def carried(harmonics, along, out, aside, place_out, place_aside) -> list[Float[Array, "..."]]:
    r"""$\Lambda_l^m(\theta) \cos m(\phi_v - \phi_y)$ to l = 2 of views, seen from places away from the sun's axis.

    **Arguments:** the components of the views' unit vectors; the places' components across the axis, m.
    """
    distance = safe_sqrt(place_out**2 + place_aside**2)
    lean = jnp.where(
        distance > _NO_LENGTH, (place_out * out + place_aside * aside) / jnp.maximum(distance, _NO_LENGTH), out
    )
    across = out**2 + aside**2
    known = {
        (0, 0): jnp.ones_like(lean),
        (1, 0): along + 0.0 * lean,
        (1, 1): np.sqrt(0.5) * lean,
        (2, 0): 1.5 * along**2 - 0.5 + 0.0 * lean,
        (2, 1): np.sqrt(1.5) * along * lean,
        (2, 2): np.sqrt(0.375) * (2.0 * lean**2 - across),
    }
    return [known[pair] for pair in harmonics if pair[0] < TRAVELLING]


def weights(harmonics) -> np.ndarray:
    r"""$(2 - \delta_{m0}) / 4\pi$, the factor of the addition theorem beside $(2l+1)\chi_l$."""
    return np.array([(1.0 if mode == 0 else 2.0) for _, mode in harmonics]) / (4.0 * np.pi)
