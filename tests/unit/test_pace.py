"""Launches that follow a device: groups by its width, sizes by what launches took, one queued behind another."""

from types import SimpleNamespace

import pyopencl as cl
import pytest

from cloudtomo_cl.errors import DeviceError
from cloudtomo_cl.opencl.devices import choose_device
from cloudtomo_cl.opencl.dialect import group_size, keeps_local
from cloudtomo_cl.opencl.pace import Pace


class Clock:
    """A device whose launches take a time that is made up; `waited` has the launches that were waited for."""

    name, first_launch, largest_launch = "made up", 1000, 64000

    def __init__(self, seconds_of):
        self.lock = choose_device().lock
        self.queue = SimpleNamespace(flush=lambda: None)
        self.seconds_of, self.launched, self.waited = seconds_of, [], []

    def launch(self, kernel, work_items):
        number = len(self.launched)
        self.launched.append(work_items)
        profile = SimpleNamespace(start=0, end=int(1e9 * self.seconds_of(work_items)))
        return SimpleNamespace(wait=lambda: self.waited.append(number), profile=profile)


KERNEL = SimpleNamespace(function_name="kernel")


def test_one_launch_is_queued_behind_the_one_that_runs():
    clock = Clock(lambda work_items: 0.1)
    pace = Pace(clock)
    for number in range(4):
        pace.launch(KERNEL, 10)
        assert clock.waited == list(range(number))


@pytest.mark.parametrize("rate", [1e3, 1e4, 1e5, 1e9])
def test_launches_come_to_take_two_fifths_of_a_second(rate):
    clock = Clock(lambda work_items: work_items / rate)
    pace = Pace(clock)
    for _ in range(20):
        pace.launch(KERNEL, pace.work_items)
    assert pace.work_items == pytest.approx(min(0.4 * rate, clock.largest_launch), rel=0.01)
    ratios = [after / before for before, after in zip(clock.launched, clock.launched[1:])]
    assert max(ratios) <= 2 and min(ratios) >= 0.49


def test_a_launch_that_fails_while_it_runs_is_told(monkeypatch):
    def fail():
        raise cl.RuntimeError("clWaitForEvents failed: DEVICE_NOT_AVAILABLE")

    clock = Clock(lambda work_items: 0.1)
    pace = Pace(clock)
    pace.launch(KERNEL, 10)
    pace._queued[0][0].wait = fail
    with pytest.raises(DeviceError, match="device made up: running kernel failed .*DEVICE_NOT_AVAILABLE"):
        pace.launch(KERNEL, 10)


@pytest.mark.parametrize(
    ("said", "size"),
    [
        ({"vendor": "NVIDIA Corporation", "warp_size_nv": 32}, 128),
        ({"wavefront_width_amd": 64}, 64),
        ({"preferred_work_group_size_multiple": 128}, 128),
        ({"preferred_work_group_size_multiple": 24}, 72),
        ({}, 64),
        ({"warp_size_nv": 32, "max_work_group_size": 16}, 16),
        ({"vendor": "NVIDIA Corporation", "warp_size_nv": 32, "max_work_group_size": 64}, 64),
    ],
)
def test_groups_are_whole_warps(said, size):
    assert group_size(SimpleNamespace(**{"vendor": "another", "max_work_group_size": 1024} | said)) == size


@pytest.mark.parametrize(
    ("vendor", "memory", "keeps"),
    [("NVIDIA Corporation", 48 << 10, True), ("NVIDIA Corporation", 8 << 10, False), ("AMD", 64 << 10, False)],
)
def test_paths_are_kept_in_local_memory_where_there_is_enough(vendor, memory, keeps):
    assert keeps_local(SimpleNamespace(vendor=vendor, local_mem_size=memory), 64) == keeps


@pytest.mark.parametrize(("units", "paths"), [(4, 1 << 18), (132, 64 * 64 * 132)])
def test_the_first_launch_fills_a_gpu(units, paths):
    own = choose_device()
    own.regenerates, own.opencl = True, SimpleNamespace(max_compute_units=units, global_mem_size=80 * 10**9)
    assert own.first_launch == paths
