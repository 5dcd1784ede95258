"""What kernels are compiled like for a kind of device, and in what groups their work items run."""

from __future__ import annotations

from typing import Any

WORK_GROUP_SIZE = 64
# An H200 renders 10 % faster than with groups of 64, and makes derivatives 20 % faster.
GROUP_SIZE_ON_NVIDIA = 128
# Local memory that a work item takes at most (kernels/walk/kept.h), with what groups have beside it.
_KEPT_BYTES = 192


def dialect(regenerates: bool, keeps_local: bool, group_size: int) -> list[str]:
    """What kernels are to be compiled like, in OpenCL C; the attributes of `Device`.

    `inline` is an order: compilers for CPUs make functions of what is called in innermost loops. The few large
    functions that they had better keep are LARGE_FUNCTIONs; all inlined, the kernels run 5 % faster and take twice
    the time to build. GPUs have them inlined, for a call moves what a work item keeps in registers into memory.
    RARELY_READ keeps compilers from loading ahead of a loop what few of its rounds need, KEEPS_LOOPS has loops where
    CPUs have their rounds one after the other. kernels/walk/kept.h says where a path's state is kept while it flies.
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
    """Work items of a GPU's groups: whole warps or waves, by what it says of itself, WORK_GROUP_SIZE or more."""
    width, wanted = 1, GROUP_SIZE_ON_NVIDIA if _is_nvidia(device) else WORK_GROUP_SIZE
    for name in ("warp_size_nv", "wavefront_width_amd", "preferred_work_group_size_multiple"):
        try:
            width = max(width, int(getattr(device, name)))
        except Exception:  # of pyopencl, and attributes that this release lacks: it is another maker's device
            continue
    return max(min(-(-wanted // width) * width, int(device.max_work_group_size)), 1)


def keeps_local(device: Any, size: int) -> bool:
    """Whether a GPU keeps paths in local memory, with groups of a size.

    NVIDIA's have enough of it for as many groups as their registers allow; on AMD's it would allow fewer of them.
    """
    return _is_nvidia(device) and size * _KEPT_BYTES <= device.local_mem_size


def _is_nvidia(device: Any) -> bool:
    return "nvidia" in device.vendor.lower()
