"""The parameters of kernels that minimise: of minimise.cl and patches.cl; see parameters.py."""

from __future__ import annotations

_POINT = (
    "const uint count",
    "const __global float *x",
    "const __global float *upper",  # bound of x
    "const __global float *gradient",
)
_HALO = (
    "const int3 shape",  # of the grid
    "const int3 halo",  # and with what is around it
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
        "const __global float *hessian_change",  # the second derivative times the change
        "__global float *sums",  # [3][part]
    ),
    "choose_step": (
        "const __global float *sums",  # [3][part]
        "const float longest",  # changes, that a step may take
        "const int most_steps",
        "const float tolerance",  # share of all that was gained
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
        "const __global uint *place",  # of every number, among the values
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
        "const __global uint *part_start",  # of the pixels' list
        "const __global uint *pixels",
        "const __global float *weighted_basis",  # [pixel][basis]
        "const __global float *residual",
        "__global float *sums",
    ),
    "fit_views": (
        "const uint view_count",
        "const uint basis_count",
        "const __global uint *first_part",  # of every view
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
        "__global ushort *component",  # a guess, and the result, by the patch's centre, [x][y][z]
        "__global float *cost",  # of every patch
    ),
    "find_tiles": (
        "const uint tile_count",
        "const __global ushort4 *corner",  # of every tile, its first voxel
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
        "const __global ushort4 *voxel",  # w: whether it is another rank's
        "const int3 shape",
        "const __global ushort *component",
        "const __global float *slope",  # precision times mean, [component][value]
        "const __global float *diagonal_of",  # the precision's, [component][value]
        "__global float *of_means",
        "__global float *clear",
        "__global float *diagonal",
    ),
    "add_stencil_product": (
        "const uint tile_count",
        "const __global ushort4 *corner",
        "const __global int *number",  # of every tile's voxels, among those of the mask, or -1
        "const int3 halo",
        "const __global float *stencil",
        "const __global float *values",
        "const float factor",
        "__global float *result",
    ),
    "add_diagonal_product": (
        "const uint voxel_count",
        "const __global uint *place",  # of every voxel of the mask, in the halo
        "const __global float *clear",
        "const __global float *of_means",
        "const float means",
        "const __global float *values",
        "const float factor",
        "__global float *result",
    ),
}
