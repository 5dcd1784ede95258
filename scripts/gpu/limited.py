"""Renders with registers limited by the driver's compiler: what fewer of them bring, or cost in spills.

NVIDIA's compiler takes the limit as an option; other drivers are left alone.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator

import numpy as np
from benchmarks.scenes import generated, scene_c

import cloudtomo_cl as ct
from cloudtomo_cl.opencl.device import Device, choose_device
from gpu.rows import Row, failed

_PART = "registers"
_LIMITS = (None, 128, 96, 80, 64)
_SECONDS = 0.5


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
    for program in device._programs.values():
        log = program.get_build_info(device.opencl, pyopencl.program_build_info.LOG)
        for name, rest in re.findall(r"entry function '(\w+)'(.*?Used \d+ registers)", log, flags=re.DOTALL):
            spills = re.search(r"(\d+) bytes spill stores, (\d+) bytes spill loads", rest)
            registers = re.search(r"Used (\d+) registers", rest)
            said += f"{name}: {registers[1] if registers else '?'} registers, {spills[0] if spills else '?'}; "
    return said or "the compiler does not say"


def rows(quick: bool) -> Iterator[Row]:
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
            operator = ct.RadianceOperator(case.scene, (case.view,), device)
            field, samples = operator.on_device(case.extinction), 64
            took = 0.0
            while took < _SECONDS and samples < 1 << 20:
                samples *= 2
                start = time.perf_counter()
                operator.render(field, samples, samples)
                took = time.perf_counter() - start
            speeds = []
            for seed in range(3):
                start = time.perf_counter()
                operator.render(field, samples, seed)
                speeds.append(samples * len(operator.pixels) / (time.perf_counter() - start))
            what = f"{case.name}, render, at most {limit} registers" if limit else f"{case.name}, render, no limit"
            yield Row(_PART, what, float(np.median(speeds)), "paths/s", used(device))
        except ct.CloudtomoError as error:
            yield failed(_PART, f"limit {limit}: {error}")
