"""The OpenCL devices of this machine: what there are, and which one is meant."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

from cloudtomo_cl.arguments import a, able, require_kinds
from cloudtomo_cl.errors import DeviceError
from cloudtomo_cl.opencl import kernel_cache
from cloudtomo_cl.opencl.device import Device, accumulation
from cloudtomo_cl.opencl.driver import device_errors, import_pyopencl, use_from_here
from cloudtomo_cl.parallel.ranks import ALONE, Ranks

ENVIRONMENT_VARIABLE = "CLOUDTOMO_DEVICE"
# Environment variables for the number of threads of PoCL's CPU device, in earlier and in later releases.
_THREADS_OF_POCL = ("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT")

_COMMUNICATOR = able("a communicator of mpi4py, for instance MPI.COMM_WORLD, or None", "Dup", "Get_size").or_(a(Ranks))


@dataclass(frozen=True)
class DeviceInfo:
    """A device as `cloudtomo devices` lists it. Memory in bytes."""

    index: int
    platform: str
    name: str
    kind: str
    compute_units: int
    memory: int
    version: str
    accumulation: str


def _opencl_devices() -> list[Any]:
    """All devices, GPUs first, in the order the platforms give them."""
    use_from_here()
    kernel_cache.prepare()
    cl = import_pyopencl()
    try:
        platforms = cl.get_platforms()
    except cl.Error as error:
        raise DeviceError(
            f"no OpenCL platform ({error}): install one, for instance pip install 'pyopencl[pocl]'"
        ) from None
    devices = []
    for platform in platforms:
        try:
            devices += platform.get_devices()
        except cl.Error:
            # A platform whose driver is broken, or that has no device, must not hide the others.
            continue
    if not devices:
        raise DeviceError("no OpenCL device: install a driver, for instance pip install 'pyopencl[pocl]'")
    order = {cl.device_type.GPU: 0, cl.device_type.ACCELERATOR: 1}
    return sorted(devices, key=lambda device: order.get(device.type & ~cl.device_type.DEFAULT, 2))


def _kind(device: Any) -> str:
    cl = import_pyopencl()
    kinds = ("GPU", "CPU", "ACCELERATOR", "CUSTOM")
    return " | ".join(kind for kind in kinds if device.type & getattr(cl.device_type, kind))


@device_errors("listing the devices")
def list_devices() -> list[DeviceInfo]:
    """Every OpenCL device of this machine; the index is what `choose_device` takes.

    Raises
    ------
    DeviceError : there is none
    """
    return [
        DeviceInfo(
            index=index,
            platform=device.platform.name.strip(),
            name=device.name.strip(),
            kind=_kind(device),
            compute_units=device.max_compute_units,
            memory=device.global_mem_size,
            version=device.version.strip(),
            accumulation=accumulation(device),
        )
        for index, device in enumerate(_opencl_devices())
    ]


def choose_device(name: str | int | None = None, communicator: Any = None) -> Device:
    """Opens a device.

    Parameters
    ----------
    name : an index of `list_devices`, or a part of a device's or platform's name; by default
        the environment variable CLOUDTOMO_DEVICE, else the first device, GPUs before CPUs. Where several devices fit,
        as with "0,1" or a part of a name, the ranks of a machine take them in turn
    communicator : MPI communicator of mpi4py, for instance `MPI.COMM_WORLD`. Its ranks share each computation, every
        rank on the device that it has opened, and all get the result, with the same bits as from one rank. Every rank
        must do the same things in the same order. By default each rank of a machine takes another GPU, if there is one

    Raises
    ------
    DeviceError : there is no such device
    InvalidArgumentError : communicator is none
    """
    ranks = _ranks_of(communicator)
    devices = _opencl_devices()
    return Device(devices[_chosen(devices, name, ranks)], ranks)


@device_errors("listing the devices")
def chosen_index(name: str | int | None = None, communicator: Any = None) -> int:
    """The index of the device that `choose_device` opens on this rank. Raises DeviceError as it does."""
    ranks = _ranks_of(communicator)
    return _chosen(_opencl_devices(), name, ranks)


def _chosen(devices: list[Any], name: str | int | None, ranks: Ranks) -> int:
    numbers = named_devices(name)
    if len(numbers) > 1 and ranks.size == 1:
        raise DeviceError(f"device {','.join(numbers)!r} is several, and here one is wanted: in Python see on_devices")
    wanted = ",".join(numbers)
    found = _named(devices, numbers)
    if found:
        return devices.index(found[ranks.place % len(found)])
    listed = "; ".join(f"{index}: {device.name.strip()}" for index, device in enumerate(devices))
    raise DeviceError(f"no OpenCL device {wanted!r}; there are {listed} (choose an index or a part of a name)")


def named_devices(name: str | int | None) -> list[str]:
    """The indices that a name lists, or the name itself as one entry; None: the environment variable's, or [""]."""
    wanted = str(name) if name is not None else os.environ.get(ENVIRONMENT_VARIABLE, "")
    numbers = [number.strip() for number in wanted.split(",")]
    return numbers if all(map(_is_index, numbers)) else [wanted]


def _is_index(text: str) -> bool:
    return text.isascii() and text.isdigit()


def _named(devices: list[Any], names: list[str]) -> list[Any]:
    """The devices that indices or a part of a name stand for; for an empty name all devices of the first one's kind."""
    wanted = names[0]
    if not wanted:
        return [device for device in devices if _kind(device) == _kind(devices[0])]
    if _is_index(wanted):
        chosen = [int(number) for number in names]
        return [devices[number] for number in chosen] if max(chosen) < len(devices) else []
    return [device for device in devices if wanted.lower() in f"{device.platform.name} {device.name}".lower()]


def _ranks_of(communicator: Any) -> Ranks:
    """The ranks of a communicator. Divides a machine's cores among its ranks before PoCL's driver counts them."""
    if communicator is None:
        return ALONE
    require_kinds("choose_device", communicator=(communicator, _COMMUNICATOR))
    if not isinstance(communicator, Ranks):
        from cloudtomo_cl.parallel.mpi import MPIRanks

        communicator = MPIRanks(communicator)
    if communicator.size > 1:
        for variable in _THREADS_OF_POCL:
            os.environ.setdefault(variable, str(communicator.cores))
    return communicator
