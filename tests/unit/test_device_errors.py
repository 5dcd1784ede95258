"""Devices that fail: every error of OpenCL becomes a named one with advice."""

from types import SimpleNamespace

import numpy as np
import pyopencl as cl
import pyopencl.array
import pytest

import cloudtomo_cl as ct
from cloudtomo_cl.errors import BuildError, DeviceError, TransportError
from cloudtomo_cl.opencl.device import Device
from cloudtomo_cl.opencl.devices import choose_device, list_devices
from cloudtomo_cl.opencl.driver import device_errors
from cloudtomo_cl.opencl.layout import STRUCTS
from cloudtomo_cl.opencl.programs import kernels_folder
from cloudtomo_cl.transport.samples import Samples

GRID = ct.Grid(shape=(2, 2, 2), spacing=(0.2, 0.2, 0.2))
SCENE = ct.Scene(grid=GRID, sun=ct.Sun(zenith=30.0))
VIEWS = (ct.OrthographicView(zenith=0.0, width=0.6, pixels=(3, 3)),)
STAGES = (ct.Stage(grid=(2, 2, 2), samples=4, iterations=3, window=1000),)
# On the device, and with a minimum found in few products: hundreds of runs are made.
QUICK = {"prior": ct.Prior(), "solver": ct.GaussNewton(inner_iterations=3), "uncertainty": 0}
CODES = {"MEM_OBJECT_ALLOCATION_FAILURE": cl.MemoryError, "OUT_OF_RESOURCES": cl.RuntimeError}


@pytest.fixture(scope="module")
def own_device():
    """Not the one that other tests use: its kernels are made while calls fail."""
    return choose_device()


@pytest.fixture(scope="module")
def measurements(own_device):
    operator = ct.RadianceOperator(SCENE, VIEWS, own_device)
    rendering = operator.render(np.full(GRID.shape, 5.0, np.float32), 16)
    return ct.Measurements.rendered(operator, rendering)


class Failing:
    """Counts calls of OpenCL, and lets one of them fail."""

    PLACES = [
        (cl, "enqueue_copy"),
        (cl, "enqueue_fill_buffer"),
        (cl.Kernel, "__call__"),
        (cl.CommandQueue, "finish"),
        (pyopencl.array, "to_device"),
        (pyopencl.array, "zeros"),
        (pyopencl.array, "empty"),
        (pyopencl.array, "empty_like"),
        (pyopencl.array.Array, "get"),
        (pyopencl.array.Array, "fill"),
        (pyopencl.array.Array, "__add__"),
        (pyopencl.array.Array, "astype"),
        (pyopencl.array.Array, "copy"),
    ]

    def __init__(self, monkeypatch, at, error):
        self.calls, self.at, self.error, self.failed = 0, at, error, None
        for owner, name in self.PLACES:
            monkeypatch.setattr(owner, name, self.counted(getattr(owner, name), f"{owner.__name__}.{name}"))

    def counted(self, original, name):
        def call(*arguments, **options):
            self.calls += 1
            if self.calls == self.at:
                self.failed = name
                raise self.error
            return original(*arguments, **options)

        return call


def opencl_error(code):
    return CODES[code](f"call failed: {code}")


def test_the_call_that_fails_does_not_matter(own_device, measurements, monkeypatch, tmp_path):
    """One call after the other fails, of all that a reconstruction makes; from the second iteration on there is
    a checkpoint, and the run goes on from it with the same bits."""
    whole = ct.reconstruct(SCENE, measurements, STAGES, device=own_device, **QUICK)
    path = tmp_path / "checkpoint.npz"
    at, places = 1, set()
    while True:
        path.unlink(missing_ok=True)
        with monkeypatch.context() as patch:
            failing = Failing(patch, at, opencl_error("OUT_OF_RESOURCES"))
            try:
                ct.reconstruct(
                    SCENE,
                    measurements,
                    STAGES,
                    device=own_device,
                    checkpoint=path,
                    checkpoint_interval=0,
                    **QUICK,
                )
                break
            except DeviceError as error:
                assert "not enough memory" in str(error) and "cloudtomo devices" in str(error)
        places.add(failing.failed)
        if path.exists():
            resumed = ct.reconstruct(SCENE, measurements, STAGES, device=own_device, resume=path, **QUICK)
            np.testing.assert_array_equal(resumed.extinction, whole.extinction)
        # All of the first calls, then every seventh, and ever fewer.
        at += 1 if at < 40 else max(7, at // 8)
    assert at > 60 and len(places) >= 6, places


@pytest.mark.parametrize(
    ("code", "advice"),
    [("MEM_OBJECT_ALLOCATION_FAILURE", "not enough memory: choose fewer"), ("OUT_OF_RESOURCES", "not enough memory")],
)
def test_a_lack_of_memory_is_told_as_such(code, advice):
    with pytest.raises(DeviceError, match=f"rendering failed .*{code}.*{advice}"), device_errors("rendering"):
        raise opencl_error(code)


def test_a_device_that_disappears_is_told_as_such():
    with pytest.raises(DeviceError, match="the device or its driver failed"), device_errors("rendering"):
        raise cl.RuntimeError("clFinish failed: DEVICE_NOT_AVAILABLE")


def test_other_errors_pass():
    with pytest.raises(ZeroDivisionError), device_errors("rendering"):
        raise ZeroDivisionError


def test_a_lack_of_real_memory_is_told(own_device):
    """Not made up: more than the device has."""
    with pytest.raises(DeviceError), device_errors("allocating"):
        cl.Buffer(own_device.context, cl.mem_flags.READ_WRITE, 4 * own_device.opencl.global_mem_size)


def test_a_build_that_fails_shows_device_options_and_log(own_device):
    with pytest.raises(BuildError, match="(?s)a kernel did not build.*options: -cl-std=CL1.2") as error:
        own_device.build("__kernel void wrong() { not_declared(); }")
    assert own_device.name in str(error.value)


def test_a_context_that_cannot_be_made_is_named(monkeypatch):
    def fail(devices):
        raise cl.RuntimeError("clCreateContext failed: DEVICE_NOT_AVAILABLE")

    monkeypatch.setattr(cl, "Context", fail)
    with pytest.raises(DeviceError, match="opening the device failed"):
        choose_device()


def test_a_broken_platform_does_not_hide_the_others(monkeypatch):
    good = cl.get_platforms()

    class Broken:
        name = "broken"

        def get_devices(self):
            raise cl.LogicError("clGetDeviceIDs failed: INVALID_PLATFORM")

    monkeypatch.setattr(cl, "get_platforms", lambda: [Broken(), *good])
    assert len(list_devices()) >= 1


def test_no_platform_is_named(monkeypatch):
    def fail():
        raise cl.LogicError("clGetPlatformIDs failed: PLATFORM_NOT_FOUND_KHR")

    monkeypatch.setattr(cl, "get_platforms", fail)
    with pytest.raises(DeviceError, match="no OpenCL platform"):
        choose_device()


@pytest.mark.parametrize("where", ["cloudtomo_cl/kernels", "kernels"], ids=["installed", "checkout"])
def test_kernels_are_found_in_a_package_and_beside_it(monkeypatch, tmp_path, where):
    (tmp_path / where).mkdir(parents=True)
    file = tmp_path / "cloudtomo_cl" / "opencl" / "programs.py"
    monkeypatch.setattr("cloudtomo_cl.opencl.programs.__file__", str(file))
    assert kernels_folder() == tmp_path / where


def test_kernels_build_from_a_folder_with_a_space(monkeypatch, tmp_path):
    """PoCL understands no such path, quoted or not: headers are copied to where it does."""
    import shutil

    folder = tmp_path / "a folder with spaces"
    shutil.copytree(kernels_folder(), folder)
    (folder / "only_here.h").write_text("#define ONLY_HERE 1\n")
    monkeypatch.setattr("cloudtomo_cl.opencl.programs.kernels_folder", lambda: folder)
    device = Device(cl.get_platforms()[0].get_devices()[0])
    includes = '#include "only_here.h"\n#include "walk/rng.h"\n'
    device.build(f"{includes}__kernel void f(__global int *a) {{ a[0] = ONLY_HERE; }}")


def test_a_device_that_is_known_to_compute_wrongly_is_told(monkeypatch):
    monkeypatch.setattr("cloudtomo_cl.opencl.device._FAULTS", {choose_device().name[:5]: "it cannot count"})
    with pytest.warns(RuntimeWarning, match="it cannot count"):
        choose_device()


def test_one_pixel_that_is_not_finite_is_named():
    sums = np.zeros(2, STRUCTS["PixelSums"])
    sums["square_sum"][1] = np.inf
    operator = SimpleNamespace(
        pixels=np.array([[0, 3], [1, 5]]),
        scene=SCENE,
        device=SimpleNamespace(read=lambda given, host: host.__setitem__(slice(None), given)),
    )
    with pytest.raises(TransportError, match="not finite in view 1, pixel 5"):
        ct.RadianceOperator._rendering(operator, sums, Samples(4, 0, 0, 0), None, None, [])
