"""Haze beside a cloud: what is left in voxels that are clear."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.inversion.data_term import DataTerm
from cloudtomo_cl.inversion.voxels import Voxels

# Less than this share of the mean extinction of the cloud around it is haze: about what values of a clear patch differ
# by, 0.02 and the patches' noise of 0.03 (docs/decisions/haze.md).
_SHARE = 0.04
# Around a voxel are those that share a patch of 5 x 5 x 3 with it.
_AROUND = (9, 9, 5)


def without_haze(extinction: np.ndarray, voxels: Voxels, data: DataTerm, unit: float) -> np.ndarray:
    """The extinction with voxels that are thin beside those around them made clear, km^-1, shape (voxels,).

    Images hardly tell a sharp edge of a cloud from one with some haze before it, and Gaussians know no sharp edges: a
    fifth of a recovery's error was in voxels that are clear. The measure is the mean extinction of the cloud around
    each voxel, s = sum b^2 / sum b, so that a thin cloud stays where no dense one is near.

    Where the images do tell, a thin cloud stays beside a dense one, too: where the data term without these voxels would
    rise by more than its unit for each of them, as Akaike 1974 weighs parameters. With d the change, and g and h the
    gradients before and after, it rises by sum_v d_v (g_v + h_v) / 2: what voxels around one have of that decides.

    Parameters
    ----------
    extinction : km^-1, shape (voxels,)
    voxels : where they lie
    data : the data term, without damping
    unit : mean weighted variance of a pixel's noise
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
