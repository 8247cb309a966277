"""What a fit says of the haze beyond its own parameters: optical depths, exponents, albedos, radii and their errors."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..atmosphere import TwoModeAerosol
from ..numerics import as_float
from .model import SkyModel
from .parameters import with_values
from .result import Fit


# nm, where sun photometers state them (AERONET's almucantars)
_WAVELENGTHS = (440.0, 675.0, 870.0)


class Derived(NamedTuple):
    """One quantity at each time: value, sigma as in `Fit.sigma`, and unit."""

    value: Float[np.ndarray, " time"]
    sigma: Float[np.ndarray, " time"]
    unit: str


def aerosol_optics(fit: Fit) -> dict[str, Derived]:
    r"""The optics of a fitted haze by name, as sun photometers state them.

    At 440, 675 and 870 nm `aerosol_optical_depth_*`, `single_scattering_albedo_*` and `asymmetry_*`, the mean cosine of
    the phase function; `angstrom_exponent_440_870`; of spheres in two modes of size also `fine_effective_radius`,
    `coarse_effective_radius` and `effective_radius` of both.

    **Arguments:** `fit` of any haze but one given per wavelength. **Returns:** empty without such a haze. Sigma is
    $\sqrt{G C G^T}$ with the parameters' covariance C and the gradient G: what is held fixed has no error here.
    **Valid:** the wavelengths of a fit; beyond them the numbers follow from the model's laws.
    """
    atmosphere = fit.start.atmosphere
    if "aerosol" not in atmosphere or atmosphere.aerosol.phase is None or not atmosphere.aerosol.smooth_in_wavelength:
        return {}
    # in the dtype of this process, whatever that of the fit was
    start = jax.tree.map(lambda leaf: as_float(np.asarray(leaf)), fit.start)
    values, names = as_float(fit.values), tuple(jax.eval_shape(_numbers, start))

    def numbers(row):
        by_name = _numbers(with_values(start, fit.free, row))
        return jnp.stack([by_name[name] for name in names])

    found = np.asarray(jax.lax.map(numbers, values), float)
    gradient = np.asarray(jax.lax.map(jax.jacfwd(numbers), values), float)
    known = np.where(np.isfinite(fit.covariance), fit.covariance, 0.0)
    variance = np.einsum("tqp,tpr,tqr->tq", gradient, known, gradient)
    # a parameter of which nothing is known leaves nothing known of what depends on it
    open_ended = ~np.isfinite(np.einsum("tpp->tp", fit.covariance))
    touched = np.any((gradient != 0.0) & open_ended[:, None], axis=2)
    sigma = np.where(touched, np.inf, np.sqrt(np.maximum(variance, 0.0)))
    return {name: Derived(found[:, i], sigma[:, i], _unit(name)) for i, name in enumerate(names)}


def _unit(name: str) -> str:
    return "um" if name.endswith("radius") else "1"


def _numbers(model: SkyModel) -> dict:
    aerosol = model.atmosphere.aerosol
    wavelength = as_float(_WAVELENGTHS)
    depth, albedo = aerosol.optical_depth_at(wavelength), aerosol.single_scattering_albedo_at(wavelength)
    asymmetry = jnp.broadcast_to(aerosol.phase.moments(2, wavelength)[1], wavelength.shape)
    numbers = {
        f"{name}_{nm:.0f}": rows[i]
        for name, rows in (
            ("aerosol_optical_depth", depth), ("single_scattering_albedo", albedo), ("asymmetry", asymmetry)
        )
        for i, nm in enumerate(_WAVELENGTHS)
    }  # fmt: skip
    # without haze it has no exponent
    safe = jnp.where(depth > 0.0, depth, 1.0)
    slope = jnp.log(safe[0] / safe[-1]) / np.log(_WAVELENGTHS[-1] / _WAVELENGTHS[0])
    numbers["angstrom_exponent_440_870"] = slope
    if isinstance(aerosol, TwoModeAerosol):
        numbers |= {
            "fine_effective_radius": aerosol.fine_effective_radius,
            "coarse_effective_radius": aerosol.coarse_effective_radius,
            "effective_radius": aerosol.effective_radius,
        }
    return numbers
