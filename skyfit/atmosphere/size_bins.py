r"""Aerosol of spheres with any size distribution, in bins of radius; its refractive index varies with wavelength."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr
from jaxtyping import Array, Float

from ..numerics import as_float, check_range, within
from .constituent import AbstractConstituent
from .mie import TwoModeAerosol
from .phase import REFERENCE_WAVELENGTH
from .profile import AbstractProfile, Exponential, HAZE_SCALE_HEIGHT
from .sphere_kernels import AbstractSpherePhase, class_weights, KNOWN_N, KNOWN_NM, LARGEST_K, OF_TABLE, SphereKernels


# Radii at which AERONET tabulates size distributions, um (Dubovik & King 2000, J. Geophys. Res. 105, 20673)
BIN_RADII = np.geomspace(0.05, 15.0, 22)
# Distance of the bins in ln r, and the width of their Gaussians: equal bins then add up to a constant within 1e-8
_STEP = float(np.log(BIN_RADII[1] / BIN_RADII[0]))
# Places in ln r at which bins are fitted to a stated distribution: eight for each bin
_PLACES = np.linspace(np.log(BIN_RADII[0]), np.log(BIN_RADII[-1]), 8 * (BIN_RADII.size - 1) + 1)
# Smallest volume over radius that counts as aerosol, um^2/um^2
_NO_VOLUME = 1e-12
# Candidate radii for AERONET's separation of fine from coarse (Version 3), um: it is at the minimum of dV/dlnr
_PARTING = BIN_RADII[(BIN_RADII > 0.4) & (BIN_RADII < 1.0)]


class _Sizes(eqx.Module):
    """The parameters of a `BinnedAerosol` that determine its optics."""

    bins: Float[Array, " bin"]
    refractive_index: Float[Array, ""]
    refractive_index_slope: Float[Array, ""]
    absorption_index: Float[Array, ""]
    absorption_index_exponent: Float[Array, ""]
    absorption_index_curvature: Float[Array, ""]

    def index_at(self, wavelength_nm) -> tuple[Array, Array]:
        """The refractive indices n and k, clipped to the range of the kernels."""
        x = jnp.log(wavelength_nm / REFERENCE_WAVELENGTH)
        exponent = (self.absorption_index_curvature * x - self.absorption_index_exponent) * x
        n = self.refractive_index + self.refractive_index_slope * x
        return jnp.clip(n, *KNOWN_N), jnp.minimum(self.absorption_index * jnp.exp(exponent), LARGEST_K)

    def classes(self, wavelength_nm) -> Float[Array, "wavelength class"]:
        """Volume in each size class, um^3/um^2."""
        radius = as_float(BIN_RADII)
        shares = class_weights(radius, jnp.full_like(radius, _STEP), wavelength_nm)
        return jnp.einsum("b,bwj->wj", self.bins * _STEP, shares)

    def depths(self, wavelength_nm) -> Float[Array, "quantity wavelength"]:
        """Extinction and scattering optical depth."""
        efficiencies = jax.vmap(lambda n, k: SphereKernels(n, k).efficiencies())(*self.index_at(wavelength_nm))
        return jnp.einsum("wqj,wj->qw", efficiencies, self.classes(wavelength_nm)) / (1e-3 * wavelength_nm)[None]


class BinnedPhase(AbstractSpherePhase):
    """Phase function and scattering matrix of a `BinnedAerosol`, made by its property `phase`.

    It is cubic between the tabulated angles and normalised by its own integral. **Valid:** as `BinnedAerosol`.
    """

    sizes: _Sizes

    def by_angle(self, wavelength_nm, ratios=()):
        def at(n, k, row):
            return SphereKernels(n, k).by_angle(row[None], ratios)

        each = jax.vmap(at)(*self.sizes.index_at(wavelength_nm), self.sizes.classes(wavelength_nm))
        return [values[..., 0].T for values in each]


class BinnedAerosol(AbstractConstituent):
    r"""Homogeneous spheres with sizes in 22 bins, $dV/d\ln r = \sum_j b_j\, \Delta\, N(\ln r; \ln r_j, \Delta)$.

    `bins` $b_j$ `[22]`, um^3/um^2, >= 0; if all are equal, dV/dlnr of the column has that value. The radii $r_j$ are
    AERONET's, from 0.05 to 15 um, $\Delta = 0.27$ apart in ln r. The refractive index n + i k is the same for all
    sizes. With $x = \ln(\lambda/550)$, $n = n_{550} + s x$ from `refractive_index` and `refractive_index_slope` s, and
    $k = k_{550}\, e^{-a x + c x^2}$ from `absorption_index`, `absorption_index_exponent` a and
    `absorption_index_curvature` c. `profile`. Optical depth, single scattering albedo and phase function follow.
    May stand under any name of an `Atmosphere`.

    **Valid:** 300 to 1100 nm; n of 1.33 to 1.60, k to 0.1, as for `TwoModeAerosol`; where n or k leaves this range the
    end value holds with slope 0. A mode narrower than 0.27 in ln r is broadened to that. Dust is not made of spheres.

    **Source:** Mie theory, experiments/tables/make_mie_tables.py. Bins as in Dubovik & King 2000, J. Geophys. Res. 105,
    20673, there straight lines between the radii in place of bells.

    **Example:**

        >>> haze = skyfit.BinnedAerosol.like(skyfit.TwoModeAerosol(0.2))
        >>> round(float(haze.optical_depth_at(np.array([550.0]))[0]), 3)
        0.2
    """

    bins: Float[Array, " bin"] = eqx.field(converter=as_float, metadata=within(0.0, 1e3, "um3/um2"))
    refractive_index: Float[Array, ""] = eqx.field(
        converter=as_float, default=1.40, metadata=within(*KNOWN_N, hint=OF_TABLE)
    )
    refractive_index_slope: Float[Array, ""] = eqx.field(converter=as_float, default=0.0, metadata=within(-0.3, 0.3))
    absorption_index: Float[Array, ""] = eqx.field(
        converter=as_float, default=0.003, metadata=within(0.0, LARGEST_K, hint=OF_TABLE)
    )
    absorption_index_exponent: Float[Array, ""] = eqx.field(converter=as_float, default=0.0, metadata=within(-6.0, 6.0))
    absorption_index_curvature: Float[Array, ""] = eqx.field(
        converter=as_float, default=0.0, metadata=within(-10.0, 10.0)
    )
    profile: AbstractProfile = eqx.field(default_factory=lambda: Exponential(HAZE_SCALE_HEIGHT))
    smooth_in_wavelength: ClassVar[bool] = True
    known_nm: ClassVar[tuple[float, float]] = KNOWN_NM

    def __check_init__(self):
        # A placeholder (a tree without numbers) has no shape
        if eqx.is_array(self.bins) and self.bins.shape[-1:] != (BIN_RADII.size,):
            raise ValueError(f"`bins` must hold {BIN_RADII.size} numbers, got {np.shape(self.bins)}")

    @classmethod
    def like(cls, haze: TwoModeAerosol) -> "BinnedAerosol":
        """Bins that approximate a `TwoModeAerosol`, with its volumes, refractive index and profile.

        **Valid:** the optics agree within 0.5 % if the bins cover the modes (tested: fine modes about 0.15 um, coarse
        modes about 2.5 um). Volume below 0.05 and above 15 um is lost: for a fine mode of 0.05 um about 10 % of the
        extinction. Modes of width 0.3 become slightly wider.
        """
        width = jnp.stack([haze.fine_width, haze.coarse_width])
        # The convolution of two Gaussians is a Gaussian; the bins add _STEP**2 to the variance
        width = jnp.sqrt(jnp.maximum(width**2 - _STEP**2, (0.5 * _STEP) ** 2))
        radius = jnp.stack([haze.fine_radius, haze.coarse_radius])
        away = jnp.log(as_float(BIN_RADII)[:, None] / radius[None]) / width[None]
        bins = jnp.exp(-0.5 * away**2) @ (haze.volumes / (width * np.sqrt(2.0 * np.pi)))
        # pyright mistakes the inherited, abstract `phase` for an argument
        return cls(bins, haze.refractive_index, absorption_index=haze.absorption_index, profile=haze.profile)  # pyright: ignore

    @classmethod
    def from_size_distribution(cls, radius_um, volume, **settings) -> "BinnedAerosol":
        """The bins that come nearest to a stated size distribution, taken as straight lines between its radii.

        **Arguments:** `radius_um` `[radius]`, increasing, two at least; `volume` `[radius]`, dV/dlnr of the column,
        um^3/um^2, 0 beyond the ends; `settings`, the other fields.
        **Returns:** a haze whose bins are the non-negative least squares fit to the lines.
        **Valid:** for a network's 22 radii the single scattering albedo is within 0.0006 of exact Mie theory for the
        same lines, the asymmetry within 0.002, the optical depth within 0.8 % (experiments/results/closure.json).
        **Errors:** `ValueError` for radii that do not increase, negative volumes, or arrays of different lengths.

        **Example:**

            >>> fine = [0.1, 0.15, 0.25], [0.0, 0.05, 0.0]
            >>> haze = skyfit.BinnedAerosol.from_size_distribution(*fine, refractive_index=1.45)
            >>> round(float(haze.volumes.sum()), 3)
            0.022
        """
        from scipy.optimize import nnls

        radius, volume = np.asarray(radius_um, float), np.asarray(volume, float)
        if radius.ndim != 1 or radius.size < 2 or radius.shape != volume.shape:
            given = f"{radius.shape} and {volume.shape}"
            raise ValueError(f"`radius_um` and `volume` must be 1-d, of one length, 2 at least, got {given}")
        check_range("radius_um", radius, 1e-3, 1e3, "um")
        check_range("volume", volume, 0.0, 1e3, "um3/um2")
        if np.any(np.diff(radius) <= 0.0):
            raise ValueError("`radius_um` must increase")
        away = (_PLACES[:, None] - np.log(BIN_RADII)[None]) / _STEP
        lines = np.interp(_PLACES, np.log(radius), volume, left=0.0, right=0.0)
        bins, _ = nnls(np.exp(-0.5 * away**2) / np.sqrt(2.0 * np.pi), lines)
        return cls(bins, **settings)

    @property
    def _sizes(self) -> _Sizes:
        return _Sizes(
            self.bins,
            self.refractive_index,
            self.refractive_index_slope,
            self.absorption_index,
            self.absorption_index_exponent,
            self.absorption_index_curvature,
        )

    @property
    def _some(self) -> _Sizes:
        """The sizes; if all bins are empty, equal bins, because an empty aerosol has no phase function."""
        bins = jnp.where(jnp.sum(self.bins) > 0.0, self.bins, jnp.ones_like(self.bins))
        return eqx.tree_at(lambda sizes: sizes.bins, self._sizes, bins)

    @property
    def phase(self):
        """The phase function and scattering matrix of all bins."""
        return BinnedPhase(self._some)

    def index_at(self, wavelength_nm: Float[Array, " wavelength"]) -> tuple[Array, Array]:
        """The refractive indices n and k at wavelengths in nm."""
        return self._sizes.index_at(wavelength_nm)

    def volume_size_distribution(self, radius_um: Float[Array, " radius"]) -> Float[Array, " radius"]:
        """Volume size distribution dV/dlnr of the column at radii in micrometres, um^3/um^2."""
        away = (jnp.log(radius_um)[:, None] - as_float(np.log(BIN_RADII))[None]) / _STEP
        return jnp.exp(-0.5 * away**2) @ self.bins / np.sqrt(2.0 * np.pi)

    def _moments(self) -> Float[Array, "quantity mode"]:
        """Volume and volume over radius of the fine and the coarse spheres."""
        radius = as_float(BIN_RADII)
        least = jnp.argmin(self.volume_size_distribution(as_float(_PARTING)))
        away = (jnp.log(as_float(_PARTING)[least]) - jnp.log(radius)) / _STEP
        volume = self.bins * _STEP
        over_radius = volume / radius * np.exp(0.5 * _STEP**2)
        fine = jnp.stack([volume * ndtr(away), over_radius * ndtr(away + _STEP)])
        coarse = jnp.stack([volume * ndtr(-away), over_radius * ndtr(-away - _STEP)])
        return jnp.stack([fine.sum(axis=1), coarse.sum(axis=1)], axis=1)

    @property
    def volumes(self) -> Float[Array, " mode"]:
        """Column volumes of fine and coarse spheres, um^3/um^2, separated at the minimum of dV/dlnr in 0.44-0.99 um.

        **Source:** AERONET Version 3. The parting radius is one of `bins`, and has no slope.
        """
        return self._moments()[0]

    @property
    def fine_effective_radius(self) -> Float[Array, ""]:
        """Effective radius of the fine spheres, micrometres, separated as in `volumes`; 0 if there are none."""
        return self._effective(self._moments()[:, 0])

    @property
    def coarse_effective_radius(self) -> Float[Array, ""]:
        """Effective radius of the coarse spheres, micrometres, separated as in `volumes`; 0 if there are none."""
        return self._effective(self._moments()[:, 1])

    @property
    def effective_radius(self) -> Float[Array, ""]:
        """Effective radius of all spheres, three times the volume over the surface area, micrometres."""
        return self._effective(jnp.sum(self._moments(), axis=1))

    @staticmethod
    def _effective(moments: Float[Array, "2"]) -> Float[Array, ""]:
        """The ratio of volume to volume over radius, 0 if there is no volume."""
        some = moments[1] > _NO_VOLUME
        return jnp.where(some, moments[0] / jnp.where(some, moments[1], 1.0), 0.0)

    def optical_depth_at(self, wavelength_nm):
        self.check_wavelengths(wavelength_nm)
        return self._sizes.depths(wavelength_nm)[0]

    def single_scattering_albedo_at(self, wavelength_nm):
        extinction, scattering = self._some.depths(wavelength_nm)
        return scattering / extinction
