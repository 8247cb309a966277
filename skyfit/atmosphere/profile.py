"""Vertical profiles: how a constituent's column is spread over height above the ground."""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics import hat_weights
from ..scene import as_float


class AbstractProfile(eqx.Module):
    """The shape of a column, normalised to one; heights in metres above the ground."""

    @abstractmethod
    def above(self, height: Float[Array, "..."]) -> Float[Array, "..."]:
        """The share of the column above `height` (m), 1 at the ground, 0 in space."""

    @abstractmethod
    def density(self, height: Float[Array, "..."]) -> Float[Array, "..."]:
        """The normalised density, m^-1: minus the derivative of `above`."""

    @abstractmethod
    def reach(self) -> Float[Array, ""]:
        """The height (m) over which the column thins out: the length scale of quadrature."""


class Exponential(AbstractProfile):
    r"""Density falling as $e^{-h/H}$; Preetham 1999, eq. 5 with $\alpha = 1/H$. `scale_height` in m, > 0."""

    scale_height: Float[Array, ""] = eqx.field(converter=as_float)

    def above(self, height):
        return jnp.exp(-height / self.scale_height)

    def density(self, height):
        return jnp.exp(-height / self.scale_height) / self.scale_height

    def reach(self):
        return self.scale_height


class OzoneLayer(AbstractProfile):
    r"""Stratospheric ozone: column above h proportional to $1 / (1 + e^{(h - b)/c})$.

    `height` b = 20 km and `thickness` c = 5 km (m here) stand for middle latitudes.
    Source: Lacis & Hansen 1974, J. Atmos. Sci. 31, 118 (their u(h) with a = 0.4 cm, b = 20 km, c = 5 km).
    """

    height: Float[Array, ""] = eqx.field(converter=as_float, default=20e3)
    thickness: Float[Array, ""] = eqx.field(converter=as_float, default=5e3)

    def above(self, height):
        whole = jax.nn.sigmoid(self.height / self.thickness)
        return jax.nn.sigmoid((self.height - height) / self.thickness) / whole

    def density(self, height):
        beyond = jax.nn.sigmoid((height - self.height) / self.thickness)
        return self.above(height) * beyond / self.thickness

    def reach(self):
        return self.height


class Layered(AbstractProfile):
    """Homogeneous layers: `fraction` of the column in each layer between consecutive `edges`.

    `edges` in m, increasing, one more than `fraction`; the first is the ground (0). Fractions are normalised
    to sum 1. Single scattering has its `nodes` in each layer that scatters, at that cost.
    """

    edges: Float[Array, " edge"] = eqx.field(converter=as_float)
    fraction: Float[Array, " layer"] = eqx.field(converter=as_float)

    def __check_init__(self):
        if self.edges.shape[0] != self.fraction.shape[0] + 1:
            raise ValueError(
                "`edges` must have one entry more than `fraction`, "
                f"got {self.edges.shape[0]} and {self.fraction.shape[0]}"
            )

    def _share(self):
        return self.fraction / jnp.sum(self.fraction)

    def above(self, height):
        below = jnp.concatenate([jnp.zeros_like(self.fraction[:1]), jnp.cumsum(self._share())])
        return 1.0 - hat_weights(height, self.edges) @ below

    def density(self, height):
        per_metre = self._share() / jnp.diff(self.edges)
        lower, upper = self.edges[:-1], self.edges[1:]
        axes = tuple(range(height.ndim))
        level = height[..., None]
        inside = (level >= jnp.expand_dims(lower, axes)) & (level < jnp.expand_dims(upper, axes))
        return inside.astype(per_metre.dtype) @ per_metre

    def reach(self):
        middle = 0.5 * (self.edges[1:] + self.edges[:-1])
        return jnp.sum(self._share() * middle)
