/* Steps of stochastic descent. The parameter is the extinction, or its square root; voxels
 * outside of the mask stay 0, those inside stay at or above the floor (km^-1). */

/* Descends by `change` in the parameter, and writes the projected extinction. */
inline void descend(__global float *extinction, const __global uchar *mask, size_t voxel, float change, int square_root,
                    float floor_extinction)
{
    if (!mask[voxel]) {
        extinction[voxel] = 0.0f;
    } else if (square_root) {
        const float root = fmax(sqrt(extinction[voxel]) - change, sqrt(floor_extinction));
        extinction[voxel] = root * root;
    } else {
        extinction[voxel] = fmax(extinction[voxel] - change, floor_extinction);
    }
}

/* d cost / d parameter from d cost / d extinction. */
inline float chain(const __global float *extinction, float gradient, size_t voxel, int square_root)
{
    return square_root ? 2.0f * sqrt(extinction[voxel]) * gradient : gradient;
}

__kernel void sgd_step(SGD_STEP_PARAMETERS)
{
    const size_t voxel = get_global_id(0);
    if (voxel >= voxel_count)
        return;
    const float slope = chain(extinction, gradient[voxel], voxel, square_root);
    descend(extinction, mask, voxel, step * slope, square_root, floor_extinction);
}

/* Kingma and Ba 2015, Algorithm 1; the bias corrections of the moments are
 * first_correction = 1 / (1 - beta1^t) and second_correction = 1 / (1 - beta2^t). */
__kernel void adam_step(ADAM_STEP_PARAMETERS)
{
    const size_t voxel = get_global_id(0);
    if (voxel >= voxel_count)
        return;
    const float slope = chain(extinction, gradient[voxel], voxel, square_root);
    const float first = beta1 * first_moment[voxel] + (1.0f - beta1) * slope;
    const float second = beta2 * second_moment[voxel] + (1.0f - beta2) * slope * slope;
    first_moment[voxel] = first;
    second_moment[voxel] = second;
    const float size = sqrt(second * second_correction);
    const float change = size > 0.0f ? step * first * first_correction / size : 0.0f;
    descend(extinction, mask, voxel, change, square_root, floor_extinction);
}
