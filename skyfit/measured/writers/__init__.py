from .netcdf import axes as axes, degrees as degrees, write_netcdf as write_netcdf
from .tidy import write_tidy as write_tidy
