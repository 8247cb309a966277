"""Choice of the cheapest solver, resolution, geometry, polarisation and set of constituents within an error."""

import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from ..atmosphere import Atmosphere
from ..numerics import check_range
from ..scene import Directions, Scene
from .contract import AbstractSolver, Geometry
from .deciding import Deciding, deciding
from .double import DoubleScattering
from .error_model import beyond, predicted, shared_features, with_left_out, with_streams
from .optics import scatterer_indices
from .orders.solver import OrdersOfScattering
from .orders.spectrum import spectral_nodes
from .single import SingleScattering
from .spherical import Spherical
from .work import seconds


Of = Literal["maximum", "median"]

# Streams, modes, levels, sweeps and nodes of `OrdersOfScattering`; the first two rows are `draft` and `normal`.
RUNGS = {
    "6 streams": (6, 12, 16, 5, 16),
    "8 streams": (8, 16, 24, 7, 24),
    "12 streams": (12, 24, 24, 10, 24),
    "12 deep streams": (12, 24, 48, 10, 32),
    "16 streams": (16, 32, 48, 12, 32),
}
# Flat rungs end at 12 streams, which are within 0.07 % of 16 with 100 levels in 16 scenes.
_FLAT_RUNGS = ("6 streams", "8 streams", "12 streams")
# Largest and median error of `OrdersOfScattering.fine`, spherical, against 200 levels in place of 100, in 16 scenes.
_FINE = (1.4e-3, 1e-4)
# Zenith angle (degrees) of the lowest sun of the model of errors.
_LOWEST_SUN = 88.0
# Sun zenith angle (degrees), largest and median error of `Spherical.normal` against Monte Carlo:
# experiments/results/space.json.
_SPHERICAL = ((89.0, 0.012, 7e-4), (96.0, 0.019, 1e-3), (108.0, 0.043, 4.1e-3))
# Sun zenith angle (degrees), largest error beyond three sigma of Monte Carlo and median error of
# `OrdersOfScattering.normal`, spherical: experiments/results/accuracy.json. All its layers see the sun at one angle.
_ONE_SUN = ((80.0, 0.004, 0.0027), (85.0, 0.025, 0.0033), (89.0, 0.098, 0.0043))
# Largest number of directions times wavelengths that are examined; least number of directions.
_POINTS, _FEWEST = 4096, 32


def streams_of(name: str, geometry: Geometry, polarised: bool, spectral_nodes: int | None = None) -> OrdersOfScattering:
    """`OrdersOfScattering` by a name of `RUNGS`."""
    settings = dict(zip(("streams", "modes", "levels", "orders", "nodes"), RUNGS[name], strict=True))
    return OrdersOfScattering(**settings, spectral_nodes=spectral_nodes, geometry=geometry, polarised=polarised)


class Choice(NamedTuple):
    """A solver and an atmosphere, with their expected error and time.

    `expected_error`, relative, safe for 98 % of scenes; `seconds` on two cores at 2.5 GHz in float32, compiled, by
    counted work (`work.seconds`); `reasons`, in words; `met`, whether the error is within the tolerance (if no solver
    meets it, the one with the smallest error is chosen); `known`, whether the scene is within the range that the error
    model was fitted to; `tolerance`, the one that was asked for.
    """

    solver: AbstractSolver
    atmosphere: Atmosphere
    expected_error: float
    seconds: float
    reasons: tuple[str, ...]
    met: bool
    known: bool
    tolerance: float


class _Candidate(NamedTuple):
    """A solver, the effects that make up its error, and the seconds it takes."""

    solver: AbstractSolver
    effects: tuple[str, ...]
    seconds: float


def choose(atmosphere: Atmosphere, scene: Scene, tolerance: float, *, of: Of = "maximum") -> Choice:
    """Choose the cheapest solver and set of constituents for a scene whose error stays under a tolerance; say why.

    **Arguments:** `tolerance`, relative, in (0, 1]; `of`: it holds for the "maximum" over the scene's directions above
    the horizon and its wavelengths, or for their "median".
    **Returns:** a `Choice`. **Errors:** `ValueError` for traced values, and for a sun or wavelengths for which no
    solver is valid.
    **Valid:** on the host, outside jit. Errors are those of the radiance, against
    `OrdersOfScattering.fine("spherical", polarised=True)`, which is within 0.5 % of Monte Carlo beyond its noise under
    suns to 80 degrees. The error that lower suns add is included. The model of errors (data/error_model.csv) covers
    observers on the ground, suns to 88 degrees, 340 to 1000 nm and haze to an optical depth of 1.5 by its moments.
    Aloft and under lower suns the choice is `Spherical`.
    """
    judged = _judge(atmosphere, scene, tolerance, of)
    if judged is None:
        return _dark(atmosphere, scene, tolerance)
    place, met = _cheapest([candidate.seconds for candidate in judged.candidates], judged.off, tolerance)
    chosen = judged.candidates[place]
    left_out = _without(atmosphere, chosen, judged.errors, tolerance)
    return _told(judged, chosen, tolerance, of, met, *left_out)


def choose_for_all(skies: Sequence[tuple[Atmosphere, Scene]], tolerance: float, *, of: Of = "maximum") -> Choice:
    """Choose one solver for several skies with all their constituents: the cheapest within a tolerance in each.

    **Arguments:** pairs of atmosphere and scene, one at least; else as `choose`.
    **Returns:** a `Choice`. Its atmosphere, reasons and expected error are those of the sky where the solver's error is
    largest; `seconds` is for all skies.
    """
    found = [_judge(atmosphere, scene, tolerance, of) for atmosphere, scene in skies]
    judged = [each for each in found if each is not None]
    if not judged:
        return _dark(*skies[0], tolerance)
    tables = [{_settings(c.solver): i for i, c in enumerate(each.candidates)} for each in judged]
    common = [settings for settings in tables[0] if all(settings in table for table in tables)]
    # Indices of the common candidates, for each sky.
    places = [[table[settings] for settings in common] for table in tables]
    time = np.array([[j.candidates[i].seconds for i in row] for j, row in zip(judged, places, strict=True)]).sum(axis=0)
    off = np.array([[j.off[i] for i in row] for j, row in zip(judged, places, strict=True)])
    place, met = _cheapest(time.tolist(), off.max(axis=0).tolist(), tolerance)
    worst = int(np.argmax(off[:, place]))
    told = _told(judged[worst], judged[worst].candidates[places[worst][place]], tolerance, of, met)
    known = all(not each.errors.unknown(each.scene) for each in judged)
    return told._replace(seconds=float(time[place]), known=known)


class _Judged(NamedTuple):
    """A sky, the solvers that are valid for it, and the error of each."""

    atmosphere: Atmosphere
    scene: Scene
    sun: float
    errors: "_Errors"
    candidates: list[_Candidate]
    off: list[float]


def _judge(atmosphere: Atmosphere, scene: Scene, tolerance: float, of: Of) -> _Judged | None:
    """Find the candidates for a sky and their errors; None where all is dark."""
    check_numbers("choose", (atmosphere, scene, tolerance))
    if of not in ("maximum", "median"):
        raise ValueError(f'`of` must be "maximum" or "median", got {of!r}')
    if not 0.0 < tolerance <= 1.0:
        raise ValueError(f"`tolerance` must be above 0 and at most 1, a share of the radiance, got {tolerance:g}")
    atmosphere.check_wavelengths(scene.wavelength_nm)
    sun = float(np.degrees(scene.sun_zenith))
    check_range("sun_zenith", scene.sun_zenith, 0.0, np.radians(_SPHERICAL[-1][0]), "rad", "suns to 108 degrees")
    seen = _looked_at(scene)
    if not scatterer_indices(atmosphere.constituents) or seen is None:
        return None
    errors, candidates = _Errors(atmosphere, *seen, sun, of), _candidates(atmosphere, scene, sun)
    off = [errors.altogether(candidate.effects) for candidate in candidates]
    return _Judged(atmosphere, scene, sun, errors, candidates, off)


def _dark(atmosphere: Atmosphere, scene: Scene, tolerance: float) -> Choice:
    solver = SingleScattering.draft()
    why = "no view meets the sky" if scatterer_indices(atmosphere.constituents) else "nothing scatters"
    time = seconds(solver, atmosphere, scene)
    return Choice(solver, atmosphere, 0.0, time, (f"{why}: all is dark",), True, True, tolerance)


def _cheapest(time: list[float], off: list[float], tolerance: float) -> tuple[int, bool]:
    """Index of the cheapest within tolerance, or of the smallest error where there is none; whether there is one."""
    allowed = [i for i, error in enumerate(off) if error <= tolerance]
    return (min(allowed, key=lambda i: time[i]), True) if allowed else (int(np.argmin(off)), False)


def _settings(solver: AbstractSolver) -> tuple:
    return type(solver), *(getattr(solver, field.name) for field in fields(solver))


def _told(
    judged: _Judged,
    chosen: _Candidate,
    tolerance: float,
    of: Of,
    met: bool,
    kept: Atmosphere | None = None,
    left: tuple[int, ...] = (),
    said: Sequence[str] = (),
) -> Choice:
    """Make the `Choice` of a candidate, with reasons; `kept` lacks the constituents `left` out, as `said` in words."""
    errors, scene = judged.errors, judged.scene
    reasons = [f"{of} over {scene.view.zenith.shape[0]} directions and {scene.wavelength_nm.shape[0]} wavelengths"]
    reasons += [*_of_solver(chosen, judged.candidates, errors, judged.sun, scene), *said]
    unknown = errors.unknown(scene)
    reasons += [f"beyond what the errors were fitted to: {what}" for what in unknown]
    expected = errors.altogether(chosen.effects, left)
    if not met:
        reasons.append(f"no solver stays under {_percent(tolerance)}: the nearest may be {_percent(expected)} off")
    air = judged.atmosphere if kept is None else kept
    time = seconds(chosen.solver, air, scene)
    return Choice(chosen.solver, air, expected, time, tuple(reasons), met, not unknown, tolerance)


def check_numbers(name: str, given) -> None:
    """Raise a `ValueError` for traced values among the arguments of a function of the host."""
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(given)):
        raise ValueError(f"`{name}` must be called with numbers, outside of jit, vmap and grad: got traced values")


class _Errors:
    """The errors of one scene by effect, each computed when it is first asked for."""

    def __init__(self, atmosphere: Atmosphere, scene: Scene, views: int, sun: float, of: Of):
        numbers = deciding(atmosphere, scene)
        self._numbers = Deciding(*(np.asarray(each, np.float64)[..., :views, :] for each in numbers))
        self._features = shared_features(self._numbers)
        self._sun, self._median = sun, of == "median"
        self._reduced: Callable = np.median if self._median else np.max
        self._known: dict[str | int, np.ndarray] = {}

    def __getitem__(self, effect: str | int) -> np.ndarray:
        """Error by the effect of a name, or by leaving out the constituent of an index, `[direction, wavelength]`."""
        if effect not in self._known:
            self._known[effect] = self._found(effect)
        return self._known[effect]

    def _found(self, effect: str | int) -> np.ndarray:
        if isinstance(effect, int):
            return predicted("left out", with_left_out(self._features, self._numbers, effect), self._median)
        here = np.zeros_like(self._numbers.depth)
        if effect == "fine":
            return here + _FINE[self._median]
        for name, table in (("Spherical", _SPHERICAL), ("one sun", _ONE_SUN)):
            if effect == name:
                suns, *errors = (np.array(column) for column in zip(*table, strict=True))
                return here + np.exp(np.interp(self._sun, suns, np.log(errors[self._median])))
        first = effect.split()[0]
        of = with_streams(self._features, self._numbers, int(first)) if first.isdigit() else self._features
        return predicted(effect, of, self._median)

    def of_one(self, effect: str | int) -> float:
        return float(self._reduced(self[effect]))

    def altogether(self, effects: tuple[str, ...], left: tuple[int, ...] = ()) -> float:
        """Largest or median value of the sum of effects."""
        return float(self._reduced(sum(self[effect] for effect in (*effects, *left))))

    def unknown(self, scene: Scene) -> list[str]:
        """Say, in words, what in the scene is beyond the range of the model of errors."""
        found = beyond(with_streams(self._features, self._numbers, 8))
        wavelength = np.asarray(scene.wavelength_nm)
        if wavelength.min() < 0.99 * 340.0 or wavelength.max() > 1.01 * 1000.0:
            found.append(f"{wavelength.min():g} to {wavelength.max():g} nm, where they know 340 to 1000")
        if self._sun > _LOWEST_SUN:
            found.append(f"a sun at {self._sun:.4g} degrees, where they know {_LOWEST_SUN:g}")
        if scene.height is not None:
            found.append("an observer aloft")
        return found


@functools.cache
def _known() -> tuple[tuple[AbstractSolver, tuple[str, ...], bool], ...]:
    """Solvers for observers on the ground, effects in their errors, whether they solve long spectra at few nodes."""
    found: list[tuple[AbstractSolver, tuple[str, ...], bool]] = []
    geometries: tuple[tuple[Geometry, tuple[str, ...]], ...] = (("flat", ("flat Earth",)), ("spherical", ()))
    for geometry, bent in geometries:
        found.append((SingleScattering.normal(geometry), ("one order", *bent), False))
        found.append((DoubleScattering.normal(geometry), ("two orders", *bent), True))
        for name in RUNGS if geometry == "spherical" else _FLAT_RUNGS:
            # The error by the flat Earth includes that of the last flat rung.
            own = () if bent and name == _FLAT_RUNGS[-1] else (f"{name} flat" if bent else name,)
            for polarised, nodes in itertools.product((False, True), (None, 0)):
                solver = streams_of(name, geometry, polarised, nodes)
                found.append((solver, (*own, *bent, *("no polarisation",) * (not polarised)), nodes is None))
    return (*found, (OrdersOfScattering.fine(polarised=True), ("fine",), False))


def _candidates(atmosphere: Atmosphere, scene: Scene, sun: float) -> list[_Candidate]:
    """All solvers that are valid for the sun and the observer."""
    found: list[tuple[AbstractSolver, tuple[str, ...]]] = [(Spherical.normal(), ("Spherical", "no polarisation"))]
    if scene.height is None and sun <= _LOWEST_SUN:
        long = spectral_nodes(atmosphere, scene, None) is not None
        low = ("one sun",) if sun > _ONE_SUN[0][0] else ()
        for solver, effects, few in _known():
            every = isinstance(solver, OrdersOfScattering) and not few
            # For a short spectrum every wavelength is solved in any case.
            if sun <= solver.suns.largest_deg and (long or not every or "fine" in effects):
                more = () if "one order" in effects else low
                found.append((solver, (*effects, *more, *("few wavelengths",) * (few and long))))
    return [_Candidate(solver, effects, seconds(solver, atmosphere, scene)) for solver, effects in found]


def candidates_of(atmosphere: Atmosphere, scene: Scene) -> list[AbstractSolver]:
    """The solvers among which `choose` chooses for a scene."""
    return [c.solver for c in _candidates(atmosphere, scene, float(np.degrees(scene.sun_zenith)))]


def _of_solver(
    chosen: _Candidate, candidates: list[_Candidate], errors: _Errors, sun: float, scene: Scene
) -> list[str]:
    """Say, in words, why this solver is chosen."""
    used = set(chosen.effects)
    offered = {effect for candidate in candidates for effect in candidate.effects}
    if isinstance(chosen.solver, Spherical):
        where = "the observer is aloft" if scene.height is not None else f"the sun stands at {sun:.4g} degrees"
        return [
            f"{where}: Spherical, {_percent(errors.of_one('Spherical'))}",
            f"polarisation {_percent(errors.of_one('no polarisation'))}: Spherical leaves it out",
        ]
    said = []
    for effect, instead in (
        ("one order", "more orders"), ("two orders", "all orders"), ("flat Earth", "curved paths"),
        ("no polarisation", "kept"), ("few wavelengths", "every wavelength is solved"),
    ):  # fmt: skip
        # One and two orders are scalar: their errors include the missing polarisation.
        implied = {"two orders": {"one order"}, "no polarisation": {"one order", "two orders"}}.get(effect, set())
        if effect in offered and not implied & used:
            name = "polarisation" if effect == "no polarisation" else effect
            word = "left out" if effect == "no polarisation" else "used"
            said.append(f"{name} {_percent(errors.of_one(effect))}: {word if effect in used else instead}")
    for effect in chosen.effects:
        if effect == "one sun":
            said.append(f"a low sun, at one angle for all heights, {_percent(errors.of_one(effect))}: counted")
        if "streams" in effect or effect == "fine":
            said.append(f"{effect} {_percent(errors.of_one(effect))}: used")
    return said


def _without(
    atmosphere: Atmosphere, chosen: _Candidate, errors: _Errors, tolerance: float
) -> tuple[Atmosphere, tuple[int, ...], list[str]]:
    """The atmosphere without the constituents that the tolerance allows to omit, their indices, and words for each."""
    order = sorted(range(len(atmosphere.constituents)), key=errors.of_one)
    left, said = (), []
    for place in order:
        name, error = atmosphere.names[place], _percent(errors.of_one(place))
        scattering = set(scatterer_indices(atmosphere.constituents)) - {*left, place}
        if scattering and errors.altogether(chosen.effects, (*left, place)) <= tolerance:
            left = (*left, place)
            said.append(f"{name} changes nothing above {error}: left out")
        else:
            said.append(f"{name} {error}: kept")
    gone: dict = {atmosphere.names[place]: None for place in left}
    return (atmosphere.replace(**gone) if gone else atmosphere), left, said


def _looked_at(scene: Scene) -> tuple[Scene, int] | None:
    """The scene with representative views, repeated to a power of two, and the number of different ones.

    None where no view meets the sky.
    """
    zenith, azimuth = np.asarray(scene.view.zenith, float), np.asarray(scene.view.azimuth, float)
    up = np.flatnonzero(np.cos(zenith) > -1e-6) if scene.height is None else np.arange(zenith.size)
    if not up.size:
        return None
    zenith, azimuth = zenith[up], azimuth[up]
    most = max(_POINTS // max(scene.wavelength_nm.shape[0], 1), _FEWEST)
    if up.size > most:
        sun, around = float(scene.sun_zenith), float(scene.sun_azimuth)
        apart = np.sin(0.5 * (zenith - sun)) ** 2 + np.sin(zenith) * np.sin(sun) * np.sin(0.5 * (azimuth - around)) ** 2
        picked = np.unique(np.linspace(0, up.size - 1, most // 2).round().astype(int))
        some = np.unique(np.concatenate([np.argsort(zenith)[picked], np.argsort(apart)[picked]]))
        zenith, azimuth = zenith[some], azimuth[some]
    # Powers of two, so that few programs are compiled.
    full = np.arange(1 << (zenith.size - 1).bit_length()) % zenith.size
    return eqx.tree_at(lambda s: s.view, scene, Directions(zenith[full], azimuth[full])), zenith.size


def _percent(error: float) -> str:
    return f"{float(f'{100.0 * min(error, 1.0):.2g}'):g} %"
