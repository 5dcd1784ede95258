"""How kernels are compiled for each kind of device, and the size of their work-groups."""

from __future__ import annotations

from typing import Any

WORK_GROUP_SIZE = 64
# With groups of 128 an H200 renders 10 % faster than with groups of 64, and computes derivatives 20 % faster.
GROUP_SIZE_ON_NVIDIA = 128
# Bytes of local memory that a work item takes at most (kernels/walk/kept.h), its part of the group's included.
_KEPT_BYTES = 192


def dialect(regenerates: bool, keeps_local: bool, group_size: int) -> list[str]:
    """Macros in OpenCL C that adapt kernels to a device. The parameters are attributes of `Device`.

    `inline` is made an order, since compilers for CPUs otherwise call functions even in innermost loops. A few large
    functions are LARGE_FUNCTIONs, which CPUs do call: with these inlined kernels would run 5 % faster, but take twice
    as long to build. GPUs inline them, because a call moves a work item's registers into memory. RARELY_READ keeps
    compilers from loading ahead of a loop what few of its iterations need. KEEPS_LOOPS chooses a loop (GPUs) or
    unrolled code (CPUs). kernels/walk/kept.h says where the state of a path in flight is kept.
    """
    always = "inline __attribute__((always_inline))"
    return [
        *(["#define CLOUDTOMO_REGENERATES"] if regenerates else []),
        f"#define inline {always}",
        f"#define LARGE_FUNCTION {'inline' if regenerates else 'static'}",
        *(["#define CLOUDTOMO_KEEPS_LOCAL"] if keeps_local else []),
        f"#define WORK_GROUP_SIZE {group_size}",
        f"#define RARELY_READ {'volatile' if regenerates else ''}",
        f"#define KEEPS_LOOPS {'true' if regenerates else 'false'}",
    ]


def group_size(device: Any) -> int:
    """Work items in a GPU's work-groups: whole warps or wavefronts, WORK_GROUP_SIZE or more if the GPU allows it."""
    width, wanted = 1, GROUP_SIZE_ON_NVIDIA if _is_nvidia(device) else WORK_GROUP_SIZE
    for name in ("warp_size_nv", "wavefront_width_amd", "preferred_work_group_size_multiple"):
        try:
            width = max(width, int(getattr(device, name)))
        except Exception:  # pyopencl's errors, or an attribute that it lacks: another maker's device
            continue
    return max(min(-(-wanted // width) * width, int(device.max_work_group_size)), 1)


def keeps_local(device: Any, size: int) -> bool:
    """Whether a GPU keeps the state of paths in local memory, in work-groups of `size` work items.

    NVIDIA's GPUs have enough local memory for as many groups as their registers allow; AMD's would run fewer groups.
    """
    return _is_nvidia(device) and size * _KEPT_BYTES <= device.local_mem_size


def _is_nvidia(device: Any) -> bool:
    return "nvidia" in device.vendor.lower()
