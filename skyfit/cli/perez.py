"""`skyfit perez`."""

from pathlib import Path
from typing import Annotated

import typer

from .asked_of_files import Altitude, Latitude, Longitude, MaskSun, read_asked, ResponseOption, Times, UtcOffset
from .options import check_file, command


@command("perez", "skyfit perez scan.csv --out perez.csv")
def perez_command(
    sky: Annotated[Path, typer.Argument(help="of an instrument, NetCDF, CSV or a folder of ASD text exports")],
    out: Annotated[Path, typer.Option(help="CSV file to write")],
    each: Annotated[bool, typer.Option("--each", help="each wavelength, not luminance")] = False,
    mask_sun: MaskSun = None,
    times: Times = None,
    response: ResponseOption = None,
    latitude: Latitude = None,
    longitude: Longitude = None,
    utc_offset: UtcOffset = None,
    altitude: Altitude = None,
):
    """Fit Perez' five parameters to every time of a measured sky, with their covariance.

    As skyfit.perez_of_sky does in Python: of luminance where the sky tells it, else of each wavelength.
    """
    from ..analytic import perez_of_sky
    from ..records import write_perez
    from .asked import response_of, samples_of
    from .perez_report import print_perez, record_of
    from .printing import give, written

    check_file(out)
    measured = read_asked(sky, latitude, longitude, utc_offset, altitude, None, response_of(response))
    found = perez_of_sky(samples_of(measured, times, mask_sun), each)
    write_perez(found, out)
    print_perez(found)
    written([out])
    give(record_of(out))
