"""Where rays lie in a box."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def clip_to_box(
    start: np.ndarray, step: np.ndarray, lower: np.ndarray, upper: np.ndarray, axes: Sequence[int] = (0, 1, 2)
) -> tuple[np.ndarray, np.ndarray]:
    """Where rays `start + t step`, t >= 0, lie in a box: they do for near <= t <= far (the slab test).

    Parameters
    ----------
    start, step : starting points and directions, shape (..., 3)
    lower, upper : corners of the box, shape (3,)
    axes : axes along which the box is bounded

    Returns
    -------
    near, far : values of t, shape (...); a ray misses the box where near > far
    """
    axes = list(axes)
    with np.errstate(divide="ignore", invalid="ignore"):
        to_lower = (lower - start)[..., axes] / step[..., axes]
        to_upper = (upper - start)[..., axes] / step[..., axes]
    # A ray within the plane of a face gives 0/0: the face does not bound it.
    enters = np.nan_to_num(np.minimum(to_lower, to_upper), nan=-np.inf).max(axis=-1)
    leaves = np.nan_to_num(np.maximum(to_lower, to_upper), nan=np.inf).min(axis=-1)
    return np.maximum(enters, 0.0), leaves
