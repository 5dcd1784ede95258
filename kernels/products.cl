/* Products with a Jacobian in two parts: the near field by rows (CSR) and by columns, and the far field by blocks. One
 * work item makes each sum, in the order of its entries; sums of the far field are made in parts of FAR_PART, which are
 * then added in order. WIDTH is the width of the vectors that are read at a time, 8. */

#include "lanes.h"

/* near x + far x. */
__kernel void jacobian_times(JACOBIAN_TIMES_PARAMETERS)
{
    const size_t row = get_global_id(0);
    if (row >= pixel_count)
        return;
    float sum = 0.0f;
    for (uint entry = row_start[row]; entry < row_start[row + 1]; ++entry)
        sum += values[entry] * x[columns[entry]];
    result[row] = sum + of_blocks[pixel_block[row]];
}

/* near^T y + far^T y. */
__kernel void jacobian_transposed(JACOBIAN_TRANSPOSED_PARAMETERS)
{
    const size_t voxel = get_global_id(0);
    if (voxel >= voxel_count)
        return;
    float sum = 0.0f;
    for (uint place = column_start[voxel]; place < column_start[voxel + 1]; ++place)
        sum += values[place] * y[rows[place]];
    result[voxel] = sum + of_blocks[block[voxel]];
}

/* The diagonal of J^T diag(y) J, J = near + far; `of_blocks` has the diagonal for the far field alone. */
__kernel void jacobian_curvature(JACOBIAN_CURVATURE_PARAMETERS)
{
    const size_t voxel = get_global_id(0);
    if (voxel >= voxel_count)
        return;
    float sum = 0.0f;
    for (uint place = column_start[voxel]; place < column_start[voxel + 1]; ++place) {
        const uint row = rows[place];
        const float value = values[place];
        sum += value * (value + 2.0f * far[(size_t)pixel_block[row] * block_count + block[voxel]]) * y[row];
    }
    result[voxel] = sum + of_blocks[block[voxel]];
}

/* The values of the near field by columns, from those by rows. */
__kernel void near_by_column(NEAR_BY_COLUMN_PARAMETERS)
{
    const size_t place = get_global_id(0);
    if (place < count)
        result[place] = values[entries[place]];
}

/* Sums of a vector's elements over the members of each block. */
__kernel void sum_members(SUM_MEMBERS_PARAMETERS)
{
    const size_t index = get_global_id(0);
    if (index >= block_count)
        return;
    float sum = 0.0f;
    for (uint place = member_start[index]; place < member_start[index + 1]; ++place)
        sum += x[members[place]];
    result[index] = sum;
}

/* far x, in parts of FAR_PART columns: `result` is [part][row]. */
__kernel void far_times(FAR_TIMES_PARAMETERS)
{
    const uint item = get_global_id(0), part = item / pixel_block_count, row = item % pixel_block_count;
    if (part * FAR_PART >= block_count)
        return;
    const __global float *values = far + (size_t)row * block_count;
    const uint last = min((part + 1u) * FAR_PART, block_count);
    float8 sums = 0.0f;
    uint n = part * FAR_PART;
    for (; n + WIDTH <= last; n += WIDTH)
        sums += vload8(0, values + n) * vload8(0, x + n);
    float sum = sum_of(sums);
    for (; n < last; ++n)
        sum += values[n] * x[n];
    result[item] = sum;
}

/* far^T y, or with the squares of far, in parts of FAR_PART rows: `result` is [part][column]; each work
 * item computes WIDTH columns. */
__kernel void far_transposed(FAR_TRANSPOSED_PARAMETERS)
{
    const uint groups = (block_count + WIDTH - 1u) / WIDTH;
    const uint part = get_global_id(0) / groups, first = get_global_id(0) % groups * WIDTH;
    if (part * FAR_PART >= pixel_block_count)
        return;
    const uint last = min((part + 1u) * FAR_PART, pixel_block_count);
    const __global float *values = far + first;
    __global float *sums = result + (size_t)part * block_count + first;
    if (first + WIDTH <= block_count) {
        float8 sum = 0.0f;
        for (uint row = part * FAR_PART; row < last; ++row) {
            const float8 value = vload8(0, values + (size_t)row * block_count);
            sum += (squares ? value * value : value) * y[row];
        }
        vstore8(sum, 0, sums);
        return;
    }
    for (uint n = 0u; first + n < block_count; ++n) {
        float sum = 0.0f;
        for (uint row = part * FAR_PART; row < last; ++row) {
            const float value = values[(size_t)row * block_count + n];
            sum += (squares ? value * value : value) * y[row];
        }
        sums[n] = sum;
    }
}

/* The sum of parts, [part][count]. */
__kernel void sum_parts(SUM_PARTS_PARAMETERS)
{
    const size_t index = get_global_id(0);
    if (index >= count)
        return;
    float sum = 0.0f;
    for (uint part = 0u; part < part_count; ++part)
        sum += parts[(size_t)part * count + index];
    result[index] = sum;
}
