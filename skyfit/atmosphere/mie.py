r"""Aerosol of spheres in two size modes, fine and coarse, by Mie theory."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..numerics import as_float, within
from .constituent import AbstractConstituent
from .phase import REFERENCE_WAVELENGTH
from .profile import AbstractProfile, Exponential, HAZE_SCALE_HEIGHT
from .sphere_kernels import AbstractSpherePhase, class_weights, KNOWN_N, KNOWN_NM, LARGEST_K, OF_TABLE, SphereKernels


class _Modes(eqx.Module):
    """The parameters of a `TwoModeAerosol` that determine its optics."""

    fine_fraction: Float[Array, ""]
    fine_radius: Float[Array, ""]
    coarse_radius: Float[Array, ""]
    fine_width: Float[Array, ""]
    coarse_width: Float[Array, ""]
    refractive_index: Float[Array, ""]
    absorption_index: Float[Array, ""]

    @property
    def kernels(self) -> SphereKernels:
        return SphereKernels(self.refractive_index, self.absorption_index)

    @property
    def shares(self) -> Float[Array, " mode"]:
        """The share of each mode in the optical depth at 550 nm."""
        fine = jnp.clip(self.fine_fraction, 0.0, 1.0)
        return jnp.stack([fine, 1.0 - fine])

    def size_weights(self, wavelength_nm) -> Float[Array, "mode wavelength class"]:
        """The share of each size class in each mode's volume."""
        radius = jnp.stack([self.fine_radius, self.coarse_radius])
        return class_weights(radius, jnp.stack([self.fine_width, self.coarse_width]), wavelength_nm)

    def volumes(self, efficiencies) -> Float[Array, " mode"]:
        """Volume of each mode for a total optical depth of 1 at 550 nm, um^3/um^2."""
        reference = jnp.full((1,), REFERENCE_WAVELENGTH, jnp.result_type(self.refractive_index))
        extinction = self.size_weights(reference)[:, 0] @ efficiencies[0]
        return self.shares * (1e-3 * REFERENCE_WAVELENGTH) / extinction

    def classes(self, wavelength_nm, efficiencies) -> Float[Array, "wavelength class"]:
        """Volume in each size class for an optical depth of 1 at 550 nm, um^3/um^2."""
        volumes = self.volumes(efficiencies)
        return jnp.sum(volumes[:, None, None] * self.size_weights(wavelength_nm), axis=0)

    def depths(self, wavelength_nm) -> Float[Array, "quantity wavelength"]:
        """Extinction and scattering optical depth for an extinction optical depth of 1 at 550 nm."""
        efficiencies = self.kernels.efficiencies()
        classes = self.classes(wavelength_nm, efficiencies)
        return efficiencies @ classes.T / (1e-3 * wavelength_nm)[None]


class TwoModePhase(AbstractSpherePhase):
    """Phase function and scattering matrix of a `TwoModeAerosol`, made by its property `phase`.

    It is cubic between the tabulated angles and normalised by its own integral.
    **Valid:** as `TwoModeAerosol`; for size parameters above about 500 the diffraction peak is cut off within 0.1
    degrees of the sun.
    """

    modes: _Modes

    def by_angle(self, wavelength_nm, ratios=()):
        kernels = self.modes.kernels
        return kernels.by_angle(self.modes.classes(wavelength_nm, kernels.efficiencies()), ratios)


class TwoModeAerosol(AbstractConstituent):
    r"""Homogeneous spheres, $dV/d\ln r = \sum_m V_m N(\ln r; \ln r_m, \sigma_m)$, m a fine and a coarse mode.

    `optical_depth` at 550 nm, >= 0, of both modes together; `fine_fraction`, the fine mode's share of it, in [0, 1];
    `fine_radius` and `coarse_radius`, medians of the volume distribution in micrometres;
    `fine_width` and `coarse_width`, $\sigma = \ln \sigma_g$; `refractive_index` n and `absorption_index` k >= 0 of
    n + i k, the same for both modes and all wavelengths; `profile`. The Angstrom exponent, single scattering albedo and
    phase function, which an `Aerosol` takes as parameters, follow from these. May stand under any name of an
    `Atmosphere`.

    **Valid:** 300 to 1100 nm; radii of 0.05 to 0.5 and 0.8 to 6 um; widths of 0.3 to 0.9; n of 1.33 to 1.60; k to 0.1.
    Concrete values outside are a `ValueError`. For traced n, k and widths below 0.25 the end value holds with slope 0.
    Far outside the tabulated range of radius over wavelength the slopes go to 0. F34 is neglected.
    Dust is not made of spheres: beyond 90 degrees from the sun its phase function and polarisation differ from these.

    **Source:** Mie theory, experiments/tables/make_mie_tables.py. Two modes and one index as in Dubovik & King 2000,
    J. Geophys. Res. 105, 20673. Defaults: Dubovik et al. 2002, J. Atmos. Sci. 59, 590, Table 1, urban-industrial
    aerosol at Goddard Space Flight Center for an optical depth of 0.3 at 440 nm; its volumes give a fine fraction of
    0.91 here.

    **Example:**

        >>> haze = skyfit.TwoModeAerosol(0.2, fine_fraction=0.8)
        >>> round(float(haze.optical_depth_at(np.array([550.0]))[0]), 3)
        0.2
    """

    optical_depth: Float[Array, ""] = eqx.field(converter=as_float, metadata=within(0.0, 1e3))
    fine_fraction: Float[Array, ""] = eqx.field(converter=as_float, default=0.9, metadata=within(0.0, 1.0))
    fine_radius: Float[Array, ""] = eqx.field(converter=as_float, default=0.15, metadata=within(0.05, 0.5, "um"))
    coarse_radius: Float[Array, ""] = eqx.field(converter=as_float, default=3.2, metadata=within(0.8, 6.0, "um"))
    fine_width: Float[Array, ""] = eqx.field(converter=as_float, default=0.38, metadata=within(0.3, 0.9))
    coarse_width: Float[Array, ""] = eqx.field(converter=as_float, default=0.75, metadata=within(0.3, 0.9))
    refractive_index: Float[Array, ""] = eqx.field(
        converter=as_float, default=1.40, metadata=within(*KNOWN_N, hint=OF_TABLE)
    )
    absorption_index: Float[Array, ""] = eqx.field(
        converter=as_float, default=0.003, metadata=within(0.0, LARGEST_K, hint=OF_TABLE)
    )
    profile: AbstractProfile = eqx.field(default_factory=lambda: Exponential(HAZE_SCALE_HEIGHT))
    smooth_in_wavelength: ClassVar[bool] = True
    known_nm: ClassVar[tuple[float, float]] = KNOWN_NM

    @property
    def _modes(self) -> _Modes:
        return _Modes(
            self.fine_fraction,
            self.fine_radius,
            self.coarse_radius,
            self.fine_width,
            self.coarse_width,
            self.refractive_index,
            self.absorption_index,
        )

    @property
    def phase(self):
        """The phase function and scattering matrix of both modes together."""
        return TwoModePhase(self._modes)

    @property
    def fine_effective_radius(self) -> Float[Array, ""]:
        r"""Effective radius of the fine mode, $r e^{-\sigma^2/2}$, micrometres."""
        return self.fine_radius * jnp.exp(-0.5 * self.fine_width**2)

    @property
    def coarse_effective_radius(self) -> Float[Array, ""]:
        r"""Effective radius of the coarse mode, $r e^{-\sigma^2/2}$, micrometres."""
        return self.coarse_radius * jnp.exp(-0.5 * self.coarse_width**2)

    @property
    def volumes(self) -> Float[Array, " mode"]:
        """Column volumes of the fine and the coarse mode, um^3/um^2."""
        modes = self._modes
        return self.optical_depth * modes.volumes(modes.kernels.efficiencies())

    def index_at(self, wavelength_nm: Float[Array, " wavelength"]) -> tuple[Array, Array]:
        """The refractive indices n and k, the same at all wavelengths (nm)."""
        indices = self.refractive_index, self.absorption_index
        n, k = (jnp.broadcast_to(index, wavelength_nm.shape) for index in indices)
        return n, k

    def volume_size_distribution(self, radius_um: Float[Array, " radius"]) -> Float[Array, " radius"]:
        """Volume size distribution dV/dlnr of the column at radii in micrometres, um^3/um^2."""
        radius = jnp.stack([self.fine_radius, self.coarse_radius])
        width = jnp.stack([self.fine_width, self.coarse_width])
        away = jnp.log(radius_um[:, None] / radius[None]) / width[None]
        return jnp.exp(-0.5 * away**2) @ (self.volumes / (width * np.sqrt(2.0 * np.pi)))

    @property
    def effective_radius(self) -> Float[Array, ""]:
        """Effective radius of both modes together, three times the volume over the surface area, micrometres."""
        volumes = self._modes.volumes(self._modes.kernels.efficiencies())
        radii = jnp.stack([self.fine_effective_radius, self.coarse_effective_radius])
        return jnp.sum(volumes) / jnp.sum(volumes / radii)

    def optical_depth_at(self, wavelength_nm):
        self.check_wavelengths(wavelength_nm)
        return self.optical_depth * self._modes.depths(wavelength_nm)[0]

    def single_scattering_albedo_at(self, wavelength_nm):
        extinction, scattering = self._modes.depths(wavelength_nm)
        return scattering / extinction
