"""Absorption by ozone."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics import hat_weights, read_table
from ..scene import as_float
from .constituent import AbstractConstituent
from .profile import AbstractProfile, OzoneLayer


# Dobson units in one atm-cm
DOBSON_PER_ATM_CM = 1000.0


class Ozone(AbstractConstituent):
    """Ozone: Chappuis and Huggins absorption without scattering.

    `column` in Dobson units, >= 0; `profile`. The coefficient is interpolated in a 5-10 nm table, so the fine
    structure of the Huggins bands below 340 nm is smoothed.
    Source: Bird & Riordan 1986 (Leckner 1978), as shipped by pvlib; see data/spectrl2_absorption.csv.
    """

    column: Float[Array, ""] = eqx.field(converter=as_float, default=300.0)
    profile: AbstractProfile = eqx.field(default_factory=OzoneLayer)
    phase: None = None
    smooth_in_wavelength: ClassVar[bool] = True

    def extinction(self, wavelength_nm):
        table = read_table("spectrl2_absorption.csv")
        weights = hat_weights(wavelength_nm, as_float(table["wavelength_nm"]))
        per_atm_cm = weights @ as_float(table["ozone_absorption"])
        return per_atm_cm * (self.column / DOBSON_PER_ATM_CM)

    def albedo(self, wavelength_nm):
        return jnp.zeros_like(wavelength_nm)
