/* The patch prior of one step (docs/explanation/patches.md): the choice of each patch's component, and the quadratic
 * function that is the sum over all patches.
 *
 * A patch has PATCH_X x PATCH_Y x PATCH_Z values around its centre, odd numbers, z fastest; beyond the edges of the
 * grid the nearest voxel is repeated. The sum of all patches' quadratic forms is a quadratic form of the voxels, whose
 * matrix couples a voxel with those that share a patch with it: the stencil. It is stored by tiles, LANES voxels in a
 * row along z, and its products cost 15 times less than those of single patches. One work item makes each sum, in a
 * fixed order.
 *
 * The halo is the grid with margins of zeros around it, so that no tile reads beyond the array. */

#include "lanes.h"

#define VALUES (PATCH_X * PATCH_Y * PATCH_Z)
#define CHUNKS ((VALUES + LANES - 1) / LANES)
#define PLACE(x, y, z) (((x) * PATCH_Y + (y)) * PATCH_Z + (z))
#define OFFSETS_X (2 * PATCH_X - 1)
#define OFFSETS_Y (2 * PATCH_Y - 1)
#define OFFSETS_Z (2 * PATCH_Z - 1)

inline int grid_index(int3 voxel, int3 shape) { return (voxel.x * shape.y + voxel.y) * shape.z + voxel.z; }

inline int halo_index(int3 voxel, int3 halo)
{
    return grid_index(voxel + (int3)(PATCH_X - 1, PATCH_Y - 1, PATCH_Z - 1), halo);
}

/* The voxel at a place of a patch, along one axis. */
inline int voxel_at(int centre, int place, int width, int count)
{
    return clamp(centre + place - width / 2, 0, count - 1);
}

/* The first and the last place of a voxel in a patch, along one axis. It has none if the last is before the first. */
inline int2 places_of(int voxel, int centre, int width, int count)
{
    const int place = voxel - centre + width / 2;
    return (int2)(voxel == 0 ? 0 : place, voxel == count - 1 ? width - 1 : place);
}

/* The first and the last centre of patches that hold both voxels, along one axis. */
inline int2 centres_of(int one, int other, int width, int count)
{
    return (int2)(max(max(one, other) - width / 2, 0), min(min(one, other) + width / 2, count - 1));
}

inline int3 int3_of(ushort4 voxel) { return (int3)(voxel.x, voxel.y, voxel.z); }

/* The component with the least minus log density of a patch, and that value minus the one of a patch of zeros with the
 * first component. */
__kernel void choose_components(CHOOSE_COMPONENTS_PARAMETERS)
{
    const uint patch = get_global_id(0);
    if (patch >= patch_count)
        return;
    const int3 middle = int3_of(centre[patch]);
    float held[CHUNKS * LANES];
    bool clear = true;
    for (int x = 0, place = 0; x < PATCH_X; ++x)
        for (int y = 0; y < PATCH_Y; ++y)
            for (int z = 0; z < PATCH_Z; ++z, ++place) {
                const int3 voxel =
                    (int3)(voxel_at(middle.x, x, PATCH_X, shape.x), voxel_at(middle.y, y, PATCH_Y, shape.y),
                           voxel_at(middle.z, z, PATCH_Z, shape.z));
                held[place] = values[halo_index(voxel, halo)];
                clear = clear && held[place] == 0.0f;
            }
    for (int place = VALUES; place < CHUNKS * LANES; ++place)
        held[place] = 0.0f;
    float8 own[CHUNKS];
    for (int chunk = 0; chunk < CHUNKS; ++chunk)
        own[chunk] = vload8(chunk, held);
    /* A good first guess makes the search shorter, and does not change its result. */
    const int index = grid_index(middle, shape);
    const uint guess = component[index] < component_count ? component[index] : 0u;
    uint found = 0u;
    float least = clear ? constants[0] : INFINITY;
    for (uint n = 0u; n <= component_count && !clear; ++n) {
        const uint tried = n == 0u ? guess : n - 1u;
        float sum = constants[tried];
        /* Axes from the narrowest on: most components are soon too unlikely. */
        for (uint axis = 0u; axis < VALUES && sum <= least; ++axis) {
            const __global float *row = whitening + (size_t)(tried * VALUES + axis) * CHUNKS * LANES;
            float8 sums = 0.0f;
#pragma unroll
            for (int chunk = 0; chunk < CHUNKS; ++chunk)
                sums += own[chunk] * vload8(chunk, row);
            const float away = sum_of(sums) - white_means[tried * VALUES + axis];
            sum += 0.5f * away * away;
        }
        if (sum < least || (sum == least && tried < found)) {
            least = sum;
            found = tried;
        }
    }
    component[index] = found;
    cost[patch] = least - constants[0];
}

/* Which tiles have a voxel in a patch with cloud. */
__kernel void find_tiles(FIND_TILES_PARAMETERS)
{
    const uint tile = get_global_id(0);
    if (tile >= tile_count)
        return;
    const int3 first = int3_of(corner[tile]);
    const int2 xs = centres_of(first.x, first.x, PATCH_X, shape.x), ys = centres_of(first.y, first.y, PATCH_Y, shape.y);
    const int low = max(first.z - PATCH_Z / 2, 0), high = min(first.z + LANES - 1 + PATCH_Z / 2, shape.z - 1);
    bool found = false;
    for (int x = xs.x; x <= xs.y; ++x)
        for (int y = ys.x; y <= ys.y; ++y)
            for (int z = low; z <= high; ++z) {
                const ushort n = component[grid_index((int3)(x, y, z), shape)];
                found = found || (n != 0 && n != NO_PATCH);
            }
    reached[tile] = found;
}

/* One work item computes the entries of a voxel for all voxels at one offset along x and y. */
__kernel void assemble_stencil(ASSEMBLE_STENCIL_PARAMETERS)
{
    const uint item = get_global_id(0), lane = item % LANES, across = item / LANES % (OFFSETS_X * OFFSETS_Y);
    const uint tile = item / (LANES * OFFSETS_X * OFFSETS_Y);
    if (tile >= tile_count)
        return;
    const int3 voxel = int3_of(corner[tile]) + (int3)(0, 0, lane);
    const int other_x = voxel.x + (int)(across / OFFSETS_Y) - (PATCH_X - 1);
    const int other_y = voxel.y + (int)(across % OFFSETS_Y) - (PATCH_Y - 1);
    float sums[OFFSETS_Z];
    for (int n = 0; n < OFFSETS_Z; ++n)
        sums[n] = 0.0f;
    const bool inside =
        number[tile * LANES + lane] >= 0 && other_x >= 0 && other_x < shape.x && other_y >= 0 && other_y < shape.y;
    const int2 xs = centres_of(voxel.x, other_x, PATCH_X, shape.x), ys = centres_of(voxel.y, other_y, PATCH_Y, shape.y);
    for (int x = xs.x; inside && x <= xs.y; ++x) {
        const int2 px = places_of(voxel.x, x, PATCH_X, shape.x), qx = places_of(other_x, x, PATCH_X, shape.x);
        for (int y = ys.x; y <= ys.y; ++y) {
            const int2 py = places_of(voxel.y, y, PATCH_Y, shape.y), qy = places_of(other_y, y, PATCH_Y, shape.y);
            /* Except at the edges of the grid, both voxels have one place each in a patch. */
            const bool alone = px.x == px.y && qx.x == qx.y && py.x == py.y && qy.x == qy.y;
#pragma unroll
            for (int n = 0; n < PATCH_Z; ++n) {
                const int z = voxel.z + n - PATCH_Z / 2;
                const ushort chosen = z < 0 || z >= shape.z ? NO_PATCH : component[grid_index((int3)(x, y, z), shape)];
                if (chosen == 0 || chosen == NO_PATCH)
                    continue;
                const __global float *own = precision + (size_t)chosen * VALUES * VALUES;
                if (alone && z >= PATCH_Z / 2 && z < shape.z - PATCH_Z / 2) {
                    const __global float *row =
                        own + PLACE(px.x, py.x, PATCH_Z - 1 - n) * VALUES + PLACE(qx.x, qy.x, 0);
#pragma unroll
                    for (int c = 0; c < PATCH_Z; ++c)
                        sums[n + c] += row[c];
                    continue;
                }
                const int2 pz = places_of(voxel.z, z, PATCH_Z, shape.z);
                for (int i = px.x; i <= px.y; ++i)
                    for (int j = py.x; j <= py.y; ++j)
                        for (int k = pz.x; k <= pz.y; ++k)
                            for (int a = qx.x; a <= qx.y; ++a)
                                for (int b = qy.x; b <= qy.y; ++b)
                                    for (int c = 0; c < PATCH_Z; ++c)
                                        sums[voxel_at(z, c, PATCH_Z, shape.z) - voxel.z + PATCH_Z - 1] +=
                                            own[PLACE(i, j, k) * VALUES + PLACE(a, b, c)];
            }
        }
    }
    for (int n = 0; n < OFFSETS_Z; ++n)
        stencil[(((size_t)tile * OFFSETS_X * OFFSETS_Y + across) * OFFSETS_Z + n) * LANES + lane] = sums[n];
}

/* For every voxel of this rank (w is 0): the sum of precision times mean over its patches, the diagonal of the matrix
 * by patches without cloud, and the diagonal by all patches. */
__kernel void sum_patches(SUM_PATCHES_PARAMETERS)
{
    const uint index = get_global_id(0);
    if (index >= voxel_count || voxel[index].w)
        return;
    const int3 own = int3_of(voxel[index]);
    const int2 xs = centres_of(own.x, own.x, PATCH_X, shape.x), ys = centres_of(own.y, own.y, PATCH_Y, shape.y);
    const int2 zs = centres_of(own.z, own.z, PATCH_Z, shape.z);
    float slopes = 0.0f, diagonals = 0.0f;
    uint count = 0u;
    for (int x = xs.x; x <= xs.y; ++x)
        for (int y = ys.x; y <= ys.y; ++y)
            for (int z = zs.x; z <= zs.y; ++z) {
                const ushort n = component[grid_index((int3)(x, y, z), shape)];
                if (n == NO_PATCH)
                    continue;
                const int2 px = places_of(own.x, x, PATCH_X, shape.x), py = places_of(own.y, y, PATCH_Y, shape.y);
                const int2 pz = places_of(own.z, z, PATCH_Z, shape.z);
                for (int i = px.x; i <= px.y; ++i)
                    for (int j = py.x; j <= py.y; ++j)
                        for (int k = pz.x; k <= pz.y; ++k) {
                            const int place = n * VALUES + PLACE(i, j, k);
                            slopes += slope[place];
                            diagonals += diagonal_of[place];
                            count += n == 0;
                        }
            }
    of_means[index] = slopes;
    clear[index] = (float)count * diagonal_of[0];
    diagonal[index] = diagonals;
}

/* Adds factor times the stencil's product with the values in the halo; one work item computes a tile. */
__kernel void add_stencil_product(ADD_STENCIL_PRODUCT_PARAMETERS)
{
    const uint tile = get_global_id(0);
    if (tile >= tile_count)
        return;
    const __global float *entries = stencil + (size_t)tile * OFFSETS_X * OFFSETS_Y * OFFSETS_Z * LANES;
    const __global float *middle = values + halo_index(int3_of(corner[tile]), halo) - (PATCH_Z - 1);
    float8 sums = 0.0f;
    for (int x = 1 - PATCH_X; x < PATCH_X; ++x)
        for (int y = 1 - PATCH_Y; y < PATCH_Y; ++y) {
            const __global float *others = middle + (x * halo.y + y) * halo.z;
            float8 row = 0.0f;
#pragma unroll
            for (int z = 0; z < OFFSETS_Z; ++z)
                row += vload8(z, entries) * vload8(0, others + z);
            sums += row;
            entries += OFFSETS_Z * LANES;
        }
    float lanes[LANES];
    vstore8(sums, 0, lanes);
    for (uint lane = 0u; lane < LANES; ++lane) {
        const int index = number[tile * LANES + lane];
        if (index >= 0)
            result[index] += factor * lanes[lane];
    }
}

/* Adds factor times the product of patches without cloud, minus `means` times the means' part. */
__kernel void add_diagonal_product(ADD_DIAGONAL_PRODUCT_PARAMETERS)
{
    const uint index = get_global_id(0);
    if (index < voxel_count)
        result[index] += factor * (clear[index] * values[place[index]] - means * of_means[index]);
}
