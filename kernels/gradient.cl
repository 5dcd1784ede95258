/* The gradient of a cost with respect to extinction: every path of a render is walked again
 * and deposits its share into the voxels it depends on. */
#define CLOUDTOMO_REPLAY
#include "path.h"

__kernel void replay_paths(__constant Scene *scene, const __global View *views,
                           const __global float *rays,
                           const __global uint2 *pixels,
                           const __global float *extinction, const __global float *table_row,
                           const __global uchar *clear, const __global float *profiles,
                           const uint pixel_count, const uint first_sample, const uint path_count,
                           const uint seed, const uint iteration,
                           const __global float *path_radiance, /* from render_paths, sr^-1 */
                           volatile __global uint *astray,      /* paths that bring something else now */
                           const __global float2 *adjoint,      /* per pixel: even, odd samples */
                           volatile __global Accumulator *gradient)
{
    const size_t item = get_global_id(0);
    if (item >= path_count)
        return;
    const uint path = path_of_item((uint)item, pixel_count, path_count);
    const uint sample = first_sample + (uint)(path / pixel_count);
    const uint pixel_in_list = path % pixel_count;
    const float2 halves = adjoint[pixel_in_list];
    Record record;
    record_begin(&record);
    record.total = path_radiance[path];
    record.adjoint = sample & 1u ? halves.y : halves.x;
    record.gradient = gradient;
    if (record.total == 0.0f || record.adjoint == 0.0f)
        return;
    const uint2 pixel = pixels[pixel_in_list];
    const SampleKey key = {seed, iteration, pixel.y, pixel.x, sample};
    const Medium medium = make_medium(scene, extinction, table_row, clear, profiles);
    trace_path(&medium, camera_ray(scene, views + pixel.x, rays, &key), &key, &record);
    check_replay(&record, astray);
}
