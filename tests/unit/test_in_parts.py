"""A device that says it has little memory: what it does not hold whole goes in parts."""

import numpy as np
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.opencl.devices import choose_device
from cloudtomo_cl.opencl.memory import Footprint
from cloudtomo_cl.transport.jacobian_average import JacobianAverage

GRID = ct.Grid(shape=(6, 5, 4), spacing=(0.1, 0.1, 0.1))
SCENE = ct.Scene(grid=GRID, sun=ct.Sun(zenith=30.0))
VIEW = ct.OrthographicView(zenith=20.0, width=0.8, pixels=(80, 80))
MASK = np.ones(GRID.shape, bool)


class Claims:
    """An OpenCL device that says other things of itself."""

    def __init__(self, real, **said):
        self.__dict__.update(said, real=real)

    def __getattr__(self, name):
        return getattr(self.real, name)


@pytest.fixture
def small():
    """A device with room for some thousands of pixels, and memory of its own."""

    def made(memory):
        device = choose_device()
        assert device.preamble  # asks the real one for its layout of structs
        device.opencl = Claims(
            device.opencl, global_mem_size=memory, max_mem_alloc_size=memory // 2, host_unified_memory=False
        )
        device.is_cpu = False
        return device

    return made


def extinction():
    return np.random.default_rng(1).uniform(2, 20, GRID.shape)


def test_images_in_parts_have_the_same_bits(device, small):
    seen = []
    whole, parts = (
        ct.RadianceOperator(SCENE, [VIEW], one).render(extinction(), 8, seed=3, progress=seen.append)
        for one in (device, small(250_000))
    )
    for name in ("mean", "standard_error", "halves"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name))
    assert parts.audit.launched == whole.audit.launched == 8 * 6400
    assert parts.audit.top == pytest.approx(whole.audit.top, rel=1e-12)
    assert seen[-1] == 8 and sorted(seen[1:]) == seen[1:] and len(seen) > 2
    assert parts.to_dataset().radiance.shape == whole.to_dataset().radiance.shape


def test_a_device_with_room_for_hardly_a_pixel_refuses(small):
    with pytest.raises(ct.DeviceError, match="rendering 6400 pixels of 6 x 5 x 4 voxels needs about"):
        ct.RadianceOperator(SCENE, [VIEW], small(100_000))


def test_paths_that_the_device_does_not_hold_are_stored_on_the_machine(device, small, monkeypatch):
    monkeypatch.setattr("cloudtomo_cl.opencl.device._FIRST_LAUNCH", 6400)
    monkeypatch.setattr("cloudtomo_cl.opencl.device._LARGEST_LAUNCH", 6400)
    monkeypatch.setattr("cloudtomo_cl.opencl.memory._STORED_SHARE", 6e-4)
    devices, found = (device, small(300_000_000)), []
    for one in devices:
        operator = ct.RadianceOperator(SCENE, [VIEW], one, mask=MASK)
        rendering = operator.render(extinction(), 8, seed=3, store_paths=True)
        sums = JacobianAverage(operator)
        sums.add(rendering, 1.0)
        gradient = operator.gradient(rendering, np.ones((6400, 2))).get()
        found.append((rendering, gradient, sums.jacobian @ np.ones(MASK.size)))
    where = [[one.is_array(paths) for _, paths in f[0]._launches] for one, f in zip(devices, found)]
    assert all(where[0]) and where[1][0] and not where[1][-1]
    for one, other in zip(found[0][1:], found[1][1:]):
        np.testing.assert_array_equal(one, other)


def test_stored_paths_count_where_they_lie(small):
    needed = Footprint(device=50_000, stored=1e6)
    needed.require(small(200_000), "storing", "choose fewer samples")
    with pytest.raises(ct.DeviceError, match="storing needs about 100 kB of memory, device .* has 100 kB"):
        Footprint(device=50_001, stored=1e6).require(small(100_000), "storing", "choose fewer samples")
    with pytest.raises(ct.DataError, match="storing needs about 1e.* of memory, this machine has"):
        Footprint(stored=1e18).require(small(200_000), "storing", "choose fewer samples")
