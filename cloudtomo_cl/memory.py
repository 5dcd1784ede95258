"""How much memory a computation needs, against what there is: said before it is taken."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from cloudtomo_cl.errors import DataError, DeviceError

if TYPE_CHECKING:
    from cloudtomo_cl.opencl.device import Device

# Bytes for each voxel and pixel, counted over the arrays that live at the same time and rounded up.
_RENDER_VOXEL, _RENDER_PIXEL = 8, 48
_DESCENT_VOXEL = 64
_HOST_VOXEL, _HOST_PIXEL = 40, 160
_PATH = 4
_GENERATED_VOXEL = 64
# Kernels count voxels with signed and pixels with unsigned integers of 32 bits.
_MOST_VOXELS, _MOST_PIXELS = 2**31 - 1, 2**32 - 1


def _free_memory() -> int | None:
    """Bytes that this process may still take; None where the system does not tell."""
    try:
        with open("/proc/meminfo", encoding="ascii") as file:
            table = dict(line.split(":") for line in file)
        return int(table["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):
        pass
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, AttributeError):
        return None


def size_text(number: float) -> str:
    """Bytes as a person says them."""
    for unit in ("bytes", "kB", "MB", "GB", "TB"):
        if number < 1000 or unit == "TB":
            return f"{number:.0f} {unit}" if unit == "bytes" else f"{number:.3g} {unit}"
        number /= 1000
    raise AssertionError


def require(needed: float, what: str, advice: str) -> None:
    """Checks that this machine has memory free.

    Parameters
    ----------
    needed : bytes
    what : begins the message, for instance "reading cloud.nc"
    advice : ends it

    Raises
    ------
    DataError : there is less
    """
    free = _free_memory()
    if free is not None and needed > free:
        raise DataError(
            f"{what} needs about {size_text(needed)} of memory, this machine has {size_text(free)} free: {advice}"
        )


def _require_on_device(device: Device, total: float, largest: float, on_host: float, what: str, advice: str) -> None:
    for needed, there, words in (
        (total, device.opencl.global_mem_size, "has"),
        (largest, device.opencl.max_mem_alloc_size, "gives at most"),
    ):
        if needed > there:
            piece = "" if needed is total else " in one piece"
            raise DeviceError(
                f"{what} needs about {size_text(needed)} of memory{piece}, device {device.name} {words} "
                f"{size_text(there)}: {advice}"
            )
    # A CPU's memory is the machine's own.
    require(on_host + (total if device.shares_memory else 0), what, advice)


def _count(numbers: Sequence[int]) -> int:
    product = 1
    for number in numbers:
        product *= int(number)  # Python's integers do not overflow
    return product


def _pixels(views: Sequence[Any]) -> int:
    return sum(_count(view.pixels) for view in views)


def require_grid(shape: Sequence[int], what: str) -> None:
    """Checks that an extinction of this shape can be made. DataError if not."""
    voxels = _count(shape)
    if voxels > _MOST_VOXELS:
        raise DataError(f"{what}: {_shape(shape)} voxels are more than kernels count ({_MOST_VOXELS}): use fewer")
    require(_GENERATED_VOXEL * voxels, f"{what}: an extinction of {_shape(shape)} voxels", "use fewer")


def require_rendering(device: Device, shape: Sequence[int], views: Sequence[Any]) -> None:
    """Checks that images of a grid can be rendered.

    Raises
    ------
    DataError : the machine has not enough memory, or there are more voxels or pixels than kernels count
    DeviceError : the device has not enough memory
    """
    pixels, voxels = _pixels(views), _count(shape)
    what = f"rendering {pixels} pixels of {_shape(shape)} voxels"
    if pixels > _MOST_PIXELS or voxels > _MOST_VOXELS:
        raise DataError(f"{what} is more than kernels count ({_MOST_PIXELS} pixels, {_MOST_VOXELS} voxels): use fewer")
    total = _RENDER_VOXEL * voxels + _RENDER_PIXEL * pixels
    largest = max(_RENDER_VOXEL // 2 * voxels, _RENDER_PIXEL // 2 * pixels)
    _require_on_device(device, total, largest, _HOST_PIXEL * pixels, what, "choose fewer pixels or voxels")


def require_reconstruction(
    device: Device, shape: Sequence[int], stage_shapes: Sequence[Sequence[int]], pixels: int, samples: int
) -> None:
    """Checks that the largest stage of a reconstruction fits, before the first one is begun.

    Parameters
    ----------
    shape, stage_shapes : of the finest grid, and of those of the stages
    pixels, samples : the largest numbers of pixels of a stage, and of paths for each

    Raises
    ------
    DataError, DeviceError : as `require_rendering`
    """
    voxels = max(_count(stage) for stage in stage_shapes)
    finest = _count(shape)
    what = f"a reconstruction with {_shape(max(stage_shapes, key=_count))} voxels and {pixels} pixels"
    if max(voxels, finest) > _MOST_VOXELS:
        raise DataError(f"{what} has more voxels than the {_MOST_VOXELS} that kernels count: use fewer")
    paths = _PATH * pixels * samples
    total = _DESCENT_VOXEL * voxels + _RENDER_PIXEL * pixels + paths
    largest = max(8 * voxels, _RENDER_PIXEL // 2 * pixels)
    host = _HOST_VOXEL * (voxels + finest) + _HOST_PIXEL * pixels
    _require_on_device(device, total, largest, host, what, "choose a coarser [grid] or [[stage]], or fewer samples")


def require_jacobian(pixels: int, voxels: int) -> None:
    """Checks that the derivatives of so many pixels with respect to so many voxels fit, twice. DataError if not."""
    require(
        2 * 4.0 * pixels * voxels,
        f"the derivatives of {pixels} pixels with respect to {voxels} voxels",
        'choose fewer pixels, a coarser [grid] or [[stage]], or optimizer.type = "adam", which keeps none',
    )


def _shape(shape: Sequence[int]) -> str:
    return " x ".join(map(str, shape))
