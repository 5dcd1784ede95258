"""Launches that are made again and again with the same arguments: a driver is told those once.

To convert the arguments of a kernel and to hand them to the driver takes the host several times as long as to launch
it (docs/decisions/inner-minimisation.md). What an iteration launches on the same arrays is recorded in the first one,
and made again in the others; with it what several ranks tell each other in between.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
    """What one thread has launched, and done in between, to be done again."""

    def __init__(self) -> None:
        self._launches: list[Recorded] = []
        # Launches and other steps, in their order; each is given the queue.
        self._steps: list[Callable[[Any], Any]] = []

    def __len__(self) -> int:
        return len(self._steps)

    def launch(self, queue: Any, kernel: Kernel, work: Work, values: list[Any]) -> Any:
        """Launches a kernel and keeps it; returns its event."""
        launch = Recorded(kernel, work, values)
        self._launches.append(launch)
        self._steps.append(launch)
        return launch(queue)

    def step(self, work: Callable[[], None]) -> None:
        """Keeps what is done between two launches."""
        self._steps.append(lambda _: work())

    def again(self, queue: Any) -> None:
        """Queues all launches again, and does what is done in between, in their order."""
        for step in self._steps:
            step(queue)

    def close(self) -> None:
        """Gives the copies of kernels back."""
        self._steps.clear()
        while self._launches:
            self._launches.pop().close()


class Recorder(threading.local):
    """What a device's threads record, each its own.

    Attributes
    ----------
    recording : that takes down what is launched; none: nothing is recorded
    """

    recording: Recording | None = None

    def step(self, work: Callable[[], None]) -> None:
        """See `Device.step`."""
        if self.recording is not None:
            self.recording.step(work)
        work()

    @contextmanager
    def repeated(self, queue: Any, function: Callable[[], None]) -> Iterator[Callable[[], None]]:
        """See `Device.repeated`."""
        recording = Recording()

        def repeat() -> None:
            if len(recording):
                recording.again(queue)
                return
            self.recording = recording
            try:
                function()
            except BaseException:
                recording.close()  # a part of it must not pass for the whole the next time
                raise
            finally:
                self.recording = None

        try:
            yield repeat
        finally:
            recording.close()
