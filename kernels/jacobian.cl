/* The derivatives of every pixel with respect to every voxel, by the radiance table (derivatives.h). */
#include "radiance_table.h"

typedef struct {
    float radiance, own_share; /* of walk/radiance.h */
    float total;
    RadianceTable table;
    /* [column]: the pixel's derivatives, by its paths' first flights and by all that follows, sr^-1 km */
    __global float *first_row, *later_row;
} Tally;

inline void tally_derivative(int index, int column, float derivative, bool is_first, Tally *tally)
{
    (is_first ? tally->first_row : tally->later_row)[column] += derivative;
}

#include "derivatives.h"

/* Rows of the Jacobian, for pixels from first_pixel on: sums over samples `begin` to `end` of a
 * launch, apart for the paths' first flights and for all that follows. One work item replays all these
 * paths of its pixel, so that its row needs no atomics. The paths go into the table's sums, too. */
__kernel void jacobian_rows(JACOBIAN_ROWS_PARAMETERS)
{
    const size_t row = get_global_id(0);
    if (row >= row_count)
        return;
    const uint pixel_in_list = first_pixel + (uint)row;
    const uint2 pixel = pixels[pixel_in_list];
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    for (uint n = begin; n < end; ++n) {
        const uint path = n * pixel_count + pixel_in_list;
        const SampleKey key = {seed, stream, pixel.y, pixel.x, first_sample + n};
        Tally tally = {
            0.0f, 1.0f, path_radiance[path], {column, scattered, sunlight, table_sums},
            first_rows + row * column_count, later_rows + row * column_count
        };
        walk_path(&medium, camera_ray(scene, views + pixel.x, rays, &key), &key, &tally);
        check_replay(tally.radiance, tally.total, astray);
    }
}
