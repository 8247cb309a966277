"""The parameters of a sky by name: the leaf, unit and bounds of each."""

import functools
from collections.abc import Callable
from difflib import get_close_matches
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..atmosphere import (
    Aerosol,
    Atmosphere,
    BIN_RADII,
    BinnedAerosol,
    HenyeyGreenstein,
    optical_depth_to_turbidity,
    Ozone,
    Rayleigh,
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
    """One named scalar: its leaf in a `SkyModel`, unit, bounds, the scale on which it is fitted, and its properties.

    - `place`: path of the leaf, for instance "atmosphere.aerosol.optical_depth", with the constituent's name
    - `log`: fitted as its logarithm, for positive quantities
    - `to_leaf`, `from_leaf`: conversion from the stated unit to the leaf's and back
    - `slow`: constant over a day, like the kind of particle and the air; the amount of haze, the pointing and, under a
      moving sun, the reflection by the ground are not
    - `group`: "two lobes", "particles" or "size bins", for parameters that only a haze of that kind has
    - `usual`: the sets of parameters that a sky scan determines and that include this one: "lobes" (`LOBES_FREE`),
      "particles" (`PARTICLE_FREE`) or "bins" (`BINS_FREE`)
    - `climatology`: value and sigma of the prior if the user gives none, for parameters that a scan alone hardly
      determines
    - `index`: position of the number if the leaf is an array
    """

    name: str
    unit: str
    lower: float
    upper: float
    place: str
    log: bool = False
    to_leaf: Callable = _same
    from_leaf: Callable = _same
    slow: bool = False
    group: str | None = None
    usual: tuple[str, ...] = ()
    climatology: tuple[float, float] | None = None
    index: int | None = None

    @property
    def of_instrument(self) -> bool:
        """Whether the parameter belongs to the instrument, not to the atmosphere."""
        return self.place.startswith("instrument.")

    def leaf(self, model: SkyModel) -> Any:
        """The parameter's leaf in a model or in a half of `partition`; `AttributeError` where there is none."""
        leaf: Any = functools.reduce(getattr, self.place.split("."), model)
        return leaf if self.index is None or leaf is None else leaf[..., self.index]

    def bound(self, free):
        """The value at an unconstrained `free` number: a logistic curve between the bounds."""
        low, high = self.ends()
        scaled = low + (high - low) * jax.nn.sigmoid(free)
        return jnp.exp(scaled) if self.log else scaled

    def to_scale(self, value: float) -> float:
        """The position of a value on the parameter's scale: its logarithm if `log` is set, else the value itself."""
        return float(np.log(value)) if self.log else float(value)

    def unbound(self, value: float) -> float:
        """The inverse of `bound`, for a value inside the bounds (nudged inside by 1 % of the range)."""
        low, high = self.ends()
        share = (self.to_scale(value) - low) / (high - low)
        share = np.clip(share, 0.01, 0.99)
        return float(np.log(share / (1.0 - share)))

    def free_of(self, model: SkyModel) -> Float[Array, ""]:
        """The unconstrained number of a model's value: the same as `unbound`, for values that may be traced."""
        low, high = self.ends()
        value = self.from_leaf(self.leaf(model))
        share = jnp.clip(((jnp.log(value) if self.log else value) - low) / (high - low), 0.01, 0.99)
        return jnp.log(share / (1.0 - share))

    def at_bound(self, value: float) -> bool:
        """Whether the value lies within a thousandth of the range from a bound."""
        low, high = self.ends()
        share = (self.to_scale(value) - low) / (high - low)
        return bool(share < 1e-3 or share > 1.0 - 1e-3)

    def spread(self, value: float) -> float:
        """The allowed range in the parameter's unit; on a log scale one e-fold of the value."""
        return float(value) if self.log else self.upper - self.lower

    def ends(self) -> tuple[float, float]:
        """The bounds on the parameter's scale."""
        if self.log:
            return np.log(self.lower), np.log(self.upper)
        return self.lower, self.upper


_HAZE, _GROUND = "atmosphere.aerosol", "atmosphere.ground"
_LOBES, _PARTICLES, _BINS = ("lobes",), ("particles",), ("bins",)
_SPHERES, _ALL = _PARTICLES + _BINS, _LOBES + _PARTICLES + _BINS
_LIST = (
    Parameter(
        "turbidity", "1", 1.001, 50.0, f"{_HAZE}.optical_depth", log=True, to_leaf=turbidity_to_optical_depth,
        from_leaf=optical_depth_to_turbidity,
    ),
    Parameter("aerosol_optical_depth", "1", 1e-4, 5.0, f"{_HAZE}.optical_depth", log=True,
        usual=_LOBES + _PARTICLES,
    ),
    Parameter("angstrom_exponent", "1", -0.5, 3.5, f"{_HAZE}.angstrom_exponent", usual=_LOBES),
    Parameter("angstrom_curvature", "1", -1.0, 1.0, f"{_HAZE}.angstrom_curvature", slow=True),
    Parameter(
        "single_scattering_albedo", "1", 0.4, 1.0, f"{_HAZE}.single_scattering_albedo", slow=True, usual=_LOBES,
    ),
    Parameter(
        "single_scattering_albedo_slope", "1", -0.5, 0.5, f"{_HAZE}.single_scattering_albedo_slope", slow=True,
    ),
    Parameter("asymmetry", "1", 0.0, 0.95, f"{_HAZE}.phase.asymmetry", slow=True, usual=_LOBES),
    Parameter(
        "asymmetry_second", "1", -0.9, 0.95, f"{_HAZE}.phase.asymmetry_second", slow=True, group="two lobes",
        usual=_LOBES,
    ),
    Parameter(
        "forward_fraction", "1", 0.0, 1.0, f"{_HAZE}.phase.forward_fraction", slow=True, group="two lobes",
        usual=_LOBES,
    ),
    Parameter(
        "forward_fraction_slope", "1", -0.5, 0.5, f"{_HAZE}.phase.forward_fraction_slope", slow=True,
        group="two lobes", usual=_LOBES,
    ),
    Parameter("haze_polarisation", "1", 0.0, 1.0, f"{_HAZE}.phase.polarisation", slow=True),
    Parameter(
        "fine_fraction", "1", 0.0, 1.0, f"{_HAZE}.fine_fraction", slow=True, group="particles", usual=_PARTICLES,
    ),
    Parameter(
        "fine_radius", "um", 0.05, 0.5, f"{_HAZE}.fine_radius", log=True, slow=True, group="particles",
        usual=_PARTICLES,
    ),
    Parameter(
        "coarse_radius", "um", 0.8, 6.0, f"{_HAZE}.coarse_radius", log=True, slow=True, group="particles",
        usual=_PARTICLES,
    ),
    # priors of sizes and indices: spread of AERONET's climatologies (Dubovik et al. 2002, J. Atmos. Sci. 59, 590,
    # table 1)
    Parameter(
        "fine_width", "1", 0.3, 0.8, f"{_HAZE}.fine_width", slow=True, group="particles", usual=_PARTICLES,
        climatology=(0.42, 0.08),
    ),
    Parameter(
        "coarse_width", "1", 0.3, 0.9, f"{_HAZE}.coarse_width", slow=True, group="particles", usual=_PARTICLES,
        climatology=(0.68, 0.08),
    ),
    Parameter(
        "refractive_index", "1", 1.33, 1.6, f"{_HAZE}.refractive_index", slow=True, group="particles",
        usual=_SPHERES, climatology=(1.45, 0.06),
    ),
    Parameter(
        "absorption_index", "1", 1e-4, 0.1, f"{_HAZE}.absorption_index", log=True, slow=True, group="particles",
        usual=_SPHERES, climatology=(0.006, 0.008),
    ),
    # n changes by 0.01 from 440 to 1020 nm; the exponent of k is 0 for soot and up to 2 for dust (ibid.)
    Parameter(
        "refractive_index_slope", "1", -0.15, 0.15, f"{_HAZE}.refractive_index_slope", slow=True, group="size bins",
        usual=_BINS, climatology=(0.0, 0.02),
    ),
    Parameter(
        "absorption_index_exponent", "1", -4.0, 4.0, f"{_HAZE}.absorption_index_exponent", slow=True,
        group="size bins", usual=_BINS, climatology=(0.0, 1.0),
    ),
    Parameter(
        "absorption_index_curvature", "1", -6.0, 6.0, f"{_HAZE}.absorption_index_curvature", slow=True,
        group="size bins", usual=_BINS, climatology=(0.0, 1.0),
    ),
    # hardly any particles in the first and the last bin (Dubovik & King 2000, J. Geophys. Res. 105, 20673, sec. 3.2)
    *(
        Parameter(
            f"size_bin_{i + 1}", "um3/um2", 1e-6, 10.0, f"{_HAZE}.bins", log=True, slow=True, group="size bins",
            usual=_BINS, index=i, climatology=(1e-3, 2e-3) if i in (0, BIN_RADII.size - 1) else None,
        )
        for i in range(BIN_RADII.size)
    ),
    Parameter(
        "aerosol_scale_height", "m", 200.0, 8000.0, f"{_HAZE}.profile.scale_height", log=True, slow=True,
    ),
    Parameter("ozone", "DU", 50.0, 700.0, "atmosphere.ozone.column", slow=True),
    Parameter("ground_albedo", "1", 0.0, 1.0, f"{_GROUND}.albedo", usual=_ALL),
    Parameter("ground_albedo_slope", "1", -1.0, 1.0, f"{_GROUND}.albedo_slope", slow=True),
    Parameter("ground_red_edge", "1", 0.0, 1.0, f"{_GROUND}.red_edge", usual=_SPHERES),
    Parameter("pressure", "Pa", 3e4, 1.1e5, "atmosphere.rayleigh.pressure", slow=True),
    Parameter(
        "pointing_zenith", "degree", -6.0, 6.0, "instrument.pointing_zenith", to_leaf=_radians, from_leaf=_degrees,
        usual=_ALL,
    ),
    Parameter(
        "pointing_azimuth", "degree", -20.0, 20.0, "instrument.pointing_azimuth", to_leaf=_radians,
        from_leaf=_degrees, usual=_ALL,
    ),
    Parameter(
        "sun_zenith_offset", "degree", -12.0, 12.0, "instrument.sun_zenith", to_leaf=_radians, from_leaf=_degrees,
    ),
)  # fmt: skip
PARAMETERS: dict[str, Parameter] = {p.name: p for p in _LIST}
"""All that can be fitted, by name: unit, bounds (`lower`, `upper`), and the place of each in the model."""
# parameters that a sky scan determines, and the pointing: for haze of two lobes, of spheres in two modes, and in bins
LOBES_FREE = tuple(p.name for p in _LIST if "lobes" in p.usual)
PARTICLE_FREE = tuple(p.name for p in _LIST if "particles" in p.usual)
BINS_FREE = tuple(p.name for p in _LIST if "bins" in p.usual)
SIZE_BINS = tuple(p.name for p in _LIST if p.index is not None)
SLOW = tuple(p.name for p in _LIST if p.slow)
# parameters that a picture's pattern determines if its level, white and ground are unknown; those of a guessed sun
PICTURE_FREE, SUN_FREE = ("turbidity", "asymmetry"), ("sun_zenith_offset", "pointing_azimuth")
# parameters of the instrument's pointing
POINTING = ("pointing_zenith", "pointing_azimuth")


# optical depth of the haze where a fit starts
_DEPTH = 0.15


def start_model(free: tuple[str, ...], pressure: float, ozone: float = 300.0) -> SkyModel:
    """The model a fit starts from: the defaults of `Atmosphere.from_optical_depth`, optical depth 0.15.

    The phase function has two lobes if `free` names a parameter of the second lobe. The haze consists of spheres in
    size bins or in two size modes, which determine its optics, if `free` names a parameter of these.

    **Arguments:** names that are free; `pressure` of the station, Pa; `ozone` over it, DU. **Returns:** a `SkyModel`.
    """
    groups = {PARAMETERS[name].group for name in free if name in PARAMETERS}
    if groups & {"particles", "size bins"}:
        # pyright takes the inherited, abstract `phase` for an argument
        haze = TwoModeAerosol(_DEPTH, fine_fraction=0.7)  # pyright: ignore[reportCallIssue]
        haze = BinnedAerosol.like(haze) if "size bins" in groups else haze
    else:
        two_lobes = TwoTermHenyeyGreenstein(0.75, 0.1, 0.8)
        lobes = two_lobes if "two lobes" in groups else HenyeyGreenstein(0.7)
        haze = Aerosol(optical_depth=as_float(_DEPTH), phase=lobes)
    return SkyModel(Atmosphere(Rayleigh(pressure=as_float(pressure)), haze, Ozone(column=as_float(ozone))))


def check_free(free: tuple[str, ...], model: SkyModel, argument: str = "free", per_wavelength: bool = False) -> None:
    """Raise a `ValueError` about `argument` unless the names are distinct, consistent parameters of this model.

    A value given per wavelength counts as a parameter if `per_wavelength` is true: it moves as a whole.
    """
    if not free:
        raise ValueError(f"`{argument}` must name at least one parameter")
    for name in free:
        if name not in PARAMETERS:
            near = get_close_matches(name, PARAMETERS, 3, 0.6)
            said = f"; is {' or '.join(near)} meant?" if near else ", which `skyfit invert --help` lists"
            raise ValueError(f"`{argument}` must name parameters of `skyfit.PARAMETERS`, got {name!r}{said}")
        if not _present(PARAMETERS[name], model, per_wavelength):
            raise ValueError(f"`{argument}` names {name!r}, which this atmosphere does not have")
    if len(set(free)) < len(free):
        raise ValueError(f"`{argument}` must name each parameter once, got {', '.join(free)}")
    if "turbidity" in free and "aerosol_optical_depth" in free:
        raise ValueError(f"`{argument}` must not hold both turbidity and aerosol_optical_depth: they are one")


def _present(parameter: Parameter, model: SkyModel, per_wavelength: bool = False) -> bool:
    try:
        leaf = parameter.leaf(model)
    except AttributeError:
        return False
    return leaf is not None and (per_wavelength or jnp.ndim(leaf) == 0)


def values_of(model: SkyModel, names) -> dict[str, float]:
    """The values of the named parameters in their stated units; those the model lacks are left out."""
    present = (PARAMETERS[n] for n in names if _present(PARAMETERS[n], model))
    return {p.name: p.from_leaf(float(p.leaf(model))) for p in present}


def fixed_values(model: SkyModel, free: tuple[str, ...]) -> dict[str, float]:
    """The values that are not fitted, by name; turbidity and optical depth are one quantity and appear once."""
    hidden = "aerosol_optical_depth" if "turbidity" in free else "turbidity"
    return {n: v for n, v in values_of(model, PARAMETERS).items() if n not in free and n != hidden}


def partition(model: SkyModel, names: tuple[str, ...]):
    """Split the model into free leaves and the rest, as `eqx.partition` does; leaves with `index` stay in the rest."""
    nothing = jax.tree_util.tree_map(lambda _: False, model)
    alone = [n for n in names if PARAMETERS[n].index is None]
    chosen = eqx.tree_at(lambda m: [PARAMETERS[n].leaf(m) for n in alone], nothing, [True] * len(alone))
    return eqx.partition(model, chosen)


def with_values(fixed: SkyModel, names: tuple[str, ...], values) -> SkyModel:
    """The model with the named parameters set to values in their stated units, in order.

    **Arguments:** `fixed`, a whole model or the fixed half of `partition`; `values`, scalars or one array.
    """
    placed: dict[str, Any] = {}
    for i, n in enumerate(names):
        parameter, leaf = PARAMETERS[n], as_float(PARAMETERS[n].to_leaf(values[i]))
        if parameter.index is not None:
            whole = placed.get(parameter.place, parameter._replace(index=None).leaf(fixed))
            leaf = whole.at[..., parameter.index].set(leaf)
        placed[parameter.place] = leaf

    def leaves(model):
        return [functools.reduce(getattr, place.split("."), model) for place in placed]

    return eqx.tree_at(leaves, fixed, list(placed.values()), is_leaf=lambda x: x is None)
