"""The atmosphere: its constituents and the ground under it; every parameter of a sky is a leaf of it."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics import as_float
from .aerosol import Aerosol
from .constituent import AbstractConstituent
from .gas import Ozone
from .phase import REFERENCE_WAVELENGTH
from .rayleigh import Rayleigh
from .turbidity import Relation, turbidity_to_optical_depth


# nm, the red edge of green vegetation: its middle and the width of its logistic curve (10 to 90 % in 53 nm). Horler et
# al. 1983, Int. J. Remote Sens. 4, 273: leaves have it at 700 to 725 nm
_RED_EDGE, _RED_EDGE_WIDTH = 716.0, 12.0


class Ground(eqx.Module):
    """A Lambertian ground: `albedo` at 550 nm in [0, 1], its slope per unit of ln(wavelength / 550 nm).

    `red_edge`, how much more of the near infrared than of the red it reflects: 0.3 to 0.5 of green vegetation, for
    bare ground 0. `albedo` may also be given per wavelength of the scene, `[wavelength]`.
    """

    albedo: Float[Array, "*wavelength"] = eqx.field(converter=as_float, default=0.1)
    albedo_slope: Float[Array, ""] = eqx.field(converter=as_float, default=0.0)
    red_edge: Float[Array, ""] = eqx.field(converter=as_float, default=0.0)

    def reflectance(self, wavelength_nm: Float[Array, " wavelength"]) -> Float[Array, " wavelength"]:
        """The albedo at the given wavelengths."""
        ratio = jnp.log(wavelength_nm / REFERENCE_WAVELENGTH)
        step = self.red_edge * jax.nn.sigmoid((wavelength_nm - _RED_EDGE) / _RED_EDGE_WIDTH)
        albedo = jnp.broadcast_to(self.albedo, wavelength_nm.shape) + self.albedo_slope * ratio + step
        return jnp.clip(albedo, 0.0, 1.0)


class Atmosphere(eqx.Module):
    """Air, haze, ozone and the ground; a constituent that is None costs nothing.

    Each of `rayleigh`, `aerosol`, `ozone` may be any `AbstractConstituent`, a `Prescribed` one for instance.
    """

    rayleigh: AbstractConstituent | None = eqx.field(default_factory=Rayleigh)
    aerosol: AbstractConstituent | None = None
    ozone: AbstractConstituent | None = eqx.field(default_factory=Ozone)
    ground: Ground = eqx.field(default_factory=Ground)

    @classmethod
    def from_optical_depth(cls, optical_depth, **aerosol) -> "Atmosphere":
        """Air at sea level, 300 DU of ozone, ground albedo 0.1 and haze of this optical depth at 550 nm.

        **Arguments:** `optical_depth` >= 0, may be traced; the other fields of `Aerosol` by name.
        **Returns:** an `Atmosphere`.
        """
        return cls(aerosol=Aerosol(optical_depth, **aerosol))

    @classmethod
    def from_turbidity(cls, turbidity, relation: Relation = "definition", **aerosol) -> "Atmosphere":
        """As `from_optical_depth`, with the haze given by Preetham's turbidity at 550 nm (>= 1).

        `relation` as in `turbidity_to_optical_depth`.
        """
        return cls.from_optical_depth(turbidity_to_optical_depth(turbidity, relation), **aerosol)

    @property
    def constituents(self) -> tuple[AbstractConstituent, ...]:
        """The constituents that are present."""
        return tuple(c for c in (self.rayleigh, self.aerosol, self.ozone) if c is not None)

    @property
    def smooth_in_wavelength(self) -> bool:
        """Whether all optics may be asked for between the scene's wavelengths."""
        return self.ground.albedo.ndim == 0 and all(c.smooth_in_wavelength for c in self.constituents)
