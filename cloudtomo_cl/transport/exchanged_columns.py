"""A Jacobian by columns, of several ranks: values by rows are sent to the ranks that have their voxels."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.transport.jacobian_structure import JacobianStructure

# In which values change hands: what is on its way is small beside what stays.
_PARTS = 8


class ExchangedColumns:
    """The columns of this rank's voxels; see `JacobianColumns`.

    Parameters
    ----------
    structure : of the Jacobian; its pixels are those of several ranks
    near, far : values by rows, of this rank's pixels
    """

    def __init__(self, structure: JacobianStructure, near: DeviceArray, far: DeviceArray) -> None:
        self.shares = structure.voxel_shares
        self._near, self._far = _Near(structure, near), _Far(structure, far)
        self.start, self.rows, self.near = self._near.start, self._near.rows, self._near.values
        self.blocks, self.block, self.pixel_block = self._far.blocks, self._far.block, self._far.pixel_block
        self.far = self._far.values

    def refresh(self) -> None:
        """Takes values over that have changed by rows."""
        self._near.refresh()
        self._far.refresh()


class _Near:
    """The near field: where this rank's entries go, and where those that come stand in its columns."""

    def __init__(self, structure: JacobianStructure, by_row: DeviceArray) -> None:
        self._ranks, self._device, self._by_row = structure.shares.ranks, structure.device, by_row
        columns, given = self._ranks.together(lambda: self._sorted(structure))
        taken = np.concatenate(self._ranks.exchange(list(given[:, None])))
        self._given, self._taken = _cuts(given), _cuts(taken)
        rows = np.repeat(structure.shares.own.astype(np.int32), np.diff(structure.near.start_on_host))
        column, row = self._exchanged(columns), self._exchanged(rows)
        del rows, columns
        self._ranks.together(lambda: self._place_columns(column, row, structure.voxels))

    def _sorted(self, structure: JacobianStructure) -> tuple[np.ndarray, np.ndarray]:
        """Sorts this rank's entries by who has their voxels; returns their columns, and how many go to each rank."""
        assert structure.voxel_shares.owner is not None
        # In the order of pixels and slots, for every rank: so all have it.
        columns = self._device.copied(structure.near.columns)[: structure.near.count]
        owner = structure.voxel_shares.owner[columns]
        self._order = np.argsort(owner, kind="stable").astype(np.uint32)
        return columns, np.bincount(owner, minlength=self._ranks.size)

    def _place_columns(self, column: np.ndarray, row: np.ndarray, voxels: int) -> None:
        """Puts the entries of this rank's voxels in the order of their columns."""
        self._place = np.lexsort((row, column)).astype(np.uint32)
        counts = np.bincount(column, minlength=voxels)
        self.start = self._device.constant(np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32))
        self.rows = self._device.constant(row[self._place].astype(np.uint32))
        self.values = self._device.zeros(max(len(self._place), 1), np.float32)

    def _exchanged(self, values: np.ndarray) -> np.ndarray:
        """What belongs to the entries of this rank's columns, from what belongs to those of its rows."""
        result = np.empty(self._taken[-1, -1], values.dtype)
        for part in range(_PARTS):
            given = [values[self._order[cuts[part] : cuts[part + 1]]] for cuts in self._given]
            for cuts, taken in zip(self._taken, self._ranks.exchange(given)):
                result[cuts[part] : cuts[part + 1]] = taken
        return result

    def refresh(self) -> None:
        values = self._exchanged(self._ranks.together(lambda: self._device.copied(self._by_row)[: len(self._order)]))
        for first, last in pairwise(_cuts(np.array([len(values)]))[0]):
            if last > first:
                self._device.write(self.values.data, values[self._place[first:last]], int(first) * values.itemsize)


class _Far:
    """The far field: the blocks of this rank's voxels, with the blocks of all pixels."""

    def __init__(self, structure: JacobianStructure, by_row: DeviceArray) -> None:
        self._ranks, self._device, self._by_row = structure.shares.ranks, structure.device, by_row
        self._ranks.together(lambda: self._number(structure))
        self._rows_of = self._ranks.all(structure.far.row_blocks)
        self._blocks_of = self._ranks.all(self.blocks)

    def _number(self, structure: JacobianStructure) -> None:
        """Numbers the blocks of this rank's voxels, and makes room for their values."""
        shares, far = structure.voxel_shares, structure.far
        block = np.zeros(structure.voxels, np.int32)
        self.blocks, block[shares.own] = np.unique(shares.taken(far.voxel_blocks.of), return_inverse=True)
        self.block: Any = self._device.constant(block)
        self.pixel_block: Any = self._device.constant(far.pixel_blocks.of.astype(np.uint32))
        shape = (len(far.pixel_blocks), max(len(self.blocks), 1))
        self.values = self._device.zeros(shape, np.float32)

    def refresh(self) -> None:
        shape = (self.values.shape[0], len(self.blocks))
        of_rank, whole = self._ranks.together(lambda: (self._device.copied(self._by_row), np.empty(shape, np.float32)))
        at_once = max(max(map(len, self._rows_of)) // _PARTS, 1)
        for first in range(0, max(map(len, self._rows_of)), at_once):
            rows_of = [rows[first : first + at_once] for rows in self._rows_of]
            some = of_rank[first : first + len(rows_of[self._ranks.rank])]
            parts = self._ranks.exchange([some[:, blocks].reshape(-1) for blocks in self._blocks_of])
            for rows, part in zip(rows_of, parts):
                whole[rows] = part.reshape(len(rows), len(self.blocks))
        if len(self.blocks):
            self._device.write(self.values.data, whole)


def _cuts(counts: np.ndarray) -> np.ndarray:
    """Where parts begin and end of things that lie one kind after the other, shape (kinds, parts + 1).

    counts : of the kinds. Who sends and who takes cuts a kind in the same places, for both know its count
    """
    first = np.cumsum(counts) - counts
    return first[:, None] + counts[:, None] * np.arange(_PARTS + 1) // _PARTS
