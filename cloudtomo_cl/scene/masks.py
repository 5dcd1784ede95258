"""Masks: which voxels of a grid may hold cloud."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.arrays import unmasked
from cloudtomo_cl.scene.grid import Grid


def checked_mask(mask: Any, grid: Grid) -> np.ndarray:
    """A mask as bool, shape of the grid.

    Parameters
    ----------
    mask : voxels that may hold cloud, bool, or numbers 0 and 1 as in files, shape of the grid

    Raises
    ------
    DataError : the mask has another shape or other values, is missing in a voxel, or has no voxel; it makes no array
        (InvalidArgumentError)
    """
    mask = unmasked(mask, "mask")
    if mask.shape != grid.shape:
        raise DataError(f"mask has shape {mask.shape}, the grid {grid.shape}")
    if mask.dtype.kind != "b":
        mask = _of_numbers(mask)
    if not mask.any():
        raise DataError(
            "the mask is empty: no voxel may hold cloud. If images, views and surface are right, the sky is clear: "
            "there is nothing to recover"
        )
    return mask


def _of_numbers(mask: np.ndarray) -> np.ndarray:
    if mask.dtype.kind not in "iuf":
        raise DataError(f"mask is of type {mask.dtype}: it must be bool, or numbers 0 and 1")
    missing, wrong = np.isnan(mask), (mask != 0) & (mask != 1)
    if missing.any():
        raise DataError(
            f"the mask: cloud is missing in {int(missing.sum())} of {mask.size} voxels, first at {_first(missing)} "
            "(NaN or masked): say of every voxel whether it may hold cloud"
        )
    if wrong.any():
        raise DataError(
            f"mask at voxel {_first(wrong)} is {mask[_first(wrong)]}: it must be 1 (or True) where there may be cloud "
            "and 0 (or False) elsewhere; of an extinction give mask=extinction > 0"
        )
    return mask == 1


def _first(wrong: np.ndarray) -> tuple[int, ...]:
    return tuple(int(index) for index in np.argwhere(wrong)[0])
