"""Options of the commands that read a measured sky, beside its file."""

from pathlib import Path
from typing import Annotated

import typer


Latitude = Annotated[float | None, typer.Option(help="degrees north, if the file does not tell")]
Longitude = Annotated[float | None, typer.Option(help="degrees east, if the file does not tell")]
UtcOffset = Annotated[float | None, typer.Option(help="hours of local time ahead of UTC (EDT: -4)")]
Altitude = Annotated[float | None, typer.Option(help="of the station, metres")]
ResponseOption = Annotated[str | None, typer.Option(help="samples are channels: xyz, srgb or a CSV of them")]
MaskSun = Annotated[float | None, typer.Option(help="leave out samples within so many degrees of the sun")]
Times = Annotated[
    str | None,
    typer.Option(help="first..last, both included, each a number from 1 or an ISO time (UTC); one may lack"),
]


def read_asked(path: Path, latitude, longitude, utc_offset, altitude, fwhm, response=None):
    """Read the sky of a file, with the metadata given by the user."""
    from ..measured import read

    return read(
        path, latitude=latitude, longitude=longitude, utc_offset=utc_offset, altitude=altitude, fwhm_nm=fwhm,
        response=response,
    )  # fmt: skip
