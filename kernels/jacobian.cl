/* The derivatives of every pixel with respect to every voxel, by the field of radiance (field.cl). */
#define CLOUDTOMO_JACOBIAN
#include "field.cl"

/* Rows of the Jacobian, for pixels from first_pixel on: sums over samples `begin` to `end` of a
 * launch, apart for the paths' first flights and for all that follows. One work item walks all these
 * paths of its pixel, so that its row needs no atomics. The paths go into the field, too. */
__kernel void jacobian_rows(__constant Scene *scene, const __global View *views,
                            const __global float *rays, const __global uint2 *pixels,
                            const __global float *extinction, const __global float *table_row,
                            const __global uchar *clear, const __global float *profiles,
                            const uint pixel_count, const uint first_sample, const uint path_count,
                            const uint seed, const uint iteration,
                            const __global float *path_radiance, /* from render_paths, sr^-1 */
                            volatile __global uint *astray,      /* as of replay_paths */
                            const uint begin, const uint end,
                            const __global int *column,          /* of every voxel in the field, or -1 */
                            const __global float *scattered,     /* [column][bin]: source - radiance, sr^-1 */
                            const __global float *sunlight,      /* [column]: direct, share of the irradiance */
                            volatile __global Accumulator *field /* [column][bin][2]: km, sr^-1 km */,
                            const uint first_pixel, const uint row_count, const uint column_count,
                            __global float *first_rows /* [row][column]: sr^-1 km */,
                            __global float *later_rows)
{
    const size_t row = get_global_id(0);
    if (row >= row_count)
        return;
    const uint pixel_in_list = first_pixel + (uint)row;
    const uint2 pixel = pixels[pixel_in_list];
    const Medium medium = make_medium(scene, extinction, table_row, clear, profiles);
    for (uint n = begin; n < end; ++n) {
        const uint path = n * pixel_count + pixel_in_list;
        const SampleKey key = {seed, iteration, pixel.y, pixel.x, first_sample + n};
        Record record;
        record_begin(&record);
        record.total = path_radiance[path];
        record.column = column;
        record.scattered = scattered;
        record.sunlight = sunlight;
        record.field = field;
        record.first_row = first_rows + row * column_count;
        record.later_row = later_rows + row * column_count;
        trace_path(&medium, camera_ray(scene, views + pixel.x, rays, &key), &key, &record);
        check_replay(&record, astray);
    }
}
