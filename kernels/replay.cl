/* The gradient of a cost with respect to extinction: every path of a rendering is replayed, and adds its
 * part to the voxels on which it depends. A crossing of voxel v over l km on the way to radiance R adds -l R, a
 * collision with a droplet there adds R / extinction (the supplement's Eqs. 13, 17, 18 with sums swapped; path
 * replay, Vicini et al. 2021).
 *
 * Where the extinction is small this is noisy, and where it is 0 nothing collides. So there are virtual droplets, too,
 * with the extinction `virtual_extinction` (km^-1). Paths pass them, but where a path meets one, another path begins,
 * which scatters there as if the droplet were real. Its radiance (virtual.cl), and that of collisions with real
 * droplets, is divided by the sum of both extinctions. The mean is the derivative for every virtual extinction, if
 * that sum is above 0. */
#include "walk/accumulate.h"
#include "walk/estimate.h"
#include "walk/event.h"
#include "walk/replayed.h"
#include "walk/turns.h"

/* The part of a replayed path's state that is seldom needed. */
typedef struct {
    SampleKey key;           /* key of the virtual collisions' random numbers */
    uint virtual_collisions; /* number of virtual collisions so far */
    uint place;              /* place, in the list, of the one that is kept */
    uint path;               /* number of the path in its launch */
    float total;             /* radiance of the whole path, sr^-1 */
    float throughput, share; /* of the present flight: another path would begin with them */
    uint event;              /* number of the present flight */
    int aside;               /* whether it is a side flight */
} Replayed;

typedef struct {
    float radiance, own_share; /* of radiance.h */
    float adjoint;             /* derivative of the cost with respect to this path's radiance, scaled */
    float remaining;           /* the adjoint payload of the path's flight: radiance that depends on it, sr^-1 */
    float virtual_depth;       /* optical depth of virtual droplets until the next is met */
    float end;                 /* radiance when all has ended that begins on the present walk from here on, sr^-1 */
    KEPT Replayed *path;
    const __global float *virtual_extinction; /* [x][y][z]; below 0: outside of the mask, nothing is deposited */
    __global VirtualCollision *list;
    volatile __global uint *listed;
    volatile __global Accumulator *gradient;
    Branches branches;
    const __global float *brought; /* [branch]: radiance of each with those that begin on it, sr^-1 */
    uint path_count;               /* stride of `brought` */
} Tally;

inline void deposit_crossing(const Tally *tally, int index, float length, float radiance)
{
    if (radiance != 0.0f && tally->virtual_extinction[index] >= 0.0f)
        accumulate(tally->gradient + index, -tally->adjoint * length * radiance);
}

/* The n-th virtual collision replaces the kept one with probability 1 / n: all are equally likely to be kept. */
inline void meet_virtual_droplet(const Medium *medium, const Ray *from, const VoxelWalk *walk, float distance,
                                 Tally *tally)
{
    KEPT Replayed *path = tally->path;
    const uint n = path->virtual_collisions + 1u;
    path->virtual_collisions = n;
    const SampleKey key = kept_key(&path->key);
    const float2 u = uniforms(&key, n).xy;
    tally->virtual_depth = -logarithm(u.x);
    if (n == 1u)
        path->place = atomic_inc(tally->listed);
    else if (u.y * (float)n >= 1.0f)
        return;
    Ray ray = *from;
    move_to_walk(medium->scene, &ray, walk, distance);
    __global VirtualCollision *kept = tally->list + path->place;
    vstore3(ray.position, 0, kept->position);
    vstore3(ray.direction, 0, kept->direction);
    vstore3(ray.voxel, 0, kept->voxel);
    kept->throughput = path->throughput;
    kept->share = path->share;
    kept->event = path->event;
    kept->aside = path->aside;
    kept->path = path->path;
}

inline void cross(const Medium *medium, const Ray *ray, const VoxelWalk *walk, float length, float radiance,
                  Tally *tally)
{
    deposit_crossing(tally, walk->index, length, radiance);
    const float rate = tally->virtual_extinction[walk->index];
    float rest = length; /* km after the last virtual collision */
    while (rate * rest > tally->virtual_depth) {
        rest -= tally->virtual_depth / rate;
        meet_virtual_droplet(medium, ray, walk, walk->distance + (length - rest), tally);
    }
    tally->virtual_depth -= greater(rate * rest, 0.0f);
}

#define TRAVERSAL fly_and_deposit
#define TRAVERSAL_CONTEXT , float radiance, Tally *tally
#define CROSSES(index, length) cross(medium, ray, &walk, length, radiance, tally)
#include "walk/traversal.h"

#define TRAVERSAL fly_to_sun
#define TRAVERSAL_CONTEXT , float radiance, const Tally *tally
#define CROSSES(index, length) deposit_crossing(tally, index, length, radiance)
#include "walk/traversal.h"

/* Deposits at the collision where a flight, on which `radiance` depends, has ended. */
inline void deposit_collision(const Tally *tally, const Flight *flight, Particle end, float radiance)
{
    if (end < 0 || radiance == 0.0f || tally->virtual_extinction[flight->index] < 0.0f)
        return;
    const float droplets = flight->droplets + tally->virtual_extinction[flight->index];
    accumulate(tally->gradient + flight->index, tally->adjoint * (radiance / droplets));
}

inline void begin_flight(const Segment *segment, float share, bool aside, Tally *tally)
{
    KEPT Replayed *path = tally->path;
    path->throughput = segment->throughput;
    path->share = share;
    path->event = segment->event;
    path->aside = aside;
}

inline Flight tally_fly(const Medium *medium, Ray *ray, const Segment *segment, Tally *tally)
{
    tally->remaining = remaining_radiance(tally->end, tally->radiance, tally->path->total);
    begin_flight(segment, tally->own_share, false, tally);
    return fly_and_deposit(medium, ray, segment->optical_depth, tally->remaining, tally);
}

inline void tally_segment(const Medium *medium, const Segment *segment, const Flight *flight, Particle end, float share,
                          float local_radiance, Tally *tally)
{
    deposit_collision(tally, flight, end, tally->remaining);
}

inline void tally_side_flight(const Medium *medium, const Segment *segment, const Flight *flight, Particle end,
                              float share, float local_radiance, Tally *tally)
{
    begin_flight(segment, share, true, tally);
    Ray ray = segment->start;
    fly_and_deposit(medium, &ray, segment->optical_depth, local_radiance, tally);
    deposit_collision(tally, flight, end, local_radiance);
}

inline void tally_shadow_ray(const Medium *medium, const Ray *from, const LocalEstimate *estimate, Tally *tally)
{
    if (!depends_on_shadow_ray(medium, estimate))
        return;
    Ray ray = shadow_ray(medium, from);
    fly_to_sun(medium, &ray, INFINITY, estimate->radiance, tally);
}

/* A branch is walked when its path has ended; from the flights before it on, what it brings depends on the path. */
inline void tally_new_branch(uint number, Tally *tally)
{
    tally->end -= tally->brought[(size_t)(number - 1u) * tally->path_count];
}

inline void tally_next_branch(uint number, Tally *tally)
{
    tally->end = tally->radiance + tally->brought[(size_t)(number - 1u) * tally->path_count];
}

#include "walk/unbudgeted.h"
#include "walk/radiance.h"

/* Starts the tally of a path, whose radiance is known. */
inline void begin_tally(Tally *tally, uint number, float total, SampleKey key)
{
    KEPT Replayed *path = tally->path;
    key.view += VIRTUAL_COLLISIONS_VIEW;
    keep_key(&path->key, &key);
    path->virtual_collisions = 0u;
    path->place = 0u;
    path->path = number;
    path->total = total;
    tally->radiance = 0.0f;
    tally->own_share = 1.0f;
    tally->remaining = 0.0f;
    tally->end = total;
    clear_branches(&tally->branches);
    tally->virtual_depth = -logarithm(uniforms(&key, 0u).x);
}

inline void end_tally(const Tally *tally, volatile __global uint *astray)
{
    const KEPT Replayed *path = tally->path;
    check_replay(tally->radiance, path->total, astray);
    if (path->virtual_collisions > 0u)
        tally->list[path->place].of = path->virtual_collisions;
}

/* A launch may replay a part of the paths: its global offset is the first one. */
__kernel void replay_paths(REPLAY_PATHS_PARAMETERS)
{
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    TURNS(turn, path_count);
    KEPT_TOGETHER(SampleKey, key, Interaction, at, Replayed, replayed);
    Tally tally;
    tally.path = replayed;
    tally.virtual_extinction = virtual_extinction;
    tally.list = virtual_collisions;
    tally.listed = virtual_collision_count;
    tally.gradient = gradient;
    tally.path_count = path_count;
    BRANCHES(tally);
    for (bool walks = false; walks || next_turn(&turn);) {
        if (!walks) {
            const uint path = path_of_item(turn.item, pixel_count, path_count);
            const uint sample = first_sample + path / pixel_count, pixel_in_list = path % pixel_count;
            tally.adjoint = adjoint_of(adjoint, pixel_in_list, sample);
            if (tally.adjoint == 0.0f)
                continue;
            const uint2 pixel = pixels[pixel_in_list];
            const SampleKey own = sample_key(seed, stream, pixel, sample);
            keep_key(key, &own);
            start_path(at, camera_ray(scene, views + pixel.x, rays, &own));
            tally.brought = path_radiance + path_count + path;
            begin_tally(&tally, path, path_radiance[path], own);
        }
        walks = walk_turn(&medium, at, key, &tally) || next_branch(at, key, &tally);
        if (!walks)
            end_tally(&tally, astray);
    }
}
