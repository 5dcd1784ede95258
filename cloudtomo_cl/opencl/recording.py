"""Launches that are repeated with the same arguments: the driver gets the arguments only once.

Converting a kernel's arguments and handing them to the driver takes the host several times as long as launching it
(docs/decisions/inner-minimisation.md). So the launches of the first iteration are recorded, and repeated in the
others, which work on the same arrays; and with them the exchanges between ranks.
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
    kernel : kernel, of which this object holds a copy until it is closed
    work : number of work items in all, number in a work-group, and offset of the first work item or None
    values : arguments as pyopencl takes them; they are kept alive here, for drivers do not do that
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
    """Launches of one thread, and its steps between them, to be repeated."""

    def __init__(self) -> None:
        self._launches: list[Recorded] = []
        # Launches and other steps, in their order; each is a function of the queue.
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
        """Keeps work that is done between two launches."""
        self._steps.append(lambda _: work())

    def again(self, queue: Any) -> None:
        """Repeats all launches and the steps between them, in their order."""
        for step in self._steps:
            step(queue)

    def close(self) -> None:
        """Gives the copies of kernels back."""
        self._steps.clear()
        while self._launches:
            self._launches.pop().close()


class Recorder(threading.local):
    """The recording that is going on in each thread of a device.

    Attributes
    ----------
    recording : recording of this thread's launches; None: nothing is recorded
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
                recording.close()  # the next call must not take a part of it for the whole
                raise
            finally:
                self.recording = None

        try:
            yield repeat
        finally:
            recording.close()
