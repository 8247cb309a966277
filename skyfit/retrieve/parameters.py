"""The parameters of a sky by name: which leaf each one is, in what unit, within which bounds."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..atmosphere import (
    Atmosphere,
    HenyeyGreenstein,
    optical_depth_to_turbidity,
    turbidity_to_optical_depth,
    TwoModeAerosol,
    TwoTermHenyeyGreenstein,
)
from ..numerics import as_float
from .model import SkyModel


def _same(value):
    return value


def _radians(degrees):
    return degrees * (np.pi / 180.0)


def _degrees(radians):
    return radians * (180.0 / np.pi)


class Parameter(NamedTuple):
    """One named scalar: its leaf in a `SkyModel`, unit, bounds and the scale on which it is fitted.

    `to_leaf` and `from_leaf` turn the stated unit into the leaf's. A log scale is for positive quantities.
    """

    name: str
    unit: str
    lower: float
    upper: float
    leaf: Callable[[SkyModel], Any]
    log: bool = False
    to_leaf: Callable = _same
    from_leaf: Callable = _same

    def bound(self, free):
        """The value at an unconstrained `free` number: a logistic curve between the bounds."""
        return self.from_scale(self.on_scale(free))

    def on_scale(self, free):
        """As `bound`, on the scale of the parameter: the logarithm of a positive quantity, else the value itself."""
        low, high = self._ends()
        return low + (high - low) * jax.nn.sigmoid(free)

    def from_scale(self, scaled):
        """The value that stands at a place of the parameter's scale."""
        return jnp.exp(scaled) if self.log else scaled

    def to_scale(self, value: float) -> float:
        """The inverse of `from_scale`, for one number."""
        return float(np.log(value)) if self.log else float(value)

    def unbound(self, value: float) -> float:
        """The inverse of `bound`, for a value inside the bounds (nudged inside by 1 % of the range)."""
        low, high = self._ends()
        share = (self.to_scale(value) - low) / (high - low)
        share = np.clip(share, 0.01, 0.99)
        return float(np.log(share / (1.0 - share)))

    def place_of(self, model: SkyModel) -> Float[Array, ""]:
        """The unconstrained number of a model's value, which may be traced; `unbound` for traced values."""
        low, high = self._ends()
        value = self.from_leaf(self.leaf(model))
        share = jnp.clip(((jnp.log(value) if self.log else value) - low) / (high - low), 0.01, 0.99)
        return jnp.log(share / (1.0 - share))

    def at_bound(self, value: float) -> bool:
        """Whether the value lies within a thousandth of the range from a bound."""
        low, high = self._ends()
        share = (self.to_scale(value) - low) / (high - low)
        return bool(share < 1e-3 or share > 1.0 - 1e-3)

    def spread(self, value: float) -> float:
        """The allowed range in the parameter's unit; on a log scale one e-fold of the value."""
        return float(value) if self.log else self.upper - self.lower

    def _ends(self):
        if self.log:
            return np.log(self.lower), np.log(self.upper)
        return self.lower, self.upper


_LIST = (
    Parameter(
        "turbidity",
        "1",
        1.001,
        50.0,
        lambda m: m.atmosphere.aerosol.optical_depth,
        True,
        turbidity_to_optical_depth,
        optical_depth_to_turbidity,
    ),
    Parameter("aerosol_optical_depth", "1", 1e-4, 5.0, lambda m: m.atmosphere.aerosol.optical_depth, True),
    Parameter("angstrom_exponent", "1", -0.5, 3.5, lambda m: m.atmosphere.aerosol.angstrom_exponent),
    Parameter(
        "single_scattering_albedo",
        "1",
        0.4,
        1.0,
        lambda m: m.atmosphere.aerosol.single_scattering_albedo,
    ),
    Parameter(
        "single_scattering_albedo_slope",
        "1",
        -0.5,
        0.5,
        lambda m: m.atmosphere.aerosol.single_scattering_albedo_slope,
    ),
    Parameter("asymmetry", "1", 0.0, 0.95, lambda m: m.atmosphere.aerosol.phase.asymmetry),
    Parameter("asymmetry_second", "1", -0.9, 0.95, lambda m: m.atmosphere.aerosol.phase.asymmetry_second),
    Parameter("forward_fraction", "1", 0.0, 1.0, lambda m: m.atmosphere.aerosol.phase.forward_fraction),
    Parameter("forward_fraction_slope", "1", -0.5, 0.5, lambda m: m.atmosphere.aerosol.phase.forward_fraction_slope),
    Parameter("haze_polarisation", "1", 0.0, 1.0, lambda m: m.atmosphere.aerosol.phase.polarisation),
    Parameter("fine_fraction", "1", 0.0, 1.0, lambda m: m.atmosphere.aerosol.fine_fraction),
    Parameter("fine_radius", "um", 0.05, 0.5, lambda m: m.atmosphere.aerosol.fine_radius, True),
    Parameter("coarse_radius", "um", 0.8, 6.0, lambda m: m.atmosphere.aerosol.coarse_radius, True),
    Parameter("fine_width", "1", 0.3, 0.8, lambda m: m.atmosphere.aerosol.fine_width),
    Parameter("coarse_width", "1", 0.3, 0.9, lambda m: m.atmosphere.aerosol.coarse_width),
    Parameter("refractive_index", "1", 1.33, 1.6, lambda m: m.atmosphere.aerosol.refractive_index),
    Parameter("absorption_index", "1", 1e-4, 0.1, lambda m: m.atmosphere.aerosol.absorption_index, True),
    Parameter(
        "aerosol_scale_height",
        "m",
        200.0,
        8000.0,
        lambda m: m.atmosphere.aerosol.profile.scale_height,
        True,
    ),
    Parameter("ozone", "DU", 50.0, 700.0, lambda m: m.atmosphere.ozone.column),
    Parameter("ground_albedo", "1", 0.0, 1.0, lambda m: m.atmosphere.ground.albedo),
    Parameter("ground_albedo_slope", "1", -1.0, 1.0, lambda m: m.atmosphere.ground.albedo_slope),
    Parameter("ground_red_edge", "1", 0.0, 1.0, lambda m: m.atmosphere.ground.red_edge),
    Parameter("pressure", "Pa", 3e4, 1.1e5, lambda m: m.atmosphere.rayleigh.pressure),
    Parameter(
        "pointing_zenith",
        "degree",
        -6.0,
        6.0,
        lambda m: m.instrument.pointing_zenith,
        False,
        _radians,
        _degrees,
    ),
    Parameter(
        "pointing_azimuth",
        "degree",
        -20.0,
        20.0,
        lambda m: m.instrument.pointing_azimuth,
        False,
        _radians,
        _degrees,
    ),
)
PARAMETERS: dict[str, Parameter] = {p.name: p for p in _LIST}
_TWO_TERM = ("asymmetry_second", "forward_fraction", "forward_fraction_slope")
_PARTICLES = (
    "fine_fraction", "fine_radius", "coarse_radius", "fine_width", "coarse_width", "refractive_index",
    "absorption_index",
)  # fmt: skip


# of the haze where a fit starts
_DEPTH = 0.15


def start_model(free: tuple[str, ...], pressure: float) -> SkyModel:
    """The model a fit starts from: the defaults of `Atmosphere.from_optical_depth`, optical depth 0.15.

    The phase function has two lobes if a second one is to be fitted; the haze is one of spheres in two modes of size,
    whose optics follow, if anything of these is.

    **Arguments:** names that are free; `pressure` of the station, Pa. **Returns:** a `SkyModel`.
    """
    two_terms = any(name in free for name in _TWO_TERM)
    phase = TwoTermHenyeyGreenstein(0.75, 0.1, 0.8) if two_terms else HenyeyGreenstein(0.7)
    model = SkyModel(Atmosphere.from_optical_depth(_DEPTH, phase=phase))
    if any(name in free for name in _PARTICLES):
        # pyright takes the inherited, abstract `phase` for an argument
        spheres = TwoModeAerosol(_DEPTH, fine_fraction=0.7)  # pyright: ignore[reportCallIssue]
        model = eqx.tree_at(lambda m: m.atmosphere.aerosol, model, spheres)
    return eqx.tree_at(lambda m: m.atmosphere.rayleigh.pressure, model, as_float(pressure))


def check_free(free: tuple[str, ...], model: SkyModel, argument: str = "free") -> None:
    """A `ValueError` about `argument` unless every name is a parameter that this model has, once, not contradicting."""
    if not free:
        raise ValueError(f"`{argument}` must name at least one parameter")
    for name in free:
        if name not in PARAMETERS:
            raise ValueError(f"`{argument}` must name parameters among {', '.join(PARAMETERS)}; got {name!r}")
        if not _present(PARAMETERS[name], model):
            raise ValueError(f"`{argument}` names {name!r}, which this atmosphere does not have")
    if len(set(free)) < len(free):
        raise ValueError(f"`{argument}` must name each parameter once, got {', '.join(free)}")
    if "turbidity" in free and "aerosol_optical_depth" in free:
        raise ValueError(f"`{argument}` must not hold both turbidity and aerosol_optical_depth: they are one")


def _present(parameter: Parameter, model: SkyModel) -> bool:
    try:
        return parameter.leaf(model) is not None
    except AttributeError:
        return False


def values_of(model: SkyModel, names) -> dict[str, float]:
    """The values of the named parameters in their stated units; those the model lacks are left out."""
    present = (PARAMETERS[n] for n in names if _present(PARAMETERS[n], model))
    return {p.name: p.from_leaf(float(p.leaf(model))) for p in present}


def fixed_values(model: SkyModel, free: tuple[str, ...]) -> dict[str, float]:
    """The values that are not fitted, by name; turbidity and optical depth, one quantity, once."""
    hidden = "aerosol_optical_depth" if "turbidity" in free else "turbidity"
    return {n: v for n, v in values_of(model, PARAMETERS).items() if n not in free and n != hidden}


def partition(model: SkyModel, names: tuple[str, ...]):
    """The model's free leaves and the rest, as `eqx.partition` gives them."""
    nothing = jax.tree_util.tree_map(lambda _: False, model)
    chosen = eqx.tree_at(lambda m: [PARAMETERS[n].leaf(m) for n in names], nothing, [True] * len(names))
    return eqx.partition(model, chosen)


def with_values(fixed: SkyModel, names: tuple[str, ...], values) -> SkyModel:
    """The model with the named parameters set to values in their stated units, in order.

    **Arguments:** `fixed`, a whole model or the fixed half of `partition`; `values`, scalars or one array.
    """
    leaves = [as_float(PARAMETERS[n].to_leaf(values[i])) for i, n in enumerate(names)]
    return eqx.tree_at(lambda m: [PARAMETERS[n].leaf(m) for n in names], fixed, leaves, is_leaf=lambda x: x is None)
