"""Renderings that a device does not hold whole: in ranges of pixels, and with paths that the machine stores."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.memory import stored_on_device
from cloudtomo_cl.transport.audit import combined

if TYPE_CHECKING:
    from cloudtomo_cl.transport.radiance import RadianceOperator, Rendering

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


def render_in_parts(
    operator: RadianceOperator,
    at_once: int,
    extinction: Any,
    samples: int,
    progress: Callable[[int], None] | None,
    **options: Any,
) -> Rendering:
    """As `RadianceOperator.render`, so many pixels at a time: with the same bits, but for the audit's rounding.

    Parameters
    ----------
    options : those of `render`
    """
    from cloudtomo_cl.transport.radiance import Rendering

    ranks, pixels, found = operator.ranks, operator.pixels, []
    medium = ranks.together(lambda: operator.on_device(extinction))
    for begin in range(0, len(pixels), at_once):
        part = ranks.together(partial(operator.of_pixels, pixels[begin : begin + at_once]))

        def told(done: int, before: int = begin, count: int = len(part.pixels)) -> None:
            if progress:
                progress(int((samples * before + done * count) / len(pixels)))

        found.append(part.render(medium, samples, progress=told, **options))
    mean, error, halves = (
        np.concatenate([getattr(one, name) for one in found]) for name in ("mean", "standard_error", "halves")
    )
    first = found[0]
    audit = combined([one.audit for one in found])
    return Rendering(mean, error, halves, samples, first.seed, first.stream, audit, medium, first._launches, operator)


def kept(device: Device, paths: DeviceArray, launches: list[tuple[int, Any]]) -> Any:
    """Paths of a launch as they are stored: on the device, or on the machine if those of others fill it by now."""
    there = sum(others.nbytes for _, others in launches if device.is_array(others)) + paths.nbytes
    return paths if there <= stored_on_device(device, there) else paths.get()


def on_device(device: Device, paths: Any) -> DeviceArray:
    """Paths that are stored, where kernels find them."""
    return paths if device.is_array(paths) else device.array(paths)
