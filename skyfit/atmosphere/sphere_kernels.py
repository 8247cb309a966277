"""A shipped table of scattering by spheres in narrow size classes, per unit volume, over refractive index and angle.

The optics of any size distribution are a sum over the classes. The dependence on refractive index is a polynomial. A
lognormal part of the distribution has weights that are Gaussian in ln(radius / wavelength), so the optics are smooth
in radius, width and wavelength.
"""

import functools
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..numerics import chebyshev_weights, check_range, check_wavelength, gauss_legendre
from ..tables import read_arrays
from .phase import AbstractPhase


# Smallest width of a lognormal part; smaller ones are raised to it, because the classes have a width themselves
LEAST_WIDTH = 0.25
# Valid wavelengths of the table, nm
KNOWN_NM = (300.0, 1100.0)
# Range of the real refractive index n, and the largest absorption index k (the smallest is 0)
KNOWN_N, LARGEST_K = (1.33, 1.6), 0.1
OF_TABLE = "of the table of spheres: soot and iron are beyond it, `Prescribed` takes optics of one's own"
# Radii are clipped to this range, micrometres, which is far wider than that of the classes
_RADII = (1e-3, 1e3)
# Number of quadrature nodes in each interval between tabulated angles
_NODES_BETWEEN = 12


@functools.lru_cache(maxsize=4)
def _tables(dtype: Any) -> Mapping[str, np.ndarray]:
    """The shipped arrays in a dtype, `[class, node, ...]`, with the means over the nodes stored separately.

    The deviations from the means are small, so that sums over nodes lose few digits.
    """
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
    """The fractional index of angles in the tabulated angles, from 0 to their number minus one."""
    a, first, b, c, last = (float(v) for v in read_arrays("mie_kernels.npz")["angle_map"])

    def mapped(h, xp):
        return a * xp.log1p(h / first) + b * h - c * xp.log1p(-h / (1.0 + last))

    count = len(read_arrays("mie_kernels.npz")["haversine"])
    return mapped(haversine, xp) * ((count - 1) / float(mapped(np.float64(1.0), np)))


def _angle_weights(haversine, xp: Any = jnp):
    """Local cubic weights of the tabulated angles and of one extra node at each end, `[direction, angle + 2]`.

    **Source:** Keys 1981, IEEE Trans. Acoust. Speech Signal Process. 29, 1153, a = -1/2.
    """
    count = len(read_arrays("mie_kernels.npz")["haversine"])
    where = _angle_coordinate(haversine, xp)
    distance = xp.minimum(xp.abs(where[:, None] - xp.arange(-1, count + 1, dtype=where.dtype)[None]), 2.0)
    near = (1.5 * distance - 2.5) * distance**2 + 1.0
    far = ((2.5 - 0.5 * distance) * distance - 4.0) * distance + 2.0
    return xp.where(distance < 1.0, near, far)


def _with_ends(values, xp: Any = jnp):
    """Values with one more at either end of the first axis, extrapolated by the parabola through the three nearest."""
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


def class_weights(
    radius: Float[Array, " part"], width: Float[Array, " part"], wavelength_nm: Float[ArrayLike, " wavelength"]
) -> Float[Array, "part wavelength class"]:
    """The share of each size class in the volume of each lognormal part; median `radius` in micrometres."""
    table = _tables(jnp.result_type(radius))
    radius, width = jnp.clip(radius, *_RADII), jnp.maximum(width, LEAST_WIDTH)
    size = jnp.log(radius * (2e3 * np.pi))[:, None] - jnp.log(wavelength_nm)[None]
    offset = table["log_size"][None, None] - size[:, :, None]
    return jax.nn.softmax(-0.5 * offset**2 / (width**2 - table["class_width"] ** 2)[:, None, None], axis=-1)


class SphereKernels(eqx.Module):
    """The optics of the size classes at one refractive index n + i k, `refractive_index` and `absorption_index`."""

    refractive_index: Float[Array, ""]
    absorption_index: Float[Array, ""]

    @property
    def _tables(self) -> Mapping[str, np.ndarray]:
        return _tables(jnp.result_type(self.refractive_index))

    def _node_weights(self) -> Float[Array, "class node"]:
        """Interpolation weights of the nodes in n and k, for each size class."""
        t = self._tables
        lower, upper = t["index_range"]
        _, count, absorbing = read_arrays("mie_kernels.npz")["log_scattering"].shape
        real = (2.0 * jnp.clip(self.refractive_index, lower, upper) - (lower + upper)) / (upper - lower)
        scale, top = t["absorption_scale"] * np.exp(-t["log_size"]), t["absorption_top"]
        k = jnp.clip(self.absorption_index, 0.0, top)
        imaginary = 2.0 * (k / (k + scale)) * ((top + scale) / top) - 1.0
        by_real = chebyshev_weights(real[None], count)
        by_imaginary = chebyshev_weights(imaginary, absorbing)
        return (by_real[:, :, None] * by_imaginary[:, None, :]).reshape(len(scale), -1)

    def _interpolated(self, name: str, weights) -> Float[Array, "class *angle"]:
        """A table interpolated at the refractive index."""
        t = self._tables
        return jnp.asarray(t[f"{name}_mean"]) + jnp.einsum("jn,jn...->j...", weights, t[name])

    def efficiencies(self) -> Float[Array, "quantity class"]:
        """Extinction and scattering of the classes per volume, times wavelength."""
        weights = self._node_weights()
        scattering = jnp.exp(self._interpolated("log_scattering", weights))
        k = jnp.clip(self.absorption_index, 0.0, self._tables["absorption_top"])
        return jnp.stack([scattering + k * jnp.exp(self._interpolated("log_absorption", weights)), scattering])

    def by_angle(self, classes: Float[Array, "wavelength class"], ratios=()) -> list[Float[Array, "angle wavelength"]]:
        """F11 at the tabulated angles for given class volumes, then F11 times each of `ratios`; arbitrary units."""
        weights = self._node_weights()
        value = jnp.exp(self._interpolated("log_value", weights))
        kernels = [value] + [value * self._interpolated(name, weights) for name in ratios]
        return [kernel.T @ classes.T for kernel in kernels]


class AbstractSpherePhase(AbstractPhase):
    """Phase function and scattering matrix of spheres: cubic between the tabulated angles, normalised by its integral.

    **Valid:** for size parameters above about 500 the diffraction peak is cut off within 0.1 degrees of the sun. F34
    is neglected.
    """

    last_degree: ClassVar[int | None] = None
    known_nm: ClassVar[tuple[float, float]] = KNOWN_NM

    @abstractmethod
    def by_angle(
        self, wavelength_nm: Float[Array, " wavelength"], ratios: tuple[str, ...] = ()
    ) -> list[Float[Array, "angle wavelength"]]:
        """F11 at the tabulated angles, then F11 times each of `ratios`, in arbitrary units."""

    def at_haversine(self, haversine, wavelength_nm):
        check_range("haversine", haversine, 0.0, 1.0)
        check_wavelength(wavelength_nm, *self.known_nm, f"all that {type(self).__name__} knows")
        (by_angle,) = self.by_angle(wavelength_nm)
        total = _moment_weights(1).astype(by_angle.dtype) @ by_angle
        return _angle_weights(jnp.clip(haversine, 0.0, 1.0)) @ _with_ends(by_angle / total)

    def moments(self, count, wavelength_nm):
        (by_angle,) = self.by_angle(wavelength_nm)
        moments = _moment_weights(count).astype(by_angle.dtype) @ by_angle
        return moments / moments[:1]

    def matrix(self, haversine, wavelength_nm):
        to_angles = _angle_weights(jnp.clip(haversine, 0.0, 1.0))
        by_angle = self.by_angle(wavelength_nm, ("ratio_12", "ratio_33"))
        f11, f12, f33 = (to_angles @ _with_ends(v) for v in by_angle)
        return jnp.stack([f12 / f11, jnp.ones_like(f11), f33 / f11])
