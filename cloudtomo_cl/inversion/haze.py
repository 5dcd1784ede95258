"""Haze beside a cloud: what is left in voxels that are clear."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.inversion.voxels import Voxels

# Less than this share of the mean extinction of the cloud around it is haze: about what values of a clear patch differ
# by, 0.02 and the patches' noise of 0.03 (docs/decisions/haze.md).
_SHARE = 0.04
# Around a voxel are those that share a patch of 5 x 5 x 3 with it.
_AROUND = (9, 9, 5)


def without_haze(extinction: np.ndarray, voxels: Voxels) -> np.ndarray:
    """The extinction with voxels that are thin beside those around them made clear, km^-1, shape (voxels,).

    Images hardly tell a sharp edge of a cloud from one with some haze before it, and Gaussians know no sharp edges: a
    fifth of a recovery's error was in voxels that are clear. What goes, the next step gives to voxels where images miss
    it. The measure is the mean extinction of the cloud around each voxel, s = sum b^2 / sum b, so that a thin cloud
    stays where no dense one is near.

    Parameters
    ----------
    extinction : km^-1, shape (voxels,)
    voxels : where they lie
    """
    from scipy.ndimage import uniform_filter

    on_grid = np.zeros(voxels.mask.shape)
    on_grid[voxels.mask] = extinction
    squares, sums = (uniform_filter(power, _AROUND, mode="constant")[voxels.mask] for power in (on_grid**2, on_grid))
    return np.where(extinction * sums < _SHARE * squares, 0.0, extinction)
