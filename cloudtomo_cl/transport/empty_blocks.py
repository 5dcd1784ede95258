"""Blocks of voxels without cloud, which walks cross in one step (kernels/walk/grid.h)."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.scene.scene import Scene

# Blocks along an axis, at most: their table stays in a processor's second-level cache.
_MOST_BLOCKS = 64
# Copies of a periodic domain that are looked at beside it, in blocks; the most a walk skips.
_PERIODIC_MARGIN = 32
_LARGEST_SKIP = 255


def empty_shift(scene: Scene) -> int:
    """Walks skip blocks of 2^empty_shift voxels along each axis; a periodic domain's ends with a whole one."""
    shape, shift = scene.grid.shape, 0
    periodic = scene.boundary.horizontal == "periodic"
    while max(shape) > _MOST_BLOCKS << shift and not (periodic and (shape[0] | shape[1]) & 1 << shift):
        shift += 1
    return shift


def occupied_blocks(occupied: np.ndarray, shift: int) -> np.ndarray:
    """Which blocks of 2^shift voxels along each axis hold an occupied one; those at the ends may be smaller."""
    for axis in range(occupied.ndim):
        occupied = np.logical_or.reduceat(occupied, np.arange(0, occupied.shape[axis], 1 << shift), axis)
    return occupied


def empty_distances(occupied: np.ndarray, periodic: bool) -> np.ndarray:
    """How far from every block the nearest occupied one is, in blocks along the axis where it is most.

    Parameters
    ----------
    occupied : bool, shape (blocks along x, y, z)
    periodic : whether the domain is repeated horizontally

    Returns uint8, same shape: 0 where occupied, 1 beside it, at most 255.
    """
    # Beyond the margin nothing is known of a periodic domain's copies, and a walk wraps once at most.
    largest = min(_PERIODIC_MARGIN, *occupied.shape[:2]) if periodic else _LARGEST_SKIP
    if not occupied.any():
        return np.full(occupied.shape, largest, np.uint8)
    distances, reached = np.zeros(occupied.shape, np.uint8), occupied
    # SciPy has this (ndimage), but to import it takes half as long as all the rest of a small render.
    for _ in range(largest):
        if reached.all():
            break
        distances += ~reached
        for axis in range(3):
            reached = _spread(reached, axis, periodic and axis < 2)
    return distances


def _spread(reached: np.ndarray, axis: int, wraps: bool) -> np.ndarray:
    """With the blocks beside them along an axis."""
    before = np.moveaxis(reached, axis, 0)
    after = before.copy(order="K")
    after[1:] |= before[:-1]
    after[:-1] |= before[1:]
    if wraps:
        after[0] |= before[-1]
        after[-1] |= before[0]
    return np.moveaxis(after, 0, axis)
