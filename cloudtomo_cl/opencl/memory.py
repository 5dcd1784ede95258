"""How much memory of a device and of the machine a computation needs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from cloudtomo_cl.errors import DeviceError
from cloudtomo_cl.memory import require, size_text
from cloudtomo_cl.opencl.device import Device

# Of a device's memory, what stored paths may take: others lie on the machine.
_STORED_SHARE = 0.5


@dataclass(frozen=True)
class Footprint:
    """Bytes that arrays take which live at the same time.

    Attributes
    ----------
    device : on the device
    largest : the largest buffer there
    host : on the machine
    stored : of paths that are stored, on the device as far as it has room for them, else on the machine
    """

    device: float = 0.0
    largest: float = 0.0
    host: float = 0.0
    stored: float = 0.0

    def __add__(self, other: Footprint) -> Footprint:
        largest = max(self.largest, other.largest)
        return Footprint(self.device + other.device, largest, self.host + other.host, self.stored + other.stored)

    def require(self, device: Device, what: str, advice: str) -> None:
        """Checks that it fits.

        Parameters
        ----------
        what : begins the message, for instance "rendering 100 pixels"
        advice : ends it

        Raises
        ------
        DataError : the machine has less
        DeviceError : the device has less
        """
        if self.stored:
            there = stored_on_device(device, self.stored)
            held = replace(self, device=self.device + there, host=self.host + self.stored - there, stored=0.0)
            return held.require(device, what, advice)
        # A CPU's memory is the machine's own, whatever its driver says: PoCL 3.0 said 5.3 GB of 24, and gave 9.
        total = math.inf if device.is_cpu else device.opencl.global_mem_size
        for needed, there, piece, words in (
            (self.device, total, "", "has"),
            (self.largest, device.opencl.max_mem_alloc_size, " in one piece", "gives at most"),
        ):
            if needed > there:
                raise DeviceError(
                    f"{what} needs about {size_text(needed)} of memory{piece}, device {device.name} {words} "
                    f"{size_text(there)}: {advice}"
                )
        own = self.host + (self.device if device.shares_memory else 0)
        require(own * device.ranks.on_node, what, advice)


def stored_on_device(device: Device, size: float) -> float:
    """How much of so many bytes of stored paths lies on the device."""
    return size if device.shares_memory else min(size, _STORED_SHARE * device.opencl.global_mem_size)
