"""An OpenCL device: its queue, what is built for it, and what lies on it."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import cached_property
from typing import Any

import numpy as np

from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.dialect import WORK_GROUP_SIZE, dialect, group_size, keeps_local
from cloudtomo_cl.opencl.driver import device_errors, import_pyopencl
from cloudtomo_cl.opencl.parameters import TURNS
from cloudtomo_cl.opencl.programs import Programs, compiler_options
from cloudtomo_cl.opencl.recording import Recorder
from cloudtomo_cl.parallel.ranks import ALONE, Ranks

# On a GPU a work item walks several paths, one after the other (kernels/walk/turns.h): _MOST_TURNS at most, and fewer
# where less than _GROUPS_OF_UNIT work-groups would be left for each compute unit, so that none runs out of work.
_MOST_TURNS, _GROUPS_OF_UNIT = 64, 64
# Number of work items of the first launch of a kind, and of the largest launch.
_FIRST_LAUNCH = 1 << 18
_LARGEST_LAUNCH = 1 << 24
# Largest launch on a GPU: one path for every _BYTES_OF_LAUNCH bytes of its memory, at most _LARGEST_ON_GPU paths.
_BYTES_OF_LAUNCH, _LARGEST_ON_GPU = 256, 1 << 27
# Drivers that are known to compute wrongly: part of the device's name, and the warning when the device is opened.
_FAULTS = {
    "llvmpipe": "it ends loops after 65,535 rounds and says nothing, so paths through thick clouds are cut short "
    "(no audit sees it), and it has crashed in gradients: choose another device for results",
}
_WIDE_ATOMICS_EXTENSION = "cl_khr_int64_base_atomics"
_WIDE_ATOMICS, _NARROW_ATOMICS = "64-bit atomics", "32-bit atomics with carry"


def accumulation(device: Any) -> str:
    """How kernels add in fixed point on it, in words."""
    return _WIDE_ATOMICS if _WIDE_ATOMICS_EXTENSION in device.extensions.split() else _NARROW_ATOMICS


class Device:
    """An OpenCL device with its context, queue and built kernels.

    Attributes
    ----------
    is_cpu : whether the device is a CPU. An accelerator does not count as one, even if it shares the machine's memory
    lock : lock that a thread holds while it builds a kernel, or sets a kernel's arguments and launches it
    regenerates : whether a work item that has finished its path takes another one: true on GPUs, whose work items run
        in lockstep
    keeps_local : whether the state of a path in flight is kept in local memory (kernels/walk/kept.h)
    group_size : number of work items in a work-group
    options : options of the kernel compiler
    ranks : ranks that share the computations; each of them has opened a device
    """

    @device_errors("opening the device")
    def __init__(self, opencl_device: Any, ranks: Ranks = ALONE) -> None:
        cl = import_pyopencl()
        self.opencl, self.ranks = opencl_device, ranks
        self.context = cl.Context([opencl_device])
        self.queue = cl.CommandQueue(self.context, properties=cl.command_queue_properties.PROFILING_ENABLE)
        self.name = opencl_device.name.strip()
        self.accumulation = accumulation(opencl_device)
        self.is_cpu = bool(opencl_device.type & cl.device_type.CPU)
        self.regenerates = bool(opencl_device.type & cl.device_type.GPU)
        self.group_size = group_size(opencl_device) if self.regenerates else WORK_GROUP_SIZE
        self.keeps_local = self.regenerates and keeps_local(opencl_device, self.group_size)
        self.options = compiler_options(opencl_device)
        for part, fault in _FAULTS.items():
            if part in self.name:
                warnings.warn(f"device {self.name}: {fault} (`cloudtomo devices` lists them)", RuntimeWarning, 2)
        self.lock = threading.RLock()
        self._recorder = Recorder()
        self._programs = Programs(self.context, self.name)

    def __repr__(self) -> str:
        return f"Device({self.name!r})"

    def __reduce_ex__(self, protocol: Any) -> Any:
        raise TypeError(
            "a Device, and what holds one (operators, problems, Jacobians), can neither be pickled nor copied: it "
            "belongs to this process; make another by choose_device()"
        )

    @property
    def shares_memory(self) -> bool:
        """Whether the device uses the machine's main memory."""
        return bool(self.opencl.host_unified_memory)

    @cached_property
    def preamble(self) -> str:
        """OpenCL C that comes before every kernel's source: what host and kernels share."""
        from cloudtomo_cl.opencl.layout import declarations

        # Without contraction (fused multiply-add) a path is the same to the last bit wherever its code is inlined.
        lines = ["#pragma OPENCL FP_CONTRACT OFF", *dialect(self.regenerates, self.keeps_local, self.group_size)]
        return "\n".join([*lines, declarations(self.opencl)])

    def build(self, source: str) -> Any:
        """Builds OpenCL C that may include the shipped kernel headers; built once per source.

        Raises
        ------
        BuildError : with device, options and the compiler's log
        """
        with self.lock:
            return self._programs.built(source, self.preamble, self._all_options)

    @property
    def _all_options(self) -> tuple[str, ...]:
        return (*self.options, *(("-D", "CLOUDTOMO_WIDE_ATOMICS") if self.accumulation == _WIDE_ATOMICS else ()))

    def kernel(self, file: str, name: str, features: tuple[str, ...] = ()) -> Any:
        """A kernel of a shipped file, for instance kernel("image", "render_paths"); parameters.py has its parameters.

        features : macros that switch on code which only some scenes need, for instance
            ("CLOUDTOMO_PHASE_TABLE",)
        """
        with self.lock:
            return self._programs.kernel(file, name, features, self.preamble, self._all_options)

    def constant(self, values: np.ndarray) -> Any:
        """A buffer with a copy of an array, for kernels to read."""
        cl = import_pyopencl()
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        # OpenCL has no empty buffers.
        held = values if values.size else np.zeros(1, values.dtype)
        return cl.Buffer(self.context, flags, hostbuf=np.ascontiguousarray(held))

    def array(self, values: np.ndarray) -> DeviceArray:
        """A copy of an array, on the device."""
        import pyopencl.array

        return pyopencl.array.to_device(self.queue, np.ascontiguousarray(values))

    def buffer(self, size: int) -> Any:
        """A buffer of `size` bytes on the device, not initialised: for arrays of structs."""
        cl = import_pyopencl()
        return cl.Buffer(self.context, cl.mem_flags.READ_WRITE, size)

    def clear(self, buffer: Any) -> None:
        """Sets all bytes of a buffer, or of an array's buffer, to 0."""
        cl = import_pyopencl()
        memory = getattr(buffer, "data", buffer)
        cl.enqueue_fill_buffer(self.queue, memory, np.zeros(1, np.uint8), 0, memory.size)

    def read(self, buffer: Any, values: np.ndarray, offset: int = 0) -> None:
        """Fills an array of the host from a buffer, from its byte `offset` on."""
        import_pyopencl().enqueue_copy(self.queue, values, buffer, src_offset=offset)

    def write(self, buffer: Any, values: np.ndarray, offset: int = 0, wait: bool = True) -> Any:
        """Copies an array of the host into a buffer, from its byte `offset` on; returns the event.

        With wait=False the caller must keep the event, and leave the values unchanged, until the event has ended.
        """
        held = np.ascontiguousarray(values)
        return import_pyopencl().enqueue_copy(self.queue, buffer, held, dst_offset=offset, is_blocking=wait)

    def copied(self, array: DeviceArray) -> np.ndarray:
        """A copy on the host of a large array. One by pyopencl's `get` would live as long as the device's array."""
        values = np.empty(array.shape, array.dtype)
        if values.size:
            self.read(array.data, values)
        return values

    def is_array(self, value: Any) -> bool:
        """Whether something is an array on a device."""
        import pyopencl.array

        return isinstance(value, pyopencl.array.Array)

    def zeros(self, shape: Any, dtype: Any) -> DeviceArray:
        """An array of zeros on the device."""
        import pyopencl.array

        return pyopencl.array.zeros(self.queue, shape, dtype)

    def empty(self, shape: Any, dtype: Any) -> DeviceArray:
        """An array on the device that is not initialised."""
        import pyopencl.array

        return pyopencl.array.empty(self.queue, shape, dtype)

    @property
    def first_launch(self) -> int:
        """Work items of the first launch of a kind; on a GPU the number of paths, enough for all compute units."""
        if not self.regenerates:
            return _FIRST_LAUNCH
        enough = _GROUPS_OF_UNIT * self.group_size * int(self.opencl.max_compute_units)
        return min(max(_FIRST_LAUNCH, enough), self.largest_launch)

    @property
    def largest_launch(self) -> int:
        """Work items of the largest launch; on a GPU the number of paths. A power of two."""
        if not self.regenerates:
            return _LARGEST_LAUNCH
        paths = int(self.opencl.global_mem_size) // _BYTES_OF_LAUNCH
        return min(1 << max(paths.bit_length() - 1, 0), _LARGEST_ON_GPU)

    def turns(self, paths: int) -> int:
        """Number of paths that each work item walks in a launch of `paths` paths: a power of two."""
        if not self.regenerates:
            return 1
        most = paths // (self.group_size * _GROUPS_OF_UNIT * self.opencl.max_compute_units)
        return min(1 << max(most.bit_length() - 1, 0), _MOST_TURNS)

    def launch(self, kernel: Any, work_items: int, *arguments: Any, global_offset: int = 0, **named: Any) -> Any:
        """Queues a kernel on at least `work_items` work items from `global_offset` on (kernels skip the surplus).

        For kernels that take turns (kernels/walk/turns.h) `work_items` is the number of paths, which fewer work items
        walk. Returns the event of the launch.
        """
        turns = 1
        if getattr(kernel, "takes_turns", False):
            turns = named[TURNS] = self.turns(work_items)
        groups = -(-work_items // (self.group_size * turns))
        with device_errors(f"device {self.name}: launching {kernel.function_name}"), self.lock:
            size, group = (groups * self.group_size,), (self.group_size,)
            offset = (global_offset,) if global_offset else None
            recording = self._recorder.recording
            if recording is not None:
                values = kernel.arguments(*arguments, **named)
                return recording.launch(self.queue, kernel, (size, group, offset), values)
            return kernel(self.queue, size, group, *arguments, global_offset=offset, **named)

    def step(self, work: Callable[[], None]) -> None:
        """Does work of the host between two launches. Where these are repeated (`repeated`), it is done again."""
        self._recorder.step(work)

    def repeated(self, function: Callable[[], None]) -> AbstractContextManager[Callable[[], None]]:
        """`function` as one that costs the host much less time when it is called again: see recording.py.

        It must make the same launches on the same arrays in every call, and do nothing else but `step`s.
        """
        return self._recorder.repeated(self.queue, function)
