/* What conjugate gradients with a bound at 0 do with vectors (docs/explanation/solvers.md). Sums over a vector are made
 * by PARTS work items, of which each adds every PARTS-th number in order; the host adds the parts. */

/* x is free where it is off its bound, or is pulled off it. */
inline bool is_free(float x, float gradient) { return x > 0.0f || gradient < 0.0f; }

/* Where a step along the next direction comes to rest, bounds heeded: `change`, which has the last one before. What is
 * on its bound and is pushed against it was not moved off it by the last change, and stays. */
__kernel void next_change(NEXT_CHANGE_PARAMETERS)
{
    const uint index = get_global_id(0);
    if (index >= count)
        return;
    const float along = conjugation * change[index] - scale[index] * gradient[index];
    change[index] = fmax(x[index] + length * along, 0.0f) - x[index];
}

/* gradient . change, change . image, and how many times as far a change can go until it meets a bound. */
__kernel void sums_of_change(SUMS_OF_CHANGE_PARAMETERS)
{
    const uint part = get_global_id(0);
    if (part >= PARTS)
        return;
    float slopes = 0.0f, curvatures = 0.0f, least = INFINITY;
    for (uint index = part; index < count; index += PARTS) {
        const float own = change[index];
        slopes += gradient[index] * own;
        curvatures += own * image[index];
        if (own < 0.0f)
            least = fmin(least, x[index] / -own);
    }
    sums[part] = slopes;
    sums[PARTS + part] = curvatures;
    sums[2 * PARTS + part] = least;
}

/* x + length change, and its gradient, if that is linear. */
__kernel void take_step(TAKE_STEP_PARAMETERS)
{
    const uint index = get_global_id(0);
    if (index >= count)
        return;
    x[index] = fmax(x[index] + length * change[index], 0.0f);
    gradient[index] += length * image[index];
}

/* The scaled negative gradient of what is free, times the last change's image: how far it is from conjugate. */
__kernel void sums_of_gradient(SUMS_OF_GRADIENT_PARAMETERS)
{
    const uint part = get_global_id(0);
    if (part >= PARTS)
        return;
    float along = 0.0f;
    for (uint index = part; index < count; index += PARTS)
        if (is_free(x[index], gradient[index]))
            along -= scale[index] * gradient[index] * image[index];
    sums[part] = along;
}

/* result += factor x. */
__kernel void add_vector(ADD_VECTOR_PARAMETERS)
{
    const uint index = get_global_id(0);
    if (index < count)
        result[index] += factor * x[index];
}

/* A vector's numbers in a larger array, and back. */
__kernel void spread_values(SPREAD_VALUES_PARAMETERS)
{
    const uint index = get_global_id(0);
    if (index < count)
        values[place[index]] = factor * x[index];
}

__kernel void add_gathered(ADD_GATHERED_PARAMETERS)
{
    const uint index = get_global_id(0);
    if (index < count)
        result[index] += factor * values[place[index]];
}

/* x - start. */
__kernel void find_change(FIND_CHANGE_PARAMETERS)
{
    const uint index = get_global_id(0);
    if (index < count)
        result[index] = x[index] - start[index];
}

/* Adds a data term's slope: the transposed Jacobian's, and that of the damping. */
__kernel void add_damped(ADD_DAMPED_PARAMETERS)
{
    const uint index = get_global_id(0);
    if (index < count)
        result[index] += transposed[index] + stiffness[index] * change[index];
}

/* Of each part of a view's pixels the sums of residuals times the weighted basis, [part][basis]. */
__kernel void sum_basis(SUM_BASIS_PARAMETERS)
{
    const uint item = get_global_id(0), part = item / basis_count, n = item % basis_count;
    if (part >= part_count)
        return;
    float sum = 0.0f;
    for (uint place = part_start[part]; place < part_start[part + 1u]; ++place)
        sum += weighted_basis[(size_t)pixels[place] * basis_count + n] * residual[pixels[place]];
    sums[item] = sum;
}

/* What the views' gains and motions are fitted to be: a matrix times the sums over each view's parts, [view][basis]. */
__kernel void fit_views(FIT_VIEWS_PARAMETERS)
{
    const uint item = get_global_id(0);
    if (item >= view_count * basis_count)
        return;
    float found = 0.0f;
    for (uint other = 0u; other < view_count * basis_count; ++other) {
        const uint view = other / basis_count, n = other % basis_count;
        float sum = 0.0f;
        for (uint part = first_part[view]; part < first_part[view + 1u]; ++part)
            sum += sums[part * basis_count + n];
        found += matrix[item * view_count * basis_count + other] * sum;
    }
    fitted[item] = found;
}

/* Weighted residuals without what the views' gains and motions explain. */
__kernel void weigh_residual(WEIGH_RESIDUAL_PARAMETERS)
{
    const uint pixel = get_global_id(0);
    if (pixel >= pixel_count)
        return;
    float left = residual[pixel];
    for (uint n = 0u; n < basis_count; ++n)
        left -= basis[(size_t)pixel * basis_count + n] * fitted[view[pixel] * basis_count + n];
    result[pixel] = weights[pixel] * left;
}
