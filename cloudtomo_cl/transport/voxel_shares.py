"""Which rank has which voxels of a mask: the columns of derivatives, and the patch prior's stencil.

Both are sums that a product makes for a voxel. Where one rank makes them all, what ranks tell each other of a product
is a number for each voxel, once.
"""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.parallel.ranks import Ranks, Shares

# Voxels in a row along z that one rank has whole: of a tile of the patch prior's stencil.
ROW = 8
# Edges of the boxes that are dealt out along x and y: as large as leaves a rank so many boxes, so that blocks of the
# far field lie in one where they can; and so small that all have about as much to do.
_EDGES, _BOXES_OF_RANK = (16, 8, 4, 2), 128


def voxel_shares(mask: np.ndarray, ranks: Ranks) -> Shares:
    """Deals a mask's voxels out, in the order of `np.argwhere`; the same for all who ask."""
    if ranks.size == 1:
        return ranks.dealt(np.zeros(np.count_nonzero(mask), np.int64))
    places = np.argwhere(mask)
    for edge in _EDGES:
        boxes = _boxes(places, edge)
        if boxes.max() + 1 >= _BOXES_OF_RANK * ranks.size:
            break
    return ranks.dealt(boxes)


def _boxes(places: np.ndarray, edge: int) -> np.ndarray:
    """The box of each place, of those that hold any, numbered in the order of x, y, z."""
    corners = places // (edge, edge, max(edge, ROW))
    numbers = np.ravel_multi_index(tuple(corners.T), tuple(corners.max(axis=0) + 1))
    return np.unique(numbers, return_inverse=True)[1].reshape(-1)
