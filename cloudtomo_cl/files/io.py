"""All that reads and writes our netCDF files, by one name."""

from cloudtomo_cl.files.extinction import (
    extinction_dataset,
    read_effective_radius,
    read_extinction,
    write_extinction,
)
from cloudtomo_cl.files.measurements import (
    VIEW_FIELDS,
    measurements_dataset,
    read_measurements,
    read_rays,
    read_settings,
    write_measurements,
    write_rays,
)
from cloudtomo_cl.files.netcdf import CONVENTIONS, check_output, is_netcdf, load_dataset, save_dataset

__all__ = [
    "CONVENTIONS",
    "VIEW_FIELDS",
    "check_output",
    "extinction_dataset",
    "is_netcdf",
    "load_dataset",
    "measurements_dataset",
    "read_effective_radius",
    "read_extinction",
    "read_measurements",
    "read_rays",
    "read_settings",
    "save_dataset",
    "write_extinction",
    "write_measurements",
    "write_rays",
]
