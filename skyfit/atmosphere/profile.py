"""Vertical profiles: the distribution of a constituent's column over height above the ground."""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..numerics import as_float, check_increasing, concrete, hat_weights, phi1, phi_functions, Ranged, within
from ..tables import read_table


# Scale height of haze, m: Preetham 1999, A.4 (0.8333 /km)
HAZE_SCALE_HEIGHT = 1200.0
# Smallest density whose logarithm is taken; float32 represents it
_SMALLEST_DENSITY = 1e-30


class AbstractProfile(Ranged):
    """The vertical distribution of a column, normalised to one; heights in metres above the ground."""

    @abstractmethod
    def column_above(self, height: Float[Array, "..."]) -> Float[Array, "..."]:
        """The share of the column above `height` (m), 1 at the ground, 0 in space."""

    @abstractmethod
    def density(self, height: Float[Array, "..."]) -> Float[Array, "..."]:
        """The normalised density, m^-1: minus the derivative of `column_above`."""

    @abstractmethod
    def reach(self) -> Float[Array, ""]:
        """A height (m) characteristic of the profile: the length scale of quadrature."""


class Exponential(AbstractProfile):
    r"""Density proportional to $e^{-h/H}$; Preetham 1999, eq. 5 with $\alpha = 1/H$. `scale_height` in m, 10 to 1e6.

    **Example:**

        >>> air = skyfit.Exponential(8000.0)
        >>> round(float(air.density(8000.0) / air.density(0.0)), 3)
        0.368
    """

    scale_height: Float[Array, ""] = eqx.field(
        converter=as_float, metadata=within(10.0, 1e6, "m", "kilometres times 1000")
    )

    def column_above(self, height):
        return jnp.exp(-height / self.scale_height)

    def density(self, height):
        return jnp.exp(-height / self.scale_height) / self.scale_height

    def reach(self):
        return self.scale_height


class OzoneLayer(AbstractProfile):
    r"""Stratospheric ozone: column above h proportional to $1 / (1 + e^{(h - b)/c})$.

    `height` b and `thickness` c are in m. The defaults, 20 km and 5 km, represent middle latitudes.
    Source: Lacis & Hansen 1974, J. Atmos. Sci. 31, 118 (their u(h) with a = 0.4 cm, b = 20 km, c = 5 km).

    **Example:**

        >>> round(float(skyfit.OzoneLayer().column_above(20000.0)), 2)
        0.51
    """

    height: Float[Array, ""] = eqx.field(converter=as_float, default=20e3, metadata=within(1.0, 1e5, "m"))
    thickness: Float[Array, ""] = eqx.field(converter=as_float, default=5e3, metadata=within(1.0, 1e5, "m"))

    def column_above(self, height):
        whole = jax.nn.sigmoid(self.height / self.thickness)
        return jax.nn.sigmoid((self.height - height) / self.thickness) / whole

    def density(self, height):
        beyond = jax.nn.sigmoid((height - self.height) / self.thickness)
        return self.column_above(height) * beyond / self.thickness

    def reach(self):
        return self.height


class Layered(AbstractProfile):
    """Homogeneous layers: `fraction` of the column in each layer between consecutive `edges`.

    `edges` in m, increasing, one more than `fraction`; the first is the ground (0). Fractions are normalised
    to sum 1. Single scattering places its `nodes` in each scattering layer, which costs accordingly.

    **Example:**

        >>> haze = skyfit.Layered(np.array([0.0, 1000.0, 3000.0]), np.array([3.0, 1.0]))
        >>> round(float(haze.column_above(jnp.array([1000.0]))[0]), 3)
        0.25
    """

    edges: Float[Array, " edge"] = eqx.field(converter=as_float, metadata=within(0.0, 1e6, "m"))
    fraction: Float[Array, " layer"] = eqx.field(converter=as_float, metadata=within(0.0, 1e30))

    def __check_init__(self):
        if self.edges.shape[0] != self.fraction.shape[0] + 1:
            raise ValueError(
                "`edges` must have one entry more than `fraction`, "
                f"got {self.edges.shape[0]} and {self.fraction.shape[0]}"
            )
        check_increasing("edges", self.edges)

    def _share(self):
        return self.fraction / jnp.sum(self.fraction)

    def column_above(self, height):
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


class Levels(AbstractProfile):
    r"""Density at levels, exponential in height between them, $\rho_i (\rho_{i+1}/\rho_i)^t$.

    `height` of the levels in m, increasing, the first on the ground; `density_at`, the density there, > 0, in any unit
    (the column is normalised). The density above the last level is 0. Solvers on a sphere integrate layer by layer,
    which costs accordingly. `SingleScattering.normal` computes Elterman's haze to 0.2 %, because its quadrature nodes
    resolve the elevated layer coarsely.

    **Example:**

        >>> air = skyfit.Levels.us_standard_1976()
        >>> half = air.column_above(jnp.array([5500.0]))
        >>> bool(abs(half[0] - 0.5) < 0.01)
        True
    """

    height: Float[Array, " level"] = eqx.field(converter=as_float, metadata=within(0.0, 1e6, "m"))
    density_at: Float[Array, " level"] = eqx.field(converter=as_float, metadata=within(0.0, 1e30))

    def __check_init__(self):
        if self.height.ndim != 1 or self.height.shape != self.density_at.shape or self.height.shape[0] < 2:
            raise ValueError(
                "`height` and `density_at` must be 1-d and of one length, two levels at least, "
                f"got {self.height.shape} and {self.density_at.shape}"
            )
        check_increasing("height", self.height)
        height, density = concrete(self.height), concrete(self.density_at)
        if height is not None and height[0] != 0.0:
            raise ValueError(f"`height` must begin at 0, got {height[0]:g}")
        if density is not None and not np.all(density > 0.0):
            raise ValueError(f"`density_at` must be positive, got {density[~(density > 0.0)][0]:g}")

    @classmethod
    def us_standard_1976(cls) -> "Levels":
        """Air density of the US Standard Atmosphere 1976, ground to 86 km; data/us_standard_atmosphere_1976.csv."""
        table = read_table("us_standard_atmosphere_1976.csv")
        return cls(table["height_m"], table["density_kg_m3"])

    @classmethod
    def elterman_1968(cls) -> "Levels":
        """Elterman's haze from the ground to 50 km, with a layer at 20 km; data/elterman_1968_aerosol.csv."""
        table = read_table("elterman_1968_aerosol.csv")
        return cls(table["height_m"], table["extinction_per_km"])

    def log_density(self) -> Float[Array, " level"]:
        """Logarithm of the normalised density (m^-1) at the levels."""
        log = jnp.log(jnp.maximum(self.density_at, _SMALLEST_DENSITY))
        log = log - log[0]
        return log - jnp.log(jnp.sum(jnp.diff(self.height) * jnp.exp(log[:-1]) * phi1(log[:-1] - log[1:])))

    def column_above(self, height):
        log = self.log_density()
        layer = jnp.diff(self.height) * jnp.exp(log[:-1]) * phi1(log[:-1] - log[1:])
        over = jnp.concatenate([jnp.cumsum(layer[::-1])[::-1][1:], jnp.zeros_like(layer[:1])])
        # Height, log density and column above of the upper end of the layer that contains each height
        ends = self._layer_of(height) @ jnp.stack([self.height[1:], log[1:], over], axis=1)
        inside = jnp.clip(height, self.height[0], self.height[-1])
        here = hat_weights(height, self.height) @ log
        return ends[..., 2] + (ends[..., 0] - inside) * jnp.exp(here) * phi1(here - ends[..., 1])

    def density(self, height):
        here = jnp.exp(hat_weights(height, self.height) @ self.log_density())
        return jnp.where(height < self.height[-1], here, 0.0)

    def _layer_of(self, height):
        """1 for the layer that contains a height, 0 for the others; the first and last layer extend without limit."""
        past = (height[..., None] >= jnp.expand_dims(self.height[1:-1], range(height.ndim))).astype(self.height.dtype)
        ones = jnp.ones_like(height)[..., None]
        return jnp.concatenate([ones, past], axis=-1) - jnp.concatenate([past, 0.0 * ones], axis=-1)

    def reach(self):
        log, step = self.log_density(), jnp.diff(self.height)
        first, second = phi_functions(log[:-1] - log[1:])
        # Mean height
        return jnp.sum(step * jnp.exp(log[:-1]) * (self.height[:-1] * first + step * (first - second)))
