/* Products with a Jacobian in two parts: the near field by rows (CSR) and by columns (its transpose, an index into the
 * rows), and the far field by blocks. NUMBERS is float, or float8 for as many vectors at once. Every sum is one work
 * item's, in the order of its entries. */

/* near x + far x. */
__kernel void jacobian_times(JACOBIAN_TIMES_PARAMETERS)
{
    const size_t row = get_global_id(0);
    if (row >= pixel_count)
        return;
    NUMBERS sum = 0.0f;
    for (uint entry = row_start[row]; entry < row_start[row + 1]; ++entry)
        sum += values[entry] * x[columns[entry]];
    result[row] = sum + of_blocks[pixel_block[row]];
}

/* near^T y + far^T y; of squares, the diagonal of J^T diag(y) J. */
__kernel void jacobian_transposed(JACOBIAN_TRANSPOSED_PARAMETERS)
{
    const size_t voxel = get_global_id(0);
    if (voxel >= voxel_count)
        return;
    NUMBERS sum = 0.0f;
    for (uint place = column_start[voxel]; place < column_start[voxel + 1]; ++place) {
        const float value = values[entries[place]];
        sum += (squares ? value * value : value) * y[rows[place]];
    }
    result[voxel] = sum + of_blocks[block[voxel]];
}

/* Sums of a vector's numbers over the members of each block. */
__kernel void sum_members(SUM_MEMBERS_PARAMETERS)
{
    const size_t index = get_global_id(0);
    if (index >= block_count)
        return;
    NUMBERS sum = 0.0f;
    for (uint place = member_start[index]; place < member_start[index + 1]; ++place)
        sum += x[members[place]];
    result[index] = sum;
}

__kernel void far_times(FAR_TIMES_PARAMETERS)
{
    const size_t row = get_global_id(0);
    if (row >= pixel_block_count)
        return;
    NUMBERS sum = 0.0f;
    for (uint n = 0u; n < block_count; ++n)
        sum += far[row * block_count + n] * x[n];
    result[row] = sum;
}

__kernel void far_transposed(FAR_TRANSPOSED_PARAMETERS)
{
    const size_t n = get_global_id(0);
    if (n >= block_count)
        return;
    NUMBERS sum = 0.0f;
    for (uint row = 0u; row < pixel_block_count; ++row) {
        const float value = far[(size_t)row * block_count + n];
        sum += (squares ? value * value : value) * y[row];
    }
    result[n] = sum;
}
