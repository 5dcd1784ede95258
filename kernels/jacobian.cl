/* The derivatives of every pixel with respect to every voxel, by the radiance table (derivatives.h): for voxels near
 * the pixel's line of sight one by one, for the others by blocks of pixels and voxels. */
#include "near_field.h"
#include "radiance_table.h"
#include "walk/accumulate.h"
#include "walk/event.h"
#include "walk/turns.h"

typedef struct {
    float radiance, own_share; /* of walk/radiance.h */
    float total;
    Branches branches;
    RadianceTable table;
    float weight; /* factor of a derivative: number of paths that it stands for */
    const __constant Scene *scene;
    const __global Tile *tile;
    const __global ushort4 *place;       /* [column]: voxel */
    const __global int *block;           /* [column]: block of voxels */
    volatile __global Accumulator *near; /* [slot] of the pixel: DERIVATIVE_UNIT units per sr^-1 km */
    volatile __global Accumulator *far;  /* [block] of the pixel's block, same units */
} Tally;

inline void tally_derivative(int index, int column, float derivative, Tally *tally)
{
    const int slot = tile_slot(tally->scene, tally->tile, convert_int3(tally->place[column].xyz));
    volatile __global Accumulator *sum = slot >= 0 ? tally->near + slot : tally->far + tally->block[column];
    accumulate(sum, DERIVATIVE_UNIT * tally->weight * derivative);
}

#include "derivatives.h"
#include "camera_rays.h"

/* Sums for first flights, along the rays of each pixel's first `ray_count` samples in the launch; `weight`: number of
 * paths that each ray stands for. */
__kernel void jacobian_rays(JACOBIAN_RAYS_PARAMETERS)
{
    const size_t item = get_global_id(0);
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    KEPT_FOR_ITEM(SampleKey, key);
    if (item >= (size_t)row_count * ray_count)
        return;
    Tally tally;
    tally.table = make_table(TABLE_ARGUMENTS);
    tally.scene = scene;
    tally.place = place;
    tally.block = block;
    tally.weight = weight;
    const uint pixel_in_list = first_pixel + (uint)item / ray_count, n = (uint)item % ray_count;
    const uint2 pixel = pixels[pixel_in_list];
    const SampleKey own = sample_key(seed, stream, pixel, first_sample + n);
    tally.tile = tiles + pixel_in_list;
    tally.near = near_sums + (slot_start[pixel_in_list] - slot_start[first_pixel]);
    tally.far = far_sums + (size_t)pixel_block[pixel_in_list] * block_count;
    keep_key(key, &own);
    const Ray ray = camera_ray(scene, views + pixel.x, rays, &own);
    deposit_camera_ray(&medium, &tally.table, &ray, key, path_radiance[n * pixel_count + pixel_in_list], &tally);
}

/* Sums over all paths of a launch, for the pixels from first_pixel on; without the first flights. */
__kernel void jacobian_paths(JACOBIAN_PATHS_PARAMETERS)
{
    const uint samples = path_count / pixel_count;
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    TURNS(turn, row_count * samples);
    KEPT_FOR_ITEM(SampleKey, key);
    KEPT_FOR_ITEM(Interaction, at);
    Tally tally;
    tally.table = make_table(TABLE_ARGUMENTS);
    tally.scene = scene;
    tally.place = place;
    tally.block = block;
    tally.weight = 1.0f;
    BRANCHES(tally);
    for (bool walks = false; walks || next_turn(&turn);) {
        if (!walks) {
            /* Neighbours in a work group replay paths of the same pixel, which go through the same voxels. */
            const uint pixel_in_list = first_pixel + turn.item / samples, n = turn.item % samples;
            const uint2 pixel = pixels[pixel_in_list];
            const SampleKey own = sample_key(seed, stream, pixel, first_sample + n);
            tally.radiance = 0.0f;
            tally.own_share = 1.0f;
            clear_branches(&tally.branches);
            tally.total = path_radiance[n * pixel_count + pixel_in_list];
            tally.tile = tiles + pixel_in_list;
            tally.near = near_sums + (slot_start[pixel_in_list] - slot_start[first_pixel]);
            tally.far = far_sums + (size_t)pixel_block[pixel_in_list] * block_count;
            keep_key(key, &own);
            start_path(at, camera_ray(scene, views + pixel.x, rays, &own));
        }
        walks = walk_turn(&medium, at, key, &tally) || next_branch(at, key, &tally);
        if (!walks)
            check_replay(tally.radiance, tally.total, astray);
    }
}
