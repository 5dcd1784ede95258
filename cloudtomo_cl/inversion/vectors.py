"""Vectors of unknowns on a device, and the kernels of minimise.cl that work on them."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device

# Number of partial sums of a sum over a vector, each by one work item, and of sums to which one group adds them up: the
# same on every device.
PARTS, _LANES = 1024, 64
MINIMISE_FEATURES = (f"PARTS {PARTS}u", f"LANES {_LANES}u")


class Vectors:
    """Vectors of one length, float32.

    Parameters
    ----------
    device : device on which the vectors lie
    count : number of their elements
    """

    def __init__(self, device: Device, count: int) -> None:
        self.device, self.count = device, count

    def of(self, values: np.ndarray) -> DeviceArray:
        """A copy, on the device, of an array of the host."""
        return self.device.array(np.asarray(values, np.float32))

    def zeros(self) -> DeviceArray:
        """A vector of zeros."""
        return self.device.zeros(self.count, np.float32)

    def launch(self, name: str, **arguments: Any) -> None:
        """Runs a kernel of minimise.cl with a work item for each element."""
        self._launch(name, self.count, count=self.count, **arguments)

    def add(self, factor: float, x: DeviceArray, result: DeviceArray) -> None:
        """Adds factor times the vector x to the vector `result`."""
        self.launch("add_vector", factor=factor, x=x, result=result)

    def launch_parts(self, name: str, **arguments: Any) -> None:
        """Runs a kernel of minimise.cl with a work item for each partial sum."""
        self._launch(name, PARTS, count=self.count, **arguments)

    def launch_once(self, name: str, **arguments: Any) -> None:
        """Runs a kernel of minimise.cl that has one work-group."""
        self._launch(name, 1, **arguments)

    def _launch(self, name: str, work_items: int, **arguments: Any) -> None:
        self.device.launch(self.device.kernel("minimise", name, MINIMISE_FEATURES), work_items, **arguments)
