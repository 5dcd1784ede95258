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

# Parameters that describe the scene to a path: walk/medium.h.
MEDIUM = (
    "__constant Scene *scene",
    "const __global float *extinction",  # extinction of droplets, km^-1, [x][y][z]
    "const __global float *table_row",  # [voxel]: row of the phase table, or a place between two rows
    "const __global uchar *empty",  # [block]: how many blocks around it hold nothing, see walk_skip
    "const __global float *profiles",  # profiles of the air and the phase table, see make_medium
)
# Paths from cameras: a path's number in its launch is `sample_in_launch * pixel_count + pixel`.
PATHS = (
    *MEDIUM,
    "const __global View *views",
    "const __global float *rays",  # [ray][6]: rays of the views that are lists of rays
    "const __global uint2 *pixels",  # (view, pixel)
    "const uint pixel_count",
    "const uint first_sample",
    "const uint path_count",
    "const uint seed",
    "const uint stream",
)
# Parameter of kernels whose work items walk several paths on a GPU (kernels/walk/turns.h); `Device.launch` sets it.
TURNS = "turns"
_TURNS = (f"const uint {TURNS}",)  # paths per work item
_REPLAY = (
    *PATHS,
    # From render_paths, sr^-1: [path] of each path; after these, of paths that branch, [branch][path] of each branch
    # with those that began on it.
    "const __global float *path_radiance",
    "volatile __global uint *astray",  # number of paths whose radiance is now another one
)
_TABLE = (
    "const __global int *column",  # [voxel]: column of the radiance table, or -1
    "const __global uint4 *cells",  # [column]: first cell, and numbers of cells along x, y, z
    "const __global float *diffuse",  # [cell][2][bin]: source minus radiance, and source, sr^-1
    "const __global float *sunlight",  # [cell]: direct sunlight, share of the irradiance
)
_STARTS = (  # starts of photons
    *MEDIUM,
    "const __global View *sun_view",
    "const uint pixel_count",
    "const __global float *box",  # lower and upper corner, voxel units
    "const uint first_sample",
    "const uint seed",
    "const uint stream",
)
_GRADIENT = (
    "const __global float2 *adjoint",  # [pixel]: derivative of the cost by the radiance of even, odd samples
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
    "const __global uint *slot_start",  # [pixel]: first slot of the pixel's tile
    "const uint first_pixel",
    "const uint row_count",
)
_COLUMNS = (
    "const uint voxel_count",
    "const __global uint *column_start",  # [voxel]: place of the column's first entry
    "const __global uint *rows",  # [entry]: pixel
    "const __global float *values",  # [entry]: derivative, W m^-2 sr^-1 km
    "const __global int *block",  # [voxel]: block of the far field
)
_FAR = (
    "const uint pixel_block_count",
    "const uint block_count",
    "const __global float *far",  # [pixel block][block]: mean derivative, W m^-2 sr^-1 km
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
        "__global float *path_radiance",  # as in replays, sr^-1
        "const uint stores_branches",  # whether the branches' are wanted
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
        "const float unit",  # units of the sums per km
        "volatile __global Accumulator *lengths",  # [x][y][z]: length of paths in the voxel
    ),
    "gradient_paths": (
        *_REPLAY,
        *_TABLE,
        "const __global float2 *adjoint",
        "const __global float *change",  # change of the extinction, km^-1, [x][y][z]
        "volatile __global Accumulator *gradient",
        "__global float *path_tangent",  # [path]: derivative of its radiance along the change, sr^-1
        *_TURNS,
    ),
    "gradient_rays": (
        *_REPLAY,
        *_TABLE,
        "const uint ray_count",  # rays of each pixel
        "const float weight",  # paths that each ray stands for
        "const __global float2 *adjoint",
        "const __global float *change",
        "volatile __global Accumulator *gradient",
        "__global float *ray_tangent",
    ),
    "jacobian_rays": (
        *_REPLAY,
        *_TABLE,
        "const uint ray_count",  # rays of each pixel
        "const float weight",  # paths that each ray stands for
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
        "const __global ushort4 *place",  # [column]: voxel (x, y, z)
        "const __global int *block",  # [column]: block of voxels
        "const __global uint *pixel_block",  # [pixel]: block of pixels
        "const uint block_count",
        "volatile __global Accumulator *near_sums",  # [slot]: sums of the pixels in rows
        "volatile __global Accumulator *far_sums",  # [pixel block][block]: sums
        *_TURNS,
    ),
    "count_near": (*_TILES, "const uint pixel_count", "__global uint *counts"),
    "list_near": (*_TILES, "const uint pixel_count", "const __global uint *row_start", "__global int *columns"),
    "average_near": (
        "__constant Scene *scene",
        "const __global int *column",
        *_ROWS,
        "const __global uint *row_start",  # [pixel]: the pixel's first entry
        "const __global Accumulator *near_sums",
        "const float keep",
        "const float unit",  # W m^-2 sr^-1 km for each unit of the sums
        "__global float *values",
        "volatile __global uint *overflown",  # number of sums that have overflowed
    ),
    "average_far": (
        "const uint pixel_block_count",
        "const uint block_count",
        "const __global Accumulator *far_sums",
        "const __global float *block_pixels",  # [pixel block]: number of pixels
        "const __global float *block_voxels",  # [block]: number of voxels
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
        "const __global float *of_blocks",  # [pixel block]: the far field's part of the product
        "const __global float *x",
        "__global float *result",
    ),
    "jacobian_transposed": (
        *_COLUMNS,
        "const __global float *of_blocks",  # [block]: the far field's part of the product
        "const __global float *y",
        "__global float *result",
    ),
    "jacobian_curvature": (
        *_COLUMNS,
        "const __global uint *pixel_block",
        "const uint block_count",
        "const __global float *far",  # [pixel block][block]
        "const __global float *of_blocks",  # [block]: the far field's part of the result
        "const __global float *y",
        "__global float *result",
    ),
    "near_by_column": (
        "const uint count",
        "const __global uint *entries",  # [entry by columns]: the same entry by rows
        "const __global float *values",
        "__global float *result",
    ),
    "sum_members": (
        "const uint block_count",
        "const __global uint *member_start",  # [block]: place of its first member
        "const __global uint *members",  # index in x
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
        "const int enters_box",  # whether photons start on the box; if not, in the sun's view
        "const int weighted",  # whether weights are given
        "const __global float *weights",  # [photon]
        "const __global int *column",
        "const __global uint4 *cells",
        "const float unit",  # units of the sums per km
        "volatile __global Accumulator *table_sums",  # [cell][bin]: weight x length
        *_TURNS,
    ),
    "arriving_diffuse": (
        *_STARTS,
        "const uint count",
        "const float unit",  # factor from a radiance to a weight, sr
        "__global float *weights",
    ),
    "arriving_sunlight": (
        *_STARTS,
        "const uint count",
        "__global float *weights",
    ),
    "tabulate": (
        "volatile __global Accumulator *table_sums",  # [cell][bin]; overwritten by the table's values
        "const __global float *scattering",  # [from bin][into bin]: source function by light from a bin, sr^-1
        "const __global float *solid_angle",  # [bin], sr
        "const __global uint4 *cells",
        "const __global int *cell_column",
        "const uint count",
        "const float unit",  # factor of the sums of a whole voxel: radiance times sr
        "volatile __global uint *overflown",  # number of sums that have overflowed
    ),
    "direct_sunlight": (
        *MEDIUM,
        "const __global int *voxel",  # [column]: index of the voxel
        "const __global uint4 *cells",
        "const __global int *cell_column",  # [cell]: column
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
# dtypes of the arrays for each buffer type; vectors' components are a further axis of the array. Structs are missing
# here: layout.STRUCTS describes them.
_ELEMENTS = _NUMBERS | {"uint2": np.uint32, "float2": np.float32, "ushort4": np.uint16}


@dataclass(frozen=True)
class Parameter:
    """One parameter of a kernel.

    Attributes
    ----------
    declaration : declaration in OpenCL C
    """

    declaration: str

    @cached_property
    def name(self) -> str:
        """The parameter's name: the last word of its declaration."""
        return self.declaration.replace("*", " ").split()[-1]

    @cached_property
    def kind(self) -> str:
        """The name of the type, without qualifiers."""
        return self.declaration.replace("*", " ").split()[-2]

    @cached_property
    def is_buffer(self) -> bool:
        """Whether the parameter is a buffer on the device."""
        return "*" in self.declaration

    def converted(self, value: Any) -> Any:
        """A value as pyopencl takes it.

        Parameters
        ----------
        value : a buffer, or an array on the device; an int, a float, or three ints

        Raises
        ------
        TypeError : the value has another type than the kernel's parameter
        OverflowError : the integer does not fit the kernel's type
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
    """The macros of all parameter lists in OpenCL C; and MEDIUM_ARGUMENTS, the names in MEDIUM_PARAMETERS."""
    lines = [macro(name, declarations) for name, declarations in (KERNELS | {"medium": MEDIUM}).items()]
    lines.append(f"#define MEDIUM_ARGUMENTS {', '.join(Parameter(declaration).name for declaration in MEDIUM)}")
    return "\n".join(lines)


class Kernel:
    """A built kernel that takes plain Python values.

    Parameters
    ----------
    opencl : pyopencl's kernel
    name : name of the kernel, for messages
    declarations : declarations of its parameters, a value of KERNELS
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
        """A copy of pyopencl's kernel, whose arguments nobody else sets until it is given back."""
        import pyopencl

        return self._spare.pop() if self._spare else pyopencl.Kernel(self._opencl.program, self.function_name)

    def give_back(self, copy: Any) -> None:
        """Keeps a copy for the next `taken`: making a new one takes as long as many launches."""
        self._spare.append(copy)

    def arguments(self, *values: Any, **named: Any) -> list[Any]:
        """All arguments as pyopencl takes them.

        Parameters
        ----------
        values : values of the first parameters, in their order
        named : values of the other parameters, by name

        Raises
        ------
        TypeError : an argument is missing, unknown, given twice or of a wrong type, or there are too many
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
