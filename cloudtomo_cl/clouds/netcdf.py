"""Clouds in netCDF files of models and of AT3D: fields found by their names, units understood."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cloudtomo_cl.clouds.quantities import UNIFORM, ReadingOptions, cloud_volume, edges_between, field_kind
from cloudtomo_cl.clouds.volume import CloudVolume
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.netcdf import LENGTH_UNITS, Source, load_dataset, name_of

if TYPE_CHECKING:
    import xarray as xr

_RADII = {
    **dict.fromkeys(("um", "micron", "microns", "micrometer", "micrometers", "micrometre", "\u00b5m", "\u03bcm"), 1.0),
    **dict.fromkeys(("m", "meter", "meters", "metre"), 1e6),
}
_AIR_DENSITIES = {"kgm-3": 1.0, "kg/m3": 1.0}

# Names that fields go by, in lower case, the likelier first.
_EXTINCTION_NAMES = ("extinction", "ext", "beta", "sigma_ext", "extinction_coefficient")
WATER_NAMES = ("density", "lwc", "liquid_water_content", "cloud_water_content", "clwc")
_MIXING_NAMES = ("ql", "qc", "qcloud", "qn", "qcl", "l", "clw", "cloud_water_mixing_ratio", "q_liquid")
RADIUS_NAMES = ("effective_radius", "reff", "re", "r_eff", "rel", "re_cloud")
_AIR_NAMES = ("rho", "air_density", "rhobf", "rho0", "dn0", "rhof")
_HEIGHT_NAMES = ("height", "altitude", "lev", "level", "bottom_top", "top_bottom")

# Beyond any cloud's voxel: coordinates without units and steps this large are metres, not km.
_LARGEST_STEP = 5.0


def read_netcdf_cloud(source: Source, options: ReadingOptions) -> CloudVolume:
    """Extinction, water content or mixing ratio over x, y, z.

    Raises
    ------
    DataError : no such field, other units, coordinates that are not uniform but for the vertical one
    """
    path, dataset = Path(name_of(source)), load_dataset(source)
    name, kind, factor = _field(path, dataset, options)
    axes = _axes(path, dataset, dataset[name])
    field = _plain(path, dataset[name], axes, options) * factor
    if kind == "mixing ratio":
        density = _find(dataset, _AIR_NAMES)
        if density is None:
            raise DataError(
                f"{path}: {name} is a mixing ratio, which needs the density of air: add a variable rho (kg m-3) "
                f"on its levels, or store the water content in g m-3"
            )
        unit = str(dataset[density].attrs.get("units", "kg m-3")).replace(" ", "").replace("^", "")
        if unit not in _AIR_DENSITIES:
            raise DataError(f"{path}: {density} has units '{unit}', it must have kg m-3")
        field = field * _plain(path, dataset[density], axes, options)
        kind = "liquid water content"
    radius = None
    radius_name = _find(dataset, RADIUS_NAMES)
    if radius_name is not None:
        unit = str(dataset[radius_name].attrs.get("units", "um")).strip()
        if unit not in _RADII:
            raise DataError(f"{path}: {radius_name} has units '{unit}', it must have um or m")
        radius = np.broadcast_to(_plain(path, dataset[radius_name], axes, options) * _RADII[unit], field.shape)
    edges = [_axis_edges(path, dataset, axis, number, options) for number, axis in enumerate(axes)]
    for number in (0, 1):
        steps = np.diff(edges[number])
        if np.ptp(steps) > 2 * UNIFORM * steps.mean():
            raise DataError(f"{path}: {axes[number]} is not uniform: only vertical levels may be stretched")
    return cloud_volume(path, field, kind, edges, radius, options)


def _find(dataset: xr.Dataset, names: tuple[str, ...]) -> str | None:
    by_lower = {str(name).lower(): str(name) for name in dataset.variables}
    return next((by_lower[name] for name in names if name in by_lower), None)


def _field(path: Path, dataset: xr.Dataset, options: ReadingOptions) -> tuple[str, str, float]:
    """Name and kind of the cloud's field, and the factor to our unit."""
    defaults = {"extinction": "km-1", "liquid water content": "g m-3", "mixing ratio": None}
    kinds = (
        ("extinction", _EXTINCTION_NAMES),
        ("liquid water content", WATER_NAMES),
        ("mixing ratio", _MIXING_NAMES),
    )
    for default, names in kinds:
        name = _find(dataset, names) if options.variable is None else options.variable
        if name is None or (options.variable is not None and name.lower() not in names):
            continue
        if name not in dataset.variables or dataset[name].ndim < 3:
            continue
        units = options.units or dataset[name].attrs.get("units") or defaults[default]
        if units is None:
            raise DataError(f"{path}: {name} has no units: say them with --units, for instance --units 'g kg-1'")
        kind, factor = field_kind(path, str(units))
        return name, kind, factor
    if options.variable is not None and options.variable in dataset.variables:
        units = options.units or dataset[options.variable].attrs.get("units")
        if units is None:
            raise DataError(f"{path}: {options.variable} has no units: say them with --units")
        return (options.variable, *field_kind(path, str(units)))
    found = ", ".join(str(name) for name in dataset.data_vars) or "none"
    raise DataError(
        f"{path}: no variable extinction, lwc, density, ql or qc over x, y, z; choose one with --variable from: {found}"
    )


def _axes(path: Path, dataset: xr.Dataset, variable: xr.DataArray) -> list[str]:
    """The names of the dimensions along x, y, z."""
    found: dict[str, str] = {}
    for dimension in map(str, variable.dims):
        attributes = dataset[dimension].attrs if dimension in dataset.variables else {}
        lower = dimension.lower()
        letter = str(attributes.get("axis", "")).lower()
        if letter not in ("x", "y", "z"):
            letter = "z" if lower in _HEIGHT_NAMES else lower[:1]
            letter = {"west_east": "x", "south_north": "y", "longitude": "x", "latitude": "y"}.get(lower, letter)
        if letter in ("x", "y", "z"):
            found.setdefault(letter, dimension)
    if len(found) != 3:
        raise DataError(
            f"{path}: {variable.name} has dimensions ({', '.join(map(str, variable.dims))}), which are not known as "
            f"x, y and z: rename them, or give them the attribute axis"
        )
    return [found[letter] for letter in "xyz"]


def _plain(path: Path, variable: xr.DataArray, axes: list[str], options: ReadingOptions) -> np.ndarray:
    """The variable over x, y, z (dimensions of length 1 where it has none), one time step of it."""
    for dimension in [str(name) for name in variable.dims if name not in axes]:
        count = variable.sizes[dimension]
        if options.time is None and count > 1:
            raise DataError(f"{path}: {variable.name} has {count} steps of {dimension}: choose one with --time INDEX")
        index = options.time if count > 1 and options.time is not None else 0
        if not -count <= index < count:
            raise DataError(f"{path}: --time {index}: {variable.name} has {count} steps of {dimension}")
        variable = variable.isel({dimension: index})
    missing = [axis for axis in axes if axis not in variable.dims]
    return variable.expand_dims(missing).transpose(*axes).values.astype(np.float64)


def _axis_edges(path: Path, dataset: xr.Dataset, name: str, number: int, options: ReadingOptions) -> np.ndarray:
    """Edges of the voxels along an axis, km: from bounds where the file has them, else half-way between points."""
    given = None if options.spacing is None else options.spacing[number]
    if name not in dataset.variables:
        if given is None:
            raise DataError(f"{path}: dimension {name} has no coordinate: add --spacing DX DY DZ (km)")
        return given * np.arange(dataset.sizes[name] + 1)
    variable = dataset[name]
    units = variable.attrs.get("units")
    points = variable.values.astype(np.float64)
    if units is None and len(points) > 1 and np.diff(points).max() > _LARGEST_STEP:
        raise DataError(
            f"{path}: {name} has no units and steps of {np.diff(points).max():g}: set its attribute units to m or km"
        )
    unit = str(units or "km").strip()
    if unit not in LENGTH_UNITS:
        raise DataError(f"{path}: {name} has units '{unit}', allowed are m and km")
    factor = LENGTH_UNITS[unit]
    bounds = variable.attrs.get("bounds", variable.encoding.get("bounds"))
    if bounds in dataset.variables and dataset[bounds].shape == (len(points), 2):
        pairs = dataset[bounds].values.astype(np.float64) * factor
        if np.allclose(pairs[1:, 0], pairs[:-1, 1]):
            return np.append(pairs[:, 0], pairs[-1, 1])
    return edges_between(path, name, points * factor, given)
