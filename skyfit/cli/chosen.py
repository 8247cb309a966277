"""The option `--tolerance`: the solver that `choose` finds for all skies of a command."""

import numpy as np

from ..atmosphere import Atmosphere
from ..measured import Response, Sky
from ..scene import Directions, Scene
from ..transport import Choice
from .models import tolerance_of
from .options import Context, refuse
from .printing import say, warn


def allowed_of(context: Context, solver: str, tolerance: str | None, held: tuple[str, ...]) -> float | None:
    """The tolerance, or None if it is not given; raises if an option is given that the choice of solver decides."""
    if tolerance is None:
        if solver == "auto":
            raise ValueError("`--solver auto` must come with `--tolerance`, to which it is chosen")
        return None
    refuse(context, (*held, *("solver",) * (solver != "auto")), "`--tolerance`, which chooses the solver")
    return tolerance_of(tolerance)


def scenes_of(sky: Sky, atmosphere: Atmosphere, response: Response | None) -> list[Scene]:
    """A scene for each time, at the wavelengths of the sky or of its channels' spectrum within the air's range."""
    seen = response or sky.response
    nm = sky.wavelength_nm if seen is None else seen.spectrum(sky.wavelength_nm)
    parts = [part for c in atmosphere.constituents for part in (c, c.phase) if part is not None]
    for low, high in (part.known_nm for part in parts):
        nm = nm[(nm >= low) & (nm <= high)]
    found = []
    for t in range(len(sky.time)):
        view = np.stack([sky.view_zenith[t], sky.view_azimuth[t]])
        view = Directions(*view[:, np.isfinite(view[0])])
        found.append(Scene(*sky.sun_at(t), view, nm, np.ones(nm.size)))
    return found


def record_of(choice: Choice) -> dict:
    """The entries of a choice in a file."""
    return {
        "tolerance": choice.tolerance, "expected_error": choice.expected_error, "met": choice.met,
        "reasons": list(choice.reasons),
    }  # fmt: skip


def expected_of(choice: Choice) -> str:
    """The expected error in words."""
    return f"error to expect: {100.0 * choice.expected_error:.2g} % at most"


def print_choice(choice: Choice) -> None:
    """Print the reasons for the choice of solver, and its expected error."""
    for reason in choice.reasons:
        say(f"  {reason}")
    expected = expected_of(choice)
    if choice.met:
        say(expected)
    else:
        warn(f"{expected}, where {100.0 * choice.tolerance:.2g} % was asked for")
