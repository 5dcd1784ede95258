"""netCDF files of measurements: images and the views that they were taken from; lists of rays."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from cloudtomo_cl.arguments import MAPPING, PATH, Kind, a, many, require_kinds
from cloudtomo_cl.errors import DataError, InvalidSettingError
from cloudtomo_cl.files.axes import components_in_order, in_order
from cloudtomo_cl.files.extinction import extinction_variables
from cloudtomo_cl.files.missing import undeclared_fill
from cloudtomo_cl.files.netcdf import (
    Source,
    as_json,
    component_coordinate,
    factor_of,
    file_attributes,
    load_dataset,
    name_of,
    number_variable,
    save_dataset,
    unit_factor,
)
from cloudtomo_cl.files.units import NUMBER, parse_unit
from cloudtomo_cl.files.wavelengths import WAVELENGTH, at_wavelength, stacked, wavelength_coordinate, wavelengths_of
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.measurements import BEYOND_RADIANCES, Measurements
from cloudtomo_cl.scene.sensors import RayView, View

if TYPE_CHECKING:
    import xarray as xr

RADIANCE_UNITS = "W m-2 sr-1"
_CLOUD = Kind(
    "a tuple of grid, extinction, and effective radius or None", lambda c: isinstance(c, tuple) and len(c) == 3
)
# A radiance below zero by more standard errors than this is no noise.
_MOST_BELOW_ZERO = 8.0
# What a variable `valid` may say of its flags 0 and 1.
_GOOD_WORDS, _BAD_WORDS = ("valid", "good", "true", "yes", "ok"), ("invalid", "bad", "false", "no", "not_valid")
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
# Standard errors, each common to all pixels of a view: field of `Measurements`, unit, long name.
ERRORS_OF_VIEWS = {
    "calibration_error": ("calibration_errors", "1", "standard error of a view's gain"),
    "pointing_error": ("pointing_errors", "degree", "standard error of a camera's direction and its image's rotation"),
    "position_error": ("position_errors", "km", "standard error of a camera's place, or of an orthographic image's"),
}
# Of lengths and angles without units, the largest that are taken as km and the smallest as degrees: heights and
# distances of kilometres, angles that in radians are no directions. What else they are, somebody must say.
_LARGEST_GUESSED, _SMALLEST_GUESSED = 100.0, 2 * np.pi
# Of radiances and errors without units, the largest typical error that is taken to be in the radiances' unit, in these.
_LARGEST_GUESSED_ERROR = 2.0
# Numbers that no key of a view has, by which programs mark that there is none.
_MARKS = (-999.0, -999.9, -9999.0, -9999.9, -99999.0, -32767.0, -32768.0)
# Only in files whose views have them.
OPTIONAL_VIEW_FIELDS = ("aspect", "start", "end", "along_track_angle")
# Rays of the views that are lists of rays, one after the other.
RAY_FIELDS = {
    "ray_origin": ("origins", "km", "origin of a pixel's ray"),
    "ray_direction": ("directions", "1", "direction in which a pixel looks, a unit vector"),
}


def write_measurements(
    path: str | os.PathLike[str],
    measurements: Measurements | Sequence[Measurements],
    attributes: Mapping[str, Any] | None = None,
    settings: Mapping[str, Any] | None = None,
    cloud: tuple[Grid, Any, np.ndarray | None] | None = None,
) -> None:
    """Writes `measurements_dataset` into a netCDF file.

    Parameters
    ----------
    path : of the file; it is replaced whole or not at all
    measurements, attributes, settings, cloud : see `measurements_dataset`

    Raises
    ------
    DataError : the file cannot be written; as `measurements_dataset`
    """
    save_dataset(path, measurements_dataset(measurements, attributes, settings, cloud, name_of(path)))


def measurements_dataset(
    measurements: Measurements | Sequence[Measurements],
    attributes: Mapping[str, Any] | None = None,
    settings: Mapping[str, Any] | None = None,
    cloud: tuple[Grid, Any, np.ndarray | None] | None = None,
    name: str = "the dataset",
) -> xr.Dataset:
    """Images with the views that they were taken from.

    Variables: `radiance` and `radiance_standard_error` (view, row, column), W m-2 sr-1, padded
    with NaN to the largest image, and NaN in invalid pixels, with `image_height` and `image_width` (view); `view_type`
    and every field of the views (view) or (view, axis), NaN where a view has no such field. Views
    that are lists of rays have `ray_origin` and `ray_direction` (ray, axis), the rays of all of
    them one after the other. A coordinate `wavelength` (nm) where it is known; of several, the radiances and the
    extinction have a dimension of it, the first.

    Parameters
    ----------
    measurements : images and views; several, of the same views, go into one file by their wavelengths
    attributes : text or numbers; mappings are stored as JSON
    settings : of the run that made the images, stored as the JSON attribute `settings`; with several wavelengths
        `scenes` is a list of as many
    cloud : grid, extinction (km^-1; one for each wavelength) and effective radius (um, or None) to keep beside the
        images: what they were rendered from, or what was recovered from them
    name : what errors call it

    Raises
    ------
    DataError : no view; images without a wavelength, of wavelengths that do not increase, or of other views beside
        others; as `extinction_dataset`, also where an argument is of another kind (InvalidArgumentError)
    """
    require_kinds(name, measurements=(measurements, a(Measurements).or_(many(Measurements))))
    require_kinds(name, settings=(settings, MAPPING.or_none()), cloud=(cloud, _CLOUD.or_none()))
    if isinstance(measurements, Measurements):
        return _dataset(measurements, attributes, settings, cloud, name)
    if not len(measurements):
        raise DataError(f"{name}: there are no images to write")
    first = measurements[0]
    if any(_of_views(one) != _of_views(first) for one in measurements):
        raise DataError(f"{name}: images of several wavelengths in one file must have the same views")
    datasets = [
        _dataset(one, attributes, settings, None if cloud is None else (cloud[0], cloud[1][n], cloud[2]), name)
        for n, one in enumerate(measurements)
    ]
    changing = ("radiance", "radiance_standard_error", "extinction")
    return stacked(name, datasets, [one.wavelength for one in measurements], changing)


def _dataset(
    measurements: Measurements,
    attributes: Mapping[str, Any] | None,
    settings: Mapping[str, Any] | None,
    cloud: tuple[Grid, np.ndarray, np.ndarray | None] | None,
    name: str,
) -> xr.Dataset:
    """Of one wavelength."""
    import xarray as xr

    views = measurements.views
    if not views:
        raise DataError(f"{name}: there is no view to write")
    rows = max(view.pixels[1] for view in views)
    columns = max(view.pixels[0] for view in views)
    radiance = np.full((2, len(views), rows, columns), np.nan)
    for kind, arrays in enumerate((measurements.images, measurements.standard_errors)):
        for index, array in enumerate(arrays):
            radiance[kind, index, : array.shape[0], : array.shape[1]] = array
    dims = ("view", "row", "column")
    types = [view.type for view in views]
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
        "view_type": ("view", np.array(types, dtype=object), {"units": "1", "long_name": "projection"}),
    }
    for key, (extra, unit, long_name) in VIEW_FIELDS.items():
        missing = (np.nan,) * 3 if extra else np.nan
        fields = [getattr(view, key, None) for view in views]
        if key in OPTIONAL_VIEW_FIELDS and not any(value is not None for value in fields):
            continue
        values = np.array([missing if value is None else value for value in fields], dtype=np.float64)
        variables[key] = (("view", *extra), values, {"units": unit, "long_name": long_name})
    lists = [view for view in views if isinstance(view, RayView)]
    if lists:
        variables.update(_ray_variables(lists))
    coordinates: dict[str, Any] = {"component": component_coordinate()}
    for key, count in (("view", len(views)), ("row", rows), ("column", columns)):
        coordinates[key] = (key, np.arange(count, dtype=np.int32), {"units": "1", "long_name": f"{key}, from 0"})
    if measurements.wavelength is not None:
        coordinates[WAVELENGTH] = wavelength_coordinate(measurements.wavelength)
    for name_of_error, (field, unit, long_name) in ERRORS_OF_VIEWS.items():
        if any(getattr(measurements, field)):
            described = {"units": unit, "long_name": f"{long_name}, common to all of its pixels"}
            variables[name_of_error] = ("view", np.array(getattr(measurements, field), float), described)
    if cloud is not None:
        of_cloud = extinction_variables(name, *cloud)
        variables.update(of_cloud[0])
        coordinates.update(of_cloud[1])
    described = file_attributes("images of a cloud, and the views that they were taken from", attributes)
    if settings is not None:
        described["settings"] = as_json("settings", settings, 1)
    return xr.Dataset(variables, coordinates, described)


def read_measurements(source: Source, wavelength: float | None = None) -> Measurements:
    """Reads what `write_measurements` wrote, or `measurements_dataset` made: the same images, the same views.

    Pixels are bad whose radiance is missing (NaN, masked, a fill value, outside of its valid range), or where a
    variable `valid` (view, row, column), which a file may have, is 0 or missing. Others that it may have are standard
    errors of views: `calibration_error` (view), relative, `pointing_error` and `position_error` (view), with units.
    Units are converted; coordinates `row`, `column` and `axis` say in which order these come.

    Parameters
    ----------
    source : a file, or a dataset
    wavelength : nm, which images, where the file holds those of several

    Raises
    ------
    DataError : no such file, not netCDF, cut short; several wavelengths of which none is chosen, or not this one;
        missing variables, other dimensions or units; images that are infinite, far below zero, or bad in all pixels;
        views that are not possible
    """
    path = name_of(source)
    dataset = at_wavelength(path, load_dataset(source), wavelength)
    for dimension in ("row", "column"):
        dataset = in_order(path, dataset, dimension)
    dataset = components_in_order(path, dataset)
    dims = ("view", "row", "column")
    radiance, error = (_radiances(path, dataset, name) for name in ("radiance", "radiance_standard_error"))
    _require_units_of_both(path, dataset)
    if "valid" in dataset.variables:
        if dataset["valid"].dtype.kind == "b":
            dataset = dataset.assign(valid=dataset["valid"].astype(np.int8))
        radiance = radiance.where(_valid(path, number_variable(path, dataset, "valid", dims)))
    heights = number_variable(path, dataset, "image_height", ("view",)).values
    widths = number_variable(path, dataset, "image_width", ("view",)).values
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
    _refuse_unlikely(path, radiance.values, error.values)
    shapes = [(slice(0, int(height)), slice(0, int(width))) for height, width in zip(heights, widths)]
    try:
        return Measurements(
            views,
            tuple(image[shape].astype(np.float64) for image, shape in zip(radiance.values, shapes)),
            tuple(image[shape].astype(np.float64) for image, shape in zip(error.values, shapes)),
            wavelength=next(iter(wavelengths_of(path, dataset)), None),
            **_errors_of_views(path, dataset),
        )
    except DataError as wrong:
        raise DataError(f"{path}: {wrong}") from None


def _of_views(measurements: Measurements) -> tuple[Any, ...]:
    """The views, and what is known of them as wholes."""
    return measurements.views, *(getattr(measurements, field) for field, *_ in ERRORS_OF_VIEWS.values())


def _errors_of_views(path: Any, dataset: xr.Dataset) -> dict[str, tuple[float, ...]]:
    """The standard errors that are common to views' pixels, by the fields of `Measurements`."""
    errors = {}
    for name, (field, unit, _) in ERRORS_OF_VIEWS.items():
        if name not in dataset.variables:
            continue
        variable = number_variable(path, dataset, name, ("view",))
        if unit != "1" and "units" not in variable.attrs:
            raise DataError(f"{path}: {name} has no units: set its attribute units, for instance to {unit}")
        values = variable.values.astype(np.float64) * unit_factor(path, variable, unit)
        errors[field] = tuple(map(float, values))
    return errors


def _radiances(path: Any, dataset: xr.Dataset, name: str) -> xr.DataArray:
    """Radiances, or their errors, in our unit and double precision."""
    variable = number_variable(path, dataset, name, ("view", "row", "column"))
    unit = parse_unit(variable.attrs.get("units"))
    if unit is not None and unit.dimension == NUMBER:
        raise DataError(
            f"{path}: {name} has units '{variable.attrs['units']}', allowed are {RADIANCE_UNITS} and what converts to "
            f"it: a reflectance factor R is the radiance R mu0 F0 / pi"
        )
    return variable.astype(np.float64) * unit_factor(path, variable, RADIANCE_UNITS)


def _require_units_of_both(path: Any, dataset: xr.Dataset) -> None:
    """Refuses radiances with units beside errors without any, and the reverse: the absent ones may be others."""
    names = ("radiance", "radiance_standard_error")
    stated = [factor_of(path, name, dataset[name].attrs.get("units"), RADIANCE_UNITS)[1] for name in names]
    if stated[0] != stated[1]:
        without, other = names[stated.index(False)], names[stated.index(True)]
        units = dataset[other].attrs["units"]
        raise DataError(f"{path}: {without} has no units, and {other} is in '{units}': set its attribute units")
    values, errors = (np.abs(dataset[name].values.astype(np.float64)) for name in names)
    values, errors = values[np.isfinite(values)], errors[np.isfinite(errors)]
    guessed = not any(stated) and values.size > 0 and errors.size > 0
    if guessed and np.median(errors) > _LARGEST_GUESSED_ERROR * np.median(values):
        raise DataError(
            f"{path}: radiance and radiance_standard_error have no units, and the errors are larger than the "
            f"radiances: set their attributes units"
        )


def _valid(path: Any, flags: xr.DataArray) -> xr.DataArray:
    """Which pixels a variable `valid` calls good: those where it is 1."""
    values = flags.values
    known = ~np.isnan(values) if values.dtype.kind == "f" else np.ones(values.shape, bool)
    if not np.isin(values[known], (0, 1)).all():
        other = values[known][~np.isin(values[known], (0, 1))][0]
        raise DataError(f"{path}: valid holds {other:g}: it must be 1 in good pixels and 0 in bad ones")
    meanings = str(flags.attrs.get("flag_meanings", "")).lower().split()
    numbers = np.ravel(flags.attrs.get("flag_values", (0, 1))).tolist()
    for number, meaning in zip(numbers, meanings):
        if meaning in (_GOOD_WORDS if number == 0 else _BAD_WORDS):
            raise DataError(f"{path}: valid calls {number} '{meaning}' in flag_meanings: it must be 1 in good pixels")
    return flags == 1


def _refuse_unlikely(path: Any, radiance: np.ndarray, error: np.ndarray) -> None:
    """Refuses radiances that can only be a mark for invalid pixels which no attribute tells."""
    sigma = np.where(np.isfinite(error), error, 0.0)
    with np.errstate(invalid="ignore"):
        negative = (radiance < 0) & (radiance < -_MOST_BELOW_ZERO * sigma)
        # Cameras that tell no errors have noise, too: below zero by less than the mean radiance.
        if np.isfinite(radiance).any():
            negative &= (sigma > 0) | undeclared_fill(radiance) | (radiance < -np.nanmean(np.abs(radiance)))
    wrong = negative | (np.isfinite(radiance) & (np.abs(radiance) >= BEYOND_RADIANCES))
    if wrong.any():
        view, row, column = np.argwhere(wrong)[0]
        raise DataError(
            f"{path}: radiance of view {view} at row {row}, column {column} is {radiance[view, row, column]:g} (and "
            f"{int(wrong.sum()) - 1} more are like it), which is no noise: if it marks invalid pixels, set them to NaN "
            "or say so with the attribute _FillValue"
        )


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
    require_kinds("write_rays", path=(path, PATH), view=(view, a(RayView)))
    import xarray as xr

    variables = {name.removeprefix("ray_"): variable for name, variable in _ray_variables([view]).items()}
    width, height = view.pixels
    sizes = {"image_width": width, "image_height": height}
    save_dataset(
        path, xr.Dataset(variables, {"component": component_coordinate()}, file_attributes("rays of a sensor", sizes))
    )


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
    dataset = components_in_order(path, load_dataset(path))
    dims = ("ray", "axis")
    fields: dict[str, Any] = {
        "origins": _in_unit(path, dataset, "origin", dims, "km"),
        "directions": _in_unit(path, dataset, "direction", dims, "1"),
    }
    if "image_width" in dataset.attrs:
        fields["pixels"] = tuple(np.ravel(dataset.attrs.get(name, 1))[0] for name in ("image_width", "image_height"))
    try:
        return RayView(**fields)
    except InvalidSettingError as error:
        raise DataError(f"{path}: rays are not possible: {_first_error(error.details)}") from None


def _first_error(errors: Sequence[Any]) -> str:
    first = errors[0]
    where = ".".join(map(str, first["loc"]))
    return f"{where}: {first['msg']}" if where else str(first["msg"])


def _in_unit(path: Any, dataset: xr.Dataset, name: str, dims: tuple[str, ...], ours: str) -> np.ndarray:
    """A field of views in our unit, exactly as it is stored where it is in that unit.

    Raises
    ------
    DataError : the unit is of something else; or it is absent, and other fields state another, or the numbers may as
        well be in another
    """
    variable = number_variable(path, dataset, name, dims)
    values = variable.values.astype(np.float64)
    factor, stated = factor_of(path, name, variable.attrs.get("units"), ours)
    # One coordinate of a place may be -999 m; all three are not.
    marks = np.isin(values, _MARKS)
    marks = marks.all(axis=-1, keepdims=True) & marks if marks.ndim == 2 else marks
    marks |= np.abs(values) >= BEYOND_RADIANCES
    if marks.any():
        raise DataError(f"{path}: {name} has {values[marks][0]:g}: if that means missing, say so with _FillValue")
    if not stated and ours in ("km", "degree") and np.isfinite(values).any():
        largest = float(np.nanmax(np.abs(values)))
        others = [other for other in (*VIEW_FIELDS, *RAY_FIELDS) if _states_another(path, dataset, other, ours)]
        small = ours == "degree" and 0 < largest <= _SMALLEST_GUESSED
        if others or small or (ours == "km" and largest > _LARGEST_GUESSED):
            why = f"{others[0]} has others than {ours}" if others else f"its largest number is {largest:g}"
            raise DataError(f"{path}: {name} has no units, and {why}: set its attribute units, for instance to {ours}")
    return values if factor == 1.0 else values * factor


def _states_another(path: Any, dataset: xr.Dataset, name: str, ours: str) -> bool:
    """Whether a field of a file is in another unit of the same kind."""
    if name not in dataset.variables:
        return False
    unit, wanted = parse_unit(dataset[name].attrs.get("units")), parse_unit(ours)
    assert wanted is not None
    return unit is not None and unit.dimension == wanted.dimension and unit != wanted


def _names_of_views(path: Any, dataset: xr.Dataset) -> list[str]:
    """What kind each view is, also where a file has characters without an encoding."""
    if "view_type" not in dataset.variables or dataset["view_type"].dims != ("view",):
        raise DataError(f"{path}: no variable view_type(view)")
    kinds = [
        kind.decode("utf-8", "replace") if isinstance(kind, bytes) else kind for kind in dataset["view_type"].values
    ]
    return [str(kind).strip(" \0") for kind in kinds]


def _views(path: Any, dataset: xr.Dataset, heights: np.ndarray, widths: np.ndarray) -> tuple[View, ...]:
    """The views from their fields; a field that is NaN was not given."""
    kinds = _names_of_views(path, dataset)
    fields = {
        name: _in_unit(path, dataset, name, ("view", *extra), unit)
        for name, (extra, unit, _) in VIEW_FIELDS.items()
        if name not in OPTIONAL_VIEW_FIELDS or name in dataset.variables
    }
    first_ray, rays = 0, {}
    if "rays" in kinds:
        rays = {
            field: _in_unit(path, dataset, name, ("ray", "axis"), unit) for name, (field, unit, _) in RAY_FIELDS.items()
        }
        wanted = sum(int(width) * int(height) for kind, width, height in zip(kinds, widths, heights) if kind == "rays")
        if wanted != dataset.sizes["ray"]:
            raise DataError(f"{path}: has {dataset.sizes['ray']} rays for {wanted} pixels of the views of type rays")
    adapter: TypeAdapter[Any] = TypeAdapter(View)
    views = []
    for index, kind in enumerate(kinds):
        table: dict[str, Any] = {"type": str(kind), "pixels": (int(widths[index]), int(heights[index]))}
        for name, values in fields.items():
            missing = np.isnan(values[index])
            if missing.any() and not missing.all():
                raise DataError(f"{path}: {name} of view {index} is missing in part: give all of its numbers, or none")
            if not missing.any():
                table[name] = values[index].tolist()
        if kind == "rays":
            count = int(widths[index]) * int(heights[index])
            table.update({field: values[first_ray : first_ray + count] for field, values in rays.items()})
            first_ray += count
        try:
            views.append(adapter.validate_python(table))
        except ValidationError as error:
            raise DataError(f"{path}: view {index} is not possible: {_first_error(error.errors())}") from None
    return tuple(views)
