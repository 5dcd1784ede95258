/* The walk of render_paths, for its counts alone: see scripts/divergence.py. Flights are flown again by a traversal
 * that counts what they cross. */
#include "walk/estimate.h"
#include "walk/rng.h"

#define EVENTS_COUNTED 128

typedef struct {
    float radiance, own_share;  /* of walk/radiance.h */
    uint event;                 /* of the path's flight, or later ones than are counted: the last */
    __global ushort *crossings; /* by event */
} Tally;

#define TRAVERSAL fly_and_count
#define TRAVERSAL_CONTEXT , __global ushort *crossings
#define CROSSES(index, length) ++*crossings
/* A step over a cube of empty blocks counts as a crossing, too. */
#define walk_skip(scene, walk, empty) (++*crossings, walk_skip(scene, walk, empty))
#include "walk/traversal.h"
#undef walk_skip

inline void count_flight(const Medium *medium, Ray ray, float optical_depth, const Tally *tally)
{
    fly_and_count(medium, &ray, optical_depth, tally->crossings + tally->event - 1u);
}

inline Flight tally_fly(const Medium *medium, Ray *ray, const Segment *segment, Tally *tally)
{
    tally->event = min(segment->event, (uint)EVENTS_COUNTED);
    count_flight(medium, *ray, segment->optical_depth, tally);
    return fly(medium, ray, segment->optical_depth);
}

inline void tally_segment(const Medium *medium, const Segment *segment, const Flight *flight, Particle end, float share,
                          float local_radiance, Tally *tally)
{
}

inline void tally_side_flight(const Medium *medium, const Segment *segment, const Flight *flight, Particle end,
                              float share, float local_radiance, Tally *tally)
{
    count_flight(medium, segment->start, segment->optical_depth, tally);
}

inline void tally_shadow_ray(const Medium *medium, const Ray *from, const LocalEstimate *estimate, Tally *tally)
{
    if (estimate->optical_depth > 0.0f)
        count_flight(medium, shadow_ray(medium, from), estimate->optical_depth, tally);
}

#include "walk/unbudgeted.h"
#include "walk/radiance.h"

__kernel void count_paths(COUNT_PATHS_PARAMETERS)
{
    KEPT_FOR_ITEM(SampleKey, key);
    KEPT_FOR_ITEM(Interaction, at);
    const size_t item = get_global_id(0);
    if (item >= path_count)
        return;
    const uint path = path_of_item((uint)item, pixel_count, path_count);
    const uint2 pixel = pixels[path % pixel_count];
    const SampleKey own = {seed, stream, pixel.y, pixel.x, first_sample + (uint)(path / pixel_count)};
    keep_key(key, &own);
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    Tally tally = {0.0f, 1.0f, 1u, crossings + (size_t)path * EVENTS_COUNTED};
    walk_path(&medium, at, camera_ray(scene, views + pixel.x, rays, &own), key, &tally);
    events[path] = tally.event;
}
