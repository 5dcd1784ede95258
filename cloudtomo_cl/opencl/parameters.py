"""The kernels' parameters: one description makes their lists in OpenCL C and converts what the host passes.

In OpenCL C a kernel is written as `__kernel void render_paths(RENDER_PATHS_PARAMETERS)`; the macro comes from here
(`macros`). On the host a `Kernel` takes plain Python numbers, buffers and arrays, in their order or by name.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from cloudtomo_cl.opencl.vector_parameters import VECTOR_KERNELS

# What a path needs of the scene: walk/medium.h.
MEDIUM = (
    "__constant Scene *scene",
    "const __global float *extinction",  # of droplets, km^-1, [x][y][z]
    "const __global float *table_row",  # per voxel, a row of the phase table or between two
    "const __global uchar *empty",  # per block: how many blocks around hold nothing
    "const __global float *profiles",  # of the air and the phase table, see make_medium
)
# Paths from cameras: `sample_in_launch * pixel_count + pixel` is the number of one in its launch.
PATHS = (
    *MEDIUM,
    "const __global View *views",
    "const __global float *rays",  # of the views that are lists of rays
    "const __global uint2 *pixels",  # (view, pixel)
    "const uint pixel_count",
    "const uint first_sample",
    "const uint path_count",
    "const uint seed",
    "const uint stream",
)
# Of kernels whose work items walk several paths on a GPU: kernels/walk/turns.h. `Device.launch` gives it.
TURNS = "turns"
_TURNS = (f"const uint {TURNS}",)  # paths per work item
_REPLAY = (
    *PATHS,
    "const __global float *path_radiance",  # from render_paths, sr^-1
    "volatile __global uint *astray",  # number of paths that contribute something else now
)
_TABLE = (
    "const __global int *column",  # of every voxel in the radiance table, or -1
    "const __global uint4 *cells",  # of every column: its first cell, and parts along x, y, z
    "const __global float *diffuse",  # [cell][2][bin]: source - radiance, and the source, sr^-1
    "const __global float *sunlight",  # [cell]: direct, share of the irradiance
)
_STARTS = (  # of photons
    *MEDIUM,
    "const __global View *sun_view",
    "const uint pixel_count",
    "const __global float *box",  # lower and upper corner, voxels
    "const uint first_sample",
    "const uint seed",
    "const uint stream",
)
_GRADIENT = (
    "const __global float2 *adjoint",  # per pixel: even, odd samples
    "const __global float *virtual_extinction",  # [x][y][z], km^-1; below 0: nothing is deposited
    "volatile __global Accumulator *gradient",  # [x][y][z]
)
_TILES = (
    "__constant Scene *scene",
    "const __global Tile *tiles",
    "const __global int *column",
)
_ROWS = (
    "const __global Tile *tiles",
    "const __global uint *slot_start",  # of every pixel's tile
    "const uint first_pixel",
    "const uint row_count",
)
_COLUMNS = (
    "const uint voxel_count",
    "const __global uint *column_start",
    "const __global uint *rows",  # of every column's entries
    "const __global float *values",  # of these
    "const __global int *block",
)
_FAR = (
    "const uint pixel_block_count",
    "const uint block_count",
    "const __global float *far",  # [pixel block][block]
)
_STEP = (
    "const uint voxel_count",
    "__global float *extinction",  # km^-1
    "const __global uchar *mask",
    "const __global float *gradient",  # cost per km^-1
    "const float step",
    "const int square_root",  # whether the parameter is the square root of the extinction
    "const float floor_extinction",  # km^-1
)
KERNELS: dict[str, tuple[str, ...]] = {
    **VECTOR_KERNELS,
    "render_paths": (
        *PATHS,
        "__global float *path_radiance",  # sr^-1
        "volatile __global Accumulator *budget",  # [copy][Termination]
        *_TURNS,
    ),
    "sum_paths": (
        "const __global float *path_radiance",
        "const uint pixel_count",
        "const uint first_sample",
        "const uint begin",
        "const uint end",
        "__global PixelSums *sums",
    ),
    "replay_paths": (
        *_REPLAY,
        *_GRADIENT,
        "__global VirtualCollision *virtual_collisions",
        "volatile __global uint *virtual_collision_count",
        *_TURNS,
    ),
    "virtual_paths": (
        *PATHS,
        *_GRADIENT,
        "const __global VirtualCollision *virtual_collisions",
        "const uint count",
    ),
    "path_lengths": (
        *PATHS,
        "const float unit",  # of the sums, per km
        "volatile __global Accumulator *lengths",  # [x][y][z]
    ),
    "gradient_paths": (
        *_REPLAY,
        *_TABLE,
        "const __global float2 *adjoint",
        "const __global float *change",  # of extinction, km^-1, [x][y][z]
        "volatile __global Accumulator *gradient",
        "__global float *path_tangent",  # each path's derivative along the change, sr^-1
        *_TURNS,
    ),
    "gradient_rays": (
        *_REPLAY,
        *_TABLE,
        "const uint ray_count",  # of each pixel
        "const float weight",
        "const __global float2 *adjoint",
        "const __global float *change",
        "volatile __global Accumulator *gradient",
        "__global float *ray_tangent",
    ),
    "jacobian_rays": (
        *_REPLAY,
        *_TABLE,
        "const uint ray_count",  # of each pixel
        "const float weight",
        *_ROWS,
        "const __global ushort4 *place",
        "const __global int *block",
        "const __global uint *pixel_block",
        "const uint block_count",
        "volatile __global Accumulator *near_sums",
        "volatile __global Accumulator *far_sums",
    ),
    "jacobian_paths": (
        *_REPLAY,
        *_TABLE,
        *_ROWS,
        "const __global ushort4 *place",  # of every column: the voxel
        "const __global int *block",  # of every column
        "const __global uint *pixel_block",  # of every pixel
        "const uint block_count",
        "volatile __global Accumulator *near_sums",  # [slot] of the rows' pixels
        "volatile __global Accumulator *far_sums",  # [pixel block][block]
        *_TURNS,
    ),
    "near_count": (*_TILES, "const uint pixel_count", "__global uint *counts"),
    "near_fill": (*_TILES, "const uint pixel_count", "const __global uint *row_start", "__global int *columns"),
    "average_near": (
        "__constant Scene *scene",
        "const __global int *column",
        *_ROWS,
        "const __global uint *row_start",  # of every pixel's entries
        "const __global Accumulator *near_sums",
        "const float keep",
        "const float unit",  # W m^-2 sr^-1 km of a sum's unit
        "__global float *values",
        "volatile __global uint *overflown",  # number of sums
    ),
    "average_far": (
        "const uint pixel_block_count",
        "const uint block_count",
        "const __global Accumulator *far_sums",
        "const __global float *block_pixels",  # pixels of every pixel block
        "const __global float *block_voxels",  # voxels of every block
        "const float keep",
        "const float unit",
        "__global float *far",
        "volatile __global uint *overflown",
    ),
    "jacobian_times": (
        "const uint pixel_count",
        "const __global uint *row_start",
        "const __global int *columns",
        "const __global float *values",
        "const __global uint *pixel_block",
        "const __global float *of_blocks",  # the far field's part, [pixel block]
        "const __global float *x",
        "__global float *result",
    ),
    "jacobian_transposed": (
        *_COLUMNS,
        "const __global float *of_blocks",  # the far field's part, [block]
        "const __global float *y",
        "__global float *result",
    ),
    "jacobian_curvature": (
        *_COLUMNS,
        "const __global uint *pixel_block",
        "const uint block_count",
        "const __global float *far",  # [pixel block][block]
        "const __global float *of_blocks",
        "const __global float *y",
        "__global float *result",
    ),
    "near_by_column": (
        "const uint count",
        "const __global uint *entries",  # of every column, among the rows' values
        "const __global float *values",
        "__global float *result",
    ),
    "sum_members": (
        "const uint block_count",
        "const __global uint *member_start",
        "const __global uint *members",
        "const __global float *x",
        "__global float *result",
    ),
    "far_times": (*_FAR, "const __global float *x", "__global float *result"),
    "far_transposed": (*_FAR, "const int squares", "const __global float *y", "__global float *result"),
    "sum_parts": (
        "const uint count",
        "const uint part_count",
        "const __global float *parts",  # [part][count]
        "__global float *result",
    ),
    "fill_table": (
        *_STARTS,
        "const uint photon_count",
        "const int enters_box",  # whether photons start on the box; or else in the sun's view
        "const int weighted",  # whether weights are given
        "const __global float *weights",
        "const __global int *column",
        "const __global uint4 *cells",
        "const float unit",  # of the sums, per km
        "volatile __global Accumulator *table_sums",  # [cell][bin]: weight x length
        *_TURNS,
    ),
    "arriving_diffuse": (
        *_STARTS,
        "const uint count",
        "const float unit",  # of the weights, sr
        "__global float *weights",
    ),
    "arriving_sunlight": (
        *_STARTS,
        "const uint count",
        "__global float *weights",
    ),
    "tabulate": (
        "volatile __global Accumulator *table_sums",  # what becomes of them takes their place
        "const __global float *scattering",  # [from bin][into bin]: scattered light
        "const __global float *solid_angle",  # of every bin, sr
        "const __global uint4 *cells",
        "const __global int *cell_column",
        "const uint count",
        "const float unit",  # of the sums in a whole voxel
        "volatile __global uint *overflown",  # number of sums
    ),
    "direct_sunlight": (
        *MEDIUM,
        "const __global int *voxel",  # of every column: index
        "const __global uint4 *cells",
        "const __global int *cell_column",  # of every cell
        "const uint count",
        "__global float *sunlight",
    ),
    "trace_photons": (
        *MEDIUM,
        "const __global View *sun_view",
        "const uint pixel_count",
        "const uint first_sample",
        "const uint photon_count",
        "const uint seed",
        "volatile __global Accumulator *columns",  # weights, [Flux][x][y]
        "volatile __global Accumulator *budget",  # [copy][Termination]
        *_TURNS,
    ),
    "laplacian": ("const __global float *extinction", "const int3 shape", "__global float *result"),
    "monotonicity_terms": (
        "const __global float *extinction",
        "const int3 shape",
        "const float c1",
        "const float c2",
        "const float threshold",
        "__global float *value",
        "__global float *outer",
        "__global float *inner",
    ),
    "prior_gradient": (
        "const __global float *smooth",
        "const __global float *outer",
        "const __global float *inner",
        "const int3 shape",
        "const float smoothness",
        "const float monotonicity",
        "const __global float *extinction",
        "const float sparsity",
        "const float sparsity_scale",  # km^-1
        "__global float *gradient",
    ),
    "sgd_step": _STEP,
    "adam_step": (
        *_STEP,
        "__global float *first_moment",
        "__global float *second_moment",
        "const float beta1",
        "const float beta2",
        "const float first_correction",
        "const float second_correction",
    ),
}
_NUMBERS: dict[str, Any] = {
    "uint": np.uint32, "int": np.int32, "float": np.float32, "uchar": np.uint8, "ushort": np.uint16,
    "Accumulator": np.int64,
}  # fmt: skip
# Types of buffers whose arrays have their components as another axis, or are made of structs: host and kernels agree
# on those by layout.STRUCTS.
_ELEMENTS = _NUMBERS | {"uint2": np.uint32, "float2": np.float32, "ushort4": np.uint16}


@dataclass(frozen=True)
class Parameter:
    """One parameter of a kernel.

    Attributes
    ----------
    declaration : in OpenCL C
    """

    declaration: str

    @cached_property
    def name(self) -> str:
        """The last word."""
        return self.declaration.replace("*", " ").split()[-1]

    @cached_property
    def kind(self) -> str:
        """The type's name, without qualifiers."""
        return self.declaration.replace("*", " ").split()[-2]

    @cached_property
    def is_buffer(self) -> bool:
        """Whether it is memory on the device."""
        return "*" in self.declaration

    def converted(self, value: Any) -> Any:
        """What pyopencl takes for a value.

        Parameters
        ----------
        value : a buffer, or an array on the device; an int, a float, or three ints

        Raises
        ------
        TypeError : of another type than the kernel's
        OverflowError : an integer that the kernel's type does not hold
        """
        if self.is_buffer:
            return self._buffer(value)
        if self.kind == "int3":
            from pyopencl import cltypes

            return cltypes.make_int3(*(operator.index(number) for number in value))  # type: ignore[attr-defined]
        if self.kind == "float":
            return np.float32(value)
        number, limits = operator.index(value), np.iinfo(_NUMBERS[self.kind])
        if not limits.min <= number <= limits.max:
            raise OverflowError(f"{self.name} is {number}: it must be from {limits.min} to {limits.max}")
        return _NUMBERS[self.kind](number)

    def _buffer(self, value: Any) -> Any:
        import pyopencl

        if isinstance(value, pyopencl.MemoryObject):
            return value
        if not hasattr(value, "data") or isinstance(value, np.ndarray | np.generic):
            raise TypeError(f"{self.name} is {type(value).__name__}: it must be a buffer or an array on the device")
        expected = _ELEMENTS.get(self.kind)
        if expected is not None and value.dtype != expected:
            raise TypeError(f"{self.name} holds {value.dtype}: the kernel reads {np.dtype(expected)}")
        return value.data


def macro(name: str, declarations: Sequence[str]) -> str:
    """A parameter list in OpenCL C."""
    return f"#define {name.upper()}_PARAMETERS {', '.join(declarations)}"


def macros() -> str:
    """The parameter lists in OpenCL C, KERNEL_PARAMETERS for each; MEDIUM_PARAMETERS, and MEDIUM_ARGUMENTS by name."""
    lines = [macro(name, declarations) for name, declarations in (KERNELS | {"medium": MEDIUM}).items()]
    lines.append(f"#define MEDIUM_ARGUMENTS {', '.join(Parameter(declaration).name for declaration in MEDIUM)}")
    return "\n".join(lines)


class Kernel:
    """A built kernel that takes plain Python values.

    Parameters
    ----------
    opencl : pyopencl's kernel
    name : of it, for messages
    declarations : of its parameters, one of KERNELS
    """

    def __init__(self, opencl: Any, name: str, declarations: Sequence[str]) -> None:
        self._opencl = opencl
        self._parameters = tuple(map(Parameter, declarations))
        self._places = {parameter.name: place for place, parameter in enumerate(self._parameters)}
        self.function_name = name
        self.takes_turns = TURNS in self._places
        self._spare: list[Any] = []

    def __call__(
        self,
        queue: Any,
        size: tuple[int, ...],
        group: tuple[int, ...],
        *values: Any,
        global_offset: tuple[int, ...] | None = None,
        **named: Any,
    ) -> Any:
        """Launches it; see `arguments`."""
        return self._opencl(queue, size, group, *self.arguments(*values, **named), global_offset=global_offset)

    def taken(self) -> Any:
        """A copy of pyopencl's kernel, which has arguments of its own until it is given back."""
        import pyopencl

        return self._spare.pop() if self._spare else pyopencl.Kernel(self._opencl.program, self.function_name)

    def give_back(self, copy: Any) -> None:
        """Keeps a copy for who takes the next one: to make one takes as long as many launches."""
        self._spare.append(copy)

    def arguments(self, *values: Any, **named: Any) -> list[Any]:
        """All arguments as pyopencl takes them.

        Parameters
        ----------
        values : of the first parameters, in their order
        named : of the others, by name

        Raises
        ------
        TypeError : one is missing, there are too many, a name is none of the kernel's or given twice, a wrong type
        OverflowError : an integer is too large
        """
        if len(values) > len(self._parameters):
            raise TypeError(f"{self.function_name} takes {len(self._parameters)} arguments, {len(values)} are given")
        given: list[Any] = [*values, *[_MISSING] * (len(self._parameters) - len(values))]
        for name, value in named.items():
            place = self._places.get(name)
            if place is None:
                raise TypeError(f"{self.function_name} has no parameter {name}; it has {', '.join(self._places)}")
            if given[place] is not _MISSING:
                raise TypeError(f"{self.function_name}: {name} is given twice")
            given[place] = value
        missing = [parameter.name for parameter, value in zip(self._parameters, given) if value is _MISSING]
        if missing:
            raise TypeError(f"{self.function_name}: missing {', '.join(missing)}")
        try:
            return [parameter.converted(value) for parameter, value in zip(self._parameters, given)]
        except (TypeError, OverflowError) as error:
            raise type(error)(f"{self.function_name}: {error}") from None


_MISSING = object()
