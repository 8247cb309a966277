"""Spectral responses of a camera's channels from a CSV."""

import os
from pathlib import Path

import numpy as np

from ..response import Response
from .tidy import read_numbers


def read_response(path: str | os.PathLike) -> Response:
    """Read the channels of a camera or photometer from a CSV.

    **Arguments:** `path`: the first column is wavelength_nm, each other column a channel's weights: its value per
    W m^-2 sr^-1 nm^-1 and nm.
    **Returns:** a `Response` of the channels in the order of the columns, with their names. Weights are multiplied by
    the steps of the wavelengths (trapezoids), so that a sum over them is an integral.
    **Valid:** 300-1100 nm, increasing; anything else is a one-line `ValueError` with the file's name.

    **Example:**

        >>> from pathlib import Path
        >>> _ = Path("camera.csv").write_text("wavelength_nm,blue,green\\n450,1,0\\n550,0,2\\n650,0,1\\n")
        >>> camera = skyfit.read_response("camera.csv")
        >>> camera.names, camera.weight.shape
        (('blue', 'green'), (2, 3))
    """
    path = Path(path)
    header, numbers = read_numbers(path)
    if header[0] != "wavelength_nm" or len(header) < 2 or len(numbers) < 2:
        raise ValueError(
            f"{path.name}: expected the column `wavelength_nm`, one or more channels and two or more rows, found "
            f"{', '.join(header)[:200]} and {len(numbers)} rows"
        )
    wavelength = numbers[:, 0]
    half = 0.5 * np.diff(wavelength)
    width = np.append(half, 0.0) + np.append(0.0, half)
    try:
        return Response(wavelength, (numbers[:, 1:] * width[:, None]).T, tuple(header[1:]))
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from None
