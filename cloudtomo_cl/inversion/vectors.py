"""Vectors of unknowns on a device, and what minimisers do with them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device

# Work items that a sum is made by: the same on every device.
PARTS = 1024
MINIMISE_FEATURES = (f"PARTS {PARTS}u",)


class Vectors:
    """Vectors of one length, float32.

    Parameters
    ----------
    device : where they are
    count : of their numbers
    """

    def __init__(self, device: Device, count: int) -> None:
        self.device, self.count = device, count
        self._sums = device.empty((3, PARTS), np.float32)

    def of(self, values: np.ndarray) -> DeviceArray:
        """A copy of an array of the host."""
        return self.device.array(np.asarray(values, np.float32))

    def zeros(self) -> DeviceArray:
        """A vector of zeros."""
        return self.device.zeros(self.count, np.float32)

    def launch(self, name: str, **arguments: Any) -> None:
        """Runs a kernel of minimise.cl with a work item for each number."""
        kernel = self.device.kernel("minimise", name, MINIMISE_FEATURES)
        self.device.launch(kernel, self.count, count=self.count, **arguments)

    def add(self, factor: float, x: DeviceArray, result: DeviceArray) -> None:
        """Adds factor times a vector to another."""
        self.launch("add_vector", factor=factor, x=x, result=result)

    def parts(self, name: str, **arguments: Any) -> np.ndarray:
        """The parts of up to three sums, shape (3, parts): those that a kernel makes."""
        kernel = self.device.kernel("minimise", name, MINIMISE_FEATURES)
        self.device.launch(kernel, PARTS, count=self.count, **arguments, sums=self._sums)
        return self._sums.get()


def sum_of(parts: np.ndarray) -> float:
    """A sum of parts, exact but for the last rounding: it follows from nothing but its parts."""
    return math.fsum(parts.tolist())
