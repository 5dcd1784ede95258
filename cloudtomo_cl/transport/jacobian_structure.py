"""Which derivatives of pixels with respect to voxels are kept: some one by one, the others by blocks."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.opencl.device import Device, device_errors
from cloudtomo_cl.opencl.layout import TILE_WIDTH
from cloudtomo_cl.transport.blocks import pixel_blocks, voxel_blocks
from cloudtomo_cl.transport.radiance import RadianceOperator
from cloudtomo_cl.transport.tiles import tiles_of
from cloudtomo_cl.transport.voxel_shares import voxel_shares

# Kernels count slots and entries with unsigned integers of 32 bits.
_MOST_ENTRIES = 2**32 - 1


class Tiles:
    """The tiles of some pixels on a device: slots for the voxels around each pixel's line of sight.

    Attributes
    ----------
    tiles : the kernels' Tile of each pixel, on the device
    start : the first slot of each, and how many there are, on the device, uint32
    start_on_host : the same, int64
    """

    def __init__(self, operator: RadianceOperator) -> None:
        assert operator.mask is not None
        device, shares = operator.device, operator.shares
        tiles = tiles_of(operator.views, shares.taken(operator.pixels), operator.scene, operator.mask)
        slots = tiles["slabs"].astype(np.int64) * TILE_WIDTH**2
        self.start_on_host = np.concatenate([[0], np.cumsum(slots)])
        if self.start_on_host[-1] > _MOST_ENTRIES:
            raise DataError(
                f"the near field of {len(tiles)} pixels and {int(operator.mask.sum())} voxels has more entries than "
                "kernels count: choose fewer pixels or a coarser grid"
            )
        self.tiles = device.constant(tiles)
        self.start = device.constant(self.start_on_host.astype(np.uint32))

    def __len__(self) -> int:
        return len(self.start_on_host) - 1

    def slots(self, first: int, count: int) -> int:
        """How many so many tiles have from one on."""
        return int(self.start_on_host[first + count] - self.start_on_host[first])

    @property
    def arguments(self) -> dict[str, Any]:
        """As kernels take them."""
        return {"tiles": self.tiles, "slot_start": self.start}


class NearEntries:
    """The voxels of the mask that are in tiles, pixel by pixel: rows of a sparse matrix, on a device.

    Attributes
    ----------
    count : of all
    start : of every pixel's, on the device, uint32; on the host, int64: start_on_host
    columns : the entries' voxels, in the order of the mask, on the device, int32
    """

    def __init__(self, device: Device, tiles: Tiles, column: Any, scene_struct: Any) -> None:
        def launch(name: str, **arguments: Any) -> None:
            if len(tiles):
                device.launch(
                    device.kernel("near_field", name), len(tiles), scene=scene_struct, tiles=tiles.tiles, column=column,
                    pixel_count=len(tiles), **arguments,
                )  # fmt: skip

        counts = device.zeros(max(len(tiles), 1), np.uint32)
        launch("count_near", counts=counts)
        self.start_on_host = np.concatenate([[0], np.cumsum(counts.get()[: len(tiles)], dtype=np.int64)])
        self.count = int(self.start_on_host[-1])
        self.start = device.constant(self.start_on_host.astype(np.uint32))
        self.columns = device.empty(max(self.count, 1), np.int32)
        launch("list_near", row_start=self.start, columns=self.columns)


class JacobianStructure:
    """Which entries of a Jacobian are kept one by one, its near field, and the blocks that share the others.

    Parameters
    ----------
    operator : with a mask
    column : of every voxel of the grid, or -1, on the device

    Attributes
    ----------
    device
    pixels, voxels : numbers of rows and columns
    shares : which rank has which pixels: tiles, entries, pixel_block are of this one's
    voxel_shares : which rank has which voxels
    tiles, near : of the near field
    pixel_blocks, voxel_blocks : of the far field, of all ranks
    row_blocks : the pixel blocks that are this rank's
    pixel_block : of every pixel, its number among these, on the device
    block : of every voxel, on the device
    place : of every voxel in the grid, on the device, uint16
    column, scene_struct : as given, and the operator's
    """

    @device_errors("the structure of the derivatives")
    def __init__(self, operator: RadianceOperator, column: Any) -> None:
        assert operator.mask is not None
        self.device, self.column, self.scene_struct = operator.device, column, operator.scene_struct
        self.pixels, self.voxels = len(operator.pixels), int(operator.mask.sum())
        self.shares = operator.shares
        self.voxel_shares = voxel_shares(operator.mask, self.device.ranks)
        self.tiles = Tiles(operator)
        self.near = NearEntries(self.device, self.tiles, column, self.scene_struct)
        self.pixel_blocks = pixel_blocks(operator.views, operator.pixels)
        self.voxel_blocks = voxel_blocks(operator.mask, len(self.pixel_blocks))
        # Blocks are dealt out whole.
        self.row_blocks, row_block = np.unique(self.shares.taken(self.pixel_blocks.of), return_inverse=True)
        constant = self.device.constant
        self.pixel_block = constant(row_block.astype(np.uint32))
        self.block = constant(self.voxel_blocks.of)
        places = np.zeros((self.voxels, 4), np.uint16)
        places[:, :3] = np.argwhere(operator.mask)
        self.place = constant(places)

    @property
    def rows(self) -> int:
        """Number of this rank's pixels."""
        return len(self.shares)
