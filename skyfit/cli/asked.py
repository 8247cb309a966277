"""Conversion of the options of `skyfit invert` from text to settings."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..atmosphere import Atmosphere
from ..measured import mask_sun as without_sun, read_response, Response, Sky
from ..measured.readers.header import moment_of
from ..retrieve import (
    BINS_FREE,
    check_free,
    LOBES_FREE,
    PARAMETERS,
    PARTICLE_FREE,
    SkyModel,
    SLOW,
    start_at,
    usual_free,
    with_values,
)
from ..retrieve.parameters import POINTING
from .options import in_range


_SETS = {"particles": PARTICLE_FREE, "bins": BINS_FREE, "lobes": LOBES_FREE}


def names_in(text: str) -> tuple[str, ...]:
    """Names from a comma-separated list; `particles`, `bins`, `lobes` expand to `PARTICLE_FREE` and so on."""
    names = [name.strip() for name in text.split(",") if name.strip()]
    return tuple(one for name in names for one in _SETS.get(name, (name,)))


def free_of(text: str | None, sky: Sky, known: Collection[str] = ()) -> tuple[str, ...]:
    """The names of the free parameters: those named in `text`, those of its sets, or the default for the sky.

    Sets and the default leave out parameters with known values, and the pointing if the instrument tracks the sun.
    """
    asked = [] if text is None else [name.strip() for name in text.split(",")]
    names = usual_free(sky) if text is None else names_in(text)
    left = {*known, *(POINTING if sky.follows_sun else ())}
    return tuple(name for name in names if name in asked or name not in left)


def values_of_fix(fix: Sequence[str]) -> dict[str, float]:
    """The values given by the user, by parameter name."""
    return {name: _value("--fix", name, text) for name, text in _by_name("--fix", "name=value", fix).items()}


def start_of(
    free: tuple[str, ...], known: Mapping[str, float], sky: Sky, atmosphere: Atmosphere | None = None
) -> SkyModel:
    """The first guess, or the given atmosphere in its place, with the values given by the user."""
    start = start_at(sky, free) if atmosphere is None else SkyModel(atmosphere)
    check_free(free, start)
    for name in known:
        if name in free:
            raise ValueError(f"`--fix` must name each parameter once and none of `--free`, got {name!r}")
    try:
        check_free((*free, *known), start)
    except ValueError as error:
        raise ValueError(f"`--fix` with `--free`: {error}") from None
    return with_values(start, tuple(known), list(known.values()))


def shared_of(
    free: tuple[str, ...], shared: str | None, independent: bool, smooth: Sequence[str], times: int
) -> tuple[str, ...]:
    """The parameters shared by all times: those the user names, else the slow ones if there are several times."""
    if independent:
        if shared is not None:
            raise ValueError("`--shared` must be left out with `--independent`")
        return ()
    if shared is not None:
        return names_in(shared)
    return tuple(name for name in free if name in SLOW and name not in smooth) if times > 1 else ()


def priors_of(texts: Sequence[str]) -> dict[str, tuple[float, float] | None]:
    """Prior value and sigma by parameter name; None for a parameter that shall have no prior."""
    form, priors = "name=value,sigma or name=none", {}
    for name, text in _by_name("--prior", form, texts).items():
        if text == "none":
            priors[name] = None
            continue
        value, comma, sigma = text.partition(",")
        if not comma:
            raise ValueError(f"`--prior` must be {form}, got {name + '=' + text!r}")
        priors[name] = _value("--prior", name, value), _positive("--prior", name, sigma)
    return priors


def smooth_of(texts: Sequence[str]) -> dict[str, float]:
    """Sigma of the change per hour, by name, of the parameters that are smooth in time."""
    entries = _by_name("--smooth", "name=sigma", texts)
    return {name: _positive("--smooth", name, text) for name, text in entries.items()}


def response_of(text: str | None) -> Response | None:
    """The response of the samples' channels: CIE XYZ, linear sRGB or that of a file."""
    if text is None:
        return None
    return {"xyz": Response.xyz, "srgb": Response.linear_srgb}.get(text, lambda: read_response(Path(text)))()


def samples_of(sky: Sky, times: str | None, mask_sun: float | None) -> Sky:
    """The sky at the chosen times, without samples within `mask_sun` degrees of the sun."""
    if times is not None:
        sky = sky.at_times(times_of(times, sky))
    if mask_sun is not None:
        sky = without_sun(sky, np.radians(in_range("--mask-sun", mask_sun, 0.0, 180.0)))
    return sky


def times_of(text: str, sky: Sky) -> np.ndarray:
    """Indices of the times in first..last, each a number from 1 or an ISO time; a single one is both."""
    first, dots, last = (part.strip() for part in text.partition(".."))
    last = last if dots else first
    number, chosen = np.arange(1, len(sky.time) + 1), np.full(len(sky.time), True)
    for end, low in ((first, True), (last, False)):
        if not end:
            continue
        if end.isdigit():
            axis, limit = number, int(end)
        else:
            axis, limit = sky.time, _moment(text, end)
            # A last time given as a day or a minute includes all of it
            limit = limit if low else limit + _span(end)
        chosen &= (axis >= limit) if low else (axis <= limit)
    if not chosen.any():
        known = f"{len(sky.time)} times" + ("" if np.isnat(sky.time).all() else f", {' to '.join(_ends(sky))}")
        raise ValueError(f"`--times` must hold one of the file's {known}, got {text!r}")
    return np.flatnonzero(chosen)


def _ends(sky: Sky) -> tuple[str, str]:
    known = np.sort(sky.time[~np.isnat(sky.time)]).astype("datetime64[s]")
    return f"{known[0]}Z", f"{known[-1]}Z"


def _moment(text: str, end: str) -> np.datetime64:
    try:
        return moment_of(end)
    except ValueError:
        form = "first..last, each a number from 1 or an ISO time such as 2013-05-27T14:00Z"
        raise ValueError(f"`--times` must be {form}, got {text!r}") from None


def _span(end: str) -> np.timedelta64:
    """The duration after its beginning that a time includes, by its precision: a day, a minute or a second."""
    unit = "D" if len(end) <= 10 else "m" if end.count(":") == 1 and "+" not in end else "s"
    return np.timedelta64(1, unit).astype("timedelta64[ns]") - np.timedelta64(1, "ns")


def _by_name(option: str, form: str, texts: Sequence[str]) -> dict[str, str]:
    entries: dict[str, str] = {}
    for text in texts:
        name, _, rest = text.partition("=")
        if name not in PARAMETERS:
            raise ValueError(f"`{option}` must name a parameter among {', '.join(PARAMETERS)}; got {name!r}")
        if name in entries:
            raise ValueError(f"`{option}` must name each parameter once, got {name!r}")
        if not rest:
            raise ValueError(f"`{option}` must be {form}, got {text!r}")
        entries[name] = rest
    return entries


def _number(option: str, name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"`{option}` of {name} must be a number, got {text!r}") from None


def _value(option: str, name: str, text: str) -> float:
    parameter = PARAMETERS[name]
    return in_range(f"{option} {name}", _number(option, name, text), parameter.lower, parameter.upper)


def _positive(option: str, name: str, text: str) -> float:
    number = _number(option, name, text)
    if not 0.0 < number < float("inf"):
        raise ValueError(f"`{option}` of {name} must have a positive sigma, got {text!r}")
    return number
