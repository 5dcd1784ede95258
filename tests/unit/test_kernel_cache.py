"""Where built kernels are kept: places that cannot be written, and disks that are full."""

import os
import shutil
import subprocess
import sys

import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.errors import DeviceError
from cloudtomo_cl.opencl import kernel_cache


def test_a_kernel_cache_that_cannot_be_written_is_replaced(tmp_path):
    (tmp_path / "file").touch()
    environment = os.environ | {"POCL_CACHE_DIR": str(tmp_path / "file" / "cache")}
    code = "import cloudtomo_cl as ct; ct.choose_device(); import os; print(os.environ['POCL_CACHE_DIR'])"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "cloudtomo-kernels-" in done.stdout and not os.path.exists(done.stdout.strip())


def test_caches_that_cannot_be_written_are_replaced(tmp_path):
    """As in a container, or on a node, without a home: pyopencl's own cache, too, lies there."""
    (tmp_path / "file").touch()
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "file"), "POCL_CACHE_DIR": ""}
    code = (
        "import cloudtomo_cl as ct, os; grid = ct.Grid((1, 1, 1), (1, 1, 1)); "
        "view = ct.OrthographicView(width=1.0, zenith=0.0, pixels=(1, 1)); "
        "ct.RadianceOperator(ct.Scene(grid, ct.Sun(0.0)), [view]).render([[[1.0]]], 2); "
        "print(os.environ['XDG_CACHE_HOME'])"
    )
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr) == (0, "") and done.stdout.strip() == str(tmp_path / "file")


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
