"""How much memory of a device and of the machine a computation needs."""

from __future__ import annotations

from dataclasses import dataclass

from cloudtomo_cl.errors import DeviceError
from cloudtomo_cl.memory import require, size_text
from cloudtomo_cl.opencl.device import Device


@dataclass(frozen=True)
class Footprint:
    """Bytes that arrays take which live at the same time.

    Attributes
    ----------
    device : on the device
    largest : the largest buffer there
    host : on the machine
    """

    device: float = 0.0
    largest: float = 0.0
    host: float = 0.0

    def __add__(self, other: Footprint) -> Footprint:
        return Footprint(self.device + other.device, max(self.largest, other.largest), self.host + other.host)

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
        for needed, there, words in (
            (self.device, device.opencl.global_mem_size, "has"),
            (self.largest, device.opencl.max_mem_alloc_size, "gives at most"),
        ):
            if needed > there:
                piece = " in one piece" if needed is self.largest else ""
                raise DeviceError(
                    f"{what} needs about {size_text(needed)} of memory{piece}, device {device.name} {words} "
                    f"{size_text(there)}: {advice}"
                )
        # A CPU's memory is the machine's own.
        own = self.host + (self.device if device.shares_memory else 0)
        require(own * device.ranks.on_node, what, advice)
