"""Write the products of a haze as NetCDF or as a table."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..extras import require
from ..measured import atomic


if TYPE_CHECKING:
    import xarray

_COLUMNS = "time", "quantity", "wavelength_nm", "radius_um", "value", "sigma", "unit"


def write_products(products: "xarray.Dataset", path: str | os.PathLike) -> None:
    """Write the result of `aerosol_products` as NetCDF 4 (`*.nc`) or as a table (`*.csv`) with a row for each number.

    The columns are time (UTC), quantity, wavelength_nm, radius_um, value, sigma (inf: not determined) and unit. The
    cell of a wavelength or radius on which a quantity does not depend is empty. **Errors:** `ValueError` for another
    suffix, and if nothing can be written, in which case an older file stays.

    **Example:**

        >>> sky = skyfit.read("data/skies/sample.nc")
        >>> fit = skyfit.invert(sky, ["turbidity"], skyfit.SingleScattering.draft("flat"))
        >>> skyfit.write_products(skyfit.aerosol_products(fit), "aerosol.csv")
        >>> from pathlib import Path
        >>> Path("aerosol.csv").read_text().split(",")[:3]
        ['time', 'quantity', 'wavelength_nm']
    """
    path = Path(path)
    if path.suffix not in (".nc", ".csv"):
        raise ValueError(f"{path.name}: expected a suffix of .nc or .csv, found {path.suffix!r}")
    with atomic(path) as part:
        if path.suffix == ".nc":
            require("h5netcdf")
            products.to_netcdf(part, engine="h5netcdf")
        else:
            part.write_text(_table(products), encoding="utf-8")


def _table(products: "xarray.Dataset") -> str:
    lines = [",".join(_COLUMNS)]
    times = [np.datetime_as_string(time, unit="s") for time in products["time"].values]
    for name in products:
        if str(name).endswith("_sigma"):
            continue
        values, sigmas = products[name], products[f"{name}_sigma"].values
        axis = values.dims[1] if len(values.dims) > 1 else None
        places = [""] if axis is None else [f"{place:.9g}" for place in products[axis].values]
        for t, time in enumerate(times):
            rows = np.atleast_1d(values.values[t]), np.atleast_1d(sigmas[t])
            for place, value, sigma in zip(places, *rows, strict=True):
                where = (place, "") if axis == "wavelength" else ("", place)
                lines.append(",".join([time, str(name), *where, f"{value:.9g}", f"{sigma:.4g}", values.attrs["units"]]))
    return "\n".join(lines) + "\n"
