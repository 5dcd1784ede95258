"""netCDF files of extinction and of measurements.

xarray and the netCDF library are imported where they are used: importing this package is fast.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files import written_whole
from cloudtomo_cl.grid import Grid
from cloudtomo_cl.measurements import Measurements
from cloudtomo_cl.memory import require
from cloudtomo_cl.sensors import RayView, View

if TYPE_CHECKING:
    import xarray as xr

CONVENTIONS = "CF-1.10"
AXES = ("x", "y", "z")
# Kilometres in one unit of length.
LENGTH_UNITS = {
    **dict.fromkeys(("km", "kilometer", "kilometers", "kilometre", "kilometres"), 1.0),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1e-3),
}
# km^-1 in one unit of extinction.
EXTINCTION_UNITS = {
    **dict.fromkeys(("km-1", "km^-1", "km**-1", "1/km"), 1.0),
    **dict.fromkeys(("m-1", "m^-1", "m**-1", "1/m"), 1e3),
}
# Coordinates may lie this far from a uniform spacing, in voxels: single precision passes.
UNIFORM_TOLERANCE = 1e-3
RADIANCE_UNITS = "W m-2 sr-1"
# What describes a view: field, dimensions beside "view", unit, long name.
VIEW_FIELDS: dict[str, tuple[tuple[str, ...], str, str]] = {
    "position": (("axis",), "km", "position of the sensor"),
    "target": (("axis",), "km", "point that the image's centre looks at"),
    "up": (("axis",), "1", "direction that is up in the image"),
    "field_of_view": ((), "degree", "full field of view across the width of a perspective or push-broom image"),
    "width": ((), "km", "width of an orthographic image, measured across the rays"),
    "zenith": ((), "degree", "zenith angle of the direction from the scene to the sensor"),
    "azimuth": ((), "degree", "azimuth of the direction from the scene to the sensor, from +x towards +y"),
    "aspect": ((), "1", "height of the image over its width, across the line of sight"),
    "start": (("axis",), "km", "start of the flight track of a push-broom image, at its bottom"),
    "end": (("axis",), "km", "end of the flight track of a push-broom image, at its top"),
    "along_track_angle": ((), "degree", "angle from nadir of a push-broom scanner's look, positive ahead"),
}
# Only in files whose views have them.
OPTIONAL_VIEW_FIELDS = ("aspect", "start", "end", "along_track_angle")
# Rays of the views that are lists of rays, one after the other.
RAY_FIELDS = {
    "ray_origin": ("origins", "km", "origin of a pixel's ray"),
    "ray_direction": ("directions", "1", "direction in which a pixel looks, a unit vector"),
}


def is_netcdf(path: Path) -> bool:
    """By the first bytes; what cannot be read is no netCDF file."""
    try:
        with open(path, "rb") as file:
            return file.read(4) in (b"\x89HDF", b"CDF\x01", b"CDF\x02", b"CDF\x05")
    except OSError:
        return False


def load_dataset(path: str | os.PathLike[str]) -> xr.Dataset:
    """The whole file in memory.

    Raises
    ------
    DataError : no such file, not netCDF, or cut short
    """
    import xarray as xr

    if not Path(path).is_file():
        raise DataError(f"{path}: no such file")
    try:
        # Times and other CF encodings that a foreign file may have are none of our business.
        with xr.open_dataset(path, engine="netcdf4", decode_times=False) as dataset:
            # Compressed, a small file may hold gigabytes.
            require(2 * dataset.nbytes, f"{path}: reading it", "crop or coarsen it")
            loaded = dataset.load()
        _check_classic(path)
        return loaded
    except (DataError, MemoryError):
        raise
    except Exception as error:  # what a damaged file may raise has no end
        text = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise DataError(
            f"{path}: not a netCDF file, or damaged or cut short ({text}): check or copy it again; "
            f"clouds in other formats become netCDF by `cloudtomo cloud FILE --output cloud.nc`"
        ) from None


def _check_classic(path: str | os.PathLike[str]) -> None:
    """Raises ValueError if a file in the classic format ends too early.

    The netCDF library reads zeros where such a file was cut off; SciPy's reader notices.
    """
    with open(path, "rb") as file:
        if file.read(4) not in (b"CDF\x01", b"CDF\x02"):
            return
    from scipy.io import netcdf_file

    netcdf_file(path, mmap=False).close()


def check_output(path: Path, overwrite: bool) -> None:
    """Fails before the work, not after it.

    Raises
    ------
    DataError : a folder, in no folder, or there already and not to be replaced
    """
    if path.is_dir() or not path.parent.is_dir():
        raise DataError(f"{path}: is a folder, or in a folder that does not exist: choose another --output")
    if path.exists() and not overwrite:
        raise DataError(f"{path}: exists already: choose another --output, or add --overwrite")


def save_dataset(path: str | os.PathLike[str], dataset: xr.Dataset) -> None:
    """Writes all or nothing: a file of that name is either whole or as it was before."""
    encoding = {
        name: {"zlib": True, "complevel": 4}
        for name, variable in dataset.data_vars.items()
        if variable.ndim and variable.dtype.kind == "f"
    }
    for name in dataset.variables:
        encoding.setdefault(name, {})
        if name not in ("radiance", "radiance_standard_error", "effective_radius"):
            encoding[name]["_FillValue"] = None
    with written_whole(path) as partial:
        try:
            dataset.to_netcdf(partial, engine="netcdf4", format="NETCDF4", encoding=encoding)
        except RuntimeError as error:  # how the netCDF library says that a disk is full
            raise OSError(str(error)) from None


def _variable(path: Any, dataset: xr.Dataset, name: str, dims: tuple[str, ...]) -> xr.DataArray:
    """A numeric variable with these dimensions, in this order, in double precision."""
    if name not in dataset.variables:
        found = ", ".join(sorted(str(other) for other in dataset.variables)) or "none"
        raise DataError(f"{path}: no variable {name}({', '.join(dims)}); the file has {found}")
    variable = dataset[name]
    if set(variable.dims) != set(dims):
        raise DataError(
            f"{path}: {name} has dimensions ({', '.join(map(str, variable.dims))}), "
            f"it must have ({', '.join(dims)}) in any order"
        )
    if variable.dtype.kind not in "fiu":
        raise DataError(f"{path}: {name} has type {variable.dtype}, it must hold numbers")
    return variable.transpose(*dims)


def _unit(path: Any, variable: xr.DataArray, units: Mapping[str, float], default: str) -> float:
    """The factor to our unit; a variable without units is taken to be in it already."""
    name = str(variable.attrs.get("units", default)).strip()
    if name not in units:
        raise DataError(f"{path}: {variable.name} has units '{name}', allowed are {', '.join(units)}")
    return units[name]


def _axis(path: Any, dataset: xr.Dataset, name: str) -> tuple[float, float]:
    """Spacing and lower end of an axis of voxel centres, km."""
    variable = _variable(path, dataset, name, (name,))
    unit = _unit(path, variable, LENGTH_UNITS, "km")
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


def read_extinction(path: str | os.PathLike[str]) -> tuple[Grid, np.ndarray]:
    """Reads extinction(x, y, z) from a netCDF file.

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
    dataset = load_dataset(path)
    variable = _variable(path, dataset, "extinction", AXES)
    spacing, origin = zip(*(_axis(path, dataset, name) for name in AXES))
    values = variable.values.astype(np.float64) * _unit(path, variable, EXTINCTION_UNITS, "km-1")
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


def read_effective_radius(path: str | os.PathLike[str]) -> np.ndarray | None:
    """effective_radius(x, y, z) of a cloud's file, micrometres, NaN where it has no cloud; None if it has none.

    Raises
    ------
    DataError : other dimensions or units
    """
    dataset = load_dataset(path)
    if "effective_radius" not in dataset:
        return None
    variable = _variable(path, dataset, "effective_radius", AXES)
    factor = _unit(path, variable, {"um": 1.0, "micrometer": 1.0, "micron": 1.0, "m": 1e6}, "um")
    return np.ascontiguousarray(variable.to_numpy() * factor, np.float32)


def write_extinction(
    path: str | os.PathLike[str],
    grid: Grid,
    extinction: np.ndarray,
    attributes: Mapping[str, Any] | None = None,
    effective_radius: np.ndarray | None = None,
) -> None:
    """Writes extinction(x, y, z) with its voxel centres, after the CF conventions.

    Parameters
    ----------
    path : of the file; it is replaced whole or not at all
    grid : of the domain
    extinction : km^-1, shape of the grid; stored in single precision
    attributes : of the file, text or numbers; mappings are stored as JSON
    effective_radius : of the droplets, micrometres, same shape, NaN where there is no cloud

    Raises
    ------
    DataError : extinction of another shape or not finite; the file cannot be written
    """
    import xarray as xr

    variables, coordinates = _extinction_variables(path, grid, extinction, effective_radius)
    save_dataset(path, xr.Dataset(variables, coordinates, _attributes(attributes)))


def _extinction_variables(
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
        coordinates[f"{name}_bounds"] = ((name, "bound"), np.column_stack([centres - half, centres + half]))
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


def write_measurements(
    path: str | os.PathLike[str],
    measurements: Measurements,
    attributes: Mapping[str, Any] | None = None,
    settings: Mapping[str, Any] | None = None,
    cloud: tuple[Grid, np.ndarray, np.ndarray | None] | None = None,
) -> None:
    """Writes images with the views that they were taken from.

    Variables: `radiance` and `radiance_standard_error` (view, row, column), W m-2 sr-1, padded
    with NaN to the largest image, with `image_height` and `image_width` (view); `view_type`
    and every field of the views (view) or (view, axis), NaN where a view has no such field. Views
    that are lists of rays have `ray_origin` and `ray_direction` (ray, axis), the rays of all of
    them one after the other.

    Parameters
    ----------
    path : of the file; it is replaced whole or not at all
    measurements : images and views
    attributes : of the file, text or numbers; mappings are stored as JSON
    settings : of the run that made the images, stored as the JSON attribute `settings`
    cloud : grid, extinction (km^-1) and effective radius (um, or None) to keep beside the images: what they
        were rendered from, or what was recovered from them

    Raises
    ------
    DataError : the file cannot be written; as `write_extinction`
    """
    import xarray as xr

    views = measurements.views
    if not views:
        raise DataError(f"{path}: there is no view to write")
    rows = max(view.pixels[1] for view in views)
    columns = max(view.pixels[0] for view in views)
    radiance = np.full((2, len(views), rows, columns), np.nan)
    for kind, arrays in enumerate((measurements.images, measurements.standard_errors)):
        for index, array in enumerate(arrays):
            radiance[kind, index, : array.shape[0], : array.shape[1]] = array
    dims = ("view", "row", "column")
    counts = {"height": [view.pixels[1] for view in views], "width": [view.pixels[0] for view in views]}
    variables: dict[str, Any] = {
        "radiance": (dims, radiance[0], {"units": RADIANCE_UNITS, "long_name": "mean radiance of a pixel"}),
        "radiance_standard_error": (
            dims,
            radiance[1],
            {"units": RADIANCE_UNITS, "long_name": "standard error of the radiance, 0 where unknown"},
        ),
        "image_height": ("view", counts["height"], {"units": "1", "long_name": "rows of the image"}),
        "image_width": ("view", counts["width"], {"units": "1", "long_name": "columns of the image"}),
        "view_type": ("view", np.array([view.type for view in views], dtype=object), {"long_name": "projection"}),
    }
    for name, (extra, unit, long_name) in VIEW_FIELDS.items():
        missing = (np.nan,) * 3 if extra else np.nan
        fields = [getattr(view, name, None) for view in views]
        if name in OPTIONAL_VIEW_FIELDS and not any(value is not None for value in fields):
            continue
        values = np.array([missing if value is None else value for value in fields], dtype=np.float64)
        variables[name] = (("view", *extra), values, {"units": unit, "long_name": long_name})
    lists = [view for view in views if isinstance(view, RayView)]
    if lists:
        variables.update(_ray_variables(lists))
    coordinates: dict[str, Any] = {"axis": ("axis", np.array(AXES, dtype=object))}
    for name, count in (("view", len(views)), ("row", rows), ("column", columns)):
        coordinates[name] = (name, np.arange(count, dtype=np.int32), {"units": "1", "long_name": f"{name}, from 0"})
    if cloud is not None:
        of_cloud = _extinction_variables(path, *cloud)
        variables.update(of_cloud[0])
        coordinates.update(of_cloud[1])
    described = _attributes(attributes)
    if settings is not None:
        described["settings"] = json.dumps(settings, indent=1)
    save_dataset(path, xr.Dataset(variables, coordinates, described))


def read_measurements(path: str | os.PathLike[str]) -> Measurements:
    """Reads what `write_measurements` wrote: the same images, the same views.

    Raises
    ------
    DataError : no such file, not netCDF, cut short; missing variables, other dimensions or
        units; images that are not finite; views that are not possible
    """
    dataset = load_dataset(path)
    dims = ("view", "row", "column")
    radiance = _variable(path, dataset, "radiance", dims)
    error = _variable(path, dataset, "radiance_standard_error", dims)
    for variable in (radiance, error):
        _unit(path, variable, {RADIANCE_UNITS: 1.0}, RADIANCE_UNITS)
    heights = _variable(path, dataset, "image_height", ("view",)).values
    widths = _variable(path, dataset, "image_width", ("view",)).values
    for name, values, largest in (
        ("image_height", heights, radiance.shape[1]),
        ("image_width", widths, radiance.shape[2]),
    ):
        if not ((values >= 1) & (values <= largest) & (values % 1 == 0)).all():
            raise DataError(f"{path}: {name} is {values.tolist()}: each must be a whole number from 1 to {largest}")
    for index, (height, width) in enumerate(zip(heights, widths)):
        beyond = ~np.isnan(radiance.values[index])
        beyond[: int(height), : int(width)] = False
        if beyond.any():
            row, column = np.argwhere(beyond)[0]
            raise DataError(
                f"{path}: view {index} has {int(width)} x {int(height)} pixels by image_width and image_height, "
                f"but a radiance at row {row}, column {column}: correct them, or set what lies beyond to NaN"
            )
    views = _views(path, dataset, heights, widths)
    shapes = [(slice(0, int(height)), slice(0, int(width))) for height, width in zip(heights, widths)]
    try:
        return Measurements(
            views,
            tuple(image[shape].astype(np.float64) for image, shape in zip(radiance.values, shapes)),
            tuple(image[shape].astype(np.float64) for image, shape in zip(error.values, shapes)),
        )
    except DataError as wrong:
        raise DataError(f"{path}: {wrong}") from None


def read_settings(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The settings that were written with a file of measurements.

    Raises
    ------
    DataError : no such file, not netCDF; no attribute `settings`, or it is not a JSON table
    """
    text = load_dataset(path).attrs.get("settings")
    if text is None:
        raise DataError(f"{path}: no attribute settings: the file was written without them")
    try:
        settings = json.loads(text)
    except (TypeError, ValueError, RecursionError):
        settings = None
    if not isinstance(settings, dict):
        raise DataError(f"{path}: the attribute settings is not a JSON table")
    return settings


def _ray_variables(views: Sequence[RayView]) -> dict[str, Any]:
    return {
        name: (
            ("ray", "axis"),
            np.concatenate([getattr(view, field) for view in views]),
            {"units": unit, "long_name": long_name},
        )
        for name, (field, unit, long_name) in RAY_FIELDS.items()
    }


def write_rays(path: str | os.PathLike[str], view: RayView) -> None:
    """Writes the rays of a view as `origin` and `direction` (ray, axis): see `read_rays`.

    Raises
    ------
    DataError : the file cannot be written
    """
    import xarray as xr

    variables = {name.removeprefix("ray_"): variable for name, variable in _ray_variables([view]).items()}
    width, height = view.pixels
    sizes = {"image_width": width, "image_height": height}
    save_dataset(path, xr.Dataset(variables, {"axis": ("axis", np.array(AXES, dtype=object))}, _attributes(sizes)))


def read_rays(path: str | os.PathLike[str]) -> RayView:
    """Reads a view that is a list of rays.

    Variables: `origin` (ray, axis) in km (also if no unit is given) or m, `direction` (ray, axis) of
    any length, with three numbers x, y, z along `axis`. The file's attributes `image_width` and
    `image_height`, if there, give the pixels; otherwise there is one row.

    Raises
    ------
    DataError : no such file, not netCDF; missing variables, other dimensions or units, rays that
        are not possible
    """
    dataset = load_dataset(path)
    dims = ("ray", "axis")
    origin, direction = (_variable(path, dataset, name, dims) for name in ("origin", "direction"))
    fields: dict[str, Any] = {
        "origins": origin.values.astype(np.float64) * _unit(path, origin, LENGTH_UNITS, "km"),
        "directions": direction.values,
    }
    if "image_width" in dataset.attrs:
        fields["pixels"] = tuple(np.ravel(dataset.attrs.get(name, 1))[0] for name in ("image_width", "image_height"))
    try:
        return RayView(**fields)
    except ValidationError as error:
        raise DataError(f"{path}: rays are not possible: {_first_error(error)}") from None


def _first_error(error: ValidationError) -> str:
    first = error.errors()[0]
    where = ".".join(map(str, first["loc"]))
    return f"{where}: {first['msg']}" if where else str(first["msg"])


def _views(path: Any, dataset: xr.Dataset, heights: np.ndarray, widths: np.ndarray) -> tuple[View, ...]:
    """The views from their fields; a field that is NaN was not given."""
    if "view_type" not in dataset.variables or dataset["view_type"].dims != ("view",):
        raise DataError(f"{path}: no variable view_type(view)")
    fields = {
        name: _variable(path, dataset, name, ("view", *extra)).values
        for name, (extra, _, _) in VIEW_FIELDS.items()
        if name not in OPTIONAL_VIEW_FIELDS or name in dataset.variables
    }
    kinds = dataset["view_type"].values
    first_ray, rays = 0, {}
    if "rays" in kinds:
        rays = {
            field: _variable(path, dataset, name, ("ray", "axis")).values
            for name, (field, _, _) in RAY_FIELDS.items()
        }
    adapter: TypeAdapter[Any] = TypeAdapter(View)
    views = []
    for index, kind in enumerate(kinds):
        table: dict[str, Any] = {"type": str(kind), "pixels": (int(widths[index]), int(heights[index]))}
        for name, values in fields.items():
            if not np.isnan(values[index]).all():
                table[name] = values[index].tolist()
        if kind == "rays":
            count = int(widths[index]) * int(heights[index])
            table.update({field: values[first_ray : first_ray + count] for field, values in rays.items()})
            first_ray += count
        try:
            views.append(adapter.validate_python(table))
        except ValidationError as error:
            raise DataError(f"{path}: view {index} is not possible: {_first_error(error)}") from None
    return tuple(views)


def _attributes(attributes: Mapping[str, Any] | None) -> dict[str, Any]:
    """Attributes as netCDF holds them."""
    described: dict[str, Any] = {"Conventions": CONVENTIONS}
    for name, value in (attributes or {}).items():
        described[name] = json.dumps(value) if isinstance(value, Mapping) else value
    return described
