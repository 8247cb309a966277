"""Load a NetCDF file into memory."""

from pathlib import Path

from ...extras import require


def load_dataset(path: Path):
    """All of a NetCDF file in memory, as an `xarray.Dataset`; a one-line `ValueError` if it is no NetCDF or damaged."""
    require("xarray", "h5netcdf", "h5py")
    import xarray

    with open(path, "rb") as stream:
        start = stream.read(4)
    # NetCDF 3 begins with CDF, NetCDF 4 as HDF5.
    engine = {b"CDF": "scipy", b"\x89HD": "h5netcdf"}.get(start[:3])
    if engine is None:
        found = "an empty file" if not start else f"a file that begins with {start!r}"
        raise ValueError(f"{path.name}: expected NetCDF, found {found}")
    try:
        with open(path, "rb") as stream:
            if engine == "h5netcdf":
                _probe(stream)
            return xarray.load_dataset(stream, engine=engine, decode_timedelta=False)
    except Exception as error:
        line = (str(error).splitlines() or [""])[0] or type(error).__name__
        raise ValueError(f"{path.name}: expected NetCDF, found a truncated or damaged file ({line})") from error


def _probe(stream):
    """Fail on a damaged HDF5 file; h5netcdf would fail too, and then again when it is garbage-collected."""
    import h5py

    with h5py.File(stream, "r") as file:
        list(file.attrs.items())
        list(file.items())
    stream.seek(0)
