"""Clouds as others keep them: text of SHDOM, pyshdom, AT3D and I3RC, netCDF of AT3D and of models, .npy, .mat.

All become a `CloudVolume`: extinction in km^-1 on uniform voxels, and the effective radius where it is known.
Points of a grid are taken as the centres of voxels that reach half-way to their neighbours; stretched layers are
brought to uniform ones so that the optical depth and the water path of every column stay what they are.
"""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np

from cloudtomo_cl.arguments import a, require_kinds
from cloudtomo_cl.clouds.netcdf import read_netcdf_cloud
from cloudtomo_cl.clouds.quantities import UNIFORM, Quantity, ReadingOptions, box_edges, cloud_volume, field_kind
from cloudtomo_cl.clouds.text import read_text_cloud
from cloudtomo_cl.clouds.volume import CloudVolume
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files.netcdf import HARMLESS, LARGEST_COMPRESSION, Source, name_of, require_file
from cloudtomo_cl.files.text import read_text
from cloudtomo_cl.memory import require, size_text

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
    require_kinds("read_cloud", options=(options, a(ReadingOptions).or_none()))
    path, options = Path(name_of(source)), options or ReadingOptions()
    in_memory = not isinstance(source, (str, os.PathLike))
    if not (isinstance(options.missing, str) and options.missing in ("refuse", "clear")):
        raise DataError(f"missing is {options.missing!r}: it must be 'refuse' or 'clear'")
    if not in_memory:
        require_file(path)
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
        return _read_array(path, "the array", _numpy_array(path), options)
    if path.suffix == ".mat":
        return _read_array(path, *_matlab_array(path, options), options)
    if start.startswith(b"PK"):
        raise DataError(f"{path}: is an archive (zip, .npz): take the array or the file out of it")
    if start.startswith(b"\x1f\x8b"):
        raise DataError(f"{path}: is compressed: unpack it first (gunzip)")
    return _read_text(path, options)


# ---- text


def _read_text(path: Path, options: ReadingOptions) -> CloudVolume:
    if options.order != "xyz":
        raise DataError(f"{path}: --order {options.order} has no effect on text, which names its axes; leave it out")
    try:
        text = read_text(path, latin=True)
    except DataError as error:
        raise DataError(
            f"{error}; it is none of the known kinds of files: text, netCDF, .npy, .mat; see `cloudtomo cloud --help`"
        ) from None
    _refuse_dimensions(path, options)
    if ".tau." in path.name:
        return _read_columns(path, options)
    return read_text_cloud(path, text, options)


def _refuse_dimensions(path: Path, options: ReadingOptions) -> None:
    """Times and members are there in netCDF only."""
    for name, value in (("--time", options.time), ("--select", options.select)):
        if value is not None:
            raise DataError(f"{path}: {name} has no effect: the file has three dimensions; leave it out")


def _read_columns(path: Path, options: ReadingOptions) -> CloudVolume:
    """I3RC's Landsat cloud: optical depth and thickness (km) of every column, above a common base.

    A line of numbers runs along x, the lines follow each other along y. I3RC's case 3 has columns of 30 m and its
    base at 0.2 km.
    """
    beside = path.with_name(path.name.replace(".tau.", ".dz."))
    if not beside.is_file():
        raise DataError(f"{path}: holds optical depths; their thicknesses must lie beside it in {beside.name}")
    for name, value in (("--variable", options.variable), ("--units", options.units)):
        if value is not None:
            raise DataError(f"{path}: {name} has no effect: the file holds optical depths; leave it out")
    depth, thickness = _table(path), _table(beside)
    if depth.shape != thickness.shape:
        raise DataError(f"{path}: has {depth.shape} columns, {beside.name} {thickness.shape}")
    dx, dy, dz = options.spacing or (0.03, 0.03, 0.05)
    base, count = 0.2, max(1, int(np.ceil(thickness.max() / dz - UNIFORM)))
    edges = dz * np.arange(count + 1)
    share = np.clip((thickness[..., None] - edges[:-1]) / dz, 0.0, 1.0)
    reached = share.sum(axis=-1, keepdims=True) * dz
    extinction = np.divide(depth[..., None] * share, reached, out=np.zeros(share.shape), where=reached > 0)
    if (depth[thickness <= 0] > 0).any():
        raise DataError(f"{path}: a column has an optical depth but no thickness in {beside.name}")
    sides = box_edges(depth.shape, (dx, dy))
    by = "by --spacing" if options.spacing else "of I3RC's case 3"
    rows = (("x, y, z", f"voxels of {dx:g} x {dy:g} x {dz:g} km, {by}; base at {base:g} km"),)
    field = Quantity(f"optical depth, by the thickness in {beside.name}", "extinction", extinction, "km-1", True)
    return cloud_volume(path, field, [*sides, base + edges], None, options, rows)


def _table(path: Path) -> np.ndarray:
    """Numbers of a text file, [x, y]: a line of it runs along x. All known, and none negative."""
    rows = [line.replace(",", " ").split() for line in read_text(path).splitlines() if line.strip()]
    if not rows or any(len(row) != len(rows[0]) for row in rows):
        raise DataError(f"{path}: is no table of numbers: its lines have different numbers of them")
    try:
        values = np.array([[float(word.lower().replace("d", "e")) for word in row] for row in rows]).T
    except ValueError as error:
        raise DataError(f"{path}: is no table of numbers ({error})") from None
    wrong = ~(np.isfinite(values) & (values >= 0))
    if wrong.any():
        x, y = (int(index) for index in np.argwhere(wrong)[0])
        raise DataError(f"{path}: line {y + 1}, number {x + 1} is {values[x, y]}: it must be finite and at least 0")
    return values


# ---- plain arrays


def _numpy_array(path: Path) -> np.ndarray:
    """The array of a .npy file. Its header is looked at first: it may claim more than there is."""
    try:
        # What is mapped is as large as the file.
        mapped = np.load(path, allow_pickle=False, mmap_mode="r")
    except ValueError as error:
        text = "it holds Python objects, not numbers" if "bject" in str(error) else str(error)
        raise DataError(f"{path}: is no array that can be read ({text}): save plain numbers with numpy.save") from None
    require(3 * mapped.size * 8, f"{path}: reading it", "crop or coarsen it")
    return np.array(mapped)


def _matlab_array(path: Path, options: ReadingOptions) -> tuple[str, np.ndarray]:
    from scipy.io import loadmat, whosmat

    try:
        claims = {name: 8 * math.prod(shape) for name, shape, _ in whosmat(path)}
        total = sum(claims.values())
        if total > HARMLESS and total > LARGEST_COMPRESSION * path.stat().st_size:
            raise DataError(f"{path}: claims {size_text(total)} in a file of {size_text(path.stat().st_size)}")
        require(3 * total, f"{path}: reading it", "crop or coarsen it")
        content = loadmat(path)
    except (DataError, MemoryError):
        raise
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
    return next(iter(arrays.items()))


def _read_array(path: Path, name: str, values: np.ndarray, options: ReadingOptions) -> CloudVolume:
    if values.ndim != 3 or values.dtype.kind not in "fiu":
        raise DataError(f"{path}: has the shape {values.shape} and type {values.dtype}: it must hold 3-D numbers")
    if not values.size:
        raise DataError(f"{path}: has the shape {values.shape}: it holds nothing")
    if options.spacing is None:
        raise DataError(f"{path}: an array tells no spacing: add --spacing DX DY DZ (km)")
    if sorted(options.order) != ["x", "y", "z"]:
        raise DataError(f"--order {options.order}: must be a permutation of xyz")
    _refuse_dimensions(path, options)
    if options.variable is not None and name != options.variable:
        raise DataError(f"{path}: --variable {options.variable} has no effect: the file has one array; leave it out")
    values = values.transpose([options.order.index(axis) for axis in "xyz"]).astype(np.float64)
    kind, factor = field_kind(path, options.units or "km-1")
    if kind == "mixing ratio":
        raise DataError(f"{path}: a mixing ratio needs the density of air: multiply with it, and use g m-3")
    field = Quantity(name, kind, values * factor, options.units or "km-1", options.units is not None)
    rows = (("x, y, z", f"the array's axes {options.order}, voxels by --spacing, from 0"),)
    return cloud_volume(path, field, box_edges(values.shape, options.spacing), None, options, rows)
