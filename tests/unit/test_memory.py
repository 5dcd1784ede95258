"""Memory is asked for before it is taken."""

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

import cloudtomo_cl as ct
from cloudtomo_cl import memory
from cloudtomo_cl.commands.reconstruction import _say_what_is_doubtful
from cloudtomo_cl.errors import DataError, DeviceError
from cloudtomo_cl.files.extinction import read_extinction
from cloudtomo_cl.inversion.checks import check_memory
from cloudtomo_cl.inversion.footprint import stage_footprint
from cloudtomo_cl.opencl.memory import Footprint
from cloudtomo_cl.parallel.ranks import ALONE
from cloudtomo_cl.transport.cells import most_cells
from cloudtomo_cl.transport.radiance_table import table_footprint
from cloudtomo_cl.transport.rendering_memory import footprint

GRID = ct.Grid(shape=(4, 4, 4), spacing=(0.1, 0.1, 0.1))
SCENE = ct.Scene(grid=GRID, sun=ct.Sun(zenith=30.0))


def view(*pixels):
    return ct.OrthographicView(zenith=0.0, width=0.6, pixels=pixels)


class SmallDevice:
    """A device that says it has little memory."""

    name = "small"
    shares_memory = is_cpu = False
    ranks = ALONE

    def __init__(self, total, largest):
        self.opencl = type("Info", (), {"global_mem_size": total, "max_mem_alloc_size": largest})


def test_images_too_large_for_the_machine_are_refused_at_once(device):
    with pytest.raises(DataError, match="rendering 10000000000 pixels .* more than kernels count"):
        ct.RadianceOperator(SCENE, [view(100_000, 100_000)], device)
    with pytest.raises((DataError, DeviceError), match=r"rendering 4000000000 pixels.* needs about \d+ GB of memory"):
        ct.RadianceOperator(SCENE, [view(50_000, 80_000)], device)


def test_a_device_too_small_is_told_with_both_numbers():
    with pytest.raises(DeviceError, match=r"needs about 4.8 MB of memory, device small has 1 MB: choose fewer pixels"):
        footprint(64, 100_000).require(SmallDevice(1e6, 1e6), "rendering", "choose fewer pixels")


def test_the_largest_piece_counts_too():
    with pytest.raises(DeviceError, match=r"in one piece, device small gives at most 1 MB"):
        footprint(64, 100_000).require(SmallDevice(1e9, 1e6), "rendering", "choose fewer pixels")


def test_a_device_that_is_too_small_in_all_is_not_told_of_a_piece():
    """The largest buffer may be all there is."""
    size = 27e9
    with pytest.raises(DeviceError, match="rendering needs about 27 GB of memory, device small has 1 GB: buy"):
        Footprint(size, size).require(SmallDevice(1e9, 1e9), "rendering", "buy")


def test_a_cpu_has_the_machines_memory_whatever_its_driver_says():
    small = SmallDevice(1e6, 1e9)
    small.shares_memory = small.is_cpu = True
    footprint(64, 100_000).require(small, "rendering", "choose fewer pixels")


def test_a_late_stage_too_large_is_told_at_the_start():
    image = np.ones((3, 3))
    measurements = ct.Measurements((view(3, 3),), (image,), (image,))
    stages = (ct.Stage(grid=(2, 2, 2)), ct.Stage(grid=(200, 200, 200)))
    with pytest.raises(DeviceError, match="a reconstruction with 200 x 200 x 200 voxels and 9 pixels needs about"):
        check_memory(SCENE, measurements, stages, SmallDevice(1e8, 1e8))


@pytest.fixture
def of_a_run():
    """What `check_memory` is given, and how much a recovery with a cell a voxel needs of the machine."""
    image = np.ones((3, 3))
    measurements = ct.Measurements((view(3, 3),), (image,), (image,))
    stage, mask, device = ct.Stage(grid=(40, 40, 40)), np.ones(GRID.shape, bool), SmallDevice(1e12, 1e12)
    device.shares_memory = True

    def given(solver):
        needed = stage_footprint(SCENE, measurements, stage, solver, mask)
        return (SCENE, measurements, (stage,), device, solver, mask), needed.device + needed.host

    return given


SOLVERS = pytest.mark.parametrize("solver", [ct.GaussNewton(), ct.Adam()], ids=["Gauss-Newton", "Adam"])


@SOLVERS
def test_a_run_that_a_deep_cloud_may_end_begins_with_a_warning(of_a_run, monkeypatch, solver):
    given, needed = of_a_run(solver)
    monkeypatch.setattr(memory, "free_memory", lambda: 1.01 * needed)
    assert "voxels and 9 pixels, of a very deep cloud, needs about" in check_memory(*given)
    table = table_footprint(most_cells(40**3)).device
    monkeypatch.setattr(memory, "free_memory", lambda: needed + table)
    assert check_memory(*given) == ""


def test_a_command_says_so(of_a_run, monkeypatch):
    (scene, measurements, stages, device, solver, mask), needed = of_a_run(ct.GaussNewton())
    monkeypatch.setattr(memory, "free_memory", lambda: 1.01 * needed)
    settings, told = SimpleNamespace(stage=stages, solver=solver), []
    job = SimpleNamespace(scene=scene, measurements=measurements, settings=settings, device=device, say=told.append)
    _say_what_is_doubtful(job, mask)
    assert len(told) == 1 and "ends with an error if the cloud turns out so deep" in told[0]


def test_so_does_a_recovery_in_python(device, monkeypatch):
    operator = ct.RadianceOperator(SCENE, [view(3, 3)], device)
    images = ct.Measurements.rendered(operator, operator.render(np.full(GRID.shape, 5.0), 4))
    stage, mask = ct.Stage(grid=GRID.shape, iterations=1, samples=4), np.ones(GRID.shape, bool)
    needed = stage_footprint(SCENE, images, stage, ct.GaussNewton(), mask)
    monkeypatch.setattr(memory, "free_memory", lambda: 1.01 * (needed.device + needed.host + needed.stored))
    with pytest.warns(ct.RecoveryWarning, match="4 x 4 x 4 voxels .* of a very deep cloud, needs"):
        ct.reconstruct(SCENE, images, [stage], ct.Prior(), mask=mask, device=device, uncertainty=0)


def test_by_replay_no_cloud_is_too_deep(of_a_run, monkeypatch):
    given, needed = of_a_run(ct.Adam(gradient="replay"))
    monkeypatch.setattr(memory, "free_memory", lambda: 1.01 * needed)
    assert check_memory(*given) == ""


def test_a_machine_with_little_left_refuses(monkeypatch, device):
    monkeypatch.setattr(memory, "free_memory", lambda: 1000)
    with pytest.raises(DataError, match="this machine has 1 kB free: choose fewer pixels"):
        ct.RadianceOperator(SCENE, [view(8, 8)], device)


def test_a_small_file_of_gigabytes_is_refused_before_it_is_read(tmp_path, monkeypatch):
    values = np.zeros((40, 40, 40))
    data = xr.Dataset({"extinction": (("x", "y", "z"), values)}, {axis: np.arange(40) for axis in "xyz"})
    data.to_netcdf(tmp_path / "cloud.nc", encoding={"extinction": {"zlib": True}})
    monkeypatch.setattr(memory, "free_memory", lambda: 500_000)
    with pytest.raises(DataError, match="cloud.nc: reading it needs about 1.54 MB .* this machine has 500 kB free"):
        read_extinction(tmp_path / "cloud.nc")


def test_a_generated_cloud_too_large_is_refused():
    with pytest.raises(DataError, match="3000 x 3000 x 3000 voxels is more than kernels count"):
        ct.cumulus(ct.Grid(shape=(3000, 3000, 3000), spacing=(0.01, 0.01, 0.01)))


def test_free_memory_is_that_of_this_machine():
    assert 10**7 < memory.free_memory() < 10**14


def control_group(folder, most, taken, idle=None, names=("memory.max", "memory.current", "inactive_file")):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / names[0]).write_text(f"{most}\n")
    (folder / names[1]).write_text(f"{taken}\n")
    if idle is not None:
        (folder / "memory.stat").write_text(f"anon 5\n{names[2]} {idle}\n")


@pytest.fixture
def groups(monkeypatch, tmp_path):
    """Control groups of our own; a process in the root, until it is said otherwise."""
    monkeypatch.setattr(memory, "_CONTROL_GROUPS", tmp_path / "cgroup")
    monkeypatch.setattr(memory, "_OWN_GROUPS", tmp_path / "own")
    return tmp_path


def test_a_control_groups_limit_counts(groups):
    control_group(groups / "cgroup", 3_000_000, 1_000_000)
    assert memory.free_memory() == 2_000_000


def test_copies_of_files_that_a_control_group_holds_are_free(groups):
    control_group(groups / "cgroup", 3_000_000, 2_500_000, idle=1_500_000)
    assert memory.free_memory() == 2_000_000


def test_a_control_group_without_a_limit_counts_for_nothing(groups):
    control_group(groups / "cgroup", "max", 1_000_000)
    assert memory.free_memory() > 10**7


@pytest.mark.parametrize("above", ["job", "."])
def test_the_limits_of_a_batch_jobs_own_group_and_of_those_above_count(groups, above):
    (groups / "own").write_text("0::/job/step\n")
    control_group(groups / "cgroup" / "job" / "step", "max", 10)
    control_group(groups / "cgroup" / above, 3_000_000, 1_000_000)
    control_group(groups / "cgroup" / "other", 1000, 10)
    assert memory.free_memory() == 2_000_000


def test_control_groups_of_version_1_count(groups):
    (groups / "own").write_text("3:cpuset:/\n2:memory:/job/step\n0::/\n")
    names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
    control_group(groups / "cgroup" / "memory" / "job" / "step", 3_000_000, 1_500_000, 500_000, names)
    control_group(groups / "cgroup" / "memory", 2**63 - 4096, 10**10, names=names)
    assert memory.free_memory() == 2_000_000


def test_a_limit_of_the_process_counts():
    code = (
        "import resource; from cloudtomo_cl.memory import free_memory; free_memory()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (4 * 10**9, 4 * 10**9)); assert free_memory() < 4 * 10**9"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0
