"""The multiply-adds and exponentials that `OrdersOfScattering` needs for a sky, and the least time they take."""

from typing import NamedTuple

from skyfit import Atmosphere, OrdersOfScattering
from skyfit.transport.optics import scatterer_indices


# FACTS of the machine (2 cores at 2.5 GHz, float32): exponentials and flops a second
EXPONENTIALS = 0.56e9
BATCHED_FLOPS = (12e9, 21e9)
LARGE_FLOPS = 45e9
# multiply-adds of a column along a curved ray: two polynomials, of degrees 10 and 6
COLUMN_TERMS = 17


class Work(NamedTuple):
    """Multiply-adds and exponentials of one part, and whether its multiplications are one large product."""

    multiply_adds: float
    exponentials: float
    large: bool

    def seconds(self) -> tuple[float, float]:
        """At the fast and at the slow rate."""
        rates = (LARGE_FLOPS, LARGE_FLOPS) if self.large else BATCHED_FLOPS[::-1]
        fast, slow = (2.0 * self.multiply_adds / rate + self.exponentials / EXPONENTIALS for rate in rates)
        return fast, slow


def counted(solver: OrdersOfScattering, atmosphere: Atmosphere, directions: int, wavelengths: int) -> dict[str, Work]:
    """Work of one sky, by part.

    D directions, W wavelengths, V of them solved, C constituents of which S scatter, Q nodes, N streams a
    hemisphere, L layers, I sweeps, P pairs (l, m) with l >= m.

    single scattering: exponents $\\tau = $ column $\\cdot$ extinction, C D Q W; their exponentials, D Q W; the sum over
    nodes, S D Q W; phase functions times it, S D W; densities and two columns, 3 C D Q exponentials, with 17
    multiply-adds a column on curved paths (exponential profiles; ozone's takes 16 points).
    sweeps: moments to streams and back, 2 P N L V a sweep; in each of two directions 2 N L M V for the recurrence and
    6 N L M V for the emitted and the mean light; turning on curved paths, 2 L N N M V; diffusion, L L V a sweep and
    once the inverse that is dense as it is coded, L^3 V; attenuation and source functions, 4 N L V exponentials.
    view integral: moments into views, P D L V; attenuation and source functions, 2 D L V exponentials and 4
    multiply-adds; to all wavelengths, V W D, with D W exponentials and D V logarithms.
    """
    d, w, n, layers, q = directions, wavelengths, solver.streams, solver.levels, solver.nodes
    few = solver.spectral_nodes
    v = w if few is None or not 0 < few < w else few + (few + 1) // 2
    count, modes = solver._resolution().for_phases(atmosphere.constituents)
    pairs = sum(max(count - m, 0) for m in range(modes))
    c, s = len(atmosphere.constituents), len(scatterer_indices(atmosphere.constituents))
    curved = solver.geometry == "spherical"
    column = COLUMN_TERMS if curved else 1
    sweep = 2 * pairs * n * layers * v + 2 * (2 + 6) * n * layers * modes * v + layers * layers * v
    if curved:
        sweep += 2 * layers * n * n * modes * v
    return {
        "single scattering": Work(d * q * w * (c + s) + s * d * w + 2 * c * d * q * column,
                                  d * q * w + 3 * d * q * c, True),
        "sweeps": Work(solver.orders * sweep + layers**3 * v, 4 * n * layers * v + 2 * layers * v, False),
        "view integral": Work(pairs * d * layers * v + 4 * d * layers * v + d * w * v * (v < w),
                              2 * d * layers * v + (d * w + d * v) * (v < w), True),
    }  # fmt: skip


def floor(solver: OrdersOfScattering, atmosphere: Atmosphere, directions: int, wavelengths: int) -> dict:
    """The counted work as a record: by part, and the least seconds altogether."""
    parts = counted(solver, atmosphere, directions, wavelengths)
    record = {
        name: {
            "multiply_adds": part.multiply_adds,
            "exponentials": part.exponentials,
            "seconds": part.seconds()[0],
            "seconds_slow_rate": part.seconds()[1],
        }
        for name, part in parts.items()
    }
    return {
        "parts": record,
        "seconds": sum(part["seconds"] for part in record.values()),
        "seconds_slow_rate": sum(part["seconds_slow_rate"] for part in record.values()),
        "rates": {
            "exponentials_per_second": EXPONENTIALS,
            "flops_small_batches": BATCHED_FLOPS,
            "flops_large": LARGE_FLOPS,
        },
    }
