"""The patch prior's stencil: the matrix that couples voxels which share a patch, by tiles (patches.cl)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from cloudtomo_cl.inversion.halo import Halo
from cloudtomo_cl.inversion.patch_kernels import LANES, PatchKernels
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.layout import places
from cloudtomo_cl.opencl.memory import Footprint

# Share of the tiles' voxels that are near cloud, and number of voxels that share a patch of 5 x 5 x 3 with one voxel.
_SHARE_NEAR_CLOUD, _NEIGHBOURS = 0.6, 405


def stencil_footprint(voxels: int) -> Footprint:
    """Memory of a step's stencil for a number of voxels near cloud."""
    size = 4.0 * _NEIGHBOURS * voxels / _SHARE_NEAR_CLOUD
    return Footprint(size, size)


@dataclass(frozen=True, eq=False)
class Stencil:
    """The entries of this rank's tiles near cloud, on the device; its length is the number of these tiles."""

    _kernels: PatchKernels
    _halo: Halo
    _tiles: dict[str, Any]
    _entries: DeviceArray

    def __len__(self) -> int:
        return int(self._tiles["tile_count"])

    def add_product(self, factor: float, result: DeviceArray) -> None:
        """Adds factor times the product with the halo's values to a result, shape (voxels,), for the tiles' voxels."""
        self._kernels.launch(
            "add_stencil_product", len(self), **self._tiles, halo=self._halo.shape,
            stencil=self._entries, values=self._halo.values, factor=factor, result=result,
        )  # fmt: skip


class StencilTiles:
    """This rank's tiles that hold a voxel of the mask; a tile is a row of voxels along z.

    Parameters
    ----------
    mask : of the grid
    is_own : whether each voxel of the mask is this rank's, shape (voxels,); a tile has one owner
    kernels : of patches.cl
    halo : of this mask, by whose values stencils are multiplied
    """

    def __init__(self, mask: np.ndarray, is_own: np.ndarray, kernels: PatchKernels, halo: Halo) -> None:
        self._kernels, self._halo, self._shape = kernels, halo, mask.shape
        along = -(-mask.shape[2] // LANES)
        numbers = np.full((*mask.shape[:2], along * LANES), -1, np.int32)
        numbers[:, :, : mask.shape[2]][mask] = np.arange(len(is_own))
        numbers = numbers.reshape(-1, LANES)
        last = numbers.max(axis=1)
        chosen = np.flatnonzero((last >= 0) & is_own[last])
        x, y, z = np.unravel_index(chosen, (*mask.shape[:2], along))
        self._numbers, self._corners = numbers[chosen], places(np.column_stack([x, y, z * LANES]))
        self._corner = kernels.device.constant(self._corners)

    def assembled(self, component: DeviceArray, precision: Any) -> Stencil:
        """The stencil of the tiles near cloud: elsewhere patches are clear, and their matrix is diagonal.

        component : of each patch, on the grid
        precision : of each component, on the device
        """
        near = self._near_cloud(component)
        count, constant, device = len(near), self._kernels.device.constant, self._kernels.device
        tiles = {
            "tile_count": count, "corner": constant(self._corners[near]), "number": constant(self._numbers[near]),
        }  # fmt: skip
        offsets = [2 * width - 1 for width in self._kernels.size]
        entries = device.empty(max(count, 1) * math.prod(offsets) * LANES, np.float32)
        self._kernels.launch(
            "assemble_stencil", count * math.prod(offsets[:2]) * LANES, **tiles, shape=self._shape,
            component=component, precision=precision, stencil=entries,
        )  # fmt: skip
        return Stencil(self._kernels, self._halo, tiles, entries)

    def _near_cloud(self, component: DeviceArray) -> np.ndarray:
        """Numbers of the tiles with a voxel in a patch with cloud."""
        tiles = len(self._corners)
        reached = self._kernels.device.empty(max(tiles, 1), np.uint8)
        self._kernels.launch(
            "find_tiles", tiles, tile_count=tiles, corner=self._corner, shape=self._shape, component=component,
            reached=reached,
        )  # fmt: skip
        return np.flatnonzero(reached.get()[:tiles])
