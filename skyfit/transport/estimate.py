"""The error of a solver in one scene, estimated by a refined solve of a few directions and wavelengths."""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import numpy as np

from ..atmosphere import Atmosphere
from ..scene import above_horizon, angle_between, Directions, Scene
from .choose import check_numbers, RUNGS, streams_of
from .contract import AbstractSolver
from .orders.solver import OrdersOfScattering
from .spherical import Spherical


# Largest zenith angle of the sun (degrees) at which streams serve as the refined solver.
_LOWEST_SUN = 88.0
# Ratio of the bound to the largest error found, and an addition for the refined solver's own error, from 128 scenes of
# the model of errors. experiments/results/choose.json has other scenes.
_FACTOR, _OWN = 2.0, 5e-4


class Estimate(NamedTuple):
    """The error of a solver in one scene, relative to the radiance.

    `bound`, above the largest error in about 95 % of scenes; `found`, the largest error at the directions and
    wavelengths that were solved again; `refined`, the solver that solved them.
    """

    bound: float
    found: float
    refined: AbstractSolver


def estimate_error(
    solver: AbstractSolver, atmosphere: Atmosphere, scene: Scene, *, directions: int = 8, wavelengths: int = 3
) -> Estimate:
    """Bound the error of a solver's radiance in a scene, including the effects of polarisation and the Earth's shape.

    A refined solver solves the lowest views, those next to the sun and some between them, at the ends and in the middle
    of the spectrum (at all wavelengths where a constituent is known at the scene's alone). Its program is compiled once
    for each number of directions and wavelengths: some ten seconds for streams, minutes for `Spherical`.

    **Arguments:** `directions`, `wavelengths`, their largest numbers, at least 4 and 2. **Returns:** an `Estimate`.
    **Errors:** `ValueError` for traced values, and for what `solver.radiance` refuses.
    **Valid:** the bound was calibrated on scenes seen from the ground under suns to 88 degrees
    (experiments/validation/choose.py). Under lower suns and aloft `Spherical.fine` is the refined solver, which leaves
    out polarisation.
    """
    check_numbers("estimate_error", (atmosphere, scene))
    if directions < 4 or wavelengths < 2:
        raise ValueError(
            f"`directions` must be at least 4 and `wavelengths` at least 2, got {directions} and {wavelengths}"
        )
    refined = refinement(solver, scene)
    views, colours = picked(atmosphere, scene, directions, wavelengths)
    if not views.size:
        return Estimate(0.0, 0.0, refined)
    found = np.asarray(solver.radiance(atmosphere, scene), float)[np.ix_(views, colours)]
    few = eqx.tree_at(
        lambda s: (s.view, s.wavelength_nm, s.solar_irradiance),
        scene,
        (
            Directions(scene.view.zenith[views], scene.view.azimuth[views]),
            scene.wavelength_nm[colours],
            scene.solar_irradiance[colours],
        ),
    )
    right = np.asarray(refined.radiance(atmosphere, few), float)
    return Estimate(*bound_of(found, right), refined)


def bound_of(found: np.ndarray, right: np.ndarray) -> tuple[float, float]:
    """The bound, and the largest relative error of `found` against `right`."""
    lit = right > 0.0
    off = np.abs(found - right)[lit] / right[lit]
    largest = float(off.max()) if off.size else 0.0
    return _FACTOR * largest + _OWN, largest


def refinement(solver: AbstractSolver, scene: Scene) -> AbstractSolver:
    """The refined solver against which `solver` is compared in a scene."""
    if scene.height is not None or float(np.degrees(scene.sun_zenith)) > _LOWEST_SUN:
        return Spherical.fine()
    if isinstance(solver, OrdersOfScattering) and solver.streams >= RUNGS["16 streams"][0]:
        finest = OrdersOfScattering.fine(polarised=True)
        done = solver.levels >= finest.levels
        return replace(finest, streams=20, modes=40, levels=150, orders=14) if done else finest
    return streams_of("16 streams", "spherical", True, 0)


def picked(atmosphere: Atmosphere, scene: Scene, directions: int, wavelengths: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the directions and of the wavelengths that are solved again."""
    zenith = np.asarray(scene.view.zenith, float)
    seen = np.arange(zenith.size)
    if scene.height is None:
        seen = np.flatnonzero(np.asarray(above_horizon(scene.view.zenith)))
    apart = np.asarray(angle_between(scene.view.zenith, scene.sun_zenith, scene.view.azimuth - scene.sun_azimuth))
    by_zenith, by_sun = seen[np.argsort(zenith[seen])], seen[np.argsort(apart[seen])]
    # The two lowest views, the two next to the sun, and others evenly distributed over the zenith angles.
    wanted = np.concatenate([by_zenith[-2:], by_sun[:2], by_zenith[_evenly(seen.size, directions - 4)]])
    count = scene.wavelength_nm.shape[0]
    return np.unique(wanted), _evenly(count, wavelengths) if atmosphere.smooth_in_wavelength else np.arange(count)


def _evenly(size: int, count: int) -> np.ndarray:
    """At most `count` evenly distributed indices, among them the first and the last."""
    return np.unique(np.linspace(0, size - 1, min(count, size)).round().astype(int))
