"""Memory that a computation needs on a device and on the machine."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from cloudtomo_cl.errors import DeviceError
from cloudtomo_cl.memory import require, size_text
from cloudtomo_cl.opencl.device import Device

# Largest share of a device's memory for stored paths: the rest of them is kept in the machine's memory.
_STORED_SHARE = 0.5


@dataclass(frozen=True)
class Footprint:
    """Bytes of memory of the arrays that exist at the same time.

    Attributes
    ----------
    device : bytes on the device
    largest : bytes of the largest buffer on the device
    host : bytes in the machine's memory
    stored : bytes of stored paths: on the device as far as it has room, else in the machine's memory
    """

    device: float = 0.0
    largest: float = 0.0
    host: float = 0.0
    stored: float = 0.0

    def __add__(self, other: Footprint) -> Footprint:
        largest = max(self.largest, other.largest)
        return Footprint(self.device + other.device, largest, self.host + other.host, self.stored + other.stored)

    def require(self, device: Device, what: str, advice: str) -> None:
        """Checks that the device and the machine have that much memory.

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
        # A CPU uses all of the machine's memory, whatever its driver says: PoCL 3.0 said 5.3 GB of 24 GB, and gave 9.
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
        in_main_memory = self.host + (self.device if device.shares_memory else 0)
        require(in_main_memory * device.ranks.on_node, what, advice)


def stored_on_device(device: Device, size: float) -> float:
    """How many of the `size` bytes of stored paths lie on the device."""
    return size if device.shares_memory else min(size, _STORED_SHARE * device.opencl.global_mem_size)
