"""The grid with margins of zeros around it, so that no patch or tile of the patch prior reads beyond an array."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.inversion.patch_kernels import LANES
from cloudtomo_cl.inversion.vectors import Vectors
from cloudtomo_cl.opencl.arrays import DeviceArray


class Halo:
    """An array on the device with the values of the grid's voxels, and margins.

    Parameters
    ----------
    mask : voxels that have values; the others are 0
    size : of a patch, voxels along x, y, z: margins are one voxel less
    vectors : with an element for each voxel of the mask

    Attributes
    ----------
    shape : of the array; along z the grid's voxels end with a whole tile
    values : the array, float32
    place : of every voxel of the mask, its index in the array, on the device, uint32
    """

    def __init__(self, mask: np.ndarray, size: tuple[int, int, int], vectors: Vectors) -> None:
        margins, device = np.array(size) - 1, vectors.device
        whole = [*mask.shape[:2], -(-mask.shape[2] // LANES) * LANES]
        self._vectors, self.shape = vectors, tuple(np.array(whole) + 2 * margins)
        place = np.ravel_multi_index(tuple((np.argwhere(mask) + margins).T), self.shape)
        self.place = device.constant(place.astype(np.uint32))
        self.values = device.zeros(self.shape, np.float32)

    def spread(self, x: DeviceArray, scale: float = 1.0) -> None:
        """Writes scale times the voxels' values, shape (voxels,), into the array."""
        self._vectors.launch("spread_values", factor=scale, place=self.place, x=x, values=self.values)
