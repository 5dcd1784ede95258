/* For tallies of radiance.h that deposit nothing along a path's flights. */
#ifndef CLOUDTOMO_UNTALLIED_H
#define CLOUDTOMO_UNTALLIED_H

#include "walk/estimate.h"

inline Flight tally_fly(const Medium *medium, Ray *ray, const Segment *segment, Tally *tally)
{
    return fly(medium, ray, segment->optical_depth);
}

inline void tally_segment(const Medium *medium, const Segment *segment, const Flight *flight, Particle end, float share,
                          float local_radiance, Tally *tally)
{
}

inline void tally_side_flight(const Medium *medium, const Segment *segment, const Flight *flight, Particle end,
                              float share, float local_radiance, Tally *tally)
{
}

#endif
