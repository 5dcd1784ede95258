"""netCDF files: reading them whole, writing them whole, and what their variables must be.

xarray and the netCDF library are imported where they are used: importing this package is fast.
"""

from __future__ import annotations

import json
import math
import os
import re
import stat
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from numbers import Number
from pathlib import Path
from typing import TYPE_CHECKING, Any, Union

import numpy as np

from cloudtomo_cl.arguments import MAPPING, PATH, Kind, a, require_kinds
from cloudtomo_cl.errors import DataError, InvalidArgumentError
from cloudtomo_cl.files.missing import decode_all
from cloudtomo_cl.files.units import RADIANCE, Unit, parse_unit
from cloudtomo_cl.files.whole import check_apart, check_target, written_whole
from cloudtomo_cl.memory import require, size_text
from cloudtomo_cl.versions import version_of

if TYPE_CHECKING:
    import xarray as xr

CONVENTIONS = "CF-1.10"
REFERENCES = (
    "Loeub, Levis, Holodovsky, Schechner 2020: Monotonicity Prior for Cloud Tomography, ECCV 2020, "
    "doi:10.1007/978-3-030-58523-5_17"
)
# Endings of the names of netCDF files; one without says nothing else.
ENDINGS = (".nc", ".nc4", ".cdf", ".netcdf", "")
AXES = ("x", "y", "z")
# What files are read from: their names, or what they hold, in memory.
Source = Union[str, "os.PathLike[str]", "xr.Dataset", "xr.DataArray"]
# A file that claims to hold so many bytes for each of its own holds nothing: what is compressed best (zeros, by
# deflate) has 1000.
LARGEST_COMPRESSION = 2000
# Attributes by which others than CF pack numbers.
_OTHER_SCALES = re.compile(r"(.*_)?(scales?|scaling|offsets?|slope|intercept|gain)(_?factor)?", re.I)
# Below this, no claim takes time or memory.
HARMLESS = 1 << 26


def is_netcdf(path: Path) -> bool:
    """By the first bytes; what cannot be read is no netCDF file."""
    try:
        if not path.is_file():  # nothing waits for a pipe
            return False
        with open(path, "rb") as file:
            return file.read(4) in (b"\x89HDF", b"CDF\x01", b"CDF\x02", b"CDF\x05")
    except OSError:
        return False


def name_of(source: Source) -> str:
    """How errors call what is read."""
    return str(source) if isinstance(source, (str, os.PathLike)) else f"the {type(source).__name__}"


def load_dataset(source: Source) -> xr.Dataset:
    """The whole file in memory, as its attributes mean it: missing values are NaN, packed ones unpacked (`missing`).

    A dataset is in memory already, and a DataArray becomes one.

    Raises
    ------
    DataError : no such file, not netCDF, cut short, or larger than this machine's memory
    """
    import xarray as xr

    if isinstance(source, xr.Dataset):
        return decode_all(name_of(source), source)
    if isinstance(source, xr.DataArray):
        return decode_all(name_of(source), source.to_dataset(name=source.name or "extinction"))
    require_kinds("reading", path=(source, PATH))
    path = Path(source)
    require_file(path)
    try:
        with name_for_netcdf(path) as name:
            _require_size(path, name)
            # Times and other CF encodings that a foreign file may have are none of our business.
            with xr.open_dataset(name, engine="netcdf4", decode_times=False, mask_and_scale=False) as dataset:
                loaded = dataset.load()
        _check_classic(path)
        return decode_all(path, loaded)
    except (DataError, MemoryError):
        raise
    except Exception as error:  # what a damaged file may raise has no end
        if _is_locked(path):
            raise DataError(
                f"{path}: another program has it open for writing: close it there, or wait until it is written"
            ) from None
        text = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise DataError(
            f"{path}: not a netCDF file, or damaged or cut short ({text}): check or copy it again; "
            f"clouds in other formats become netCDF by `cloudtomo cloud FILE --output cloud.nc`"
        ) from None


def _is_locked(path: str | os.PathLike[str]) -> bool:
    """Whether another program has locked a file, as the netCDF library does that writes it."""
    try:
        import fcntl
    except ImportError:  # Windows
        return False
    try:
        with open(path, "rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def require_file(path: Path) -> None:
    """Checks that there is a regular file, so that nothing waits for a pipe. DataError if not."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        raise DataError(f"{path}: no such file") from None
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "a pipe or a device"
        raise DataError(f"{path}: no such file: it is {kind}; copy what it gives to a file first")


@contextmanager
def name_for_netcdf(path: str | os.PathLike[str]) -> Iterator[str]:
    """Gives a name by which the netCDF library finds a file that is there.

    The library reads names in its own way: what begins with a space, or as C:/ or a URL does, means something else to
    it, unless the name is absolute, and a backslash is a slash to it on every system. Then a link stands in.
    """
    name = os.path.abspath(path)
    if os.sep == "\\" or "\\" not in name:
        yield name
        return
    with tempfile.TemporaryDirectory(prefix="cloudtomo-") as folder:
        link = os.path.join(folder, "file.nc")
        os.symlink(name, link)
        yield link


def _require_size(path: Path, name: str) -> None:
    """Checks what a file claims to hold before any of it is read: compressed, a small file may hold gigabytes.

    name : of the file, for the netCDF library
    """
    import netCDF4

    with netCDF4.Dataset(name) as file:
        claims = {
            name: np.dtype(variable.dtype if variable.dtype is not str else object).itemsize
            * math.prod(map(int, variable.shape))
            for name, variable in file.variables.items()
        }
    total = sum(claims.values())
    if total > HARMLESS and total > LARGEST_COMPRESSION * path.stat().st_size:
        name = max(claims, key=lambda key: claims[key])
        raise DataError(
            f"{path}: {name} claims {size_text(claims[name])} in a file of {size_text(path.stat().st_size)}: most of "
            f"it was never written: write the file again with the sizes that it has"
        )
    # Beside the values there are copies in double precision, and the index of a coordinate.
    require(3 * total, f"{path}: reading it", "crop or coarsen it")


def _check_classic(path: str | os.PathLike[str]) -> None:
    """Raises ValueError if a file in the classic format ends too early.

    The netCDF library reads zeros where such a file was cut off; SciPy's reader notices.
    """
    with open(path, "rb") as file:
        if file.read(4) not in (b"CDF\x01", b"CDF\x02"):
            return
    from scipy.io import netcdf_file

    netcdf_file(path, mmap=False).close()


def check_output(
    path: Path,
    overwrite: bool,
    endings: Sequence[str] = (),
    option: str = "--output",
    inputs: Iterable[Path] = (),
) -> None:
    """Fails before the work, not after it.

    Parameters
    ----------
    endings : that the name may have; any without
    option : of the command line, that the path is from
    inputs : files that are read, of which it may be none

    Raises
    ------
    DataError : a folder, a device, a pipe, protected against writing, in no folder, or there already and not to be
        replaced; a name that stands for another format; one of the inputs
    """
    if endings and path.suffix.lower() not in endings:
        named = " or ".join(ending for ending in endings if ending)
        raise DataError(f"{path}: the name must end in {named}, which is what {option} writes")
    target = check_target(path)
    check_apart(path, inputs, option)
    if target.exists() and not overwrite:
        raise DataError(f"{path}: exists already: choose another {option}, or add --overwrite")


def save_dataset(path: str | os.PathLike[str], dataset: xr.Dataset) -> None:
    """Writes all or nothing: a file of that name is either whole or as it was before."""
    encoding: dict[Any, dict[str, Any]] = {
        name: {"zlib": True, "complevel": 4}
        for name, variable in dataset.data_vars.items()
        if variable.ndim and variable.dtype.kind == "f"
    }
    for name in dataset.variables:
        encoding.setdefault(name, {})
        if name not in ("radiance", "radiance_standard_error", "effective_radius"):
            encoding[name]["_FillValue"] = None
    with written_whole(path) as partial, name_for_netcdf(partial) as name, netcdf_errors():
        dataset.to_netcdf(name, engine="netcdf4", format="NETCDF4", encoding=encoding)


def save_variables(
    path: str | os.PathLike[str],
    title: str,
    variables: Mapping[str, Any],
    coordinates: Mapping[str, Any],
    attributes: Mapping[str, Any] | None,
) -> None:
    """Writes variables and coordinates, each its dimensions, values and attributes, as `save_dataset` does.

    title, attributes : see `file_attributes`
    """
    import xarray as xr

    save_dataset(path, xr.Dataset(variables, coordinates, file_attributes(title, attributes)))


@contextmanager
def netcdf_errors() -> Iterator[None]:
    """Turns what the netCDF library raises where a file cannot be written, such as a full disk's, into OSError."""
    try:
        yield
    except RuntimeError as error:
        raise OSError(str(error)) from None


def number_variable(path: Any, dataset: xr.Dataset, name: str, dims: tuple[str, ...]) -> xr.DataArray:
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
    require_numbers(path, variable)
    return variable.transpose(*dims)


def require_numbers(path: Any, variable: xr.DataArray) -> None:
    """Refuses what is no numbers, and counts that a scale of another name than CF's makes into something else."""
    if variable.dtype.kind not in "fiu":
        raise DataError(f"{path}: {variable.name} has type {variable.dtype}, it must hold numbers")
    for name in variable.attrs:
        if variable.attrs[name] is not None and _OTHER_SCALES.fullmatch(str(name)):
            raise DataError(
                f"{path}: {variable.name} has the attribute {name}, by which its numbers are something else: unpack "
                f"them, or use scale_factor and add_offset"
            )


def unit_factor(path: Any, variable: xr.DataArray, ours: str) -> float:
    """The factor from a variable's unit to ours; a variable without units is taken to be in it already.

    Raises
    ------
    DataError : the unit is not understood, or is one of something else
    """
    return factor_of(path, str(variable.name), variable.attrs.get("units"), ours)[0]


def factor_of(path: Any, name: str, units: Any, ours: str) -> tuple[float, bool]:
    """The factor from a unit to ours, and whether the unit was stated at all.

    Parameters
    ----------
    path, name : what errors call the file and the variable
    units : the attribute, or None
    ours : a unit that `parse_unit` understands

    Raises
    ------
    DataError : the unit is not understood, or is one of something else
    """
    if units is None or (isinstance(units, str) and not units.strip()):
        return 1.0, False
    wanted = parse_unit(ours)
    assert wanted is not None
    unit = parse_unit(units)
    if unit is None or unit.dimension != wanted.dimension:
        hint = ": multiply a spectral radiance with the width of its band first" if _spectral(unit, ours) else ""
        raise DataError(f"{path}: {name} has units '{units}', allowed are {ours} and what converts to it{hint}")
    return unit.factor / wanted.factor, True


def _spectral(unit: Unit | None, ours: str) -> bool:
    radiance = parse_unit(ours)
    return (
        unit is not None
        and radiance is not None
        and radiance.dimension == RADIANCE
        and unit.dimension in ((-1, *RADIANCE[1:]), (1, *RADIANCE[1:]))
    )


def component_coordinate() -> tuple[str, Any, dict[str, str]]:
    """The names x, y, z along the dimension `axis`: a label, which CF lets no coordinate variable be."""
    return "axis", np.array(AXES, dtype=object), {"units": "1", "long_name": "component of a vector"}


def _is_stored(value: Any) -> bool:
    """Whether an attribute of a netCDF file can have a value; mappings become text."""
    if isinstance(value, (str, bytes, Mapping)):
        return True
    if not isinstance(value, (Number, np.ndarray, list, tuple)):
        return False
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        return False
    return array.ndim < 2 and (array.dtype.kind in "iuSU" or array.dtype in (np.float32, np.float64))


_STORED = Kind("text, a number, or a list of them; mappings are stored as JSON", _is_stored)


def file_attributes(title: str, attributes: Mapping[str, Any] | None) -> dict[str, Any]:
    """Attributes as netCDF holds them, with those that CF wants every file to have.

    title : what is in the file, unless `attributes` have one

    Raises
    ------
    InvalidArgumentError : attributes are no mapping, or one of them is nothing that a file or JSON can hold
    """
    require_kinds("writing", attributes=(attributes, MAPPING.or_none()))
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    described: dict[str, Any] = {
        "Conventions": CONVENTIONS,
        "title": title,
        "history": f"{now} written by cloudtomo-cl {version_of()}",
        "references": REFERENCES,
    }
    for name, value in (attributes or {}).items():
        require_kinds("attributes", name=(name, a(str)), **{repr(name): (value, _STORED)})
        described[name] = as_json(f"attributes: {name!r}", value) if isinstance(value, Mapping) else value
    return described


def as_json(what: str, value: Any, indent: int | None = None) -> str:
    """A value as JSON. InvalidArgumentError if it holds what JSON has not."""
    try:
        return json.dumps(value, indent=indent)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise InvalidArgumentError(f"{what} cannot be JSON ({error}): give text, numbers, lists and mappings") from None
