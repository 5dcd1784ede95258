"""A Jacobian by columns: of one rank a copy of its rows' values in another order; else every rank has its voxels'.

A product with the transpose adds up, for every voxel, what all pixels bring, in the order of the pixels. Ranks that
have the rows of some pixels each would have to add their parts, and the bits would follow from their number. So every
rank has the columns of some voxels, whole, too: values change places once in an iteration, and products exchange no
more than vectors.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.parallel.ranks import Shares
from cloudtomo_cl.transport.exchanged_columns import ExchangedColumns
from cloudtomo_cl.transport.jacobian_structure import JacobianStructure

# Sums over blocks are made in parts of so many, and transposed ones for so many columns at a time (products.cl).
FAR_PART, COLUMNS_AT_ONCE = 128, 8
PRODUCT_FEATURES = (f"FAR_PART {FAR_PART}u", f"WIDTH {COLUMNS_AT_ONCE}u")


class JacobianColumns(Protocol):
    """A Jacobian's near and far field by columns, as kernels take them; of voxels of other ranks there are none.

    Attributes
    ----------
    shares : which rank has which voxels
    blocks : the voxel blocks of this rank's voxels
    block : of every voxel, among these, on the device; of other ranks' voxels any
    pixel_block : of every pixel, on the device
    start, rows : of all columns: where they begin, and their entries' pixels
    near, far : values of the entries, in the order of the columns; of the blocks, [pixel block][voxel block]
    """

    shares: Shares
    blocks: np.ndarray
    block: Any
    pixel_block: Any
    start: Any
    rows: Any
    near: DeviceArray
    far: DeviceArray

    def refresh(self) -> None:
        """Takes values over that have changed by rows."""
        ...


def columns_of(structure: JacobianStructure, near: DeviceArray, far: DeviceArray) -> JacobianColumns:
    """Those of a Jacobian whose values by rows, of this rank's pixels, stand in two arrays."""
    if structure.shares.ranks.size == 1:
        return _Reordered(structure, near, far)
    return ExchangedColumns(structure, near, far)


class _Reordered:
    """One rank has all rows: its columns have the same values in another order."""

    def __init__(self, structure: JacobianStructure, near: DeviceArray, far: DeviceArray) -> None:
        import scipy.sparse

        entries, shape = structure.near, (structure.pixels, structure.voxels)
        columns = structure.device.copied(entries.columns)[: entries.count]
        numbers = np.arange(entries.count, dtype=np.uint32)
        by_column = scipy.sparse.csr_matrix((numbers, columns, entries.start_on_host), shape).tocsc()
        del columns, numbers
        self._device, self._count, self._by_row = structure.device, entries.count, near
        self.shares = structure.voxel_shares
        self.blocks = np.arange(len(structure.far.voxel_blocks))
        self.block, self.pixel_block = structure.far.voxel_block, structure.far.pixel_block
        constant = structure.device.constant
        self.start = constant(by_column.indptr.astype(np.uint32))
        self._entries = constant(by_column.data)
        self.rows = constant(by_column.indices.astype(np.uint32))
        self.near, self.far = self._device.zeros(max(self._count, 1), np.float32), far

    def refresh(self) -> None:
        if self._count:
            kernel = self._device.kernel("products", "near_by_column", PRODUCT_FEATURES)
            self._device.launch(
                kernel, self._count, count=self._count, entries=self._entries, values=self._by_row, result=self.near
            )
