"""Renders and replays with registers limited by the driver's compiler: what fewer bring, or cost in spills.

NVIDIA's compiler takes the limit as an option; other drivers are left alone.
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterator

import numpy as np
from benchmarks.scenes import Case, generated, scene_c

import cloudtomo_cl as ct
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.devices import choose_device
from gpu.rows import Row, failed

_PART = "registers"
_LIMITS = (None, 128, 96, 80, 64)
_SECONDS, _REPEATS = 0.5, 3
_MOST_STORED = 1 << 13  # paths a pixel of a render that is replayed


def built(limit: int | None) -> Device:
    """The device, with kernels of at most so many registers."""
    device = choose_device()
    own = ["-cl-nv-verbose", *([f"-cl-nv-maxrregcount={limit}"] if limit else [])]
    device.options = (*device.options, *own)
    return device


def used(device: Device) -> str:
    """What the compiler says of the kernels that have been built."""
    import pyopencl

    said = ""
    for program in device._programs:
        log = program.get_build_info(device.opencl, pyopencl.program_build_info.LOG)
        for name, rest in re.findall(r"entry function '(\w+)'(.*?Used \d+ registers)", log, flags=re.DOTALL):
            spills = re.search(r"(\d+) bytes spill stores, (\d+) bytes spill loads", rest)
            registers = re.search(r"Used (\d+) registers", rest)
            said += f"{name}: {registers[1] if registers else '?'} registers, {spills[0] if spills else '?'}; "
    return said or "the compiler does not say"


def rows(quick: bool) -> Iterator[Row]:
    os.environ["PYOPENCL_NO_CACHE"] = "1"  # what comes from there says nothing of its registers
    if "nvidia" not in choose_device().opencl.vendor.lower():
        yield Row(_PART, "limits", "-", note="for NVIDIA's driver only; scripts/gpu_registers.py counts without one")
        return
    try:
        case = scene_c()
    except FileNotFoundError:
        case = generated(64)
    for limit in _LIMITS:
        try:
            device = built(limit)
            what = f"at most {limit} registers" if limit else "no limit"
            for name, speed in speeds(case, device):
                yield Row(_PART, f"{case.name}, {name}, {what}", speed, "paths/s", used(device))
        except ct.CloudtomoError as error:
            yield failed(_PART, f"limit {limit}: {error}")


def speeds(case: Case, device: Device) -> Iterator[tuple[str, float]]:
    """Paths a second by the clock, of renders and of gradients by replay."""
    operator = ct.RadianceOperator(case.scene, (case.view,), device, mask=case.extinction > 0)
    adjoint = np.full((len(operator.pixels), 2), 0.5)
    medium, samples, took = operator.on_device(case.extinction), 64, 0.0
    while took < _SECONDS and samples < 1 << 20:
        samples *= 2
        took = clocked(lambda n=samples: operator.render(medium, n, n))
    taken = [clocked(lambda n=seed: operator.render(medium, samples, n)) for seed in range(_REPEATS)]
    yield "render", samples * len(operator.pixels) / float(np.median(taken))
    samples = min(samples, _MOST_STORED)
    rendering = operator.render(case.extinction, samples, 1, store_paths=True)
    operator.gradient(rendering, adjoint).get()  # builds the kernels
    taken = [clocked(lambda: operator.gradient(rendering, adjoint).get()) for _ in range(_REPEATS)]
    yield "replay", samples * len(operator.pixels) / float(np.median(taken))


def clocked(work: Callable[[], object]) -> float:
    """Seconds by the clock."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
