/* Paths from virtual collisions, for sums over blocks of pixels and voxels (virtual.h). */
#include "block_target.h"
#include "virtual.h"

__kernel void virtual_blocks(VIRTUAL_BLOCKS_PARAMETERS)
{
    const size_t item = get_global_id(0);
    if (item >= count)
        return;
    const __global VirtualCollision *from = virtual_collisions + item;
    const uint sample = first_sample + from->path / pixel_count;
    const uint pixel_in_list = from->path % pixel_count;
    const uint2 pixel = pixels[pixel_in_list];
    const SampleKey key = {seed, stream, pixel.y, pixel.x + VIRTUAL_PATHS_VIEW, sample};
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    const Target target = {
        far_sums + (size_t)pixel_block[pixel_in_list] * block_count, column, block
    };
    int index;
    const float derivative = virtual_derivative(&medium, from, &key, virtual_extinction, &index);
    if (derivative != 0.0f)
        deposit(&target, index, derivative);
}
