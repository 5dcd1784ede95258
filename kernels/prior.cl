/* The priors of the supplement's Eqs. 20-23, each with its exact gradient (the printed Eq. 23
 * lacks the transpose on Dz; see docs/explanation/derivatives.md). One work item per voxel; the gradient is
 * gathered, not scattered: no atomics. Extinction in km^-1, arrays [x][y][z], z fastest. */

inline int3 voxel_of(int index, int3 shape)
{
    return (int3)(index / (shape.y * shape.z), (index / shape.z) % shape.y, index % shape.z);
}

inline int index_of(int3 voxel, int3 shape) { return (voxel.x * shape.y + voxel.y) * shape.z + voxel.z; }

/* A: mean of the 26 neighbours minus the centre; beyond the edge the nearest voxel is repeated.
 * A is symmetric, the edges included: A^T A b is this kernel twice. */
__kernel void laplacian(LAPLACIAN_PARAMETERS)
{
    const int index = get_global_id(0);
    if (index >= shape.x * shape.y * shape.z)
        return;
    const int3 voxel = voxel_of(index, shape);
    float sum = 0.0f;
    for (int i = -1; i <= 1; ++i)
        for (int j = -1; j <= 1; ++j)
            for (int k = -1; k <= 1; ++k)
                sum += extinction[index_of(clamp(voxel + (int3)(i, j, k), (int3)(0), shape - 1), shape)];
    result[index] = (sum - 27.0f * extinction[index]) / 26.0f;
}

/* Dz: central differences along z in units of voxels, one-sided at the ends. */
inline float difference_z(const __global float *extinction, int index, int z, int count)
{
    const int above = min(z + 1, count - 1), below = max(z - 1, 0);
    return above == below ? 0.0f
                          : (extinction[index + above - z] - extinction[index + below - z]) / (float)(above - below);
}

/* Per voxel: minus tanh(c1 Dz b) tanh(c2 b) where b > threshold, and the factors that
 * multiply Dz^T (outer) and the identity (inner) in the gradient. */
__kernel void monotonicity_terms(MONOTONICITY_TERMS_PARAMETERS)
{
    const int index = get_global_id(0);
    if (index >= shape.x * shape.y * shape.z)
        return;
    const float rise = tanh(c1 * difference_z(extinction, index, index % shape.z, shape.z));
    const float presence = tanh(c2 * extinction[index]);
    const bool counts = extinction[index] > threshold;
    value[index] = counts ? -rise * presence : 0.0f;
    outer[index] = counts ? -c1 * (1.0f - rise * rise) * presence : 0.0f;
    inner[index] = counts ? -c2 * rise * (1.0f - presence * presence) : 0.0f;
}

/* gradient = smoothness * A^T A b + monotonicity * (Dz^T outer + inner) + sparsity * scale / (b + scale)^2. */
__kernel void prior_gradient(PRIOR_GRADIENT_PARAMETERS)
{
    const int index = get_global_id(0);
    if (index >= shape.x * shape.y * shape.z)
        return;
    const int count = shape.z, z = index % count;
    float transposed = 0.0f; /* Dz^T: every row u of Dz that has an entry in column z */
    for (int u = max(z - 1, 0); u <= min(z + 1, count - 1); ++u) {
        const int above = min(u + 1, count - 1), below = max(u - 1, 0);
        if (above != below)
            transposed += outer[index + u - z] * (float)((above == z) - (below == z)) / (float)(above - below);
    }
    gradient[index] =
        smoothness * smooth[index] + monotonicity * (transposed + inner[index])
        + sparsity * sparsity_scale / ((extinction[index] + sparsity_scale) * (extinction[index] + sparsity_scale));
}
