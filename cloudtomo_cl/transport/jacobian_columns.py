"""A Jacobian by columns: of one rank a copy of its rows' values in another order; else every rank has its voxels'.

A product with the transpose adds up, for every voxel, what all pixels bring, in the order of the pixels. Ranks that
have the rows of some pixels each would have to add their parts, and the bits would follow from their number. So every
rank has the columns of some voxels, whole, too: values change places once in an iteration, and products exchange no
more than vectors.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.parallel.ranks import Shares
from cloudtomo_cl.transport.jacobian_structure import JacobianStructure

# In which values change hands: what is on its way is small beside what stays.
_PARTS = 8
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
    return _Exchanged(structure, near, far)


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


class _Exchanged:
    """Several ranks: each has the columns of its voxels, whose values the ranks of the pixels send."""

    def __init__(self, structure: JacobianStructure, near: DeviceArray, far: DeviceArray) -> None:
        self._ranks, self._device = structure.shares.ranks, structure.device
        self._near_by_row, self._far_by_row = near, far
        self.shares = structure.voxel_shares
        assert self.shares.owner is not None
        columns, given = self._ranks.together(lambda: self._sorted(structure))
        taken = np.concatenate(self._ranks.exchange(list(given[:, None])))
        self._given, self._taken = _cuts(given), _cuts(taken)
        rows = np.repeat(structure.shares.own.astype(np.int32), np.diff(structure.near.start_on_host))
        column, row = self._exchanged(columns), self._exchanged(rows)
        del rows, columns
        self._pixel_blocks = len(structure.far.pixel_blocks)
        self._ranks.together(lambda: self._place_columns(column, row, structure.voxels))
        self._rows_of = self._ranks.all(structure.far.row_blocks)
        self._blocks_of = self._ranks.all(self.blocks)

    def _sorted(self, structure: JacobianStructure) -> tuple[np.ndarray, np.ndarray]:
        """Sorts this rank's entries by who has their voxels; returns their columns, and how many go to each rank."""
        assert self.shares.owner is not None
        own_blocks = self.shares.taken(structure.far.voxel_blocks.of)
        block = np.zeros(structure.voxels, np.int32)
        self.blocks, block[self.shares.own] = np.unique(own_blocks, return_inverse=True)
        self.block = self._device.constant(block)
        self.pixel_block = self._device.constant(structure.far.pixel_blocks.of.astype(np.uint32))
        # In the order of pixels and slots, for every rank: so all have it.
        columns = self._device.copied(structure.near.columns)[: structure.near.count]
        owner = self.shares.owner[columns]
        self._order = np.argsort(owner, kind="stable").astype(np.uint32)
        return columns, np.bincount(owner, minlength=self._ranks.size)

    def _place_columns(self, column: np.ndarray, row: np.ndarray, voxels: int) -> None:
        """Puts the entries of this rank's voxels in the order of their columns."""
        self._place = np.lexsort((row, column)).astype(np.uint32)
        counts = np.bincount(column, minlength=voxels)
        self.start = self._device.constant(np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32))
        self.rows = self._device.constant(row[self._place].astype(np.uint32))
        self.near = self._device.zeros(max(len(self._place), 1), np.float32)
        self.far = self._device.zeros((self._pixel_blocks, max(len(self.blocks), 1)), np.float32)

    def _exchanged(self, values: np.ndarray) -> np.ndarray:
        """What belongs to the entries of this rank's columns, from what belongs to those of its rows."""
        result = np.empty(self._taken[-1, -1], values.dtype)
        for part in range(_PARTS):
            given = [values[self._order[cuts[part] : cuts[part + 1]]] for cuts in self._given]
            for cuts, taken in zip(self._taken, self._ranks.exchange(given)):
                result[cuts[part] : cuts[part + 1]] = taken
        return result

    def refresh(self) -> None:
        values = self._exchanged(
            self._ranks.together(lambda: self._device.copied(self._near_by_row)[: len(self._order)])
        )
        for first, last in pairwise(_cuts(np.array([len(values)]))[0]):
            if last > first:
                self._device.write(self.near.data, values[self._place[first:last]], int(first) * values.itemsize)
        del values
        shape = (self._pixel_blocks, len(self.blocks))
        of_rank, whole = self._ranks.together(
            lambda: (self._device.copied(self._far_by_row), np.empty(shape, np.float32))
        )
        at_once = max(max(map(len, self._rows_of)) // _PARTS, 1)
        for first in range(0, max(map(len, self._rows_of)), at_once):
            rows_of = [rows[first : first + at_once] for rows in self._rows_of]
            some = of_rank[first : first + len(rows_of[self._ranks.rank])]
            parts = self._ranks.exchange([some[:, blocks].reshape(-1) for blocks in self._blocks_of])
            for rows, part in zip(rows_of, parts):
                whole[rows] = part.reshape(len(rows), len(self.blocks))
        if len(self.blocks):
            self._device.write(self.far.data, whole)


def _cuts(counts: np.ndarray) -> np.ndarray:
    """Where parts begin and end of things that lie one kind after the other, shape (kinds, parts + 1).

    counts : of the kinds. Who sends and who takes cuts a kind in the same places, for both know its count
    """
    first = np.cumsum(counts) - counts
    return first[:, None] + counts[:, None] * np.arange(_PARTS + 1) // _PARTS
