"""Vectors on a device of which every rank has computed a part: all ranks get the whole vector."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.parallel.ranks import Shares


class Gathering:
    """Exchanges the elements of vectors between ranks: float32, shape (count,). With one rank it does nothing.

    Parameters
    ----------
    device : device of this rank
    shares : which rank computes which elements; None: every rank computes all
    """

    def __init__(self, device: Device, shares: Shares | None) -> None:
        self._device, self._shares = device, shares
        self._alone = shares is None or shares.owner is None
        # Event of the last copy. It keeps the array on the host alive until the device has read it.
        self._copied: Any = None

    def complete(self, vector: DeviceArray) -> None:
        """Fills in the elements of other ranks; `vector` already holds this rank's elements in their places."""
        if not self._alone:
            self._device.step(lambda: self._complete(vector))

    def join(self, part: DeviceArray, vector: DeviceArray) -> None:
        """Fills `vector` from all ranks; `part` begins with this rank's elements, in their order."""
        if not self._alone:
            self._device.step(lambda: self._join(part, vector))

    def _complete(self, vector: DeviceArray) -> None:
        shares = self._shares
        assert shares is not None
        self._hand_out(shares.taken(self._read(vector, shares.count)), vector)

    def _join(self, part: DeviceArray, vector: DeviceArray) -> None:
        assert self._shares is not None
        self._hand_out(self._read(part, len(self._shares)), vector)

    def _read(self, array: DeviceArray, count: int) -> np.ndarray:
        values = np.empty(count, np.float32)
        if count:
            self._device.read(array.data, values)
        return values

    def _hand_out(self, elements: np.ndarray, vector: DeviceArray) -> None:
        """Copies all ranks' elements to the device without waiting: kernels that read them are queued behind."""
        assert self._shares is not None
        self._copied = self._device.write(vector.data, self._shares.gathered(elements), wait=False)
