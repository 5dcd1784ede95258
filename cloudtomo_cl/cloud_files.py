"""Clouds as others keep them: text of SHDOM, pyshdom, AT3D and I3RC, netCDF of AT3D and of models, .npy, .mat.

All become a `CloudVolume`: extinction in km^-1 on uniform voxels, and the effective radius where it is known.
Points of a grid are taken as the centres of voxels that reach half-way to their neighbours; stretched layers are
brought to uniform ones so that the optical depth and the water path of every column stay what they are.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import ValidationError

from cloudtomo_cl.cloud_volume import CloudVolume, uniform_layers, weighted_mean
from cloudtomo_cl.droplets import DropletTable, extinction_from_water
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.grid import Grid

if TYPE_CHECKING:
    import xarray as xr

_LENGTHS = {
    **dict.fromkeys(("km", "kilometer", "kilometers", "kilometre", "kilometres"), 1.0),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1e-3),
}
_RADII = {
    **dict.fromkeys(("um", "micron", "microns", "micrometer", "micrometers", "micrometre", "\u00b5m", "\u03bcm"), 1.0),
    **dict.fromkeys(("m", "meter", "meters", "metre"), 1e6),
}
# What a three-dimensional field may be: its units tell, and its unit here is the first factor's.
_EXTINCTIONS = {"km-1": 1.0, "1/km": 1.0, "m-1": 1e3, "1/m": 1e3}
_WATER_CONTENTS = {"gm-3": 1.0, "g/m3": 1.0, "kgm-3": 1e3, "kg/m3": 1e3}
_MIXING_RATIOS = {"gkg-1": 1.0, "g/kg": 1.0, "kgkg-1": 1e3, "kg/kg": 1e3}
_AIR_DENSITIES = {"kgm-3": 1.0, "kg/m3": 1.0}

# Names that fields go by, in lower case, the likelier first.
_EXTINCTION_NAMES = ("extinction", "ext", "beta", "sigma_ext", "extinction_coefficient")
_WATER_NAMES = ("density", "lwc", "liquid_water_content", "cloud_water_content", "clwc")
_MIXING_NAMES = ("ql", "qc", "qcloud", "qn", "qcl", "l", "clw", "cloud_water_mixing_ratio", "q_liquid")
_RADIUS_NAMES = ("effective_radius", "reff", "re", "r_eff", "rel", "re_cloud")
_AIR_NAMES = ("rho", "air_density", "rhobf", "rho0", "dn0", "rhof")
_HEIGHT_NAMES = ("height", "altitude", "lev", "level", "bottom_top", "top_bottom")

# Beyond any cloud's voxel: coordinates without units and steps this large are metres, not km.
_LARGEST_STEP = 5.0
_UNIFORM = 1e-3
# Martin, Johnson and Spice 1994: (r_v / r_e)^3, the cube of volume mean over effective radius, in maritime clouds.
_VOLUME_RADIUS_SHARE = 0.80
_WATER_DENSITY = 1e6  # g m^-3


@dataclass(frozen=True)
class ReadingOptions:
    """What a file may leave open.

    Attributes
    ----------
    variable : name of the field, where the file has several or none of the known names
    units : of the field, for files that cannot tell or do not: km-1, m-1, g m-3, kg m-3, g kg-1, kg kg-1
    spacing : voxel edges in km, for files without coordinates
    order : of the axes of a plain array, for instance "zyx"
    time : index of the time step, for files with several
    effective_radius : micrometres, where the file has none
    droplet_number : cm^-3, from which the effective radius follows where the file has none
    droplet_table : file of a Mie table (`cloudtomo mie`) that water becomes extinction by; by default the
        limit of large droplets
    layer : thickness of the uniform layers that stretched ones become, km; by default the thinnest
    """

    variable: str | None = None
    units: str | None = None
    spacing: tuple[float, float, float] | None = None
    order: str = "xyz"
    time: int | None = None
    effective_radius: float | None = None
    droplet_number: float | None = None
    droplet_table: Path | None = None
    layer: float | None = None


def read_cloud(path: str | os.PathLike[str], options: ReadingOptions | None = None) -> CloudVolume:
    """Reads a cloud from any of the known kinds of files; the content decides, or the name's end (.npy, .mat).

    Text: pyshdom's ("# comment", "nx ny nz", "dx dy z...", indices from 0, water content and radius),
    AT3D's with commas and column names, SHDOM's and I3RC's "2 parameter LWC file" (indices from 1), and
    I3RC's NAME.tau.NXxNY with NAME.dz.NXxNY beside it (the Landsat cloud).
    netCDF: extinction, water content or mixing ratio on x, y, z.

    Raises
    ------
    DataError : no such file, none of these, or something in it that cannot be; the text says what to do
    """
    path, options = Path(path), options or ReadingOptions()
    if not path.is_file():
        raise DataError(f"{path}: no such file")
    try:
        return _read_any(path, options)
    except (DataError, MemoryError):
        raise
    except Exception as error:  # what a foreign or damaged file may lead to has no end
        text = str(error) or type(error).__name__
        raise DataError(f"{path}: is damaged, or no cloud that can be understood ({text})") from None


def _read_any(path: Path, options: ReadingOptions) -> CloudVolume:
    with open(path, "rb") as file:
        start = file.read(8)
    if start.startswith((b"CDF", b"\x89HDF")) and path.suffix != ".mat":
        return _read_netcdf(path, options)
    if start.startswith(b"\x93NUMPY"):
        return _read_array(path, np.load(path, allow_pickle=False), options)
    if path.suffix == ".mat":
        return _read_array(path, _matlab_array(path, options), options)
    return _read_text(path, options)


# ---- fields of a known kind to a CloudVolume


def _volume(
    path: Path,
    field: np.ndarray,
    kind: str,
    edges: list[np.ndarray],
    radius: np.ndarray | None,
    options: ReadingOptions,
) -> CloudVolume:
    """A field of extinction (km^-1) or of water content (g m^-3) between voxel edges (km), x and y uniform."""
    field = np.nan_to_num(np.asarray(field, dtype=np.float64), posinf=np.inf, neginf=-np.inf)
    wrong = ~(np.isfinite(field) & (field >= 0))
    if wrong.any():
        # Models leave rounding errors below zero behind.
        if np.isfinite(field).all() and field.min() > -1e-6 * field.max():
            field = np.maximum(field, 0.0)
        else:
            voxel = tuple(int(i) for i in np.argwhere(wrong)[0])
            raise DataError(f"{path}: {kind} at voxel {voxel} is {field[voxel]}: it must be finite and at least 0")
    if not field.any():
        raise DataError(f"{path}: {kind} is zero in every voxel: there is no cloud in this file")
    radius = _known_radius(path, field, kind, radius, options)
    if kind == "extinction":
        extinction = field
    else:
        if radius is None:
            raise DataError(
                f"{path}: holds water content but no effective radius, which extinction depends on: "
                f"add --effective-radius (um) or --droplet-number (cm^-3)"
            )
        try:
            extinction = extinction_from_water(field, radius, _droplet_table(options))
        except DataError as error:
            raise DataError(f"{path}: {error}") from None
    heights, layers = _above_ground(path, edges[2], extinction)
    extinction = extinction[..., layers]
    fields = [extinction] if radius is None else [extinction, extinction * np.nan_to_num(radius[..., layers])]
    steps = np.diff(heights)
    if np.ptp(steps) > _UNIFORM * steps.mean() or options.layer is not None:
        heights, fields = uniform_layers(heights, fields, options.layer)
    spacing, origin = zip(*(_edges_to_axis(values) for values in (edges[0], edges[1], heights)))
    extinction = fields[0]
    try:
        grid = Grid(extinction.shape, spacing, origin)
    except ValidationError as error:
        raise DataError(f"{path}: impossible grid: {error.errors()[0]['msg']}") from None
    return CloudVolume(
        grid,
        extinction.astype(np.float32),
        None if radius is None else weighted_mean(fields[1], extinction).astype(np.float32),
    )


def _droplet_table(options: ReadingOptions) -> DropletTable | None:
    if options.droplet_table is None:
        return None
    from cloudtomo_cl.phase_files import read_droplet_table

    return read_droplet_table(options.droplet_table)


def _known_radius(
    path: Path, field: np.ndarray, kind: str, radius: np.ndarray | None, options: ReadingOptions
) -> np.ndarray | None:
    """The effective radius in cloudy voxels, micrometres, from the file or from what the user says."""
    if options.effective_radius is not None:
        radius = np.full(field.shape, options.effective_radius)
    elif options.droplet_number is not None and kind == "liquid water content":
        # LWC = 4/3 pi rho k r_e^3 N: micrometres from g m^-3 and cm^-3.
        volume = field / (4 / 3 * np.pi * _WATER_DENSITY * _VOLUME_RADIUS_SHARE * options.droplet_number * 1e6)
        radius = np.cbrt(volume) * 1e6
    if radius is None:
        return None
    radius = np.where(field > 0, np.broadcast_to(radius, field.shape), np.nan)
    wrong = (field > 0) & ~(np.isfinite(radius) & (radius > 0))
    if wrong.any():
        voxel = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise DataError(
            f"{path}: effective radius at the cloudy voxel {voxel} is {radius[voxel]}: it must be above 0 um"
        )
    return radius


def _above_ground(path: Path, edges: np.ndarray, extinction: np.ndarray) -> tuple[np.ndarray, slice]:
    """Edges of the layers, and which; a first level at z = 0 has half of its layer below the ground."""
    if edges[0] >= 0:
        return edges, slice(None)
    above = int(np.searchsorted(edges, 0.0))
    if not extinction[..., :above].any():
        return edges[above:], slice(above, None)
    if edges[1] > 0:
        return np.concatenate([[0.0], edges[1:]]), slice(None)
    raise DataError(f"{path}: there is cloud at z = {edges[0]:g} km, below the ground z = 0")


def _edges_to_axis(edges: np.ndarray) -> tuple[float, float]:
    """Spacing and lower end, without the rounding of single precision."""
    return round(float(edges[-1] - edges[0]) / (len(edges) - 1), 9), round(float(edges[0]), 9)


def _edges(path: Path, name: str, points: np.ndarray, single: float | None = None) -> np.ndarray:
    """Edges half-way between points; the outermost voxels are as wide as their neighbours' distance."""
    points = np.asarray(points, dtype=np.float64)
    if not np.isfinite(points).all() or (np.diff(points) <= 0).any():
        raise DataError(f"{path}: {name} must be finite and increase from point to point")
    if len(points) == 1:
        if single is None:
            raise DataError(f"{path}: {name} has one point only, which tells no spacing: add --spacing")
        return np.array([points[0] - single / 2, points[0] + single / 2])
    middle = (points[1:] + points[:-1]) / 2
    return np.concatenate([[2 * points[0] - middle[0]], middle, [2 * points[-1] - middle[-1]]])


def _box(shape: tuple[int, ...], spacing: tuple[float, ...]) -> list[np.ndarray]:
    """Edges of uniform voxels from 0 on."""
    return [step * np.arange(count + 1) for count, step in zip(shape, spacing)]


# ---- text


def _read_text(path: Path, options: ReadingOptions) -> CloudVolume:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError:
        raise DataError(
            f"{path}: is none of the known kinds of files: text, netCDF, .npy, .mat; see `cloudtomo cloud --help`"
        ) from None
    if ".tau." in path.name:
        return _read_columns(path, options)
    if lines and "2 parameter lwc" in lines[0].lower():
        header, rows, first = [lines[1], f"{lines[2]} {lines[3]}"], lines[5:], 1
    else:
        lines = [line for line in lines if not line.lstrip().startswith("#")]
        if len(lines) > 3 and "," in lines[0]:
            # AT3D: commas, the levels on their own line, then column names.
            names = [name.strip() for name in lines[3].split(",")]
            wanted = _at3d_columns(path, names)
            header = [lines[0].replace(",", " "), f"{lines[1]},{lines[2]}".replace(",", " ")]
            rows = [" ".join(np.array(line.split(","))[wanted]) for line in lines[4:] if line.strip()]
            first = 0
        else:
            header, rows, first = lines[:2], lines[2:], 0
    return _read_points(path, header, rows, first, options)


def _at3d_columns(path: Path, names: list[str]) -> list[int]:
    lower = [name.lower() for name in names]
    water = next((lower.index(name) for name in _WATER_NAMES if name in lower), None)
    radius = next((lower.index(name) for name in _RADIUS_NAMES if name in lower), None)
    if lower[:3] != ["x", "y", "z"] or water is None or radius is None:
        raise DataError(f"{path}: has the columns {', '.join(names)}; it must have x, y, z, lwc and reff")
    return [0, 1, 2, water, radius]


def _read_points(path: Path, header: list[str], rows: list[str], first: int, options: ReadingOptions) -> CloudVolume:
    """nx ny nz; dx dy and the levels; then ix iy iz, water content (g m^-3), effective radius (um)."""
    expected = (
        "text must hold '# comment', 'nx ny nz', 'dx dy z1 ... znz' (km), and lines "
        "'ix iy iz water_content effective_radius' (g m^-3, um)"
    )
    try:
        shape = tuple(int(word) for word in header[0].split())
        dx, dy, *levels = (float(word) for word in header[1].split())
        table = np.array([[float(word) for word in row.split()[:5]] for row in rows if row.strip()])
    except (ValueError, IndexError):
        raise DataError(f"{path}: is no cloud that can be read: {expected}") from None
    if len(shape) != 3 or min(shape) < 1 or table.ndim != 2 or table.shape[1] != 5:
        raise DataError(f"{path}: is no cloud that can be read: {expected}")
    if len(levels) != shape[2]:
        raise DataError(f"{path}: line 3 has {len(levels)} levels, line 2 says {shape[2]}")
    indices = table[:, :3].astype(int) - first
    wrong = ((indices < 0) | (indices >= shape)).any(axis=1)
    if wrong.any():
        row = np.array(table[np.argmax(wrong), :3], int)
        raise DataError(
            f"{path}: the voxel {tuple(row.tolist())} lies outside of {shape} voxels, which are counted from {first}"
        )
    water, radius = np.zeros(shape), np.full(shape, np.nan)
    water[tuple(indices.T)], radius[tuple(indices.T)] = table[:, 3], table[:, 4]
    # The levels are points on which SHDOM interpolates; x and y are told by their spacing only, and start at 0.
    edges = [*_box(shape[:2], (dx, dy)), _edges(path, "z", np.array(levels), dx)]
    return _volume(path, water, "liquid water content", edges, radius, options)


def _read_columns(path: Path, options: ReadingOptions) -> CloudVolume:
    """I3RC's Landsat cloud: optical depth and thickness (km) of every column, above a common base.

    A line of numbers runs along x, the lines follow each other along y. I3RC's case 3 has columns of 30 m and its
    base at 0.2 km.
    """
    beside = path.with_name(path.name.replace(".tau.", ".dz."))
    if not beside.is_file():
        raise DataError(f"{path}: holds optical depths; their thicknesses must lie beside it in {beside.name}")
    try:
        depth, thickness = (np.loadtxt(file, ndmin=2).T for file in (path, beside))
    except ValueError as error:
        raise DataError(f"{path}: is no table of numbers ({error})") from None
    if depth.shape != thickness.shape:
        raise DataError(f"{path}: has {depth.shape} columns, {beside.name} {thickness.shape}")
    dx, dy, dz = options.spacing or (0.03, 0.03, 0.05)
    base, count = 0.2, max(1, int(np.ceil(thickness.max() / dz - _UNIFORM)))
    edges = dz * np.arange(count + 1)
    share = np.clip((thickness[..., None] - edges[:-1]) / dz, 0.0, 1.0)
    filled = share.sum(axis=-1, keepdims=True) * dz
    extinction = np.divide(depth[..., None] * share, filled, out=np.zeros(share.shape), where=filled > 0)
    if (depth[thickness <= 0] > 0).any():
        raise DataError(f"{path}: a column has an optical depth but no thickness in {beside.name}")
    return _volume(path, extinction, "extinction", [*_box(depth.shape, (dx, dy)), base + edges], None, options)


# ---- plain arrays


def _matlab_array(path: Path, options: ReadingOptions) -> np.ndarray:
    from scipy.io import loadmat

    try:
        content = loadmat(path)
    except (NotImplementedError, ValueError, OSError):
        raise DataError(f"{path}: MATLAB's format 7.3 or damaged: save it with save(..., '-v7')") from None
    arrays = {name: value for name, value in content.items() if isinstance(value, np.ndarray) and value.ndim == 3}
    if options.variable is not None:
        arrays = {name: value for name, value in arrays.items() if name == options.variable}
    if len(arrays) != 1:
        names = ", ".join(name for name in content if not name.startswith("__"))
        raise DataError(f"{path}: choose the three-dimensional array with --variable; the file has {names}")
    return next(iter(arrays.values()))


def _read_array(path: Path, values: np.ndarray, options: ReadingOptions) -> CloudVolume:
    if values.ndim != 3 or values.dtype.kind not in "fiu":
        raise DataError(f"{path}: has the shape {values.shape} and type {values.dtype}: it must hold 3-D numbers")
    if options.spacing is None:
        raise DataError(f"{path}: an array tells no spacing: add --spacing DX DY DZ (km)")
    if sorted(options.order) != ["x", "y", "z"]:
        raise DataError(f"--order {options.order}: must be a permutation of xyz")
    values = values.transpose([options.order.index(axis) for axis in "xyz"])
    kind, factor = _kind(path, options.units or "km-1")
    if kind == "mixing ratio":
        raise DataError(f"{path}: a mixing ratio needs the density of air: multiply with it, and use g m-3")
    return _volume(path, values * factor, kind, _box(values.shape, options.spacing), None, options)


def _kind(path: Path, units: str) -> tuple[str, float]:
    """What a field is by its units, and the factor to km^-1, g m^-3 or g kg^-1."""
    short = units.replace(" ", "").replace("^", "").replace("**", "").replace("/m**3", "/m3")
    for kind, table in (
        ("extinction", _EXTINCTIONS),
        ("liquid water content", _WATER_CONTENTS),
        ("mixing ratio", _MIXING_RATIOS),
    ):
        if short in table:
            return kind, table[short]
    allowed = "km-1, m-1, g m-3, kg m-3, g kg-1 or kg kg-1"
    raise DataError(f"{path}: the field has units '{units}', allowed are {allowed}: say them with --units")


# ---- netCDF


def _read_netcdf(path: Path, options: ReadingOptions) -> CloudVolume:
    from cloudtomo_cl.io import load_dataset

    dataset = load_dataset(path)
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
    radius_name = _find(dataset, _RADIUS_NAMES)
    if radius_name is not None:
        unit = str(dataset[radius_name].attrs.get("units", "um")).strip()
        if unit not in _RADII:
            raise DataError(f"{path}: {radius_name} has units '{unit}', it must have um or m")
        radius = np.broadcast_to(_plain(path, dataset[radius_name], axes, options) * _RADII[unit], field.shape)
    edges = [_axis_edges(path, dataset, axis, number, options) for number, axis in enumerate(axes)]
    for number in (0, 1):
        steps = np.diff(edges[number])
        if np.ptp(steps) > 2 * _UNIFORM * steps.mean():
            raise DataError(f"{path}: {axes[number]} is not uniform: only vertical levels may be stretched")
    return _volume(path, field, kind, edges, radius, options)


def _find(dataset: xr.Dataset, names: tuple[str, ...]) -> str | None:
    by_lower = {str(name).lower(): str(name) for name in dataset.variables}
    return next((by_lower[name] for name in names if name in by_lower), None)


def _field(path: Path, dataset: xr.Dataset, options: ReadingOptions) -> tuple[str, str, float]:
    """Name and kind of the cloud's field, and the factor to our unit."""
    defaults = {"extinction": "km-1", "liquid water content": "g m-3", "mixing ratio": None}
    kinds = (
        ("extinction", _EXTINCTION_NAMES),
        ("liquid water content", _WATER_NAMES),
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
        kind, factor = _kind(path, str(units))
        return name, kind, factor
    if options.variable is not None and options.variable in dataset.variables:
        units = options.units or dataset[options.variable].attrs.get("units")
        if units is None:
            raise DataError(f"{path}: {options.variable} has no units: say them with --units")
        return (options.variable, *_kind(path, str(units)))
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
    if unit not in _LENGTHS:
        raise DataError(f"{path}: {name} has units '{unit}', allowed are m and km")
    factor = _LENGTHS[unit]
    bounds = variable.attrs.get("bounds", variable.encoding.get("bounds"))
    if bounds in dataset.variables and dataset[bounds].shape == (len(points), 2):
        pairs = dataset[bounds].values.astype(np.float64) * factor
        if np.allclose(pairs[1:, 0], pairs[:-1, 1]):
            return np.append(pairs[:, 0], pairs[-1, 1])
    return _edges(path, name, points * factor, given)
