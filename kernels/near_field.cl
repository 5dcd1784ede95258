/* The entries of a Jacobian's near field, and averages of derivatives over renderings. */
#include "walk/accumulate.h"
#include "near_field.h"

/* The number of voxels of the mask in every pixel's tile. */
__kernel void count_near(COUNT_NEAR_PARAMETERS)
{
    const size_t row = get_global_id(0);
    if (row >= pixel_count)
        return;
    const __global Tile *tile = tiles + row;
    uint found = 0u;
    for (int slot = 0; slot < tile->slabs * TILE_AREA; ++slot) {
        const int index = slot_index(scene, tile, slot);
        found += index >= 0 && column[index] >= 0;
    }
    counts[row] = found;
}

/* The columns of these voxels, in the order of their slots. */
__kernel void list_near(LIST_NEAR_PARAMETERS)
{
    const size_t row = get_global_id(0);
    if (row >= pixel_count)
        return;
    const __global Tile *tile = tiles + row;
    uint entry = row_start[row];
    for (int slot = 0; slot < tile->slabs * TILE_AREA; ++slot) {
        const int index = slot_index(scene, tile, slot);
        if (index >= 0 && column[index] >= 0)
            columns[entry++] = column[index];
    }
}

/* entry <- keep entry + unit sum, for the pixels from first_pixel on. */
__kernel void average_near(AVERAGE_NEAR_PARAMETERS)
{
    const size_t item = get_global_id(0);
    if (item >= row_count)
        return;
    const uint row = first_pixel + (uint)item;
    const __global Tile *tile = tiles + row;
    const __global Accumulator *sums = near_sums + (slot_start[row] - slot_start[first_pixel]);
    uint entry = row_start[row];
    for (int slot = 0; slot < tile->slabs * TILE_AREA; ++slot) {
        const int index = slot_index(scene, tile, slot);
        if (index < 0 || column[index] < 0)
            continue;
        if (has_overflowed(sums[slot]))
            atomic_inc(overflown);
        values[entry] = keep * values[entry] + unit * (float)sums[slot];
        ++entry;
    }
}

/* The same for blocks; a sum is divided equally among all pixels and voxels of the blocks. */
__kernel void average_far(AVERAGE_FAR_PARAMETERS)
{
    const size_t item = get_global_id(0);
    if (item >= (size_t)pixel_block_count * block_count)
        return;
    const float members = block_pixels[item / block_count] * block_voxels[item % block_count];
    if (has_overflowed(far_sums[item]))
        atomic_inc(overflown);
    far[item] = keep * far[item] + unit * (float)far_sums[item] / members;
}
