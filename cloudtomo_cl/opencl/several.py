"""Several devices in one process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from cloudtomo_cl.arguments import CALLABLE, WHOLE, Kind, a, is_sequence_of, require_kinds
from cloudtomo_cl.errors import DeviceError
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.devices import choose_device
from cloudtomo_cl.parallel.ranks import Ranks
from cloudtomo_cl.parallel.threads import shared_by_threads

_Result = TypeVar("_Result")


def on_devices(names: Sequence[str | int], work: Callable[[Device], _Result]) -> _Result:
    """Lets several devices share a computation; the result has the same bits as from one device.

    Parameters
    ----------
    names : names or indices of the devices, each as `choose_device` takes it
    work : function that is called with each device, in one thread for each, for instance
        `lambda device: reconstruct(scene, measurements, device=device)`: it must do the same things in the same order

    Returns
    -------
    what `work` returns with the first device

    Raises
    ------
    InvalidArgumentError : names are no sequence, or work is no function
    DeviceError : no name is given, or there is no such device; other errors as `work` raises them
    """
    one_name = a(str).or_(WHOLE)
    kind = Kind("a tuple or list of names or indices of devices", lambda value: is_sequence_of(one_name, value))
    require_kinds("on_devices", names=(names, kind), work=(work, CALLABLE))
    if not len(names):
        raise DeviceError("no device is named: give at least one (`cloudtomo devices` lists them)")

    def one(ranks: Ranks) -> _Result:
        return work(ranks.together(lambda: choose_device(names[ranks.rank], ranks)))

    return shared_by_threads(len(names), one)
