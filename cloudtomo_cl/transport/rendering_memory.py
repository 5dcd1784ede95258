"""The memory of a rendering: what it takes, how many pixels fit at once, and where stored paths lie."""

from __future__ import annotations

from typing import Any

from cloudtomo_cl.memory import require_countable, shape_text, voxels_of
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.layout import MOST_BRANCHES
from cloudtomo_cl.opencl.memory import Footprint, stored_on_device

# Of a device's memory, what a rendering may take: drivers take some, and other arrays are there.
_SHARE = 0.9
# On the device: extinction and what skips empty blocks; sums; a stored path or branch. On the host: what sums become.
_BYTES_PER_VOXEL, _BYTES_PER_PIXEL, _BYTES_OF_RADIANCE, _HOST_BYTES_PER_PIXEL = 8, 48, 4, 160
# Of that of a pixel, what it takes while it is rendered, and what its place in the list of all takes; and the largest
# of its arrays.
_BYTES_AT_ONCE, _BYTES_OF_LIST, _LARGEST_BYTES = 40, 8, 24
# Pixels that are rendered together at least: with less room a problem is refused.
_FEWEST_AT_ONCE = 4096


def pixels_at_once(device: Device, voxels: int, pixels: int) -> int:
    """How many of so many pixels are rendered together; all, if they fit. At least 1."""
    room = _SHARE * device.opencl.global_mem_size - _BYTES_PER_VOXEL * voxels - _BYTES_OF_LIST * pixels
    most = min(room / _BYTES_AT_ONCE, device.opencl.max_mem_alloc_size / _LARGEST_BYTES)
    return int(max(min(most, pixels), 1))


def kept(device: Device, paths: DeviceArray, launches: list[tuple[int, Any]]) -> Any:
    """Paths of a launch as they are stored: on the device, or on the machine if others need its memory."""
    there = sum(others.nbytes for _, others in launches if device.is_array(others)) + paths.nbytes
    return paths if there <= stored_on_device(device, there) else paths.get()


def on_device(device: Device, paths: Any) -> DeviceArray:
    """Paths that are stored, where kernels find them."""
    return paths if device.is_array(paths) else device.array(paths)


def footprint(voxels: int, pixels: int, stored_paths: int = 0, branches: bool = True) -> Footprint:
    """What a `RadianceOperator` takes to render a grid: counted over arrays that live at the same time, rounded up.

    branches : whether stored paths branch
    """
    of_path = _BYTES_OF_RADIANCE * (1 + MOST_BRANCHES * branches)
    device = _BYTES_PER_VOXEL * voxels + _BYTES_PER_PIXEL * pixels
    largest = max(_BYTES_PER_VOXEL // 2 * voxels, _LARGEST_BYTES * pixels)
    return Footprint(device, largest, _HOST_BYTES_PER_PIXEL * pixels, of_path * stored_paths)


def require_memory(device: Device, shape: tuple[int, ...], pixels: int) -> None:
    """DataError or DeviceError if there is not memory enough, or there is more than kernels count."""
    what = f"rendering {pixels} pixels of {shape_text(shape)} voxels"
    require_countable(voxels_of(shape), pixels, what)
    voxels = voxels_of(shape)
    at_once = max(pixels_at_once(device, voxels, pixels), min(pixels, _FEWEST_AT_ONCE))
    later = pixels - at_once
    needed = footprint(voxels, at_once) + Footprint(_BYTES_OF_LIST * later, 0.0, _HOST_BYTES_PER_PIXEL * later)
    needed.require(device, what, "choose fewer pixels or voxels")
