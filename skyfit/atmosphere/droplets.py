"""Water droplets: fog and wet haze in a homogeneous layer on the ground."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..numerics import as_float, check_increasing, hat_weights, table_range, within
from ..tables import read_table
from .constituent import AbstractConstituent
from .phase import AbstractPhase, held, REFERENCE_WAVELENGTH, TABLE_WAVELENGTHS, Tabulated
from .profile import Layered


class Droplets(AbstractConstituent):
    r"""Droplets of one density from the ground to `thickness`: $\tau = \beta_{550}\, h\, Q(\lambda) / Q(550)$.

    `coefficient`, extinction at 550 nm, 0 to 10 m^-1; `thickness` h, 0.1 m to 100 km; `efficiency` Q `[band]` at
    `table_wavelength_nm` `[band]`, interpolated linearly; `phase`; `single_scattering_albedo`.
    May stand under any name of an `Atmosphere`.

    **Valid:** within the table. Other wavelengths are a `ValueError`; traced ones get the value at the table's end.
    **Source:** Klassen 1987, sec. 10 and 11: fog 0.015 to 0.040 m^-1, of uniform density; Q of Mie theory.

    **Example:**

        >>> fog = skyfit.Droplets.fog(0.02, 100.0)
        >>> round(float(fog.optical_depth_at(jnp.array([550.0]))[0]), 3)
        2.0
    """

    coefficient: Float[Array, ""] = eqx.field(converter=as_float, metadata=within(0.0, 10.0, "per metre"))
    thickness: Float[Array, ""] = eqx.field(converter=as_float, metadata=within(0.1, 1e5, "m"))
    table_wavelength_nm: Float[Array, " band"] = eqx.field(converter=as_float, metadata=TABLE_WAVELENGTHS)
    efficiency: Float[Array, " band"] = eqx.field(converter=as_float, metadata=within(0.0, 1e3))
    phase: AbstractPhase
    single_scattering_albedo: Float[Array, ""] = eqx.field(converter=as_float, default=1.0, metadata=within(0.0, 1.0))
    smooth_in_wavelength: ClassVar[bool] = True

    @property
    def known_nm(self) -> tuple[float, float]:
        """The wavelength range of the table, nm."""
        return table_range(self.table_wavelength_nm)

    def __check_init__(self):
        check_increasing("table_wavelength_nm", self.table_wavelength_nm)

    @classmethod
    def fog(cls, coefficient=0.02, thickness=100.0, phase: AbstractPhase | None = None) -> "Droplets":
        """Fog: droplets of 4.5 micrometres, lognormal with a geometric standard deviation of 1.4.

        **Arguments:** `coefficient` in m^-1, `thickness` in m; `phase`, None for the tabulated function. Its forward
        peak is 20 degrees wide; with few moments a Henyey-Greenstein function of g = 0.85 can replace it.
        **Valid:** 300 to 1100 nm. The efficiency of drops much larger than the wavelength hardly varies, so the
        values at the ends of the table (400 and 700 nm) hold beyond them.
        """
        return cls._of_kind("fog", coefficient, thickness, phase)

    @classmethod
    def wet_haze(cls, coefficient=1e-4, thickness=1200.0, phase: AbstractPhase | None = None) -> "Droplets":
        """Wet haze: droplets of 0.3 micrometres, geometric standard deviation 1.6; arguments as for `fog`.

        **Valid:** 400 to 700 nm.
        """
        return cls._of_kind("wet_haze", coefficient, thickness, phase)

    @classmethod
    def _of_kind(cls, kind: str, coefficient, thickness, phase) -> "Droplets":
        means = read_table("droplet_efficiencies.csv")
        phase = droplet_phase(kind) if phase is None else phase
        nm, efficiency = means["wavelength_nm"], means[f"{kind}_efficiency"]
        if kind == "fog":
            nm, efficiency = held(nm, efficiency)
        # pyright mistakes the inherited, abstract `profile` for an argument
        return cls(  # pyright: ignore[reportCallIssue]
            coefficient=coefficient,
            thickness=thickness,
            table_wavelength_nm=nm,
            efficiency=efficiency,
            phase=phase,
        )

    @property
    def profile(self):
        """One homogeneous layer."""
        return Layered(jnp.stack([jnp.zeros_like(self.thickness), self.thickness]), jnp.ones(1))

    def optical_depth_at(self, wavelength_nm):
        self.check_wavelengths(wavelength_nm)

        def relative(wavelength):
            return hat_weights(wavelength, self.table_wavelength_nm) @ self.efficiency

        ratio = relative(wavelength_nm) / relative(jnp.full((1,), REFERENCE_WAVELENGTH))
        return self.coefficient * self.thickness * ratio

    def single_scattering_albedo_at(self, wavelength_nm):
        return jnp.broadcast_to(jnp.clip(self.single_scattering_albedo, 0.0, 1.0), wavelength_nm.shape)


def droplet_phase(kind: str) -> Tabulated:
    """The tabulated phase function of a kind of droplets.

    **Arguments:** `kind`, "fog" or "wet_haze". **Returns:** `Tabulated`, 400 to 700 nm. For fog the end values hold to
    300 and 1100 nm.
    **Source:** Mie theory, Hale & Querry's water; data/droplets.csv.
    """
    table = read_table("droplets.csv")
    names = [name for name in table if name.startswith(f"{kind}_")]
    if not names:
        raise ValueError(f'`kind` must be "fog" or "wet_haze", got {kind!r}')
    bands = np.array([float(name.removeprefix(f"{kind}_").removesuffix("nm")) for name in names])
    values = np.stack([table[name] for name in names], axis=1)
    if kind == "fog":
        bands, values = held(bands, values)
    return Tabulated(np.radians(table["angle_deg"]), bands, values)
