"""Work items that walk several paths, one after the other, as they do on GPUs: here on any device."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import ABOVE, CAMERA, SCENES, extinction_of

import cloudtomo_cl as ct
from cloudtomo_cl.opencl import device as device_module
from cloudtomo_cl.opencl.devices import choose_device
from cloudtomo_cl.transport.audit import Budget
from cloudtomo_cl.transport.jacobian_average import JacobianAverage
from cloudtomo_cl.transport.table_gradient import TableGradient

SAMPLES = 500
CHOSEN = ["forward peak", "air, ground, periodic", "phase table"]


@pytest.fixture(scope="module")
def stepping():
    """A device whose kernels are built for work items that go in step, with several turns even of a few paths."""
    patch = pytest.MonkeyPatch()
    patch.setattr(device_module, "_GROUPS_OF_UNIT", 3)
    device = choose_device()
    device.regenerates = device.keeps_local = True
    yield device
    patch.undo()


def sums_of_budget(operator, extinction, monkeypatch):
    """The integer sums of a rendering's budget, and the rendering."""
    budgets = []

    class Kept(Budget):
        def __init__(self, device):
            super().__init__(device)
            budgets.append(self)

    monkeypatch.setattr("cloudtomo_cl.transport.radiance.Budget", Kept)
    rendering = operator.render(extinction, SAMPLES, seed=4, store_paths=True)
    return budgets[0].sums.get().sum(axis=0), rendering


def both(name, device, stepping, **options):
    scene = SCENES[name]
    return [ct.RadianceOperator(scene, [ABOVE, CAMERA], one, **options) for one in (device, stepping)]


@pytest.mark.parametrize("estimator", ["side-flights", "branches"])
@pytest.mark.parametrize("name", CHOSEN)
def test_turns_change_no_bit_of_a_path_and_none_of_the_audit(device, stepping, monkeypatch, name, estimator):
    assert stepping.turns(SAMPLES * 18) > 1
    one, other = (
        sums_of_budget(operator, extinction_of(SCENES[name]), monkeypatch)
        for operator in both(name, device, stepping, estimator=estimator)
    )
    np.testing.assert_array_equal(one[0], other[0])
    paths = [np.concatenate([kept.get()[0] for _, kept in found[1]._launches]) for found in (one, other)]
    np.testing.assert_array_equal(*paths)
    assert one[0].any() and paths[0].any()


def derivatives(operator, extinction):
    """By replay, by the radiance table, and of every pixel."""
    rendering = operator.render(extinction, SAMPLES, seed=4, store_paths=True)
    adjoint = np.linspace(-1, 1, 2 * len(operator.pixels)).reshape(-1, 2)
    adjoint[3] = 0.0  # paths that are left out
    sums = JacobianAverage(operator)
    sums.add(rendering, 1.0)
    change = operator.device.array(np.full(extinction.shape, 0.5, np.float32))
    by_table, tangent = TableGradient(operator).gradient(rendering, adjoint, change)
    return [
        operator.gradient(rendering, adjoint).get(), by_table.get(), tangent, sums.jacobian @ np.ones(extinction.size)
    ]  # fmt: skip


def test_turns_change_no_bit_of_the_derivatives(device, stepping):
    scene = SCENES["forward peak"]
    mask = np.ones(scene.grid.shape, bool)
    found = [derivatives(one, extinction_of(scene)) for one in both("forward peak", device, stepping, mask=mask)]
    for one, other in zip(*found):
        np.testing.assert_array_equal(one, other)
        assert one.any()


def test_turns_change_no_bit_of_fluxes(device, stepping):
    scene = replace(SCENES["absorbing"], surface=ct.Surface(0.0))
    found = [ct.FluxOperator(scene, one).compute(extinction_of(scene), 300_000, seed=2) for one in (device, stepping)]
    for name in ("reflected", "direct", "diffuse", "absorbed"):
        np.testing.assert_array_equal(*(getattr(fluxes, name).value for fluxes in found))
    assert found[0].audit == found[1].audit


def test_a_groups_sum_that_is_too_large_is_seen(stepping):
    """In the sums of all groups, too: added as it is, it would bring an overflown one back into the range."""
    source = """
    #include "walk/budget.h"
    __kernel void probe(volatile __global Accumulator *sums)
    {
        GROUP_BUDGET(group, sums);
        if (get_local_id(0) < 3)
            add_to_budget(group, units_of(0.9f * LARGEST_ADDEND));
        close_group_budget(group, sums);
    }
    """
    import pyopencl as cl

    sums = Budget(stepping)
    stepping.launch(cl.Kernel(stepping.build(source), "probe"), 64, sums.data)
    with pytest.raises(ct.TransportError, match="budget of the paths' weights"):
        sums.audit()


def test_what_work_items_keep_lies_in_different_banks(stepping):
    source = """
    #include "walk/budget.h"
    #include "walk/event.h"
    __kernel void probe(__global uint *words)
    {
        words[0] = sizeof(SampleKey) / 4;
        words[1] = sizeof(Interaction) / 4;
        words[2] = sizeof(Budget) / 4;
    }
    """
    import pyopencl as cl

    words = stepping.zeros(3, np.uint32)
    cl.Kernel(stepping.build(source), "probe")(stepping.queue, (1,), None, words.data)
    own = words.get()
    assert list(own % 2) == [1, 1, 1] and own.sum() % 2 == 1, own


def test_on_cpus_a_work_item_has_one_path(device):
    assert device.regenerates or device.turns(1 << 30) == 1


def test_groups_are_left_for_all_compute_units(stepping):
    units = stepping.opencl.max_compute_units
    for paths in (1, 1000, 10**5, 10**7, 10**9):
        turns = stepping.turns(paths)
        assert turns & (turns - 1) == 0 and 1 <= turns <= 64
        assert turns == 1 or paths / (64 * turns) >= 3 * units


def test_launches_follow_a_gpus_memory(stepping, device):
    class Memory:
        def __init__(self, size):
            self.global_mem_size = size

    real = stepping.opencl
    try:
        found = []
        for gigabytes in (1, 8, 80):
            stepping.opencl = Memory(gigabytes * 10**9)
            found.append(stepping.largest_launch)
    finally:
        stepping.opencl = real
    assert found == [1 << 21, 1 << 24, 1 << 27]
    assert device.regenerates or device.largest_launch == 1 << 24
