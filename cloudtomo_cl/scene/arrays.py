"""Arrays as users give them: masked values become NaN, and named dimensions are put into this package's order."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloudtomo_cl.errors import InvalidArgumentError

# Orders of named dimensions in this package's arrays. (Its files, as CF recommends, have z first.)
_ORDERS = (("x", "y", "z"), ("row", "column"), ("view", "row", "column"))


def unmasked(values: Any) -> np.ndarray:
    """An array with NaN for masked values, and the dimensions of an xarray.DataArray in this package's order."""
    dims = getattr(values, "dims", None)
    if isinstance(dims, tuple):
        order = next((order for order in _ORDERS if sorted(order) == sorted(map(str, dims))), dims)
        values = values.transpose(*order).values
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        if values.dtype.kind not in "f":
            values = values.astype(np.float64)
        return np.ma.filled(values, np.nan)
    return np.asarray(values)


def as_numbers(values: Any, name: str) -> np.ndarray:
    """As `unmasked`, in double precision. InvalidArgumentError if they are no numbers.

    name : what errors call the array
    """
    array = unmasked(values)
    try:
        return array.astype(np.float64, copy=False)
    except (TypeError, ValueError):
        kind = type(values).__name__
        raise InvalidArgumentError(
            f"{name} is of type {kind} and holds no numbers: it must be an array of them"
        ) from None
