"""netCDF files of extinction on voxels, with the droplets' effective radius where it is known."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cloudtomo_cl.arguments import NUMBER, a, require_kinds
from cloudtomo_cl.errors import DataError, InvalidSettingError
from cloudtomo_cl.files.axes import TOLERANCE, Axis, read_axis
from cloudtomo_cl.files.missing import require_present, undeclared_fill
from cloudtomo_cl.files.netcdf import (
    AXES,
    Source,
    factor_of,
    file_attributes,
    load_dataset,
    name_of,
    number_variable,
    save_dataset,
)
from cloudtomo_cl.files.wavelengths import WAVELENGTH, at_wavelength, wavelength_coordinate, wavelengths_of
from cloudtomo_cl.scene.arrays import real_numbers
from cloudtomo_cl.scene.droplets import GEOMETRIC_EXTINCTION_EFFICIENCY
from cloudtomo_cl.scene.grid import Grid

if TYPE_CHECKING:
    import xarray as xr

# The order of what is written: that of the CF conventions, which viewers take for granted.
WRITTEN_AXES = AXES[::-1]
# What extinctions without units may be, largest of a cloud, km^-1: less is likely one in m^-1.
PLAUSIBLE_EXTINCTION = (0.5, 2000.0)
PLAUSIBLE_RADIUS = (0.5, 500.0)
# The attribute of an extinction that water has in the limit of large droplets, whatever the wavelength.
_EFFICIENCY = "extinction_efficiency"
# Above this a number is no quantity of a cloud in any unit, but a mark for missing values.
LARGEST = 1e15


def _axis(path: Any, dataset: xr.Dataset, name: str) -> tuple[Axis, float, float]:
    """An axis of voxel centres, with its spacing and lower end, km."""
    stored = number_variable(path, dataset, name, (name,))
    axis = read_axis(path, dataset, name, name)
    count, points = len(axis.points), axis.points
    single = stored.dtype == np.float32
    rounding = 4 * float(np.abs(points).max()) * float(np.finfo(np.float32 if single else np.float64).eps)
    spacing = _tidy(float(axis.edges[-1] - axis.edges[0]) / count, rounding)
    uniform = axis.edges[0] + spacing * (np.arange(count) + 0.5)
    between = (points[-1] - points[0]) / (count - 1) if count > 1 else spacing
    # Neither edges nor points may be uneven; points may lie off the middle.
    wrong = np.abs(axis.edges[1:] - uniform - spacing / 2) > 2 * TOLERANCE * spacing
    wrong |= np.abs(points - points[0] - between * np.arange(count)) > TOLERANCE * spacing
    if wrong.any():
        index = int(np.argmax(wrong))
        raise DataError(
            f"{path}: {name} is not uniform: {points[index]:g} km at index {index}, where a uniform spacing "
            f"of {spacing:g} km gives {uniform[index]:g} km: resample the extinction to uniform voxels"
        )
    # Half a voxel below the first centre, unless bounds say otherwise: centres have less rounding than edges.
    if np.allclose(axis.edges[:-1], points - spacing / 2, rtol=0, atol=TOLERANCE * spacing):
        spacing = _tidy(float(between), rounding)
        origin = float(points[0]) - spacing / 2
    else:
        origin = float(axis.edges[0])
    if abs(origin) <= TOLERANCE * spacing:
        return axis, spacing, 0.0
    return axis, spacing, _tidy(origin, rounding)


def _tidy(value: float, rounding: float) -> float:
    """The shortest decimal number that a value may stand for, given its rounding error."""
    for digits in range(1, 17):
        short = float(f"{value:.{digits - 1}e}")
        if abs(short - value) <= rounding:
            return short
    return value


def _turned(values: np.ndarray, axes: Sequence[Axis]) -> np.ndarray:
    """Values over x, y, z along rising axes."""
    return values[tuple(slice(None, None, -1 if axis.falls else 1) for axis in axes)]


def read_extinction(source: Source, wavelength: float | None = None) -> tuple[Grid, np.ndarray]:
    """Reads extinction(x, y, z) from a netCDF file, or from an xarray Dataset or DataArray.

    The coordinates x, y, z are the centres of uniform voxels, in units of length (km if no unit is given, and
    voxels then are as small as those of clouds); they may fall, and the domain starts half a voxel below the lowest,
    or where bounds say. Extinction is in units of an inverse length (km-1 if none is given); its dimensions may come
    in any order.

    Parameters
    ----------
    source : a file, or a dataset
    wavelength : nm, which extinction, where the file holds those at several

    Returns
    -------
    grid : of the domain
    extinction : km^-1, float32, shape (nx, ny, nz)

    Raises
    ------
    DataError : no such file, not netCDF, cut short; several wavelengths of which
        none is chosen, or not this one; missing variables, other dimensions or
        units, spacing that is not uniform, a domain below the ground; extinction that is missing,
        negative, not finite or zero everywhere, or without units and unlike any cloud's
    """
    path = name_of(source)
    dataset = at_wavelength(path, load_dataset(source), wavelength)
    variable = number_variable(path, dataset, "extinction", AXES)
    axes, spacing, origin = zip(*(_axis(path, dataset, name) for name in AXES))
    factor, stated = factor_of(path, "extinction", variable.attrs.get("units"), "km-1")
    values = _turned(variable.values.astype(np.float64) * factor, axes)
    with np.errstate(over="ignore"):
        extinction = np.ascontiguousarray(values, dtype=np.float32)
    check_extinction(path, "extinction", values)
    wrong = ~np.isfinite(extinction)
    if wrong.any():
        voxel = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise DataError(
            f"{path}: extinction at voxel {voxel} is {values[voxel]}: it must be finite and at least 0 km^-1"
        )
    if not extinction.any():
        raise DataError(f"{path}: extinction is zero in every voxel: there is no cloud in this file")
    if not stated:
        require_plausible(path, "extinction", float(values.max()), "km-1", PLAUSIBLE_EXTINCTION)
    try:
        return Grid(shape=extinction.shape, spacing=spacing, origin=origin), extinction
    except InvalidSettingError as error:
        raise DataError(f"{path}: impossible grid: {error.details[0]['msg']} (z must be at least 0)") from None


def read_extinction_wavelength(source: Source) -> float | None:
    """The wavelength at which a file has its extinction.

    Returns
    -------
    wavelength : nm; 0 in the limit of large droplets, where the extinction efficiency is 2 and no wavelength matters;
        None where the file does not say, or holds several

    Raises
    ------
    DataError : no such file, not netCDF; a wavelength that is none
    """
    dataset = load_dataset(source)
    found = wavelengths_of(name_of(source), dataset)
    if len(found) == 1:
        return found[0]
    return extinction_wavelength(dataset.get("extinction"))


def extinction_wavelength(variable: xr.DataArray | None) -> float | None:
    """0 where a variable says that it is in the limit of large droplets; None otherwise."""
    efficiency = None if variable is None else variable.attrs.get(_EFFICIENCY)
    return 0.0 if efficiency == GEOMETRIC_EXTINCTION_EFFICIENCY else None


def check_extinction(path: Any, name: str, values: np.ndarray) -> None:
    """Checks that values of a cloud are known, finite and not negative everywhere. DataError names the first voxel."""
    wrong = ~(np.isfinite(values) & (values >= 0) & (values < LARGEST))
    if wrong.any():
        voxel = tuple(int(i) for i in np.argwhere(wrong)[0])
        missing = int(np.isnan(values).sum())
        what = f"; {missing} of {wrong.size} voxels are missing (NaN, masked, or a fill value)" if missing else ""
        if not missing and undeclared_fill(values[voxel]).any():
            what = ": if that means missing, say so with the attribute _FillValue"
        raise DataError(f"{path}: {name} at voxel {voxel} is {values[voxel]}: it must be finite and at least 0{what}")


def require_plausible(path: Any, name: str, value: float, unit: str, limits: tuple[float, float]) -> None:
    """Checks a value whose unit nobody stated against what clouds have. DataError names the likely unit."""
    lower, upper = limits
    if lower <= value <= upper:
        return
    others = {"km-1": ("m-1", 1e3), "um": ("m", 1e6), "g m-3": ("kg m-3", 1e3), "kg m-3": ("g m-3", 1e-3)}
    other, factor = others[unit]
    likely = f", likely {other}" if lower <= value * factor <= upper else ""
    raise DataError(
        f"{path}: {name} has no units, and as {unit} its largest value, {value:g}, is none of a cloud "
        f"({lower:g} to {upper:g}): set its attribute units{likely}, or say --units"
    )


def read_effective_radius(source: Source) -> np.ndarray | None:
    """effective_radius(x, y, z) of a cloud's file, micrometres, NaN where it has no cloud; None if it has none.

    Raises
    ------
    DataError : other dimensions or units; missing, not above 0, or unlike any droplets' where there is cloud
    """
    path, dataset = name_of(source), load_dataset(source)
    if "effective_radius" not in dataset:
        return None
    variable = number_variable(path, dataset, "effective_radius", AXES)
    factor, stated = factor_of(path, "effective_radius", variable.attrs.get("units"), "um")
    radius = variable.to_numpy().astype(np.float64) * factor
    if all(name in dataset.variables for name in AXES):
        radius = _turned(radius, [read_axis(path, dataset, name, name) for name in AXES])
    if "extinction" in dataset.variables:
        extinction = read_extinction(dataset, next(iter(wavelengths_of(path, dataset)), None))[1]
        check_radius(path, radius, extinction > 0, stated)
    return np.ascontiguousarray(radius, np.float32)


def check_radius(path: Any, radius: np.ndarray, cloudy: np.ndarray, stated: bool = True) -> None:
    """Checks that the droplets' size is known wherever there are droplets.

    Parameters
    ----------
    path : what errors call its file
    radius : micrometres, NaN where it is unknown
    cloudy : bool, the same shape: where there is cloud
    stated : whether somebody said that it is in micrometres

    Raises
    ------
    DataError : missing, not above 0, or unlike any droplets' in a cloudy voxel
    """
    require_present(path, "effective radius", radius, "a cloudy voxel must know its droplets' size", cloudy)
    wrong = cloudy & ~(np.isfinite(radius) & (radius > 0))
    if wrong.any():
        voxel = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise DataError(
            f"{path}: effective radius at the cloudy voxel {voxel} is {radius[voxel]}: it must be above 0 um"
        )
    if not stated and cloudy.any():
        for value in (radius[cloudy].min(), radius[cloudy].max()):
            require_plausible(path, "effective radius", float(value), "um", PLAUSIBLE_RADIUS)


def write_extinction(
    path: str | os.PathLike[str],
    grid: Grid,
    extinction: np.ndarray,
    attributes: Mapping[str, Any] | None = None,
    effective_radius: np.ndarray | None = None,
    wavelength: float | None = None,
) -> None:
    """Writes `extinction_dataset` into a netCDF file.

    Parameters
    ----------
    path : of the file; it is replaced whole or not at all
    grid, extinction, attributes, effective_radius, wavelength : see `extinction_dataset`

    Raises
    ------
    DataError : as `extinction_dataset`; the file cannot be written
    """
    save_dataset(path, extinction_dataset(grid, extinction, attributes, effective_radius, name_of(path), wavelength))


def extinction_dataset(
    grid: Grid,
    extinction: np.ndarray,
    attributes: Mapping[str, Any] | None = None,
    effective_radius: np.ndarray | None = None,
    name: str = "the dataset",
    wavelength: float | None = None,
) -> xr.Dataset:
    """extinction(z, y, x) with its voxel centres and their bounds, after the CF conventions.

    Parameters
    ----------
    grid : of the domain
    extinction : km^-1, shape of the grid; stored in single precision
    attributes : text or numbers; mappings are stored as JSON
    effective_radius : of the droplets, micrometres, same shape, NaN where there is no cloud
    name : what errors call it
    wavelength : nm, at which the extinction is; 0 in the limit of large droplets (an extinction efficiency of 2)

    Raises
    ------
    DataError : extinction of another shape, negative or not finite; a radius that is missing in the cloud; an argument
        is of another kind (InvalidArgumentError)
    """
    import xarray as xr

    require_kinds(name, wavelength=(wavelength, NUMBER.or_none()))
    variables, coordinates = extinction_variables(name, grid, extinction, effective_radius)
    if wavelength:
        coordinates[WAVELENGTH] = wavelength_coordinate(wavelength)
    elif wavelength is not None:
        variables["extinction"][2][_EFFICIENCY] = GEOMETRIC_EXTINCTION_EFFICIENCY
    return xr.Dataset(variables, coordinates, file_attributes("extinction of a cloud", attributes))


def extinction_variables(
    path: Any, grid: Grid, extinction: np.ndarray, effective_radius: np.ndarray | None = None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Variables and coordinates of an extinction, checked."""
    require_kinds(str(path), grid=(grid, a(Grid)))
    extinction = real_numbers(extinction, f"{path}: extinction")
    if extinction.shape != grid.shape:
        raise DataError(f"{path}: extinction has shape {extinction.shape}, the grid {grid.shape}")
    if not np.isfinite(extinction).all():
        raise DataError(f"{path}: extinction is not finite everywhere: it is not written")
    check_extinction(path, "extinction", extinction)
    # Without the attribute axis for x and y: VTK's reader (ParaView) takes them for longitude and latitude then.
    standard = {
        "x": {"standard_name": "projection_x_coordinate", "long_name": "voxel centre along x (east)"},
        "y": {"standard_name": "projection_y_coordinate", "long_name": "voxel centre along y (north)"},
        "z": {"standard_name": "height", "long_name": "voxel centre along z (up)", "axis": "Z", "positive": "up"},
    }
    coordinates: dict[str, Any] = {}
    for axis, name in enumerate(AXES):
        centres, half = grid.centres(axis), grid.spacing[axis] / 2
        coordinates[name] = (name, centres, {"units": "km", "bounds": f"{name}_bounds", **standard[name]})
        edges = np.column_stack([centres - half, centres + half])
        coordinates[f"{name}_bounds"] = ((name, "bound"), edges)  # CF: without attributes of their own
    described = {
        "long_name": "cloud volume extinction coefficient",
        "units": "km-1",
    }
    variables: dict[str, Any] = {"extinction": (WRITTEN_AXES, extinction.T.astype(np.float32), described)}
    if effective_radius is not None:
        effective_radius = real_numbers(effective_radius, f"{path}: effective_radius")
        if effective_radius.shape != grid.shape:
            raise DataError(f"{path}: effective_radius has shape {effective_radius.shape}, the grid {grid.shape}")
        check_radius(path, effective_radius, extinction > 0)
        described = {"long_name": "effective radius of the cloud's droplets", "units": "um"}
        described["standard_name"] = "effective_radius_of_cloud_liquid_water_particles"
        variables["effective_radius"] = (WRITTEN_AXES, effective_radius.T.astype(np.float32), described)
    return variables, coordinates
