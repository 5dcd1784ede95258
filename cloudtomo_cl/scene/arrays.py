"""Arrays as users give them: masked values become NaN, and named dimensions are put into this package's order."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloudtomo_cl.errors import InvalidArgumentError

# Orders of named dimensions in this package's arrays. (Its files, as CF recommends, have z first.)
_ORDERS = (("x", "y", "z"), ("row", "column"), ("view", "row", "column"))


def unmasked(values: Any, name: str = "the array") -> np.ndarray:
    """An array with NaN for masked values, and the dimensions of an xarray.DataArray in this package's order.

    name : what errors call the array

    Raises
    ------
    InvalidArgumentError : its rows are not of one length
    """
    dims = getattr(values, "dims", None)
    if isinstance(dims, tuple):
        order = next((order for order in _ORDERS if sorted(order) == sorted(map(str, dims))), dims)
        values = values.transpose(*order).values
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        if values.dtype.kind not in "f":
            values = values.astype(np.float64)
        return np.ma.filled(values, np.nan)
    try:
        return np.asarray(values)
    except (TypeError, ValueError) as error:
        raise InvalidArgumentError(f"{name} makes no array ({error}): give all rows as many numbers") from None


def real_numbers(values: Any, name: str) -> np.ndarray:
    """As `unmasked`, in its own precision; in double precision, if it has none.

    Raises
    ------
    InvalidArgumentError : they are text, complex or no numbers, or beyond double precision
    """
    array = unmasked(values, name)
    if array.dtype.kind in "biuf":
        return array
    kind = f"of type {type(values).__name__}"
    if array.dtype.kind == "c":
        raise InvalidArgumentError(f"{name} is complex: it must be real numbers")
    try:
        if array.dtype.kind == "O":
            return array.astype(np.float64)
    except (TypeError, ValueError):
        pass
    except OverflowError:
        raise InvalidArgumentError(f"{name} is {kind} and holds a number beyond 1e308: it must be less") from None
    raise InvalidArgumentError(f"{name} is {kind} and holds no numbers: it must be an array of them")


def as_numbers(values: Any, name: str) -> np.ndarray:
    """As `real_numbers`, in double precision."""
    return real_numbers(values, name).astype(np.float64, copy=False)
