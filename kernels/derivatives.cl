/* The gradient of a cost by the radiance table (derivatives.h), and the table's direct sunlight. */
#include "radiance_table.h"
#include "walk/accumulate.h"
#include "walk/event.h"
#include "walk/turns.h"

typedef struct {
    float radiance, own_share; /* of walk/radiance.h */
    float total;
    Branches branches;
    RadianceTable table;
    float adjoint; /* derivative of the cost with respect to this path's radiance, scaled */
    volatile __global Accumulator *gradient;
    const __global float *change; /* change of the extinction, km^-1, [x][y][z] */
    float tangent;                /* derivative of the path's radiance along `change`, sr^-1 */
} Tally;

inline void tally_derivative(int index, int column, float derivative, Tally *tally)
{
    tally->tangent += derivative * tally->change[index];
    if (tally->adjoint != 0.0f)
        accumulate(tally->gradient + index, tally->adjoint * derivative);
}

#include "derivatives.h"
#include "camera_rays.h"

/* Replays paths for the gradient and for each path's derivative along a change. Where the adjoint is 0 nothing is added
 * to the gradient. */
__kernel void gradient_paths(GRADIENT_PATHS_PARAMETERS)
{
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    TURNS(turn, path_count);
    uint path = 0u;
    KEPT_FOR_ITEM(SampleKey, key);
    KEPT_FOR_ITEM(Interaction, at);
    Tally tally;
    tally.table = make_table(TABLE_ARGUMENTS);
    tally.gradient = gradient;
    tally.change = change;
    BRANCHES(tally);
    for (bool walks = false; walks || next_turn(&turn);) {
        if (!walks) {
            path = path_of_item(turn.item, pixel_count, path_count);
            const uint sample = first_sample + path / pixel_count, pixel_in_list = path % pixel_count;
            const uint2 pixel = pixels[pixel_in_list];
            const SampleKey own = sample_key(seed, stream, pixel, sample);
            tally.radiance = 0.0f;
            tally.own_share = 1.0f;
            clear_branches(&tally.branches);
            tally.total = path_radiance[path];
            tally.adjoint = adjoint_of(adjoint, pixel_in_list, sample);
            tally.tangent = 0.0f;
            keep_key(key, &own);
            start_path(at, camera_ray(scene, views + pixel.x, rays, &own));
        }
        walks = walk_turn(&medium, at, key, &tally) || next_branch(at, key, &tally);
        if (!walks) {
            check_replay(tally.radiance, tally.total, astray);
            path_tangent[path] = tally.tangent;
        }
    }
}

/* The same for first flights, along the rays of each pixel's first `ray_count` samples in the launch; `weight`: number
 * of paths that each ray stands for. */
__kernel void gradient_rays(GRADIENT_RAYS_PARAMETERS)
{
    const size_t item = get_global_id(0);
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    KEPT_FOR_ITEM(SampleKey, key);
    if (item >= (size_t)pixel_count * ray_count)
        return;
    const uint pixel_in_list = (uint)item / ray_count, n = (uint)item % ray_count;
    const uint2 pixel = pixels[pixel_in_list];
    const SampleKey own = sample_key(seed, stream, pixel, first_sample + n);
    Tally tally;
    tally.table = make_table(TABLE_ARGUMENTS);
    tally.gradient = gradient;
    tally.change = change;
    tally.adjoint = weight * adjoint_of(adjoint, pixel_in_list, first_sample + n);
    tally.tangent = 0.0f;
    keep_key(key, &own);
    const Ray ray = camera_ray(scene, views + pixel.x, rays, &own);
    deposit_camera_ray(&medium, &tally.table, &ray, key, path_radiance[n * pixel_count + pixel_in_list], &tally);
    ray_tangent[n * pixel_count + pixel_in_list] = weight * tally.tangent;
}

/* Direct sunlight in the table's cells: the mean over 2 x 2 x 2 points of the Gauss-Legendre rule. */
__kernel void direct_sunlight(DIRECT_SUNLIGHT_PARAMETERS)
{
    const size_t cell = get_global_id(0);
    if (cell >= count)
        return;
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    const int layers = scene->shape[2], rows = scene->shape[1];
    const int column = cell_column[cell], index = voxel[column];
    const int3 at = (int3)(index / (layers * rows), index / layers % rows, index % layers);
    const uint3 parts = cells[column].yzw;
    const uint number = (uint)cell - cells[column].x;
    const uint3 part = (uint3)(number / (parts.y * parts.z), number / parts.z % parts.y, number % parts.z);
    const float rate = sunlight_rate(scene, extinction[index]);
    float sum = 0.0f, unit = 0.0f;
    for (int n = 0; n < 8; ++n) {
        Ray ray;
        const float3 side = (float3)(n & 1 ? 1.0f : -1.0f, n & 2 ? 1.0f : -1.0f, n & 4 ? 1.0f : -1.0f);
        const float3 within_part = 0.5f + 0.288675135f * side; /* 1 / sqrt(12) */
        ray.position = convert_float3(at) + (convert_float3(part) + within_part) / convert_float3(parts);
        ray.direction = sun_direction(scene);
        ray.voxel = at;
        ray.inside = true;
        const float way = scalar_product(ray.direction, (ray.position - convert_float3(at)) * grid_spacing(scene));
        unit += sunlight_at(rate, way);
        sum += exponential(-fly(&medium, &ray, INFINITY).depth);
    }
    sunlight[cell] = sum / unit;
}
