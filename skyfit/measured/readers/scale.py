"""The conversion of a file's samples by their unit, and the eye's response for luminance."""

from ..response import Response
from ..units import LUMINANCE, luminance_factor, RADIANCE, radiance_factor


def scale_of(units: str | None, channels: int, own: bool) -> tuple[float, list[str], Response | None]:
    """The factor of units, a note if they are converted, and the eye's response if they are of luminance.

    **Arguments:** `channels`, how many wavelengths or channels the samples have; `own`: whether a response is known, so
    that the units are those of its channels, whatever they are.
    **Errors:** `ValueError` for other units without a response, also for luminance of more than one channel.
    """
    luminance = None if units is None else luminance_factor(units)
    if luminance is not None:
        if channels != 1 and not own:
            raise ValueError(
                f"units {units} of {channels} wavelengths: expected one, of luminance, or a response of the channels "
                "(in the file, or `response`)"
            )
        return luminance, _note(units, luminance, LUMINANCE), None if own else Response.eye()
    if own and units is None:
        return 1.0, [], None
    if units is None:
        raise ValueError(f"expected units {RADIANCE}, found none")
    try:
        factor = radiance_factor(units)
    except ValueError as error:
        if own:
            return 1.0, [], None
        raise ValueError(f"{error}; of channels give their response") from None
    return factor, _note(units, factor, RADIANCE), None


def _note(units, factor, wanted):
    return [] if factor == 1.0 else [f"radiance converted from {units} to {wanted}"]
