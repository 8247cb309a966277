"""Multiply-adds and exponentials that a solver needs for a sky, and the seconds they take."""

from typing import NamedTuple

from ..atmosphere import Atmosphere
from ..scene import Scene
from .columns import COLUMN_TERMS
from .contract import AbstractSolver
from .double import DoubleScattering
from .optics import scatterer_indices
from .orders.layering import Resolution
from .orders.solver import OrdersOfScattering
from .orders.spectrum import spectral_nodes
from .single import SingleScattering
from .spherical import Spherical


# Rates per second of two cores at 2.5 GHz in float32: exponentials, flops in small batches and in large products.
EXPONENTIALS, BATCHED_FLOPS, LARGE_FLOPS = 0.56e9, (12e9, 21e9), 45e9
# Ratio of measured to counted seconds of `fine` and of `SingleScattering.normal`, ratio of polarised to scalar time,
# and seconds of a call (that of `Uniform`): medians of experiments/results/speed_vs_error.csv in float32, 343
# directions and 41 wavelengths.
_OVER, _POLARISED, _CALL = {"single": 0.9, "double": 1.16, "orders": 1.8}, 1.31, 3e-4
# Seconds per wavelength. One observer takes 0.38 s for 8 wavelengths with the sun at 60 degrees, 0.62 s at 90:
# experiments/results/spherical.json.
_SPHERICAL_WAVELENGTH = 0.078


class Work(NamedTuple):
    """Multiply-adds and exponentials of one part of a solver, and whether its multiplications are one large product."""

    multiply_adds: float
    exponentials: float
    large: bool

    def seconds(self) -> tuple[float, float]:
        """Seconds at the fast and at the slow rate."""
        rates = (LARGE_FLOPS, LARGE_FLOPS) if self.large else BATCHED_FLOPS[::-1]
        fast, slow = (2.0 * self.multiply_adds / rate + self.exponentials / EXPONENTIALS for rate in rates)
        return fast, slow


def counted(
    solver: OrdersOfScattering | DoubleScattering | SingleScattering, atmosphere: Atmosphere, scene: Scene
) -> dict[str, Work]:
    """Work of one sky, by part.

    There are D directions, W wavelengths, V of them solved, C constituents of which S scatter, Q nodes, N streams per
    hemisphere, L layers, I sweeps, M modes and P pairs (l, m) with l >= m.

    Single scattering: exponents $\\tau = $ column $\\cdot$ extinction, C D Q W; their exponentials, D Q W; the sum over
    nodes, S D Q W; phase functions times it, S D W; densities and two columns, 3 C D Q exponentials, with 17
    multiply-adds per column on curved paths (exponential profiles; ozone's takes 16 points).
    Sweeps: moments to streams and back, 2 P N L V per sweep; in each of two directions 2 N L M V for the recurrence and
    6 N L M V for the emitted and the mean light; turning on curved paths, 2 L N N M V; diffusion, L L V per sweep and
    once its inverse, which is coded as dense, L^3 V; attenuation and source functions, 4 N L V exponentials.
    View integral: moments into views, P D L V; attenuation and source functions, 2 D L V exponentials and 4
    multiply-adds. For a spectrum that is solved at few wavelengths (`spectrum.interpolated`), coarse streams do sweeps
    and view integral at all wavelengths, over two grounds.
    """
    directions, wavelengths = scene.view.zenith.shape[0], scene.wavelength_nm.shape[0]
    constituents, curved = len(atmosphere.constituents), solver.geometry == "spherical"
    scatterers = len(scatterer_indices(atmosphere.constituents))
    nodes = directions * solver.nodes
    once = Work(
        nodes * wavelengths * (constituents + scatterers)
        + scatterers * directions * wavelengths
        + 2 * constituents * nodes * (COLUMN_TERMS if curved else 1),
        nodes * wavelengths + 3 * nodes * constituents,
        True,
    )
    if isinstance(solver, SingleScattering):
        return {"single scattering": once}
    few = spectral_nodes(atmosphere, scene, solver.spectral_nodes)
    resolution = solver._resolution() if isinstance(solver, OrdersOfScattering) else solver._resolution(1)
    sweeps, views = _streams(resolution, atmosphere, directions, wavelengths if few is None else sum(few))
    if few is not None:
        coarse = _streams(resolution.coarse(), atmosphere, directions, 2 * (wavelengths + sum(few)))
        sweeps, views = (
            Work(a.multiply_adds + b.multiply_adds, a.exponentials + b.exponentials, a.large)
            for a, b in zip((sweeps, views), coarse, strict=True)
        )
    return {"single scattering": once, "sweeps": sweeps, "view integral": views}


def _streams(resolution: Resolution, atmosphere: Atmosphere, directions: int, wavelengths: int) -> tuple[Work, Work]:
    """Work of the sweeps and of the view integral at a number of wavelengths."""
    n, layers, v = resolution.streams, resolution.levels, wavelengths
    count, modes = resolution.for_phases(atmosphere.constituents)
    pairs = sum(max(count - m, 0) for m in range(modes))
    sweep = 2 * pairs * n * layers * v + 2 * (2 + 6) * n * layers * modes * v + layers * layers * v
    if resolution.geometry == "spherical":
        sweep += 2 * layers * n * n * modes * v
    return (
        Work(resolution.orders * sweep + layers**3 * v, 4 * n * layers * v + 2 * layers * v, False),
        Work(pairs * directions * layers * v + 4 * directions * layers * v, 2 * directions * layers * v, True),
    )


def seconds(solver: AbstractSolver, atmosphere: Atmosphere, scene: Scene) -> float:
    """Seconds that a sky may take, compiled, on two cores at 2.5 GHz in float32: counted work times measured ratios.

    They serve to compare solvers: another machine and float64 scale all of them alike. Few wavelengths use a core less
    well than the 41 at which the ratios were measured: 16 directions and 4 wavelengths took some four times as long.
    The work of `Spherical` is not counted; its time is a measured time per wavelength.
    **Errors:** `ValueError` for another solver.
    """
    if isinstance(solver, Spherical):
        return _SPHERICAL_WAVELENGTH * scene.wavelength_nm.shape[0]
    if not isinstance(solver, OrdersOfScattering | DoubleScattering | SingleScattering):
        raise ValueError(f"`solver` must be one whose work is counted, got {type(solver).__name__}")
    kind = {SingleScattering: "single", DoubleScattering: "double"}.get(type(solver), "orders")
    least = sum(work.seconds()[0] for work in counted(solver, atmosphere, scene).values())
    polarised = isinstance(solver, OrdersOfScattering) and solver.polarised
    return _CALL + _OVER[kind] * least * (_POLARISED if polarised else 1.0)
