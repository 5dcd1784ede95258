"""The parameters of the kernels for minimisation, minimise.cl and patches.cl; see parameters.py."""

from __future__ import annotations

_POINT = (
    "const uint count",
    "const __global float *x",
    "const __global float *upper",  # upper bound of x
    "const __global float *gradient",
)
_HALO = (
    "const int3 shape",  # voxels of the grid
    "const int3 halo",  # voxels of the grid with its margins: patches.cl
)
VECTOR_KERNELS: dict[str, tuple[str, ...]] = {
    "next_change": (
        *_POINT,
        "const __global float *inverse_diagonal",
        "const __global Minimisation *state",
        "__global float *change",
        "__global float *product",
    ),
    "sums_of_change": (
        *_POINT,
        "const __global float *change",
        "const __global float *hessian_change",  # the Hessian's product with the change
        "__global float *sums",  # [3][part]
    ),
    "choose_step": (
        "const __global float *sums",  # [3][part]
        "const float longest",  # largest step, in units of the change
        "const int most_steps",
        "const float tolerance",  # least gain of a step, as a share of all gains
        "__global Minimisation *state",
    ),
    "take_step": (
        "const uint count",
        "const __global Minimisation *state",
        "const __global float *change",
        "const __global float *hessian_change",
        "const __global float *upper",
        "__global float *x",
        "__global float *gradient",
    ),
    "sums_of_gradient": (
        *_POINT,
        "const __global float *inverse_diagonal",
        "const __global float *hessian_change",
        "__global float *sums",  # [part]
    ),
    "choose_conjugation": ("const __global float *sums", "__global Minimisation *state"),
    "add_vector": ("const uint count", "const float factor", "const __global float *x", "__global float *result"),
    "spread_values": (
        "const uint count",
        "const float factor",
        "const __global uint *place",  # [element of x]: its index in values
        "const __global float *x",
        "__global float *values",
    ),
    "add_gathered": (
        "const uint count",
        "const float factor",
        "const __global uint *place",
        "const __global float *values",
        "__global float *result",
    ),
    "find_change": (
        "const uint count",
        "const __global float *x",
        "const __global float *start",
        "__global float *result",
    ),
    "add_damped": (
        "const uint count",
        "const __global float *transposed",
        "const __global float *damping",
        "const __global float *change",
        "__global float *result",
    ),
    "sum_basis": (
        "const uint part_count",
        "const uint basis_count",
        "const __global uint *part_start",  # [part]: its first place in pixels
        "const __global uint *pixels",  # pixels ordered by view
        "const __global float *weighted_basis",  # [pixel][basis]
        "const __global float *residual",
        "__global float *sums",
    ),
    "fit_views": (
        "const uint view_count",
        "const uint basis_count",
        "const __global uint *first_part",  # [view]
        "const __global float *sums",
        "const __global float *matrix",  # [view][basis][view][basis]
        "__global float *fitted",
    ),
    "weigh_residual": (
        "const uint pixel_count",
        "const uint basis_count",
        "const __global uint *view",
        "const __global float *basis",  # [pixel][basis]
        "const __global float *fitted",
        "const __global float *weights",
        "const __global float *residual",
        "__global float *result",
    ),
    "choose_components": (
        "const uint patch_count",
        "const __global ushort4 *centre",
        *_HALO,
        "const __global float *values",
        "const uint component_count",
        "const __global float *whitening",  # [component][axis][value], padded to full lanes
        "const __global float *white_means",  # [component][axis]
        "const __global float *constants",  # [component]
        "__global ushort *component",  # [x][y][z] of the patch's centre: first a guess, then the result
        "__global float *cost",  # [patch]
    ),
    "find_tiles": (
        "const uint tile_count",
        "const __global ushort4 *corner",  # [tile]: its first voxel
        "const int3 shape",
        "const __global ushort *component",
        "__global uchar *reached",
    ),
    "assemble_stencil": (
        "const uint tile_count",
        "const __global ushort4 *corner",
        "const __global int *number",
        "const int3 shape",
        "const __global ushort *component",
        "const __global float *precision",  # [component][value][value]
        "__global float *stencil",  # [tile][offset][lane]
    ),
    "sum_patches": (
        "const uint voxel_count",
        "const __global ushort4 *voxel",  # (x, y, z), and whether it is another rank's (w)
        "const int3 shape",
        "const __global ushort *component",
        "const __global float *slope",  # [component][value]: precision times mean
        "const __global float *diagonal_of",  # [component][value]: diagonal of the precision
        "__global float *of_means",  # [voxel]: precision times mean, summed over patches
        "__global float *clear",  # [voxel]: diagonal by patches without cloud
        "__global float *diagonal",  # [voxel]: diagonal by all patches
    ),
    "add_stencil_product": (
        "const uint tile_count",
        "const __global ushort4 *corner",
        "const __global int *number",  # [tile][lane]: number of the voxel in the mask, or -1
        "const int3 halo",
        "const __global float *stencil",
        "const __global float *values",
        "const float factor",
        "__global float *result",
    ),
    "add_diagonal_product": (
        "const uint voxel_count",
        "const __global uint *place",  # [voxel of the mask]: its index in the halo
        "const __global float *clear",
        "const __global float *of_means",
        "const float means",  # factor of of_means: 1 for a gradient, 0 for a product
        "const __global float *values",
        "const float factor",
        "__global float *result",
    ),
}
