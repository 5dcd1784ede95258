"""Which derivatives of pixels with respect to voxels are kept: some one by one, the others by blocks."""

from __future__ import annotations

from typing import Any

from cloudtomo_cl.opencl.driver import device_errors
from cloudtomo_cl.transport.far_field import FarField
from cloudtomo_cl.transport.near_field import NearField
from cloudtomo_cl.transport.radiance import RadianceOperator
from cloudtomo_cl.transport.voxel_shares import voxel_shares


class JacobianStructure:
    """Which entries of a Jacobian are kept one by one, its near field, and the blocks that share the others.

    Parameters
    ----------
    operator : with a mask
    column : of every voxel of the grid, or -1, on the device

    Attributes
    ----------
    device
    pixels, voxels : numbers of rows and columns
    shares : which rank has which pixels: of these are `near`, and the rows of `far`
    voxel_shares : which rank has which voxels
    near, far : fields
    """

    @device_errors("the structure of the derivatives")
    def __init__(self, operator: RadianceOperator, column: Any) -> None:
        assert operator.mask is not None
        self.device, self.shares = operator.device, operator.shares
        self.pixels, self.voxels = len(operator.pixels), int(operator.mask.sum())
        self.voxel_shares = voxel_shares(operator.mask, self.device.ranks)
        self.near, self.far = NearField(operator, column), FarField(operator)

    @property
    def rows(self) -> int:
        """Number of this rank's pixels."""
        return len(self.shares)
