/* The radiance that each branch of a path brings, with those that begin on it: for path replay (replay.cl). A tally
 * calls await_branch where a branch begins, open_branch where it begins to be walked, and end_branches where a walk
 * ends. */
#ifndef CLOUDTOMO_BROUGHT_H
#define CLOUDTOMO_BROUGHT_H

#include "walk/event.h"

#define NOT_OPEN 0xFFFFFFFFu

typedef struct {
    float radiance[MOST_BRANCHES]; /* sr^-1; while a branch is open: the path's before it was walked */
    uint place[MOST_BRANCHES];     /* number of branches that waited then; NOT_OPEN before that and after its end */
} Brought;

/* For a branch, number 1, 2, ..., that has begun and waits. */
inline void await_branch(Brought *brought, uint number)
{
    brought->radiance[number - 1u] = 0.0f;
    brought->place[number - 1u] = NOT_OPEN;
}

/* For a branch that begins to be walked, while `waiting` others wait. */
inline void open_branch(Brought *brought, uint number, uint waiting, float path_radiance)
{
    brought->radiance[number - 1u] = path_radiance;
    brought->place[number - 1u] = waiting;
}

/* Branches have ended where a walk ends and none waits that began on them. */
inline void end_branches(Brought *brought, const Branches *branches, uint waiting, float path_radiance)
{
    for (uint n = 0u; n < branches->begun; ++n)
        if (brought->place[n] != NOT_OPEN && brought->place[n] >= waiting) {
            brought->radiance[n] = path_radiance - brought->radiance[n];
            brought->place[n] = NOT_OPEN;
        }
}

#endif
