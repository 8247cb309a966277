"""Directions of view and the angles between directions."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from ..numerics import as_float, as_float_or_none, check_radians, radians_within, Ranged, safe_sqrt, within


LOWEST_VISIBLE = -1e-6  # smallest cosine of the zenith angle of a view that still counts as horizontal
MOST_AZIMUTH = 4.0 * np.pi  # largest azimuth in either direction, rad; beyond two turns the value is probably degrees


def haversine(zenith_1, zenith_2, azimuth_difference):
    r"""$\sin^2(\gamma/2)$ of the angle between two directions, accurate for tiny angles.

    $\sin^2\frac{\gamma}{2} = \sin^2\frac{\theta_1-\theta_2}{2} + \sin\theta_1\sin\theta_2\sin^2\frac{\Delta\phi}{2}$

    **Arguments:** zenith angles and azimuth difference, radians, broadcastable.
    **Returns:** dimensionless, in [0, 1]. **Valid:** everywhere, with finite gradients.
    **Source:** the haversine formula of spherical trigonometry.
    """
    value = (
        jnp.sin(0.5 * (zenith_1 - zenith_2)) ** 2
        + jnp.sin(zenith_1) * jnp.sin(zenith_2) * jnp.sin(0.5 * azimuth_difference) ** 2
    )
    return jnp.clip(value, 0.0, 1.0)


def angle_between(zenith_1, zenith_2, azimuth_difference):
    """The angle between two directions, radians; value 0 and gradient 0 where they coincide.

    **Arguments:** zenith angles and azimuth difference, radians, broadcastable.
    **Returns:** radians, in [0, pi]. **Valid:** everywhere.
    """
    half = haversine(zenith_1, zenith_2, azimuth_difference)
    return 2.0 * jnp.arctan2(safe_sqrt(half), safe_sqrt(1.0 - half))


def above_horizon(zenith: Float[Array, " direction"]) -> Bool[Array, " direction"]:
    """Whether a view meets the sky; the horizontal view does, regardless of the rounding of pi / 2."""
    return jnp.cos(zenith) > LOWEST_VISIBLE


class Directions(Ranged):
    """Directions of view: zenith and azimuth angles in radians and, if known, the solid angle each represents.

    Zenith angles are in [0, pi]. Azimuth is clockwise from north, up to two turns either way. `weight`, the solid
    angle, is in steradians and sums to 2 pi over a hemisphere.

    **Example:**

        >>> west = skyfit.Directions.from_degrees([30, 60], 270)
        >>> np.degrees(west.zenith).round(3).tolist()
        [30.0, 60.0]
    """

    zenith: Float[Array, " direction"] = eqx.field(converter=as_float, metadata=radians_within(0.0, np.pi))
    azimuth: Float[Array, " direction"] = eqx.field(
        converter=as_float, metadata=radians_within(-MOST_AZIMUTH, MOST_AZIMUTH)
    )
    weight: Float[Array, " direction"] | None = eqx.field(
        converter=as_float_or_none, default=None, metadata=within(0.0, 4.0 * np.pi, "sr")
    )

    def __check_init__(self):
        if self.zenith.ndim != 1 or self.zenith.shape != self.azimuth.shape:
            raise ValueError(
                "`zenith` and `azimuth` must be 1-d and of one length, "
                f"got {self.zenith.shape} and {self.azimuth.shape}"
            )

    @classmethod
    def from_degrees(cls, zenith, azimuth) -> "Directions":
        """Directions from angles in degrees, broadcast against each other and flattened."""
        zenith, azimuth = np.broadcast_arrays(np.radians(zenith), np.radians(azimuth))
        return cls(zenith.ravel(), azimuth.ravel())


def hemisphere(count: int = 343, max_zenith: float = np.pi / 2) -> Directions:
    """Near-uniform directions over the sky on a Fibonacci spiral, each with the same solid angle.

    **Arguments:** `count`, number of directions (>= 1); `max_zenith`, radians, the edge of the cap.
    **Returns:** `Directions` with weights in sr.
    **Valid:** 0 < max_zenith <= pi/2.
    **Source:** Swinbank & Purser 2006, Fibonacci grids. 343 is the number Preetham 1999, sec. 3.2, simulated.

    **Example:**

        >>> view = skyfit.hemisphere(343)
        >>> view.zenith.shape, round(float(view.weight.sum() / np.pi), 4)
        ((343,), 2.0)
    """
    if count < 1 or not 0.0 < max_zenith <= np.pi / 2 + 1e-9:
        raise ValueError(f"`count` must be >= 1 and `max_zenith` in (0, pi/2], got {count} and {max_zenith}")
    index = np.arange(count) + 0.5
    cap = 1.0 - np.cos(max_zenith)
    golden_angle = np.pi * (3.0 - np.sqrt(5.0))
    return Directions(
        np.arccos(1.0 - cap * index / count),
        np.mod(golden_angle * index, 2.0 * np.pi),
        as_float(np.full(count, 2.0 * np.pi * cap / count)),
    )


def unit_vectors(
    zenith: Float[ArrayLike, "*direction"], azimuth: Float[ArrayLike, "*direction"]
) -> Float[Array, "3 ..."]:
    r"""Unit vectors of directions, $(\sin\theta \sin\phi, \sin\theta \cos\phi, \cos\theta)$: east, north, up.

    **Arguments:** zenith angle and azimuth clockwise from north, radians, of one shape.
    **Returns:** dimensionless, `[3, direction]`. **Valid:** zenith angles from 0 to pi, azimuths to two turns.

    **Example:**

        >>> east = skyfit.unit_vectors(np.pi / 2, np.pi / 2)
        >>> [round(float(v)) for v in east]
        [1, 0, 0]
    """
    check_radians("zenith", zenith, 0.0, np.pi)
    check_radians("azimuth", azimuth, -MOST_AZIMUTH, MOST_AZIMUTH)
    sine = jnp.sin(zenith)
    return jnp.stack([sine * jnp.sin(azimuth), sine * jnp.cos(azimuth), jnp.cos(zenith)])


def fisheye(size: int, mirrored: bool = False) -> Float[Array, "3 row column"]:
    r"""Unit vectors of the pixels of a fisheye image: zenith at the centre, horizon at the rim, north up, east right.

    The zenith angle grows linearly with the distance from the middle, $\theta = \frac{\pi}{2} r$.

    **Arguments:** `size`, pixels across, >= 1; `mirrored`: east on the left, as in all-sky cameras.
    **Returns:** dimensionless, `[3, row, column]`, the top row first.
    **Valid:** the corners lie below the horizon, z < 0.

    **Example:**

        >>> skyfit.fisheye(256).shape
        (3, 256, 256)
    """
    if size < 1:
        raise ValueError(f"`size` must be >= 1, got {size}")
    edge = (np.arange(size) + 0.5) / size * 2.0 - 1.0
    x, y = np.meshgrid(edge[::-1] if mirrored else edge, edge[::-1])
    radius = np.hypot(x, y)
    # sin(pi r / 2) / r; numpy's sinc(x) is sin(pi x) / (pi x)
    sine = 0.5 * np.pi * np.sinc(0.5 * radius)
    return as_float(np.stack([sine * x, sine * y, np.cos(0.5 * np.pi * radius)]))
