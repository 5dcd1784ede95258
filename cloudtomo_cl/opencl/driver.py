"""pyopencl and the drivers below it: when they are imported, where they may be used, and what their errors say."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from cloudtomo_cl.errors import DeviceError


def import_pyopencl() -> Any:
    """The package, imported when it is first needed."""
    # PoCL's wheel warns about every kernel that it compiles; a failed build raises anyway.
    os.environ.setdefault("PYOPENCL_COMPILER_OUTPUT", "0")
    import pyopencl

    return pyopencl


# Id of the process that has used OpenCL. What drivers set up there does not work in a forked process.
_PROCESS: list[int] = []


def check_process() -> None:
    """Raises DeviceError in a process forked from one that had used OpenCL: its drivers would wait for ever."""
    if _PROCESS and os.getpid() not in _PROCESS:
        raise DeviceError(
            "this process was forked from one that had used OpenCL, whose drivers do not work here: start processes "
            'by multiprocessing.get_context("spawn"), or use no device before the fork'
        )


def use_from_here() -> None:
    """Takes note that this process uses OpenCL. DeviceError as `check_process`."""
    check_process()
    if not _PROCESS:
        _PROCESS.append(os.getpid())


# OpenCL's error codes for a lack of memory; INVALID_BUFFER_SIZE: a buffer is larger than the device allows.
_OUT_OF_MEMORY = ("MEM_OBJECT_ALLOCATION_FAILURE", "OUT_OF_RESOURCES", "OUT_OF_HOST_MEMORY", "INVALID_BUFFER_SIZE")


@contextmanager
def device_errors(doing: str) -> Iterator[None]:
    """Turns OpenCL's errors into DeviceError with advice; around a block, or as a decorator."""
    check_process()
    try:
        yield
    except Exception as error:
        cl = import_pyopencl()
        if not isinstance(error, cl.Error):
            raise
        text = str(error).splitlines()[0] if str(error) else type(error).__name__
        if isinstance(error, cl.MemoryError) or any(code in text for code in _OUT_OF_MEMORY):
            advice = "the device has not enough memory: choose fewer voxels, pixels or samples, or another device"
        else:
            advice = "the device or its driver failed: check it, or choose another device"
        raise DeviceError(f"{doing} failed ({text}): {advice} (`cloudtomo devices` lists them)") from None
