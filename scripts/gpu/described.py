"""The device, its driver and its machine."""

from __future__ import annotations

import platform
import shutil
import subprocess
from collections.abc import Iterator

from cloudtomo_cl.opencl.devices import choose_device
from gpu.rows import Row

_PART = "device"
# What is said of a device: a name, an attribute of pyopencl's, a unit.
_QUESTIONS = (
    ("name", "name", ""),
    ("vendor", "vendor", ""),
    ("version", "version", ""),
    ("driver", "driver_version", ""),
    ("compute units", "max_compute_units", ""),
    ("clock", "max_clock_frequency", "MHz"),
    ("memory", "global_mem_size", "bytes"),
    ("largest buffer", "max_mem_alloc_size", "bytes"),
    ("local memory", "local_mem_size", "bytes"),
    ("largest work group", "max_work_group_size", "work items"),
    ("single precision", "single_fp_config", "bits"),
)


def rows(quick: bool) -> Iterator[Row]:
    device = choose_device()
    yield Row(_PART, "platform", device.opencl.platform.name.strip(), note=device.opencl.platform.version.strip())
    for what, attribute, unit in _QUESTIONS:
        try:
            value = getattr(device.opencl, attribute)
        except Exception as error:  # a driver that does not know a question
            yield Row(_PART, what, "-", note=str(error).splitlines()[0])
            continue
        yield Row(_PART, what, value.strip() if isinstance(value, str) else float(value), unit)
    extensions = device.opencl.extensions.split()
    yield Row(_PART, "accumulates by", device.accumulation)
    yield Row(_PART, "extensions", " ".join(one for one in extensions if "atomic" in one or "fp64" in one) or "-")
    yield Row(_PART, "build options", " ".join(getattr(device, "options", ())) or "-")
    yield Row(_PART, "machine", platform.platform(), note=f"Python {platform.python_version()}")
    if shutil.which("nvidia-smi"):
        query = ["nvidia-smi", "--query-gpu=name,driver_version,memory.total,clocks.max.sm", "--format=csv,noheader"]
        said = subprocess.run(query, capture_output=True, text=True, timeout=30)
        yield Row(_PART, "nvidia-smi", said.stdout.strip() or said.stderr.strip() or "-")
