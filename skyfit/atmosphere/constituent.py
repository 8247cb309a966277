"""A constituent of the atmosphere: its optical depth, single scattering albedo, phase function and profile."""

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
    """A constituent of the air. `phase` is None if it only absorbs."""

    phase: eqx.AbstractVar[AbstractPhase | None]
    profile: eqx.AbstractVar[AbstractProfile]
    # Whether the optics can be evaluated at wavelengths other than the scene's
    smooth_in_wavelength: eqx.AbstractClassVar[bool]
    # Whether a solution with few streams follows the constituent's change with wavelength within a per cent
    factors_out: ClassVar[bool] = True

    @property
    @abstractmethod
    def known_nm(self) -> tuple[float, float]:
        """The valid wavelengths of the optics, nm. Concrete wavelengths beyond are a `ValueError`."""

    def check_wavelengths(self, wavelength_nm) -> None:
        """Raise `ValueError` for wavelengths outside the range of the optics or of the phase; traced ones pass."""
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
    """A constituent whose optical depth and single scattering albedo are given at the scene's own wavelengths.

    `optical_depth` `[wavelength]`, vertical extinction, >= 0; `single_scattering_albedo` `[wavelength]`
    or a scalar; `phase` (None: absorbs only) and `profile`. May stand under any name of an `Atmosphere`.

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
        """Constituents from a table of optical depths of homogeneous layers, the format atmosphere models exchange.

        One profile holds for all wavelengths. Layers whose shares of the column vary with wavelength therefore become
        one constituent for each wavelength, with an optical depth of 0 at all others. This is exact in every solver.

        **Arguments:** `edges` of the layers, m, increasing from 0, one more than layers; `optical_depth`
        `[layer, wavelength]`, vertical extinction, at the scene's own wavelengths, may be traced; `phase` and
        `single_scattering_albedo` as above.
        **Returns:** the constituents, one for each wavelength. You name them, for example:
        `Atmosphere(None, None, None, **{f"air_{i}": part for i, part in enumerate(parts)})`.
        """
        depth = as_float(optical_depth)
        if depth.ndim != 2 or np.shape(edges) != (depth.shape[0] + 1,):
            raise ValueError(
                "`optical_depth` must be of [layer, wavelength] and `edges` have one entry more than layers, "
                f"got {depth.shape} and {np.shape(edges)}"
            )
        total, alone = jnp.sum(depth, axis=0), np.eye(depth.shape[1])
        # An empty column may have any profile
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
