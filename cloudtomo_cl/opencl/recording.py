"""Launches that are made again and again with the same arguments: a driver is told those once.

To convert the arguments of a kernel and to hand them to the driver takes the host several times as long as to launch
it (docs/decisions/inner-minimisation.md). What an iteration launches on the same arrays is recorded in the first one,
and made again in the others.
"""

from __future__ import annotations

from typing import Any

from cloudtomo_cl.opencl.parameters import Kernel

Work = tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...] | None]


class Recorded:
    """A kernel with its arguments, ready to be launched.

    Parameters
    ----------
    kernel : of which it takes a copy until it is closed
    work : numbers of work items, in all and of a group, and of the first, or None
    values : the arguments as pyopencl takes them; they are kept, for drivers do not
    """

    def __init__(self, kernel: Kernel, work: Work, values: list[Any]) -> None:
        self.function_name = kernel.function_name
        self._kernel, self._work, self._values = kernel, work, values
        self._opencl = kernel.taken()
        self._opencl.set_args(*values)

    def __call__(self, queue: Any) -> Any:
        """Launches it; returns its event."""
        import pyopencl

        return pyopencl.enqueue_nd_range_kernel(queue, self._opencl, *self._work)

    def close(self) -> None:
        """Gives the copy of the kernel back."""
        self._kernel.give_back(self._opencl)


class Recording:
    """What one thread has launched, to be launched again (`Device.repeated`)."""

    def __init__(self) -> None:
        self._launches: list[Recorded] = []

    def __len__(self) -> int:
        return len(self._launches)

    def launch(self, queue: Any, kernel: Kernel, work: Work, values: list[Any]) -> Any:
        """Launches a kernel and keeps it; returns its event."""
        self._launches.append(Recorded(kernel, work, values))
        return self._launches[-1](queue)

    def again(self, queue: Any) -> None:
        """Queues all launches again, in their order."""
        for launch in self._launches:
            launch(queue)

    def close(self) -> None:
        """Gives the copies of kernels back."""
        while self._launches:
            self._launches.pop().close()
