/* The operations on vectors for conjugate gradients with bounds, 0 <= x <= upper (docs/explanation/solvers.md). PARTS
 * work items make partial sums over a vector, each of every PARTS-th element in order; then one group adds these up to
 * LANES sums, whatever its size. */

/* The next step is tried AIM times as long as the last one should have been, so that bounds do not cut it short too
 * often; its length changes by LARGEST_CHANGE at most. */
#define AIM 1.3f
#define LARGEST_CHANGE 2.0f
/* The minimisation ends after this many poor steps in a row. */
#define PATIENCE 2

/* x is free if it is not on a bound, or if the negative gradient points away from the bound. */
inline bool is_free(float x, float upper, float gradient)
{
    return (x > 0.0f || gradient < 0.0f) && (x < upper || gradient > 0.0f);
}

/* One of LANES sums over the PARTS partial sums. */
inline float lane_of(const __global float *sums, uint lane)
{
    float sum = 0.0f;
    for (uint part = lane; part < PARTS; part += LANES)
        sum += sums[part];
    return sum;
}

/* The next change: a step along the next direction, projected onto the bounds. `change` has the last change before. An
 * element on its bound that is pushed against it stays: the last change did not move it off. The product is set to 0.
 */
__kernel void next_change(NEXT_CHANGE_PARAMETERS)
{
    const uint index = get_global_id(0);
    if (index >= count)
        return;
    const float along = state->conjugation * change[index] - inverse_diagonal[index] * gradient[index];
    change[index] = clamp(x[index] + state->length * along, 0.0f, upper[index]) - x[index];
    product[index] = 0.0f;
}

/* Partial sums of gradient . change and change . Hessian change, and the largest factor of the change within bounds. */
__kernel void sums_of_change(SUMS_OF_CHANGE_PARAMETERS)
{
    const uint part = get_global_id(0);
    if (part >= PARTS)
        return;
    float slopes = 0.0f, curvatures = 0.0f, least = INFINITY;
    for (uint index = part; index < count; index += PARTS) {
        const float moved = change[index];
        slopes += gradient[index] * moved;
        curvatures += moved * hessian_change[index];
        if (moved < 0.0f)
            least = fmin(least, x[index] / -moved);
        else if (moved > 0.0f)
            least = fmin(least, (upper[index] - x[index]) / moved);
    }
    sums[part] = slopes;
    sums[PARTS + part] = curvatures;
    sums[2 * PARTS + part] = least;
}

/* Chooses the factor with which a change is taken, and the length of the next step. A change along which the function
 * rises is not taken: the next direction is the gradient's alone. If it already was that, or if the function has no
 * minimum along the change, the minimisation ends. */
inline void choose(__global Minimisation *state, float slope, float curvature, float farthest, float longest,
                   int most_steps, float tolerance)
{
    const float best = curvature > 0.0f ? -slope / curvature : INFINITY;
    const float taken = fmin(fmin(best, farthest), longest);
    const bool leads_up = slope >= 0.0f && state->conjugation > 0.0f;
    state->conjugation = 0.0f;
    state->curvature = curvature;
    state->taken = 0.0f;
    if (leads_up)
        return;
    if (!(slope < 0.0f && taken < INFINITY)) {
        state->ended = 1;
        return;
    }
    const float gain = -taken * (slope + 0.5f * taken * curvature);
    state->taken = taken;
    state->gained += gain;
    state->steps += 1;
    state->poor = gain <= tolerance * state->gained ? state->poor + 1 : 0;
    state->ended = state->poor == PATIENCE || state->steps == most_steps;
    state->length *= fmin(fmax(AIM * best, 1.0f / LARGEST_CHANGE), LARGEST_CHANGE);
}

__kernel void choose_step(CHOOSE_STEP_PARAMETERS)
{
    __local float slopes[LANES], curvatures[LANES], leasts[LANES];
    for (uint lane = get_local_id(0); lane < LANES; lane += get_local_size(0)) {
        slopes[lane] = lane_of(sums, lane);
        curvatures[lane] = lane_of(sums + PARTS, lane);
        float least = INFINITY;
        for (uint part = lane; part < PARTS; part += LANES)
            least = fmin(least, sums[2 * PARTS + part]);
        leasts[lane] = least;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (get_global_id(0) != 0)
        return;
    float slope = 0.0f, curvature = 0.0f, farthest = INFINITY;
    for (uint lane = 0u; lane < LANES; ++lane) {
        slope += slopes[lane];
        curvature += curvatures[lane];
        farthest = fmin(farthest, leasts[lane]);
    }
    if (state->ended)
        state->taken = 0.0f;
    else
        choose(state, slope, curvature, farthest, longest, most_steps, tolerance);
}

/* Adds the chosen multiple of the change to x, and of its product with the Hessian to the gradient. */
__kernel void take_step(TAKE_STEP_PARAMETERS)
{
    const uint index = get_global_id(0);
    const float taken = state->taken;
    if (index >= count || !(taken > 0.0f))
        return;
    x[index] = clamp(x[index] + taken * change[index], 0.0f, upper[index]);
    gradient[index] += taken * hessian_change[index];
}

/* Partial sums of the scaled negative gradient of free elements, times the Hessian's product with the last change: 0 if
 * both are conjugate. */
__kernel void sums_of_gradient(SUMS_OF_GRADIENT_PARAMETERS)
{
    const uint part = get_global_id(0);
    if (part >= PARTS)
        return;
    float along = 0.0f;
    for (uint index = part; index < count; index += PARTS)
        if (is_free(x[index], upper[index], gradient[index]))
            along -= inverse_diagonal[index] * gradient[index] * hessian_change[index];
    sums[part] = along;
}

/* The factor of the last change that makes the next direction conjugate to it. */
__kernel void choose_conjugation(CHOOSE_CONJUGATION_PARAMETERS)
{
    __local float lanes[LANES];
    for (uint lane = get_local_id(0); lane < LANES; lane += get_local_size(0))
        lanes[lane] = lane_of(sums, lane);
    barrier(CLK_LOCAL_MEM_FENCE);
    if (get_global_id(0) != 0)
        return;
    float along = 0.0f;
    for (uint lane = 0u; lane < LANES; ++lane)
        along += lanes[lane];
    if (state->taken > 0.0f && state->curvature > 0.0f)
        state->conjugation = fmax(-along / state->curvature, 0.0f);
}

/* result += factor x. */
__kernel void add_vector(ADD_VECTOR_PARAMETERS)
{
    const uint index = get_global_id(0);
    if (index < count)
        result[index] += factor * x[index];
}

/* Writes a vector's elements to their places in a larger array; and below, adds them back from there. */
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

/* Adds a data term's gradient: the transposed Jacobian's product and the damping's gradient. */
__kernel void add_damped(ADD_DAMPED_PARAMETERS)
{
    const uint index = get_global_id(0);
    if (index < count)
        result[index] += transposed[index] + damping[index] * change[index];
}

/* Sums over each part of a view's pixels of residuals times the weighted basis, [part][basis]. */
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

/* The fitted gains and motions of the views, [view][basis]: a matrix times the sums over each view's parts. */
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
