"""Missing values: one rule for all that is read.

A value is missing if it is NaN, masked, one of the values that its variable's attributes call missing (`_FillValue`,
`missing_value` and their other spellings), outside of its valid range, or what the netCDF library leaves where nothing
was written. It becomes NaN when the file is opened, before anything else looks at it; whoever needs the value then
refuses it (`require_present`). Nothing takes a missing value for clear air, unless somebody says so.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cloudtomo_cl.errors import DataError

if TYPE_CHECKING:
    import xarray as xr

# Attributes that name missing values, without case and underscores: those of CF and those that others write.
_FILL_ATTRIBUTES = (
    "fillvalue", "missingvalue", "missing", "missval", "missingval", "missvalue", "nodata", "nodatavalue", "fill",
    "codemissing", "missingdata",
)  # fmt: skip
_RANGE_ATTRIBUTES = ("validrange", "validmin", "validmax")
_SCALE_ATTRIBUTES = ("scalefactor", "addoffset")
# What the netCDF library leaves where nothing was written (netcdf.h), by NumPy's type; bytes have none.
_DEFAULT_FILLS = {
    "i2": -32767, "u2": 65535, "i4": -2147483647, "u4": 4294967295, "i8": -9223372036854775806,
    "u8": 18446744073709551614, "f4": 9.9692099683868690e36, "f8": 9.9692099683868690e36,
}  # fmt: skip
# A number that programs write for "missing" without saying so; as a value of what is read here it is none.
_UNDECLARED = (-1.0, -9.0, -99.0, -99.9, -999.0, -999.9, -9999.0, -9999.9, -99999.0, -32767.0, -32768.0)
_BEYOND = 1e15


def _short(name: Any) -> str:
    return str(name).lower().replace("_", "")


def decoded(path: Any, name: Any, variable: xr.Variable) -> xr.Variable:
    """A variable as its attributes mean it: NaN where values are missing, unpacked in double precision.

    Parameters
    ----------
    path, name : what errors call the file and the variable
    variable : as it is stored, or as xarray has decoded it already

    Raises
    ------
    DataError : an attribute that says what is missing, or how values are packed, is no number
    """
    import xarray as xr

    if variable.dtype.kind not in "fiu":
        return variable
    attributes = {_short(key): key for key in variable.attrs}
    values = np.asarray(variable.values)
    if values.dtype.kind == "i" and str(variable.attrs.get("_Unsigned", "false")).lower() == "true":
        values = values.view(values.dtype.str.replace("i", "u"))
    numbers = _Attributes(path, name, variable)
    absent = _declared(values, numbers, attributes) | _never_written(values)
    absent |= _outside(values, numbers, attributes, variable)
    scale = numbers.one(attributes.get("scalefactor"), 1.0)
    offset = numbers.one(attributes.get("addoffset"), 0.0)
    packed = "scalefactor" in attributes or "addoffset" in attributes
    if packed and not (np.isfinite([scale, offset]).all() and scale != 0):
        raise DataError(f"{path}: {name} has the scale_factor {scale} and add_offset {offset}: correct the file")
    if packed:
        values = values.astype(np.float64) * scale + offset
    if absent.any():
        values = np.where(absent, np.nan, values.astype(np.float64) if values.dtype.kind in "iu" else values)
    done = {*_FILL_ATTRIBUTES, *_RANGE_ATTRIBUTES, *_SCALE_ATTRIBUTES, "unsigned"}
    kept = {key: _plain_text(value) for key, value in variable.attrs.items() if _short(key) not in done}
    encoding = {key: value for key, value in variable.encoding.items() if key in ("units", "bounds")}
    return xr.Variable(variable.dims, values, kept, encoding)


def _plain_text(value: Any) -> Any:
    """Text, where an attribute holds it as bytes or as the only entry of an array."""
    if isinstance(value, np.ndarray) and value.size == 1 and value.dtype.kind in "OSU":
        value = value.ravel()[0]
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


class _Attributes:
    """A variable's attributes as numbers."""

    def __init__(self, path: Any, name: Any, variable: xr.Variable) -> None:
        self.path, self.name, self.attributes = path, name, variable.attrs

    def all(self, key: Any) -> np.ndarray:
        value = self.attributes[key]
        try:
            words = value.replace(",", " ").split() if isinstance(value, str) else value
            return np.atleast_1d(np.asarray(words, dtype=np.float64)).ravel()
        except (TypeError, ValueError):
            text = f"{self.path}: {self.name} has the attribute {key} = {value!r}, which is no number: correct it"
            raise DataError(text) from None

    def one(self, key: Any, default: float) -> float:
        if key is None:
            return default
        numbers = self.all(key)
        if len(numbers) != 1:
            raise DataError(f"{self.path}: {self.name} has {len(numbers)} numbers in {key}: it must be one")
        return float(numbers[0])


def _declared(values: np.ndarray, numbers: _Attributes, attributes: dict[str, Any]) -> np.ndarray:
    """Where a value is one that the attributes call missing."""
    found = np.isnan(values) if values.dtype.kind == "f" else np.zeros(values.shape, bool)
    for short in _FILL_ATTRIBUTES:
        if short not in attributes:
            continue
        for number in numbers.all(attributes[short]):
            if np.isnan(number):
                continue
            if values.dtype.kind == "f":
                # In the values' own precision: -999.9 in double is another number than in single.
                with np.errstate(over="ignore"):
                    found |= values == values.dtype.type(number)
            elif number == np.floor(number):
                found |= values == int(number)
                if values.dtype.kind == "u" and number < 0:
                    found |= values == int(number) % 2 ** (8 * values.dtype.itemsize)
    return found


def _never_written(values: np.ndarray) -> np.ndarray:
    fill = _DEFAULT_FILLS.get(values.dtype.newbyteorder("=").str[1:])
    if fill is None:
        return np.zeros(values.shape, bool)
    if values.dtype.kind == "f":
        return np.isclose(values, fill, rtol=1e-6, atol=0.0)
    return values == fill


def _outside(values: np.ndarray, numbers: _Attributes, attributes: dict[str, Any], variable: xr.Variable) -> np.ndarray:
    """Where a value lies outside of its valid range, which is given in packed values if the values are packed."""
    lower, upper = -np.inf, np.inf
    if "validrange" in attributes:
        both = numbers.all(attributes["validrange"])
        if len(both) != 2:
            raise DataError(f"{numbers.path}: {numbers.name} has a valid_range of {len(both)} numbers: it must have 2")
        lower, upper = both
    lower = numbers.one(attributes.get("validmin"), lower)
    upper = numbers.one(attributes.get("validmax"), upper)
    stored = variable.encoding.get("dtype")
    scale, offset = variable.encoding.get("scale_factor"), variable.encoding.get("add_offset")
    if (scale is not None or offset is not None) and stored is not None and np.dtype(stored).kind in "iu":
        # xarray has unpacked the values, and left the range as it was.
        ends = np.array([lower, upper]) * (1.0 if scale is None else scale) + (0.0 if offset is None else offset)
        lower, upper = ends.min(), ends.max()
    if lower == -np.inf and upper == np.inf:
        return np.zeros(values.shape, bool)
    if values.dtype.kind == "f":
        # Ends are as precise as the values: 0.3 in double is below the same number in single.
        slack = 4 * np.finfo(values.dtype).eps
        lower, upper = lower - slack * abs(lower), upper + slack * abs(upper)
    return (values < lower) | (values > upper)


def decode_all(path: Any, dataset: xr.Dataset) -> xr.Dataset:
    """A dataset all of whose variables are `decoded`. Doing it twice changes nothing."""
    import xarray as xr

    variables = {name: decoded(path, name, variable) for name, variable in dataset.variables.items()}
    coordinates = {name: variable for name, variable in variables.items() if name in dataset.coords}
    others = {name: variable for name, variable in variables.items() if name not in dataset.coords}
    return xr.Dataset(others, coordinates, dataset.attrs)


def require_present(path: Any, name: str, values: np.ndarray, remedy: str, among: np.ndarray | None = None) -> None:
    """Refuses missing values.

    Parameters
    ----------
    path, name : of what is read
    values : any shape; NaN is missing
    remedy : ends the message: what to do
    among : bool, the values' shape: where they are needed; by default everywhere

    Raises
    ------
    DataError : a needed value is missing; it tells how many, and the first one's place
    """
    wrong = np.isnan(values) if among is None else np.isnan(values) & among
    if wrong.any():
        where = tuple(int(index) for index in np.argwhere(wrong)[0])
        raise DataError(
            f"{path}: {name} is missing in {int(wrong.sum())} of {wrong.size} voxels, first at {where} "
            f"(NaN, masked, a fill value, or outside of its valid range): {remedy}"
        )


def undeclared_fill(values: np.ndarray) -> np.ndarray:
    """Where a value that must not be negative looks like a program's mark for "missing" that no attribute tells."""
    with np.errstate(invalid="ignore"):
        single = np.array(_UNDECLARED, np.float32)
        return np.isin(values, single) | np.isin(values, _UNDECLARED) | (np.abs(values) >= _BEYOND)
