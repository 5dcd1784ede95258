"""Sums that 1e9 photons have filled take the next ones as well as the first: means do not drift.

A run of 1e9 photons takes too long for a test. What it would leave behind is put into the sums, and the kernels add on
top of it what a short run brings. Expected: the difference is that run's own sum, in double precision.
"""

import numpy as np
import pyopencl as cl
import pytest

from cloudtomo_cl.opencl.layout import STRUCTS, WEIGHT_UNIT

PHOTONS_BEFORE = 1_000_000_000
PATHS = 100_000


@pytest.fixture(scope="module")
def radiances():
    """Of paths through thin cloud: most bring little, few much, sr^-1."""
    return (0.0016 * np.random.default_rng(7).lognormal(-1.0, 1.5, PATHS)).astype(np.float32)


def two_floats(value):
    """A number as the sum of two floats, as the kernel keeps it."""
    high = np.float32(value)
    return high, np.float32(value - float(high))


def test_radiances_on_top_of_a_billion(device, radiances):
    exact = radiances.astype(float)
    halves = np.array([exact[0::2].sum(), exact[1::2].sum()])
    before = np.zeros(1, STRUCTS["PixelSums"])
    for half in (0, 1):
        high, low = two_floats(halves[half] / (PATHS / 2) * PHOTONS_BEFORE / 2)
        before["half_sum"][0, half], before["half_low"][0, half] = high, low
    before["square_sum"][0], before["square_low"][0] = two_floats((exact**2).mean() * PHOTONS_BEFORE)
    after = before.copy()
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    sums = cl.Buffer(device.context, flags, hostbuf=after)
    kernel = device.kernel("image", "sum_paths")
    device.launch(kernel, 1, device.constant(radiances), 1, 0, 0, PATHS, sums)
    cl.enqueue_copy(device.queue, after, sums)

    def total(sums, name):
        return sums[f"{name}_sum"][0].astype(float) + sums[f"{name}_low"][0]

    np.testing.assert_allclose(total(after, "half") - total(before, "half"), halves, rtol=1e-5)
    np.testing.assert_allclose(total(after, "square") - total(before, "square"), (exact**2).sum(), rtol=1e-4)
    # In one float these paths would be lost altogether.
    assert before["half_sum"][0, 0] + np.float32(np.median(radiances)) == before["half_sum"][0, 0]


@pytest.mark.parametrize("atomics", ["probe", "probe_with_narrow_atomics"])
def test_fluxes_on_top_of_a_billion(request, atomics):
    """The sums of fluxes and of the audit are integers: to the last unit."""
    probe = request.getfixturevalue(atomics)
    weights = np.random.default_rng(8).random(PATHS).astype(np.float32) * np.float32(WEIGHT_UNIT)
    before = np.int64(PHOTONS_BEFORE * WEIGHT_UNIT)
    (after,) = probe("probe_accumulate", PATHS, np.uint32(1), weights, results=[np.full(1, before)])
    assert after - before == int(np.rint(weights.astype(float)).sum())
