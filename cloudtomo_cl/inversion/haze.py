"""Haze beside a cloud: a little extinction that a recovery leaves in voxels which are clear."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.inversion.data_term import DataTerm
from cloudtomo_cl.inversion.voxels import Voxels

# A voxel with less than this share of the mean extinction of the cloud around it is haze. It is about the deviation of
# values in a clear patch, 0.02, with the patches' noise of 0.03 (docs/decisions/haze.md).
_SHARE = 0.04
# Size of a voxel's surroundings, voxels along x, y, z: those that share a patch of 5 x 5 x 3 with it.
_AROUND = (9, 9, 5)


def without_haze(extinction: np.ndarray, voxels: Voxels, data: DataTerm, unit: float) -> np.ndarray:
    """The extinction, km^-1, shape (voxels,), with voxels set to 0 that are much thinner than the cloud around them.

    Images hardly tell a cloud's sharp edge from one with some haze before it, and the prior's Gaussians have no sharp
    edges: a fifth of a recovery's error was in voxels that are clear. A voxel is compared with the mean extinction of
    the cloud around it, s = sum b^2 / sum b, so that a thin cloud stays where no dense one is near.

    A thin cloud beside a dense one stays, too, where the images show it: where the data term would rise by more than
    its unit for each voxel that is set to 0 (Akaike 1974 weighs parameters like this). With the change d, and the
    gradients g before and h after it, the data term rises by sum_v d_v (g_v + h_v) / 2. For each voxel the part of this
    sum in its surroundings decides.

    Parameters
    ----------
    extinction : extinction of the mask's voxels, km^-1, shape (voxels,)
    voxels : grid and mask of these voxels
    data : data term without damping
    unit : mean over pixels of weight times noise variance
    """
    from scipy.ndimage import uniform_filter

    def around(values: np.ndarray) -> np.ndarray:
        on_grid = np.zeros(voxels.mask.shape)
        on_grid[voxels.mask] = values
        return uniform_filter(on_grid, _AROUND, mode="constant")[voxels.mask]

    is_haze = (extinction > 0) & (extinction * around(extinction) < _SHARE * around(extinction**2))
    if not is_haze.any():
        return extinction
    clear = np.where(is_haze, 0.0, extinction)
    rise = (clear - extinction) * (data.gradient(extinction) + data.gradient(clear)) / 2
    stays = around(rise) > unit * around(is_haze.astype(float))
    return np.where(is_haze & ~stays, 0.0, extinction)
