"""Times of kernels by the device's own clock, and how long lanes of a warp would wait for each other."""

from __future__ import annotations

import importlib
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any
from unittest import mock

import numpy as np
import pyopencl as cl
from benchmarks.scenes import Case, generated, scene_c

import cloudtomo_cl as ct
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.devices import choose_device
from cloudtomo_cl.opencl.parameters import Kernel
from cloudtomo_cl.opencl.recording import Recorded
from gpu.rows import Row

_PART = "kernels"
_SAMPLES, _QUICK_SAMPLES = 2048, 64
_WIDTH = 32  # lanes in step: a warp


class Recorder:
    """A device whose queue keeps times, and the launches of kernels on it.

    Attributes
    ----------
    events : (kernel, event) of every launch
    """

    def __init__(self) -> None:
        self.events: list[tuple[str, Any]] = []
        self.device: Device = choose_device()
        self.device.queue = cl.CommandQueue(
            self.device.context, properties=cl.command_queue_properties.PROFILING_ENABLE
        )
        for kind in (Kernel, Recorded):
            mock.patch.object(kind, "__call__", self._keeping(kind.__call__)).start()

    def _keeping(self, launch: Callable[..., Any]) -> Callable[..., Any]:
        """A launch whose event is kept."""

        def kept(kernel: Kernel | Recorded, *arguments: Any, **named: Any) -> Any:
            event = launch(kernel, *arguments, **named)
            self.events.append((kernel.function_name, event))
            return event

        return kept

    def clear(self) -> None:
        self.device.queue.finish()
        self.events.clear()

    def seconds(self) -> dict[str, float]:
        """By kernel."""
        self.device.queue.finish()
        total: dict[str, float] = defaultdict(float)
        for name, event in self.events:
            total[name] += 1e-9 * (event.profile.end - event.profile.start)
        return dict(total)


def rows(quick: bool) -> Iterator[Row]:
    try:
        case: Case = scene_c()
    except FileNotFoundError:
        case = generated(64)
    recorder = Recorder()
    samples = _QUICK_SAMPLES if quick else _SAMPLES
    operator = ct.RadianceOperator(case.scene, (case.view,), recorder.device, mask=case.extinction > 0)
    adjoint = np.full((len(operator.pixels), 2), 0.5)
    # Builds the kernels, for launches of these sizes.
    operator.gradient(operator.render(case.extinction, samples, 1, store_paths=True), adjoint).get()
    recorder.clear()
    start = time.perf_counter()
    rendering = operator.render(case.extinction, samples, 1, store_paths=True)
    operator.gradient(rendering, adjoint).get()
    took = time.perf_counter() - start
    times = recorder.seconds()
    paths = samples * len(operator.pixels)
    for name, seconds in sorted(times.items(), key=lambda item: -item[1]):
        launches = sum(one == name for one, _ in recorder.events)
        yield Row(_PART, f"{name}, {case.name}", 1e9 * seconds / paths, "ns a path", f"{launches} launches")
    yield Row(_PART, "image and gradient: share in which the device idles", 1 - sum(times.values()) / took)
    divergence = importlib.import_module("divergence")
    steps = divergence.steps_by_event(case, 64)
    width = f"in step by {_WIDTH}"
    idle = divergence.idle_in_step(steps.reshape(-1, _WIDTH, steps.shape[-1]))
    again = divergence.idle_with_regeneration(steps.reshape(-1, steps.shape[-1]), _WIDTH)
    yield Row(_PART, f"lanes idle, {width}, a path each", idle, "", "counted on the walks")
    yield Row(_PART, f"lanes idle, {width}, with regeneration", again, "", "counted on the walks")
