/* The pieces of a path, which the walk passes to a tally. */
#ifndef CLOUDTOMO_EVENT_H
#define CLOUDTOMO_EVENT_H

#include "walk/flight.h"
#include "walk/rng.h"

/* A sampled free flight, of the path itself or a side flight. */
typedef struct {
    Ray start;
    float optical_depth; /* sampled optical depth at which it collides, if it gets that far */
    float throughput;    /* throughput of the path at its start */
    uint event;          /* number in the path; 1: from the camera, or from the sun */
} Segment;

/* The state of a path where it scatters. */
typedef struct {
    KeptRay ray; /* position, and direction in which the path arrives */
    Particle particle;
    float albedo;
    float throughput;         /* after the interaction: product of albedos, over the probability of survival */
    uint event;               /* number of the segment that ends here */
    KeptVector new_direction; /* direction in which the path goes on */
    float u_estimate;         /* uniform number for the roulette on the local estimate */
    float u_companions;       /* uniform number for the numbers of side flights and of branches */
} Interaction;

/* A path that begins where another scatters (branches.h). */
typedef struct {
    Ray start;
    float throughput;
    float own_share; /* share of the branch in the local estimate at its next collision */
    uint event;      /* number of the segment that begins there */
    uint number;     /* 1, 2, ..., in the order in which a path's branches begin; 0 is the path itself */
} Branch;

/* The branches of a path; MOST_BRANCHES (cloudtomo_cl/opencl/layout.py) is how many it may have. */
typedef struct {
    Branch *waiting; /* [MOST_BRANCHES] */
    uint count;      /* number of those that wait */
    uint begun;      /* number of those that have begun */
    uint walked;     /* number of the one that is walked */
} Branches;

#endif
