/* Branches: where a path scatters, another may begin, in a direction around the sun. It waits until all that began
 * later have ended, and then is walked as the path itself is: it scatters, has side flights, and branches.
 *
 * Only with CLOUDTOMO_BRANCHES, and in kernels that call next_branch. There the tally has `Branches branches`, and the
 * including file defines, before it includes this,
 *
 *   void on_branch(float given, float taken, tally)
 *       a path leaves the throughput `given` to branches, and one of them takes `taken`, or none: the means are equal
 *   void tally_new_branch(uint number, tally)
 *       a branch has begun, and waits
 *   void tally_next_branch(uint number, tally)
 *       what was walked before has ended, and a branch is walked now
 *
 * budgeted.h and unbudgeted.h define the first. All but these is
 *
 *   BRANCHES(tally)               declares the memory of a tally's branches; in a kernel, not in a branch of its code
 *   clear_branches(branches)      for a new path
 *   next_branch(at, key, tally)   makes `at` the start of the branch that began last; returns false if none waits */
#ifndef CLOUDTOMO_BRANCHES_H
#define CLOUDTOMO_BRANCHES_H

#include "walk/companions.h"
#include "walk/roulette.h"

inline void clear_branches(Branches *branches)
{
    branches->count = 0u;
    branches->begun = 0u;
    branches->walked = 0u;
}

#ifdef CLOUDTOMO_BRANCHES
#define BRANCHES(tally) \
    Branch tally##_waiting[MOST_BRANCHES]; \
    tally.branches.waiting = tally##_waiting

/* Begins a branch, or not, and takes from the path what its branches bring. */
inline void branch_off(const Medium *medium, KEPT Interaction *at, Companions companions, Densities own,
                       const KEPT SampleKey *key, Tally *tally)
{
    const float throughput = at->throughput, kept = throughput * share_beside_each_other(own);
    at->throughput = kept;
    float taken = 0.0f;
    /* Side flights are rounded to a whole number by the same uniform number: each has its mean. */
    if (at->u_companions < companions.branches) {
        const float4 u = event_uniforms(key, at->event, BLOCK_BRANCH);
        const float cosine = sample_henyey_greenstein(u.x, medium->scene->wide_g);
        const float3 direction = direction_around(sun_direction(medium->scene), cosine, u.y);
        const float3 arriving = kept_vector(&at->ray.direction);
        const Densities densities = densities_in(medium, at->particle, arriving, direction, companions);
        taken = throughput * share_beside_each_other(densities);
        const float left = after_roulette(taken, u.z, tally);
        if (left > 0.0f) {
            Branches *branches = &tally->branches;
            Branch *branch = branches->waiting + branches->count++;
            branch->start = kept_ray(&at->ray);
            branch->start.direction = direction;
            branch->throughput = left;
            branch->own_share = share_beside_side_flights(densities);
            branch->event = at->event + 1u;
            branch->number = ++branches->begun;
            tally_new_branch(branch->number, tally);
        }
    }
    on_branch(throughput - kept, taken, tally);
}

inline bool next_branch(KEPT Interaction *at, KEPT SampleKey *key, Tally *tally)
{
    Branches *branches = &tally->branches;
    if (branches->count == 0u)
        return false;
    const Branch *branch = branches->waiting + --branches->count;
    keep_ray(&at->ray, &branch->start);
    at->throughput = branch->throughput;
    at->event = branch->event;
    tally->own_share = branch->own_share;
    key->view += (branch->number - branches->walked) * BRANCH_VIEW;
    branches->walked = branch->number;
    tally_next_branch(branch->number, tally);
    return true;
}
#else
#define BRANCHES(tally)

inline void branch_off(const Medium *medium, KEPT Interaction *at, Companions companions, Densities own,
                       const KEPT SampleKey *key, Tally *tally)
{
}

inline bool next_branch(KEPT Interaction *at, KEPT SampleKey *key, Tally *tally) { return false; }
#endif

#endif
