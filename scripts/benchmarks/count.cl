/* The walk of render_paths, for its counts alone: see scripts/divergence.py. */
#define CLOUDTOMO_EVENTS_COUNTED 128
#include "path.h"

__kernel void count_paths(__constant Scene *scene, const __global View *views, const __global float *rays,
                          const __global uint2 *pixels, const __global float *extinction,
                          const __global float *table_row, const __global uchar *clear,
                          const __global float *profiles, const uint pixel_count, const uint first_sample,
                          const uint path_count, const uint seed, const uint iteration,
                          volatile __global Accumulator *account, __global ushort *crossings, __global uint *events)
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
    record.crossings = crossings + (size_t)path * CLOUDTOMO_EVENTS_COUNTED;
    trace_path(&medium, camera_ray(scene, views + pixel.x, rays, &key), &key, &record);
    events[path] = record.event;
}
