/* The gradient of a cost by the field of radiance: no collisions, no 1 / extinction.
 *
 * A little more of droplets at a point takes from the light that passes there, and scatters into its
 * direction what comes from elsewhere. So along every flight of a path of weight w, a crossing of
 * l km in direction d adds w l (source(d) - radiance(d)) to the derivative of the pixel, with the
 * source function that droplets there would have, and the way to the sun adds -l times the local
 * estimate. Source and radiance come from a table by voxel and direction, which the paths of all
 * pixels fill. It is this pooling that takes the noise out; the table's cells are what biases it
 * (docs/explanation/derivatives.md). */
#define CLOUDTOMO_FIELD
#include "path.h"

/* As replay_paths; adds to the field what the paths bring, and nothing to the gradient where the
 * adjoint is 0. */
__kernel void field_paths(__constant Scene *scene, const __global View *views,
                          const __global float *rays, const __global uint2 *pixels,
                          const __global float *extinction, const __global float *table_row,
                          const __global uchar *clear, const __global float *profiles,
                          const uint pixel_count, const uint first_sample, const uint path_count,
                          const uint seed, const uint iteration,
                          const __global float *path_radiance, /* from render_paths, sr^-1 */
                          volatile __global uint *astray,      /* as of replay_paths */
                          const __global float2 *adjoint,      /* per pixel: even, odd samples */
                          const __global int *column,          /* of every voxel in the field, or -1 */
                          const __global float *scattered,     /* [column][bin]: source - radiance, sr^-1 */
                          const __global float *sunlight,      /* [column]: direct, share of the irradiance */
                          const __global float *change,        /* of extinction, km^-1, [x][y][z] */
                          volatile __global Accumulator *gradient,
                          __global float *path_tangent,        /* each path's derivative along change, sr^-1 */
                          volatile __global Accumulator *field /* [column][bin][2]: km, sr^-1 km */)
{
    const size_t item = get_global_id(0);
    if (item >= path_count)
        return;
    const uint path = path_of_item((uint)item, pixel_count, path_count);
    const uint sample = first_sample + (uint)(path / pixel_count);
    const uint pixel_in_list = path % pixel_count;
    const float2 halves = adjoint[pixel_in_list];
    const uint2 pixel = pixels[pixel_in_list];
    const SampleKey key = {seed, iteration, pixel.y, pixel.x, sample};
    const Medium medium = make_medium(scene, extinction, table_row, clear, profiles);
    Record record;
    record_begin(&record);
    record.total = path_radiance[path];
    record.adjoint = sample & 1u ? halves.y : halves.x;
    record.gradient = gradient;
    record.column = column;
    record.scattered = scattered;
    record.sunlight = sunlight;
    record.field = field;
    record.change = change;
    record.tangent = 0.0f;
    trace_path(&medium, camera_ray(scene, views + pixel.x, rays, &key), &key, &record);
    check_replay(&record, astray);
    path_tangent[path] = record.tangent;
}

/* Direct sunlight in the field's voxels, the mean of 2 x 2 x 2 points of the Gauss-Legendre rule. */
__kernel void direct_sunlight(__constant Scene *scene,
                              const __global float *extinction, const __global float *table_row,
                              const __global uchar *clear, const __global float *profiles,
                              const __global int *voxel, const uint count, __global float *sunlight)
{
    const size_t index = get_global_id(0);
    if (index >= count)
        return;
    const Medium medium = make_medium(scene, extinction, table_row, clear, profiles);
    const int layers = scene->shape[2], rows = scene->shape[1];
    const int3 at = (int3)(voxel[index] / (layers * rows), voxel[index] / layers % rows, voxel[index] % layers);
    Record record;
    record_begin(&record);
    float sum = 0.0f;
    for (int n = 0; n < 8; ++n) {
        Ray ray;
        const float3 side = (float3)(n & 1 ? 1.0f : -1.0f, n & 2 ? 1.0f : -1.0f, n & 4 ? 1.0f : -1.0f);
        ray.position = convert_float3(at) + 0.5f + 0.288675135f * side; /* 1 / sqrt(12) */
        ray.direction = sun_direction(scene);
        ray.voxel = at;
        ray.inside = true;
        sum += exp(-fly(&medium, &ray, INFINITY, nothing_carried(), &record).depth);
    }
    sunlight[index] = 0.125f * sum;
}
