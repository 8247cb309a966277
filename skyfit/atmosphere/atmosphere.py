"""The atmosphere: named constituents and the ground. Every parameter of a sky is a leaf of this tree."""

from dataclasses import fields
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics import as_float, Ranged, within
from .aerosol import Aerosol
from .constituent import AbstractConstituent
from .gas import Ozone
from .phase import REFERENCE_WAVELENGTH
from .rayleigh import Rayleigh
from .turbidity import Relation, turbidity_to_optical_depth


# Red edge of green vegetation, nm: the middle and the width of a logistic curve (10 to 90 % in 53 nm). Horler et al.
# 1983, Int. J. Remote Sens. 4, 273: leaves have the edge at 700 to 725 nm
_RED_EDGE, _RED_EDGE_WIDTH = 716.0, 12.0


class Ground(Ranged):
    """A Lambertian ground: `albedo` at 550 nm in [0, 1] and its slope per unit of ln(wavelength / 550 nm).

    `red_edge` is the near-infrared albedo minus the red albedo: 0.3 to 0.5 for green vegetation, 0 for bare ground.
    `albedo` may also be an array over the wavelengths of the scene, `[wavelength]`.

    **Example:**

        >>> grass = skyfit.Ground(0.1, red_edge=0.4)
        >>> red, infrared = grass.reflectance(jnp.array([650.0, 800.0]))
        >>> bool(infrared > 3.0 * red)
        True
    """

    albedo: Float[Array, "*wavelength"] = eqx.field(converter=as_float, default=0.1, metadata=within(0.0, 1.0))
    albedo_slope: Float[Array, ""] = eqx.field(converter=as_float, default=0.0, metadata=within(-10.0, 10.0))
    red_edge: Float[Array, ""] = eqx.field(converter=as_float, default=0.0, metadata=within(-1.0, 1.0))

    def reflectance(self, wavelength_nm: Float[Array, " wavelength"]) -> Float[Array, " wavelength"]:
        """The albedo at the given wavelengths."""
        ratio = jnp.log(wavelength_nm / REFERENCE_WAVELENGTH)
        step = self.red_edge * jax.nn.sigmoid((wavelength_nm - _RED_EDGE) / _RED_EDGE_WIDTH)
        albedo = jnp.broadcast_to(self.albedo, wavelength_nm.shape) + self.albedo_slope * ratio + step
        return jnp.clip(albedo, 0.0, 1.0)


class Atmosphere(eqx.Module):
    """An ordered set of named constituents over a ground. An absent constituent costs nothing.

    Example: `Atmosphere(aerosol=Aerosol(0.1), dust=Aerosol(0.02, profile=Levels.elterman_1968()), no2=Gas(...))`.
    Beside `rayleigh`, `aerosol` and `ozone` you may add any number of constituents under your own names. `rayleigh`
    (the air) and `ozone` are present by default; None removes them. Each may be any `AbstractConstituent`, for instance
    a `Prescribed` one. A solver that treats air separately (`Shells`) takes the constituent named rayleigh for the air.

    `atmosphere.dust` or `atmosphere["dust"]` reads a constituent, `"dust" in atmosphere` tells whether it exists, and
    `replace` makes another atmosphere. `names` and `constituents` have the same order: rayleigh, aerosol, ozone, then
    the others as given.

    **Example:**

        >>> air = skyfit.Atmosphere(aerosol=skyfit.Aerosol(0.1), smoke=skyfit.Aerosol(0.02))
        >>> air.names
        ('rayleigh', 'aerosol', 'ozone', 'smoke')
        >>> air.replace(ozone=None).names
        ('rayleigh', 'aerosol', 'smoke')
    """

    names: tuple[str, ...] = eqx.field(static=True)
    constituents: tuple[AbstractConstituent, ...]
    ground: Ground

    def __init__(
        self,
        /,
        rayleigh: AbstractConstituent | type[Rayleigh] | None = Rayleigh,
        aerosol: AbstractConstituent | None = None,
        ozone: AbstractConstituent | type[Ozone] | None = Ozone,
        ground: Ground | type[Ground] = Ground,
        **more: AbstractConstituent | None,
    ):
        # The defaults are made here, so that they have the float type the process uses now
        made = {
            "rayleigh": Rayleigh() if rayleigh is Rayleigh else rayleigh,
            "aerosol": aerosol,
            "ozone": Ozone() if ozone is Ozone else ozone,
        } | more
        present = {name: c for name, c in made.items() if isinstance(c, AbstractConstituent)}
        taken = {*dir(type(self)), *(field.name for field in fields(self))}
        for name, c in made.items():
            if not name.isidentifier() or name.startswith("_") or name in taken:
                raise ValueError(f"`{name}` must be another name: a word that means nothing else of an atmosphere")
            if c is not None and name not in present:
                raise ValueError(f"`{name}` must be a constituent or None, got {c!r}")
        if not (ground is Ground or isinstance(ground, Ground)):
            raise ValueError(f"`ground` must be a `Ground`, got {ground!r}")
        self.names, self.constituents = tuple(present), tuple(present.values())
        self.ground = Ground() if isinstance(ground, type) else ground

    @classmethod
    def from_optical_depth(cls, optical_depth, **aerosol) -> "Atmosphere":
        """Sea-level air, 300 DU of ozone, ground albedo 0.1 and haze of the given optical depth at 550 nm.

        **Arguments:** `optical_depth`, 0 to 1000, may be traced; the other fields of `Aerosol` by name.
        **Returns:** an `Atmosphere`.
        """
        return cls(aerosol=Aerosol(optical_depth, **aerosol))

    @classmethod
    def from_turbidity(cls, turbidity, relation: Relation = "definition", **aerosol) -> "Atmosphere":
        """Like `from_optical_depth`, but Preetham's turbidity at 550 nm (>= 1) gives the haze.

        `relation` as in `turbidity_to_optical_depth`.
        """
        return cls.from_optical_depth(turbidity_to_optical_depth(turbidity, relation), **aerosol)

    def replace(self, /, *, ground: Ground | None = None, **constituents: AbstractConstituent | None) -> "Atmosphere":
        """A copy with the given constituents replaced, added or (None) removed, and optionally with another ground."""
        parts = {"rayleigh": None, "ozone": None} | dict(zip(self.names, self.constituents, strict=True)) | constituents
        return Atmosphere(ground=self.ground if ground is None else ground, **parts)

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def __getitem__(self, name: str) -> AbstractConstituent:
        if name not in self.names:
            raise KeyError(self._absent(name))
        return self.constituents[self.names.index(name)]

    def __getattr__(self, name: str) -> Any:
        # A field that is not set yet, or a name that Python or JAX looks up by itself
        if name.startswith("_") or name in ("names", "constituents", "ground"):
            raise AttributeError(name)
        if name not in self.names:
            raise AttributeError(self._absent(name))
        return self.constituents[self.names.index(name)]

    def _absent(self, name: str) -> str:
        return f"this atmosphere has no `{name}`, only {', '.join(self.names) or 'its ground'}"

    def check_wavelengths(self, wavelength_nm) -> None:
        """Raise `ValueError` for wavelengths outside the range of a constituent; traced wavelengths pass."""
        for constituent in self.constituents:
            constituent.check_wavelengths(wavelength_nm)

    @property
    def smooth_in_wavelength(self) -> bool:
        """Whether all optics can be evaluated between the scene's wavelengths."""
        return self.ground.albedo.ndim == 0 and all(c.smooth_in_wavelength for c in self.constituents)
