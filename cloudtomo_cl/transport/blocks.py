"""Blocks of pixels and of voxels, each pair of which shares its derivatives where they are far from each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cloudtomo_cl.errors import DataError
from cloudtomo_cl.scene.sensors import RayView, View

# Edges of blocks: of pixels in their image; of voxels at least, doubled until there are no more pairs than these.
PIXEL_EDGE = 4
_VOXEL_EDGE = 2
MOST_PAIRS = 1 << 25


@dataclass(frozen=True, eq=False)
class Blocks:
    """A division of things into blocks.

    Attributes
    ----------
    of : the block of each, int32
    start, members : those of block n are members[start[n] : start[n + 1]], uint32
    """

    of: np.ndarray
    start: np.ndarray
    members: np.ndarray

    @classmethod
    def by_label(cls, labels: np.ndarray) -> Blocks:
        """Blocks of equal labels (an array of rows), numbered in their order."""
        _, of = np.unique(labels, axis=0, return_inverse=True)
        of = of.reshape(-1)
        sizes = np.bincount(of)
        start = np.concatenate([[0], np.cumsum(sizes)])
        return cls(of.astype(np.int32), start.astype(np.uint32), np.argsort(of, kind="stable").astype(np.uint32))

    def __len__(self) -> int:
        return len(self.start) - 1

    @property
    def sizes(self) -> np.ndarray:
        """How many are in each, float32."""
        return np.diff(self.start.astype(np.int64)).astype(np.float32)


def pixel_blocks(views: Sequence[View], pixels: np.ndarray) -> Blocks:
    """Squares of pixels of one image; of a list of rays each by itself."""
    labels = np.empty((len(pixels), 3), np.int64)
    for index, view in enumerate(views):
        chosen = pixels[:, 0] == index
        row, column = np.divmod(pixels[chosen, 1].astype(int), view.pixels[0])
        edge = 1 if isinstance(view, RayView) else PIXEL_EDGE
        labels[chosen] = np.column_stack([np.full(len(row), index), row // edge, column // edge])
    return Blocks.by_label(labels)


def voxel_blocks(mask: np.ndarray, pixel_blocks: int) -> Blocks:
    """Cubes of the mask's voxels, as small as the number of pairs with pixel blocks allows.

    Raises
    ------
    DataError : there are too many pixels for one block of voxels
    """
    places = np.argwhere(mask)
    edge = _VOXEL_EDGE
    while edge < 2 * max(*mask.shape, _VOXEL_EDGE):
        blocks = Blocks.by_label(places // edge)
        if len(blocks) * pixel_blocks <= MOST_PAIRS:
            return blocks
        edge *= 2
    raise DataError(f"{pixel_blocks} blocks of pixels are more than derivatives are kept for: use fewer pixels")
