"""What a device holds of a rendering: how many pixels at once, and how many of the stored paths."""

from __future__ import annotations

from typing import Any

from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.memory import stored_on_device

# Of a device's memory, what a rendering may fill: drivers take some, and other arrays are there.
_SHARE = 0.9
# On the device, of a pixel that is rendered: its sums, and a path; of all pixels: their list.
_BYTES_AT_ONCE, _LARGEST_BYTES, BYTES_OF_LIST = 40, 24, 8
_BYTES_PER_VOXEL = 8


def pixels_at_once(device: Device, voxels: int, pixels: int) -> int:
    """How many of so many pixels are rendered together; all, if they fit. At least 1."""
    room = _SHARE * device.opencl.global_mem_size - _BYTES_PER_VOXEL * voxels - BYTES_OF_LIST * pixels
    most = min(room / _BYTES_AT_ONCE, device.opencl.max_mem_alloc_size / _LARGEST_BYTES)
    return int(max(min(most, pixels), 1))


def kept(device: Device, paths: DeviceArray, launches: list[tuple[int, Any]]) -> Any:
    """Paths of a launch as they are stored: on the device, or on the machine if those of others fill it by now."""
    there = sum(others.nbytes for _, others in launches if device.is_array(others)) + paths.nbytes
    return paths if there <= stored_on_device(device, there) else paths.get()


def on_device(device: Device, paths: Any) -> DeviceArray:
    """Paths that are stored, where kernels find them."""
    return paths if device.is_array(paths) else device.array(paths)
