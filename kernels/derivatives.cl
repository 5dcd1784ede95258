/* The gradient of a cost by the radiance table (derivatives.h), and what is needed to make the table. */
#include "radiance_table.h"

typedef struct {
    float radiance, own_share; /* of walk/radiance.h */
    float total;
    RadianceTable table;
    float adjoint; /* derivative of the cost with respect to this path's radiance, scaled */
    volatile __global Accumulator *gradient;
    const __global float *change; /* of extinction, km^-1, [x][y][z] */
    float tangent;                /* derivative of the path's radiance along `change`, sr^-1 */
} Tally;

inline void tally_derivative(int index, int column, float derivative, bool is_first, Tally *tally)
{
    tally->tangent += derivative * tally->change[index];
    if (tally->adjoint != 0.0f)
        accumulate(tally->gradient + index, tally->adjoint * derivative);
}

#include "derivatives.h"

/* As replay_paths; adds to the table's sums what the paths bring, and nothing to the gradient where the
 * adjoint is 0. */
__kernel void gradient_paths(GRADIENT_PATHS_PARAMETERS)
{
    const size_t item = get_global_id(0);
    if (item >= path_count)
        return;
    const uint path = path_of_item((uint)item, pixel_count, path_count);
    const uint sample = first_sample + (uint)(path / pixel_count);
    const uint pixel_in_list = path % pixel_count;
    const float2 halves = adjoint[pixel_in_list];
    const uint2 pixel = pixels[pixel_in_list];
    const SampleKey key = {seed, stream, pixel.y, pixel.x, sample};
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    Tally tally = {0.0f,
                   1.0f,
                   path_radiance[path],
                   {column, cells, scattered, sunlight, table_sums},
                   sample & 1u ? halves.y : halves.x,
                   gradient,
                   change,
                   0.0f};
    walk_path(&medium, camera_ray(scene, views + pixel.x, rays, &key), &key, &tally);
    check_replay(tally.radiance, tally.total, astray);
    path_tangent[path] = tally.tangent;
}

/* Direct sunlight in the table's cells, the mean of 2 x 2 x 2 points of the Gauss-Legendre rule. */
__kernel void direct_sunlight(DIRECT_SUNLIGHT_PARAMETERS)
{
    const size_t cell = get_global_id(0);
    if (cell >= count)
        return;
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    const int layers = scene->shape[2], rows = scene->shape[1];
    const int column = cell_column[cell], index = voxel[column];
    const int3 at = (int3)(index / (layers * rows), index / layers % rows, index % layers);
    const uint3 parts = cells[column].yzw;
    const uint number = (uint)cell - cells[column].x;
    const uint3 part = (uint3)(number / (parts.y * parts.z), number / parts.z % parts.y, number % parts.z);
    float sum = 0.0f;
    for (int n = 0; n < 8; ++n) {
        Ray ray;
        const float3 side = (float3)(n & 1 ? 1.0f : -1.0f, n & 2 ? 1.0f : -1.0f, n & 4 ? 1.0f : -1.0f);
        const float3 within_part = 0.5f + 0.288675135f * side; /* 1 / sqrt(12) */
        ray.position = convert_float3(at) + (convert_float3(part) + within_part) / convert_float3(parts);
        ray.direction = sun_direction(scene);
        ray.voxel = at;
        ray.inside = true;
        sum += exp(-fly(&medium, &ray, INFINITY).depth);
    }
    sunlight[cell] = 0.125f * sum;
}
