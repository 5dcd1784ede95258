/* The gradient of a cost with respect to extinction: every path of a render is replayed, and deposits its
 * share into the voxels it depends on. A crossing of voxel v over l km on the way to radiance R adds -l R, a
 * collision with a droplet there adds R / extinction (the supplement's Eqs. 13, 17, 18 with sums swapped; path
 * replay, Vicini et al. 2021).
 *
 * Where the extinction is small that is noise, and where it is 0 nothing collides. So there are virtual droplets too,
 * `virtual_extinction` of them (km^-1): paths pass them, but where a path meets one another path begins, which
 * scatters there as if the droplet were real. What that one brings (virtual.cl), and what collisions with real
 * droplets bring, is divided by the extinction of both. Whatever the virtual extinction, the mean is the derivative,
 * if together with the droplets' it is above 0. */
#include "walk/accumulate.h"
#include "walk/estimate.h"
#include "walk/replayed.h"
#include "walk/turns.h"

typedef struct {
    float radiance, own_share; /* of radiance.h */
    float total;               /* the whole path's radiance, sr^-1 */
    float adjoint;             /* derivative of the cost with respect to this path's radiance, scaled */
    float remaining;           /* the adjoint payload of the path's flight: radiance that depends on it, sr^-1 */
    float virtual_depth;       /* optical depth of virtual droplets before the next is met */
    uint virtual_collisions;   /* so far */
    uint place;                /* of the one that is kept, in the list */
    uint path;
    const KEPT Interaction *at; /* the path as it stands */
    const __global float *virtual_extinction; /* [x][y][z]; below 0: outside of the mask, nothing is deposited */
    __global VirtualCollision *list;
    volatile __global uint *listed;
    volatile __global Accumulator *gradient;
} Tally;

/* What a flight deposits, and with what another path would begin on it. */
typedef struct {
    float radiance; /* that depends on it, sr^-1 */
    float throughput, share;
    uint event;
    bool aside; /* a side flight */
} Payload;

inline void deposit_crossing(const Tally *tally, int index, float length, float radiance)
{
    if (radiance != 0.0f && tally->virtual_extinction[index] >= 0.0f)
        accumulate(tally->gradient + index, -tally->adjoint * length * radiance);
}

/* The uniform numbers of a path's virtual collision n; 0: of the way to the first. */
inline float4 virtual_uniforms(const Tally *tally, uint n)
{
    SampleKey key = kept_key(&tally->at->key);
    key.view += VIRTUAL_COLLISIONS_VIEW;
    return uniforms(&key, n);
}

/* The n-th virtual collision replaces the one that is kept with probability 1 / n: each is kept as likely. */
inline void meet_virtual_droplet(const Medium *medium, const Ray *from, const VoxelWalk *walk, float distance,
                                        const Payload *payload, Tally *tally)
{
    const uint n = ++tally->virtual_collisions;
    const float2 u = virtual_uniforms(tally, n).xy;
    tally->virtual_depth = -logarithm(u.x);
    if (n == 1u)
        tally->place = atomic_inc(tally->listed);
    else if (u.y * (float)n >= 1.0f)
        return;
    Ray ray = *from;
    move_to_walk(medium->scene, &ray, walk, distance);
    __global VirtualCollision *kept = tally->list + tally->place;
    vstore3(ray.position, 0, kept->position);
    vstore3(ray.direction, 0, kept->direction);
    vstore3(ray.voxel, 0, kept->voxel);
    kept->throughput = payload->throughput;
    kept->share = payload->share;
    kept->event = payload->event;
    kept->aside = payload->aside;
    kept->path = tally->path;
}

inline void cross(const Medium *medium, const Ray *ray, const VoxelWalk *walk, float length, const Payload *payload,
                  Tally *tally)
{
    deposit_crossing(tally, walk->index, length, payload->radiance);
    const float rate = tally->virtual_extinction[walk->index];
    float rest = length; /* km after the last virtual collision */
    while (rate * rest > tally->virtual_depth) {
        rest -= tally->virtual_depth / rate;
        meet_virtual_droplet(medium, ray, walk, walk->distance + (length - rest), payload, tally);
    }
    tally->virtual_depth -= greater(rate * rest, 0.0f);
}

#define TRAVERSAL fly_and_deposit
#define TRAVERSAL_CONTEXT , Payload payload, Tally *tally
#define CROSSES(index, length) cross(medium, ray, &walk, length, &payload, tally)
#define SKIPS()
#include "walk/traversal.h"

#define TRAVERSAL fly_to_sun
#define TRAVERSAL_CONTEXT , float radiance, const Tally *tally
#define CROSSES(index, length) deposit_crossing(tally, index, length, radiance)
#define SKIPS()
#include "walk/traversal.h"

/* Where a flight that `radiance` depends on has ended. */
inline void deposit_collision(const Tally *tally, const Flight *flight, Particle end, float radiance)
{
    if (end < 0 || radiance == 0.0f || tally->virtual_extinction[flight->index] < 0.0f)
        return;
    const float droplets = flight->droplets + tally->virtual_extinction[flight->index];
    accumulate(tally->gradient + flight->index, tally->adjoint * (radiance / droplets));
}

inline Flight tally_fly(const Medium *medium, Ray *ray, const Segment *segment, Tally *tally)
{
    tally->remaining = remaining_radiance(tally->total, tally->radiance);
    const Payload payload = {tally->remaining, segment->throughput, tally->own_share, segment->event, false};
    return fly_and_deposit(medium, ray, segment->optical_depth, payload, tally);
}

inline void tally_segment(const Medium *medium, const Segment *segment, const Flight *flight, Particle end, float share,
                          float local_radiance, Tally *tally)
{
    deposit_collision(tally, flight, end, tally->remaining);
}

inline void tally_side_flight(const Medium *medium, const Segment *segment, const Flight *flight, Particle end,
                              float share, float local_radiance, Tally *tally)
{
    const Payload payload = {local_radiance, segment->throughput, share, segment->event, true};
    Ray ray = segment->start;
    fly_and_deposit(medium, &ray, segment->optical_depth, payload, tally);
    deposit_collision(tally, flight, end, local_radiance);
}

inline void tally_shadow_ray(const Medium *medium, const Ray *from, const LocalEstimate *estimate, Tally *tally)
{
    if (!depends_on_shadow_ray(medium, estimate))
        return;
    Ray ray = shadow_ray(medium, from);
    fly_to_sun(medium, &ray, INFINITY, estimate->radiance, tally);
}

#include "walk/unbudgeted.h"
#include "walk/radiance.h"

/* Before a path, whose radiance is known. */
inline void begin_tally(Tally *tally, uint path, float total)
{
    tally->radiance = 0.0f;
    tally->own_share = 1.0f;
    tally->total = total;
    tally->remaining = 0.0f;
    tally->virtual_depth = -logarithm(virtual_uniforms(tally, 0u).x);
    tally->virtual_collisions = 0u;
    tally->place = 0u;
    tally->path = path;
}

inline void end_tally(const Tally *tally, volatile __global uint *astray)
{
    check_replay(tally->radiance, tally->total, astray);
    if (tally->virtual_collisions > 0u)
        tally->list[tally->place].of = tally->virtual_collisions;
}

/* The launch may be a part of the paths: its global offset is the first. */
__kernel void replay_paths(REPLAY_PATHS_PARAMETERS)
{
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    TURNS(turn, path_count);
    KEPT_FOR_ITEM(Interaction, at);
    Tally tally;
    tally.at = at;
    tally.virtual_extinction = virtual_extinction;
    tally.list = virtual_collisions;
    tally.listed = virtual_collision_count;
    tally.gradient = gradient;
    for (bool walks = false;;) {
        if (!walks) {
            if (!next_turn(&turn))
                break;
            const uint path = path_of_item(turn.item, pixel_count, path_count);
            const uint sample = first_sample + path / pixel_count, pixel_in_list = path % pixel_count;
            tally.adjoint = adjoint_of(adjoint, pixel_in_list, sample);
            if (tally.adjoint == 0.0f)
                continue;
            const uint2 pixel = pixels[pixel_in_list];
            const SampleKey key = sample_key(seed, stream, pixel, sample);
            start_path(at, &key, camera_ray(scene, views + pixel.x, rays, &key));
            begin_tally(&tally, path, path_radiance[path]);
        }
        do
            walks = walk_event(&medium, at, &tally);
        while (walks && !REGENERATES);
        if (!walks)
            end_tally(&tally, astray);
    }
}
