"""Vectors on a device of which every rank has made a part: all get all of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.parallel.ranks import Shares


class Gathering:
    """Has ranks tell each other their numbers of vectors: float32, shape (count,). One rank tells nobody anything.

    Parameters
    ----------
    device : of this rank
    shares : which rank makes which of the numbers; none where each makes all
    """

    def __init__(self, device: Device, shares: Shares | None) -> None:
        self._device, self._shares = device, shares
        self._alone = shares is None or shares.owner is None
        # Of the last vector: what was copied must stay until it is there.
        self._copied: Any = None

    def complete(self, vector: DeviceArray) -> None:
        """Fills a vector in, of which this rank has made its own numbers, in their places."""
        if not self._alone:
            self._device.step(lambda: self._complete(vector))

    def join(self, part: DeviceArray, vector: DeviceArray) -> None:
        """Makes a vector of this rank's numbers, in their order at the beginning of a part, and those of the others."""
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

    def _hand_out(self, own: np.ndarray, vector: DeviceArray) -> None:
        """Copies all ranks' numbers without waiting: whatever reads them next stands behind in the queue."""
        assert self._shares is not None
        self._copied = self._device.write(vector.data, self._shares.gathered(own), wait=False)
