"""The kernels of the patch prior (patches.cl), for patches of one size."""

from __future__ import annotations

from typing import Any

from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.transport.voxel_shares import ROW

# Voxels of a tile of the stencil, in a row along z; and the component number of places without a patch.
LANES, NO_PATCH = ROW, 65535


class PatchKernels:
    """Runs the kernels.

    Parameters
    ----------
    device : where they run
    size : of a patch, voxels along x, y, z
    """

    def __init__(self, device: Device, size: tuple[int, int, int]) -> None:
        self.device, self.size = device, size
        names = ("PATCH_X", "PATCH_Y", "PATCH_Z", "LANES", "NO_PATCH")
        self._features = tuple(f"{name} {value}" for name, value in zip(names, (*size, LANES, NO_PATCH)))

    def launch(self, name: str, work_items: int, **arguments: Any) -> None:
        """Runs one of them, where there is anything to do."""
        if work_items:
            self.device.launch(self.device.kernel("patches", name, self._features), work_items, **arguments)
