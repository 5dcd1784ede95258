/* Radiances: every work item walks one path; then every pixel sums its paths in order. */
#include "path.h"

/* Path `sample_in_launch * pixel_count + pixel`: its radiance, for a sun of irradiance 1. */
__kernel void render_paths(__constant Scene *scene, const __global View *views,
                           const __global float *rays,   /* of the views that are lists of rays */
                           const __global uint2 *pixels, /* (view, pixel) to render */
                           const __global float *extinction, const __global float *table_row,
                           const __global uchar *clear, const __global float *profiles,
                           const uint pixel_count, const uint first_sample, const uint path_count,
                           const uint seed, const uint iteration,
                           __global float *path_radiance, /* sr^-1 */
                           volatile __global Accumulator *account)
{
    const size_t item = get_global_id(0);
    if (item >= path_count)
        return;
    const uint path = path_of_item((uint)item, pixel_count, path_count);
    const uint2 pixel = pixels[path % pixel_count];
    const SampleKey key = {seed, iteration, pixel.y, pixel.x, first_sample + (uint)(path / pixel_count)};
    const Medium medium = make_medium(scene, extinction, table_row, clear, profiles);
    Record record;
    record_begin(&record);
    record.account = account;
    trace_path(&medium, camera_ray(scene, views + pixel.x, rays, &key), &key, &record);
    path_radiance[path] = record.radiance;
}

/* Adds paths of a launch, samples `begin` to `end` of it, to the pixels' sums, even and odd samples
 * apart. Each pixel is summed by one work item in the order of its samples: the same bits however
 * launches are cut. */
__kernel void sum_paths(const __global float *path_radiance, const uint pixel_count,
                        const uint first_sample, const uint begin, const uint end,
                        __global PixelSums *sums)
{
    const size_t pixel = get_global_id(0);
    if (pixel >= pixel_count)
        return;
    PixelSums s = sums[pixel];
    for (uint n = begin; n < end; ++n) {
        const float radiance = path_radiance[(size_t)n * pixel_count + pixel];
        const uint half_index = (first_sample + n) & 1u;
        add_compensated(&s.half_sum[half_index], &s.half_low[half_index], radiance);
        add_compensated(&s.square_sum, &s.square_low, radiance * radiance);
    }
    sums[pixel] = s;
}
