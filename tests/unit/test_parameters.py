"""What kernels take: counted, named, and of the right type."""

import numpy as np
import pyopencl.array
import pytest

from cloudtomo_cl.opencl.parameters import KERNELS, Kernel, Parameter, macros


@pytest.fixture(scope="module")
def steps(device):
    return device.kernel("optimizer", "sgd_step")


@pytest.fixture
def arguments(device):
    voxels = pyopencl.array.zeros(device.queue, 4, np.float32)
    mask = pyopencl.array.zeros(device.queue, 4, np.uint8)
    return {
        "voxel_count": 4, "extinction": voxels, "mask": mask, "gradient": voxels, "step": 0.5, "square_root": True,
        "floor_extinction": 0,
    }  # fmt: skip


def test_plain_values_become_the_kernels_types(steps, arguments):
    given = steps.arguments(**arguments)
    assert [type(given[place]) for place in (0, 4, 5, 6)] == [np.uint32, np.float32, np.int32, np.float32]
    assert given[1] is given[3] is arguments["extinction"].data


def test_names_and_places_mean_the_same(steps, arguments):
    values = list(arguments.values())
    assert steps.arguments(*values) == steps.arguments(*values[:3], **dict(list(arguments.items())[3:]))


@pytest.mark.parametrize(
    "change, message",
    [
        ({"step": None}, "sgd_step: missing step"),
        ({"momentum": 0.9}, "sgd_step has no parameter momentum; it has voxel_count, extinction"),
        ({"voxel_count": 4.0}, "float.* cannot be interpreted as an integer"),
        ({"gradient": np.zeros(4, np.float32)}, "gradient is ndarray: it must be a buffer or an array on the device"),
        ({"gradient": 3.0}, "gradient is float: it must be a buffer"),
    ],
)
def test_what_does_not_fit_is_refused(steps, arguments, change, message):
    given = {name: value for name, value in (arguments | change).items() if value is not None}
    with pytest.raises(TypeError, match=message):
        steps.arguments(**given)


def test_an_argument_too_many_is_refused(steps, arguments):
    with pytest.raises(TypeError, match="sgd_step takes 7 arguments, 8 are given"):
        steps.arguments(*arguments.values(), 1)


def test_an_argument_given_twice_is_refused(steps, arguments):
    with pytest.raises(TypeError, match="voxel_count is given twice"):
        steps.arguments(4, **arguments)


def test_an_array_of_another_type_is_refused(device, steps, arguments):
    doubles = pyopencl.array.zeros(device.queue, 4, np.float64)
    with pytest.raises(TypeError, match="gradient holds float64: the kernel reads float32"):
        steps.arguments(**arguments | {"gradient": doubles})


@pytest.mark.parametrize("number", [-1, 2**32])
def test_an_integer_beyond_the_kernels_is_refused(steps, arguments, number):
    with pytest.raises(OverflowError, match="voxel_count is .*: it must be from 0 to 4294967295"):
        steps.arguments(**arguments | {"voxel_count": number})


@pytest.mark.parametrize(
    "declaration, name, kind, is_buffer",
    [
        ("const __global float *extinction", "extinction", "float", True),
        ("volatile __global Accumulator *gradient", "gradient", "Accumulator", True),
        ("const int3 shape", "shape", "int3", False),
    ],
)
def test_declarations_are_understood(declaration, name, kind, is_buffer):
    parameter = Parameter(declaration)
    assert (parameter.name, parameter.kind, parameter.is_buffer) == (name, kind, is_buffer)


def test_every_kernel_has_its_list_once():
    text = macros()
    for kernel, declarations in KERNELS.items():
        assert text.count(f"#define {kernel.upper()}_PARAMETERS ") == 1
        names = [Parameter(declaration).name for declaration in declarations]
        assert len(set(names)) == len(names)


def test_three_integers_make_a_vector():
    kernel = Kernel(None, "some", ["const int3 shape"])
    (shape,) = kernel.arguments((3, 4, np.int64(5)))
    assert (shape["x"], shape["y"], shape["z"]) == (3, 4, 5)
