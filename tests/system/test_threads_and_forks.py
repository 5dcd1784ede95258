"""Operators that share a device, in threads and in forked processes; kernel caches that cannot be written."""

import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.errors import DataError, DeviceError
from cloudtomo_cl.opencl import kernel_cache

GRID = ct.Grid(shape=(4, 4, 4), spacing=(0.2, 0.2, 0.2))
VIEWS = (ct.OrthographicView(zenith=0.0, width=0.9, pixels=(8, 8)),)
SCENES = [ct.Scene(grid=GRID, sun=ct.Sun(zenith=zenith)) for zenith in (0.0, 20.0, 40.0, 60.0)]
EXTINCTION = np.full(GRID.shape, 5.0, np.float32)


@pytest.fixture
def quick_switches():
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def results(operator, seed):
    """An image and a gradient."""
    rendering = operator.render(EXTINCTION, 8, seed, store_paths=True)
    return rendering.mean, operator.gradient(rendering, np.ones((len(operator.pixels), 2))).get()


def test_threads_that_share_a_device_have_their_own_results(device, quick_switches):
    operators = [ct.RadianceOperator(scene, VIEWS, device) for scene in SCENES]
    tasks = [(operator, seed) for seed in range(15) for operator in operators]
    alone = [results(*task) for task in tasks]
    with ThreadPoolExecutor(len(operators)) as pool:
        together = list(pool.map(lambda task: results(*task), tasks))
    for one, other in zip(alone, together):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


FORKED = """
import os, sys
import numpy as np
import cloudtomo_cl as ct
from cloudtomo_cl.errors import DeviceError
grid = ct.Grid(shape=(2, 2, 2), spacing=(0.2, 0.2, 0.2))
views = (ct.OrthographicView(zenith=0.0, width=0.6, pixels=(3, 3)),)
operator = ct.RadianceOperator(ct.Scene(grid=grid, sun=ct.Sun(zenith=30.0)), views, ct.choose_device())
operator.render(np.ones(grid.shape, np.float32), 2)
child = os.fork()
if child == 0:
    said = 0
    for attempt in (lambda: operator.render(np.ones(grid.shape, np.float32), 2), ct.choose_device):
        try:
            attempt()
        except DeviceError as error:
            said += "spawn" in str(error)
    os._exit(said)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_forked_process_is_told_to_spawn():
    assert subprocess.run([sys.executable, "-c", FORKED], timeout=60).returncode == 2


def test_a_kernel_cache_that_cannot_be_written_is_replaced(tmp_path):
    (tmp_path / "file").touch()
    environment = os.environ | {"POCL_CACHE_DIR": str(tmp_path / "file" / "cache")}
    code = "import cloudtomo_cl as ct; ct.choose_device(); import os; print(os.environ['POCL_CACHE_DIR'])"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "cloudtomo-kernels-" in done.stdout and not os.path.exists(done.stdout.strip())


def full(folder):
    return shutil._ntuple_diskusage(100, 100, 0)


def test_no_place_for_kernels_is_named(monkeypatch):
    monkeypatch.setattr(kernel_cache, "_state", {})
    monkeypatch.setattr(shutil, "disk_usage", full)
    with pytest.raises(DeviceError, match="kernels cannot be built.*POCL_CACHE_DIR"):
        ct.choose_device()


def test_a_disk_that_becomes_full_is_named_before_a_build(device, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", full)
    with pytest.raises(DeviceError, match="a kernel cannot be built: the disk of /.* has 0 bytes free"):
        device.build("__kernel void never_built_before(__global int *a) { a[0] = 17; }")


@pytest.mark.parametrize("seed", [2**32, -1, 1.5, "2"])
def test_a_seed_that_kernels_do_not_take_is_named(device, seed):
    operator = ct.RadianceOperator(SCENES[0], VIEWS, device)
    flux = ct.FluxOperator(SCENES[0], device)
    for compute in (lambda: operator.render(EXTINCTION, 2, seed), lambda: flux.compute(EXTINCTION, 10, seed)):
        with pytest.raises(DataError, match=r"seed is .*: it must be a whole number from 0 to 4294967295"):
            compute()


def test_gradients_are_in_proportion_to_adjoints_however_small(device):
    operator = ct.RadianceOperator(SCENES[1], VIEWS, device)
    rendering = operator.render(EXTINCTION, 8, store_paths=True)
    adjoint = np.ones((len(operator.pixels), 2))
    one = operator.gradient(rendering, adjoint).get()
    for scale in (1e-30, 1e25):
        np.testing.assert_allclose(operator.gradient(rendering, scale * adjoint).get(), scale * one, rtol=1e-5)
    assert not operator.gradient(rendering, 5e-324 * adjoint).get().any()
    for wrong in (1e30, 1e300, np.inf, np.nan):
        with pytest.raises(DataError, match="adjoint"):
            operator.gradient(rendering, wrong * adjoint)
