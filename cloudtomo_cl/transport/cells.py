"""Cells: voxels, and parts of those that are optically deep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# A cell is so deep at most, in optical depths divided by 1 - g, along every axis: light hardly changes within.
_DEPTH = 0.25
# Light changes fast below the cloud's surface, and across it. Inside, cells may be deeper along an axis, by so much for
# an optical depth of 1 / (1 - g) along it.
_COARSENING = 2.0
# Beside a voxel so deep that it is divided light changes in thin ones, too: those with so much of its depth are halved.
_THIN = 0.02
# All that is for so many photons a voxel, or fewer. More of them have less noise, and finer cells less bias.
_PHOTONS = 100.0
# Parts along an axis at most, and cells in all: for so many voxels, and in any case.
_MOST_PARTS = 8
_MOST_PER_VOXEL, _ALWAYS = 3, 16_000
# By what cells grow until they are no more than that.
_GROWTH = 1.1


def most_cells(voxels: int) -> int:
    """How many cells so many voxels have at most."""
    return max(_MOST_PER_VOXEL * voxels, _ALWAYS)


@dataclass(frozen=True, eq=False)
class Cells:
    """How voxels are divided; cells are numbered voxel by voxel, z fastest.

    Attributes
    ----------
    parts : along x, y, z, int32, shape (voxels, 3)
    """

    parts: np.ndarray

    @classmethod
    def whole(cls, voxels: int) -> Cells:
        """Every voxel is a cell."""
        return cls(np.ones((voxels, 3), np.int32))

    @classmethod
    def of(
        cls,
        extinction: np.ndarray,
        spacing: tuple[float, float, float],
        asymmetry: float,
        within: np.ndarray | float = 0.0,
        beside: np.ndarray | float = 0.0,
        photons: float = _PHOTONS,
    ) -> Cells:
        """Cells in which light does not change much, as far as there may be so many.

        Parameters
        ----------
        extinction : km^-1, shape (voxels,)
        spacing : of the voxels, km
        asymmetry : of the droplets' phase function
        within : optical depth of the cloud between a voxel and the outside along x, y, z, shape (voxels, 3): see
            `depth_within`
        beside : largest extinction of the neighbours, km^-1, shape (voxels,): see `largest_beside`
        photons : from the sun, for each voxel
        """
        depth = np.asarray(extinction, float)[:, None] * np.asarray(spacing)
        size = min(1.0, _PHOTONS / photons)  # of that by default
        limit = size * min(_DEPTH / float(np.clip(1 - asymmetry, 1e-6, 1)), _DEPTH * _MOST_PARTS)
        coarser = np.broadcast_to(1 + size * _COARSENING * (1 - asymmetry) * np.asarray(within), depth.shape)
        depth_beside = np.broadcast_to(beside, len(depth))[:, None] * np.asarray(spacing)
        while True:
            parts = np.clip(np.ceil(depth / (limit * coarser)), 1, _MOST_PARTS)
            is_halved = (depth_beside > limit) & (depth > _THIN * depth_beside)
            parts = np.where(is_halved, np.maximum(parts, 2), parts)
            if parts.prod(axis=1).sum() <= most_cells(len(depth)):
                return cls(parts.astype(np.int32))
            limit *= _GROWTH

    @property
    def counts(self) -> np.ndarray:
        """Of every voxel's cells, shape (voxels,)."""
        return self.parts.prod(axis=1, dtype=np.int64)

    @property
    def first(self) -> np.ndarray:
        """Of every voxel's cells, the first, shape (voxels,)."""
        return np.concatenate([[0], np.cumsum(self.counts)[:-1]])

    def __len__(self) -> int:
        return int(self.counts.sum())

    @property
    def voxel(self) -> np.ndarray:
        """Of every cell, shape (cells,)."""
        return np.repeat(np.arange(len(self.parts)), self.counts)

    @property
    def places(self) -> np.ndarray:
        """First cell and parts along x, y, z of every voxel, as kernels take them: uint32, shape (voxels, 4)."""
        return np.column_stack([self.first, self.parts]).astype(np.uint32)


def depth_within(extinction: np.ndarray, spacing: tuple[float, float, float], periodic: bool) -> np.ndarray:
    """Optical depth of the cloud between every voxel and the outside, along each axis.

    Parameters
    ----------
    extinction : km^-1, shape of the grid
    periodic : whether there is no outside along x and y: then the depth there is that along z

    Returns
    -------
    shape of the grid, and 3 for x, y, z
    """
    depths = []
    for axis in (2,) if periodic else (0, 1, 2):
        depth = np.asarray(extinction, float) * spacing[axis]
        until = np.cumsum(depth, axis=axis)
        total = np.take(until, [-1], axis=axis)
        depths.append(np.maximum(np.minimum(until - depth, total - until), 0.0))
    return np.stack(depths * 3 if periodic else depths, axis=-1)


def largest_beside(extinction: np.ndarray, periodic: bool) -> np.ndarray:
    """The largest extinction of the voxels that share a face with each.

    Parameters
    ----------
    extinction : km^-1, shape of the grid
    periodic : whether there is no outside along x and y
    """
    largest = np.zeros_like(extinction)
    for axis in range(3):
        for step in (-1, 1):
            beside = np.roll(extinction, step, axis)
            if not (periodic and axis < 2):
                np.moveaxis(beside, axis, 0)[0 if step > 0 else -1] = 0
            largest = np.maximum(largest, beside)
    return largest
