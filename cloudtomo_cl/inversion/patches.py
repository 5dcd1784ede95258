"""The patches of a grid: a small box of voxels around each voxel."""

from __future__ import annotations

import math

import numpy as np

from cloudtomo_cl.inversion.voxels import Voxels


class Patches:
    """The patches around a grid's voxels that hold at least one voxel of a mask.

    Beyond the edges of the grid the nearest voxel is repeated, as for the smoothness prior.

    Parameters
    ----------
    voxels : grid and mask of the voxels
    size : size of a patch, voxels along x, y, z, odd numbers

    Attributes
    ----------
    centres : voxels in the patches' centres, shape (patches, 3)
    values : number of values of a patch
    """

    def __init__(self, voxels: Voxels, size: tuple[int, int, int]) -> None:
        self.voxels = voxels
        margins = [(n // 2, n // 2) for n in size]
        mask = np.pad(voxels.mask, margins, mode="edge")
        held = np.lib.stride_tricks.sliding_window_view(mask, size).any(axis=(3, 4, 5))
        self.centres = np.argwhere(held)
        numbers = np.arange(mask.size).reshape(mask.shape)
        # Indices in the padded grid: each patch's first voxel, and a patch's voxels minus its first.
        self._first = numbers[tuple(slice(n) for n in held.shape)][held]
        self._offsets = numbers[tuple(slice(n) for n in size)].ravel()
        unpadded = np.arange(voxels.mask.size).reshape(voxels.mask.shape)
        self._unpadded = np.pad(unpadded, margins, mode="edge").ravel()
        self.values = math.prod(size)

    def __len__(self) -> int:
        return len(self._first)

    def add(self, sums: np.ndarray, chosen: np.ndarray, values: np.ndarray) -> None:
        """Adds values of chosen patches, shape (patches, values), to sums on the padded grid, in place."""
        for index, offset in enumerate(self._offsets):
            # All patches have different first voxels, so no index occurs twice.
            sums[self._first[chosen] + offset] += values[:, index]

    def on_voxels(self, sums: np.ndarray) -> np.ndarray:
        """Sums on the padded grid, added up for each voxel of the mask, shape (voxels,), float64."""
        folded = np.bincount(self._unpadded, sums, self.voxels.mask.size)
        return folded.reshape(self.voxels.mask.shape)[self.voxels.mask]

    def zeros(self) -> np.ndarray:
        """An array for sums on the padded grid, float64, of zeros."""
        return np.zeros(len(self._unpadded))
