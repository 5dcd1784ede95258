"""Memory is asked for before it is taken."""

import numpy as np
import pytest
import xarray as xr

import cloudtomo_cl as ct
from cloudtomo_cl import memory
from cloudtomo_cl.errors import DataError, DeviceError
from cloudtomo_cl.files.extinction import read_extinction
from cloudtomo_cl.inversion.reconstruct import check_memory

GRID = ct.Grid(shape=(4, 4, 4), spacing=(0.1, 0.1, 0.1))
SCENE = ct.Scene(grid=GRID, sun=ct.Sun(zenith=30.0))


def view(*pixels):
    return ct.OrthographicView(zenith=0.0, width=0.6, pixels=pixels)


class SmallDevice:
    """A device that says it has little memory."""

    name = "small"
    shares_memory = False

    def __init__(self, total, largest):
        self.opencl = type("Info", (), {"global_mem_size": total, "max_mem_alloc_size": largest})


def test_images_too_large_for_the_machine_are_refused_at_once(device):
    with pytest.raises(DataError, match="rendering 10000000000 pixels .* more than kernels count"):
        ct.RadianceOperator(SCENE, [view(100_000, 100_000)], device)
    with pytest.raises((DataError, DeviceError), match=r"rendering 4000000000 pixels.* needs about \d+ GB of memory"):
        ct.RadianceOperator(SCENE, [view(50_000, 80_000)], device)


def test_a_device_too_small_is_told_with_both_numbers():
    with pytest.raises(DeviceError, match=r"needs about 4.8 MB of memory, device small has 1 MB: choose fewer pixels"):
        memory.require_rendering(SmallDevice(1e6, 1e6), (4, 4, 4), [view(1000, 100)])


def test_the_largest_piece_counts_too():
    with pytest.raises(DeviceError, match=r"in one piece, device small gives at most 1 MB"):
        memory.require_rendering(SmallDevice(1e9, 1e6), (4, 4, 4), [view(1000, 100)])


def test_a_late_stage_too_large_is_told_at_the_start():
    image = np.ones((3, 3))
    measurements = ct.Measurements((view(3, 3),), (image,), (image,))
    stages = (ct.Stage(grid=(2, 2, 2)), ct.Stage(grid=(200, 200, 200)))
    with pytest.raises(DeviceError, match="a reconstruction with 200 x 200 x 200 voxels and 9 pixels needs about"):
        check_memory(SCENE, measurements, stages, SmallDevice(1e8, 1e8))


def test_a_machine_with_little_left_refuses(monkeypatch, device):
    monkeypatch.setattr(memory, "_free_memory", lambda: 1000)
    with pytest.raises(DataError, match="this machine has 1 kB free: choose fewer pixels"):
        ct.RadianceOperator(SCENE, [view(8, 8)], device)


def test_a_small_file_of_gigabytes_is_refused_before_it_is_read(tmp_path, monkeypatch):
    values = np.zeros((40, 40, 40))
    data = xr.Dataset({"extinction": (("x", "y", "z"), values)}, {axis: np.arange(40) for axis in "xyz"})
    data.to_netcdf(tmp_path / "cloud.nc", encoding={"extinction": {"zlib": True}})
    monkeypatch.setattr(memory, "_free_memory", lambda: 500_000)
    with pytest.raises(DataError, match="cloud.nc: reading it needs about 1.03 MB .* this machine has 500 kB free"):
        read_extinction(tmp_path / "cloud.nc")


def test_a_generated_cloud_too_large_is_refused():
    with pytest.raises(DataError, match="3000 x 3000 x 3000 voxels are more than kernels count"):
        ct.cumulus(ct.Grid(shape=(3000, 3000, 3000), spacing=(0.01, 0.01, 0.01)))


def test_free_memory_is_that_of_this_machine():
    free = memory._free_memory()
    assert free is None or 10**7 < free < 10**14
