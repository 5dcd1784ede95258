"""Axes of files: which dimension is x, y, z or time, and where its voxels lie, in km and rising.

One reader for clouds, extinction and images. Attributes decide (`axis`, `standard_name`, `positive`, `units`,
`bounds`), names only where there are none. An axis that falls is turned; a vertical one that is no height (pressure,
terrain-following or numbered levels, depth) is refused with the attribute named, and so are latitude and longitude.
(cf_xarray finds axes by the same attributes; it neither turns nor converts nor refuses, so it would replace the first
thirty lines here and bring a dependency.)
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.units import ANGLE, LENGTH, PRESSURE, parse_unit

if TYPE_CHECKING:
    import xarray as xr

# Edges may lie this far from where they must, in voxels: single precision passes.
TOLERANCE = 1e-3
# Without units, coordinates are km if voxels then are no larger than this, and heights no higher: clouds are computed
# on voxels of some metres to some hundred, so that a larger step is one of metres, or counts levels.
_LARGEST_GUESSED_STEP, _HIGHEST_GUESSED = 0.5, 25.0

_NAMES = {
    "x": r"n?x([tmcfhu]|\d+|_.*|dim|axis|coord.*|cent.*|pos)?|west_east|lon|longitude|rlon|easting|ni",
    "y": r"n?y([tmcfhv]|\d+|_.*|dim|axis|coord.*|cent.*|pos)?|south_north|lat|latitude|rlat|northing|nj",
    "z": r"n?z([tmcfh]|[uw](_.*)?|\d+|_.*|dim|axis|coord.*|cent.*|pos)?|nk|height.*|altitude.*|alt|depth|"
    r"plev|pressure|sigma|eta|(bottom_top|top_bottom)(_stag)?|i?lev(els?)?|level_.*|model_level.*|layers?",
    "t": r"time.*|t|xtime|record|nt|date.*|ntime.*|tstep|step",
}
# Vertical names that without units may as well be of anything else: numbers, pressures, sigma.
_HEIGHTS = re.compile(r"n?z([tmcfh]|[uw](_.*)?|\d+|_.*|dim|axis|coord.*|cent.*|pos)?|height.*|altitude.*|alt")
_STANDARD_NAMES = {
    "x": r"projection_x_coordinate|grid_longitude|longitude|easting",
    "y": r"projection_y_coordinate|grid_latitude|latitude|northing",
    "z": r"height.*|altitude|geopotential_height|depth|air_pressure|model_level_number|atmosphere_.*coordinate",
    "t": r"time|forecast_.*",
}
_HEIGHT_STANDARD_NAMES = re.compile(r"height.*|altitude|geopotential_height")
_NUMBERS = re.compile(r"(model_|sigma_)?(levels?|layers?)|count|index|none|-|1|nodim|unitless|dimensionless", re.I)
_DEGREES = re.compile(r"degrees?_?([ewns]|east|west|north|south)", re.I)


@dataclass(frozen=True, eq=False)
class Axis:
    """Where the voxels along a dimension lie.

    Attributes
    ----------
    dimension : its name
    source : the variable that tells
    points, edges : km, rising, n and n + 1 of them
    falls : whether the file has them falling, so that values along it must be turned
    unit : as the file says it, or as it was taken to be
    stated : whether the file says it
    how : what else became of it, for people
    """

    dimension: str
    source: str
    points: np.ndarray
    edges: np.ndarray
    falls: bool
    unit: str
    stated: bool
    how: str = ""

    def text(self) -> str:
        """What was read, for people."""
        told = "stated" if self.stated else "guessed"
        rest = "".join(f", {word}" for word in (("turned: falls in the file",) if self.falls else ()))
        return f"{self.source}, {self.unit} ({told}), {self.points[0]:g} to {self.points[-1]:g} km{rest}{self.how}"


def _text(attributes: Any, name: str) -> str:
    value = attributes.get(name, "")
    return value.strip() if isinstance(value, str) else ""


def kind_of_dimension(dataset: xr.Dataset, dimension: str) -> str:
    """x, y, z or t; nothing for any other dimension."""
    attributes = dataset[dimension].attrs if dimension in dataset.variables else {}
    letter = _text(attributes, "axis").lower()
    if letter in _NAMES:
        return letter
    standard = _text(attributes, "standard_name").lower()
    for letter, pattern in _STANDARD_NAMES.items():
        if standard and re.fullmatch(pattern, standard):
            return letter
    units = _text(attributes, "units").lower()
    unit = parse_unit(attributes.get("units"))
    if " since " in units or (dimension in dataset.variables and dataset[dimension].dtype.kind == "M"):
        return "t"
    if re.fullmatch(r"degrees?_?(e|w|east|west)", units):
        return "x"
    if re.fullmatch(r"degrees?_?(n|s|north|south)", units):
        return "y"
    if _text(attributes, "positive") or (unit is not None and unit.dimension == PRESSURE):
        return "z"
    name = dimension.lower()
    return next((letter for letter, pattern in _NAMES.items() if re.fullmatch(pattern, name)), "")


def find_axes(path: Any, dataset: xr.Dataset, variable: xr.DataArray) -> dict[str, str]:
    """The dimensions of a variable along x, y and z.

    Raises
    ------
    DataError : not one dimension of each kind
    """
    found: dict[str, list[str]] = {"x": [], "y": [], "z": []}
    for dimension in map(str, variable.dims):
        letter = kind_of_dimension(dataset, dimension)
        if letter in found:
            found[letter].append(dimension)
    named = ", ".join(map(str, variable.dims))
    for letter, dimensions in found.items():
        if len(dimensions) > 1:
            raise DataError(
                f"{path}: {variable.name} has dimensions ({named}), of which {' and '.join(dimensions)} are both along "
                f"{letter}: give them the attribute axis"
            )
    if not all(found.values()):
        raise DataError(
            f"{path}: {variable.name} has dimensions ({named}), which are not known as x, y and z: rename them, or "
            f"give their coordinates the attribute axis"
        )
    return {letter: dimensions[0] for letter, dimensions in found.items()}


def read_axis(path: Any, dataset: xr.Dataset, dimension: str, letter: str, spacing: float | None = None) -> Axis:
    """Where the voxels along a dimension lie.

    Parameters
    ----------
    path : what errors call the file
    dataset : decoded (`missing.decode_all`)
    dimension : with or without a coordinate
    letter : x, y or z
    spacing : km, what the user says of it, for dimensions that tell nothing, or only numbers

    Raises
    ------
    DataError : no coordinate and no spacing, or both; another unit than of length, or none and none can be guessed;
        points that do not rise or fall; bounds that do not hold the points
    """
    count = dataset.sizes[dimension]
    if count < 1:
        raise DataError(f"{path}: {dimension} has no points")
    name = _coordinate(dataset, dimension, letter)
    if name is None:
        if spacing is None:
            raise DataError(f"{path}: dimension {dimension} has no coordinate: add --spacing DX DY DZ (km)")
        return _numbered(dimension, "the count", count, spacing, falls=False)
    variable = dataset[name]
    points = _points(path, name, variable)
    _refuse_other_levels(path, name, variable, letter)
    units = str(variable.attrs.get("units", "")).strip()
    downward = letter == "z" and _positive(path, name, variable) == "down"
    said = bool(units)
    numbers = _NUMBERS.fullmatch(units) if said else None
    counted = count > 1 and np.allclose(np.abs(np.diff(points)), 1.0) and np.allclose(points, np.round(points))
    if spacing is not None and (numbers or (not said and counted)):
        falls = downward != bool(count > 1 and points[0] > points[-1])
        return _numbered(dimension, name, count, spacing, falls)
    if not said and spacing is None:
        _require_no_units(path, dataset, name)
    factor, unit = _factor(path, name, units if said else None, points, letter, spacing)
    if downward:
        raise DataError(
            f"{path}: {name} has the attribute positive = 'down': it must be a height that grows upwards; store "
            f"heights, or correct the attribute"
        )
    points = points * factor
    falls = bool(count > 1 and points[0] > points[-1])
    points = points[::-1] if falls else points
    if not (np.diff(points) > 0).all():
        raise DataError(f"{path}: {name} must rise or fall from each point to the next, without repeating one")
    edges = _bounds(path, dataset, name, points, factor, falls)
    how = ", by its bounds" if edges is not None and count > 1 else ""
    if edges is None:
        edges = edges_between(path, name, points, spacing)
    elif spacing is not None and count == 1:
        _agree(path, name, spacing, np.diff(edges))
    if spacing is not None and count > 1:
        _agree(path, name, spacing, np.diff(edges))
    return Axis(dimension, name, points, edges, falls, unit, said, how)


def _coordinate(dataset: xr.Dataset, dimension: str, letter: str) -> str | None:
    """The variable that tells where the points of a dimension lie: its own, or where that counts, another one."""
    own = dataset[dimension] if dimension in dataset.variables else None
    if own is not None and own.ndim == 1:
        unit = parse_unit(own.attrs.get("units"))
        if unit is not None and unit.dimension == LENGTH:
            return dimension
    if letter == "z":
        for name, variable in dataset.variables.items():
            unit = parse_unit(variable.attrs.get("units"))
            if variable.dims != (dimension,) or unit is None or unit.dimension != LENGTH or name == dimension:
                continue
            standard = _text(variable.attrs, "standard_name").lower()
            if _HEIGHT_STANDARD_NAMES.fullmatch(standard) or _text(variable.attrs, "axis").lower() == "z":
                return str(name)
            if not standard and re.fullmatch(r"z|height|altitude|alt|z_?(full|mid|t|c|levels?)", str(name).lower()):
                return str(name)
    return dimension if own is not None and own.ndim == 1 else None


def _points(path: Any, name: str, variable: xr.DataArray) -> np.ndarray:
    if variable.dtype.kind not in "fiu":
        raise DataError(f"{path}: {name} has type {variable.dtype}, it must hold numbers")
    points = variable.values.astype(np.float64)
    if not np.isfinite(points).all():
        index = int(np.argmin(np.isfinite(points)))
        raise DataError(f"{path}: {name} is missing or not finite at index {index}: every point must have its place")
    return points


def _positive(path: Any, name: str, variable: xr.DataArray) -> str:
    positive = _text(variable.attrs, "positive").lower()
    if positive not in ("", "up", "down"):
        raise DataError(f"{path}: {name} has the attribute positive = '{positive}': it must be up or down")
    return positive


def _refuse_other_levels(path: Any, name: str, variable: xr.DataArray, letter: str) -> None:
    """Refuses what is along the vertical, or the horizontal, and tells no length."""
    units = variable.attrs.get("units")
    unit = parse_unit(units)
    standard = _text(variable.attrs, "standard_name").lower()
    if letter == "z" and unit is not None and unit.dimension == PRESSURE:
        raise DataError(f"{path}: {name} is a pressure (units '{units}'): give heights in m or km")
    if letter == "z" and ("formula_terms" in variable.attrs or re.fullmatch("atmosphere_.*coordinate", standard)):
        raise DataError(
            f"{path}: {name} has terrain-following or hybrid levels (its attributes standard_name, formula_terms): "
            f"interpolate to heights in m or km"
        )
    if letter == "z" and standard == "depth":
        raise DataError(f"{path}: {name} has the standard_name 'depth': give heights above the ground in m or km")
    degrees = isinstance(units, str) and _DEGREES.fullmatch(units.strip())
    if letter in "xy" and (degrees or (unit is not None and unit.dimension == ANGLE)):
        raise DataError(f"{path}: {name} has units '{units}', an angle, allowed are km and m: resample to lengths")


def _require_no_units(path: Any, dataset: xr.Dataset, name: str) -> None:
    """Refuses an axis without units in a file that states those of others, or one that says that it only counts.

    The unit of an axis is guessed only where a file has none at all: beside a stated one, its absence tells that
    the numbers are no lengths.
    """
    long_name = _text(dataset[name].attrs, "long_name").lower()
    words = re.search(r"sigma|\beta\b|pressure|level|layer|index|number", long_name)
    others = [str(other) for other in dataset.dims if other != name and other in dataset.variables]
    stated = [other for other in others if _is_length(dataset[other].attrs.get("units"))]
    if stated or words:
        why = f"{stated[0]} has them" if stated else f"its long_name says '{words.group()}'" if words else ""
        raise DataError(
            f"{path}: {name} has no units, and {why}: set its attribute units to m or km, or if its numbers only "
            f"count, add --spacing DX DY DZ (km)"
        )


def _is_length(units: Any) -> bool:
    unit = parse_unit(units)
    return unit is not None and unit.dimension == LENGTH


def _factor(
    path: Any, name: str, units: str | None, points: np.ndarray, letter: str, spacing: float | None
) -> tuple[float, str]:
    """The factor to km, and the unit that it is of."""
    if units is not None:
        unit = parse_unit(units)
        if unit is None or unit.dimension != LENGTH:
            also = ", or if its numbers only count, add --spacing DX DY DZ (km)" if _NUMBERS.fullmatch(units) else ""
            raise DataError(f"{path}: {name} has units '{units}', allowed are km and m (and cm, ft){also}")
        return unit.factor / 1e3, units
    steps = np.abs(np.diff(points))
    if spacing is not None and len(steps):
        for factor, unit_name in ((1.0, "km"), (1e-3, "m")):
            if abs(steps.mean() * factor - spacing) <= TOLERANCE * spacing:
                return factor, f"{unit_name}, by --spacing"
        raise DataError(
            f"{path}: {name} has no units and steps of {steps.mean():g}, which are {spacing:g} km neither in km nor "
            f"in m: set its attribute units"
        )
    largest = steps.max() if len(steps) else 0.0
    highest = np.abs(points).max() if letter == "z" else 0.0
    known = letter != "z" or _HEIGHTS.fullmatch(name.lower()) is not None
    if largest > _LARGEST_GUESSED_STEP or highest > _HIGHEST_GUESSED or not known:
        looks = "looks like metres, or counts" if largest > _LARGEST_GUESSED_STEP or highest else "may be anything"
        raise DataError(
            f"{path}: {name} has no units and steps of {largest:g}, which {looks}: set its attribute units to m or km, "
            f"or if its numbers only count, add --spacing DX DY DZ (km)"
        )
    return 1.0, "km"


def _numbered(dimension: str, source: str, count: int, spacing: float, falls: bool) -> Axis:
    """Voxels of a spacing that the user gives, from 0 on."""
    edges = spacing * np.arange(count + 1)
    how = ", by --spacing"
    return Axis(dimension, source, (edges[1:] + edges[:-1]) / 2, edges, falls, "km", True, how)


def _agree(path: Any, name: str, spacing: float, steps: np.ndarray) -> None:
    if (np.abs(steps - spacing) > 2 * TOLERANCE * spacing).any():
        raise DataError(
            f"{path}: --spacing says {spacing:g} km along {name}, the file {steps.min():g} to {steps.max():g} km: "
            f"leave the option out, or correct the file"
        )


def _bounds(
    path: Any, dataset: xr.Dataset, name: str, points: np.ndarray, factor: float, falls: bool
) -> np.ndarray | None:
    """Edges of the voxels by the bounds that a coordinate names, km; None if it names none that the file has."""
    variable = dataset[name]
    bounds = variable.attrs.get("bounds", variable.encoding.get("bounds"))
    if not isinstance(bounds, str) or bounds not in dataset.variables:
        return None
    given = dataset[bounds]
    (dimension,) = variable.dims
    if given.ndim != 2 or dimension not in given.dims or given.size != 2 * len(points) or given.dtype.kind not in "fiu":
        raise DataError(f"{path}: {bounds}, the bounds of {name}, must have two numbers for each of its points")
    units = given.attrs.get("units")
    if isinstance(units, str) and units.strip():
        unit = parse_unit(units)
        if unit is None or unit.dimension != LENGTH:
            raise DataError(f"{path}: {bounds}, the bounds of {name}, has units '{units}', allowed are km and m")
        factor = unit.factor / 1e3
    pairs = np.sort(given.transpose(dimension, ...).values.astype(np.float64) * factor, axis=1)
    pairs = pairs[::-1] if falls else pairs
    size = np.diff(pairs, axis=1)
    slack = TOLERANCE * np.abs(size).max() if np.isfinite(size).all() else np.nan
    inside = (pairs[:, 0] - slack <= points) & (points <= pairs[:, 1] + slack)
    # A voxel is about as wide as its neighbours are apart: bounds in another unit may hold the points, too.
    apart = np.abs(np.diff(points)).max() if len(points) > 1 else np.inf
    if not (size > 0).all() or not inside.all() or size.min() > 3 * apart:
        index = int(np.argmin(inside))
        raise DataError(
            f"{path}: {bounds}, the bounds of {name}, are {pairs[index][0]:g} to {pairs[index][1]:g} km at "
            f"{points[index]:g} km: they must hold their points, as wide as these are apart: correct them, or remove "
            f"the attribute bounds"
        )
    if (np.abs(pairs[1:, 0] - pairs[:-1, 1]) > slack).any():
        raise DataError(f"{path}: {bounds}, the bounds of {name}, leave gaps or overlap: correct or remove them")
    return np.append(pairs[:, 0], pairs[-1, 1])


def edges_between(path: Any, name: str, points: np.ndarray, single: float | None = None) -> np.ndarray:
    """Edges half-way between points; the outermost voxels are as wide as their neighbours' distance."""
    points = np.asarray(points, dtype=np.float64)
    if not np.isfinite(points).all() or (np.diff(points) <= 0).any():
        raise DataError(f"{path}: {name} must be finite and increase from point to point")
    if len(points) == 1:
        if single is None:
            raise DataError(
                f"{path}: {name} has one voxel centre only, which tells no spacing: give it at least two, or a bounds "
                f"variable after CF, or add --spacing DX DY DZ (km)"
            )
        return np.array([points[0] - single / 2, points[0] + single / 2])
    middle = (points[1:] + points[:-1]) / 2
    return np.concatenate([[2 * points[0] - middle[0]], middle, [2 * points[-1] - middle[-1]]])


def in_order(path: Any, dataset: xr.Dataset, dimension: str) -> xr.Dataset:
    """The dataset with rows (or columns) by their numbers, where it has a coordinate that numbers them.

    Rows are numbered from the top of an image; `positive = "up"` of the coordinate says that they are from the bottom.

    Raises
    ------
    DataError : the coordinate does not number them, one after the other
    """
    if dimension not in dataset.sizes or dimension not in dataset.variables:
        return dataset
    numbers = _points(path, dimension, dataset[dimension])
    order = np.argsort(numbers, kind="stable")
    if len(numbers) > 1 and not np.allclose(np.diff(numbers[order]), 1.0):
        raise DataError(
            f"{path}: the coordinate {dimension} must number the {dimension}s, each once, is "
            f"{', '.join(f'{number:g}' for number in numbers[:5])}, ...: correct or remove it"
        )
    if dimension == "row" and _positive(path, dimension, dataset[dimension]) == "up":
        order = order[::-1]
    return dataset if (order == np.arange(len(order))).all() else dataset.isel({dimension: order})


def components_in_order(path: Any, dataset: xr.Dataset) -> xr.Dataset:
    """The dataset with the components of vectors along `axis` as x, y, z, where it names them.

    Raises
    ------
    DataError : the names are others
    """
    labels = [name for name in ("component", "axis") if name in dataset.variables and dataset[name].dims == ("axis",)]
    if not labels:
        return dataset
    label = labels[0]
    names = [value.decode() if isinstance(value, bytes) else str(value) for value in dataset[label].values.ravel()]
    names = [name.strip().lower() for name in names]
    if names in ([str(i) for i in range(3)], [f"{i}.0" for i in range(3)]):
        return dataset
    if sorted(names) != ["x", "y", "z"]:
        raise DataError(f"{path}: the coordinate {label} must name x, y and z, is {', '.join(names)}")
    return dataset.isel({"axis": [names.index(letter) for letter in "xyz"]})
