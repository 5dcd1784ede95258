/* The gradient of a cost with respect to extinction: every path of a render is replayed, and deposits its
 * share into the voxels it depends on. A crossing of voxel v over l km on the way to radiance R adds -l R, a
 * collision with a droplet there adds R / extinction (the supplement's Eqs. 13, 17, 18 with sums swapped; path
 * replay, Vicini et al. 2021). */
#include "walk/accumulate.h"
#include "walk/estimate.h"
#include "walk/replayed.h"

typedef struct {
    float radiance, own_share; /* of radiance.h */
    float total;               /* the whole path's radiance, sr^-1 */
    float adjoint;             /* derivative of the cost with respect to this path's radiance, scaled */
    float remaining;           /* the adjoint payload of the path's flight: radiance that depends on it, sr^-1 */
    volatile __global Accumulator *gradient;
} Tally;

/* A flight that deposits, for a radiance that depends on it (sr^-1). */
inline void deposit_crossing(const Tally *tally, int index, float length, float payload)
{
    if (payload != 0.0f)
        accumulate(tally->gradient + index, -tally->adjoint * length * payload);
}

#define TRAVERSAL fly_and_deposit
#define TRAVERSAL_CONTEXT , float payload, const Tally *tally
#define CROSSES(index, length) deposit_crossing(tally, index, length, payload)
#define SKIPS()
#include "walk/traversal.h"

/* Where a flight that `payload` depends on has ended. */
inline void deposit_collision(const Tally *tally, const Flight *flight, Particle end, float payload)
{
    if (end >= 0 && payload != 0.0f)
        accumulate(tally->gradient + flight->index, tally->adjoint * (payload / flight->droplets));
}

inline Flight tally_fly(const Medium *medium, Ray *ray, const Segment *segment, Tally *tally)
{
    tally->remaining = remaining_radiance(tally->total, tally->radiance);
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
    if (!(local_radiance > 0.0f))
        return;
    Ray ray = segment->start;
    fly_and_deposit(medium, &ray, segment->optical_depth, local_radiance, tally);
    deposit_collision(tally, flight, end, local_radiance);
}

inline void tally_shadow_ray(const Medium *medium, const Ray *from, const LocalEstimate *estimate, Tally *tally)
{
    if (!depends_on_shadow_ray(medium, estimate))
        return;
    Ray ray = shadow_ray(medium, from);
    fly_and_deposit(medium, &ray, INFINITY, estimate->radiance, tally);
}

#include "walk/unbudgeted.h"
#include "walk/radiance.h"

__kernel void replay_paths(REPLAY_PATHS_PARAMETERS)
{
    const size_t item = get_global_id(0);
    if (item >= path_count)
        return;
    const uint path = path_of_item((uint)item, pixel_count, path_count);
    const uint sample = first_sample + (uint)(path / pixel_count);
    const uint pixel_in_list = path % pixel_count;
    const float2 halves = adjoint[pixel_in_list];
    Tally tally = {0.0f, 1.0f, path_radiance[path], sample & 1u ? halves.y : halves.x, 0.0f, gradient};
    if (tally.total == 0.0f || tally.adjoint == 0.0f)
        return;
    const uint2 pixel = pixels[pixel_in_list];
    const SampleKey key = {seed, stream, pixel.y, pixel.x, sample};
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    walk_path(&medium, camera_ray(scene, views + pixel.x, rays, &key), &key, &tally);
    check_replay(tally.radiance, tally.total, astray);
}
