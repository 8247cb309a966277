"""A constituent of the atmosphere: a column, what it scatters and absorbs, and where it lies."""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..numerics import ALL_WAVELENGTHS, as_float, check_wavelength, Ranged, within
from .phase import AbstractPhase
from .profile import AbstractProfile, Layered


class AbstractConstituent(Ranged):
    """Something in the air. `phase` is None where it only absorbs."""

    phase: eqx.AbstractVar[AbstractPhase | None]
    profile: eqx.AbstractVar[AbstractProfile]
    # whether the optics may be asked for at wavelengths other than the scene's
    smooth_in_wavelength: eqx.AbstractClassVar[bool]
    # whether coarse streams see within a per cent what it changes from one wavelength to the next
    factors_out: ClassVar[bool] = True

    @property
    @abstractmethod
    def known_nm(self) -> tuple[float, float]:
        """Where the optics are known, nm: beyond, wavelengths that are not traced are refused."""

    def check_wavelengths(self, wavelength_nm) -> None:
        """A `ValueError` for wavelengths at which the optics or the phase function are not known; traced ones pass."""
        for part in (self, self.phase):
            if part is not None:
                check_wavelength(wavelength_nm, *part.known_nm, f"all that {type(part).__name__} knows")

    @abstractmethod
    def optical_depth_at(self, wavelength_nm: Float[Array, " wavelength"]) -> Float[Array, " wavelength"]:
        """The vertical extinction optical depth from the ground to space."""

    @abstractmethod
    def single_scattering_albedo_at(self, wavelength_nm: Float[Array, " wavelength"]) -> Float[Array, " wavelength"]:
        """The single-scattering albedo, in [0, 1]."""


class Prescribed(AbstractConstituent):
    """A constituent whose optical depth and albedo are given at the scene's own wavelengths.

    `optical_depth` `[wavelength]`, vertical extinction, >= 0; `single_scattering_albedo` `[wavelength]`
    or a scalar; `phase` (None: absorbs only) and `profile`. Stands in any place of an `Atmosphere`.

    **Example:**

        >>> volcano = skyfit.Prescribed(
        ...     np.array([0.02, 0.02, 0.01]), skyfit.Exponential(5000.0), skyfit.HenyeyGreenstein(0.7)
        ... )
        >>> skyfit.Atmosphere(aerosol=skyfit.Aerosol(0.1), volcano=volcano).names
        ('rayleigh', 'aerosol', 'ozone', 'volcano')
    """

    optical_depth: Float[Array, " wavelength"] = eqx.field(converter=as_float, metadata=within(0.0, 1e4))
    profile: AbstractProfile
    phase: AbstractPhase | None = None
    single_scattering_albedo: Float[Array, "*wavelength"] = eqx.field(
        converter=as_float, default=1.0, metadata=within(0.0, 1.0)
    )
    smooth_in_wavelength: ClassVar[bool] = False
    factors_out: ClassVar[bool] = False
    known_nm: ClassVar[tuple[float, float]] = ALL_WAVELENGTHS

    @classmethod
    def by_layer(
        cls,
        edges,
        optical_depth,
        phase: AbstractPhase | None = None,
        single_scattering_albedo=1.0,
    ) -> tuple["Prescribed", ...]:
        """Homogeneous layers whose optical depths are given one by one, as models of the atmosphere are exchanged.

        A profile is the same at all wavelengths. Layers that share the column otherwise at each of them are as many
        constituents as wavelengths, each there at its own alone: exact, in every solver.

        **Arguments:** `edges` of the layers, m, increasing from 0, one more than layers; `optical_depth`
        `[layer, wavelength]`, vertical extinction, at the scene's own wavelengths, may be traced; `phase` and
        `single_scattering_albedo` as above.
        **Returns:** the constituents; one, where there is one wavelength. They have no names yet:
        `Atmosphere(None, None, None, **{f"air_{i}": part for i, part in enumerate(parts)})`.
        """
        depth = as_float(optical_depth)
        if depth.ndim != 2 or np.shape(edges) != (depth.shape[0] + 1,):
            raise ValueError(
                "`optical_depth` must be of [layer, wavelength] and `edges` have one entry more than layers, "
                f"got {depth.shape} and {np.shape(edges)}"
            )
        total, alone = jnp.sum(depth, axis=0), np.eye(depth.shape[1])
        # of a column that is empty any shape will do
        shares = jnp.where(total[None] > 0.0, depth, 1.0)
        return tuple(
            cls(total * alone[i], Layered(edges, shares[:, i]), phase, single_scattering_albedo)
            for i in range(depth.shape[1])
        )

    def optical_depth_at(self, wavelength_nm):
        if self.optical_depth.shape != wavelength_nm.shape:
            raise ValueError(
                "`optical_depth` must be given at the scene's wavelengths, "
                f"got {self.optical_depth.shape} for {wavelength_nm.shape}"
            )
        return self.optical_depth

    def single_scattering_albedo_at(self, wavelength_nm):
        return jnp.broadcast_to(self.single_scattering_albedo, wavelength_nm.shape)
