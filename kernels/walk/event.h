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

/* A path where it scatters. */
typedef struct {
    SampleKey key;
    KeptRay ray; /* its direction is that in which the path arrives */
    Particle particle;
    float throughput;       /* of the path, after it: product of single-scattering albedos, over survival */
    uint event;             /* number of the segment that ends here */
    KeptVector new_direction; /* in which the path goes on */
    float u_particle;       /* uniform numbers: for the particle */
    float u_scattering[2];  /* for the new direction */
    float u_estimate;       /* for the roulette on the local estimate */
    float u_roulette;       /* for the path's own */
    float u_side_flights;   /* for the number of side flights */
} Interaction;

/* Uniform numbers of a path that is kept. */
inline float4 path_uniforms(const KEPT Interaction *at, uint block)
{
    const SampleKey key = kept_key(&at->key);
    return uniforms(&key, at->event * BLOCKS_PER_EVENT + block);
}

#endif
