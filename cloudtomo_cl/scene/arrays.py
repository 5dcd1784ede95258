"""Arrays as people give them: what is masked is missing."""

from __future__ import annotations

from typing import Any

import numpy as np


def filled(values: Any) -> np.ndarray:
    """An array with NaN where a masked array is masked; any other array as it is."""
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        if values.dtype.kind not in "f":
            values = values.astype(np.float64)
        return np.ma.filled(values, np.nan)
    return np.asarray(values)
