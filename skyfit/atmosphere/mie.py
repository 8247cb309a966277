r"""Aerosol of spheres in two modes of size, a fine and a coarse one, by Mie's theory.

A shipped table holds what unit volume of spheres of narrow size classes extinguishes and scatters, over refractive
index and angle. A lognormal mode is a sum of classes with weights Gaussian in ln(radius / wavelength), so that radius,
width and wavelength enter as smooth functions; the index enters by polynomials.
"""

import functools
from collections.abc import Mapping
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..numerics import as_float, chebyshev_weights, check_range, check_wavelength, gauss_legendre, within
from ..tables import read_arrays
from .constituent import AbstractConstituent
from .phase import AbstractPhase, REFERENCE_WAVELENGTH
from .profile import AbstractProfile, Exponential, HAZE_SCALE_HEIGHT


# narrower modes are taken as this wide: the classes have a width of their own
_LEAST_WIDTH = 0.25
# micrometres, far beyond what the classes hold
_RADII = (1e-3, 1e3)
_KNOWN_NM = (300.0, 1100.0)
_OF_TABLE = "of the table of spheres: soot and iron are beyond it, `Prescribed` takes optics of one's own"
# nodes of an integral over each interval between tabulated angles
_NODES_BETWEEN = 12


@functools.lru_cache(maxsize=4)
def _tables(dtype: Any) -> Mapping[str, np.ndarray]:
    """The shipped arrays in a dtype, `[class, node, ...]`, their means over the nodes apart: small numbers add well."""
    kept = {}
    for name, values in read_arrays("mie_kernels.npz").items():
        if name == "about":
            continue
        values = np.asarray(values, np.float64)
        if name.startswith(("log_", "ratio_")) and values.ndim > 2:
            values = values.reshape(values.shape[0], -1, *values.shape[3:])
            kept[f"{name}_mean"] = values.mean(axis=1).astype(dtype)
            values = values - values.mean(axis=1, keepdims=True)
        kept[name] = values.astype(dtype)
    return kept


def _angle_coordinate(haversine, xp: Any = jnp):
    """Where angles lie among the tabulated ones, 0 to their number less one."""
    a, first, b, c, last = (float(v) for v in read_arrays("mie_kernels.npz")["angle_map"])

    def mapped(h, xp):
        return a * xp.log1p(h / first) + b * h - c * xp.log1p(-h / (1.0 + last))

    count = len(read_arrays("mie_kernels.npz")["haversine"])
    return mapped(haversine, xp) * ((count - 1) / float(mapped(np.float64(1.0), np)))


def _angle_weights(haversine, xp: Any = jnp):
    """Weights of the tabulated angles, and of one more at each end, `[direction, angle + 2]`: local cubics.

    **Source:** Keys 1981, IEEE Trans. Acoust. Speech Signal Process. 29, 1153, a = -1/2.
    """
    count = len(read_arrays("mie_kernels.npz")["haversine"])
    where = _angle_coordinate(haversine, xp)
    distance = xp.minimum(xp.abs(where[:, None] - xp.arange(-1, count + 1, dtype=where.dtype)[None]), 2.0)
    near = (1.5 * distance - 2.5) * distance**2 + 1.0
    far = ((2.5 - 0.5 * distance) * distance - 4.0) * distance + 2.0
    return xp.where(distance < 1.0, near, far)


def _with_ends(values, xp: Any = jnp):
    """One more value beyond either end of the first axis, by the parabola through the last three."""
    before = 3.0 * (values[:1] - values[1:2]) + values[2:3]
    after = 3.0 * (values[-1:] - values[-2:-1]) + values[-3:-2]
    return xp.concatenate([before, values, after])


@functools.lru_cache(maxsize=16)
def _moment_weights(count: int) -> np.ndarray:
    """Integrals over solid angle of the interpolant times Legendre polynomials, `[moment, angle]`, float64."""
    edges = read_arrays("mie_kernels.npz")["haversine"]
    nodes, weights = gauss_legendre(_NODES_BETWEEN)
    width = np.diff(edges)[:, None]
    haversine = (edges[:-1, None] + width * nodes[None]).ravel()
    solid_angle = 4.0 * np.pi * (width * weights[None]).ravel()
    to_angles = _angle_weights(haversine, np) @ _with_ends(np.eye(len(edges)), np)
    legendre = np.polynomial.legendre.legvander(1.0 - 2.0 * haversine, count - 1)
    return (legendre * solid_angle[:, None]).T @ to_angles


class _Modes(eqx.Module):
    """What the optics of two modes follow from; the fields are those of `TwoModeAerosol`."""

    fine_fraction: Float[Array, ""]
    fine_radius: Float[Array, ""]
    coarse_radius: Float[Array, ""]
    fine_width: Float[Array, ""]
    coarse_width: Float[Array, ""]
    refractive_index: Float[Array, ""]
    absorption_index: Float[Array, ""]

    @property
    def tables(self) -> Mapping[str, np.ndarray]:
        return _tables(jnp.result_type(self.refractive_index))

    @property
    def shares(self) -> Float[Array, " mode"]:
        """Of the optical depth at 550 nm."""
        fine = jnp.clip(self.fine_fraction, 0.0, 1.0)
        return jnp.stack([fine, 1.0 - fine])

    def node_weights(self) -> Float[Array, "class node"]:
        """Weights of the nodes of both refractive indices, by size class."""
        t = self.tables
        lower, upper = t["index_range"]
        _, count, absorbing = read_arrays("mie_kernels.npz")["log_scattering"].shape
        real = (2.0 * jnp.clip(self.refractive_index, lower, upper) - (lower + upper)) / (upper - lower)
        scale, top = t["absorption_scale"] * np.exp(-t["log_size"]), t["absorption_top"]
        k = jnp.clip(self.absorption_index, 0.0, top)
        imaginary = 2.0 * (k / (k + scale)) * ((top + scale) / top) - 1.0
        by_real = chebyshev_weights(real[None], count)
        by_imaginary = chebyshev_weights(imaginary, absorbing)
        return (by_real[:, :, None] * by_imaginary[:, None, :]).reshape(len(scale), -1)

    def interpolated(self, name: str, weights) -> Float[Array, "class *angle"]:
        """A table at the refractive index."""
        t = self.tables
        return jnp.asarray(t[f"{name}_mean"]) + jnp.einsum("jn,jn...->j...", weights, t[name])

    def size_weights(self, wavelength_nm) -> Float[Array, "mode wavelength class"]:
        """The classes' shares of each mode's volume."""
        t = self.tables
        radius = jnp.clip(jnp.stack([self.fine_radius, self.coarse_radius]), *_RADII)
        width = jnp.maximum(jnp.stack([self.fine_width, self.coarse_width]), _LEAST_WIDTH)
        size = jnp.log(radius * (2e3 * np.pi))[:, None] - jnp.log(wavelength_nm)[None]
        offset = t["log_size"][None, None] - size[:, :, None]
        return jax.nn.softmax(-0.5 * offset**2 / (width**2 - t["class_width"] ** 2)[:, None, None], axis=-1)

    def efficiencies(self, weights) -> Float[Array, "quantity class"]:
        """Extinction and scattering of the classes, times wavelength per volume."""
        scattering = jnp.exp(self.interpolated("log_scattering", weights))
        k = jnp.clip(self.absorption_index, 0.0, self.tables["absorption_top"])
        return jnp.stack([scattering + k * jnp.exp(self.interpolated("log_absorption", weights)), scattering])

    def volumes(self, efficiencies) -> Float[Array, " mode"]:
        """Volume of each mode for unit optical depth of both at 550 nm, um^3 over um^2."""
        reference = jnp.full((1,), REFERENCE_WAVELENGTH, jnp.result_type(self.refractive_index))
        extinction = self.size_weights(reference)[:, 0] @ efficiencies[0]
        return self.shares * (1e-3 * REFERENCE_WAVELENGTH) / extinction

    def classes(self, wavelength_nm, efficiencies) -> Float[Array, "wavelength class"]:
        """Volume in each size class for unit optical depth at 550 nm, um^3 over um^2."""
        volumes = self.volumes(efficiencies)
        return jnp.sum(volumes[:, None, None] * self.size_weights(wavelength_nm), axis=0)

    def depths(self, wavelength_nm) -> Float[Array, "quantity wavelength"]:
        """Optical depths of extinction and of scattering for unit optical depth at 550 nm."""
        efficiencies = self.efficiencies(self.node_weights())
        classes = self.classes(wavelength_nm, efficiencies)
        return efficiencies @ classes.T / (1e-3 * wavelength_nm)[None]


class TwoModePhase(AbstractPhase):
    """Phase function and scattering matrix of a `TwoModeAerosol`, whose property `phase` makes it.

    Cubic in between the tabulated angles, normalised by its own integral.
    **Valid:** as there; the diffraction peak of size parameters over some 500 is cut off within 0.1 degrees of the sun.
    """

    modes: _Modes
    last_degree: ClassVar[int | None] = None
    known_nm: ClassVar[tuple[float, float]] = _KNOWN_NM

    def _by_angle(self, wavelength_nm, ratios=()) -> list[Float[Array, "angle wavelength"]]:
        """F11 at the tabulated angles, then F11 times each of `ratios`, in arbitrary units."""
        weights = self.modes.node_weights()
        classes = self.modes.classes(wavelength_nm, self.modes.efficiencies(weights))
        value = jnp.exp(self.modes.interpolated("log_value", weights))
        kernels = [value] + [value * self.modes.interpolated(name, weights) for name in ratios]
        return [kernel.T @ classes.T for kernel in kernels]

    def at_haversine(self, haversine, wavelength_nm):
        check_range("haversine", haversine, 0.0, 1.0)
        check_wavelength(wavelength_nm, *self.known_nm, "all that TwoModePhase knows")
        (by_angle,) = self._by_angle(wavelength_nm)
        total = _moment_weights(1).astype(by_angle.dtype) @ by_angle
        return _angle_weights(jnp.clip(haversine, 0.0, 1.0)) @ _with_ends(by_angle / total)

    def moments(self, count, wavelength_nm):
        (by_angle,) = self._by_angle(wavelength_nm)
        moments = _moment_weights(count).astype(by_angle.dtype) @ by_angle
        return moments / moments[:1]

    def matrix(self, haversine, wavelength_nm):
        to_angles = _angle_weights(jnp.clip(haversine, 0.0, 1.0))
        by_angle = self._by_angle(wavelength_nm, ("ratio_12", "ratio_33"))
        f11, f12, f33 = (to_angles @ _with_ends(v) for v in by_angle)
        return jnp.stack([f12 / f11, jnp.ones_like(f11), f33 / f11])


class TwoModeAerosol(AbstractConstituent):
    r"""Homogeneous spheres, $dV/d\ln r = \sum_m V_m N(\ln r; \ln r_m, \sigma_m)$, m a fine and a coarse mode.

    `optical_depth` at 550 nm, >= 0, of both modes; `fine_fraction`, share of it that is the fine mode's, in [0, 1];
    `fine_radius` and `coarse_radius`, medians of the volume distribution in micrometres, the field's unit;
    `fine_width` and `coarse_width`, $\sigma = \ln \sigma_g$; `refractive_index` n and `absorption_index` k >= 0 of
    n + i k, the same for both modes and all wavelengths; `profile`. What an `Aerosol` is given, its Angstrom exponent,
    albedo and phase function, follows here. Stands in any place of an `Atmosphere`.

    **Valid:** 300 to 1100 nm; radii of 0.05 to 0.5 and 0.8 to 6 um; widths of 0.3 to 0.9; n of 1.33 to 1.60; k to 0.1.
    Concrete values outside are a `ValueError`. Of traced ones, beyond those of n and k, and under a width of 0.25, the
    end value holds with slope 0; far beyond those of the radius over the wavelength slopes die away. F34 is left out.
    Dust is not made of spheres: behind 90 degrees from the sun its phase function and polarisation are other than
    these.

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
        converter=as_float, default=1.40, metadata=within(1.33, 1.6, hint=_OF_TABLE)
    )
    absorption_index: Float[Array, ""] = eqx.field(
        converter=as_float, default=0.003, metadata=within(0.0, 0.1, hint=_OF_TABLE)
    )
    profile: AbstractProfile = eqx.field(default_factory=lambda: Exponential(HAZE_SCALE_HEIGHT))
    smooth_in_wavelength: ClassVar[bool] = True
    known_nm: ClassVar[tuple[float, float]] = _KNOWN_NM

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
        """What follows of the phase function and the scattering matrix."""
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
        """Volume of the fine and of the coarse mode in the column, um^3/um^2."""
        modes = self._modes
        return self.optical_depth * modes.volumes(modes.efficiencies(modes.node_weights()))

    @property
    def effective_radius(self) -> Float[Array, ""]:
        """Effective radius of both modes, volume over a quarter of the surface times three quarters, micrometres."""
        volumes = self._modes.volumes(self._modes.efficiencies(self._modes.node_weights()))
        radii = jnp.stack([self.fine_effective_radius, self.coarse_effective_radius])
        return jnp.sum(volumes) / jnp.sum(volumes / radii)

    def optical_depth_at(self, wavelength_nm):
        self.check_wavelengths(wavelength_nm)
        return self.optical_depth * self._modes.depths(wavelength_nm)[0]

    def single_scattering_albedo_at(self, wavelength_nm):
        extinction, scattering = self._modes.depths(wavelength_nm)
        return scattering / extinction
