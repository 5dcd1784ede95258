"""The patch prior on a device: what does not change from one step to the next."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.inversion.halo import Halo
from cloudtomo_cl.inversion.mixture import Mixture
from cloudtomo_cl.inversion.patch_components import ComponentChoice
from cloudtomo_cl.inversion.patch_kernels import PatchKernels
from cloudtomo_cl.inversion.patches import Patches
from cloudtomo_cl.inversion.stencil import StencilTiles
from cloudtomo_cl.inversion.vectors import Vectors
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.driver import device_errors
from cloudtomo_cl.transport.voxel_shares import voxel_shares


class PatchOperator:
    """Where the patches and tiles of a mask lie on a device, and the kernels that work on them.

    Parameters
    ----------
    patches : patches around the voxels of the mask
    mixture : mixture for patches of this size
    device : device that computes

    Attributes
    ----------
    vectors : vectors with an element for each voxel of the mask
    voxel_shares : which rank computes the products for which voxels: those of its tiles of the stencil
    voxel : of every voxel of the mask, (x, y, z), and whether it is another rank's; on the device, uint16
    kernels : of patches.cl
    halo : the voxels' values as kernels read them
    tiles : of the stencil
    choice : of the patches' components
    """

    @device_errors("the prior")
    def __init__(self, patches: Patches, mixture: Mixture, device: Device) -> None:
        self.patches, self.mixture = patches, mixture
        mask = patches.voxels.mask
        self.vectors = Vectors(device, len(patches.voxels))
        self.voxel_shares = voxel_shares(mask, device.ranks)
        is_own = np.zeros(self.vectors.count, bool)
        is_own[self.voxel_shares.own] = True
        self.voxel = device.constant(np.column_stack([np.argwhere(mask), ~is_own]).astype(np.uint16))
        self.kernels = PatchKernels(device, mixture.size)
        self.halo = Halo(mask, mixture.size, self.vectors)
        self.tiles = StencilTiles(mask, is_own, self.kernels, self.halo)
        self.choice = ComponentChoice(patches, mixture, self.kernels, self.halo)

    @property
    def device(self) -> Device:
        """That computes."""
        return self.vectors.device
