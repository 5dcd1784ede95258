"""Clouds as others keep them: text of SHDOM, pyshdom, AT3D and I3RC, netCDF of AT3D and of models, .npy, .mat.

All become a `CloudVolume`: extinction in km^-1 on uniform voxels, and the effective radius where it is known.
Points of a grid are taken as the centres of voxels that reach half-way to their neighbours; stretched layers are
brought to uniform ones so that the optical depth and the water path of every column stay what they are.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from cloudtomo_cl.clouds.netcdf import RADIUS_NAMES, WATER_NAMES, read_netcdf_cloud
from cloudtomo_cl.clouds.quantities import UNIFORM, ReadingOptions, box_edges, cloud_volume, edges_between, field_kind
from cloudtomo_cl.clouds.volume import CloudVolume
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.netcdf import Source, name_of

__all__ = ["ReadingOptions", "read_cloud"]


def read_cloud(source: Source, options: ReadingOptions | None = None) -> CloudVolume:
    """Reads a cloud from any of the known kinds of files; the content decides, or the name's end (.npy, .mat).

    An xarray Dataset, or a DataArray with a name, is understood like a netCDF file.

    Text: pyshdom's ("# comment", "nx ny nz", "dx dy z...", indices from 0, water content and radius),
    AT3D's with commas and column names, SHDOM's and I3RC's "2 parameter LWC file" (indices from 1), and
    I3RC's NAME.tau.NXxNY with NAME.dz.NXxNY beside it (the Landsat cloud).
    netCDF: extinction, water content or mixing ratio on x, y, z.

    Raises
    ------
    DataError : no such file, none of these, or something in it that cannot be; the text says what to do
    """
    path, options = Path(name_of(source)), options or ReadingOptions()
    in_memory = not isinstance(source, (str, os.PathLike))
    if not in_memory and not path.is_file():
        raise DataError(f"{path}: no such file")
    try:
        return read_netcdf_cloud(source, options) if in_memory else _read_any(path, options)
    except (DataError, MemoryError):
        raise
    except Exception as error:  # what a foreign or damaged file may lead to has no end
        text = str(error) or type(error).__name__
        raise DataError(f"{path}: is damaged, or no cloud that can be understood ({text})") from None


def _read_any(path: Path, options: ReadingOptions) -> CloudVolume:
    with open(path, "rb") as file:
        start = file.read(8)
    if start.startswith((b"CDF", b"\x89HDF")) and path.suffix != ".mat":
        return read_netcdf_cloud(path, options)
    if start.startswith(b"\x93NUMPY"):
        return _read_array(path, np.load(path, allow_pickle=False), options)
    if path.suffix == ".mat":
        return _read_array(path, _matlab_array(path, options), options)
    return _read_text(path, options)


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
    water = next((lower.index(name) for name in WATER_NAMES if name in lower), None)
    radius = next((lower.index(name) for name in RADIUS_NAMES if name in lower), None)
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
    edges = [*box_edges(shape[:2], (dx, dy)), edges_between(path, "z", np.array(levels), dx)]
    return cloud_volume(path, water, "liquid water content", edges, radius, options)


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
    base, count = 0.2, max(1, int(np.ceil(thickness.max() / dz - UNIFORM)))
    edges = dz * np.arange(count + 1)
    share = np.clip((thickness[..., None] - edges[:-1]) / dz, 0.0, 1.0)
    filled = share.sum(axis=-1, keepdims=True) * dz
    extinction = np.divide(depth[..., None] * share, filled, out=np.zeros(share.shape), where=filled > 0)
    if (depth[thickness <= 0] > 0).any():
        raise DataError(f"{path}: a column has an optical depth but no thickness in {beside.name}")
    sides = box_edges(depth.shape, (dx, dy))
    return cloud_volume(path, extinction, "extinction", [*sides, base + edges], None, options)


# ---- plain arrays


def _matlab_array(path: Path, options: ReadingOptions) -> np.ndarray:
    from scipy.io import loadmat

    try:
        content = loadmat(path)
    except NotImplementedError:  # SciPy reads formats up to 7 only
        raise DataError(f"{path}: is in MATLAB's format 7.3: save it with save(..., '-v7')") from None
    except Exception as error:  # what a damaged file may raise has no end
        raise DataError(f"{path}: cannot be read as a MATLAB file ({error}): is it damaged or cut short?") from None
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
    kind, factor = field_kind(path, options.units or "km-1")
    if kind == "mixing ratio":
        raise DataError(f"{path}: a mixing ratio needs the density of air: multiply with it, and use g m-3")
    return cloud_volume(path, values * factor, kind, box_edges(values.shape, options.spacing), None, options)
