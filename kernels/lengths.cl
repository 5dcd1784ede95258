/* The length of all paths in every voxel, side flights included. */
#include "walk/accumulate.h"
#include "walk/estimate.h"

typedef struct {
    float radiance, own_share; /* of radiance.h */
    float unit;                /* units of the sums per km */
    volatile __global Accumulator *lengths;
} Tally;

#define TRAVERSAL fly_and_measure
#define TRAVERSAL_CONTEXT , const Tally *tally
#define CROSSES(index, length) accumulate(tally->lengths + index, tally->unit * length)
#include "walk/traversal.h"

inline Flight tally_fly(const Medium *medium, Ray *ray, const Segment *segment, Tally *tally)
{
    return fly_and_measure(medium, ray, segment->optical_depth, tally);
}

inline void tally_segment(const Medium *medium, const Segment *segment, const Flight *flight, Particle end, float share,
                          float local_radiance, Tally *tally)
{
}

inline void tally_side_flight(const Medium *medium, const Segment *segment, const Flight *flight, Particle end,
                              float share, float local_radiance, Tally *tally)
{
    Ray ray = segment->start;
    fly_and_measure(medium, &ray, segment->optical_depth, tally);
}

inline void tally_shadow_ray(const Medium *medium, const Ray *from, const LocalEstimate *estimate, Tally *tally) {}

#include "walk/unbudgeted.h"
#include "walk/radiance.h"

__kernel void path_lengths(PATH_LENGTHS_PARAMETERS)
{
    KEPT_FOR_ITEM(SampleKey, key);
    KEPT_FOR_ITEM(Interaction, at);
    const size_t item = get_global_id(0);
    if (item >= path_count)
        return;
    const uint2 pixel = pixels[item % pixel_count];
    const SampleKey own = {seed, stream, pixel.y, pixel.x + PATH_LENGTHS_VIEW, first_sample + (uint)item / pixel_count};
    keep_key(key, &own);
    const Medium medium = make_medium(MEDIUM_ARGUMENTS);
    Tally tally = {0.0f, 1.0f, unit, lengths};
    walk_path(&medium, at, camera_ray(scene, views + pixel.x, rays, &own), key, &tally);
}
