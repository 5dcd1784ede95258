"""The radiance table inside a cloud, as kernels take it, and the memory that it needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.memory import Footprint
from cloudtomo_cl.transport.cells import most_cells
from cloudtomo_cl.transport.directions import BINS

# In which ranks add up their sums.
SUMMED_PARTS = 32
# Bytes of a table entry: on the device the 64-bit sum, later two floats in its place; on the host one part of the sums,
# where ranks add them up.
_BYTES_PER_ENTRY, _HOST_BYTES = 8, 24 / SUMMED_PARTS
# Kernels count the table's entries with signed integers of 32 bits.
_MOST_ENTRIES = 2**31 - 1


@dataclass(frozen=True, eq=False)
class RadianceTable:
    """The diffuse radiance by cell and bin of directions at one extinction, and the direct sunlight in the cells.

    Cells are the voxels of a mask, or parts of those that are optically deep (cells.py). It is large, and freed with
    the last one who holds it: who makes another one drops it before.

    Attributes
    ----------
    column : of every voxel of the grid, its number among those of the mask, or -1; int32, on the device
    cells : of every voxel of the mask, its first cell, and its parts along x, y, z; on the device
    diffuse : of every cell, source - radiance in the bins, and the source, sr^-1 for a sun of irradiance 1; float32,
        on the device
    sunlight : what droplets scatter of the direct one, a share of the irradiance, by cell; float32, on the device
    """

    column: Any
    cells: Any
    diffuse: DeviceArray
    sunlight: DeviceArray

    def __len__(self) -> int:
        """How many cells there are."""
        return int(self.sunlight.size)

    @property
    def arguments(self) -> dict[str, Any]:
        """The table as kernels take it."""
        return {"column": self.column, "cells": self.cells, "diffuse": self.diffuse, "sunlight": self.sunlight}


def table_footprint(cells: int) -> Footprint:
    """What a `RadianceTable` of so many cells takes; voxels have one each at least, and up to `most_cells`."""
    entries = cells * BINS
    return Footprint(_BYTES_PER_ENTRY * entries, _BYTES_PER_ENTRY * entries, _HOST_BYTES * entries)


def table_growth(voxels: int) -> Footprint:
    """What the table of so many voxels may take beyond a cell each, if they are as deep as can be."""
    least, most = table_footprint(voxels), table_footprint(most_cells(voxels))
    return Footprint(most.device - least.device, most.largest, most.host - least.host)


def require_room(cells: int, device: Device) -> None:
    """DataError or DeviceError if a table of so many cells is more than memory has, or kernels count."""
    what = f"the radiance table of {cells} voxels and parts of such"
    advice = 'choose a smaller mask or grid, or solver type "adam" with gradient = "replay"'
    if cells * BINS > _MOST_ENTRIES:
        raise DataError(f"{what} is more than kernels count: {advice}")
    table_footprint(cells).require(device, what, advice)
