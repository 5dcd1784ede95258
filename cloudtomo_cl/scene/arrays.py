"""Arrays as people give them: what is masked is missing, and named dimensions come in their order."""

from __future__ import annotations

from typing import Any

import numpy as np

# Of arrays whose dimensions have names: files of this package, as CF recommends, have z first.
_ORDERS = (("x", "y", "z"), ("row", "column"), ("view", "row", "column"))


def filled(values: Any) -> np.ndarray:
    """An array with NaN where a masked array is masked, and an xarray.DataArray in our order; any other as it is."""
    dims = getattr(values, "dims", None)
    if isinstance(dims, tuple):
        order = next((order for order in _ORDERS if sorted(order) == sorted(map(str, dims))), dims)
        values = values.transpose(*order).values
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        if values.dtype.kind not in "f":
            values = values.astype(np.float64)
        return np.ma.filled(values, np.nan)
    return np.asarray(values)
