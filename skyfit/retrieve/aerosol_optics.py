"""Haze optics derived from the parameters of a fit: optical depths, exponents, albedos, radii and their errors."""

from collections.abc import Callable
from typing import NamedTuple, TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..atmosphere import BIN_RADII, BinnedAerosol, TwoModeAerosol
from ..extras import require
from ..numerics import as_float, check_range
from .model import SkyModel
from .parameters import with_values
from .result import Fit


if TYPE_CHECKING:
    import xarray

# wavelengths in nm at which sun photometers state the optics (AERONET's almucantars)
_WAVELENGTHS = (440.0, 675.0, 870.0)
_SPHERES = TwoModeAerosol | BinnedAerosol


class Derived(NamedTuple):
    """One quantity at each time: value, sigma as in `Fit.sigma`, and unit."""

    value: Float[np.ndarray, " time"]
    sigma: Float[np.ndarray, " time"]
    unit: str


def aerosol_optics(fit: Fit) -> dict[str, Derived]:
    r"""Derive the optics of a fitted haze that sun photometers state, by name.

    The names at 440, 675 and 870 nm are `aerosol_optical_depth_*`, `single_scattering_albedo_*` and `asymmetry_*`, the
    mean cosine of the phase function. One name is `angstrom_exponent_440_870`. Haze of spheres also has
    `fine_effective_radius`, `coarse_effective_radius` and `effective_radius` of both.

    **Arguments:** `fit` of any haze except one given per wavelength. **Returns:** empty without such a haze. Sigma is
    $\sqrt{G C G^T}$ with the parameters' covariance C and the gradient G. Fixed parameters contribute no error.
    **Valid:** the wavelengths of a fit; beyond them the numbers follow from the model's laws.
    """
    if not _has_optics(fit):
        return {}
    found = _with_sigma(fit, _numbers)
    return {name: Derived(value, sigma, _unit(name)) for name, (value, sigma) in found.items()}


def aerosol_products(
    fit: Fit,
    wavelength_nm: Float[ArrayLike, " wavelength"] | None = None,
    radius_um: Float[ArrayLike, " radius"] | None = None,
) -> "xarray.Dataset":
    r"""Derive the haze products that photometer networks state, at the instrument's own wavelengths, with their sigma.

    By `time` and `wavelength` (nm): `aerosol_optical_depth`, `absorption_optical_depth`, `single_scattering_albedo`,
    `asymmetry`, and for spheres `refractive_index` and `absorption_index`. For spheres by `time` and `radius` (um):
    `volume_size_distribution`, $dV/d\ln r$ of the column in um^3/um^2; by `time`: `fine_volume`, `coarse_volume`
    (um^3/um^2), `fine_effective_radius`, `coarse_effective_radius`, `effective_radius` (um). Each has a `<name>_sigma`,
    computed as in `aerosol_optics`.

    **Arguments:** `fit`; `wavelength_nm`, default the fitted wavelengths, or 440, 675 and 870 if channels were fitted;
    `radius_um`, default AERONET's 22 from 0.05 to 15.
    **Returns:** a dataset, which `to_netcdf` and `write_products` write. **Errors:** `ValueError` for a haze without
    such optics, for wavelengths that it does not know, and for radii outside 0.001 to 1000 um.
    """
    require("xarray")
    import xarray

    if not _has_optics(fit):
        raise ValueError("`fit` must be of a haze whose optics follow from parameters, got one given per wavelength")
    usual = fit.fitted_nm if fit.response is None else _WAVELENGTHS
    wavelength = as_float(usual if wavelength_nm is None else wavelength_nm)
    radius = as_float(BIN_RADII if radius_um is None else radius_um)
    fit.start.atmosphere.check_wavelengths(wavelength)
    check_range("radius_um", radius, 1e-3, 1e3, "um")
    found = _with_sigma(fit, lambda model: _products(model, wavelength, radius))
    axes = {"wavelength": ("wavelength", np.asarray(wavelength, float), {"units": "nm"})}
    if "volume_size_distribution" in found:
        axes["radius"] = "radius", np.asarray(radius, float), {"units": "um"}
    variables = {}
    for name, (value, sigma) in found.items():
        along = ("time", "radius") if name == "volume_size_distribution" else ("time", "wavelength")[: value.ndim]
        about = {"units": "um3/um2" if "volume" in name else _unit(name)}
        variables[name], variables[f"{name}_sigma"] = (along, value, about), (along, sigma, about)
    return xarray.Dataset(variables, {"time": fit.sky.time} | axes)


def _has_optics(fit: Fit) -> bool:
    atmosphere = fit.start.atmosphere
    named = "aerosol" in atmosphere and atmosphere.aerosol.phase is not None
    return named and atmosphere.aerosol.smooth_in_wavelength


def _with_sigma(fit: Fit, numbers: Callable[[SkyModel], dict]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Evaluate `numbers` of the model, each of any shape, at each time of a fit, and their sigma."""
    # use the dtype of this process, which may differ from that of the fit
    start = jax.tree.map(lambda leaf: as_float(np.asarray(leaf)), fit.start)
    shapes = {name: leaf.shape for name, leaf in jax.eval_shape(numbers, start).items()}
    ends = np.cumsum([int(np.prod(shape)) for shape in shapes.values()])

    def row_of(row):
        by_name = numbers(with_values(start, fit.free, row))
        return jnp.concatenate([by_name[name].reshape(-1) for name in shapes])

    values = as_float(fit.values)
    found = np.asarray(jax.lax.map(row_of, values), float)
    gradient = np.asarray(jax.lax.map(jax.jacfwd(row_of), values), float)
    known = np.where(np.isfinite(fit.covariance), fit.covariance, 0.0)
    variance = np.einsum("tqp,tpr,tqr->tq", gradient, known, gradient)
    # a number that depends on an undetermined parameter is undetermined too
    open_ended = ~np.isfinite(np.einsum("tpp->tp", fit.covariance))
    touched = np.any((gradient != 0.0) & open_ended[:, None], axis=2)
    sigma = np.where(touched, np.inf, np.sqrt(np.maximum(variance, 0.0)))
    parts = (np.split(part, ends[:-1], axis=1) for part in (found, sigma))
    return {
        name: (value.reshape(-1, *shape), error.reshape(-1, *shape))
        for (name, shape), value, error in zip(shapes.items(), *parts, strict=True)
    }


def _unit(name: str) -> str:
    return "um" if name.endswith("radius") else "1"


def _spectra(aerosol, wavelength: Float[Array, " wavelength"]):
    """Optical depth, albedo and asymmetry."""
    depth, albedo = aerosol.optical_depth_at(wavelength), aerosol.single_scattering_albedo_at(wavelength)
    return depth, albedo, jnp.broadcast_to(aerosol.phase.moments(2, wavelength)[1], wavelength.shape)


def _radii(aerosol: _SPHERES) -> dict:
    names = "fine_effective_radius", "coarse_effective_radius", "effective_radius"
    return {name: getattr(aerosol, name) for name in names}


def _products(model: SkyModel, wavelength, radius) -> dict:
    aerosol = model.atmosphere.aerosol
    depth, albedo, asymmetry = _spectra(aerosol, wavelength)
    found = {
        "aerosol_optical_depth": depth, "absorption_optical_depth": depth * (1.0 - albedo),
        "single_scattering_albedo": albedo, "asymmetry": asymmetry,
    }  # fmt: skip
    if not isinstance(aerosol, _SPHERES):
        return found
    volumes = aerosol.volumes
    found["refractive_index"], found["absorption_index"] = aerosol.index_at(wavelength)
    found["volume_size_distribution"] = aerosol.volume_size_distribution(radius)
    return found | {"fine_volume": volumes[0], "coarse_volume": volumes[1]} | _radii(aerosol)


def _numbers(model: SkyModel) -> dict:
    aerosol = model.atmosphere.aerosol
    depth, albedo, asymmetry = _spectra(aerosol, as_float(_WAVELENGTHS))
    numbers = {
        f"{name}_{nm:.0f}": rows[i]
        for name, rows in (
            ("aerosol_optical_depth", depth), ("single_scattering_albedo", albedo), ("asymmetry", asymmetry)
        )
        for i, nm in enumerate(_WAVELENGTHS)
    }  # fmt: skip
    # without haze there is no exponent
    safe = jnp.where(depth > 0.0, depth, 1.0)
    slope = jnp.log(safe[0] / safe[-1]) / np.log(_WAVELENGTHS[-1] / _WAVELENGTHS[0])
    numbers["angstrom_exponent_440_870"] = slope
    return numbers | _radii(aerosol) if isinstance(aerosol, _SPHERES) else numbers
