"""OpenCL devices: list them, choose one, build kernels for it."""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from cloudtomo_cl.errors import BuildError, DeviceError
from cloudtomo_cl.opencl import kernel_cache
from cloudtomo_cl.opencl.arrays import DeviceArray
from cloudtomo_cl.opencl.dialect import WORK_GROUP_SIZE, dialect, group_size, keeps_local
from cloudtomo_cl.opencl.parameters import KERNELS, TURNS, Kernel
from cloudtomo_cl.opencl.recording import Recorder
from cloudtomo_cl.parallel.ranks import ALONE, Ranks

ENVIRONMENT_VARIABLE = "CLOUDTOMO_DEVICE"
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
# Environment variables for the number of threads of PoCL's CPU device, in earlier and in later releases.
_THREADS_OF_POCL = ("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT")
_WIDE_ATOMICS_EXTENSION = "cl_khr_int64_base_atomics"
_WIDE_ATOMICS, _NARROW_ATOMICS = "64-bit atomics", "32-bit atomics with carry"


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


def _import_pyopencl() -> Any:
    # PoCL's wheel warns about every kernel that it compiles; a failed build raises anyway.
    os.environ.setdefault("PYOPENCL_COMPILER_OUTPUT", "0")
    import pyopencl

    return pyopencl


# Id of the process that has used OpenCL. What drivers set up there does not work in a forked process.
_process: list[int] = []


def check_process() -> None:
    """Raises DeviceError in a process forked from one that had used OpenCL: its drivers would wait for ever."""
    if _process and os.getpid() not in _process:
        raise DeviceError(
            "this process was forked from one that had used OpenCL, whose drivers do not work here: start processes "
            'by multiprocessing.get_context("spawn"), or use no device before the fork'
        )


# OpenCL's error codes for a lack of memory; INVALID_BUFFER_SIZE: a buffer is larger than the device allows.
_OUT_OF_MEMORY = ("MEM_OBJECT_ALLOCATION_FAILURE", "OUT_OF_RESOURCES", "OUT_OF_HOST_MEMORY", "INVALID_BUFFER_SIZE")


@contextmanager
def device_errors(doing: str) -> Iterator[None]:
    """Turns OpenCL's errors into DeviceError with advice; around a block, or as a decorator."""
    check_process()
    try:
        yield
    except Exception as error:
        cl = _import_pyopencl()
        if not isinstance(error, cl.Error):
            raise
        text = str(error).splitlines()[0] if str(error) else type(error).__name__
        if isinstance(error, cl.MemoryError) or any(code in text for code in _OUT_OF_MEMORY):
            advice = "the device has not enough memory: choose fewer voxels, pixels or samples, or another device"
        else:
            advice = "the device or its driver failed: check it, or choose another device"
        raise DeviceError(f"{doing} failed ({text}): {advice} (`cloudtomo devices` lists them)") from None


def kernels_folder() -> Path:
    """Where the kernels' sources are: in the installed package, or beside it in a checkout."""
    package = Path(__file__).parent.parent
    installed = package / "kernels"
    return installed if installed.is_dir() else package.parent / "kernels"


@contextmanager
def _include_folders() -> Iterator[list[str]]:
    """Folders in which compilers find the headers; a copy where a space in the path would confuse PoCL's compiler."""
    import pyopencl

    ours = kernels_folder()
    # pyopencl adds a folder of headers to the options itself, but PoCL cannot read a path with a space.
    theirs = Path(pyopencl.__file__).parent / "cl"
    folders = [folder for folder in (ours, theirs) if " " in str(folder)]
    if not folders or " " in tempfile.gettempdir():
        yield [str(ours)]
        return
    with tempfile.TemporaryDirectory(prefix="cloudtomo-") as copy:
        for folder in {ours, *folders}:
            shutil.copytree(folder, copy, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
        yield [copy]


def _opencl_devices() -> list[Any]:
    """All devices, GPUs first, in the order the platforms give them."""
    check_process()
    kernel_cache.prepare()
    cl = _import_pyopencl()
    if not _process:
        _process.append(os.getpid())
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


def _accumulation(device: Any) -> str:
    return _WIDE_ATOMICS if _WIDE_ATOMICS_EXTENSION in device.extensions.split() else _NARROW_ATOMICS


def _kind(device: Any) -> str:
    cl = _import_pyopencl()
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
            accumulation=_accumulation(device),
        )
        for index, device in enumerate(_opencl_devices())
    ]


def _options(device: Any) -> tuple[str, ...]:
    """Compiler options: no warnings on the user's terminal; on GPUs divisions and square roots rounded as on CPUs."""
    cl = _import_pyopencl()
    options: tuple[str, ...] = ("-cl-std=CL1.2", "-w")
    exact = bool(device.single_fp_config & cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT)
    if exact and device.type & cl.device_type.GPU:
        options += ("-cl-fp32-correctly-rounded-divide-sqrt",)
    return options


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
        cl = _import_pyopencl()
        self.opencl, self.ranks = opencl_device, ranks
        self.context = cl.Context([opencl_device])
        self.queue = cl.CommandQueue(self.context, properties=cl.command_queue_properties.PROFILING_ENABLE)
        self.name = opencl_device.name.strip()
        self.accumulation = _accumulation(opencl_device)
        self.is_cpu = bool(opencl_device.type & cl.device_type.CPU)
        self.regenerates = bool(opencl_device.type & cl.device_type.GPU)
        self.group_size = group_size(opencl_device) if self.regenerates else WORK_GROUP_SIZE
        self.keeps_local = self.regenerates and keeps_local(opencl_device, self.group_size)
        self.options = _options(opencl_device)
        for part, fault in _FAULTS.items():
            if part in self.name:
                warnings.warn(f"device {self.name}: {fault} (`cloudtomo devices` lists them)", RuntimeWarning, 2)
        self.lock = threading.RLock()
        self._recorder = Recorder()
        self._programs: dict[str, Any] = {}
        self._kernels: dict[tuple[str, str, tuple[str, ...]], Any] = {}

    def __repr__(self) -> str:
        return f"Device({self.name!r})"

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
            return self._built(source)

    def _built(self, source: str) -> Any:
        if source not in self._programs:
            cl = _import_pyopencl()
            kernel_cache.check()
            with _include_folders() as folders:
                options = list(self.options)
                for folder in folders:
                    options += ["-I", folder]
                if self.accumulation == _WIDE_ATOMICS:
                    options += ["-D", "CLOUDTOMO_WIDE_ATOMICS"]
                try:
                    with warnings.catch_warnings():
                        # A compiler's warnings about a build that succeeded do not concern users.
                        warnings.simplefilter("ignore", cl.CompilerWarning)
                        self._programs[source] = cl.Program(self.context, f"{self.preamble}\n{source}").build(options)
                except cl.Error as error:
                    space = any(" " in option for option in options)
                    hint = "\na space in the folder's name may be the cause: install elsewhere" if space else ""
                    raise BuildError(
                        f"device {self.name}: a kernel did not build; choose another device (`cloudtomo devices` lists "
                        f"them) or report this text\noptions: {' '.join(options)}\n{error}{hint}"
                    ) from None
        return self._programs[source]

    def kernel(self, file: str, name: str, features: tuple[str, ...] = ()) -> Any:
        """A kernel of a shipped file, for instance kernel("image", "render_paths"); parameters.py has its parameters.

        features : macros that switch on code which only some scenes need, for instance
            ("CLOUDTOMO_PHASE_TABLE",)
        """
        with self.lock:
            return self._made(file, name, features)

    def _made(self, file: str, name: str, features: tuple[str, ...]) -> Any:
        if (file, name, features) not in self._kernels:
            cl = _import_pyopencl()
            source = "".join(f"#define {feature}\n" for feature in features) + f'#include "{file}.cl"\n'
            program = self.build(source)
            with device_errors(f"making the kernel {name}"):
                self._kernels[file, name, features] = Kernel(cl.Kernel(program, name), name, KERNELS[name])
        return self._kernels[file, name, features]

    def constant(self, values: np.ndarray) -> Any:
        """A buffer with a copy of an array, for kernels to read."""
        cl = _import_pyopencl()
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
        cl = _import_pyopencl()
        return cl.Buffer(self.context, cl.mem_flags.READ_WRITE, size)

    def clear(self, buffer: Any) -> None:
        """Sets all bytes of a buffer, or of an array's buffer, to 0."""
        cl = _import_pyopencl()
        memory = getattr(buffer, "data", buffer)
        cl.enqueue_fill_buffer(self.queue, memory, np.zeros(1, np.uint8), 0, memory.size)

    def read(self, buffer: Any, values: np.ndarray, offset: int = 0) -> None:
        """Fills an array of the host from a buffer, from its byte `offset` on."""
        _import_pyopencl().enqueue_copy(self.queue, values, buffer, src_offset=offset)

    def write(self, buffer: Any, values: np.ndarray, offset: int = 0, wait: bool = True) -> Any:
        """Copies an array of the host into a buffer, from its byte `offset` on; returns the event.

        With wait=False the caller must keep the event, and leave the values unchanged, until the event has ended.
        """
        held = np.ascontiguousarray(values)
        return _import_pyopencl().enqueue_copy(self.queue, buffer, held, dst_offset=offset, is_blocking=wait)

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
    if not isinstance(communicator, Ranks):
        from cloudtomo_cl.parallel.mpi import MPIRanks

        communicator = MPIRanks(communicator)
    if communicator.size > 1:
        for variable in _THREADS_OF_POCL:
            os.environ.setdefault(variable, str(communicator.cores))
    return communicator
