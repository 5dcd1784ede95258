"""Calls of single kernel functions, through tests/kernels/probes.cl."""

from pathlib import Path

import numpy as np
import pyopencl as cl
import pytest

from cloudtomo_cl.opencl.devices import choose_device

SOURCE = Path(__file__).with_name("probes.cl").read_text()


class Probe:
    """Runs probe kernels of one device."""

    def __init__(self, device, features=""):
        self.device = device
        self.program = device.build(features + SOURCE)

    def buffer(self, values):
        """A copy of an array on the device."""
        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self.device.context, flags, hostbuf=np.ascontiguousarray(values))

    def __call__(self, name, count, *arguments, results):
        """Runs a kernel on `count` work items.

        Arrays among the arguments are copied to the device; `results` are arrays that come
        after them in the kernel's list and are returned as the kernel left them.
        """
        given = [self.buffer(a) if isinstance(a, np.ndarray) else a for a in arguments]
        returned = [(self.buffer(r), np.array(r)) for r in results]
        kernel = cl.Kernel(self.program, name)
        self.device.launch(kernel, count, np.uint32(count), *given, *(b for b, _ in returned))
        for buffer, host in returned:
            cl.enqueue_copy(self.device.queue, host, buffer)
        return returned[0][1] if len(returned) == 1 else [host for _, host in returned]


@pytest.fixture(scope="session")
def probe(device):
    return Probe(device)


@pytest.fixture(scope="session")
def probe_with_narrow_atomics():
    """A device that builds its kernels without 64-bit atomics."""
    device = choose_device()
    device.accumulation = "32-bit atomics with carry"
    return Probe(device)


@pytest.fixture(scope="session")
def probe_table(device):
    """With droplets that have a phase table."""
    return Probe(device, "#define CLOUDTOMO_PHASE_TABLE\n")
