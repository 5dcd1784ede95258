/* Derivatives summed over blocks of pixels and voxels, by replay (replay.h). */
#include "block_target.h"
#include "replay.h"

/* The launch may be a part of the paths: its global offset is the first. */
__kernel void replay_blocks(REPLAY_BLOCKS_PARAMETERS)
{
    const size_t item = get_global_id(0);
    if (item >= path_count)
        return;
    const uint path = path_of_item((uint)item, pixel_count, path_count);
    const uint sample = first_sample + (uint)(path / pixel_count);
    const uint pixel_in_list = path % pixel_count;
    const uint2 pixel = pixels[pixel_in_list];
    const Target target = {
        far_sums + (size_t)pixel_block[pixel_in_list] * block_count, column, block
    };
    const SampleKey key = {seed, stream, pixel.y, pixel.x, sample};
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    Tally tally = replay_begins(
        target, path, path_radiance[path], &key, virtual_extinction, virtual_collisions, virtual_collision_count
    );
    walk_path(&medium, camera_ray(scene, views + pixel.x, rays, &key), &key, &tally);
    replay_ends(&tally, astray);
}
