"""Other solvers on the same skies: nanodisort, sasktran2, PythonicDISORT. Imports neither jax nor skyfit.

Each `prepare_*` does all that a sky of other optical depths would not need again and returns a function of nothing
that solves and gives radiance `[direction, wavelength]` per unit irradiance: what it does is what is timed.
"""

import contextlib
import importlib.util
import itertools
import os
from collections.abc import Callable
from typing import NamedTuple

import numpy as np


# exponential profiles cut here and renormalised, as in the shared oracles; m
TOP = 100e3
SCALE_HEIGHTS = np.array([8000.0, 1200.0])
EARTH_RADIUS = 6.371e6
# m: sasktran2 refuses views from the ground up in its plane-parallel modes
FLAT_RADIUS = 6.371e8
LARGEST_COSINE = 1.0 - 1e-9
# heights at which successive orders keep their sources, denser near the ground
_SOURCE_HEIGHTS = 30


class Optics(NamedTuple):
    """What a rival is told of a sky, `[wavelength]`; `second`: the moment of air at P_2, without its factor 5."""

    air: np.ndarray
    haze: np.ndarray
    haze_albedo: np.ndarray
    asymmetry: np.ndarray
    second: float
    ground: np.ndarray


# optical depths `[wavelength]` and the density by height (m) of what only absorbs
Absorber = tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]


class View(NamedTuple):
    """A product of zenith angles and azimuths from the sun's, degrees, and the sun; directions are its "ij" order."""

    zenith: np.ndarray
    azimuth: np.ndarray
    sun_zenith: float


def share_above(height: np.ndarray) -> np.ndarray:
    """The share of each column above `height`, `[constituent, level]`."""
    beyond = np.exp(-TOP / SCALE_HEIGHTS)[:, None]
    return (np.exp(-height[None] / SCALE_HEIGHTS[:, None]) - beyond) / (1.0 - beyond)


def layer_shares(layers: int) -> np.ndarray:
    """The share of each column in each layer, equal steps of their mean, top to ground, `[constituent, layer]`."""
    height = TOP * np.linspace(0.0, 1.0, 200_001) ** 3
    mean = share_above(height).mean(axis=0)
    levels = np.interp(np.arange(layers + 1) / layers, mean[::-1], height[::-1])
    return np.diff(share_above(levels), axis=1)


def layer_optics(optics: Optics, layers: int, moments: int):
    """Optical depth and albedo `[wavelength, layer]`, moments `[moment, layer, wavelength]` without 2 l + 1."""
    share = layer_shares(layers)
    depth = optics.air[:, None] * share[0] + optics.haze[:, None] * share[1]
    scattered = np.stack([optics.air[:, None] * share[0], (optics.haze * optics.haze_albedo)[:, None] * share[1]])
    each = np.zeros((moments + 1, 2, optics.air.size))
    each[0, 0], each[2, 0] = 1.0, optics.second
    each[:, 1] = optics.asymmetry[None] ** np.arange(moments + 1.0)[:, None]
    total = scattered.sum(axis=0)
    # what rounding lifts over 1 is refused
    mixed = np.minimum(np.einsum("kcw,cwl->klw", each, scattered / total), 1.0)
    return depth, np.minimum(total / depth, 1.0), mixed


@contextlib.contextmanager
def quiet():
    """C code's own warnings go nowhere."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def moments_for(asymmetry: np.ndarray) -> int:
    """As many as leave 1e-9 of a Henyey-Greenstein phase function, 64 to 256."""
    return int(np.clip(np.log(1e-9) / np.log(np.clip(np.max(asymmetry), 0.1, 0.99)), 64, 256))


def prepare_nanodisort(optics: Optics, view: View, streams: int, layers: int = 40, threads: int = 2) -> Callable:
    """cdisort, plane-parallel, delta-M and Nakajima & Tanaka's correction, wavelengths over threads."""
    import nanodisort

    count = optics.air.size
    moments = moments_for(optics.asymmetry)
    depth, albedo, mixed = layer_optics(optics, layers, moments)
    cosine = -np.cos(np.radians(view.zenith))
    order = np.argsort(cosine)
    solver = nanodisort.BatchSolver(nthreads=threads)
    solver.nstr, solver.nlyr, solver.nmom = streams, layers, moments
    solver.ntau, solver.numu, solver.nphi = 1, cosine.size, view.azimuth.size
    solver.usrtau = solver.usrang = solver.lamber = solver.quiet = True
    solver.planck = solver.onlyfl = solver.spher = False
    solver.intensity_correction = solver.old_intensity_correction = True
    solver.umu0, solver.phi0, solver.accur = min(np.cos(np.radians(view.sun_zenith)), LARGEST_COSINE), 0.0, 0.0
    # what the wavelengths share is copied at `allocate`: set before it
    solver.set_umu(cosine[order])
    solver.set_phi(np.asarray(view.azimuth, float))
    solver.set_utau(depth[0].sum(keepdims=True))
    with quiet():
        solver.allocate(count)
    solver.set_utau_batched(depth.sum(axis=1, keepdims=True))
    solver.set_dtauc(depth)
    solver.set_ssalb(albedo)
    solver.set_pmom(np.asfortranarray(mixed))
    solver.set_fbeam(np.ones(count))
    solver.set_albedo(optics.ground)

    def solve():
        solver.solve()
        found = np.empty((cosine.size, view.azimuth.size, count))
        found[order] = np.moveaxis(np.asarray(solver.uu)[:, :, 0], 0, -1)
        return found.reshape(-1, count)

    return solve


def _sasktran2_parts(
    view: View, moments: int, source: str, streams: int, geometry: str, layers: int, even: bool = False
):
    """Configuration for two threads, geometry and rays; levels closer at the ground, for it is linear between them."""
    import sasktran2 as sk

    config = sk.Config()
    config.num_threads, config.num_streams, config.num_singlescatter_moments = 2, streams, moments
    config.single_scatter_source = sk.SingleScatterSource.Exact
    config.multiple_scatter_source = getattr(sk.MultipleScatterSource, source)
    config.delta_m_scaling = source == "DiscreteOrdinates"
    height = (
        np.linspace(0.0, TOP, layers + 1) if even else 2e3 * np.expm1(np.linspace(0.0, np.log1p(TOP / 2e3), layers + 1))
    )
    sun = min(np.cos(np.radians(view.sun_zenith)), LARGEST_COSINE)
    model = sk.Geometry1D(sun, 0.0, FLAT_RADIUS if geometry == "flat" else EARTH_RADIUS, height)
    views = sk.ViewingGeometry()
    for zenith, azimuth in itertools.product(view.zenith, view.azimuth):
        ray = sk.SolarAnglesObserverLocation(sun, np.radians(azimuth), np.cos(np.radians(zenith)), 0.0)
        views.add_ray(ray)
    return config, model, height, views


def prepare_sasktran2(
    optics: Optics, view: View, source: str, streams: int = 8, geometry: str = "flat", layers: int = 40
) -> Callable:
    """sasktran2 with exact single scattering; `source` "NoSource" or "DiscreteOrdinates"."""
    moments = moments_for(optics.asymmetry)
    return _sasktran2_run(optics, moments, *_sasktran2_parts(view, moments, source, streams, geometry, layers))


def prepare_sasktran2_orders(optics: Optics, view: View, suns: int, absorber: Absorber | None = None) -> Callable:
    """sasktran2 with successive orders on a sphere, solved under some suns, on a uniform grid of 333 m."""
    import sasktran2 as sk

    moments = moments_for(optics.asymmetry)
    config, model, height, views = _sasktran2_parts(view, moments, "SuccessiveOrders", 8, "spherical", 300, even=True)
    config.num_sza = suns
    # 4 GB: with a source at every height it takes 40, and threads over wavelengths hold each a copy; 60 sources for 40
    # on a grid of 500 m change a sky under a sun at 88 degrees by 0.05 %
    config.threading_model = sk.ThreadingModel.Source
    edges = 4e3 * np.expm1(np.linspace(0.0, np.log1p(TOP / 4e3), _SOURCE_HEIGHTS + 1))
    config.successive_orders_altitude_grid_m = 0.5 * (edges[1:] + edges[:-1])
    return _sasktran2_run(optics, moments, config, model, height, views, absorber)


def _sasktran2_run(
    optics: Optics, moments: int, config, model, height, views, absorber: Absorber | None = None
) -> Callable:
    import sasktran2 as sk

    air = sk.Atmosphere(model, config, numwavel=optics.air.size, calculate_derivatives=False)
    degree = np.arange(moments)[:, None]
    rayleigh = np.where(degree == 0, 1.0, np.where(degree == 2, 5.0 * optics.second, 0.0)) + 0.0 * optics.air
    lobe = (2 * degree + 1) * optics.asymmetry[None] ** degree
    for name, scale, depth, albedo, each in (
        ("rayleigh", SCALE_HEIGHTS[0], optics.air, np.ones_like(optics.air), rayleigh),
        ("haze", SCALE_HEIGHTS[1], optics.haze, optics.haze_albedo, lobe),
    ):
        shape = np.exp(-height / scale)
        extinction = (shape / np.trapezoid(shape, height))[:, None] * depth[None]
        every = np.tile(each[:, None], (1, height.size, 1))
        air[name] = sk.constituent.Manual(extinction, np.tile(albedo, (height.size, 1)), every)
    if absorber is not None:
        depth, shape = absorber[0], absorber[1](height)
        extinction = (shape / np.trapezoid(shape, height))[:, None] * depth[None]
        every = np.tile(np.where(degree == 0, 1.0, 0.0)[:, None] + 0.0 * depth, (1, height.size, 1))
        air["absorber"] = sk.constituent.Manual(extinction, np.zeros_like(extinction), every)
    air["ground"] = sk.constituent.LambertianSurface(optics.ground)
    engine = sk.Engine(config, model, views)
    return lambda: _sasktran2_radiance(engine.calculate_radiance(air))


def _sasktran2_radiance(result) -> np.ndarray:
    return result["radiance"].transpose("los", "wavelength", "stokes").to_numpy()[:, :, 0]


def prepare_sasktran2_jacobian(
    optics: Optics, view: View, wavelength_nm: np.ndarray, derivatives: bool, streams: int = 8, layers: int = 40
) -> Callable:
    """About the same sky of its own constituents, which alone have derivatives: by pressure and temperature of the air
    and extinction of the haze at every level and by the ground's albedo. Flat."""
    import sasktran2 as sk

    moments = moments_for(optics.asymmetry)
    config, model, height, views = _sasktran2_parts(view, moments, "DiscreteOrdinates", streams, "flat", layers)
    air = sk.Atmosphere(model, config, wavelengths_nm=wavelength_nm, calculate_derivatives=derivatives)
    sk.climatology.us76.add_us76_standard_atmosphere(air)
    air["rayleigh"] = sk.constituent.Rayleigh()
    lobe = sk.optical.HenyeyGreenstein.from_parameters(
        wavelength_nm, optics.haze, optics.haze_albedo, optics.asymmetry, moments
    )
    shape = np.exp(-height / SCALE_HEIGHTS[1])
    at = wavelength_nm.size // 2
    profile = shape / np.trapezoid(shape, height) * optics.haze[at]
    air["haze"] = sk.constituent.ExtinctionScatterer(lobe, height, profile, wavelength_nm[at])
    air["ground"] = sk.constituent.LambertianSurface(float(optics.ground.mean()))
    # an engine that has met an atmosphere without derivatives breaks on one with them
    engine = sk.Engine(config, model, views)

    def solve():
        result = engine.calculate_radiance(air)
        return _sasktran2_radiance(result), *(result[name].to_numpy() for name in result if name.startswith("wf_"))

    return solve


def prepare_pythonic_disort(optics: Optics, view: View, streams: int, layers: int = 40) -> Callable:
    """PythonicDISORT, one wavelength after another, interpolated between its nodes."""
    from PythonicDISORT import subroutines
    from PythonicDISORT.pydisort import pydisort

    moments = moments_for(optics.asymmetry)
    depth, albedo, mixed = layer_optics(optics, layers, moments)
    cosine, sun = np.cos(np.radians(view.zenith)), min(np.cos(np.radians(view.sun_zenith)), LARGEST_COSINE)

    def solve():
        found = np.empty((view.zenith.size, view.azimuth.size, optics.air.size))
        for i in range(optics.air.size):
            every, levels = mixed[:, :, i].T.copy(), np.cumsum(depth[i])
            every[:, 0] = 1.0
            # unstable at an albedo of one
            *_, field = pydisort(
                levels, np.minimum(albedo[i], 1.0 - 1e-6), streams, every, sun, 1.0, 0.0,
                NLeg=streams, NFourier=streams, f_arr=every[:, streams], NT_cor=True,
                BDRF_Fourier_modes=[float(optics.ground[i])] if optics.ground[i] else [],
            )  # fmt: skip
            at = subroutines.interpolate(field)
            found[:, :, i] = at(-cosine, levels[-1], np.radians(view.azimuth))
        return found.reshape(-1, optics.air.size)

    return solve


# name, preset: module, geometries, how to prepare
RIVALS = {
    ("nanodisort", "16 streams"): ("nanodisort", ("flat",), lambda o, v, g: prepare_nanodisort(o, v, 16)),
    ("nanodisort", "32 streams"): ("nanodisort", ("flat",), lambda o, v, g: prepare_nanodisort(o, v, 32)),
    ("sasktran2", "single scattering"): (
        "sasktran2", ("flat", "spherical"), lambda o, v, g: prepare_sasktran2(o, v, "NoSource", 8, g)
    ),
    ("sasktran2", "8 streams"): (
        "sasktran2", ("flat", "spherical"), lambda o, v, g: prepare_sasktran2(o, v, "DiscreteOrdinates", 8, g)
    ),
    ("sasktran2", "16 streams"): (
        "sasktran2", ("flat", "spherical"), lambda o, v, g: prepare_sasktran2(o, v, "DiscreteOrdinates", 16, g)
    ),
    ("PythonicDISORT", "16 streams"): (
        "PythonicDISORT", ("flat",), lambda o, v, g: prepare_pythonic_disort(o, v, 16)
    ),
}  # fmt: skip


def installed() -> dict:
    """Those of `RIVALS` whose package is there."""
    return {key: row for key, row in RIVALS.items() if importlib.util.find_spec(row[0]) is not None}
