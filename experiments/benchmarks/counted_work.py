"""The least time that a sky takes by its counted work."""

from skyfit import Atmosphere, Scene
from skyfit.transport.work import BATCHED_FLOPS, counted, EXPONENTIALS, LARGE_FLOPS


def floor(solver, atmosphere: Atmosphere, scene: Scene) -> dict:
    """The counted work as a record: by part, and the least seconds altogether."""
    parts = counted(solver, atmosphere, scene)
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
