"""Gases that absorb and do not scatter."""

from abc import abstractmethod
from typing import ClassVar, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..numerics import as_float, check_increasing, hat_weights, table_range, within
from ..tables import read_table
from .constituent import AbstractConstituent
from .phase import TABLE_WAVELENGTHS
from .profile import AbstractProfile, OzoneLayer


# Dobson units in a layer of one metre at 0 C and 1013.25 mb; one Dobson unit is 10 micrometres
DOBSON_PER_METRE = 1e5
# Molecules per cm^2 in a Dobson unit: Loschmidt's number, CODATA 2018, 2.686780111e25 m^-3 at 0 C and 1013.25 mb, times
# 10 micrometres
MOLECULES_PER_DOBSON = 2.686780111e16
_M_PER_CM = 0.01


class AbstractGas(AbstractConstituent):
    r"""A gas that follows Bouguer's law, $\tau(\lambda) = k(\lambda)\, u$, with the column u in `unit`."""

    column: eqx.AbstractVar[Float[Array, ""]]
    unit: eqx.AbstractVar[str]

    @abstractmethod
    def absorption(self, wavelength_nm: Float[Array, " wavelength"]) -> Float[Array, " wavelength"]:
        """The vertical optical depth per unit of the column."""

    def optical_depth_at(self, wavelength_nm):
        self.check_wavelengths(wavelength_nm)
        return self.absorption(wavelength_nm) * self.column

    def single_scattering_albedo_at(self, wavelength_nm):
        return jnp.zeros_like(wavelength_nm)


class Gas(AbstractGas):
    """A gas given by a table of its absorption, interpolated linearly.

    `column` in `unit`, >= 0; `table_wavelength_nm` `[band]`, increasing; `absorption_per_unit` `[band]`, the vertical
    optical depth per unit of the column, >= 0; `profile`; `unit`, by default Dobson units ("DU").

    **Valid:** within the table, and beyond an end where the absorption is 0. Other wavelengths are a `ValueError`;
    traced ones get the value at the table's end.

    **Example:**

        >>> band, per_unit = np.array([400.0, 500.0, 600.0]), np.array([1e-3, 2e-3, 0.0])
        >>> gas = skyfit.Gas(5.0, band, per_unit, skyfit.Exponential(1000.0))
        >>> round(float(gas.optical_depth_at(450.0)), 4)
        0.0075
    """

    column: Float[Array, ""] = eqx.field(converter=as_float, metadata=within(0.0, 1e30))
    table_wavelength_nm: Float[Array, " band"] = eqx.field(converter=as_float, metadata=TABLE_WAVELENGTHS)
    absorption_per_unit: Float[Array, " band"] = eqx.field(converter=as_float, metadata=within(0.0, 1e30))
    profile: AbstractProfile
    unit: str = eqx.field(static=True, default="DU")
    phase: ClassVar[None] = None
    smooth_in_wavelength: ClassVar[bool] = True
    factors_out: ClassVar[bool] = False

    @property
    def known_nm(self) -> tuple[float, float]:
        """The wavelength range of the table, nm, open at an end where the absorption is 0."""
        return table_range(self.table_wavelength_nm, self.absorption_per_unit)

    def __check_init__(self):
        if self.table_wavelength_nm.shape != self.absorption_per_unit.shape:
            raise ValueError(
                "`absorption_per_unit` must be given at `table_wavelength_nm`, "
                f"got {self.absorption_per_unit.shape} for {self.table_wavelength_nm.shape}"
            )
        check_increasing("table_wavelength_nm", self.table_wavelength_nm)

    @classmethod
    def from_cross_section(cls, column, table_wavelength_nm, cross_section, profile: AbstractProfile) -> "Gas":
        """A gas from the absorption cross section of its molecules.

        **Arguments:** `column` in Dobson units (2.687e16 molecules cm^-2); `cross_section` `[band]`, cm^2 a molecule,
        at `table_wavelength_nm` `[band]`; `profile`. **Returns:** a `Gas` with `unit` "DU".
        """
        per_dobson = np.asarray(cross_section, np.float64) * MOLECULES_PER_DOBSON
        return cls(
            column=as_float(column),
            table_wavelength_nm=as_float(table_wavelength_nm),
            absorption_per_unit=as_float(per_dobson),
            profile=profile,
        )

    def absorption(self, wavelength_nm):
        return hat_weights(as_float(wavelength_nm), self.table_wavelength_nm) @ self.absorption_per_unit


class Ozone(AbstractGas):
    """Ozone: Chappuis and Huggins absorption.

    `column` in Dobson units, 0 to 1000; `profile`; `table` "spectrl2" (default) or "preetham". The coefficient is
    interpolated in a 5-10 nm table, so the fine structure of the Huggins bands below 340 nm is smoothed.

    **Valid:** from 300 nm. Shorter wavelengths are a `ValueError`, because the Hartley band is up to 40 times stronger
    there; traced ones get the value at 300 nm. For the Hartley band use `Gas.from_cross_section`.

    **Source:** Bird & Riordan 1986 (Leckner 1978), as shipped by pvlib; see data/spectrl2_absorption.csv. "preetham":
    Preetham 1999, Table 2, from 380 to 780 nm, where a gap is no absorption; it too is Leckner's and has the rows of
    580 to 680 nm that Bird & Riordan leave out, up to 5 % more; beyond, those of Bird & Riordan.

    **Example:**

        >>> layer = skyfit.Ozone(300.0)
        >>> bool(layer.optical_depth_at(600.0) > 20.0 * layer.optical_depth_at(450.0))
        True
    """

    column: Float[Array, ""] = eqx.field(converter=as_float, default=300.0, metadata=within(0.0, 1e3, "DU"))
    profile: AbstractProfile = eqx.field(default_factory=OzoneLayer)
    table: Literal["spectrl2", "preetham"] = eqx.field(static=True, default="spectrl2")
    unit: ClassVar[str] = "DU"
    phase: ClassVar[None] = None
    smooth_in_wavelength: ClassVar[bool] = True

    @property
    def known_nm(self) -> tuple[float, float]:
        """The wavelength range of the table, nm, open at an end where the absorption is 0."""
        return table_range(*self._table)

    def __check_init__(self):
        if self.table not in ("spectrl2", "preetham"):
            raise ValueError(f'`table` must be "spectrl2" or "preetham", got {self.table!r}')

    @property
    def _table(self) -> tuple[Float[np.ndarray, " band"], Float[np.ndarray, " band"]]:
        """Wavelengths, nm, and the absorption per Dobson unit."""
        if self.table == "preetham":
            nm, per_metre = preetham_absorption("ozone_absorption")
            return nm, per_metre / DOBSON_PER_METRE
        shipped = read_table("spectrl2_absorption.csv")
        return shipped["wavelength_nm"], shipped["ozone_absorption"] / (_M_PER_CM * DOBSON_PER_METRE)

    def absorption(self, wavelength_nm):
        nm, per_dobson = self._table
        return hat_weights(as_float(wavelength_nm), as_float(nm)) @ as_float(per_dobson)


def preetham_absorption(name: str) -> tuple[Float[np.ndarray, " band"], Float[np.ndarray, " band"]]:
    """Leckner's absorption coefficients, from Preetham's table at 380 to 780 nm and from SPECTRL2 beyond.

    **Arguments:** `name`, "ozone_absorption" or "water_absorption", per metre, or "mixed_gas_absorption".
    **Returns:** wavelengths in nm and the coefficients there; a gap in the paper counts as 0.
    **Source:** Preetham 1999, Table 2; Bird & Riordan 1986, Table 1, which has the first two per cm.
    """
    paper, beyond = read_table("preetham_table2_spectra.csv"), read_table("spectrl2_absorption.csv")
    inside = paper["wavelength_nm"]
    outside = (beyond["wavelength_nm"] < inside[0]) | (beyond["wavelength_nm"] > inside[-1])
    nm = np.concatenate([inside, beyond["wavelength_nm"][outside]])
    unit = 1.0 if name == "mixed_gas_absorption" else 1.0 / _M_PER_CM
    coefficient = np.concatenate([np.nan_to_num(paper[name]), unit * beyond[name][outside]])
    order = np.argsort(nm)
    return nm[order], coefficient[order]
