"""netCDF files of extinction on voxels, with the droplets' effective radius where it is known."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ValidationError

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.netcdf import (
    AXES,
    LENGTH_UNITS,
    Source,
    file_attributes,
    load_dataset,
    name_of,
    number_variable,
    save_dataset,
    unit_factor,
)
from cloudtomo_cl.scene.grid import Grid

if TYPE_CHECKING:
    import xarray as xr

# km^-1 in one unit of extinction.
EXTINCTION_UNITS = {
    **dict.fromkeys(("km-1", "km^-1", "km**-1", "1/km"), 1.0),
    **dict.fromkeys(("m-1", "m^-1", "m**-1", "1/m"), 1e3),
}
# Coordinates may lie this far from a uniform spacing, in voxels: single precision passes.
UNIFORM_TOLERANCE = 1e-3


def _axis(path: Any, dataset: xr.Dataset, name: str) -> tuple[float, float]:
    """Spacing and lower end of an axis of voxel centres, km."""
    variable = number_variable(path, dataset, name, (name,))
    unit = unit_factor(path, variable, LENGTH_UNITS, "km")
    centres = variable.values.astype(np.float64) * unit
    if not np.isfinite(centres).all():
        raise DataError(f"{path}: {name} has values that are not finite")
    if len(centres) > 1:
        spacing = float(centres[-1] - centres[0]) / (len(centres) - 1)
    else:
        spacing = _single_spacing(path, dataset, name, unit)
    single = variable.dtype == np.float32
    rounding = 4 * float(np.abs(centres).max()) * float(np.finfo(np.float32 if single else np.float64).eps)
    spacing = _tidy(spacing, rounding)
    if not spacing > 0:
        raise DataError(f"{path}: {name} must increase from each voxel centre to the next")
    uniform = centres[0] + spacing * np.arange(len(centres))
    wrong = np.abs(centres - uniform) > UNIFORM_TOLERANCE * spacing
    if wrong.any():
        index = int(np.argmax(wrong))
        raise DataError(
            f"{path}: {name} is not uniform: {centres[index]:g} km at index {index}, where a uniform spacing "
            f"of {spacing:g} km gives {uniform[index]:g} km: resample the extinction to uniform voxels"
        )
    origin = centres[0] - spacing / 2
    if abs(origin) <= UNIFORM_TOLERANCE * spacing:
        return spacing, 0.0
    return spacing, _tidy(origin, rounding)


def _tidy(value: float, rounding: float) -> float:
    """The shortest decimal number that a value may stand for, given its rounding error."""
    for digits in range(1, 17):
        short = float(f"{value:.{digits - 1}e}")
        if abs(short - value) <= rounding:
            return short
    return value


def _single_spacing(path: Any, dataset: xr.Dataset, name: str, unit: float) -> float:
    """The height or width of the only voxel along an axis: one centre does not tell it, its bounds do."""
    bounds = dataset[name].attrs.get("bounds", dataset[name].encoding.get("bounds"))
    if bounds not in dataset.variables or dataset[bounds].size != 2:
        raise DataError(
            f"{path}: {name} has one voxel centre only, which tells no spacing: "
            f"give it at least two, or a bounds variable after CF"
        )
    lower, upper = dataset[bounds].values.ravel().astype(np.float64) * unit
    return float(upper - lower)


def read_extinction(source: Source) -> tuple[Grid, np.ndarray]:
    """Reads extinction(x, y, z) from a netCDF file, or from an xarray Dataset or DataArray.

    The coordinates x, y, z are the centres of uniform voxels, in units of km (also if no unit
    is given) or m; the domain starts half a voxel below the first. Extinction is in km-1
    (also if no unit is given) or m-1; its dimensions may come in any order.

    Returns
    -------
    grid : of the domain
    extinction : km^-1, float32, shape (nx, ny, nz)

    Raises
    ------
    DataError : no such file, not netCDF, cut short; missing variables, other dimensions or
        units, spacing that is not uniform, a domain below the ground; extinction that is
        negative, not finite or zero everywhere
    """
    path, dataset = name_of(source), load_dataset(source)
    variable = number_variable(path, dataset, "extinction", AXES)
    spacing, origin = zip(*(_axis(path, dataset, name) for name in AXES))
    values = variable.values.astype(np.float64) * unit_factor(path, variable, EXTINCTION_UNITS, "km-1")
    with np.errstate(over="ignore"):
        extinction = np.ascontiguousarray(values, dtype=np.float32)
    wrong = ~(np.isfinite(extinction) & (extinction >= 0))
    if wrong.any():
        voxel = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise DataError(
            f"{path}: extinction at voxel {voxel} is {values[voxel]}: it must be finite and at least 0 km^-1"
        )
    if not extinction.any():
        raise DataError(f"{path}: extinction is zero in every voxel: there is no cloud in this file")
    try:
        return Grid(shape=extinction.shape, spacing=spacing, origin=origin), extinction
    except ValidationError as error:
        raise DataError(f"{path}: impossible grid: {error.errors()[0]['msg']} (z must be at least 0)") from None


def read_effective_radius(source: Source) -> np.ndarray | None:
    """effective_radius(x, y, z) of a cloud's file, micrometres, NaN where it has no cloud; None if it has none.

    Raises
    ------
    DataError : other dimensions or units
    """
    path, dataset = name_of(source), load_dataset(source)
    if "effective_radius" not in dataset:
        return None
    variable = number_variable(path, dataset, "effective_radius", AXES)
    factor = unit_factor(path, variable, {"um": 1.0, "micrometer": 1.0, "micron": 1.0, "m": 1e6}, "um")
    return np.ascontiguousarray(variable.to_numpy() * factor, np.float32)


def write_extinction(
    path: str | os.PathLike[str],
    grid: Grid,
    extinction: np.ndarray,
    attributes: Mapping[str, Any] | None = None,
    effective_radius: np.ndarray | None = None,
) -> None:
    """Writes `extinction_dataset` into a netCDF file.

    Parameters
    ----------
    path : of the file; it is replaced whole or not at all
    grid, extinction, attributes, effective_radius : see `extinction_dataset`

    Raises
    ------
    DataError : extinction of another shape or not finite; the file cannot be written
    """
    save_dataset(path, extinction_dataset(grid, extinction, attributes, effective_radius, name_of(path)))


def extinction_dataset(
    grid: Grid,
    extinction: np.ndarray,
    attributes: Mapping[str, Any] | None = None,
    effective_radius: np.ndarray | None = None,
    name: str = "the dataset",
) -> xr.Dataset:
    """extinction(x, y, z) with its voxel centres and their bounds, after the CF conventions.

    Parameters
    ----------
    grid : of the domain
    extinction : km^-1, shape of the grid; stored in single precision
    attributes : text or numbers; mappings are stored as JSON
    effective_radius : of the droplets, micrometres, same shape, NaN where there is no cloud
    name : what errors call it

    Raises
    ------
    DataError : extinction of another shape or not finite
    """
    import xarray as xr

    variables, coordinates = extinction_variables(name, grid, extinction, effective_radius)
    return xr.Dataset(variables, coordinates, file_attributes(attributes))


def extinction_variables(
    path: Any, grid: Grid, extinction: np.ndarray, effective_radius: np.ndarray | None = None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Variables and coordinates of an extinction, checked."""
    extinction = np.asarray(extinction)
    if extinction.shape != grid.shape:
        raise DataError(f"{path}: extinction has shape {extinction.shape}, the grid {grid.shape}")
    if not np.isfinite(extinction).all():
        raise DataError(f"{path}: extinction is not finite everywhere: it is not written")
    standard = {
        "x": {"standard_name": "projection_x_coordinate", "long_name": "voxel centre along x (east)", "axis": "X"},
        "y": {"standard_name": "projection_y_coordinate", "long_name": "voxel centre along y (north)", "axis": "Y"},
        "z": {"standard_name": "height", "long_name": "voxel centre along z (up)", "axis": "Z", "positive": "up"},
    }
    coordinates: dict[str, Any] = {}
    for axis, name in enumerate(AXES):
        centres, half = grid.centres(axis), grid.spacing[axis] / 2
        coordinates[name] = (name, centres, {"units": "km", "bounds": f"{name}_bounds", **standard[name]})
        edges = np.column_stack([centres - half, centres + half])
        described = {"units": "km", "long_name": f"faces of the voxels along {name}"}
        coordinates[f"{name}_bounds"] = ((name, "bound"), edges, described)
    described = {
        "long_name": "cloud volume extinction coefficient",
        "units": "km-1",
    }
    variables: dict[str, Any] = {"extinction": (AXES, extinction.astype(np.float32), described)}
    if effective_radius is not None:
        described = {"long_name": "effective radius of the cloud's droplets", "units": "um"}
        described["standard_name"] = "effective_radius_of_cloud_liquid_water_particles"
        variables["effective_radius"] = (AXES, effective_radius.astype(np.float32), described)
    return variables, coordinates
