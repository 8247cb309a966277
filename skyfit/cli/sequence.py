"""A time-lapse of numbered frames; existing frames are kept."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..measured import atomic
from ..measured.writing import skyfit_version
from .options import in_range
from .sun import moment_in, seen_at, sun_of


class Frame(NamedTuple):
    """A picture to render: file, time as text; zenith angle, azimuth and refracted zenith angle of the sun, degrees."""

    path: Path
    time: str | None
    zenith: float
    azimuth: float
    seen: float

    @property
    def title(self) -> str:
        """The time and the sun's elevation."""
        return f"{self.time}  sun {90.0 - self.zenith:+.1f} deg"


def frames_of(
    out: Path, first: str | None, until: str, count: int | None, at: str | None, pressure: float, lowest: float
) -> list[Frame]:
    """Frames evenly spaced from one time to another, with their suns; arguments as the options."""
    if first is None or at is None or count is None:
        raise ValueError("`--until` must come with `--time`, `--at` and `--frames`")
    in_range("--frames", count, 2, 10000)
    start, end = moment_in("--time", first), moment_in("--until", until)
    if not start < end:
        raise ValueError(f"`--until` must be later than `--time`, got {until} and {first}")
    seconds = np.linspace(0.0, (end - start) / np.timedelta64(1, "s"), count)
    moments = start + np.round(seconds).astype("timedelta64[s]")
    found = []
    for number, moment in enumerate(moments):
        time = f"{np.datetime_as_string(moment, 's')}Z"
        try:
            zenith, azimuth, _ = sun_of(None, None, time, at, pressure, lowest)
        except ValueError as error:
            raise ValueError(f"frame {number + 1}, {time}: {error}") from None
        path = out.with_name(f"{out.stem}.{number + 1:04d}{out.suffix}")
        found.append(Frame(path, time, zenith, azimuth, seen_at(zenith, time, at, pressure)))
    return found


def begin(out: Path, frames: Sequence[Frame], settings: Mapping[str, object]) -> None:
    """Write the settings of the frames to a file beside them.

    **Errors:** `ValueError` if frames exist that have other or unknown settings.
    """
    path = out.with_name(f"{out.name}.frames.json")
    # The content of a file named by an option may change until the next call
    files = {name: value for name, value in settings.items() if isinstance(value, str | Path) and Path(value).is_file()}
    contents = {name: hashlib.sha256(Path(value).read_bytes()).hexdigest() for name, value in files.items()}
    record = {"skyfit_version": skyfit_version(), "options": dict(settings), "sha256": contents}
    text = json.dumps(record, indent=1, default=str) + "\n"
    known = path.read_text() if path.is_file() else None
    if known != text and any(frame.path.exists() for frame in frames):
        raise ValueError(f"{path}: frames of other settings lie there; another `--out`, or remove them first")
    if known != text:
        with atomic(path) as part:
            part.write_text(text)
