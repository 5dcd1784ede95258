/* The pieces of a path, as the walk tells a tally of them. */
#ifndef CLOUDTOMO_EVENT_H
#define CLOUDTOMO_EVENT_H

#include "walk/flight.h"
#include "walk/rng.h"

/* A free path that is sampled, of the path's own or a side flight. */
typedef struct {
    Ray start;
    float optical_depth; /* sampled: where it collides, if it gets so far */
    float throughput;    /* of the path at its start */
    uint event;          /* its number in the path; 1: from the camera, or the sun */
} Segment;

/* Where a path scatters: what is kept of it. */
typedef struct {
    KeptRay ray; /* its direction is that in which the path arrives */
    Particle particle;
    float albedo;
    float throughput;         /* of the path, after it: product of single-scattering albedos, over survival */
    uint event;               /* number of the segment that ends here */
    KeptVector new_direction; /* in which the path goes on */
    float u_estimate;         /* uniform numbers: for the roulette on the local estimate */
    float u_side_flights;     /* for the number of side flights */
} Interaction;

#endif
