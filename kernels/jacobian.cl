/* The derivatives of every pixel with respect to every voxel, by the radiance table (derivatives.h): near its line of
 * sight one by one, elsewhere by blocks of pixels and voxels. */
#include "near_field.h"
#include "radiance_table.h"

typedef struct {
    float radiance, own_share; /* of walk/radiance.h */
    float total;
    RadianceTable table;
    const __constant Scene *scene;
    const __global Tile *tile;
    const __global ushort4 *place;       /* of every column: voxel */
    const __global int *block;           /* of every column */
    volatile __global Accumulator *near; /* [slot]: the pixel's, units of DERIVATIVE_UNIT per sr^-1 km */
    volatile __global Accumulator *far;  /* [block]: the pixel block's */
} Tally;

inline void tally_derivative(int index, int column, float derivative, bool is_first, Tally *tally)
{
    const int slot = tile_slot(tally->scene, tally->tile, convert_int3(tally->place[column].xyz));
    volatile __global Accumulator *sum = slot >= 0 ? tally->near + slot : tally->far + tally->block[column];
    accumulate(sum, DERIVATIVE_UNIT * derivative);
}

#include "derivatives.h"

/* Sums over all paths of a launch of the pixels from first_pixel on. The paths go into the table's sums, too. */
__kernel void jacobian_paths(JACOBIAN_PATHS_PARAMETERS)
{
    const size_t item = get_global_id(0);
    const uint samples = path_count / pixel_count;
    if (item >= (size_t)row_count * samples)
        return;
    /* Neighbours in a work group replay paths of the same pixel, which go through the same voxels. */
    const uint pixel_in_list = first_pixel + (uint)(item / samples), n = (uint)(item % samples);
    const uint path = n * pixel_count + pixel_in_list;
    const uint2 pixel = pixels[pixel_in_list];
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    const SampleKey key = {seed, stream, pixel.y, pixel.x, first_sample + n};
    Tally tally = {0.0f,
                   1.0f,
                   path_radiance[path],
                   {column, cells, scattered, sunlight, table_sums},
                   scene,
                   tiles + pixel_in_list,
                   place,
                   block,
                   near_sums + (slot_start[pixel_in_list] - slot_start[first_pixel]),
                   far_sums + (size_t)pixel_block[pixel_in_list] * block_count};
    walk_path(&medium, camera_ray(scene, views + pixel.x, rays, &key), &key, &tally);
    check_replay(tally.radiance, tally.total, astray);
}
