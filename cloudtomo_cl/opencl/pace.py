"""The size of launches: short enough for a desktop's watchdog and a progress bar, with one more always queued."""

from __future__ import annotations

from collections import deque
from typing import Any

from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.driver import device_errors

# Seconds that a launch should take, and number of launches queued behind the one that runs.
_LAUNCH_SECONDS, _AHEAD = 0.4, 1


class Pace:
    """Sizes launches by the time of those before, and keeps the device busy while the host prepares the next one.

    Attributes
    ----------
    work_items : number of work items that the next launch should have
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self.work_items = device.first_launch
        self._queued: deque[tuple[Any, int]] = deque()

    def launch(self, kernel: Any, work_items: int, *arguments: Any, **named: Any) -> None:
        """Queues a kernel, and waits until all before the last one have ended; the queue runs them in order."""
        event = self.device.launch(kernel, work_items, *arguments, **named)
        with device_errors(f"device {self.device.name}: running {kernel.function_name}"):
            with self.device.lock:
                self.device.queue.flush()
                self._queued.append((event, work_items))
                ended = [self._queued.popleft() for _ in range(len(self._queued) - _AHEAD)]
            for before, count in ended:
                before.wait()
                self._learn(count, 1e-9 * (before.profile.end - before.profile.start))

    def _learn(self, work_items: int, seconds: float) -> None:
        wanted = work_items / max(seconds, 1e-6) * _LAUNCH_SECONDS
        self.work_items = int(min(max(wanted, self.work_items // 2), 2 * self.work_items, self.device.largest_launch))
