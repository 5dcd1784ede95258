"""The patches of a grid: a small box of voxels around each voxel."""

from __future__ import annotations

import math

import numpy as np

from cloudtomo_cl.inversion.voxels import Voxels


class Patches:
    """Patches around the voxels of a grid that hold a voxel of a mask.

    Beyond the edges of the grid stand the nearest voxels, as for the smoothness prior.

    Parameters
    ----------
    voxels : whose values patches have
    size : of a patch along x, y, z, odd

    Attributes
    ----------
    centres : their voxels, shape (patches, 3)
    values : of a patch
    """

    def __init__(self, voxels: Voxels, size: tuple[int, int, int]) -> None:
        self.voxels = voxels
        margins = [(n // 2, n // 2) for n in size]
        mask = np.pad(voxels.mask, margins, mode="edge")
        held = np.lib.stride_tricks.sliding_window_view(mask, size).any(axis=(3, 4, 5))
        self.centres = np.argwhere(held)
        numbers = np.arange(mask.size).reshape(mask.shape)
        # Of each patch its first voxel, and of a patch's voxels how far they are from the first, in the padded grid.
        self._first = numbers[tuple(slice(n) for n in held.shape)][held]
        self._offsets = numbers[tuple(slice(n) for n in size)].ravel()
        own = np.arange(voxels.mask.size).reshape(voxels.mask.shape)
        self._unpadded = np.pad(own, margins, mode="edge").ravel()
        self.values = math.prod(size)

    def __len__(self) -> int:
        return len(self._first)

    def add(self, sums: np.ndarray, chosen: np.ndarray, values: np.ndarray) -> None:
        """Adds patches' values, shape (patches, values), to sums on the padded grid, in place."""
        for index, offset in enumerate(self._offsets):
            # A patch has another first voxel than any other: no sum is added to twice.
            sums[self._first[chosen] + offset] += values[:, index]

    def on_voxels(self, sums: np.ndarray) -> np.ndarray:
        """Sums on the padded grid as those of the voxels, shape (voxels,), float64."""
        folded = np.bincount(self._unpadded, sums, self.voxels.mask.size)
        return folded.reshape(self.voxels.mask.shape)[self.voxels.mask]

    def zeros(self) -> np.ndarray:
        """Sums on the padded grid, float64."""
        return np.zeros(len(self._unpadded))
