"""The far field of a Jacobian: blocks of pixels and blocks of voxels, of which a pair has one entry."""

from __future__ import annotations

import numpy as np

from cloudtomo_cl.transport.blocks import pixel_blocks, voxel_blocks
from cloudtomo_cl.transport.radiance import RadianceOperator


class FarField:
    """The blocks of all ranks, and which are this one's.

    Parameters
    ----------
    operator : with a mask

    Attributes
    ----------
    pixel_blocks, voxel_blocks : of all ranks
    row_blocks : numbers of the pixel blocks that are this rank's: blocks are dealt out whole
    pixel_block : of every pixel of this rank, its number among these, on the device, uint32
    voxel_block : of every voxel of the mask, on the device
    """

    def __init__(self, operator: RadianceOperator) -> None:
        assert operator.mask is not None
        self.pixel_blocks = pixel_blocks(operator.views, operator.pixels)
        self.voxel_blocks = voxel_blocks(operator.mask, len(self.pixel_blocks))
        self.row_blocks, row_block = np.unique(operator.shares.taken(self.pixel_blocks.of), return_inverse=True)
        self.pixel_block = operator.device.constant(row_block.astype(np.uint32))
        self.voxel_block = operator.device.constant(self.voxel_blocks.of)
