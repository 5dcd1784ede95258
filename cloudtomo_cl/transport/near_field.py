"""The near field of a Jacobian: the voxels around the pixels' lines of sight, which have an entry each."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.opencl.layout import TILE_WIDTH, places
from cloudtomo_cl.transport.radiance import RadianceOperator
from cloudtomo_cl.transport.tiles import tiles_of

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


class NearField:
    """The voxels of the mask that are in tiles, pixel by pixel: rows of a sparse matrix, on a device.

    Parameters
    ----------
    operator : with a mask
    column : of every voxel of the grid, or -1, on the device

    Attributes
    ----------
    tiles : of this rank's pixels
    place : of every voxel of the mask in the grid, on the device, uint16
    count : of all entries
    start : of every pixel's, on the device, uint32; on the host, int64: start_on_host
    columns : the entries' voxels, in the order of the mask, on the device, int32
    """

    def __init__(self, operator: RadianceOperator, column: Any) -> None:
        assert operator.mask is not None
        device, self._scene, self._column = operator.device, operator.scene_struct, column
        self.tiles = Tiles(operator)
        self.place = device.constant(places(np.argwhere(operator.mask)))
        pixels = len(self.tiles)

        def launch(name: str, **arguments: Any) -> None:
            if pixels:
                device.launch(
                    device.kernel("near_field", name), pixels, scene=self._scene, tiles=self.tiles.tiles, column=column,
                    pixel_count=pixels, **arguments,
                )  # fmt: skip

        counts = device.zeros(max(pixels, 1), np.uint32)
        launch("count_near", counts=counts)
        self.start_on_host = np.concatenate([[0], np.cumsum(counts.get()[:pixels], dtype=np.int64)])
        self.count = int(self.start_on_host[-1])
        self.start = device.constant(self.start_on_host.astype(np.uint32))
        self.columns = device.empty(max(self.count, 1), np.int32)
        launch("list_near", row_start=self.start, columns=self.columns)

    @property
    def arguments(self) -> dict[str, Any]:
        """Slots and entries as kernels take them that go from the ones to the others."""
        return self.tiles.arguments | {"scene": self._scene, "column": self._column, "row_start": self.start}
