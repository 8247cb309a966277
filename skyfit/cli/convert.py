"""`skyfit convert`."""

from pathlib import Path
from typing import Annotated

import typer

from .asked_of_files import Altitude, Latitude, Longitude, ResponseOption, Times, UtcOffset
from .options import command, LineShape


@command("convert", "skyfit convert scan.alm --to sky.nc")
def convert_command(
    file: Annotated[Path, typer.Argument(help="of an instrument, NetCDF, CSV or a folder of ASD text exports")],
    to: Annotated[Path, typer.Option(help="file to write, .nc or .csv")],
    times: Times = None,
    response: ResponseOption = None,
    latitude: Latitude = None,
    longitude: Longitude = None,
    utc_offset: UtcOffset = None,
    altitude: Altitude = None,
    fwhm: LineShape = None,
):
    """Write a measured sky of any format that skyfit reads as NetCDF or CSV, and show what was understood of it.

    As skyfit.read and skyfit.write_sky do in Python. The format is known by what is in the file.
    """
    from ..measured import write_sky
    from .asked import response_of, times_of
    from .asked_of_files import read_asked
    from .printing import give, written
    from .sky_report import print_sky, record_of

    if to.suffix not in (".nc", ".csv") or not to.absolute().parent.is_dir():
        raise ValueError(f"`--to` must be a .nc or .csv file in a folder that is there, got {to}")
    sky = read_asked(file, latitude, longitude, utc_offset, altitude, fwhm, response_of(response))
    if times is not None:
        sky = sky.at_times(times_of(times, sky))
    write_sky(sky, to)
    print_sky(sky)
    written([to])
    give(record_of(sky, to))
