"""Haze optics derived from the parameters of a fit: optical depths, exponents, albedos, radii and their errors."""

from typing import NamedTuple, TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..atmosphere import BIN_RADII, BinnedAerosol, TwoModeAerosol
from ..extras import require
from ..numerics import as_float, check_range
from ..programs import kept
from .model import SkyModel
from .parameters import with_values
from .result import Fit


if TYPE_CHECKING:
    import xarray

# wavelengths in nm at which sun photometers state the optics (AERONET's almucantars)
_WAVELENGTHS = (440.0, 675.0, 870.0)
_SPHERES = TwoModeAerosol | BinnedAerosol
_SPECTRA = "aerosol_optical_depth", "single_scattering_albedo", "asymmetry"
_OF_SPHERES = (
    "refractive_index", "absorption_index", "volume_size_distribution", "fine_volume", "coarse_volume",
)  # fmt: skip
_RADII = "fine_effective_radius", "coarse_effective_radius", "effective_radius"


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
    found = _with_sigma(fit, None)
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
    found = _with_sigma(fit, (wavelength, radius))
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


def _with_sigma(fit: Fit, at: tuple | None) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Each quantity, of any shape, at each time of a fit, and its sigma; `at` as in `_derived`."""
    # use the dtype of this process, which may differ from that of the fit
    start = jax.tree.map(lambda leaf: as_float(np.asarray(leaf)), fit.start)
    values, slopes = _kept_derived(start, fit.free, as_float(fit.values), at)
    known = np.where(np.isfinite(fit.covariance), fit.covariance, 0.0)
    # a number that depends on an undetermined parameter is undetermined too
    open_ended = ~np.isfinite(np.einsum("tpp->tp", fit.covariance))

    def sigma_of(slope):
        variance = np.einsum("t...p,tpr,t...r->t...", slope, known, slope)
        touched = np.einsum("t...p,tp->t...", slope != 0.0, open_ended)
        return np.where(touched, np.inf, np.sqrt(np.maximum(variance, 0.0)))

    return {name: (np.asarray(v, float), sigma_of(np.asarray(slopes[name], float))) for name, v in values.items()}


def _derived(start: SkyModel, free: tuple[str, ...], rows: Float[Array, "time parameter"], at: tuple | None):
    """Values of each quantity and their slopes by the free parameters, by name, with a time axis in front.

    The quantities are those of `_products` at some wavelengths and radii, `at`, or those of `_numbers` for None.
    """

    def of(row):
        model = with_values(start, free, row)
        return _numbers(model) if at is None else _products(model, *at)

    return jax.lax.map(lambda row: (of(row), jax.jacfwd(of)(row)), rows)


def _shape_of(start: SkyModel, _, __, at: tuple | None) -> tuple[dict, dict]:
    """A tree with the structure of the result of `_derived`: the names of the quantities."""
    if at is None:
        names = [f"{name}_{nm:.0f}" for name in _SPECTRA for nm in _WAVELENGTHS] + ["angstrom_exponent_440_870"]
    else:
        names = [*_SPECTRA, "absorption_optical_depth"]
    if isinstance(start.atmosphere.aerosol, _SPHERES):
        names += [*(() if at is None else _OF_SPHERES), *_RADII]
    one = dict.fromkeys(names, 0)
    return one, one


_kept_derived = kept(_derived, _shape_of)


def _unit(name: str) -> str:
    return "um" if name.endswith("radius") else "1"


def _spectra(aerosol, wavelength: Float[Array, " wavelength"]):
    """Optical depth, albedo and asymmetry."""
    depth, albedo = aerosol.optical_depth_at(wavelength), aerosol.single_scattering_albedo_at(wavelength)
    return depth, albedo, jnp.broadcast_to(aerosol.phase.moments(2, wavelength)[1], wavelength.shape)


def _radii(aerosol: _SPHERES) -> dict:
    return {name: getattr(aerosol, name) for name in _RADII}


def _products(model: SkyModel, wavelength, radius) -> dict:
    aerosol = model.atmosphere.aerosol
    depth, albedo, asymmetry = _spectra(aerosol, wavelength)
    found: dict[str, Array] = dict(zip(_SPECTRA, (depth, albedo, asymmetry), strict=True))
    found["absorption_optical_depth"] = depth * (1.0 - albedo)
    if not isinstance(aerosol, _SPHERES):
        return found
    sizes = *aerosol.index_at(wavelength), aerosol.volume_size_distribution(radius), *aerosol.volumes
    return found | dict(zip(_OF_SPHERES, sizes, strict=True)) | _radii(aerosol)


def _numbers(model: SkyModel) -> dict:
    aerosol = model.atmosphere.aerosol
    depth, albedo, asymmetry = _spectra(aerosol, as_float(_WAVELENGTHS))
    numbers = {
        f"{name}_{nm:.0f}": rows[i]
        for name, rows in zip(_SPECTRA, (depth, albedo, asymmetry), strict=True)
        for i, nm in enumerate(_WAVELENGTHS)
    }
    # without haze there is no exponent
    safe = jnp.where(depth > 0.0, depth, 1.0)
    slope = jnp.log(safe[0] / safe[-1]) / np.log(_WAVELENGTHS[-1] / _WAVELENGTHS[0])
    numbers["angstrom_exponent_440_870"] = slope
    return numbers | _radii(aerosol) if isinstance(aerosol, _SPHERES) else numbers
