"""Memory that runs out on one rank alone: all ranks are told, so that none waits for it for ever."""

import numpy as np
import pytest
from ranks_scene import GRID, RING, SCENE, extinction

import cloudtomo_cl as ct
from cloudtomo_cl.opencl.several import on_devices
from cloudtomo_cl.transport.jacobian_average import JacobianAverage
from cloudtomo_cl.transport.table_gradient import TableGradient

ADJOINT = np.ones((63 * len(RING), 2))
MASK = np.ones(GRID.shape, bool)


def in_parts(operator):
    return lambda: operator.render(extinction(), 4)


def to_error(operator):
    return lambda: ct.render_to_error(operator, extinction(), 0.5, seed=2, most_paths=5000)


def stored(operator):
    return operator.render(extinction(), 4, store_paths=True)


def by_replay(operator):
    rendering = stored(operator)
    return lambda: operator.gradient(rendering, ADJOINT)


def by_table(operator):
    table, rendering = TableGradient(operator), stored(operator)
    change = operator.device.zeros(GRID.shape, np.float32)
    return lambda: table.gradient(rendering, ADJOINT, change)


def structure(operator):
    return lambda: JacobianAverage(operator)


def average(operator):
    sums, rendering = JacobianAverage(operator), stored(operator)
    return lambda: sums.add(rendering, 1.0)


class Failing:
    """Lets the allocation of a number fail on a device, and counts them."""

    def __init__(self, device, number):
        self.number, self.count = number, 0
        for name in ("zeros", "empty", "constant", "array", "buffer", "copied"):
            setattr(device, name, self.of(getattr(device, name)))

    def of(self, real):
        def allocate(*arguments):
            self.count += 1
            if self.count == self.number:
                raise ct.DeviceError("there is no room")
            return real(*arguments)

        return allocate


def allocations(work, number):
    """Does some work on two ranks, of which the second one has no room the time of a number; how many times it asks."""

    def of_rank(device):
        operator = ct.RadianceOperator(SCENE, RING, device, mask=MASK)
        begun = work(operator)
        failing = Failing(device, number if device.ranks.rank else None)
        begun()
        return device.ranks.all(failing.count)[1]

    return on_devices([0, 0], of_rank)


@pytest.mark.parametrize("work", [in_parts, to_error, by_replay, by_table, structure, average])
def test_an_allocation_that_fails_on_one_rank_is_told_on_all(work, monkeypatch):
    if work is in_parts:
        monkeypatch.setattr("cloudtomo_cl.transport.radiance.pixels_at_once", lambda *_: 50)
    count = allocations(work, None)
    assert count > 3
    alone = []
    for number in range(1, count + 1):
        with pytest.raises(ct.DeviceError, match="there is no room") as raised:
            allocations(work, number)
        if not getattr(raised.value, "told_by_all", False):
            alone.append(number)
    assert not alone, f"of {count}"
