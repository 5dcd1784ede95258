"""Several devices in one process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from cloudtomo_cl.errors import DeviceError
from cloudtomo_cl.opencl.device import Device, choose_device
from cloudtomo_cl.parallel.ranks import Ranks
from cloudtomo_cl.parallel.threads import shared_by_threads

_Result = TypeVar("_Result")


def on_devices(names: Sequence[str | int], work: Callable[[Device], _Result]) -> _Result:
    """Lets several devices share what is computed, with the same bits as of one.

    Parameters
    ----------
    names : of the devices, each as `choose_device` takes it
    work : called with each device in a thread of its own, for instance
        `lambda device: reconstruct(scene, measurements, device=device)`: what is done with them must be the same, in
        the same order

    Returns
    -------
    what it returns with the first device

    Raises
    ------
    DeviceError : no name, or no such device; the rest as `work`
    """
    if not names:
        raise DeviceError("no device is named: give at least one (`cloudtomo devices` lists them)")

    def one(ranks: Ranks) -> _Result:
        return work(ranks.together(lambda: choose_device(names[ranks.rank], ranks)))

    return shared_by_threads(len(names), one)
