"""The haze and fog of Hoffman & Preetham's article."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..numerics import as_float, check_range, check_wavelength, hat_weights
from ..tables import read_table
from .constituent import Prescribed
from .phase import HenyeyGreenstein
from .profile import Exponential


# Kinds of haze, in the order of the table's rows
_KINDS = ("light haze", "heavy haze", "light fog", "heavy fog")
# The article's sample wavelengths for red, green and blue, nm
HOFFMAN_WAVELENGTHS = (650.0, 570.0, 475.0)
# Vertical optical length of haze, m
_LENGTH = 1250.0
# Largest absorption coefficient of haze in the article, m^-1
_MOST_ABSORPTION = 5e-5


def hoffman_haze(
    kind: str, wavelength_nm: Float[ArrayLike, " wavelength"], absorption: float | Float[Array, ""] = 0.0
) -> Prescribed:
    r"""Haze or fog from the article's table, with a scale height of 1.25 km, as an aerosol for an `Atmosphere`.

    The scattering coefficient follows a power law between 475, 570 and 650 nm. The power laws of the outer intervals
    extend to 300 and 1100 nm; other wavelengths are a `ValueError`.

    **Arguments:** `kind`, "light haze", "heavy haze", "light fog" or "heavy fog"; `wavelength_nm` of the
    scene, `[wavelength]`; `absorption` coefficient, m^-1, grey.
    **Returns:** a `Prescribed` constituent.
    **Valid:** `absorption` 0 to 5e-5 /m, else `ValueError` (a traced value is not checked). The g used here is between
    0 and 1 (data/hoffman_haze.csv): the printed -1, -3, -10, -30 are not asymmetry parameters, and with the printed
    numerator (1 - g)^2 the phase function does not integrate to one.
    **Source:** Hoffman & Preetham 2002, Table 1 and Sunlight.

    **Example:**

        >>> haze = skyfit.hoffman_haze("light haze", np.array([475.0, 570.0, 650.0]))
        >>> bool(np.all(np.diff(haze.optical_depth) < 0.0))
        True
    """
    if kind not in _KINDS:
        raise ValueError(f"`kind` must be one of {', '.join(_KINDS)}, got {kind!r}")
    check_wavelength(wavelength_nm, 300.0, 1100.0, "of the article's powers")
    check_range("absorption", absorption, 0.0, _MOST_ABSORPTION, "per metre")
    table = {name: float(column[_KINDS.index(kind)]) for name, column in read_table("hoffman_haze.csv").items()}
    place = np.log(HOFFMAN_WAVELENGTHS[::-1])
    value = np.log([table["blue"], table["green"], table["red"]])
    slope = np.diff(value) / np.diff(place)
    at = jnp.log(as_float(wavelength_nm))
    inside = hat_weights(at, as_float(place)) @ as_float(value)
    beyond = slope[0] * jnp.minimum(at - place[0], 0.0) + slope[1] * jnp.maximum(at - place[-1], 0.0)
    scattering: Float[Array, " wavelength"] = jnp.exp(inside + beyond)
    extinction = scattering + absorption
    return Prescribed(
        optical_depth=extinction * _LENGTH,
        profile=Exponential(_LENGTH),
        phase=HenyeyGreenstein(table["asymmetry"]),
        single_scattering_albedo=scattering / extinction,
    )
